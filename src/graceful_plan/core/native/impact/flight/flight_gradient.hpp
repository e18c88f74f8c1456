// The gradient of the effect of a side in the way: flight.hpp in reverse mode; see drop_gradient.hpp.
#pragma once
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// Maps derivatives with respect to the object's extents along a surface's axis to the parts.
template <class V>
static inline void back_extents(Backward<V>& back, const Extents<V>& extents, const Surface& s, int i, V d_low,
                                V d_high) {
  const double x = Extents<V>::axis_x(s, i), y = Extents<V>::axis_y(s, i);
  for (int p = 0; p < back.drop.n_part; ++p) {
    const V low = where(extents.lowest[i] == double(p), d_low, V{}),
            high = where(extents.highest[i] == double(p), d_high, V{});
    back.d_flight.part[p].o.x += x * (low + high), back.d_flight.part[p].o.y += y * (low + high);
    back_reach_along(back, p, x, y, high - low);
  }
}

// One side, in the lanes in which it stops the flight; `d` is zero in the others.
template <class V>
static inline void back_meeting(Backward<V>& back, const Extents<V>& extents, int surface, int i,
                                const StopSlope<V>& d) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const DropConstants& k = drop.constants;
  const Surface& s = drop.surface[surface];
  const Point2<V> from = placed(s, flight.c.x, flight.c.y), by = turned(s, flight.v.x, flight.v.y);
  const V at[2] = {from.x, from.y}, v[2] = {by.x, by.y};
  SideApproach<V> m(s, extents, i, at, v);
  m.detail(drop, flight, s, extents, i, at, v);
  const Step<V> front = m.in_front(), beside = m.beside(), under = m.below(s), over = m.above(flight, s),
                moves = m.moves(v[i]);
  const V push = d.x * Extents<V>::axis_x(s, i) + d.y * Extents<V>::axis_y(s, i);
  const V d_any = d.chance - v[i] * push, d_chance = d_any * moves.value, heights = under.value * over.value;
  const V d_heights = d_chance * front.value * beside.value;
  const V d_over = d_heights * under.value * over.slope * (1.0 / kSideTop);
  const V d_height = d_over - d_heights * over.value * under.slope * (1.0 / kSideTop);
  d_flight.high += d_over, d_flight.low += d_height - d_over;
  d_flight.v.z += d_height * m.falls;
  const V d_beside = d_chance * front.value * heights * beside.slope, d_half = d_beside * m.inverse_width;
  const V d_across = where(m.across < 0.0, d_half, -d_half);
  // 1/sqrt(V) has the derivative -V^-3/2 /2.
  const V cube = m.inverse_width * m.inverse_width * m.inverse_width * (kSideWidth * kSideWidth);
  const V d_width = d_beside * (m.half - absolute(m.across)) * cube;
  V d_time = d.time + where(m.time > k.delay, d_height * (flight.v.z - kGravity * m.falls), V{});
  d_time += d_across * v[1 - i] - d_width * (k.velocity_spread * k.velocity_spread) * m.time;
  const V inverse_speed = reciprocal(m.speed);
  const V d_gap = d_chance * front.slope * beside.value * heights * (1.0 / kSideTouch) +
                  where(m.gap > 0.0, d_time * inverse_speed, V{});
  const V d_speed = where(absolute(v[i]) > kSideSlow, -d_time * m.time * inverse_speed, V{}) +
                    d_any * front.value * beside.value * heights * moves.slope * (2.0 / kSideMoves);
  const auto backwards = v[i] < 0.0;
  V d_at[2], d_v[2], d_low[2], d_high[2];
  d_low[i] = where(backwards, d_gap, V{}), d_high[i] = where(backwards, V{}, -d_gap), d_at[i] = d_low[i] + d_high[i];
  d_v[i] = where(backwards, -d_speed, d_speed) - flight.stop.chance * push;
  d_at[1 - i] = d_across, d_v[1 - i] = d_across * m.time;
  d_low[1 - i] = 0.5 * (d_across - d_half), d_high[1 - i] = 0.5 * (d_across + d_half);
  back_turned(s, {d_at[0], d_at[1]}, d_flight.c.x, d_flight.c.y);
  back_turned(s, {d_v[0], d_v[1]}, d_flight.v.x, d_flight.v.y);
  for (int j = 0; j < 2; ++j) back_extents(back, extents, s, j, d_low[j], d_high[j]);
}

template <class V> static inline void back_find_stop(Backward<V>& back) {
  const DropTables& drop = back.drop;
  const SideStop<V>& stop = back.flight.stop;
  if (!any(stop.chance > 0.0)) return;
  const StopSlope<V>& d = back.d_flight.stop;
  Extents<V> extents;
  for (int n = 0; n < drop.n_surface; ++n)
    for (int i = 0; i < 2; ++i) {
      const auto stops = stop.side == double(2 * n + i);
      if (!any(stops)) continue;
      extents.turn_to(drop, back.flight, drop.surface[n]);
      back_meeting(
          back, extents, n, i,
          {where(stops, d.time, V{}), where(stops, d.x, V{}), where(stops, d.y, V{}), where(stops, d.chance, V{})});
    }
}

}  // namespace gp::GP_ISA

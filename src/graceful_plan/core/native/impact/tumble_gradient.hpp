// The gradient of step 3, falls onto lower surfaces, and of the own loss they cause; see drop_gradient.hpp.
#pragma once
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "impact/own_loss.hpp"
#include "impact/own_loss_gradient.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

template <class V> struct TumbleSlope {
  V mass = {}, inverse_scale = {};
  Point2<V> drift = {V{}, V{}}, start = {V{}, V{}};
};

// The objects that leave their support on a level. `d` holds the derivatives with respect to the state after it.
template <class V>
static inline void back_leave(Backward<V>& back, const Tumble<V>& tumble, int level, TumbleSlope<V>& d,
                              OwnLossSlope<V>* own) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const Point2<V>& n = landing.away[level];
  const V leaving = landing.leaving[level];
  V falls = V{} + 1.0;
  const int first = drop.level_start[level], last = drop.level_start[level + 1];
  const bool leaves = any(leaving > kNothing<V>);
  V before[kMaxSurfaces];
  const Point2<V> place = tumble.beside(drop, n);
  for (int k = first; leaves && k < last; ++k) {
    before[k] = falls;
    const Point2<V> at = placed(drop.surface[k], place.x, place.y);
    if (tumble.may_meet(drop.surface[k], at)) falls *= 1.0 - tumble.holds(drop.surface[k], at);
  }
  const V M = leaving * falls, d_M = d.mass + d.drift.x * n.x + d.drift.y * n.y;
  V d_falls = d_M * leaving;
  if (own) d_falls += own->back_leave(back, level, falls);
  d_landing.leaving[level] += d_M * falls;
  V d_x = {}, d_y = {}, after = V{} + 1.0;
  for (int k = last; leaves && k-- > first;) {
    const Surface& s = drop.surface[k];
    const Point2<V> at = placed(s, place.x, place.y);
    if (!tumble.may_meet(s, at)) continue;
    const Within<V> x(at.x, V{} + s.inside[0], tumble.inverse_scale), y(at.y, V{} + s.inside[1], tumble.inverse_scale);
    const V d_inside = -d_falls * before[k] * after * s.catches;
    after *= 1.0 - s.catches * x.value * y.value;
    back_turned(s, {d_inside * x.x * y.value, d_inside * x.value * y.x}, d_x, d_y);
    d.inverse_scale += d_inside * (x.inverse_scale * y.value + x.value * y.inverse_scale);
  }
  const double moved = drop.constants.drift * drop.size;
  d.start.x += d_x, d.start.y += d_y;
  d_landing.away[level].x += d.drift.x * M + moved * d_x, d_landing.away[level].y += d.drift.y * M + moved * d_y;
}

// One level. `tumble` is at its state before the level, d holds the derivatives with respect to the state after it.
// `own` is null if own loss does not count; otherwise `loss` is also at its state before the level.
template <class V>
static inline void back_tumble_level(Backward<V>& back, Tumble<V>& tumble, int level, const V* d_G, TumbleSlope<V>& d,
                                     OwnLoss<V>& loss, OwnLossSlope<V>* own) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  back_leave(back, tumble, level, d, own);
  if (!tumble.enter(drop)) return;
  const int first = drop.level_start[level], last = drop.level_start[level + 1];
  V before[kMaxSurfaces], keep = V{} + 1.0;
  for (int k = first; k < last; ++k) {
    before[k] = keep;
    const Point2<V> at = placed(drop.surface[k], tumble.x, tumble.y);
    if (!tumble.may_meet(drop.surface[k], at)) continue;
    const Within<V> x(at.x, V{} + drop.surface[k].inside[0], tumble.inverse_scale),
        y(at.y, V{} + drop.surface[k].inside[1], tumble.inverse_scale);
    keep *= 1.0 - drop.surface[k].catches * x.value * y.value;
  }
  V d_keep = d.mass * tumble.mass + d.drift.x * tumble.drift.x + d.drift.y * tumble.drift.y;
  d.mass *= keep, d.drift.x *= keep, d.drift.y *= keep;
  if (own) d_keep += own->back_keep(level, keep), loss.enter(tumble);
  V after = V{} + 1.0, d_x = {}, d_y = {};
  for (int k = last; k-- > first;) {
    const Surface& s = drop.surface[k];
    const Point2<V> at = placed(s, tumble.x, tumble.y);
    if (!tumble.may_meet(s, at)) continue;
    const Within<V> in_x(at.x, V{} + s.inside[0], tumble.inverse_scale),
        in_y(at.y, V{} + s.inside[1], tumble.inverse_scale);
    const Within<V> hit_x(at.x, V{} + s.reached[0], tumble.inverse_scale),
        hit_y(at.y, V{} + s.reached[1], tumble.inverse_scale);
    const V ends = s.catches * in_x.value * in_y.value, d_hit = d_G[k] * tumble.mass;
    V d_ends = -d_keep * before[k] * after;
    if (own) d_ends += own->back_end(drop, s, loss, tumble.mass * before[k], ends);
    const V d_caught = s.catches * d_ends;
    after *= 1.0 - ends;
    d.mass += d_G[k] * hit_x.value * hit_y.value;
    back_turned(s,
                {d_caught * in_x.x * in_y.value + d_hit * hit_x.x * hit_y.value,
                 d_caught * in_x.value * in_y.x + d_hit * hit_x.value * hit_y.x},
                d_x, d_y);
    d.inverse_scale += d_caught * (in_x.inverse_scale * in_y.value + in_x.value * in_y.inverse_scale) +
                       d_hit * (hit_x.inverse_scale * hit_y.value + hit_x.value * hit_y.inverse_scale);
  }
  const V share = reciprocal(tumble.mass + kLeastMass), moved = drop.constants.drift * drop.size * share;
  d.start.x += d_x, d.start.y += d_y;
  d.drift.x += d_x * moved, d.drift.y += d_y * moved;
  d.mass -= (d_x * tumble.drift.x + d_y * tumble.drift.y) * moved * share;
  if (own) d.mass += own->back_enter(loss);
}

template <class V> static inline void back_tumble(Backward<V>& back, const Tumble<V>& tumble, const TumbleSlope<V>& d) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const DropConstants& k = drop.constants;
  const V d_variance =
      -0.5 * kBeta * kBeta * tumble.inverse_scale * tumble.inverse_scale * tumble.inverse_scale * d.inverse_scale;
  const V per_speed = 2.0 * k.carry_spread * k.carry_spread * d_variance;
  d_landing.blur += d_variance;
  d_landing.mean_time += back_travelled(back, landing.mean_time + k.carry, d.start.x, d.start.y);
  d_flight.v.x += per_speed * flight.v.x, d_flight.v.y += per_speed * flight.v.y;
}

}  // namespace gp::GP_ISA

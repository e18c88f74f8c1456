// The gradient of the spill model: spill.hpp in reverse mode, with the conventions of drop_gradient.hpp.
#pragma once
#include "cutoffs.hpp"
#include "impact/contents/spill.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

template <class V> struct MouthSlope {
  V x = {}, y = {}, vx = {}, vy = {}, vz = {}, up = {}, speed2 = {};
  Vec<V> axis = {V{}, V{}, V{}};
};

// Derivatives with respect to quantities that all surfaces share.
template <class V> struct SpillSlope {
  V x = {}, y = {}, inverse_scale = {}, rho = {};
  V lands[kMaxSurfaces + 1], land_x[kMaxSurfaces + 1], land_y[kMaxSurfaces + 1];  // U and W, per level

  explicit SpillSlope(const DropTables& drop) {
    for (int l = 0; l <= drop.n_level; ++l) lands[l] = land_x[l] = land_y[l] = V{};
  }
};

// P that a point is within half sizes of a surface's centre, with derivatives; x and y are along the axes of W.
template <class V> struct Upon {
  V value = {}, x = {}, y = {}, half = {}, inverse_scale = {};

  Upon(const Surface& s, V at_x, V at_y, V a, V b, V scale) {
    const Point2<V> at = placed(s, at_x, at_y);
    if (!any(may_be_within(at, a, b, scale))) return;
    const Within<V> along(at.x, a, scale), across(at.y, b, scale);
    value = along.value * across.value;
    back_turned(s, {along.x * across.value, along.value * across.x}, x, y);
    half = along.A * across.value + along.value * across.A;
    inverse_scale = along.inverse_scale * across.value + along.value * across.inverse_scale;
  }
};

// --- surfaces in the puddle -----------------------------------------------------------------------------------------

template <class V>
static inline void back_standing(const DropTables& drop, const Spill<V>& spill, int i, V d_D, SpillSlope<V>& d) {
  const SpillSurface& stands = drop.spill.surface[i];
  const Surface& s = drop.surface[i];
  const V U = spill.sum[stands.end] - spill.sum[stands.first];
  if (!any(U > kNothing<V>)) return;
  const V share = reciprocal(U + kLeastMass), reach = spill.k.reach * spill.rho;
  const V x = (spill.sum_x[stands.end] - spill.sum_x[stands.first]) * share,
          y = (spill.sum_y[stands.end] - spill.sum_y[stands.first]) * share;
  const Upon<V> upon(s, spill.x + x, spill.y + y, s.half[0] + reach, s.half[1] + reach, spill.inverse_scale);
  const V d_upon = d_D * minimum(U, V{} + 1.0);
  d.rho += d_upon * upon.half * spill.k.reach;
  d.inverse_scale += d_upon * upon.inverse_scale;
  d.x += d_upon * upon.x, d.y += d_upon * upon.y;
  const V d_x = d_upon * upon.x * share, d_y = d_upon * upon.y * share;
  const V d_U = where(U < 1.0, d_D * upon.value, V{}) - d_x * x - d_y * y;
  // These are derivatives of sums over levels: differences here, summed up in back_spill.
  d.lands[stands.first] += d_U, d.land_x[stands.first] += d_x, d.land_y[stands.first] += d_y;
  d.lands[stands.end] -= d_U, d.land_x[stands.end] -= d_x, d.land_y[stands.end] -= d_y;
}

// --- one level ------------------------------------------------------------------------------------------------------

template <class V> struct FlowSlope {
  V flows = {}, x = {}, y = {};  // O and o
};

template <class V> struct LevelSlope {  // of contents that arrive at or land on a level: amount and place
  V amount, x, y;
};

template <class V> struct ReachedSlope {  // A, B and D (surfaces in the puddle), per surface
  V fallen[kMaxSurfaces], flown[kMaxSurfaces], stood[kMaxSurfaces];
};

template <class V>
static inline void back_over(const DropTables& drop, const Spill<V>& spill, int l, V d_over, LevelSlope<V>& d_lands,
                             SpillSlope<V>& d) {
  const SpillLevel<V>& at = spill.level[l];
  if (!any(at.lands > kNothing<V>)) return;
  const V share = reciprocal(at.lands + kLeastMass), x = at.land_x * share, y = at.land_y * share;
  const int first = drop.level_start[l], last = drop.level_start[l + 1];
  const auto upon_inner = [&](const Surface& s) {
    return Upon<V>(s, spill.x + x, spill.y + y, V{} + (s.half[0] - spill.inner), V{} + (s.half[1] - spill.inner),
                   spill.inverse_scale);
  };
  V before[kMaxSurfaces], past = V{} + 1.0, after = V{} + 1.0;
  for (int i = first; i < last; ++i) {
    before[i] = past;
    if (spill.is_wide(drop.surface[i])) past *= 1.0 - upon_inner(drop.surface[i]).value;
  }
  for (int i = last; i-- > first;) {
    const Surface& s = drop.surface[i];
    if (!spill.is_wide(s)) continue;
    const Upon<V> upon = upon_inner(s);
    const V others = before[i] * after;
    after *= 1.0 - upon.value;
    const V d_upon = -d_over * others, px = d_upon * upon.x * share, py = d_upon * upon.y * share;
    d.inverse_scale += d_upon * upon.inverse_scale;
    d.x += d_upon * upon.x, d.y += d_upon * upon.y;
    d_lands.x += px, d_lands.y += py, d_lands.amount -= px * x + py * y;
  }
}

// d_flow: derivatives with respect to the state below the level, replaced by those above it. Returns those with respect
// to the arriving contents.
template <class V>
static inline LevelSlope<V> back_flow(const DropTables& drop, const Spill<V>& spill, int l,
                                      const ReachedSlope<V>& reached, FlowSlope<V>& d_flow, SpillSlope<V>& d) {
  const SpillLevel<V>& at = spill.level[l];
  V d_past = d_flow.flows * at.flows + d_flow.x * at.flow_x + d_flow.y * at.flow_y;
  const V d_over = d_flow.flows * at.lands + d_flow.x * at.land_x + d_flow.y * at.land_y;
  LevelSlope<V> d_lands = {d.lands[l] + d_flow.flows * at.over, d.land_x[l] + d_flow.x * at.over,
                           d.land_y[l] + d_flow.y * at.over};
  d_flow.flows *= at.past, d_flow.x *= at.past, d_flow.y *= at.past;
  back_over(drop, spill, l, d_over, d_lands, d);
  const V d_x = d_lands.x, d_y = d_lands.y;
  const V share = reciprocal(at.flows + kLeastMass), fx = at.flow_x * share, fy = at.flow_y * share,
          run = spill.k.run_off * spill.rho;
  const V stays = at.flows * (1.0 - at.past), d_stays = d_lands.amount + d_x * fx + d_y * fy;
  LevelSlope<V> d_arrives = {d_lands.amount + d_x * at.x + d_y * at.y, d_x * at.arrives, d_y * at.arrives};
  V d_fx = d_x * stays, d_fy = d_y * stays;
  d_flow.flows += d_stays * (1.0 - at.past);
  d_past -= d_stays * at.flows;
  const bool arrives = any(at.arrives > kNothing<V>), flows = any(at.flows > kNothing<V>);
  const int first = drop.level_start[l], last = drop.level_start[l + 1];
  const V inverse_flows = reciprocal(maximum(at.flows, V{} + kTiny<V>));
  V before[kMaxSurfaces], past = V{} + 1.0, after = V{} + 1.0;
  for (int i = first; i < last; ++i) before[i - first] = past, past *= 1.0 - spill.flown[i] * inverse_flows;
  for (int i = last; i-- > first;) {
    const Surface& s = drop.surface[i];
    if (arrives && any(reached.fallen[i] != 0.0)) {
      const Upon<V> upon(s, spill.x + at.x, spill.y + at.y, V{} + (s.half[0] + spill.k.margin),
                         V{} + (s.half[1] + spill.k.margin), spill.inverse_scale);
      const V d_upon = reached.fallen[i] * at.arrives;
      d_arrives.amount += reached.fallen[i] * upon.value;
      d.x += d_upon * upon.x, d.y += d_upon * upon.y;
      d_arrives.x += d_upon * upon.x, d_arrives.y += d_upon * upon.y, d.inverse_scale += d_upon * upon.inverse_scale;
    }
    const double visible = drop.spill.surface[i].visible;
    if (!flows || visible == 0.0) continue;
    const Upon<V> upon(s, spill.x + fx, spill.y + fy, s.half[0] + run, s.half[1] + run, spill.inverse_scale);
    const V d_upon = (reached.flown[i] * at.flows - d_past * before[i - first] * after) * visible;
    after *= 1.0 - visible * upon.value;
    d_flow.flows += reached.flown[i] * visible * upon.value;
    d.x += d_upon * upon.x, d.y += d_upon * upon.y;
    d_fx += d_upon * upon.x, d_fy += d_upon * upon.y;
    d.inverse_scale += d_upon * upon.inverse_scale, d.rho += d_upon * upon.half * spill.k.run_off;
  }
  d_flow.x += d_fx * share, d_flow.y += d_fy * share;
  d_flow.flows -= share * (d_fx * fx + d_fy * fy);
  return d_arrives;
}

template <class V>
static inline void back_arrive(Backward<V>& back, const Mouth<V>& mouth, const Spill<V>& spill, int l,
                               const LevelSlope<V>& d, MouthSlope<V>& d_mouth) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const SpillLevel<V>& at = spill.level[l];
  const int first = drop.level_start[l];
  const V time = landing.time[first] + spill.k.carry;
  d_landing.first[l] += d.amount * at.hard, d_landing.leaving[l] += d.amount * (1.0 - at.hard);
  const V d_u = d.amount * (landing.first[l] - landing.leaving[l]) * at.hard * (1.0 - at.hard) *
                (1.0 / (kBeta * spill.k.soft_spread));
  const V h = flight.low - drop.surface[first].top, soft = square_root(h * h + 1e-4), slope = d_u * reciprocal(at.u);
  d_flight.v.z += slope * flight.v.z;
  d_flight.low += slope * (0.5 * kGravity) * (1.0 + h * reciprocal(soft));
  d_mouth.vx += d.x * time, d_mouth.vy += d.y * time;
  d_landing.time[first] += d.x * mouth.vx + d.y * mouth.vy + back_pushed(back, time, d.x, d.y);
}

// --- the container --------------------------------------------------------------------------------------------------

template <class V>
static inline void back_blur(Backward<V>& back, const Spill<V>& spill, const SpillSlope<V>& d, MouthSlope<V>& d_mouth) {
  const SpillConstants& k = spill.k;
  const V d_variance =
      -0.5 * kBeta * kBeta * spill.inverse_scale * spill.inverse_scale * spill.inverse_scale * d.inverse_scale;
  d_mouth.x += d.x, d_mouth.y += d.y;
  d_mouth.speed2 += k.speed_spread * k.speed_spread * d_variance;
  back.d_landing.fallen += 2.0 * k.height_spread * k.height_spread * back.landing.fallen * d_variance;
}

template <class V>
static inline void back_filling(const SpillTables& tables, const SpillConstants& k, const Mouth<V>& mouth, V d_rho,
                                MouthSlope<V>& d_mouth) {
  const Filling<V> filling(tables, k, mouth);
  const V cube = filling.fill * filling.fill * filling.fill;
  const V d_fill = -d_rho * filling.rho * tables.power * cube * reciprocal(1.0 + cube * filling.fill);
  const V d_x = d_fill * (1.0 + filling.x * (2.0 + 5.1 * filling.x)) * (1.0 / tables.full),
          d_lean = d_x * (tables.rim / tables.depth);
  d_mouth.speed2 += d_lean * k.slosh * 0.5 * reciprocal(filling.speed);
  const V d_slope = where(filling.slope > tables.repose, d_lean, V{}), inverse_up = reciprocal(mouth.up);
  const V inverse_side = inverse_root(1.0051 - mouth.up * mouth.up);
  d_mouth.up -= d_slope * (inverse_side + filling.slope * inverse_up);
}

template <class V>
static inline V severest(const DropTables& drop, const Spill<V>& spill, const double* severity, V weight,
                         ReachedSlope<V>& reached) {
  V P[kMaxEntities], open[kMaxEntities], impact = {};
  for (int e = 0; e < drop.n_entity; ++e) P[e] = V{}, open[e] = weight * severity[e];
  for (int i = 0; i < drop.n_surface; ++i)
    if (drop.surface[i].entity >= 0)
      P[drop.surface[i].entity] = maximum(P[drop.surface[i].entity], spill.probability(i));
  for (int i = 0; i < drop.n_surface; ++i) {
    const int entity = drop.surface[i].entity;
    reached.fallen[i] = reached.flown[i] = reached.stood[i] = V{};
    if (entity < 0) continue;
    const auto greatest = spill.probability(i) == P[entity];
    const V d = where(greatest, open[entity], V{});
    open[entity] = where(greatest, V{}, open[entity]);
    reached.fallen[i] = d * (1.0 - spill.flown[i]) * (1.0 - spill.stood[i]);
    reached.flown[i] = d * (1.0 - spill.fallen[i]) * (1.0 - spill.stood[i]);
    reached.stood[i] = d * (1.0 - spill.fallen[i]) * (1.0 - spill.flown[i]);
  }
  for (int e = 0; e < drop.n_entity; ++e) impact += P[e] * severity[e];
  return impact;
}

// Contents that leave the container: the probability, the radius of their puddle, and the derivative with respect to
// it.
template <class V> struct Outflow {
  const SpillConstants& k;
  V weight, rho, d_rho = {};
};

// Returns the impact if contents leave; derivatives are those of the impact times its weight.
template <class V>
static inline V back_spill(Backward<V>& back, const Mouth<V>& mouth, Outflow<V>& out, const double* severity,
                           MouthSlope<V>& d_mouth) {
  const DropTables& drop = back.drop;
  Spill<V> spill(out.k);
  spill.run(drop, back.flight, back.landing, mouth, out.rho, severity);
  ReachedSlope<V> reached;
  const V impact = severest(drop, spill, severity, out.weight, reached);
  SpillSlope<V> d(drop);
  for (int i = 0; i < drop.n_surface; ++i)
    if (any(reached.stood[i] != 0.0)) back_standing(drop, spill, i, reached.stood[i], d);
  for (int l = 1; l < drop.n_level; ++l)
    d.lands[l] += d.lands[l - 1], d.land_x[l] += d.land_x[l - 1], d.land_y[l] += d.land_y[l - 1];
  FlowSlope<V> d_flow;
  for (int l = drop.n_level; l-- > 0;) {
    const LevelSlope<V> d_arrives = back_flow(drop, spill, l, reached, d_flow, d);
    back_arrive(back, mouth, spill, l, d_arrives, d_mouth);
  }
  back_blur(back, spill, d, d_mouth);
  out.d_rho = d.rho;
  return impact;
}

// Returns the derivative with respect to a small rotation of the object.
template <class V>
static inline Vec<V> back_pour(const Flight<V>& flight, const Mouth<V>& mouth, const MouthSlope<V>& d,
                               FlightSlope<V>& d_flight) {
  const Vec<V> d_u = {d.vx + 2.0 * d.speed2 * mouth.vx, d.vy + 2.0 * d.speed2 * mouth.vy, d.vz};
  const V d_z = d.up * mouth.up * inverse_root(mouth.axis.z * mouth.axis.z + 0.01);
  const Vec<V> swing = cross(mouth.o, d_u), pull = cross(d_u, flight.w);
  d_flight.c.x += d.x, d_flight.c.y += d.y;
  d_flight.v.x += d_u.x, d_flight.v.y += d_u.y, d_flight.v.z += d_u.z;
  d_flight.w.x += swing.x, d_flight.w.y += swing.y, d_flight.w.z += swing.z;
  const Vec<V> arm = cross(mouth.o, {d.x + pull.x, d.y + pull.y, pull.z}),
               tilt = cross(mouth.axis, {d.axis.x, d.axis.y, d_z + d.axis.z});
  return {arm.x + tilt.x, arm.y + tilt.y, arm.z + tilt.z};
}

}  // namespace gp::GP_ISA

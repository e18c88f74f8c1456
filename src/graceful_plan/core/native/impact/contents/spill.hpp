// The spill model: entities that contents reach after a drop, or when they leave the container in the gripper.
// costs/models/spill specifies the model and its letters. Shortcuts that save time are as in drop.hpp.
#pragma once
#include "cutoffs.hpp"
#include "impact/drop.hpp"
#include "impact/flight/flight.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// --- the container --------------------------------------------------------------------------------------------------

template <class V> struct Mouth {
  Vec<V> o, axis;      // o: from c to the mouth; the container's axis
  V x, y, vx, vy, vz;  // m and vm: place and velocity of the mouth
  V up, speed2;        // p: smooth upward component of the axis; sm2: squared horizontal speed
};

template <class V>
static inline void pour(const SpillTables& spill, const Frame<V>& X, const Flight<V>& flight, Mouth<V>& mouth) {
  mouth.o = rotate(X, spill.mouth), mouth.axis = rotate(X, spill.axis);
  const Vec<V> swing = cross(flight.w, mouth.o);
  mouth.x = flight.c.x + mouth.o.x, mouth.y = flight.c.y + mouth.o.y;
  mouth.vx = flight.v.x + swing.x, mouth.vy = flight.v.y + swing.y, mouth.vz = flight.v.z + swing.z;
  mouth.up = 0.5 * (mouth.axis.z + square_root(mouth.axis.z * mouth.axis.z + 0.01));
  mouth.speed2 = mouth.vx * mouth.vx + mouth.vy * mouth.vy;
}

// Fill level of a container, relative to its capacity at this tilt.
template <class V> struct Filling {
  V slope, lean, speed, x, fill, rho;

  Filling(const SpillTables& spill, const SpillConstants& k, const Mouth<V>& mouth) {
    slope = square_root(1.0051 - mouth.up * mouth.up) * reciprocal(mouth.up);
    speed = square_root(mouth.speed2 + 1e-4);
    lean = relu(slope - spill.repose) + k.slosh * speed;
    x = lean * (spill.rim / spill.depth);
    fill = (1.0 + x * (1.0 + x * (1.0 + 1.7 * x))) * (1.0 / spill.full);
    rho = spill.radius * exponential((-0.25 * spill.power) * logarithm(1.0 + fill * fill * fill * fill));
  }
};

// --- down the levels ------------------------------------------------------------------------------------------------

// P that a point is within half sizes of a surface's centre.
template <class V> static inline V upon(const Surface& s, V x, V y, V a, V b, V inverse_scale) {
  const Point2<V> at = placed(s, x, y);
  if (!any(may_be_within(at, a, b, inverse_scale))) return V{};
  Chance<V> chance;
  chance.within(at.x, a, inverse_scale);
  chance.within(at.y, b, inverse_scale);
  return chance.value();
}

template <class V> struct SpillLevel {
  V u, hard, arrives, x, y;  // q, a, L: P of a hard impact, P of arriving, places from m
  V flows, flow_x, flow_y;   // O, o: P that contents have run over an edge, and weighted place, above the level
  V past, over;              // g, h: P of running past the level, P of running over its edges
  V lands, land_x, land_y;   // U, W: P of landing on the level, and weighted place
};

template <class V> static inline V impact_speed(const Flight<V>& flight, double top) {
  const V h = flight.low - top;
  return square_root(flight.v.z * flight.v.z + kGravity * (h + square_root(h * h + 1e-4)));
}

template <class V> struct Spill {
  const SpillConstants& k;
  V x, y, inverse_scale, rho;  // m: place of the mouth
  double inner;                // ke R: distance to a surface's edges within which a puddle runs over
  SpillLevel<V> level[kMaxSurfaces];
  V sum[kMaxSurfaces + 1], sum_x[kMaxSurfaces + 1], sum_y[kMaxSurfaces + 1];  // sums of U and W over the levels above
  V fallen[kMaxSurfaces], flown[kMaxSurfaces], stood[kMaxSurfaces];  // A, B, D: P of reaching a surface by landing, by
                                                                     // flowing, by standing in the puddle

  explicit Spill(const SpillConstants& constants) : k(constants) {}

  // `radius`: of the puddle; `severity`: as in drop_probability.
  void run(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing, const Mouth<V>& mouth, V radius,
           const double* severity) {
    const SpillTables& spill = drop.spill;
    rho = radius;
    inner = spill.radius * k.edge;
    x = mouth.x, y = mouth.y;
    const V deep = k.height_spread * landing.fallen;
    const double still = k.position_spread * k.position_spread + k.rim_spread * spill.rim * k.rim_spread * spill.rim;
    inverse_scale = (1.0 / kBeta) * inverse_root(still + k.speed_spread * k.speed_spread * mouth.speed2 + deep * deep);
    V flows = {}, flow_x = {}, flow_y = {};
    sum[0] = sum_x[0] = sum_y[0] = V{};
    for (int l = 0; l < drop.n_level; ++l) {
      SpillLevel<V>& at = level[l];
      at.flows = flows, at.flow_x = flow_x, at.flow_y = flow_y;
      arrive(drop, flight, landing, mouth, l);
      flow_on(drop, l, severity);
      flows = minimum(flows * at.past + at.lands * at.over, V{} + 1.0);
      flow_x = flow_x * at.past + at.land_x * at.over, flow_y = flow_y * at.past + at.land_y * at.over;
      sum[l + 1] = sum[l] + at.lands, sum_x[l + 1] = sum_x[l] + at.land_x, sum_y[l + 1] = sum_y[l] + at.land_y;
    }
    for (int i = 0; i < drop.n_surface; ++i) stood[i] = wanted(drop, i, severity) ? standing(drop, i) : V{};
  }
  V probability(int i) const { return 1.0 - (1.0 - fallen[i]) * (1.0 - flown[i]) * (1.0 - stood[i]); }

  static bool wanted(const DropTables& drop, int i, const double* severity) {
    const int entity = drop.surface[i].entity;
    return entity >= 0 && !(severity && severity[entity] == 0.0);
  }
  bool is_wide(const Surface& s) const { return s.half[0] > inner && s.half[1] > inner; }

 private:
  void arrive(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing, const Mouth<V>& mouth,
              int l) {
    SpillLevel<V>& at = level[l];
    const int first = drop.level_start[l];
    at.u = impact_speed(flight, drop.surface[first].top);
    Chance<V> hard;
    hard.below((at.u - k.soft_speed) * (1.0 / k.soft_spread));
    at.hard = hard.value();
    at.arrives = probable(landing.leaving[l] + (landing.first[l] - landing.leaving[l]) * at.hard);
    const V time = landing.time[first] + k.carry;
    const V pushed = relu(time - flight.stop.time);
    at.x = mouth.vx * time + flight.stop.x * pushed, at.y = mouth.vy * time + flight.stop.y * pushed;
  }
  void flow_on(const DropTables& drop, int l, const double* severity) {
    SpillLevel<V>& at = level[l];
    const bool arrives = any(at.arrives > kNothing<V>), flows = any(at.flows > kNothing<V>);
    const V share = reciprocal(at.flows + kLeastMass), fx = at.flow_x * share, fy = at.flow_y * share,
            run = k.run_off * rho;
    at.past = at.over = V{} + 1.0;
    for (int i = drop.level_start[l]; i < drop.level_start[l + 1]; ++i) {
      const Surface& s = drop.surface[i];
      fallen[i] = flown[i] = V{};
      if (arrives && wanted(drop, i, severity))
        fallen[i] = at.arrives * upon(s, x + at.x, y + at.y, V{} + (s.half[0] + k.margin), V{} + (s.half[1] + k.margin),
                                      inverse_scale);
      if (!flows || drop.spill.surface[i].visible == 0.0) continue;
      const V onto =
          drop.spill.surface[i].visible * upon(s, x + fx, y + fy, s.half[0] + run, s.half[1] + run, inverse_scale);
      flown[i] = at.flows * onto;
      at.past *= 1.0 - onto;
    }
    const V stays = at.flows * (1.0 - at.past);
    at.lands = at.arrives + stays;
    at.land_x = at.arrives * at.x + stays * fx, at.land_y = at.arrives * at.y + stays * fy;
    if (!any(at.lands > kNothing<V>)) return;
    const V landed = reciprocal(at.lands + kLeastMass), px = x + at.land_x * landed, py = y + at.land_y * landed;
    for (int i = drop.level_start[l]; i < drop.level_start[l + 1]; ++i) {
      const Surface& s = drop.surface[i];
      if (is_wide(s))
        at.over *= 1.0 - upon(s, px, py, V{} + (s.half[0] - inner), V{} + (s.half[1] - inner), inverse_scale);
    }
  }
  V standing(const DropTables& drop, int i) const {
    const SpillSurface& stands = drop.spill.surface[i];
    const Surface& s = drop.surface[i];
    const V U = sum[stands.end] - sum[stands.first];
    if (!any(U > kNothing<V>)) return V{};
    const V share = reciprocal(U + kLeastMass), reach = k.reach * rho;
    const V px = (sum_x[stands.end] - sum_x[stands.first]) * share,
            py = (sum_y[stands.end] - sum_y[stands.first]) * share;
    return minimum(U, V{} + 1.0) * upon(s, x + px, y + py, s.half[0] + reach, s.half[1] + reach, inverse_scale);
  }
};

}  // namespace gp::GP_ISA

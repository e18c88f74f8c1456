// The drop model: entities that the carried object hits if it is released in this state. flight.hpp is the step before.
// Letters as in the specification, the docstring of costs/models/drop.
#pragma once
#include "cutoffs.hpp"
#include "geometry/kinematics.hpp"
#include "impact/flight/flight.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// --- 1. first contact -----------------------------------------------------------------------------------------------

// Extents of each part along the axes of a surface (x, y) and its diagonals (left, right), cached for surfaces with the
// same axes.
template <class V> struct Reaches {
  int turn = -1;
  struct {
    V x, y, left, right;
  } part[kMaxDropParts];

  void turn_to(const DropTables& drop, const Flight<V>& flight, const Surface& s) {
    if (turn == s.turn) return;
    turn = s.turn;
    for (int p = 0; p < drop.n_part; ++p) {
      const V* Q = flight.part[p].axis;
      V x[3], y[3], left[3], right[3];
      for (int i = 0; i < 3; ++i) {
        x[i] = Q[i] * s.axis[0] + Q[3 + i] * s.axis[1], y[i] = Q[3 + i] * s.axis[0] - Q[i] * s.axis[1];
        left[i] = (x[i] + y[i]) * kHalfRoot, right[i] = (y[i] - x[i]) * kHalfRoot;
      }
      part[p] = {reach(drop.part[p], x), reach(drop.part[p], y), reach(drop.part[p], left), reach(drop.part[p], right)};
    }
  }
};

// The object at the time when it passes the height of a surface's top.
template <class V> struct Passage {
  double top = __builtin_inf();
  V time = {};                  // of the lowest part, including the delay of the release
  V x = {}, y = {}, near = {};  // of the centre of mass; near: radius around it within which the object may be
  bool detailed = false;
  struct {
    V x, y, inverse_scale, passes;  // of each part at that height; passes: 1 + e^.. of the gate for starting above the
                                    // top
    decltype(V{} > V{}) above;

    // Whether the part may be within half sizes a, b of a place in a surface's axes, in any lane.
    bool may_meet(const Point2<V>& at, V a, V b) const { return any(may_be_within(at, a, b, inverse_scale) & above); }
  } part[kMaxDropParts];

  void move_to(const DropTables& drop, const Flight<V>& flight, double height) {
    if (top == height) return;
    top = height, detailed = false;
    const DropConstants& k = drop.constants;
    const V falling = fall(flight.v.z, flight.low - top);
    time = falling + k.delay;
    const Point2<V> centre = travelled(flight, time);
    x = centre.x, y = centre.y;
    const V late = falling + flight.late;
    near = drop.radius * (1.0 + flight.turn_speed * (late + k.delay)) + flight.speed * flight.late +
           kTail<V> * kBeta * (k.position_spread + k.velocity_spread * late);
    near *= 1.4142135623730951;  // the margin along the axes of W covers a margin along the surface's axes
    near = where(flight.highest_bottom - top > kAbove<V>, near, V{} - 1e9);
  }
  void detail(const DropTables& drop, const Flight<V>& flight) {
    if (detailed) return;
    const DropConstants& k = drop.constants;
    for (int p = 0; p < drop.n_part; ++p) {
      const FlyingPart<V>& flying = flight.part[p];
      const V h = flying.bottom - top, t = fall(flight.v.z, h), spread = k.velocity_spread * t;
      part[p].inverse_scale = (1.0 / kBeta) * inverse_root(k.position_spread * k.position_spread + spread * spread);
      const V pushed = relu(t + k.delay - flight.stop.time);
      part[p].x = flight.c.x + flying.o.x + flying.u.x * (t + k.delay) + flight.stop.x * pushed;
      part[p].y = flight.c.y + flying.o.y + flying.u.y * (t + k.delay) + flight.stop.y * pushed;
      Chance<V> gate;
      gate.below(h * (1.0 / kTouch) + 1.0);
      part[p].passes = gate.under;
      part[p].above = h > kAbove<V>;
    }
    detailed = true;
  }
};

template <class V> static inline bool may_meet(const Surface& s, const Passage<V>& passage) {
  return any((absolute(passage.x - s.centre[0]) < s.bound[0] + passage.near) &
             (absolute(passage.y - s.centre[1]) < s.bound[1] + passage.near));
}

// D: P that the object overlaps a surface, seen from above, when it passes the height of the top; `foremost`: the part
// that determines D.
template <class V>
static inline V overlap(const DropTables& drop, const Flight<V>& flight, const Surface& s, Passage<V>& passage,
                        Reaches<V>& reaches, V& foremost) {
  V best = {};
  foremost = V{} - 1.0;
  if (!may_meet(s, passage)) return best;
  passage.detail(drop, flight);
  reaches.turn_to(drop, flight, s);
  for (int p = 0; p < drop.n_part; ++p) {
    const auto& part = passage.part[p];
    const auto& r = reaches.part[p];
    const Point2<V> at = placed(s, part.x, part.y);
    const V a = s.half[0] + r.x, b = s.half[1] + r.y;
    if (!part.may_meet(at, a, b)) continue;
    Chance<V> chance;
    chance.within(at.x, a, part.inverse_scale);
    chance.within(at.y, b, part.inverse_scale);
    chance.within((at.x + at.y) * kHalfRoot, s.diagonal + r.left, part.inverse_scale);
    chance.within((at.y - at.x) * kHalfRoot, s.diagonal + r.right, part.inverse_scale);
    chance.under *= part.passes;
    const V value = chance.value();
    foremost = where(value > best, V{} + double(p), foremost);
    best = maximum(best, value);
  }
  return best;
}

// --- 2. support -----------------------------------------------------------------------------------------------------

// Moments of the ground contact's area, relative to the centre of mass, in W.
template <class V> struct Moments {
  V area = {}, x = {}, y = {}, xx = {}, yy = {}, xy = {};

  // Adds the ground contact of the parts that a surface supports; `at`: the centre of mass in the surface's axes.
  void add(const DropTables& drop, const Flight<V>& flight, const Surface& s, const Point2<V>& at,
           Reaches<V>& reaches) {
    if (!any((absolute(at.x) < s.carries[0] + drop.radius) & (absolute(at.y) < s.carries[1] + drop.radius))) return;
    reaches.turn_to(drop, flight, s);
    for (int p = 0; p < drop.n_part; ++p) {
      const FlyingPart<V>& part = flight.part[p];
      const auto& r = reaches.part[p];
      const Point2<V> o = turned(s, part.o.x, part.o.y);
      const V x0 = maximum(o.x - r.x, -s.carries[0] - at.x), x1 = minimum(o.x + r.x, s.carries[0] - at.x);
      const V y0 = maximum(o.y - r.y, -s.carries[1] - at.y), y1 = minimum(o.y + r.y, s.carries[1] - at.y);
      const V wx = relu(x1 - x0), wy = relu(y1 - y0), patch = part.stands * wx * wy;
      add_patch(s, patch, 0.5 * (x0 + x1), 0.5 * (y0 + y1), wx * wx * (1.0 / 12), wy * wy * (1.0 / 12));
    }
  }

 private:
  void add_patch(const Surface& s, V patch, V mx, V my, V qx, V qy) {
    const double c = s.axis[0], n = s.axis[1];
    const V ux = c * mx - n * my, uy = n * mx + c * my;
    area += patch, x += patch * ux, y += patch * uy;
    xx += patch * (ux * ux + c * c * qx + n * n * qy);
    yy += patch * (uy * uy + n * n * qx + c * c * qy);
    xy += patch * (ux * uy + c * n * (qx - qy));
  }
};

// T: P that the object leaves the surfaces that support it; away: n, the direction in which it leaves.
template <class V>
static inline V leaves(const DropTables& drop, const Flight<V>& flight, const Moments<V>& m, Point2<V>& away) {
  const DropConstants& k = drop.constants;
  const V share = reciprocal(m.area + 1e-6), ex = m.x * share, ey = m.y * share;
  const V xx = m.xx * share - ex * ex + 1e-5, yy = m.yy * share - ey * ey + 1e-5, xy = m.xy * share - ex * ey;
  const V det = maximum(xx * yy - xy * xy, V{} + 1e-11);
  const V d2 = (yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey) * reciprocal(det), off = d2 * reciprocal(3.0 + d2);
  const V height = flight.c.z - flight.low, distance = -off * inverse_root(ex * ex + ey * ey + 1e-6);
  away = {distance * ex, distance * ey};
  const V u = k.leave + 2.0 * k.leave_offset * (off - 0.5) + k.leave_speed * flight.speed +
              2.0 * k.leave_tilt * flight.tilt +
              0.5 * k.leave_narrow * logarithm((height * height + 1e-6) * (xx + yy) * reciprocal(3.0 * det));
  Chance<V> chance;
  chance.below(u);
  return chance.value();
}

// --- steps 1 and 2 for all levels -----------------------------------------------------------------------------------

template <class V> struct Landing {
  V overlap[kMaxSurfaces], contact[kMaxSurfaces], time[kMaxSurfaces];  // D, C, tc: overlap, share of the first contact,
                                                                       // time of contact
  V foremost[kMaxSurfaces];                                            // the part that determines D
  V arrives[kMaxSurfaces], first[kMaxSurfaces], leaving[kMaxSurfaces];  // per level: A (P of arriving), sum of F (first
                                                                        // impacts), M (P of impact and leaving)
  V share[kMaxSurfaces], leaves[kMaxSurfaces];                          // per level: F/D, T
  Point2<V> away[kMaxSurfaces];                                         // per level: n
  V landed, total, mean_time, height, fallen;  // sum of F, total = that + 1e-6, tl, zs, hs: mean time, height and depth
                                               // of the fall
  V x, y;                                      // L, the place of landing
  V blur;                                      // variance of the place of landing
};

// The centre of mass at a time, in the axes of a surface.
template <class V> static inline Point2<V> passing(const Flight<V>& flight, const Surface& s, V time) {
  const Point2<V> at = travelled(flight, time);
  return placed(s, at.x, at.y);
}

// Over the surfaces of a level: the sum of D, and the product of 1 - D.
template <class V> struct LevelContacts {
  V sum = {}, missed = V{} + 1.0;
};

// Computes D of the surfaces of a level.
template <class V>
static inline LevelContacts<V> meet_level(const DropTables& drop, const Flight<V>& flight, int level,
                                          Passage<V>& passage, Reaches<V>& reaches, Landing<V>& landing) {
  LevelContacts<V> met;
  const bool arrives = any(landing.arrives[level] > kNothing<V>);
  for (int k = drop.level_start[level]; k < drop.level_start[level + 1]; ++k) {
    const Surface& s = drop.surface[k];
    passage.move_to(drop, flight, s.top);
    landing.time[k] = passage.time;
    const V overlaps = arrives ? overlap(drop, flight, s, passage, reaches, landing.foremost[k]) : V{};
    landing.overlap[k] = landing.contact[k] = overlaps;
    met.sum += overlaps, met.missed *= 1.0 - overlaps;
  }
  return met;
}

template <class V> static inline void land(const DropTables& drop, const Flight<V>& flight, Landing<V>& landing) {
  const DropConstants& c = drop.constants;
  Passage<V> passage;
  Reaches<V> reaches;
  V arrives = V{} + 1.0, sum_time = {}, sum_height = {}, sum_fallen = {};
  landing.landed = V{};
  for (int l = 0; l < drop.n_level; ++l) {
    landing.arrives[l] = arrives;
    const auto [sum, missed] = meet_level(drop, flight, l, passage, reaches, landing);
    const V first = arrives * (1.0 - missed), share = first * reciprocal(sum + kLeastMass);
    landing.first[l] = landing.leaving[l] = landing.leaves[l] = V{}, landing.away[l] = {V{}, V{}};
    landing.share[l] = share;
    if (!any(sum > 0.0)) continue;
    const bool lands = any(first > kNothing<V>);
    Moments<V> moments;
    for (int k = drop.level_start[l]; k < drop.level_start[l + 1]; ++k) {
      const Surface& s = drop.surface[k];
      const V F = share * landing.contact[k], time = landing.time[k];
      landing.contact[k] *= arrives;
      landing.first[l] += F, sum_time += F * time, sum_height += F * s.top, sum_fallen += F * relu(flight.low - s.top);
      if (lands) moments.add(drop, flight, s, passing(flight, s, time), reaches);
    }
    arrives *= missed;
    landing.landed += landing.first[l];
    if (!lands) continue;
    landing.leaves[l] = leaves(drop, flight, moments, landing.away[l]);
    landing.leaving[l] = landing.first[l] * landing.leaves[l];
  }
  landing.landed = minimum(landing.landed, V{} + 1.0);
  landing.total = landing.landed + kLeastMass;
  const V share = reciprocal(landing.total);
  landing.mean_time = sum_time * share, landing.height = sum_height * share, landing.fallen = sum_fallen * share;
  const Point2<V> place = travelled(flight, landing.mean_time);
  landing.x = place.x, landing.y = place.y;
  const V late = c.velocity_spread * landing.mean_time, deep = c.height_spread * landing.fallen;
  landing.blur = c.position_spread * c.position_spread + late * late + deep * deep;
}

// From the state at the release to the first contact.
template <class V> struct Fall {
  Frame<V> X_W[kMaxLinks];
  Flight<V> flight;
  Landing<V> landing;

  Fall(const Tables& tables, const DropTables& drop, const V* q, const V* qd) {
    forward_kinematics(tables, q, X_W);
    release(tables, drop, X_W, qd, flight);
    find_stop(drop, flight);
    land(drop, flight, landing);
  }
};

// --- 3. falls onto lower surfaces -----------------------------------------------------------------------------------

template <class V> struct Tumble {
  V mass = {};                   // B: P that the object is falling
  Point2<V> drift = {V{}, V{}};  // N: sum of n M, weighted direction
  V inverse_scale;
  Point2<V> start;           // L + ks v
  V x, y;                    // its place on the present level
  V keep = {}, caught = {};  // shares of B: not stopped by the surfaces visited on the level; stopped by the last one
  V falls = {};              // f: share of the mass that leaves the present level's support beyond the level's edges

  Tumble(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing) {
    const DropConstants& k = drop.constants;
    const double tumbling = k.size_spread * drop.size;
    const V v2 = flight.v.x * flight.v.x + flight.v.y * flight.v.y;
    inverse_scale =
        (1.0 / kBeta) * inverse_root(landing.blur + tumbling * tumbling + k.carry_spread * k.carry_spread * v2);
    start = travelled(flight, landing.mean_time + k.carry);
  }
  bool enter(const DropTables& drop) {
    keep = V{} + 1.0;
    if (!any(mass > kNothing<V>)) return false;
    const V moved = drop.constants.drift * drop.size * reciprocal(mass + kLeastMass);
    x = start.x + drift.x * moved, y = start.y + drift.y * moved;
    return true;
  }
  // Whether the object may reach a surface from a place in its axes.
  bool may_meet(const Surface& s, const Point2<V>& at) const {
    return any(may_be_within(at, s.near[0], s.near[1], inverse_scale));
  }
  // G/B, if wanted: P of hitting the surface; also updates `caught` and `keep`.
  V hit(const Surface& s, bool wanted) {
    const Point2<V> at = placed(s, x, y);
    caught = V{};
    if (!may_meet(s, at)) return V{};
    Chance<V> hits;
    if (wanted) hits.within(at.x, V{} + s.reached[0], inverse_scale);
    if (wanted) hits.within(at.y, V{} + s.reached[1], inverse_scale);
    caught = keep * holds(s, at);
    keep -= caught;
    return mass * hits.value();
  }
  // The place on a level's top of an object that has left its support there.
  Point2<V> beside(const DropTables& drop, const Point2<V>& away) const {
    const double moved = drop.constants.drift * drop.size;
    return {start.x + moved * away.x, start.y + moved * away.y};
  }
  // P that a surface ends the fall of an object at a place in its axes.
  V holds(const Surface& s, const Point2<V>& at) const {
    Chance<V> ends;
    ends.within(at.x, V{} + s.inside[0], inverse_scale);
    ends.within(at.y, V{} + s.inside[1], inverse_scale);
    return s.catches * ends.value();
  }
  // Adds the mass that falls from a level; call it after the level's last surface.
  void leave(const DropTables& drop, const Landing<V>& landing, int level) {
    const V leaving = landing.leaving[level];
    falls = V{} + 1.0;
    if (any(leaving > kNothing<V>)) {
      const Point2<V> place = beside(drop, landing.away[level]);
      for (int k = drop.level_start[level]; k < drop.level_start[level + 1]; ++k) {
        const Point2<V> at = placed(drop.surface[k], place.x, place.y);
        if (may_meet(drop.surface[k], at)) falls *= 1.0 - holds(drop.surface[k], at);
      }
    }
    const V M = leaving * falls;
    mass = minimum(mass * keep + M, V{} + 1.0);
    drift = {drift.x * keep + M * landing.away[level].x, drift.y * keep + M * landing.away[level].y};
  }
};

// --- 4. side contacts -----------------------------------------------------------------------------------------------

// P that the object leaves its first support, given that it has landed, and the mean direction.
template <class V> struct Leaving {
  V probability = {}, x = {}, y = {}, share;

  Leaving(const DropTables& drop, const Landing<V>& landing) : share(reciprocal(landing.total)) {
    for (int l = 0; l < drop.n_level; ++l) {
      probability += landing.leaving[l];
      x += landing.leaving[l] * landing.away[l].x, y += landing.leaving[l] * landing.away[l].y;
    }
    probability *= share, x *= share, y *= share;
  }
};

template <class V> struct Sweep {
  V x, y, reach, inverse_scale, top;

  Sweep(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing) {
    const DropConstants& k = drop.constants;
    const Leaving<V> leaving(drop, landing);
    const Point2<V> slid = travelled(flight, landing.mean_time + k.slide);
    x = slid.x + k.drift * drop.size * leaving.x, y = slid.y + k.drift * drop.size * leaving.y;
    const double resting = k.side_spread * drop.size;
    const V toppling = k.size_spread * drop.size * leaving.probability;
    inverse_scale = (1.0 / kBeta) * inverse_root(landing.blur + resting * resting + toppling * toppling);
    reach = (k.side_reach + k.topple_reach * leaving.probability) * drop.size;
    top = landing.height + flight.high - flight.low;
  }
  // H: P of hitting the surface from the side; beside: P that the object lands beside it.
  V hit(const DropTables& drop, const Flight<V>& flight, const Surface& s, V time, V beside) const {
    const V over = (top - s.bottom) * (1.0 / drop.constants.side_height);
    const Point2<V> from = passing(flight, s, time), to = placed(s, x, y);
    const V mx = 0.5 * (from.x + to.x), my = 0.5 * (from.y + to.y), dx = to.x - from.x, dy = to.y - from.y;
    const V a = s.half[0] + reach, b = s.half[1] + reach;
    const auto near_x = (absolute(mx) - relu(a + 0.5 * absolute(dx)) - 1e-3) * inverse_scale < kTail<V>;
    const auto near_y = (absolute(my) - relu(b + 0.5 * absolute(dy)) - 1e-3) * inverse_scale < kTail<V>;
    if (!any(near_x & near_y & (over > -kTail<V> * kBeta) & (beside > kNothing<V>))) return V{};
    Chance<V> chance;
    chance.below(over);
    chance.within(mx, a + 0.5 * square_root(dx * dx + 1e-6), inverse_scale);
    chance.within(my, b + 0.5 * square_root(dy * dy + 1e-6), inverse_scale);
    return beside * chance.value();
  }
};

// P that the object hits the side in its way before it lands (step 0).
template <class V> struct SideImpact {
  V before, value;

  SideImpact(const Flight<V>& flight, const Landing<V>& landing) {
    before = value = V{};
    if (!any(flight.stop.chance > 0.0)) return;
    before = Step<V>((landing.mean_time - flight.stop.time) * (1.0 / kSideLate)).value;
    value = probable(flight.stop.chance * (1.0 - landing.landed * (1.0 - before)));
  }
  // The value for one surface.
  V on(const Flight<V>& flight, int surface) const { return where(flight.stop.is_of(surface), value, V{}); }
};

}  // namespace gp::GP_ISA

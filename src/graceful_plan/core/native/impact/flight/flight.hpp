// The drop model, first part: the state of the carried object at its release, and its flight up to a side in the way.
// costs/models/drop specifies the model and its letters. V: lanes of double precision (D) or Single.
#pragma once
#include "cutoffs.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

constexpr double kBeta = 0.55132889542179209;  // scale of a logistic distribution with standard deviation 1: sqrt(3)/pi
constexpr double kHalfRoot = 0.70710678118654752440;  // sqrt(1/2)
constexpr double kTouch = 0.008;  // smoothing width for passing the height of a top (step 1 of the specification) [m]
template <class V>
constexpr double kAbove = -kTouch * (1.0 + kTail<V> * kBeta);  // parts that start lower do not land on a top [m]
constexpr double kLeastMass = 1e-6;                            // added to probabilities that are divided by

// --- functions ------------------------------------------------------------------------------------------------------

template <class V> struct Point2 {
  V x, y;
};

template <class V> static inline Point2<V> turned(const Surface& s, V x, V y) {
  return {s.axis[0] * x + s.axis[1] * y, s.axis[0] * y - s.axis[1] * x};
}
template <class V> static inline Point2<V> placed(const Surface& s, V x, V y) {
  return turned(s, x - s.centre[0], y - s.centre[1]);
}

// The lanes in which a noisy point may be within half sizes of a centre, given its place in their axes.
template <class V, class A>
static inline auto may_be_within(const Point2<V>& at, const A& a, const A& b, V inverse_scale) {
  return ((absolute(at.x) - a) * inverse_scale < kTail<V>)&((absolute(at.y) - b) * inverse_scale < kTail<V>);
}

// e^x, clamped from below where it is negligible in a probability.
template <class V> static inline V tail(V x) { return exponential(maximum(x, V{} - kHeld<V>)); }
template <class V> static inline V odds(V x) { return tail(minimum(x, V{} + kHeld<V>)); }

// A probability without its rounding error.
template <class V> static inline V probable(V p) { return minimum(maximum(p, V{}), V{} + 1.0); }

// A product of probabilities with a single division; no factor of `under` is below 1.
template <class V> struct Chance {
  V over = V{} + 1.0, under = V{} + 1.0;

  // P(|x + noise| < A), for logistic noise of the given scale.
  [[gnu::always_inline]] void within(V x, V A, V inverse_scale) {
    A = maximum(A, V{} + 1e-4);
    const V inside = (A - absolute(x)) * inverse_scale;
    if (!any(inside < kTail<V>)) return;  // certain, as over the ground or large tables
    const V f = odds(-inside), h = tail(-(absolute(x) + A) * inverse_scale);
    over *= 1.0 - f * h;
    under *= (1.0 + f) * (1.0 + h);
  }
  // P(noise < u), for noise of standard deviation 1.
  void below(V u) { under *= 1.0 + odds(u * (-1.0 / kBeta)); }
  // Rounding must not lead out of 0 to 1: a product of differences to 1 would then change its sign.
  V value() const { return probable(over * reciprocal(under)); }
};

template <class V> static inline V fall(V vz, V h) {
  const V k = 0.5 * (h + square_root(h * h + 1e-4));
  return (vz + square_root(vz * vz + 2.0 * kGravity * k)) * (1.0 / kGravity);
}

// --- the state at release -------------------------------------------------------------------------------------------

template <class V> struct FlyingPart {
  Vec<V> o, u;        // o: from c to the part's centre; u: velocity of that centre
  V axis[9], bottom;  // rotation Q, lowest point
  V stands;           // the part's weight in the ground contact
};

// Effect of the first side in the way on the flight.
template <class V> struct SideStop {
  V time = {}, x = {}, y = {}, chance = {};  // ts, p, E: time, loss of velocity, P of hitting the side
  V side = V{} - 1.0;                        // 2 * surface for a side across its x axis, one more for its y axis
  V effect = {};

  // Whether the side belongs to a surface.
  auto is_of(int surface) const { return (side == double(2 * surface)) | (side == double(2 * surface + 1)); }
};

template <class V> struct Flight {
  Vec<V> c, v, w;  // centre of mass, its velocity, angular velocity
  SideStop<V> stop;
  FlyingPart<V> part[kMaxDropParts];
  V low, high, highest_bottom, tilt, speed;  // lowest and highest point; highest of the parts' lowest points
  V turn_speed, late;                        // |w|, and the largest delay of another part after the lowest one
};

// Extent of a part in a direction, given as components d along the part's axes.
template <class V> static inline V reach(const DropPart& part, const V d[3]) {
  if (part.shape == kBall) return V{} + part.half[0];
  if (part.shape == kFlat)
    return absolute(d[0]) * part.half[0] + absolute(d[1]) * part.half[1] + absolute(d[2]) * part.half[2];
  return absolute(d[2]) * part.half[2] + part.half[0] * square_root(maximum(1.0 - d[2] * d[2], V{} + 1e-12));
}

template <class V> static inline V tilt_of(int shape, const V axis[9]) {
  if (shape == kBall) return V{};
  const V a = axis[6] * axis[6], b = axis[7] * axis[7], c = axis[8] * axis[8];
  return 1.0 - (shape == kRound ? (a + b) * (a + b) + c * c : a * a + b * b + c * c);
}

template <class V>
static inline void add_joint_velocities(const Tables& tables, int link, const Frame<V>* X_W, const V* qd,
                                        Flight<V>& flight) {
  for (int l = link; l >= 0; l = tables.link[l].parent) {
    const Link& joint = tables.link[l];
    if (joint.joint < 0) continue;
    const Frame<V>& X = X_W[l];
    const V rate = qd[joint.joint];
    const Vec<V> z = {X.R[2] * rate, X.R[5] * rate, X.R[8] * rate};
    Vec<V> u = z;
    if (!joint.slide) {
      u = cross(z, {flight.c.x - X.p.x, flight.c.y - X.p.y, flight.c.z - X.p.z});
      flight.w.x += z.x, flight.w.y += z.y, flight.w.z += z.z;
    }
    flight.v.x += u.x, flight.v.y += u.y, flight.v.z += u.z;
  }
}

template <class V>
static inline void place_part(const DropPart& part, const Frame<V>& X, const Flight<V>& flight, FlyingPart<V>& flying) {
  flying.o = rotate(X, part.offset);
  const Vec<V> swing = cross(flight.w, flying.o);
  flying.u = {flight.v.x + swing.x, flight.v.y + swing.y, flight.v.z + swing.z};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      flying.axis[3 * i + j] = X.R[3 * i] * part.R[j] + X.R[3 * i + 1] * part.R[3 + j] + X.R[3 * i + 2] * part.R[6 + j];
}

template <class V>
static inline void release(const Tables& tables, const DropTables& drop, const Frame<V>* X_W, const V* qd,
                           Flight<V>& flight) {
  const Frame<V>& X = X_W[drop.frame];
  flight.c = transform(X, drop.centre);
  flight.v = flight.w = {V{}, V{}, V{}};
  if (qd) add_joint_velocities(tables, drop.link, X_W, qd, flight);
  flight.low = V{} + 1e9, flight.high = flight.highest_bottom = V{} - 1e9;
  for (int p = 0; p < drop.n_part; ++p) {
    FlyingPart<V>& part = flight.part[p];
    place_part(drop.part[p], X, flight, part);
    const V up = reach(drop.part[p], part.axis + 6), z = flight.c.z + part.o.z;
    part.bottom = z - up;
    flight.low = minimum(flight.low, part.bottom), flight.high = maximum(flight.high, z + up);
    flight.highest_bottom = maximum(flight.highest_bottom, part.bottom);
  }
  for (int p = 0; p < drop.n_part; ++p) {
    const V above = (flight.part[p].bottom - flight.low) * (1.0 / 0.012);
    flight.part[p].stands = exponential(maximum(-above * above, V{} - 60.0));
  }
  flight.tilt = tilt_of(drop.part[drop.main].shape, flight.part[drop.main].axis);
  flight.speed = square_root(flight.v.x * flight.v.x + flight.v.y * flight.v.y + 1e-4);
  flight.turn_speed = square_root(flight.w.x * flight.w.x + flight.w.y * flight.w.y + flight.w.z * flight.w.z + 1e-12);
  // All heights differ by less, and sqrt(a + b) <= sqrt(a) + sqrt(b).
  flight.late = square_root((flight.highest_bottom - flight.low) * (2.0 / kGravity) + 1e-12);
}

// Place of the centre of mass at a time after the release.
template <class V> static inline Point2<V> travelled(const Flight<V>& flight, V time) {
  const V pushed = relu(time - flight.stop.time);
  return {flight.c.x + flight.v.x * time + flight.stop.x * pushed,
          flight.c.y + flight.v.y * time + flight.stop.y * pushed};
}

// --- 0. sides in the way --------------------------------------------------------------------------------------------

constexpr double kSideTouch = 0.006;  // smoothing width for being in front of a side instead of above its surface [m]
constexpr double kSideTop =
    0.067;  // smoothing width for being below the upper edge of a side and above the lower one [m]
constexpr double kSideWidth = 2.2360679774997896;  // width of a step over noise of standard deviation 1: sqrt(5)
constexpr double kSideLate = 0.067;                // smoothing width for reaching a side before landing [s]
constexpr double kSideAfter = 0.15;                // time after landing in which a side may still be hit [s]
constexpr double kSideSlow = 1e-3;                 // lower bound of speeds towards a side [m/s]
constexpr double kSideMoves = 0.1;                 // speed that fully counts as flying towards a side [m/s]

// A smooth step from 0 at x = -1 to 1 at x = 1, and its derivative.
template <class V> struct Step {
  V value, slope;

  explicit Step(V x) {
    const V t = minimum(relu(0.5 + 0.5 * x), V{} + 1.0);
    value = t * t * (3.0 - 2.0 * t), slope = 3.0 * t * (1.0 - t);
  }
};

// Extent of the whole object from its centre of mass, along a surface's axes.
template <class V> struct Extents {
  int turn = -1;
  V low[2], high[2];
  V lowest[2], highest[2];  // the parts with these extents

  void turn_to(const DropTables& drop, const Flight<V>& flight, const Surface& s) {
    if (turn == s.turn) return;
    turn = s.turn;
    for (int i = 0; i < 2; ++i) {
      low[i] = V{} + 1e9, high[i] = V{} - 1e9, lowest[i] = highest[i] = V{};
      for (int p = 0; p < drop.n_part; ++p) {
        const V o = along(s, i, flight.part[p].o), r = part_reach(drop, flight, s, p, i);
        const auto lower = o - r<low[i], higher = o + r> high[i];
        low[i] = where(lower, o - r, low[i]), lowest[i] = where(lower, V{} + double(p), lowest[i]);
        high[i] = where(higher, o + r, high[i]), highest[i] = where(higher, V{} + double(p), highest[i]);
      }
    }
  }
  static double axis_x(const Surface& s, int i) { return i ? -s.axis[1] : s.axis[0]; }
  static double axis_y(const Surface& s, int i) { return i ? s.axis[0] : s.axis[1]; }
  static V along(const Surface& s, int i, const Vec<V>& v) { return axis_x(s, i) * v.x + axis_y(s, i) * v.y; }
  static V part_reach(const DropTables& drop, const Flight<V>& flight, const Surface& s, int p, int i) {
    const V* Q = flight.part[p].axis;
    V d[3];
    for (int j = 0; j < 3; ++j) d[j] = Q[j] * axis_x(s, i) + Q[3 + j] * axis_y(s, i);
    return reach(drop.part[p], d);
  }
};

// How the object hits that side of a surface across its axis i towards which it flies.
template <class V> struct SideApproach {
  V gap, speed, time;
  V across, half, inverse_width, falls, height;  // computed by detail() if a hit is possible

  SideApproach(const Surface& s, const Extents<V>& extents, int i, const V at[2], const V v[2]) {
    gap = where(v[i] < 0.0, at[i] + extents.low[i], -at[i] - extents.high[i]) - s.half[i];
    speed = maximum(absolute(v[i]), V{} + kSideSlow);
    time = relu(gap) * reciprocal(speed);
  }
  auto in_time(V end) const { return (gap > -2.0 * kSideTouch) & (time < end); }
  void detail(const DropTables& drop, const Flight<V>& flight, const Surface& s, const Extents<V>& extents, int i,
              const V at[2], const V v[2]) {
    const DropConstants& k = drop.constants;
    across = at[1 - i] + v[1 - i] * time + 0.5 * (extents.low[1 - i] + extents.high[1 - i]);
    half = s.half[1 - i] + 0.5 * (extents.high[1 - i] - extents.low[1 - i]);
    const V spread = k.velocity_spread * time;
    inverse_width = (1.0 / kSideWidth) * inverse_root(k.position_spread * k.position_spread + spread * spread);
    falls = relu(time - k.delay);
    height = flight.low + flight.v.z * falls - (0.5 * kGravity) * falls * falls;
  }
  Step<V> in_front() const { return Step<V>(gap * (1.0 / kSideTouch) + 1.0); }
  Step<V> beside() const { return Step<V>((half - absolute(across)) * inverse_width); }
  Step<V> below(const Surface& s) const { return Step<V>((s.top - height) * (1.0 / kSideTop)); }
  Step<V> above(const Flight<V>& flight, const Surface& s) const {
    return Step<V>((height + flight.high - flight.low - s.bottom) * (1.0 / kSideTop) - 1.0);
  }
  Step<V> moves(V v) const { return Step<V>(absolute(v) * (2.0 / kSideMoves) - 1.0); }
  V chance(const Flight<V>& flight, const Surface& s, V v) const {
    return in_front().value * beside().value * below(s).value * above(flight, s).value * moves(v).value;
  }
};

template <class V> static inline void find_stop(const DropTables& drop, Flight<V>& flight) {
  if (!drop.n_surface) return;
  SideStop<V>& stop = flight.stop;
  const DropConstants& k = drop.constants;
  const V end = fall(flight.v.z, flight.low - drop.surface[drop.n_surface - 1].top) + (k.delay + kSideAfter);
  const V margin = drop.radius + kSideWidth * (k.position_spread + k.velocity_spread * end);
  // Bounds of the rest of the flight: its middle, and the distances from it within which a side may be hit.
  const V ahead_x = 0.5 * flight.v.x * end, ahead_y = 0.5 * flight.v.y * end;
  const V x = flight.c.x + ahead_x, y = flight.c.y + ahead_y;
  const V far_x = absolute(ahead_x) + margin, far_y = absolute(ahead_y) + margin;
  const double deep = drop.radius + 2.0 * kSideTouch;
  Extents<V> extents;
  for (int n = 0; n < drop.n_surface; ++n) {
    const Surface& s = drop.surface[n];
    if (!s.fixed) continue;
    if (!any((absolute(x - s.centre[0]) < s.bound[0] + far_x) & (absolute(y - s.centre[1]) < s.bound[1] + far_y)))
      continue;
    const Point2<V> from = placed(s, flight.c.x, flight.c.y), by = turned(s, flight.v.x, flight.v.y);
    const V at[2] = {from.x, from.y}, v[2] = {by.x, by.y};
    const auto comes = [&](int i) {
      const V away = where(v[i] < 0.0, at[i], -at[i]) - s.half[i];
      return (away > -deep) & (away - drop.radius < absolute(v[i]) * end);
    };
    if (!any(comes(0) | comes(1))) continue;
    extents.turn_to(drop, flight, s);
    for (int i = 0; i < 2; ++i) {
      SideApproach<V> meeting(s, extents, i, at, v);
      const auto may = meeting.in_time(end);
      if (!any(may)) continue;
      meeting.detail(drop, flight, s, extents, i, at, v);
      const V chance = where(may, meeting.chance(flight, s, v[i]), V{});
      const V effect = chance * absolute(v[i]) * (end - meeting.time);
      const auto first = effect > stop.effect;
      if (!any(first)) continue;
      const V push = -chance * v[i];
      stop.effect = where(first, effect, stop.effect), stop.time = where(first, meeting.time, stop.time);
      stop.chance = where(first, chance, stop.chance), stop.side = where(first, V{} + double(2 * n + i), stop.side);
      stop.x = where(first, push * Extents<V>::axis_x(s, i), stop.x);
      stop.y = where(first, push * Extents<V>::axis_y(s, i), stop.y);
    }
  }
}

}  // namespace gp::GP_ISA

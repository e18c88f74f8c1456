// The drop model, first part: the state of the carried object at its release, and its flight up to a side in the way.
// costs/models/drop specifies the model and its letters. The file is compiled for two precisions; kernels.cpp defines D
// and the limits of shortcuts (kTail, kHeld, kNothing).

constexpr double kGravity = 9.81;
constexpr double kBeta = 0.55132889542179209;  // scale of a logistic distribution with standard deviation 1: sqrt(3)/pi
constexpr double kHalfRoot = 0.70710678118654752440;
constexpr double kTouch = 0.008;  // smoothing width for passing the height of a top (step 1 of the specification) [m]
constexpr double kAbove =
    -kTouch * (1.0 + kTail * kBeta);  // a part that is lower relative to a top does not land on it [m]
constexpr double kLeastMass = 1e-6;

// --- functions ------------------------------------------------------------------------------------------------------

struct Point2 {
  D x, y;
};

static inline Point2 turned(const Surface& s, D x, D y) {
  return {s.axis[0] * x + s.axis[1] * y, s.axis[0] * y - s.axis[1] * x};
}
static inline Point2 placed(const Surface& s, D x, D y) { return turned(s, x - s.centre[0], y - s.centre[1]); }

static inline Vec<D> cross(const Vec<D>& a, const Vec<D>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// The lanes in which a noisy point may be within half sizes of a centre, given its place in their axes.
template <class A> static inline auto may_be_within(const Point2& at, const A& a, const A& b, D inverse_scale) {
  return ((absolute(at.x) - a) * inverse_scale < kTail) & ((absolute(at.y) - b) * inverse_scale < kTail);
}

// e^x, clamped from below where it is negligible in a probability.
static inline D tail(D x) { return exponential(maximum(x, D{} - kHeld)); }
static inline D odds(D x) { return tail(minimum(x, D{} + kHeld)); }

// A product of probabilities with a single division; no factor of `under` is below 1.
struct Chance {
  D over = D{} + 1.0, under = D{} + 1.0;

  // P(|x + noise| < A), for logistic noise of the given scale.
  [[gnu::always_inline]] void within(D x, D A, D inverse_scale) {
    A = maximum(A, D{} + 1e-4);
    const D inside = (A - absolute(x)) * inverse_scale;
    if (!any(inside < kTail)) return;  // certain, as over the ground or large tables
    const D f = odds(-inside), h = tail(-(absolute(x) + A) * inverse_scale);
    over *= 1.0 - f * h;
    under *= (1.0 + f) * (1.0 + h);
  }
  // P(noise < u), for noise of standard deviation 1.
  void below(D u) { under *= 1.0 + odds(u * (-1.0 / kBeta)); }
  D value() const { return over * reciprocal(under); }
};

static inline D fall(D vz, D h) {
  const D k = 0.5 * (h + square_root(h * h + 1e-4));
  return (vz + square_root(vz * vz + 2.0 * kGravity * k)) * (1.0 / kGravity);
}

// --- the state at release -------------------------------------------------------------------------------------------

struct FlyingPart {
  Vec<D> o, u;        // o: from c to the part's centre; u: velocity of that centre
  D axis[9], bottom;  // rotation Q, lowest point
  D stands;           // the part's weight in the ground contact
};

// Effect of the first side in the way on the flight.
struct SideStop {
  D time = {}, x = {}, y = {}, chance = {};  // ts, p, E: time, loss of velocity, P of hitting the side
  D side = D{} - 1.0;                        // 2 * surface for a side across its x axis, one more for its y axis
  D effect = {};

  // Whether the side belongs to a surface.
  auto is_of(int surface) const { return (side == double(2 * surface)) | (side == double(2 * surface + 1)); }
};

struct Flight {
  Vec<D> c, v, w;  // centre of mass, its velocity, angular velocity
  SideStop stop;
  FlyingPart part[kMaxDropParts];
  D low, high, highest_bottom, tilt, speed;  // lowest and highest point; highest of the parts' lowest points
  D turn_speed, late;                        // |w|, and the largest delay of another part after the lowest one
};

// Extent of a part in a direction, given as components d along the part's axes.
static inline D reach(const DropPart& part, const D d[3]) {
  if (part.shape == kBall) return D{} + part.half[0];
  if (part.shape == kFlat)
    return absolute(d[0]) * part.half[0] + absolute(d[1]) * part.half[1] + absolute(d[2]) * part.half[2];
  return absolute(d[2]) * part.half[2] + part.half[0] * square_root(maximum(1.0 - d[2] * d[2], D{} + 1e-12));
}

static inline D tilt_of(int shape, const D axis[9]) {
  if (shape == kBall) return D{};
  const D a = axis[6] * axis[6], b = axis[7] * axis[7], c = axis[8] * axis[8];
  return 1.0 - (shape == kRound ? (a + b) * (a + b) + c * c : a * a + b * b + c * c);
}

static inline void add_joint_velocities(const Tables& tables, int link, const Frame<D>* X_W, const D* qd,
                                        Flight& flight) {
  for (int l = link; l >= 0; l = tables.link[l].parent) {
    const Link& joint = tables.link[l];
    if (joint.joint < 0) continue;
    const Frame<D>& X = X_W[l];
    const D rate = qd[joint.joint];
    const Vec<D> z = {X.R[2] * rate, X.R[5] * rate, X.R[8] * rate};
    Vec<D> u = z;
    if (!joint.slide) {
      u = cross(z, {flight.c.x - X.p.x, flight.c.y - X.p.y, flight.c.z - X.p.z});
      flight.w.x += z.x, flight.w.y += z.y, flight.w.z += z.z;
    }
    flight.v.x += u.x, flight.v.y += u.y, flight.v.z += u.z;
  }
}

static inline void place_part(const DropPart& part, const Frame<D>& X, const Flight& flight, FlyingPart& flying) {
  flying.o = rotate(X, part.offset);
  const Vec<D> swing = cross(flight.w, flying.o);
  flying.u = {flight.v.x + swing.x, flight.v.y + swing.y, flight.v.z + swing.z};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      flying.axis[3 * i + j] = X.R[3 * i] * part.R[j] + X.R[3 * i + 1] * part.R[3 + j] + X.R[3 * i + 2] * part.R[6 + j];
}

static inline void release(const Tables& tables, const DropTables& drop, const Frame<D>* X_W, const D* qd,
                           Flight& flight) {
  const Frame<D>& X = X_W[drop.frame];
  flight.c = transform(X, drop.centre);
  flight.v = flight.w = {D{}, D{}, D{}};
  if (qd) add_joint_velocities(tables, drop.link, X_W, qd, flight);
  flight.low = D{} + 1e9, flight.high = flight.highest_bottom = D{} - 1e9;
  for (int p = 0; p < drop.n_part; ++p) {
    FlyingPart& part = flight.part[p];
    place_part(drop.part[p], X, flight, part);
    const D up = reach(drop.part[p], part.axis + 6), z = flight.c.z + part.o.z;
    part.bottom = z - up;
    flight.low = minimum(flight.low, part.bottom), flight.high = maximum(flight.high, z + up);
    flight.highest_bottom = maximum(flight.highest_bottom, part.bottom);
  }
  for (int p = 0; p < drop.n_part; ++p) {
    const D above = (flight.part[p].bottom - flight.low) * (1.0 / 0.012);
    flight.part[p].stands = exponential(maximum(-above * above, D{} - 60.0));
  }
  flight.tilt = tilt_of(drop.part[drop.main].shape, flight.part[drop.main].axis);
  flight.speed = square_root(flight.v.x * flight.v.x + flight.v.y * flight.v.y + 1e-4);
  flight.turn_speed = square_root(flight.w.x * flight.w.x + flight.w.y * flight.w.y + flight.w.z * flight.w.z + 1e-12);
  // All heights differ by less, and sqrt(a + b) <= sqrt(a) + sqrt(b).
  flight.late = square_root((flight.highest_bottom - flight.low) * (2.0 / kGravity) + 1e-12);
}

// Place of the centre of mass at a time after the release.
static inline Point2 travelled(const Flight& flight, D time) {
  const D pushed = relu(time - flight.stop.time);
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
struct Step {
  D value, slope;

  explicit Step(D x) {
    const D t = minimum(relu(0.5 + 0.5 * x), D{} + 1.0);
    value = t * t * (3.0 - 2.0 * t), slope = 3.0 * t * (1.0 - t);
  }
};

// Extent of the whole object from its centre of mass, along a surface's axes.
struct Extents {
  int turn = -1;
  D low[2], high[2];
  D lowest[2], highest[2];  // the parts with these extents

  void turn_to(const DropTables& drop, const Flight& flight, const Surface& s) {
    if (turn == s.turn) return;
    turn = s.turn;
    for (int i = 0; i < 2; ++i) {
      low[i] = D{} + 1e9, high[i] = D{} - 1e9, lowest[i] = highest[i] = D{};
      for (int p = 0; p < drop.n_part; ++p) {
        const D o = along(s, i, flight.part[p].o), r = part_reach(drop, flight, s, p, i);
        const auto lower = o - r<low[i], higher = o + r> high[i];
        low[i] = where(lower, o - r, low[i]), lowest[i] = where(lower, D{} + double(p), lowest[i]);
        high[i] = where(higher, o + r, high[i]), highest[i] = where(higher, D{} + double(p), highest[i]);
      }
    }
  }
  static double axis_x(const Surface& s, int i) { return i ? -s.axis[1] : s.axis[0]; }
  static double axis_y(const Surface& s, int i) { return i ? s.axis[0] : s.axis[1]; }
  static D along(const Surface& s, int i, const Vec<D>& v) { return axis_x(s, i) * v.x + axis_y(s, i) * v.y; }
  static D part_reach(const DropTables& drop, const Flight& flight, const Surface& s, int p, int i) {
    const D* Q = flight.part[p].axis;
    D d[3];
    for (int j = 0; j < 3; ++j) d[j] = Q[j] * axis_x(s, i) + Q[3 + j] * axis_y(s, i);
    return reach(drop.part[p], d);
  }
};

// How the object hits that side of a surface across its axis i towards which it flies.
struct SideApproach {
  D gap, speed, time;
  D across, half, inverse_width, falls, height;  // computed by detail() if a hit is possible

  SideApproach(const Surface& s, const Extents& extents, int i, const D at[2], const D v[2]) {
    gap = where(v[i] < 0.0, at[i] + extents.low[i], -at[i] - extents.high[i]) - s.half[i];
    speed = maximum(absolute(v[i]), D{} + kSideSlow);
    time = relu(gap) * reciprocal(speed);
  }
  auto in_time(D end) const { return (gap > -2.0 * kSideTouch) & (time < end); }
  void detail(const DropTables& drop, const Flight& flight, const Surface& s, const Extents& extents, int i,
              const D at[2], const D v[2]) {
    const DropConstants& k = drop.constants;
    across = at[1 - i] + v[1 - i] * time + 0.5 * (extents.low[1 - i] + extents.high[1 - i]);
    half = s.half[1 - i] + 0.5 * (extents.high[1 - i] - extents.low[1 - i]);
    const D spread = k.velocity_spread * time;
    inverse_width = (1.0 / kSideWidth) * inverse_root(k.position_spread * k.position_spread + spread * spread);
    falls = relu(time - k.delay);
    height = flight.low + flight.v.z * falls - (0.5 * kGravity) * falls * falls;
  }
  Step in_front() const { return Step(gap * (1.0 / kSideTouch) + 1.0); }
  Step beside() const { return Step((half - absolute(across)) * inverse_width); }
  Step below(const Surface& s) const { return Step((s.top - height) * (1.0 / kSideTop)); }
  Step above(const Flight& flight, const Surface& s) const {
    return Step((height + flight.high - flight.low - s.bottom) * (1.0 / kSideTop) - 1.0);
  }
  Step moves(D v) const { return Step(absolute(v) * (2.0 / kSideMoves) - 1.0); }
  D chance(const Flight& flight, const Surface& s, D v) const {
    return in_front().value * beside().value * below(s).value * above(flight, s).value * moves(v).value;
  }
};

static inline void find_stop(const DropTables& drop, Flight& flight) {
  if (!drop.n_surface) return;
  SideStop& stop = flight.stop;
  const DropConstants& k = drop.constants;
  const D end = fall(flight.v.z, flight.low - drop.surface[drop.n_surface - 1].top) + (k.delay + kSideAfter);
  const D margin = drop.radius + kSideWidth * (k.position_spread + k.velocity_spread * end);
  // Bounds of the rest of the flight: its middle, and the distances from it within which a side may be hit.
  const D ahead_x = 0.5 * flight.v.x * end, ahead_y = 0.5 * flight.v.y * end;
  const D x = flight.c.x + ahead_x, y = flight.c.y + ahead_y;
  const D far_x = absolute(ahead_x) + margin, far_y = absolute(ahead_y) + margin;
  const double deep = drop.radius + 2.0 * kSideTouch;
  Extents extents;
  for (int n = 0; n < drop.n_surface; ++n) {
    const Surface& s = drop.surface[n];
    if (!s.fixed) continue;
    if (!any((absolute(x - s.centre[0]) < s.bound[0] + far_x) & (absolute(y - s.centre[1]) < s.bound[1] + far_y)))
      continue;
    const Point2 from = placed(s, flight.c.x, flight.c.y), by = turned(s, flight.v.x, flight.v.y);
    const D at[2] = {from.x, from.y}, v[2] = {by.x, by.y};
    const auto comes = [&](int i) {
      const D away = where(v[i] < 0.0, at[i], -at[i]) - s.half[i];
      return (away > -deep) & (away - drop.radius < absolute(v[i]) * end);
    };
    if (!any(comes(0) | comes(1))) continue;
    extents.turn_to(drop, flight, s);
    for (int i = 0; i < 2; ++i) {
      SideApproach meeting(s, extents, i, at, v);
      const auto may = meeting.in_time(end);
      if (!any(may)) continue;
      meeting.detail(drop, flight, s, extents, i, at, v);
      const D chance = where(may, meeting.chance(flight, s, v[i]), D{});
      const D effect = chance * absolute(v[i]) * (end - meeting.time);
      const auto first = effect > stop.effect;
      if (!any(first)) continue;
      const D push = -chance * v[i];
      stop.effect = where(first, effect, stop.effect), stop.time = where(first, meeting.time, stop.time);
      stop.chance = where(first, chance, stop.chance), stop.side = where(first, D{} + double(2 * n + i), stop.side);
      stop.x = where(first, push * Extents::axis_x(s, i), stop.x);
      stop.y = where(first, push * Extents::axis_y(s, i), stop.y);
    }
  }
}

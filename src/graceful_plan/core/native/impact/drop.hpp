// The drop model: entities that the carried object hits if it is released in this state. flight.hpp is the step before.
// Letters as in the specification, the docstring of costs/models/drop.

// --- 1. first contact -----------------------------------------------------------------------------------------------

// Extents of each part along the axes of a surface (x, y) and its diagonals (left, right), cached for surfaces with the
// same axes.
struct Reaches {
  int turn = -1;
  struct {
    D x, y, left, right;
  } part[kMaxDropParts];

  void turn_to(const DropTables& drop, const Flight& flight, const Surface& s) {
    if (turn == s.turn) return;
    turn = s.turn;
    for (int p = 0; p < drop.n_part; ++p) {
      const D* Q = flight.part[p].axis;
      D x[3], y[3], left[3], right[3];
      for (int i = 0; i < 3; ++i) {
        x[i] = Q[i] * s.axis[0] + Q[3 + i] * s.axis[1], y[i] = Q[3 + i] * s.axis[0] - Q[i] * s.axis[1];
        left[i] = (x[i] + y[i]) * kHalfRoot, right[i] = (y[i] - x[i]) * kHalfRoot;
      }
      part[p] = {reach(drop.part[p], x), reach(drop.part[p], y), reach(drop.part[p], left), reach(drop.part[p], right)};
    }
  }
};

// The object at the time when it passes the height of a surface's top.
struct Passage {
  double top = __builtin_inf();
  D time = {};                  // of the lowest part, including the delay of the release
  D x = {}, y = {}, near = {};  // of the centre of mass; near: radius around it within which the object may be
  bool detailed = false;
  struct {
    D x, y, inverse_scale, passes;  // of each part at that height; passes: 1 + e^.. of the gate for starting above the
                                    // top
    decltype(D{} > D{}) above;

    // Whether the part may be within half sizes a, b of a place in a surface's axes, in any lane.
    bool may_meet(const Point2& at, D a, D b) const { return any(may_be_within(at, a, b, inverse_scale) & above); }
  } part[kMaxDropParts];

  void move_to(const DropTables& drop, const Flight& flight, double height) {
    if (top == height) return;
    top = height, detailed = false;
    const DropConstants& k = drop.constants;
    const D falling = fall(flight.v.z, flight.low - top);
    time = falling + k.delay;
    const Point2 centre = travelled(flight, time);
    x = centre.x, y = centre.y;
    const D late = falling + flight.late;
    near = drop.radius * (1.0 + flight.turn_speed * (late + k.delay)) + flight.speed * flight.late +
           kTail * kBeta * (k.position_spread + k.velocity_spread * late);
    near *= 1.4142135623730951;  // the margin along the axes of W covers a margin along the surface's axes
    near = where(flight.highest_bottom - top > kAbove, near, D{} - 1e9);
  }
  void detail(const DropTables& drop, const Flight& flight) {
    if (detailed) return;
    const DropConstants& k = drop.constants;
    for (int p = 0; p < drop.n_part; ++p) {
      const FlyingPart& flying = flight.part[p];
      const D h = flying.bottom - top, t = fall(flight.v.z, h), spread = k.velocity_spread * t;
      part[p].inverse_scale = (1.0 / kBeta) * inverse_root(k.position_spread * k.position_spread + spread * spread);
      const D pushed = relu(t + k.delay - flight.stop.time);
      part[p].x = flight.c.x + flying.o.x + flying.u.x * (t + k.delay) + flight.stop.x * pushed;
      part[p].y = flight.c.y + flying.o.y + flying.u.y * (t + k.delay) + flight.stop.y * pushed;
      Chance gate;
      gate.below(h * (1.0 / kTouch) + 1.0);
      part[p].passes = gate.under;
      part[p].above = h > kAbove;
    }
    detailed = true;
  }
};

static inline bool may_meet(const Surface& s, const Passage& passage) {
  return any((absolute(passage.x - s.centre[0]) < s.bound[0] + passage.near) &
             (absolute(passage.y - s.centre[1]) < s.bound[1] + passage.near));
}

// D: P that the object overlaps a surface, seen from above, when it passes the height of the top; `foremost`: the part
// that determines D.
static inline D overlap(const DropTables& drop, const Flight& flight, const Surface& s, Passage& passage,
                        Reaches& reaches, D& foremost) {
  D best = {};
  foremost = D{} - 1.0;
  if (!may_meet(s, passage)) return best;
  passage.detail(drop, flight);
  reaches.turn_to(drop, flight, s);
  for (int p = 0; p < drop.n_part; ++p) {
    const auto& part = passage.part[p];
    const auto& r = reaches.part[p];
    const Point2 at = placed(s, part.x, part.y);
    const D a = s.half[0] + r.x, b = s.half[1] + r.y;
    if (!part.may_meet(at, a, b)) continue;
    Chance chance;
    chance.within(at.x, a, part.inverse_scale);
    chance.within(at.y, b, part.inverse_scale);
    chance.within((at.x + at.y) * kHalfRoot, s.diagonal + r.left, part.inverse_scale);
    chance.within((at.y - at.x) * kHalfRoot, s.diagonal + r.right, part.inverse_scale);
    chance.under *= part.passes;
    const D value = chance.value();
    foremost = where(value > best, D{} + double(p), foremost);
    best = maximum(best, value);
  }
  return best;
}

// --- 2. support -----------------------------------------------------------------------------------------------------

// Moments of the ground contact's area, relative to the centre of mass, in W.
struct Moments {
  D area = {}, x = {}, y = {}, xx = {}, yy = {}, xy = {};

  // Adds the ground contact of the parts that a surface supports; `at`: the centre of mass in the surface's axes.
  void add(const DropTables& drop, const Flight& flight, const Surface& s, const Point2& at, Reaches& reaches) {
    if (!any((absolute(at.x) < s.carries[0] + drop.radius) & (absolute(at.y) < s.carries[1] + drop.radius))) return;
    reaches.turn_to(drop, flight, s);
    for (int p = 0; p < drop.n_part; ++p) {
      const FlyingPart& part = flight.part[p];
      const auto& r = reaches.part[p];
      const Point2 o = turned(s, part.o.x, part.o.y);
      const D x0 = maximum(o.x - r.x, -s.carries[0] - at.x), x1 = minimum(o.x + r.x, s.carries[0] - at.x);
      const D y0 = maximum(o.y - r.y, -s.carries[1] - at.y), y1 = minimum(o.y + r.y, s.carries[1] - at.y);
      const D wx = relu(x1 - x0), wy = relu(y1 - y0), patch = part.stands * wx * wy;
      add_patch(s, patch, 0.5 * (x0 + x1), 0.5 * (y0 + y1), wx * wx * (1.0 / 12), wy * wy * (1.0 / 12));
    }
  }

 private:
  void add_patch(const Surface& s, D patch, D mx, D my, D qx, D qy) {
    const double c = s.axis[0], n = s.axis[1];
    const D ux = c * mx - n * my, uy = n * mx + c * my;
    area += patch, x += patch * ux, y += patch * uy;
    xx += patch * (ux * ux + c * c * qx + n * n * qy);
    yy += patch * (uy * uy + n * n * qx + c * c * qy);
    xy += patch * (ux * uy + c * n * (qx - qy));
  }
};

// T: P that the object leaves the surfaces that support it; away: n, the direction in which it leaves.
static inline D leaves(const DropTables& drop, const Flight& flight, const Moments& m, Point2& away) {
  const DropConstants& k = drop.constants;
  const D share = reciprocal(m.area + 1e-6), ex = m.x * share, ey = m.y * share;
  const D xx = m.xx * share - ex * ex + 1e-5, yy = m.yy * share - ey * ey + 1e-5, xy = m.xy * share - ex * ey;
  const D det = maximum(xx * yy - xy * xy, D{} + 1e-11);
  const D d2 = (yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey) * reciprocal(det), off = d2 * reciprocal(3.0 + d2);
  const D height = flight.c.z - flight.low, distance = -off * inverse_root(ex * ex + ey * ey + 1e-6);
  away = {distance * ex, distance * ey};
  const D u = k.leave + 2.0 * k.leave_offset * (off - 0.5) + k.leave_speed * flight.speed +
              2.0 * k.leave_tilt * flight.tilt +
              0.5 * k.leave_narrow * logarithm((height * height + 1e-6) * (xx + yy) * reciprocal(3.0 * det));
  Chance chance;
  chance.below(u);
  return chance.value();
}

// --- steps 1 and 2 for all levels -----------------------------------------------------------------------------------

struct Landing {
  D overlap[kMaxSurfaces], contact[kMaxSurfaces], time[kMaxSurfaces];  // D, C, tc: overlap, share of the first contact,
                                                                       // time of contact
  D foremost[kMaxSurfaces];                                            // the part that determines D
  D arrives[kMaxSurfaces], first[kMaxSurfaces], leaving[kMaxSurfaces];  // per level: A (P of arriving), sum of F (first
                                                                        // impacts), M (P of impact and leaving)
  D share[kMaxSurfaces], leaves[kMaxSurfaces];                          // per level: F/D, T
  Point2 away[kMaxSurfaces];                                            // per level: n
  D landed, total, mean_time, height, fallen;  // sum of F, total = that + 1e-6, tl, zs, hs: mean time, height and depth
                                               // of the fall
  D x, y;                                      // L, the place of landing
  D blur;                                      // variance of the place of landing
};

// The centre of mass at a time, in the axes of a surface.
static inline Point2 passing(const Flight& flight, const Surface& s, D time) {
  const Point2 at = travelled(flight, time);
  return placed(s, at.x, at.y);
}

// Over the surfaces of a level: the sum of D, and the product of 1 - D.
struct Met {
  D sum = {}, missed = D{} + 1.0;
};

// Computes D of the surfaces of a level.
static inline Met meet_level(const DropTables& drop, const Flight& flight, int level, Passage& passage,
                             Reaches& reaches, Landing& landing) {
  Met met;
  const bool arrives = any(landing.arrives[level] > kNothing);
  for (int k = drop.level_start[level]; k < drop.level_start[level + 1]; ++k) {
    const Surface& s = drop.surface[k];
    passage.move_to(drop, flight, s.top);
    landing.time[k] = passage.time;
    const D overlaps = arrives ? overlap(drop, flight, s, passage, reaches, landing.foremost[k]) : D{};
    landing.overlap[k] = landing.contact[k] = overlaps;
    met.sum += overlaps, met.missed *= 1.0 - overlaps;
  }
  return met;
}

static inline void land(const DropTables& drop, const Flight& flight, Landing& landing) {
  const DropConstants& c = drop.constants;
  Passage passage;
  Reaches reaches;
  D arrives = D{} + 1.0, sum_time = {}, sum_height = {}, sum_fallen = {};
  landing.landed = D{};
  for (int l = 0; l < drop.n_level; ++l) {
    landing.arrives[l] = arrives;
    const auto [sum, missed] = meet_level(drop, flight, l, passage, reaches, landing);
    const D first = arrives * (1.0 - missed), share = first * reciprocal(sum + kLeastMass);
    landing.first[l] = landing.leaving[l] = landing.leaves[l] = D{}, landing.away[l] = {D{}, D{}};
    landing.share[l] = share;
    if (!any(sum > 0.0)) continue;
    const bool lands = any(first > kNothing);
    Moments moments;
    for (int k = drop.level_start[l]; k < drop.level_start[l + 1]; ++k) {
      const Surface& s = drop.surface[k];
      const D F = share * landing.contact[k], time = landing.time[k];
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
  landing.total = landing.landed + kLeastMass;
  const D share = reciprocal(landing.total);
  landing.mean_time = sum_time * share, landing.height = sum_height * share, landing.fallen = sum_fallen * share;
  const Point2 place = travelled(flight, landing.mean_time);
  landing.x = place.x, landing.y = place.y;
  const D late = c.velocity_spread * landing.mean_time, deep = c.height_spread * landing.fallen;
  landing.blur = c.position_spread * c.position_spread + late * late + deep * deep;
}

// From the state at the release to the first contact.
struct Fall {
  Frame<D> X_W[kMaxLinks];
  Flight flight;
  Landing landing;

  Fall(const Tables& tables, const DropTables& drop, const D* q, const D* qd) {
    forward_kinematics(tables, q, X_W);
    release(tables, drop, X_W, qd, flight);
    find_stop(drop, flight);
    land(drop, flight, landing);
  }
};

// --- 3. falls onto lower surfaces -----------------------------------------------------------------------------------

struct Tumble {
  D mass = {};                // B: P that the object is falling
  Point2 drift = {D{}, D{}};  // N: sum of n M, weighted direction
  D inverse_scale;
  Point2 start;    // L + ks v
  D x, y;          // its place on the present level
  D keep, caught;  // shares of B: not stopped by the surfaces visited on the level; stopped by the last one

  Tumble(const DropTables& drop, const Flight& flight, const Landing& landing) {
    const DropConstants& k = drop.constants;
    const double tumbling = k.size_spread * drop.size;
    const D v2 = flight.v.x * flight.v.x + flight.v.y * flight.v.y;
    inverse_scale =
        (1.0 / kBeta) * inverse_root(landing.blur + tumbling * tumbling + k.carry_spread * k.carry_spread * v2);
    start = travelled(flight, landing.mean_time + k.carry);
  }
  bool enter(const DropTables& drop) {
    keep = D{} + 1.0;
    if (!any(mass > kNothing)) return false;
    const D moved = drop.constants.drift * drop.size * reciprocal(mass + kLeastMass);
    x = start.x + drift.x * moved, y = start.y + drift.y * moved;
    return true;
  }
  // Whether the object may reach a surface from a place in its axes.
  bool may_meet(const Surface& s, const Point2& at) const {
    return any(may_be_within(at, s.near[0], s.near[1], inverse_scale));
  }
  // G/B, if wanted: P of hitting the surface; also updates `caught` and `keep`.
  D hit(const Surface& s, bool wanted) {
    const Point2 at = placed(s, x, y);
    caught = D{};
    if (!may_meet(s, at)) return D{};
    Chance hits, ends;
    if (wanted) hits.within(at.x, D{} + s.reached[0], inverse_scale);
    if (wanted) hits.within(at.y, D{} + s.reached[1], inverse_scale);
    ends.within(at.x, D{} + s.inside[0], inverse_scale);
    ends.within(at.y, D{} + s.inside[1], inverse_scale);
    caught = keep * (s.catches * ends.value());
    keep -= caught;
    return mass * hits.value();
  }
  void leave(D leaving, const Point2& away) {
    mass = mass * keep + leaving;
    drift = {drift.x * keep + leaving * away.x, drift.y * keep + leaving * away.y};
  }
};

// --- 4. side contacts -----------------------------------------------------------------------------------------------

// P that the object leaves its first support, given that it has landed, and the mean direction.
struct Leaving {
  D probability = {}, x = {}, y = {}, share;

  Leaving(const DropTables& drop, const Landing& landing) : share(reciprocal(landing.total)) {
    for (int l = 0; l < drop.n_level; ++l) {
      probability += landing.leaving[l];
      x += landing.leaving[l] * landing.away[l].x, y += landing.leaving[l] * landing.away[l].y;
    }
    probability *= share, x *= share, y *= share;
  }
};

struct Sweep {
  D x, y, reach, inverse_scale, top;

  Sweep(const DropTables& drop, const Flight& flight, const Landing& landing) {
    const DropConstants& k = drop.constants;
    const Leaving leaving(drop, landing);
    const Point2 slid = travelled(flight, landing.mean_time + k.slide);
    x = slid.x + k.drift * drop.size * leaving.x, y = slid.y + k.drift * drop.size * leaving.y;
    const double resting = k.side_spread * drop.size;
    const D toppling = k.size_spread * drop.size * leaving.probability;
    inverse_scale = (1.0 / kBeta) * inverse_root(landing.blur + resting * resting + toppling * toppling);
    reach = (k.side_reach + k.topple_reach * leaving.probability) * drop.size;
    top = landing.height + flight.high - flight.low;
  }
  // H: P of hitting the surface from the side; beside: P that the object lands beside it.
  D hit(const DropTables& drop, const Flight& flight, const Surface& s, D time, D beside) const {
    const D over = (top - s.bottom) * (1.0 / drop.constants.side_height);
    const Point2 from = passing(flight, s, time), to = placed(s, x, y);
    const D mx = 0.5 * (from.x + to.x), my = 0.5 * (from.y + to.y), dx = to.x - from.x, dy = to.y - from.y;
    const D a = s.half[0] + reach, b = s.half[1] + reach;
    const auto near_x = (absolute(mx) - relu(a + 0.5 * absolute(dx)) - 1e-3) * inverse_scale < kTail;
    const auto near_y = (absolute(my) - relu(b + 0.5 * absolute(dy)) - 1e-3) * inverse_scale < kTail;
    if (!any(near_x & near_y & (over > -kTail * kBeta) & (beside > kNothing))) return D{};
    Chance chance;
    chance.below(over);
    chance.within(mx, a + 0.5 * square_root(dx * dx + 1e-6), inverse_scale);
    chance.within(my, b + 0.5 * square_root(dy * dy + 1e-6), inverse_scale);
    return beside * chance.value();
  }
};

// P that the object hits the side in its way before it lands (step 0).
struct SideImpact {
  D before, value;

  SideImpact(const Flight& flight, const Landing& landing) {
    before = value = D{};
    if (!any(flight.stop.chance > 0.0)) return;
    before = Step((landing.mean_time - flight.stop.time) * (1.0 / kSideLate)).value;
    value = flight.stop.chance * (1.0 - landing.landed * (1.0 - before));
  }
  // The value for one surface.
  D on(const Flight& flight, int surface) const { return where(flight.stop.is_of(surface), value, D{}); }
};

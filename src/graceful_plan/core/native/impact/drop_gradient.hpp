// The gradient of the drop model's impact with respect to q and qd: drop.hpp in reverse mode. d_x is the derivative of
// the impact with respect to x. Each function takes derivatives with respect to the results of its namesake and adds to
// those with respect to its arguments.

struct StopSlope {
  D time = {}, x = {}, y = {}, chance = {};
};

struct FlightSlope {
  Vec<D> c = {D{}, D{}, D{}}, v = {D{}, D{}, D{}}, w = {D{}, D{}, D{}};
  D low = {}, high = {}, tilt = {}, speed = {};
  StopSlope stop;
  struct Part {
    Vec<D> o, u;
    D axis[9], bottom, stands;
  } part[kMaxDropParts];

  explicit FlightSlope(const DropTables& drop) {
    for (int p = 0; p < drop.n_part; ++p) part[p] = Part{};
  }
};

struct LandingSlope {
  D contact[kMaxSurfaces], time[kMaxSurfaces], lands[kMaxSurfaces];  // lands: F of each surface
  D first[kMaxSurfaces], leaving[kMaxSurfaces], leaves[kMaxSurfaces];
  Point2 away[kMaxSurfaces];
  D total = {}, mean_time = {}, height = {}, fallen = {}, x = {}, y = {}, blur = {};

  explicit LandingSlope(const DropTables& drop) {
    for (int k = 0; k < drop.n_surface; ++k) contact[k] = time[k] = lands[k] = D{};
    for (int l = 0; l < drop.n_level; ++l) first[l] = leaving[l] = leaves[l] = D{}, away[l] = {D{}, D{}};
  }
};

// The state of the reverse pass: one fall, and the derivatives with respect to its quantities.
struct Backward {
  const Tables& tables;
  const DropTables& drop;
  const Frame<D>* X_W;
  const Flight& flight;
  const Landing& landing;
  FlightSlope d_flight;
  LandingSlope d_landing;

  Backward(const Tables& of, const DropTables& dropped, const Fall& fall)
      : tables(of),
        drop(dropped),
        X_W(fall.X_W),
        flight(fall.flight),
        landing(fall.landing),
        d_flight(dropped),
        d_landing(dropped) {}
};

// --- functions ------------------------------------------------------------------------------------------------------

static inline void back_turned(const Surface& s, const Point2& d, D& d_x, D& d_y) {
  d_x += s.axis[0] * d.x - s.axis[1] * d.y;
  d_y += s.axis[1] * d.x + s.axis[0] * d.y;
}

// P(|x + noise| < A) and its derivatives: the difference of two logistic functions.
struct Within {
  D value, x, A, inverse_scale;

  [[gnu::always_inline]] Within(D at, D half, D scale) {
    const D a = maximum(half, D{} + 1e-4), r = absolute(at);
    const D upper = reciprocal(1.0 + odds((r - a) * scale)), h = tail(-(r + a) * scale),
            lower = h * reciprocal(1.0 + h);
    const D up = upper * (1.0 - upper), low = lower * (1.0 - lower);
    value = upper - lower;
    x = where(at < 0.0, up - low, low - up) * scale;
    A = where(half > 1e-4, (up + low) * scale, D{});
    inverse_scale = (a - r) * up + (a + r) * low;
  }
};

// P(noise < u) and its derivative.
struct Below {
  D value, u;

  explicit Below(D at) : value(reciprocal(1.0 + odds(at * (-1.0 / kBeta)))), u(value * (1.0 - value) * (1.0 / kBeta)) {}
};

static inline void back_fall(D vz, D h, D d_t, D& d_vz, D& d_h) {
  const D soft = square_root(h * h + 1e-4), k = 0.5 * (h + soft), inverse = inverse_root(vz * vz + 2.0 * kGravity * k);
  d_vz += d_t * (1.0 + vz * inverse) * (1.0 / kGravity);
  d_h += d_t * inverse * k * reciprocal(soft);
}

static inline void back_reach(const DropPart& part, const D d[3], D d_reach, D d_d[3]) {
  d_d[0] = d_d[1] = d_d[2] = D{};
  if (part.shape == kBall) return;
  if (part.shape == kFlat) {
    for (int i = 0; i < 3; ++i) d_d[i] = where(d[i] < 0.0, -d_reach, d_reach) * part.half[i];
    return;
  }
  const D left = 1.0 - d[2] * d[2], slope = where(left > 1e-12, d[2] * inverse_root(maximum(left, D{} + 1e-12)), D{});
  d_d[2] = d_reach * (where(d[2] < 0.0, D{} - part.half[2], D{} + part.half[2]) - part.half[0] * slope);
}

// Extent of a part in a horizontal direction u.
static inline void back_reach_along(Backward& back, int p, double ux, double uy, D d_reach) {
  const D* Q = back.flight.part[p].axis;
  D* slope = back.d_flight.part[p].axis;
  D d[3], d_d[3];
  for (int i = 0; i < 3; ++i) d[i] = Q[i] * ux + Q[3 + i] * uy;
  back_reach(back.drop.part[p], d, d_reach, d_d);
  for (int i = 0; i < 3; ++i) slope[i] += d_d[i] * ux, slope[3 + i] += d_d[i] * uy;
}

// Derivatives with respect to Reaches, summed over surfaces with the same axes.
struct ReachSlope {
  const Surface* alike = nullptr;
  struct {
    D x, y, left, right;
  } part[kMaxDropParts];

  explicit ReachSlope(const DropTables& drop) { clear(drop); }
  void turn_to(Backward& back, const Surface& s) {
    if (alike && alike->turn == s.turn) return;
    flush(back);
    alike = &s;
  }
  void flush(Backward& back) {
    if (!alike) return;
    const double c = alike->axis[0], n = alike->axis[1], lx = (c - n) * kHalfRoot, ly = (c + n) * kHalfRoot;
    for (int p = 0; p < back.drop.n_part; ++p) {
      back_reach_along(back, p, c, n, part[p].x);
      back_reach_along(back, p, -n, c, part[p].y);
      back_reach_along(back, p, lx, ly, part[p].left);
      back_reach_along(back, p, -ly, lx, part[p].right);
    }
    clear(back.drop);
  }

 private:
  void clear(const DropTables& drop) {
    for (int p = 0; p < drop.n_part; ++p) part[p] = {D{}, D{}, D{}, D{}};
  }
};

// Displacement of a place by a side in the way (push); returns the derivative with respect to the time.
static inline D back_pushed(Backward& back, D time, D d_x, D d_y) {
  const SideStop& stop = back.flight.stop;
  const auto after = time > stop.time;
  const D pushed = relu(time - stop.time), d_time = where(after, d_x * stop.x + d_y * stop.y, D{});
  StopSlope& d = back.d_flight.stop;
  d.x += d_x * pushed, d.y += d_y * pushed, d.time -= d_time;
  return d_time;
}

// Place of the centre of mass at a time; returns the derivative with respect to the time.
static inline D back_travelled(Backward& back, D time, D d_x, D d_y) {
  back.d_flight.c.x += d_x, back.d_flight.c.y += d_y;
  back.d_flight.v.x += d_x * time, back.d_flight.v.y += d_y * time;
  return d_x * back.flight.v.x + d_y * back.flight.v.y + back_pushed(back, time, d_x, d_y);
}

// Place of the centre of mass when it passes a surface, in the surface's axes.
static inline void back_passing(Backward& back, int k, const Point2& d) {
  D x = {}, y = {};
  back_turned(back.drop.surface[k], d, x, y);
  back.d_landing.time[k] += back_travelled(back, back.landing.time[k], x, y);
}

// --- 4. side contacts -----------------------------------------------------------------------------------------------

struct SweepSlope {
  D x = {}, y = {}, reach = {}, inverse_scale = {}, top = {};
};

// H of a surface; returns the derivative with respect to `beside`.
static inline D back_sweep_hit(Backward& back, const Sweep& sweep, int k, D beside, D d_H, SweepSlope& slope) {
  const DropTables& drop = back.drop;
  const Flight& flight = back.flight;
  const Surface& s = drop.surface[k];
  const Below over((sweep.top - s.bottom) * (1.0 / drop.constants.side_height));
  const Point2 from = passing(flight, s, back.landing.time[k]), to = placed(s, sweep.x, sweep.y);
  const D dx = to.x - from.x, dy = to.y - from.y;
  const D inverse_x = inverse_root(dx * dx + 1e-6), inverse_y = inverse_root(dy * dy + 1e-6);
  const Within x(0.5 * (from.x + to.x), s.half[0] + sweep.reach + 0.5 * (dx * dx + 1e-6) * inverse_x,
                 sweep.inverse_scale);
  const Within y(0.5 * (from.y + to.y), s.half[1] + sweep.reach + 0.5 * (dy * dy + 1e-6) * inverse_y,
                 sweep.inverse_scale);
  slope.top += d_H * beside * over.u * x.value * y.value * (1.0 / drop.constants.side_height);
  const D d_x = d_H * beside * over.value * y.value, d_y = d_H * beside * over.value * x.value;
  slope.inverse_scale += d_x * x.inverse_scale + d_y * y.inverse_scale;
  slope.reach += d_x * x.A + d_y * y.A;
  const Point2 middle = {0.5 * d_x * x.x, 0.5 * d_y * y.x},
               length = {0.5 * d_x * x.A * dx * inverse_x, 0.5 * d_y * y.A * dy * inverse_y};
  back_turned(s, {middle.x + length.x, middle.y + length.y}, slope.x, slope.y);
  back_passing(back, k, {middle.x - length.x, middle.y - length.y});
  return d_H * over.value * x.value * y.value;
}

static inline void back_sweep(Backward& back, const Sweep& sweep, const SweepSlope& d) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const DropConstants& k = drop.constants;
  const Leaving leaving(drop, landing);
  // 1/sqrt(V) has the derivative -V^-3/2 /2, and inverse_scale is 1/(beta sqrt(V)).
  const D d_variance =
      -0.5 * kBeta * kBeta * sweep.inverse_scale * sweep.inverse_scale * sweep.inverse_scale * d.inverse_scale;
  const double toppling = k.size_spread * drop.size, drift = k.drift * drop.size;
  const D d_leaves =
      d.reach * k.topple_reach * drop.size + d_variance * 2.0 * toppling * toppling * leaving.probability;
  d_landing.blur += d_variance;
  d_landing.mean_time += back_travelled(back, landing.mean_time + k.slide, d.x, d.y);
  d_landing.height += d.top;
  d_flight.high += d.top, d_flight.low -= d.top;
  for (int l = 0; l < drop.n_level; ++l) {
    const Point2& n = landing.away[l];
    const D M = landing.leaving[l] * leaving.share;
    d_landing.leaving[l] += leaving.share * (d_leaves + drift * (d.x * n.x + d.y * n.y));
    d_landing.away[l].x += drift * d.x * M, d_landing.away[l].y += drift * d.y * M;
  }
  d_landing.total -= leaving.share * (d_leaves * leaving.probability + drift * (d.x * leaving.x + d.y * leaving.y));
}

// P that the object hits the side in its way; returns the derivative with respect to P of landing at all.
static inline D back_brunt(Backward& back, const SideImpact& brunt, D d) {
  const SideStop& stop = back.flight.stop;
  const D landed = back.landing.landed;
  back.d_flight.stop.chance += d * (1.0 - landed * (1.0 - brunt.before));
  const Step before((back.landing.mean_time - stop.time) * (1.0 / kSideLate));
  const D d_time = d * stop.chance * landed * before.slope * (1.0 / kSideLate);
  back.d_landing.mean_time += d_time, back.d_flight.stop.time -= d_time;
  return -d * stop.chance * (1.0 - brunt.before);
}

// --- 2. support -----------------------------------------------------------------------------------------------------

// Returns the derivatives with respect to the moments.
static inline Moments back_leaves(Backward& back, const Moments& m, D d_T, const Point2& d_away) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const DropConstants& k = drop.constants;
  Moments d;
  const D share = reciprocal(m.area + 1e-6), ex = m.x * share, ey = m.y * share;
  const D xx = m.xx * share - ex * ex + 1e-5, yy = m.yy * share - ey * ey + 1e-5, xy = m.xy * share - ex * ey;
  const D plain = xx * yy - xy * xy, det = maximum(plain, D{} + 1e-11), inverse_det = reciprocal(det),
          inverse_trace = reciprocal(xx + yy);
  const D d2 = (yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey) * inverse_det, part = reciprocal(3.0 + d2),
          off = d2 * part;
  const D height = flight.c.z - flight.low, inverse = inverse_root(ex * ex + ey * ey + 1e-6),
          soft = height * height + 1e-6;
  const Below T(k.leave + 2.0 * k.leave_offset * (off - 0.5) + k.leave_speed * flight.speed +
                2.0 * k.leave_tilt * flight.tilt +
                0.5 * k.leave_narrow * logarithm(soft * (xx + yy) * reciprocal(3.0 * det)));
  const D d_u = d_T * T.u, d_log = 0.5 * k.leave_narrow * d_u, d_height = d_log * 2.0 * height * reciprocal(soft);
  d_flight.speed += k.leave_speed * d_u, d_flight.tilt += 2.0 * k.leave_tilt * d_u;
  d_flight.c.z += d_height, d_flight.low -= d_height;
  const D along = d_away.x * ex + d_away.y * ey;
  const D d_off = 2.0 * k.leave_offset * d_u - along * inverse, d_d2 = d_off * 3.0 * part * part,
          d_quadric = d_d2 * inverse_det;
  const D d_det = where(plain > 1e-11, -d_log * inverse_det - d_d2 * d2 * inverse_det, D{});
  const D cube = off * along * inverse * inverse * inverse;
  D d_ex = -off * inverse * d_away.x + cube * ex + 2.0 * d_quadric * (yy * ex - xy * ey);
  D d_ey = -off * inverse * d_away.y + cube * ey + 2.0 * d_quadric * (xx * ey - xy * ex);
  const D d_xx = d_log * inverse_trace + d_quadric * ey * ey + d_det * yy,
          d_yy = d_log * inverse_trace + d_quadric * ex * ex + d_det * xx;
  const D d_xy = -2.0 * (d_quadric * ex * ey + d_det * xy);
  d_ex -= 2.0 * ex * d_xx + ey * d_xy, d_ey -= 2.0 * ey * d_yy + ex * d_xy;
  d.x = d_ex * share, d.y = d_ey * share, d.xx = d_xx * share, d.yy = d_yy * share, d.xy = d_xy * share;
  d.area = -share * share * (d_ex * m.x + d_ey * m.y + d_xx * m.xx + d_yy * m.yy + d_xy * m.xy);
  return d;
}

struct IntervalSlope {
  D o, r, at;
};

// One axis of the rectangle of contact on a surface, from the larger lower end to the smaller upper end.
static inline IntervalSlope back_interval(D o, D r, double carries, D at, D d_middle, D d_width) {
  const D d0 = 0.5 * d_middle - d_width, d1 = 0.5 * d_middle + d_width;
  const auto own0 = o - r > -carries - at, own1 = o + r < carries - at;
  const D lower = where(own0, d0, D{}), upper = where(own1, d1, D{});
  return {lower + upper, upper - lower, -(where(own0, D{}, d0) + where(own1, D{}, d1))};
}

static inline void back_moments(Backward& back, int k, Reaches& reaches, ReachSlope& d_reaches, const Moments& d) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const Surface& s = drop.surface[k];
  const Point2 at = passing(flight, s, landing.time[k]);
  if (!any((absolute(at.x) < s.carries[0] + drop.radius) & (absolute(at.y) < s.carries[1] + drop.radius))) return;
  reaches.turn_to(drop, flight, s);
  d_reaches.turn_to(back, s);
  const double c = s.axis[0], n = s.axis[1];
  Point2 d_at = {D{}, D{}};
  for (int p = 0; p < drop.n_part; ++p) {
    const FlyingPart& part = flight.part[p];
    const auto& r = reaches.part[p];
    const Point2 o = turned(s, part.o.x, part.o.y);
    const D x0 = maximum(o.x - r.x, -s.carries[0] - at.x), x1 = minimum(o.x + r.x, s.carries[0] - at.x);
    const D y0 = maximum(o.y - r.y, -s.carries[1] - at.y), y1 = minimum(o.y + r.y, s.carries[1] - at.y);
    const D wx = relu(x1 - x0), wy = relu(y1 - y0), patch = part.stands * wx * wy, mx = 0.5 * (x0 + x1),
            my = 0.5 * (y0 + y1);
    if (!any(patch > 0.0)) continue;
    const D ux = c * mx - n * my, uy = n * mx + c * my, qx = wx * wx * (1.0 / 12), qy = wy * wy * (1.0 / 12);
    const D d_patch = d.area + d.x * ux + d.y * uy + d.xx * (ux * ux + c * c * qx + n * n * qy) +
                      d.yy * (uy * uy + n * n * qx + c * c * qy) + d.xy * (ux * uy + c * n * (qx - qy));
    const D d_ux = patch * (d.x + 2.0 * d.xx * ux + d.xy * uy), d_uy = patch * (d.y + 2.0 * d.yy * uy + d.xy * ux);
    const D d_qx = patch * (d.xx * c * c + d.yy * n * n + d.xy * c * n),
            d_qy = patch * (d.xx * n * n + d.yy * c * c - d.xy * c * n);
    const D d_wx = where(x1 > x0, d_patch * part.stands * wy + d_qx * wx * (1.0 / 6), D{});
    const D d_wy = where(y1 > y0, d_patch * part.stands * wx + d_qy * wy * (1.0 / 6), D{});
    d_flight.part[p].stands += d_patch * wx * wy;
    const IntervalSlope along = back_interval(o.x, r.x, s.carries[0], at.x, c * d_ux + n * d_uy, d_wx);
    const IntervalSlope across = back_interval(o.y, r.y, s.carries[1], at.y, c * d_uy - n * d_ux, d_wy);
    back_turned(s, {along.o, across.o}, d_flight.part[p].o.x, d_flight.part[p].o.y);
    d_reaches.part[p].x += along.r, d_reaches.part[p].y += across.r;
    d_at.x += along.at, d_at.y += across.at;
  }
  back_passing(back, k, d_at);
}

// --- 1. first contact -----------------------------------------------------------------------------------------------

static inline void back_overlap(Backward& back, int surface, Passage& passage, Reaches& reaches, ReachSlope& d_reaches,
                                D d_D) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const DropConstants& k = drop.constants;
  const Surface& s = drop.surface[surface];
  passage.move_to(drop, flight, s.top);
  passage.detail(drop, flight);
  reaches.turn_to(drop, flight, s);
  d_reaches.turn_to(back, s);
  for (int p = 0; p < drop.n_part; ++p) {
    const FlyingPart& flying = flight.part[p];
    const auto& part = passage.part[p];
    const auto& r = reaches.part[p];
    const auto decides = landing.foremost[surface] == double(p);
    if (!any(decides)) continue;
    const Point2 at = placed(s, part.x, part.y);
    const Within x(at.x, s.half[0] + r.x, part.inverse_scale), y(at.y, s.half[1] + r.y, part.inverse_scale);
    const Within left((at.x + at.y) * kHalfRoot, s.diagonal + r.left, part.inverse_scale);
    const Within right((at.y - at.x) * kHalfRoot, s.diagonal + r.right, part.inverse_scale);
    const D h = flying.bottom - s.top;
    const Below gate(h * (1.0 / kTouch) + 1.0);
    const D upright = x.value * y.value, slanted = left.value * right.value, d = where(decides, d_D, D{});
    const D gated = d * gate.value, d_x = gated * y.value * slanted, d_y = gated * x.value * slanted;
    const D d_left = gated * upright * right.value, d_right = gated * upright * left.value;
    auto& d_reach = d_reaches.part[p];
    d_reach.x += d_x * x.A, d_reach.y += d_y * y.A, d_reach.left += d_left * left.A, d_reach.right += d_right * right.A;
    D wx = {}, wy = {};
    back_turned(s,
                {d_x * x.x + (d_left * left.x - d_right * right.x) * kHalfRoot,
                 d_y * y.x + (d_left * left.x + d_right * right.x) * kHalfRoot},
                wx, wy);
    const D t = fall(flight.v.z, h), time = t + k.delay;
    d_flight.c.x += wx, d_flight.c.y += wy;
    auto& d_part = d_flight.part[p];
    d_part.o.x += wx, d_part.o.y += wy, d_part.u.x += wx * time, d_part.u.y += wy * time;
    const D d_scale =
        d_x * x.inverse_scale + d_y * y.inverse_scale + d_left * left.inverse_scale + d_right * right.inverse_scale;
    const D cube = part.inverse_scale * part.inverse_scale * part.inverse_scale * (kBeta * kBeta);
    const D d_t = wx * flying.u.x + wy * flying.u.y + back_pushed(back, time, wx, wy) -
                  d_scale * cube * (k.velocity_spread * k.velocity_spread) * t;
    back_fall(flight.v.z, h, d_t, d_flight.v.z, d_part.bottom);
    d_part.bottom += d * upright * slanted * gate.u * (1.0 / kTouch);
  }
}

// --- steps 1 and 2 for all levels -----------------------------------------------------------------------------------

// Maps derivatives with respect to C and F of each surface to derivatives with respect to D; returns that with respect
// to A.
static inline D back_level(const Backward& back, int level, D d_next, const D* d_F, D* d_overlap) {
  const DropTables& drop = back.drop;
  const Landing& landing = back.landing;
  const D* d_contact = back.d_landing.contact;
  const int first = drop.level_start[level], last = drop.level_start[level + 1];
  const D A = landing.arrives[level];
  D before[kMaxSurfaces], sum = {}, missed = D{} + 1.0, weighed = {}, d_A = {};
  for (int k = first; k < last; ++k) {
    const D overlap = landing.overlap[k];
    before[k] = missed;
    sum += overlap, missed *= 1.0 - overlap, weighed += d_F[k] * overlap, d_A += d_contact[k] * overlap;
  }
  const D inverse = reciprocal(sum + kLeastMass), share = (1.0 - missed) * inverse;
  const D d_missed = d_next * A - weighed * A * inverse, d_sum = -weighed * A * share * inverse;
  D after = D{} + 1.0;
  for (int k = last; k-- > first;) {
    d_overlap[k] = d_contact[k] * A + d_F[k] * A * share + d_sum - d_missed * before[k] * after;
    after *= 1.0 - landing.overlap[k];
  }
  return d_A + weighed * share + d_next * missed;
}

static inline void back_land(Backward& back) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d] = back;
  const DropConstants& k = drop.constants;
  d.mean_time += 2.0 * k.velocity_spread * k.velocity_spread * landing.mean_time * d.blur;
  d.fallen += 2.0 * k.height_spread * k.height_spread * landing.fallen * d.blur;
  d.mean_time += back_travelled(back, landing.mean_time, d.x, d.y);
  const D share = reciprocal(landing.total);
  const D d_total =
      d.total - share * (d.mean_time * landing.mean_time + d.height * landing.height + d.fallen * landing.fallen);
  Passage passage;
  Reaches reaches;
  ReachSlope d_reaches(drop);
  D d_F[kMaxSurfaces], d_overlap[kMaxSurfaces], d_arrives = {};
  for (int l = drop.n_level; l-- > 0;) {
    const int first = drop.level_start[l], last = drop.level_start[l + 1];
    D d_first = d.first[l] + d_total;
    if (any(landing.leaving[l] > 0.0)) {
      Moments moments;
      for (int i = first; i < last; ++i) {
        const Surface& s = drop.surface[i];
        moments.add(drop, flight, s, passing(flight, s, landing.time[i]), reaches);
      }
      d_first += d.leaving[l] * landing.leaves[l];
      const Moments d_moments = back_leaves(back, moments, d.leaving[l] * landing.first[l] + d.leaves[l], d.away[l]);
      for (int i = first; i < last; ++i) back_moments(back, i, reaches, d_reaches, d_moments);
    }
    for (int i = first; i < last; ++i) {
      const Surface& s = drop.surface[i];
      const D fallen = flight.low - s.top, F = landing.share[l] * landing.overlap[i];
      d_F[i] =
          d_first + d.lands[i] + share * (d.mean_time * landing.time[i] + d.height * s.top + d.fallen * relu(fallen));
      d.time[i] += d.mean_time * share * F;
      d_flight.low += where(fallen > 0.0, d.fallen * share * F, D{});
      back_fall(flight.v.z, fallen, d.time[i], d_flight.v.z, d_flight.low);
    }
    d_arrives = back_level(back, l, d_arrives, d_F, d_overlap);
    for (int i = first; i < last; ++i)
      if (any(landing.overlap[i] > 0.0)) back_overlap(back, i, passage, reaches, d_reaches, d_overlap[i]);
  }
  d_reaches.flush(back);
}

// --- the state at release -------------------------------------------------------------------------------------------

static inline void back_tilt(int shape, const D axis[9], D d_tilt, D d_axis[9]) {
  if (shape == kBall) return;
  const D side = axis[6] * axis[6] + axis[7] * axis[7];
  for (int i = 6; i < 9; ++i)
    d_axis[i] -= 4.0 * d_tilt * axis[i] * (shape == kRound && i < 8 ? side : axis[i] * axis[i]);
}

// Stores the derivatives with respect to c, v and w in d; returns that with respect to a small rotation of the object.
static inline Vec<D> back_release(Backward& back) {
  auto& [tables, drop, X_W, flight, landing, d, d_landing] = back;
  const D inverse_speed = reciprocal(flight.speed);
  d.v.x += d.speed * flight.v.x * inverse_speed, d.v.y += d.speed * flight.v.y * inverse_speed;
  back_tilt(drop.part[drop.main].shape, flight.part[drop.main].axis, d.tilt, d.part[drop.main].axis);
  for (int p = 0; p < drop.n_part; ++p) {
    const D above = flight.part[p].bottom - flight.low,
            slope = d.part[p].stands * flight.part[p].stands * above * (-2.0 / (0.012 * 0.012));
    d.part[p].bottom += slope, d.low -= slope;
  }
  Vec<D> turn = {D{}, D{}, D{}};
  const auto add_turn = [&](const Vec<D>& arm, const Vec<D>& pull) {
    const Vec<D> t = cross(arm, pull);
    turn.x += t.x, turn.y += t.y, turn.z += t.z;
  };
  for (int p = 0; p < drop.n_part; ++p) {
    const FlyingPart& part = flight.part[p];
    auto& slope = d.part[p];
    const D up = reach(drop.part[p], part.axis + 6), top = flight.c.z + part.o.z + up;
    const D d_bottom = slope.bottom + where(part.bottom == flight.low, d.low, D{}),
            d_top = where(top == flight.high, d.high, D{});
    d.low = where(part.bottom == flight.low, D{}, d.low), d.high = where(top == flight.high, D{}, d.high);
    d.c.z += d_bottom + d_top, slope.o.z += d_bottom + d_top;
    D d_up[3];
    back_reach(drop.part[p], part.axis + 6, d_top - d_bottom, d_up);
    for (int i = 0; i < 3; ++i) slope.axis[6 + i] += d_up[i];
    const Vec<D> swing = cross(part.o, slope.u), pull = cross(slope.u, flight.w);
    d.v.x += slope.u.x, d.v.y += slope.u.y;
    d.w.x += swing.x, d.w.y += swing.y, d.w.z += swing.z;
    add_turn(part.o, {slope.o.x + pull.x, slope.o.y + pull.y, slope.o.z + pull.z});
    for (int i = 0; i < 3; ++i)
      add_turn({part.axis[i], part.axis[3 + i], part.axis[6 + i]},
               {slope.axis[i], slope.axis[3 + i], slope.axis[6 + i]});
  }
  return turn;
}

static inline D dot(const Vec<D>& a, const Vec<D>& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Maps derivatives with respect to the object's pose and velocity to the joints, from the object's link to the base. A
// joint turns (or shifts) the velocities contributed by joints beyond it, and moves the object in the velocity field of
// the joints before it.
static inline void back_joints(const Backward& back, const D* qd, const Vec<D>& d_turn, D* d_q, D* d_qd) {
  const auto& [tables, drop, X_W, flight, landing, d, d_landing] = back;
  for (int j = 0; j < tables.n_joint; ++j) d_q[j] = d_qd[j] = D{};
  // inner: w of the joints up to this one; outer: v and w of those beyond.
  Vec<D> inner = flight.w, v_outer = {D{}, D{}, D{}}, w_outer = {D{}, D{}, D{}};
  for (int l = drop.link; l >= 0; l = tables.link[l].parent) {
    const Link& joint = tables.link[l];
    if (joint.joint < 0) continue;
    const Frame<D>& X = X_W[l];
    const D rate = qd ? qd[joint.joint] : D{};
    const Vec<D> z = {X.R[2], X.R[5], X.R[8]};
    const Vec<D> lever = joint.slide ? z : cross(z, {flight.c.x - X.p.x, flight.c.y - X.p.y, flight.c.z - X.p.z});
    D slope = dot(d.c, lever) + dot(d.v, cross(inner, lever));
    d_qd[joint.joint] = dot(d.v, lever);
    if (!joint.slide) {
      slope += dot(d_turn, z) + dot(d.v, cross(z, v_outer)) + dot(d.w, cross(z, w_outer));
      d_qd[joint.joint] += dot(d.w, z);
      inner = {inner.x - rate * z.x, inner.y - rate * z.y, inner.z - rate * z.z};
      w_outer = {w_outer.x + rate * z.x, w_outer.y + rate * z.y, w_outer.z + rate * z.z};
    }
    d_q[joint.joint] = slope;
    v_outer = {v_outer.x + rate * lever.x, v_outer.y + rate * lever.y, v_outer.z + rate * lever.z};
  }
}

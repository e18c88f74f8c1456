// The gradient of the drop model's impact with respect to q and qd: drop.hpp in reverse mode. d_x is the derivative of
// the impact with respect to x. Each function takes derivatives with respect to the results of its namesake and adds to
// those with respect to its arguments.
#pragma once
#include "impact/drop.hpp"
#include "impact/flight/flight.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

template <class V> struct StopSlope {
  V time = {}, x = {}, y = {}, chance = {};
};

template <class V> struct FlightSlope {
  Vec<V> c = {V{}, V{}, V{}}, v = {V{}, V{}, V{}}, w = {V{}, V{}, V{}};
  V low = {}, high = {}, tilt = {}, speed = {};
  StopSlope<V> stop;
  struct Part {
    Vec<V> o, u;
    V axis[9], bottom, stands;
  } part[kMaxDropParts];

  explicit FlightSlope(const DropTables& drop) {
    for (int p = 0; p < drop.n_part; ++p) part[p] = Part{};
  }
};

template <class V> struct LandingSlope {
  V contact[kMaxSurfaces], time[kMaxSurfaces], lands[kMaxSurfaces];  // lands: F of each surface
  V first[kMaxSurfaces], leaving[kMaxSurfaces], leaves[kMaxSurfaces];
  Point2<V> away[kMaxSurfaces];
  V total = {}, mean_time = {}, height = {}, fallen = {}, x = {}, y = {}, blur = {};

  explicit LandingSlope(const DropTables& drop) {
    for (int k = 0; k < drop.n_surface; ++k) contact[k] = time[k] = lands[k] = V{};
    for (int l = 0; l < drop.n_level; ++l) first[l] = leaving[l] = leaves[l] = V{}, away[l] = {V{}, V{}};
  }
};

// The state of the reverse pass: one fall, and the derivatives with respect to its quantities.
template <class V> struct Backward {
  const Tables& tables;
  const DropTables& drop;
  const Frame<V>* X_W;
  const Flight<V>& flight;
  const Landing<V>& landing;
  FlightSlope<V> d_flight;
  LandingSlope<V> d_landing;

  Backward(const Tables& of, const DropTables& dropped, const Fall<V>& fall)
      : tables(of),
        drop(dropped),
        X_W(fall.X_W),
        flight(fall.flight),
        landing(fall.landing),
        d_flight(dropped),
        d_landing(dropped) {}
};

// --- functions ------------------------------------------------------------------------------------------------------

template <class V> static inline void back_turned(const Surface& s, const Point2<V>& d, V& d_x, V& d_y) {
  d_x += s.axis[0] * d.x - s.axis[1] * d.y;
  d_y += s.axis[1] * d.x + s.axis[0] * d.y;
}

// P(|x + noise| < A) and its derivatives: the difference of two logistic functions.
template <class V> struct Within {
  V value, x, A, inverse_scale;

  [[gnu::always_inline]] Within(V at, V half, V scale) {
    const V a = maximum(half, V{} + 1e-4), r = absolute(at);
    const V upper = reciprocal(1.0 + odds((r - a) * scale)), h = tail(-(r + a) * scale),
            lower = h * reciprocal(1.0 + h);
    const V up = upper * (1.0 - upper), low = lower * (1.0 - lower);
    value = upper - lower;
    x = where(at < 0.0, up - low, low - up) * scale;
    A = where(half > 1e-4, (up + low) * scale, V{});
    inverse_scale = (a - r) * up + (a + r) * low;
  }
};

// P(noise < u) and its derivative.
template <class V> struct Below {
  V value, u;

  explicit Below(V at) : value(reciprocal(1.0 + odds(at * (-1.0 / kBeta)))), u(value * (1.0 - value) * (1.0 / kBeta)) {}
};

template <class V> static inline void back_fall(V vz, V h, V d_t, V& d_vz, V& d_h) {
  const V soft = square_root(h * h + 1e-4), k = 0.5 * (h + soft), inverse = inverse_root(vz * vz + 2.0 * kGravity * k);
  d_vz += d_t * (1.0 + vz * inverse) * (1.0 / kGravity);
  d_h += d_t * inverse * k * reciprocal(soft);
}

template <class V> static inline void back_reach(const DropPart& part, const V d[3], V d_reach, V d_d[3]) {
  d_d[0] = d_d[1] = d_d[2] = V{};
  if (part.shape == kBall) return;
  if (part.shape == kFlat) {
    for (int i = 0; i < 3; ++i) d_d[i] = where(d[i] < 0.0, -d_reach, d_reach) * part.half[i];
    return;
  }
  const V left = 1.0 - d[2] * d[2], slope = where(left > 1e-12, d[2] * inverse_root(maximum(left, V{} + 1e-12)), V{});
  d_d[2] = d_reach * (where(d[2] < 0.0, V{} - part.half[2], V{} + part.half[2]) - part.half[0] * slope);
}

// Extent of a part in a horizontal direction u.
template <class V> static inline void back_reach_along(Backward<V>& back, int p, double ux, double uy, V d_reach) {
  const V* Q = back.flight.part[p].axis;
  V* slope = back.d_flight.part[p].axis;
  V d[3], d_d[3];
  for (int i = 0; i < 3; ++i) d[i] = Q[i] * ux + Q[3 + i] * uy;
  back_reach(back.drop.part[p], d, d_reach, d_d);
  for (int i = 0; i < 3; ++i) slope[i] += d_d[i] * ux, slope[3 + i] += d_d[i] * uy;
}

// Derivatives with respect to Reaches, summed over surfaces with the same axes.
template <class V> struct ReachSlope {
  const Surface* alike = nullptr;
  struct {
    V x, y, left, right;
  } part[kMaxDropParts];

  explicit ReachSlope(const DropTables& drop) { clear(drop); }
  void turn_to(Backward<V>& back, const Surface& s) {
    if (alike && alike->turn == s.turn) return;
    flush(back);
    alike = &s;
  }
  void flush(Backward<V>& back) {
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
    for (int p = 0; p < drop.n_part; ++p) part[p] = {V{}, V{}, V{}, V{}};
  }
};

// Displacement of a place by a side in the way (push); returns the derivative with respect to the time.
template <class V> static inline V back_pushed(Backward<V>& back, V time, V d_x, V d_y) {
  const SideStop<V>& stop = back.flight.stop;
  const auto after = time > stop.time;
  const V pushed = relu(time - stop.time), d_time = where(after, d_x * stop.x + d_y * stop.y, V{});
  StopSlope<V>& d = back.d_flight.stop;
  d.x += d_x * pushed, d.y += d_y * pushed, d.time -= d_time;
  return d_time;
}

// Place of the centre of mass at a time; returns the derivative with respect to the time.
template <class V> static inline V back_travelled(Backward<V>& back, V time, V d_x, V d_y) {
  back.d_flight.c.x += d_x, back.d_flight.c.y += d_y;
  back.d_flight.v.x += d_x * time, back.d_flight.v.y += d_y * time;
  return d_x * back.flight.v.x + d_y * back.flight.v.y + back_pushed(back, time, d_x, d_y);
}

// Place of the centre of mass when it passes a surface, in the surface's axes.
template <class V> static inline void back_passing(Backward<V>& back, int k, const Point2<V>& d) {
  V x = {}, y = {};
  back_turned(back.drop.surface[k], d, x, y);
  back.d_landing.time[k] += back_travelled(back, back.landing.time[k], x, y);
}

// --- 4. side contacts -----------------------------------------------------------------------------------------------

template <class V> struct SweepSlope {
  V x = {}, y = {}, reach = {}, inverse_scale = {}, top = {};
};

// H of a surface; returns the derivative with respect to `beside`.
template <class V>
static inline V back_sweep_hit(Backward<V>& back, const Sweep<V>& sweep, int k, V beside, V d_H, SweepSlope<V>& slope) {
  const DropTables& drop = back.drop;
  const Flight<V>& flight = back.flight;
  const Surface& s = drop.surface[k];
  const Below<V> over((sweep.top - s.bottom) * (1.0 / drop.constants.side_height));
  const Point2<V> from = passing(flight, s, back.landing.time[k]), to = placed(s, sweep.x, sweep.y);
  const V dx = to.x - from.x, dy = to.y - from.y;
  const V inverse_x = inverse_root(dx * dx + 1e-6), inverse_y = inverse_root(dy * dy + 1e-6);
  const Within<V> x(0.5 * (from.x + to.x), s.half[0] + sweep.reach + 0.5 * (dx * dx + 1e-6) * inverse_x,
                    sweep.inverse_scale);
  const Within<V> y(0.5 * (from.y + to.y), s.half[1] + sweep.reach + 0.5 * (dy * dy + 1e-6) * inverse_y,
                    sweep.inverse_scale);
  slope.top += d_H * beside * over.u * x.value * y.value * (1.0 / drop.constants.side_height);
  const V d_x = d_H * beside * over.value * y.value, d_y = d_H * beside * over.value * x.value;
  slope.inverse_scale += d_x * x.inverse_scale + d_y * y.inverse_scale;
  slope.reach += d_x * x.A + d_y * y.A;
  const Point2<V> middle = {0.5 * d_x * x.x, 0.5 * d_y * y.x},
                  length = {0.5 * d_x * x.A * dx * inverse_x, 0.5 * d_y * y.A * dy * inverse_y};
  back_turned(s, {middle.x + length.x, middle.y + length.y}, slope.x, slope.y);
  back_passing(back, k, {middle.x - length.x, middle.y - length.y});
  return d_H * over.value * x.value * y.value;
}

template <class V> static inline void back_sweep(Backward<V>& back, const Sweep<V>& sweep, const SweepSlope<V>& d) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const DropConstants& k = drop.constants;
  const Leaving<V> leaving(drop, landing);
  // 1/sqrt(V) has the derivative -V^-3/2 /2, and inverse_scale is 1/(beta sqrt(V)).
  const V d_variance =
      -0.5 * kBeta * kBeta * sweep.inverse_scale * sweep.inverse_scale * sweep.inverse_scale * d.inverse_scale;
  const double toppling = k.size_spread * drop.size, drift = k.drift * drop.size;
  const V d_leaves =
      d.reach * k.topple_reach * drop.size + d_variance * 2.0 * toppling * toppling * leaving.probability;
  d_landing.blur += d_variance;
  d_landing.mean_time += back_travelled(back, landing.mean_time + k.slide, d.x, d.y);
  d_landing.height += d.top;
  d_flight.high += d.top, d_flight.low -= d.top;
  for (int l = 0; l < drop.n_level; ++l) {
    const Point2<V>& n = landing.away[l];
    const V M = landing.leaving[l] * leaving.share;
    d_landing.leaving[l] += leaving.share * (d_leaves + drift * (d.x * n.x + d.y * n.y));
    d_landing.away[l].x += drift * d.x * M, d_landing.away[l].y += drift * d.y * M;
  }
  d_landing.total -= leaving.share * (d_leaves * leaving.probability + drift * (d.x * leaving.x + d.y * leaving.y));
}

// P that the object hits the side in its way; returns the derivative with respect to P of landing at all.
template <class V> static inline V back_brunt(Backward<V>& back, const SideImpact<V>& brunt, V d) {
  const SideStop<V>& stop = back.flight.stop;
  const V landed = back.landing.landed;
  back.d_flight.stop.chance += d * (1.0 - landed * (1.0 - brunt.before));
  const Step<V> before((back.landing.mean_time - stop.time) * (1.0 / kSideLate));
  const V d_time = d * stop.chance * landed * before.slope * (1.0 / kSideLate);
  back.d_landing.mean_time += d_time, back.d_flight.stop.time -= d_time;
  return -d * stop.chance * (1.0 - brunt.before);
}

// --- 2. support -----------------------------------------------------------------------------------------------------

// Returns the derivatives with respect to the moments.
template <class V>
static inline Moments<V> back_leaves(Backward<V>& back, const Moments<V>& m, V d_T, const Point2<V>& d_away) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const DropConstants& k = drop.constants;
  Moments<V> d;
  const V share = reciprocal(m.area + 1e-6), ex = m.x * share, ey = m.y * share;
  const V xx = m.xx * share - ex * ex + 1e-5, yy = m.yy * share - ey * ey + 1e-5, xy = m.xy * share - ex * ey;
  const V plain = xx * yy - xy * xy, det = maximum(plain, V{} + 1e-11), inverse_det = reciprocal(det),
          inverse_trace = reciprocal(xx + yy);
  const V d2 = (yy * ex * ex - 2.0 * xy * ex * ey + xx * ey * ey) * inverse_det, part = reciprocal(3.0 + d2),
          off = d2 * part;
  const V height = flight.c.z - flight.low, inverse = inverse_root(ex * ex + ey * ey + 1e-6),
          soft = height * height + 1e-6;
  const Below<V> T(k.leave + 2.0 * k.leave_offset * (off - 0.5) + k.leave_speed * flight.speed +
                   2.0 * k.leave_tilt * flight.tilt +
                   0.5 * k.leave_narrow * logarithm(soft * (xx + yy) * reciprocal(3.0 * det)));
  const V d_u = d_T * T.u, d_log = 0.5 * k.leave_narrow * d_u, d_height = d_log * 2.0 * height * reciprocal(soft);
  d_flight.speed += k.leave_speed * d_u, d_flight.tilt += 2.0 * k.leave_tilt * d_u;
  d_flight.c.z += d_height, d_flight.low -= d_height;
  const V along = d_away.x * ex + d_away.y * ey;
  const V d_off = 2.0 * k.leave_offset * d_u - along * inverse, d_d2 = d_off * 3.0 * part * part,
          d_quadric = d_d2 * inverse_det;
  const V d_det = where(plain > 1e-11, -d_log * inverse_det - d_d2 * d2 * inverse_det, V{});
  const V cube = off * along * inverse * inverse * inverse;
  V d_ex = -off * inverse * d_away.x + cube * ex + 2.0 * d_quadric * (yy * ex - xy * ey);
  V d_ey = -off * inverse * d_away.y + cube * ey + 2.0 * d_quadric * (xx * ey - xy * ex);
  const V d_xx = d_log * inverse_trace + d_quadric * ey * ey + d_det * yy,
          d_yy = d_log * inverse_trace + d_quadric * ex * ex + d_det * xx;
  const V d_xy = -2.0 * (d_quadric * ex * ey + d_det * xy);
  d_ex -= 2.0 * ex * d_xx + ey * d_xy, d_ey -= 2.0 * ey * d_yy + ex * d_xy;
  d.x = d_ex * share, d.y = d_ey * share, d.xx = d_xx * share, d.yy = d_yy * share, d.xy = d_xy * share;
  d.area = -share * share * (d_ex * m.x + d_ey * m.y + d_xx * m.xx + d_yy * m.yy + d_xy * m.xy);
  return d;
}

template <class V> struct IntervalSlope {
  V o, r, at;
};

// One axis of the rectangle of contact on a surface, from the larger lower end to the smaller upper end.
template <class V> static inline IntervalSlope<V> back_interval(V o, V r, double carries, V at, V d_middle, V d_width) {
  const V d0 = 0.5 * d_middle - d_width, d1 = 0.5 * d_middle + d_width;
  const auto own0 = o - r > -carries - at, own1 = o + r < carries - at;
  const V lower = where(own0, d0, V{}), upper = where(own1, d1, V{});
  return {lower + upper, upper - lower, -(where(own0, V{}, d0) + where(own1, V{}, d1))};
}

template <class V>
static inline void back_moments(Backward<V>& back, int k, Reaches<V>& reaches, ReachSlope<V>& d_reaches,
                                const Moments<V>& d) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const Surface& s = drop.surface[k];
  const Point2<V> at = passing(flight, s, landing.time[k]);
  if (!any((absolute(at.x) < s.carries[0] + drop.radius) & (absolute(at.y) < s.carries[1] + drop.radius))) return;
  reaches.turn_to(drop, flight, s);
  d_reaches.turn_to(back, s);
  const double c = s.axis[0], n = s.axis[1];
  Point2<V> d_at = {V{}, V{}};
  for (int p = 0; p < drop.n_part; ++p) {
    const FlyingPart<V>& part = flight.part[p];
    const auto& r = reaches.part[p];
    const Point2<V> o = turned(s, part.o.x, part.o.y);
    const V x0 = maximum(o.x - r.x, -s.carries[0] - at.x), x1 = minimum(o.x + r.x, s.carries[0] - at.x);
    const V y0 = maximum(o.y - r.y, -s.carries[1] - at.y), y1 = minimum(o.y + r.y, s.carries[1] - at.y);
    const V wx = relu(x1 - x0), wy = relu(y1 - y0), patch = part.stands * wx * wy, mx = 0.5 * (x0 + x1),
            my = 0.5 * (y0 + y1);
    if (!any(patch > 0.0)) continue;
    const V ux = c * mx - n * my, uy = n * mx + c * my, qx = wx * wx * (1.0 / 12), qy = wy * wy * (1.0 / 12);
    const V d_patch = d.area + d.x * ux + d.y * uy + d.xx * (ux * ux + c * c * qx + n * n * qy) +
                      d.yy * (uy * uy + n * n * qx + c * c * qy) + d.xy * (ux * uy + c * n * (qx - qy));
    const V d_ux = patch * (d.x + 2.0 * d.xx * ux + d.xy * uy), d_uy = patch * (d.y + 2.0 * d.yy * uy + d.xy * ux);
    const V d_qx = patch * (d.xx * c * c + d.yy * n * n + d.xy * c * n),
            d_qy = patch * (d.xx * n * n + d.yy * c * c - d.xy * c * n);
    const V d_wx = where(x1 > x0, d_patch * part.stands * wy + d_qx * wx * (1.0 / 6), V{});
    const V d_wy = where(y1 > y0, d_patch * part.stands * wx + d_qy * wy * (1.0 / 6), V{});
    d_flight.part[p].stands += d_patch * wx * wy;
    const IntervalSlope<V> along = back_interval(o.x, r.x, s.carries[0], at.x, c * d_ux + n * d_uy, d_wx);
    const IntervalSlope<V> across = back_interval(o.y, r.y, s.carries[1], at.y, c * d_uy - n * d_ux, d_wy);
    back_turned(s, {along.o, across.o}, d_flight.part[p].o.x, d_flight.part[p].o.y);
    d_reaches.part[p].x += along.r, d_reaches.part[p].y += across.r;
    d_at.x += along.at, d_at.y += across.at;
  }
  back_passing(back, k, d_at);
}

// --- 1. first contact -----------------------------------------------------------------------------------------------

template <class V>
static inline void back_overlap(Backward<V>& back, int surface, Passage<V>& passage, Reaches<V>& reaches,
                                ReachSlope<V>& d_reaches, V d_D) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const DropConstants& k = drop.constants;
  const Surface& s = drop.surface[surface];
  passage.move_to(drop, flight, s.top);
  passage.detail(drop, flight);
  reaches.turn_to(drop, flight, s);
  d_reaches.turn_to(back, s);
  for (int p = 0; p < drop.n_part; ++p) {
    const FlyingPart<V>& flying = flight.part[p];
    const auto& part = passage.part[p];
    const auto& r = reaches.part[p];
    const auto decides = landing.foremost[surface] == double(p);
    if (!any(decides)) continue;
    const Point2<V> at = placed(s, part.x, part.y);
    const Within<V> x(at.x, s.half[0] + r.x, part.inverse_scale), y(at.y, s.half[1] + r.y, part.inverse_scale);
    const Within<V> left((at.x + at.y) * kHalfRoot, s.diagonal + r.left, part.inverse_scale);
    const Within<V> right((at.y - at.x) * kHalfRoot, s.diagonal + r.right, part.inverse_scale);
    const V h = flying.bottom - s.top;
    const Below<V> gate(h * (1.0 / kTouch) + 1.0);
    const V upright = x.value * y.value, slanted = left.value * right.value, d = where(decides, d_D, V{});
    const V gated = d * gate.value, d_x = gated * y.value * slanted, d_y = gated * x.value * slanted;
    const V d_left = gated * upright * right.value, d_right = gated * upright * left.value;
    auto& d_reach = d_reaches.part[p];
    d_reach.x += d_x * x.A, d_reach.y += d_y * y.A, d_reach.left += d_left * left.A, d_reach.right += d_right * right.A;
    V wx = {}, wy = {};
    back_turned(s,
                {d_x * x.x + (d_left * left.x - d_right * right.x) * kHalfRoot,
                 d_y * y.x + (d_left * left.x + d_right * right.x) * kHalfRoot},
                wx, wy);
    const V t = fall(flight.v.z, h), time = t + k.delay;
    d_flight.c.x += wx, d_flight.c.y += wy;
    auto& d_part = d_flight.part[p];
    d_part.o.x += wx, d_part.o.y += wy, d_part.u.x += wx * time, d_part.u.y += wy * time;
    const V d_scale =
        d_x * x.inverse_scale + d_y * y.inverse_scale + d_left * left.inverse_scale + d_right * right.inverse_scale;
    const V cube = part.inverse_scale * part.inverse_scale * part.inverse_scale * (kBeta * kBeta);
    const V d_t = wx * flying.u.x + wy * flying.u.y + back_pushed(back, time, wx, wy) -
                  d_scale * cube * (k.velocity_spread * k.velocity_spread) * t;
    back_fall(flight.v.z, h, d_t, d_flight.v.z, d_part.bottom);
    d_part.bottom += d * upright * slanted * gate.u * (1.0 / kTouch);
  }
}

// --- steps 1 and 2 for all levels -----------------------------------------------------------------------------------

// Maps derivatives with respect to C and F of each surface to derivatives with respect to D; returns that with respect
// to A.
template <class V>
static inline V back_level(const Backward<V>& back, int level, V d_next, const V* d_F, V* d_overlap) {
  const DropTables& drop = back.drop;
  const Landing<V>& landing = back.landing;
  const V* d_contact = back.d_landing.contact;
  const int first = drop.level_start[level], last = drop.level_start[level + 1];
  const V A = landing.arrives[level];
  V before[kMaxSurfaces], sum = {}, missed = V{} + 1.0, weighed = {}, d_A = {};
  for (int k = first; k < last; ++k) {
    const V overlap = landing.overlap[k];
    before[k] = missed;
    sum += overlap, missed *= 1.0 - overlap, weighed += d_F[k] * overlap, d_A += d_contact[k] * overlap;
  }
  const V inverse = reciprocal(sum + kLeastMass), share = (1.0 - missed) * inverse;
  const V d_missed = d_next * A - weighed * A * inverse, d_sum = -weighed * A * share * inverse;
  V after = V{} + 1.0;
  for (int k = last; k-- > first;) {
    d_overlap[k] = d_contact[k] * A + d_F[k] * A * share + d_sum - d_missed * before[k] * after;
    after *= 1.0 - landing.overlap[k];
  }
  return d_A + weighed * share + d_next * missed;
}

template <class V> static inline void back_land(Backward<V>& back) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d] = back;
  const DropConstants& k = drop.constants;
  d.mean_time += 2.0 * k.velocity_spread * k.velocity_spread * landing.mean_time * d.blur;
  d.fallen += 2.0 * k.height_spread * k.height_spread * landing.fallen * d.blur;
  d.mean_time += back_travelled(back, landing.mean_time, d.x, d.y);
  const V share = reciprocal(landing.total);
  const V d_total =
      d.total - share * (d.mean_time * landing.mean_time + d.height * landing.height + d.fallen * landing.fallen);
  Passage<V> passage;
  Reaches<V> reaches;
  ReachSlope<V> d_reaches(drop);
  V d_F[kMaxSurfaces], d_overlap[kMaxSurfaces], d_arrives = {};
  for (int l = drop.n_level; l-- > 0;) {
    const int first = drop.level_start[l], last = drop.level_start[l + 1];
    V d_first = d.first[l] + d_total;
    if (any(landing.leaving[l] > 0.0)) {
      Moments<V> moments;
      for (int i = first; i < last; ++i) {
        const Surface& s = drop.surface[i];
        moments.add(drop, flight, s, passing(flight, s, landing.time[i]), reaches);
      }
      d_first += d.leaving[l] * landing.leaves[l];
      const Moments<V> d_moments = back_leaves(back, moments, d.leaving[l] * landing.first[l] + d.leaves[l], d.away[l]);
      for (int i = first; i < last; ++i) back_moments(back, i, reaches, d_reaches, d_moments);
    }
    for (int i = first; i < last; ++i) {
      const Surface& s = drop.surface[i];
      const V fallen = flight.low - s.top, F = landing.share[l] * landing.overlap[i];
      d_F[i] =
          d_first + d.lands[i] + share * (d.mean_time * landing.time[i] + d.height * s.top + d.fallen * relu(fallen));
      d.time[i] += d.mean_time * share * F;
      d_flight.low += where(fallen > 0.0, d.fallen * share * F, V{});
      back_fall(flight.v.z, fallen, d.time[i], d_flight.v.z, d_flight.low);
    }
    d_arrives = back_level(back, l, d_arrives, d_F, d_overlap);
    for (int i = first; i < last; ++i)
      if (any(landing.overlap[i] > 0.0)) back_overlap(back, i, passage, reaches, d_reaches, d_overlap[i]);
  }
  d_reaches.flush(back);
}

// --- the state at release -------------------------------------------------------------------------------------------

template <class V> static inline void back_tilt(int shape, const V axis[9], V d_tilt, V d_axis[9]) {
  if (shape == kBall) return;
  const V side = axis[6] * axis[6] + axis[7] * axis[7];
  for (int i = 6; i < 9; ++i)
    d_axis[i] -= 4.0 * d_tilt * axis[i] * (shape == kRound && i < 8 ? side : axis[i] * axis[i]);
}

// Stores the derivatives with respect to c, v and w in d; returns that with respect to a small rotation of the object.
template <class V> static inline Vec<V> back_release(Backward<V>& back) {
  auto& [tables, drop, X_W, flight, landing, d, d_landing] = back;
  const V inverse_speed = reciprocal(flight.speed);
  d.v.x += d.speed * flight.v.x * inverse_speed, d.v.y += d.speed * flight.v.y * inverse_speed;
  back_tilt(drop.part[drop.main].shape, flight.part[drop.main].axis, d.tilt, d.part[drop.main].axis);
  for (int p = 0; p < drop.n_part; ++p) {
    const V above = flight.part[p].bottom - flight.low,
            slope = d.part[p].stands * flight.part[p].stands * above * (-2.0 / (0.012 * 0.012));
    d.part[p].bottom += slope, d.low -= slope;
  }
  Vec<V> turn = {V{}, V{}, V{}};
  const auto add_turn = [&](const Vec<V>& arm, const Vec<V>& pull) {
    const Vec<V> t = cross(arm, pull);
    turn.x += t.x, turn.y += t.y, turn.z += t.z;
  };
  for (int p = 0; p < drop.n_part; ++p) {
    const FlyingPart<V>& part = flight.part[p];
    auto& slope = d.part[p];
    const V up = reach(drop.part[p], part.axis + 6), top = flight.c.z + part.o.z + up;
    const V d_bottom = slope.bottom + where(part.bottom == flight.low, d.low, V{}),
            d_top = where(top == flight.high, d.high, V{});
    d.low = where(part.bottom == flight.low, V{}, d.low), d.high = where(top == flight.high, V{}, d.high);
    d.c.z += d_bottom + d_top, slope.o.z += d_bottom + d_top;
    V d_up[3];
    back_reach(drop.part[p], part.axis + 6, d_top - d_bottom, d_up);
    for (int i = 0; i < 3; ++i) slope.axis[6 + i] += d_up[i];
    const Vec<V> swing = cross(part.o, slope.u), pull = cross(slope.u, flight.w);
    d.v.x += slope.u.x, d.v.y += slope.u.y;
    d.w.x += swing.x, d.w.y += swing.y, d.w.z += swing.z;
    add_turn(part.o, {slope.o.x + pull.x, slope.o.y + pull.y, slope.o.z + pull.z});
    for (int i = 0; i < 3; ++i)
      add_turn({part.axis[i], part.axis[3 + i], part.axis[6 + i]},
               {slope.axis[i], slope.axis[3 + i], slope.axis[6 + i]});
  }
  return turn;
}

// Maps derivatives with respect to the object's pose and velocity to the joints, from the object's link to the base. A
// joint turns (or shifts) the velocities contributed by joints beyond it, and moves the object in the velocity field of
// the joints before it.
template <class V>
static inline void back_joints(const Backward<V>& back, const V* qd, const Vec<V>& d_turn, V* d_q, V* d_qd) {
  const auto& [tables, drop, X_W, flight, landing, d, d_landing] = back;
  for (int j = 0; j < tables.n_joint; ++j) d_q[j] = d_qd[j] = V{};
  // inner: w of the joints up to this one; outer: v and w of those beyond.
  Vec<V> inner = flight.w, v_outer = {V{}, V{}, V{}}, w_outer = {V{}, V{}, V{}};
  for (int l = drop.link; l >= 0; l = tables.link[l].parent) {
    const Link& joint = tables.link[l];
    if (joint.joint < 0) continue;
    const Frame<V>& X = X_W[l];
    const V rate = qd ? qd[joint.joint] : V{};
    const Vec<V> z = {X.R[2], X.R[5], X.R[8]};
    const Vec<V> lever = joint.slide ? z : cross(z, {flight.c.x - X.p.x, flight.c.y - X.p.y, flight.c.z - X.p.z});
    V slope = dot(d.c, lever) + dot(d.v, cross(inner, lever));
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

}  // namespace gp::GP_ISA

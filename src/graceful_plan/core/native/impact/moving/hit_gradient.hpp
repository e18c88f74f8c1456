// The gradient of P that a moving entity is hit: hit.hpp in reverse mode, back to the quantities of a fall;
// drop_gradient.hpp does the rest.
#pragma once
#include <cstddef>

#include "cutoffs.hpp"
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "impact/flight/flight_gradient.hpp"
#include "impact/moving/hit.hpp"
#include "impact/moving/path.hpp"
#include "impact/moving/tables.hpp"
#include "impact/own_loss.hpp"
#include "impact/tumble_gradient.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA::moving {

// Derivatives with respect to the quantities of a fall and to the time, summed over lanes at the end.
struct DroppedSlope {
  D v[3] = {}, low = {}, nothing = {}, time = {}, landed[2] = {}, rest[2] = {}, start[2] = {};
  D fall_variance = {}, side_variance = {}, side_reach = {}, side_top = {}, clock = {};
  struct Part {
    D o[2], u[2], axis[6], bottom, top;
  } part[kMaxDropParts];
  D mass[kMaxSurfaces], times[kMaxSurfaces];
  double left[kMaxSurfaces + 1], loose[kMaxSurfaces + 1], drift[kMaxSurfaces + 1][2];

  explicit DroppedSlope(const DropTables& drop) {
    for (int p = 0; p < drop.n_part; ++p) part[p] = Part{};
    for (int l = 0; l <= drop.n_level; ++l) left[l] = loose[l] = drift[l][0] = drift[l][1] = 0;
    for (int l = 0; l < drop.n_level; ++l) mass[l] = times[l] = D{};
  }
};

// Derivatives with respect to a relative motion: its ends, directions and extents; and to rotations of motion and
// entity.
struct WaySlope {
  Point2<D> from = {D{}, D{}}, to = {D{}, D{}};
  D x[5] = {}, y[5] = {}, reach[5] = {}, inverse_scale = {}, move = {}, yaw = {};

  WaySlope(const Way& way, D d) {
    const Within<D> of[4] = {way.within(0), way.within(1), way.within(2), way.within(3)};
    D others = D{} + 1.0, before[4];
    for (int i = 0; i < 4; ++i) before[i] = others, others *= of[i].value;
    if (way.u.n == 5) {
      const Within<D> fifth = way.within(4);
      const auto less = fifth.value < others;
      add(way, 4, fifth, where(less, d, D{}));
      d = where(less, D{}, d);
    }
    D after = d;
    for (int i = 4; i-- > 0;) add(way, i, of[i], before[i] * after), after *= of[i].value;
  }
  // Extents of the entity with a margin; returns the derivative with respect to the margin.
  D back_outline(const Way& way, const Outline& o, D margin) {
    D d_margin = {};
    for (int i = 0; i < way.u.n; ++i) {
      D d_turn;
      d_margin += back_reach_of(o, o.cosine * way.u.x[i] + o.sine * way.u.y[i],
                                o.cosine * way.u.y[i] - o.sine * way.u.x[i], margin, reach[i], d_turn);
      if (i < 4) continue;  // the other directions turn with the entity
      move += d_turn, yaw -= d_turn;
    }
    return d_margin;
  }
  // Maps derivatives with respect to directions to those with respect to the motion, which it returns.
  Point2<D> back_directions(const Way& way) {
    const Directions& u = way.u;
    for (int i = 0; i < u.n; ++i) (u.n == 4 || i == 4 ? move : yaw) += y[i] * u.x[i] - x[i] * u.y[i];
    return {move * u.turn_x, move * u.turn_y};
  }
  // Derivative with respect to the variance of the place, given that with respect to 1 / (beta sqrt(variance)).
  static D variance(D inverse_scale, D d) {
    return -0.5 * kBeta * kBeta * inverse_scale * inverse_scale * inverse_scale * d;
  }
  // Extent of an outline in a direction (c, s) in its axes; d_turn: derivative with respect to the direction's angle.
  static D back_reach_of(const Outline& o, D c, D s, D margin, D d, D& d_turn) {
    d_turn = D{};
    if (o.round) return where(o.a + margin > 1e-4, d, D{});
    const D along = absolute(c), across = absolute(s), a = o.a + margin, b = o.b + margin;
    const D held = where(a * along + b * across > 1e-4, d, D{});
    d_turn = held * (where(s < 0.0, -b, b) * c - where(c < 0.0, -a, a) * s);
    return held * (along + across);
  }

 private:
  void add(const Way& way, int i, const Within<D>& of, D d) {
    const D ux = way.u.x[i], uy = way.u.y[i];
    const D x0 = ux * way.from.x + uy * way.from.y, x1 = ux * way.to.x + uy * way.to.y;
    const D middle = 0.5 * d * of.x, half = d * of.A, length = where(x1 < x0, -0.5 * half, 0.5 * half);
    const D d0 = middle - length, d1 = middle + length;
    reach[i] += half, inverse_scale += d * of.inverse_scale;
    from.x += ux * d0, from.y += uy * d0, to.x += ux * d1, to.y += uy * d1;
    x[i] += way.from.x * d0 + way.to.x * d1, y[i] += way.from.y * d0 + way.to.y * d1;
  }
};

struct HitBack {
  const PathMeeting& of;
  const Hit& hit;
  DroppedSlope& slope;
  const Person who;
  D d_top = {}, d_bottom = {}, d_yaw = {}, d_lower = {}, d_down = {};

  HitBack(const PathMeeting& meeting, const Hit& h, DroppedSlope& s)
      : of(meeting), hit(h), slope(s), who(h.person(meeting)) {}

  void run(D d) {
    const D free_D = 1.0 - hit.D_, free_G = 1.0 - hit.G, free_H = 1.0 - hit.H;
    D d_D = d * free_G * free_H;
    const D d_G = d * free_D * free_H, d_H = d * free_D * free_G;
    const auto stays = hit.lower > hit.D_;
    const D d_stays = where(stays, d_H * hit.beside, D{});
    d_lower += d_stays, d_D -= d_stays;
    if (any(hit.beside > 0.0)) back_slide(where(stays, d_H * (hit.lower - hit.D_), D{}));
    if (any(hit.G > 0.0)) back_fall_off(d_G);
    d_lower += d_D * hit.passes, slope.nothing += d_D * hit.passes;
    back_fly(d_D * (hit.lower + of.fall.nothing));
    back_come_down();
    slope.clock += (d_top + d_bottom) * hit.rise + d_yaw * hit.turning;
  }

 private:
  // A place relative to the entity at a time; returns the derivative with respect to the time.
  static D back_place(const Person::Place& at, const Point2<D>& d) { return -(at.vx * d.x + at.vy * d.y); }

  void back_slide(D d) {
    const double softness = 1.0 / of.drop.constants.side_height;
    const Below<D> above(hit.over_side(of));
    const D d_above = d * hit.over * above.u * softness;
    slope.side_top += d_above, d_bottom -= d_above;
    WaySlope way(hit.slides, d * above.value);
    slope.side_reach += way.back_outline(hit.slides, hit.outline, D{} + of.fall.side_reach);
    const Point2<D> move = way.back_directions(hit.slides);
    way.to.x += move.x, way.to.y += move.y, way.from.x -= move.x, way.from.y -= move.y;
    d_yaw += way.yaw;
    const D t = hit.time + of.fall.time, d_variance = WaySlope::variance(hit.slides.inverse_scale, way.inverse_scale);
    slope.landed[0] += way.from.x, slope.landed[1] += way.from.y;
    slope.rest[0] += way.to.x, slope.rest[1] += way.to.y, slope.side_variance += d_variance;
    const D d_t = back_place(who.at(t), way.from) + back_place(who.at(t + kRoam), way.to) +
                  d_variance * who.variance(t + kRoam).rate;
    slope.time += d_t, slope.clock += d_t;
  }

  void back_fall_off(D d) {
    const Way& falls = hit.falls;
    const auto swept = hit.loose * hit.meets <= hit.left * hit.beyond;
    const D d_swept = where(swept, d, D{}), d_past = where(swept, D{}, d);
    D d_loose = d_swept * hit.meets;
    WaySlope way(falls, d_swept * hit.loose);
    const D margin = D{} + of.drop.constants.tumble_reach * of.drop.size;
    way.back_outline(falls, hit.outline, margin);
    const Point2<D> move = way.back_directions(falls);
    way.to.x += move.x, way.to.y += move.y, way.from.x -= move.x, way.from.y -= move.y;
    Point2<D> d_point = {D{}, D{}};
    if (any(d_past * hit.left != 0.0)) back_edges(d_past * hit.left, way, d_point);
    d_yaw += way.yaw;
    d_point.x += way.from.x + way.to.x, d_point.y += way.from.y + way.to.y;
    slope.start[0] += d_point.x, slope.start[1] += d_point.y;
    const D share = reciprocal(hit.loose + kLeastMass), moved = of.drop.constants.drift * of.drop.size * share;
    d_loose -= (d_point.x * hit.drift.x + d_point.y * hit.drift.y) * moved * share;
    for (int i = 0; i < kAbreast<D>; ++i) {
      const int level = int(hit.higher[i]);
      slope.loose[level] += d_loose[i], slope.left[level] += d_past[i] * hit.beyond[i];
      slope.drift[level][0] += d_point.x[i] * moved[i], slope.drift[level][1] += d_point.y[i] * moved[i];
    }
    const D t = hit.time + (of.fall.time + kRoam),
            d_variance = WaySlope::variance(falls.inverse_scale, way.inverse_scale);
    slope.fall_variance += d_variance;
    const D d_t = back_place(who.at(t - 0.5 * kRoam), way.from) + back_place(who.at(t + 0.5 * kRoam), way.to) +
                  d_variance * who.variance(t).rate;
    slope.time += d_t, slope.clock += d_t;
  }
  // The parts of wide tops that do not cover the entity.
  void back_edges(D d, WaySlope& way, Point2<D>& d_point) {
    for (int s = 0; s < of.drop.n_surface; ++s) {
      const auto mine = hit.edge == double(s);
      if (!any(mine)) continue;
      const Hit::Edge edge(of, hit, s);
      const D left = edge.whole() - edge.covered();
      back_edge(edge, s, where(mine & (left > 0.0), d, D{}), way, d_point);
    }
  }
  void back_edge(const Hit::Edge& edge, int surface, D d, WaySlope& way, Point2<D>& d_point) {
    const Surface& s = of.drop.surface[surface];
    const D d_covered = where(edge.hides(), -d, D{});
    D d_offset[2], d_there[2], d_entity[2];
    for (int j = 0; j < 2; ++j) {
      const Within<D> whole = edge.whole_of(j), covered = edge.covered_of(j);
      const D d_w = d * edge.whole_of(1 - j).value, d_c = d_covered * edge.covered_of(1 - j).value;
      way.inverse_scale += d_w * whole.inverse_scale + d_c * covered.inverse_scale;
      const D d_x = d_c * covered.x, d_half = 0.5 * d_c * covered.A;
      const D d_low = where(edge.entity[j] - edge.reach[j] > -edge.half[j], -0.5 * d_x - d_half, D{});
      const D d_high = where(edge.entity[j] + edge.reach[j] < edge.half[j], d_half - 0.5 * d_x, D{});
      d_offset[j] = d_w * whole.x, d_there[j] = d_x, d_entity[j] = d_low + d_high;
      back_edge_reach(s, j, d_w * whole.A + d_high - d_low, way);
    }
    Point2<D> offset = {D{}, D{}}, there = {D{}, D{}}, entity = {D{}, D{}};
    back_turned(s, {d_offset[0], d_offset[1]}, offset.x, offset.y);
    back_turned(s, {d_there[0], d_there[1]}, there.x, there.y);
    back_turned(s, {d_entity[0], d_entity[1]}, entity.x, entity.y);
    // Ends of the relative motion are the point minus the entity's places, so derivatives added to them return to the
    // point.
    const D between_x = 0.5 * (offset.x - entity.x), between_y = 0.5 * (offset.y - entity.y);
    way.from.x += between_x, way.to.x += between_x, way.from.y += between_y, way.to.y += between_y;
    d_point.x += there.x + entity.x, d_point.y += there.y + entity.y;
  }
  void back_edge_reach(const Surface& s, int j, D d, WaySlope& way) const {
    const double x = Extents<D>::axis_x(s, j), y = Extents<D>::axis_y(s, j);
    const Outline& o = hit.outline;
    const D half_x = 0.5 * __builtin_fabs(x) * d, half_y = 0.5 * __builtin_fabs(y) * d;
    const D mx = where(hit.falls.to.x < hit.falls.from.x, -half_x, half_x),
            my = where(hit.falls.to.y < hit.falls.from.y, -half_y, half_y);
    way.to.x += mx, way.from.x -= mx, way.to.y += my, way.from.y -= my;
    D d_turn;
    WaySlope::back_reach_of(o, o.cosine * x + o.sine * y, o.cosine * y - o.sine * x,
                            D{} + of.drop.constants.tumble_reach * of.drop.size, d, d_turn);
    way.yaw -= d_turn;
  }

  void back_fly(D d) {
    Point2<D> move_slope = {D{}, D{}};
    for (int p = 0; p < of.drop.n_part; ++p) {
      const auto mine = hit.foremost == double(p);
      if (!any(mine)) continue;
      const D own = where(mine, d, D{});
      D first, last;
      const Way way = hit.past(of, p, first, last);
      const Below<D> above(hit.above_bottom(of, p));
      auto& part = slope.part[p];
      const D d_above = own * way.met() * above.u * (1.0 / kSideSoft);
      part.top += d_above, d_bottom -= d_above;
      WaySlope d_way(way, own * above.value);
      d_way.back_outline(way, hit.outline, D{});
      back_part_reach(p, way, d_way);
      const Point2<D> d_move = d_way.back_directions(way);
      move_slope.x += d_move.x, move_slope.y += d_move.y;
      d_yaw += d_way.yaw;
      back_times(p, way, d_way, first, last);
    }
    // The motion is that of the centre of mass relative to the entity until landing.
    const Person::Place now = who.at(hit.time), then = who.at(hit.time + hit.down);
    slope.v[0] += move_slope.x * hit.down, slope.v[1] += move_slope.y * hit.down;
    d_down += move_slope.x * (of.fall.v[0] - then.vx) + move_slope.y * (of.fall.v[1] - then.vy);
    slope.clock += move_slope.x * (now.vx - then.vx) + move_slope.y * (now.vy - then.vy);
  }
  void back_part_reach(int p, const Way& way, WaySlope& d_way) {
    const auto& part = of.fall.part[p];
    for (int i = 0; i < way.u.n; ++i) {
      D d[3], d_d[3];
      for (int j = 0; j < 3; ++j) d[j] = part.axis[j] * way.u.x[i] + part.axis[3 + j] * way.u.y[i];
      back_reach(of.drop.part[p], d, d_way.reach[i], d_d);
      for (int j = 0; j < 3; ++j) {
        slope.part[p].axis[j] += d_d[j] * way.u.x[i], slope.part[p].axis[3 + j] += d_d[j] * way.u.y[i];
        d_way.x[i] += d_d[j] * part.axis[j], d_way.y[i] += d_d[j] * part.axis[3 + j];
      }
    }
  }
  // Maps derivatives with respect to the ends of a part's motion to those with respect to its times.
  void back_times(int p, const Way& way, const WaySlope& d_way, D first, D last) {
    const DropConstants& k = of.drop.constants;
    const auto& part = of.fall.part[p];
    auto& d_part = slope.part[p];
    const D middle = 0.5 * (first + last), d_variance = WaySlope::variance(way.inverse_scale, d_way.inverse_scale);
    const D late = d_variance * who.variance(hit.time + middle).rate;
    D clock = late;
    const D d_middle = 0.5 * (late + d_variance * 2.0 * k.velocity_spread * k.velocity_spread * middle);
    const auto back_end = [&](D t, const Point2<D>& d) {
      const D theirs = back_place(who.at(hit.time + t), d);
      d_part.o[0] += d.x, d_part.o[1] += d.y, d_part.u[0] += d.x * t, d_part.u[1] += d.y * t;
      clock += theirs;
      return theirs + part.u[0] * d.x + part.u[1] * d.y + d_middle;
    };
    D d_first = back_end(first, d_way.from);
    const D d_last = back_end(last, d_way.to);
    const auto at_once = first >= hit.down;
    d_first += where(at_once, d_last, D{}), d_down += where(at_once, D{}, d_last);
    slope.clock += clock;
    D d_h = {};
    back_fall(D{} + of.fall.v[2], part.bottom - hit.top, d_first, slope.v[2], d_h);
    d_part.bottom += d_h, d_top -= d_h;
  }

  void back_come_down() {
    const DropTables& drop = of.drop;
    const D share = reciprocal(hit.lower + (of.fall.nothing + kLeastMass)), d_sum = d_down * share;
    slope.nothing += d_sum * (hit.fallen - hit.down);
    d_lower -= d_sum * hit.down;
    D d_h = {};
    back_fall(D{} + of.fall.v[2], of.fall.low - hit.bottom, d_sum * of.fall.nothing, slope.v[2], d_h);
    slope.low += d_h, d_bottom -= d_h;
    for (int l = 0; l < drop.n_level; ++l) {
      if (!(of.fall.mass[l] > kNothing<D>)) continue;
      const Below<D> lower(hit.below(of, l));
      const D d = d_lower + d_sum * of.fall.times[l];
      slope.mass[l] += d * lower.value, slope.times[l] += d_sum * of.fall.mass[l] * lower.value;
      d_top += d * of.fall.mass[l] * lower.u * (1.0 / kLevelSoft);
    }
  }
};

// Derivatives with respect to falls side by side, collected state by state.
struct FallingSlope : BuiltInPlace {
  Backward<D> back;
  SweepSlope<D> d_sweep;
  TumbleSlope<D> d_tumble;
  D top[kMaxDropParts], loose[kMaxSurfaces + 1];
  Point2<D> drift[kMaxSurfaces + 1];

  FallingSlope(const Tables& tables, const DropTables& drop, const Falling& falling)
      : back(tables, drop, falling.fall) {
    for (int p = 0; p < drop.n_part; ++p) top[p] = D{};
    for (int l = 0; l <= drop.n_level; ++l) loose[l] = D{}, drift[l] = {D{}, D{}};
  }

  void add(const DroppedSlope& s, const Dropped& of, const Falling& falling, int i) {
    const DropTables& drop = back.drop;
    FlightSlope<D>& flight = back.d_flight;
    LandingSlope<D>& landing = back.d_landing;
    flight.v.x[i] += sum_of(s.v[0]), flight.v.y[i] += sum_of(s.v[1]), flight.v.z[i] += sum_of(s.v[2]);
    flight.low[i] += sum_of(s.low), landing.mean_time[i] += sum_of(s.time);
    landing.x[i] += sum_of(s.landed[0]), landing.y[i] += sum_of(s.landed[1]);
    d_sweep.x[i] += sum_of(s.rest[0]), d_sweep.y[i] += sum_of(s.rest[1]), d_sweep.reach[i] += sum_of(s.side_reach);
    d_sweep.top[i] += sum_of(s.side_top);
    d_sweep.inverse_scale[i] += by_inverse_scale(falling.sweep.inverse_scale[i], sum_of(s.side_variance));
    d_tumble.start.x[i] += sum_of(s.start[0]), d_tumble.start.y[i] += sum_of(s.start[1]);
    d_tumble.inverse_scale[i] += by_inverse_scale(falling.tumble.inverse_scale[i], sum_of(s.fall_variance));
    for (int p = 0; p < drop.n_part; ++p) {
      auto& part = flight.part[p];
      const auto& own = s.part[p];
      const double x = sum_of(own.o[0]), y = sum_of(own.o[1]);
      flight.c.x[i] += x, flight.c.y[i] += y, part.o.x[i] += x, part.o.y[i] += y;
      part.u.x[i] += sum_of(own.u[0]), part.u.y[i] += sum_of(own.u[1]), part.bottom[i] += sum_of(own.bottom);
      top[p][i] += sum_of(own.top);
      for (int k = 0; k < 6; ++k) part.axis[k][i] += sum_of(own.axis[k]);
    }
    const double nothing = of.partly ? sum_of(s.nothing) : 0.0;
    double left = 0;
    for (int l = drop.n_level; l-- > 0;) {
      left += s.left[l + 1];
      landing.leaving[l][i] += left, landing.first[l][i] += sum_of(s.mass[l]) - nothing;
      landing.time[drop.level_start[l]][i] += sum_of(s.times[l]);
    }
    for (int l = 0; l <= drop.n_level; ++l)
      loose[l][i] += s.loose[l], drift[l].x[i] += s.drift[l][0], drift[l].y[i] += s.drift[l][1];
  }

  // Maps derivatives to joints and their velocities.
  void finish(const Falling& falling, const D* qd, D* d_q, D* d_qd) {
    const DropTables& drop = back.drop;
    back_up();
    Tumble<D> tumble = falling.tumble;
    OwnLoss<D> none;
    D d_G[kMaxSurfaces];
    for (int k = 0; k < drop.n_surface; ++k) d_G[k] = D{};
    for (int l = drop.n_level; l >= 0; --l) {
      if (l < drop.n_level) {
        tumble.mass = falling.loose[l], tumble.drift = falling.drift[l];
        back_tumble_level<D>(back, tumble, l, d_G, d_tumble, none, nullptr);
      }
      d_tumble.mass += loose[l], d_tumble.drift.x += drift[l].x, d_tumble.drift.y += drift[l].y;
    }
    back_tumble(back, falling.tumble, d_tumble);
    back_sweep(back, falling.sweep, d_sweep);
    back_land(back);
    back_find_stop(back);
    const Vec<D> d_turn = back_release(back);
    back_joints(back, qd, d_turn, d_q, d_qd);
  }

 private:
  static double by_inverse_scale(double inverse_scale, double d_variance) {
    return d_variance / (-0.5 * kBeta * kBeta * inverse_scale * inverse_scale * inverse_scale);
  }
  // Heights of the parts' highest points.
  void back_up() {
    for (int p = 0; p < back.drop.n_part; ++p) {
      auto& part = back.d_flight.part[p];
      back.d_flight.c.z += top[p], part.o.z += top[p];
      D d_up[3];
      back_reach(back.drop.part[p], back.flight.part[p].axis + 6, top[p], d_up);
      for (int k = 0; k < 3; ++k) part.axis[6 + k] += d_up[k];
    }
  }
};

// Adds the sum of P S over entities, with its derivatives.
static void drop_gradient(const Tables& tables, const DropTables& drop, const MovingPaths& paths,
                          const MovingPlaces& places, const double* severity, const States& states, const double* t,
                          const MovingSlopes& out) {
  struct Work {
    const Tables& tables;
    const DropTables& drop;
    const double* severity;
    const MovingSlopes& out;
    size_t n;
    Storage<FallingSlope> slope;
    const Falling* falling;

    void start(const Falling& of) { slope.clear(), falling = &of; }
    void visit(int lane, size_t row, int e, const PathMeeting& meeting, const Encounter& met) {
      out.value[row] += severity[e] * met.value;
      if (!(met.value > kHardlyHit)) return;
      FallingSlope& all = slope.get() ? *slope.get() : slope.make(tables, drop, *falling);
      DroppedSlope dropped(drop);
      for (int b = 0; b < met.pairs.blocks; ++b) {
        const D d = where(met.hit[b].value > kNothing<D>, severity[e] * met.pairs.shares(b), D{});
        if (any(d > 0.0)) HitBack(meeting, met.hit[b], dropped).run(d);
      }
      out.d_t[row] += sum_of(dropped.clock);
      all.add(dropped, meeting.fall, *falling, lane);
    }
    void finish(const Falling& of, size_t first, const D* rates) {
      if (!slope.get()) return;
      D d_q[kMaxJoints], d_qd[kMaxJoints];
      slope.get()->finish(of, rates, d_q, d_qd);
      const size_t nq = size_t(tables.n_joint);
      for (int i = 0; i < kAbreast<D> && first + size_t(i) < n; ++i)
        for (size_t j = 0; j < nq; ++j) {
          out.d_q[(first + size_t(i)) * nq + j] += d_q[j][i];
          out.d_qd[(first + size_t(i)) * nq + j] += d_qd[j][i];
        }
    }
  } work{tables, drop, severity, out, states.n, {}, nullptr};
  for_each_encounter(tables, drop, paths, places, severity, states, t, work);
}

}  // namespace gp::GP_ISA::moving

// P that a dropped object hits a moving entity, for places and times of the entity side by side: D, G and H of
// costs/models/moving/drops.py. The fall is that of one state.
#pragma once
#include <cstddef>

#include "cutoffs.hpp"
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "impact/impact_of_drop.hpp"
#include "impact/moving/path.hpp"
#include "impact/moving/tables.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA::moving {

constexpr double kRoam = 0.3;        // time from landing to rest, or to falling off [s]; from the specification
constexpr double kLevelSoft = 0.01;  // smoothing width for comparing a level's height with the entity's [m]
constexpr double kSideSoft = 0.02;   // smoothing width for the object passing above or below the entity [m]
constexpr double kStandsOn = 0.1;    // surfaces less than this above an entity's bottom support it [m]
constexpr double kCertain = 0.01;    // for smaller standard deviations one place is enough [m]
constexpr double kNoMove = 1e-9;     // shorter moves have no direction [m]
constexpr double kHardlyHit = 1e-9;  // below this probability of a hit, places are not checked for being free

// --- falls of states side by side -----------------------------------------------------------------------------------

// Falls side by side; per level, the P and drift of objects that have left it or a higher level and were not caught.
struct Falling : BuiltInPlace {
  const Fall<D> fall;
  const Sweep<D> sweep;
  Tumble<D> tumble;
  D top[kMaxDropParts];
  D loose[kMaxSurfaces + 1];
  Point2<D> drift[kMaxSurfaces + 1];

  Falling(const Tables& tables, const DropTables& drop, const D* q, const D* qd)
      : fall(tables, drop, q, qd), sweep(drop, fall.flight, fall.landing), tumble(drop, fall.flight, fall.landing) {
    const Flight<D>& flight = fall.flight;
    for (int p = 0; p < drop.n_part; ++p)
      top[p] = flight.c.z + flight.part[p].o.z + reach(drop.part[p], flight.part[p].axis + 6);
    for (int l = 0; l <= drop.n_level; ++l) {
      loose[l] = tumble.mass, drift[l] = tumble.drift;
      if (l == drop.n_level) break;
      if (tumble.enter(drop))
        for (int k = drop.level_start[l]; k < drop.level_start[l + 1]; ++k) tumble.hit(drop.surface[k], false);
      tumble.leave(drop, fall.landing, l);
    }
  }
};

// One lane of these falls.
struct Dropped : BuiltInPlace {
  double c[2], v[3], low, nothing, time, landed[2], rest[2], start[2];
  double fall_variance, side_variance, side_reach, side_top;
  struct {
    double o[2], u[2], axis[6], bottom, top;
  } part[kMaxDropParts];
  double mass[kMaxSurfaces], times[kMaxSurfaces];  // per level
  double left[kMaxSurfaces + 1], loose[kMaxSurfaces + 1],
      drift[kMaxSurfaces + 1][2];  // summed over the levels above each level
  bool partly;                     // whether P of landing on nothing is neither 0 nor 1

  Dropped(const DropTables& drop, const Falling& of, int i) {
    const auto& [X_W, flight, landing] = of.fall;
    c[0] = flight.c.x[i], c[1] = flight.c.y[i];
    v[0] = flight.v.x[i], v[1] = flight.v.y[i], v[2] = flight.v.z[i];
    low = flight.low[i], time = landing.mean_time[i], landed[0] = landing.x[i], landed[1] = landing.y[i];
    rest[0] = of.sweep.x[i], rest[1] = of.sweep.y[i], start[0] = of.tumble.start.x[i], start[1] = of.tumble.start.y[i];
    fall_variance = variance_of(of.tumble.inverse_scale[i]), side_variance = variance_of(of.sweep.inverse_scale[i]);
    side_reach = of.sweep.reach[i], side_top = of.sweep.top[i];
    for (int p = 0; p < drop.n_part; ++p) {
      const FlyingPart<D>& flying = flight.part[p];
      part[p].o[0] = flying.o.x[i], part[p].o[1] = flying.o.y[i], part[p].u[0] = flying.u.x[i],
      part[p].u[1] = flying.u.y[i], part[p].bottom = flying.bottom[i], part[p].top = of.top[p][i];
      for (int k = 0; k < 6; ++k) part[p].axis[k] = flying.axis[k][i];
    }
    double whole = 0;
    left[0] = 0;
    for (int l = 0; l < drop.n_level; ++l) {
      mass[l] = landing.first[l][i], times[l] = landing.time[drop.level_start[l]][i], whole += mass[l];
      left[l + 1] = left[l] + landing.leaving[l][i];
    }
    for (int l = 0; l <= drop.n_level; ++l)
      loose[l] = of.loose[l][i], drift[l][0] = of.drift[l].x[i], drift[l][1] = of.drift[l].y[i];
    partly = whole > 0 && whole < 1;
    nothing = whole < 1 ? 1 - whole : 0.0;
  }

 private:
  static double variance_of(double inverse_scale) {
    const double scale = 1.0 / (inverse_scale * kBeta);
    return scale * scale;
  }
};

// --- relative motion ------------------------------------------------------------------------------------------------

// An entity off its predicted path by the given numbers of standard deviations; `cell`: remaining standard deviation of
// its place, relative to that of the prediction.
struct Person {
  const MovingEntity& entity;
  D off_x, off_y;
  double cell;

  struct Place {
    D x, y, vx, vy;
  };
  Place at(D t) const {
    D place[2], rate[2];
    follow<0, 2>(entity, t, place, rate);
    const Varying spread = spread_of(entity, t);
    return {place[0] + off_x * spread.value, place[1] + off_y * spread.value, rate[0] + off_x * spread.rate,
            rate[1] + off_y * spread.rate};
  }
  Varying variance(D t) const {
    const Varying spread = spread_of(entity, t);
    const double c2 = cell * cell;
    return {c2 * spread.value * spread.value, 2.0 * c2 * spread.value * spread.rate};
  }
};

// Directions across which object and entity pass each other. A disc has those along and across the motion and halfway
// between; a box has those of its axes, and the one across the motion.
struct Directions {
  int n;
  D x[5], y[5];
  D turn_x, turn_y;  // derivatives of the motion's angle with respect to the motion

  void set(const Outline& o, D move_x, D move_y) {
    const D square = move_x * move_x + move_y * move_y;
    const auto moves = square > kNoMove * kNoMove;
    const D inverse = where(moves, inverse_root(maximum(square, D{} + kNoMove * kNoMove)), D{});
    const D ax = where(moves, move_x * inverse, o.cosine), ay = where(moves, move_y * inverse, o.sine);
    turn_x = -ay * inverse, turn_y = ax * inverse;
    const D c = o.round ? ax : o.cosine, s = o.round ? ay : o.sine;
    x[0] = c, y[0] = s, x[1] = -s, y[1] = c;
    x[2] = (c - s) * kHalfRoot, y[2] = (s + c) * kHalfRoot, x[3] = -y[2], y[3] = x[2];
    n = o.round ? 4 : 5;
    if (!o.round) x[4] = -ay, y[4] = ax;
  }
  // Extents of the entity with a margin in these directions.
  void reach(const Outline& o, D margin, D* out) const {
    for (int i = 0; i < n; ++i)
      out[i] = o.reach(o.cosine * x[i] + o.sine * y[i], o.cosine * y[i] - o.sine * x[i], margin);
  }
};

// Relative motion of the object from one place to another; it hits the entity if it comes within reach.
struct Way {
  Point2<D> from, to;
  Directions u;
  D reach[5], inverse_scale;

  Within<D> within(int i) const {
    const D x0 = u.x[i] * from.x + u.y[i] * from.y, x1 = u.x[i] * to.x + u.y[i] * to.y;
    return Within<D>(0.5 * (x0 + x1), reach[i] + 0.5 * absolute(x1 - x0), inverse_scale);
  }
  D met() const {
    Chance<D> chance;
    auto near = inverse_scale > 0.0;
    for (int i = 0; i < 4; ++i) {
      D middle, half;
      interval(i, middle, half);
      near &= (absolute(middle) - half) * inverse_scale < kTail<D>;
      if (!any(near)) return D{};
      chance.within(middle, half, inverse_scale);
    }
    D P = chance.value();
    if (u.n == 5) {
      // A fifth direction is not as independent of the others, but its P is still an upper bound.
      Chance<D> fifth;
      D middle, half;
      interval(4, middle, half);
      fifth.within(middle, half, inverse_scale);
      P = minimum(P, fifth.value());
    }
    return where(near, P, D{});
  }

 private:
  void interval(int i, D& middle, D& half) const {
    const D x0 = u.x[i] * from.x + u.y[i] * from.y, x1 = u.x[i] * to.x + u.y[i] * to.y;
    middle = 0.5 * (x0 + x1), half = reach[i] + 0.5 * absolute(x1 - x0);
  }
};

static inline D inverse_scale_of(D variance) { return (1.0 / kBeta) * inverse_root(variance); }

// --- P that an entity is hit ----------------------------------------------------------------------------------------

struct PathMeeting {
  const DropTables& drop;
  const Dropped& fall;
  const MovingEntity& entity;
};

struct Hit {
  D time, off_x, off_y;  // time of the release; offset from the prediction
  double cell;
  Outline outline;
  D top, bottom, rise, turning;  // Z and B of the entity; rates of its height and yaw
  D lower, down, fallen;         // W, T2, and the time when the object is at the entity's bottom
  D passes, foremost;            // P of a hit in flight, given that the object lands lower; the part that determines it
  Directions across;             // of the flight
  D higher;                      // number of levels higher than the entity
  D loose, left, meets, beyond, edge;  // B_l, M_l; P of the sweep; P of falling past the wide top that covers most, and
                                       // its index
  Point2<D> drift;
  Way falls, slides;
  D over, beside;  // P that the sliding object meets the outline; the same at the entity's height
  D D_, G, H, value;

  Person person(const PathMeeting& of) const { return {of.entity, off_x, off_y, cell}; }

  void run(const PathMeeting& of) {
    D place[4], rate[4];
    follow<0, 4>(of.entity, time, place, rate);
    const double half = of.entity.half[2];
    top = place[2] + half, bottom = place[2] - half, rise = rate[2], turning = rate[3];
    outline.turn(of.entity, place[3]);
    come_down(of), fly(of), fall_off(of), slide(of);
    D_ = (lower + of.fall.nothing) * passes;
    H = relu(lower - D_) * beside;
    value = minimum(relu(1.0 - (1.0 - D_) * (1.0 - G) * (1.0 - H)), D{} + 1.0);
  }

  // Relative motion of part p during its flight past the entity; `first`, `last`: start and end times.
  Way past(const PathMeeting& of, int p, D& first, D& last) const {
    const DropConstants& k = of.drop.constants;
    const auto& part = of.fall.part[p];
    const Person who = person(of);
    first = fall(D{} + of.fall.v[2], part.bottom - top) + k.delay, last = maximum(down, first);
    const D middle = 0.5 * (first + last), late = k.velocity_spread * middle;
    Way way;
    way.u = across;
    way.inverse_scale =
        inverse_scale_of(k.position_spread * k.position_spread + late * late + who.variance(time + middle).value);
    const auto at = [&](D t) {
      const Person::Place there = who.at(time + t);
      return Point2<D>{of.fall.c[0] + part.o[0] + part.u[0] * t - there.x,
                       of.fall.c[1] + part.o[1] + part.u[1] * t - there.y};
    };
    way.from = at(first), way.to = at(last);
    across.reach(outline, D{}, way.reach);
    for (int i = 0; i < across.n; ++i) {
      D d[3];
      for (int j = 0; j < 3; ++j) d[j] = part.axis[j] * across.x[i] + part.axis[3 + j] * across.y[i];
      way.reach[i] += moving_reach(of.drop.part[p], d);
    }
    return way;
  }
  D above_bottom(const PathMeeting& of, int p) const { return (of.fall.part[p].top - bottom) * (1.0 / kSideSoft); }
  // P that a falling object lands on the entity instead of a wide top above it, beyond the top's edge.
  D past_edge(const PathMeeting& of, int k, D level) const {
    const Edge edge(of, *this, k);
    return where(level < higher, relu(edge.whole() - edge.covered()), D{} + 1.0);
  }
  // The object relative to the entity and to a wide top that may cover the entity, in the axes of the top.
  struct Edge {
    D offset[2], reach[2], there[2], entity[2], low[2], high[2], inverse_scale;
    double half[2];

    Edge(const PathMeeting& of, const Hit& hit, int k) {
      const Surface& s = of.drop.surface[k];
      const Way& way = hit.falls;
      const Point2<D> between = {0.5 * (way.from.x + way.to.x), 0.5 * (way.from.y + way.to.y)};
      const Point2<D> point = hit.comes_to(of);
      const Point2<D> apart = turned(s, between.x, between.y), object = placed(s, point.x, point.y),
                      centre = placed(s, point.x - between.x, point.y - between.y);
      const D move_x = absolute(way.to.x - way.from.x), move_y = absolute(way.to.y - way.from.y);
      const D margin = D{} + of.drop.constants.tumble_reach * of.drop.size;
      inverse_scale = way.inverse_scale;
      for (int j = 0; j < 2; ++j) {
        offset[j] = j ? apart.y : apart.x, there[j] = j ? object.y : object.x, entity[j] = j ? centre.y : centre.x;
        const double x = Extents<D>::axis_x(s, j), y = Extents<D>::axis_y(s, j);
        reach[j] = hit.outline.reach(hit.outline.cosine * x + hit.outline.sine * y,
                                     hit.outline.cosine * y - hit.outline.sine * x, margin) +
                   0.5 * (move_x * __builtin_fabs(x) + move_y * __builtin_fabs(y));
        half[j] = s.inside[j];
        low[j] = maximum(entity[j] - reach[j], D{} - half[j]), high[j] = minimum(entity[j] + reach[j], D{} + half[j]);
      }
    }
    auto hides() const { return (high[0] > low[0]) & (high[1] > low[1]); }
    Within<D> whole_of(int j) const { return Within<D>(offset[j], reach[j], inverse_scale); }
    Within<D> covered_of(int j) const {
      return Within<D>(there[j] - 0.5 * (low[j] + high[j]), 0.5 * (high[j] - low[j]), inverse_scale);
    }
    D whole() const { return whole_of(0).value * whole_of(1).value; }
    D covered() const {
      const auto hidden = hides();
      return any(hidden) ? where(hidden, covered_of(0).value * covered_of(1).value, D{}) : D{};
    }
  };
  // Where an object that has left its support lands.
  Point2<D> comes_to(const PathMeeting& of) const {
    const D moved = of.drop.constants.drift * of.drop.size * reciprocal(loose + kLeastMass);
    return {of.fall.start[0] + drift.x * moved, of.fall.start[1] + drift.y * moved};
  }

 private:
  static D moving_reach(const DropPart& part, const D d[3]) { return ::gp::GP_ISA::reach(part, d); }

  void come_down(const PathMeeting& of) {
    const DropTables& drop = of.drop;
    D sum = {};
    lower = D{};
    for (int l = 0; l < drop.n_level; ++l) {
      if (!(of.fall.mass[l] > kNothing<D>)) continue;
      const D mass = of.fall.mass[l] * Below<D>(below(of, l)).value;
      lower += mass, sum += mass * of.fall.times[l];
    }
    fallen = fall(D{} + of.fall.v[2], of.fall.low - bottom) + drop.constants.delay;
    down = (sum + of.fall.nothing * fallen) * reciprocal(lower + (of.fall.nothing + kLeastMass));
  }
  void fly(const PathMeeting& of) {
    const Person who = person(of);
    const Person::Place now = who.at(time), then = who.at(time + down);
    across.set(outline, of.fall.v[0] * down - then.x + now.x, of.fall.v[1] * down - then.y + now.y);
    passes = D{}, foremost = D{} - 1.0;
    for (int p = 0; p < of.drop.n_part; ++p) {
      const D above = above_bottom(of, p);
      if (!any(above > -kTail<D> * kBeta)) continue;
      D first, last;
      const D P = past(of, p, first, last).met() * Below<D>(above).value;
      foremost = where(P > passes, D{} + double(p), foremost), passes = maximum(passes, P);
    }
  }
  void count_higher(const PathMeeting& of) {
    const DropTables& drop = of.drop;
    const D limit = minimum(top, bottom + kStandsOn);
    higher = loose = left = D{}, drift = {D{}, D{}};
    for (int i = 0; i < kAbreast<D>; ++i) {
      int level = i > 0 && limit[i] == limit[i - 1] ? int(higher[i - 1]) : 0;
      while (level < drop.n_level && drop.surface[drop.level_start[level]].top > limit[i]) ++level;
      higher[i] = double(level), loose[i] = of.fall.loose[level], left[i] = of.fall.left[level];
      drift.x[i] = of.fall.drift[level][0], drift.y[i] = of.fall.drift[level][1];
    }
  }
  void fall_off(const PathMeeting& of) {
    count_higher(of);
    G = meets = beyond = D{}, edge = D{} - 1.0;
    if (!any(loose > kNothing<D>)) return;
    const DropConstants& k = of.drop.constants;
    const Person who = person(of);
    const D t = time + (of.fall.time + kRoam);
    const Person::Place before = who.at(t - 0.5 * kRoam), after = who.at(t + 0.5 * kRoam);
    const Point2<D> point = comes_to(of);
    falls.from = {point.x - before.x, point.y - before.y}, falls.to = {point.x - after.x, point.y - after.y};
    falls.inverse_scale = inverse_scale_of(of.fall.fall_variance + who.variance(t).value);
    falls.u.set(outline, falls.to.x - falls.from.x, falls.to.y - falls.from.y);
    falls.u.reach(outline, D{} + k.tumble_reach * of.drop.size, falls.reach);
    meets = falls.met();
    if (!any(loose * meets > kNothing<D>)) return;
    beyond = D{} + 1.0;
    const double most = greatest_lane(higher);
    for (int l = 0; l < of.drop.n_level && l < most; ++l)
      for (int s = of.drop.level_start[l]; s < of.drop.level_start[l + 1]; ++s) {
        if (!of.drop.surface[s].holds) continue;
        const D P = past_edge(of, s, D{} + double(l));
        edge = where(P < beyond, D{} + double(s), edge), beyond = minimum(beyond, P);
      }
    G = minimum(loose * meets, left * beyond);
  }
  void slide(const PathMeeting& of) {
    beside = over = D{};
    if (!any(lower > kNothing<D>)) return;
    const D above = over_side(of);
    if (!any(above > -kTail<D> * kBeta)) return;
    const Person who = person(of);
    const D t = time + of.fall.time;
    const Person::Place before = who.at(t), after = who.at(t + kRoam);
    slides.from = {of.fall.landed[0] - before.x, of.fall.landed[1] - before.y};
    slides.to = {of.fall.rest[0] - after.x, of.fall.rest[1] - after.y};
    slides.inverse_scale = inverse_scale_of(of.fall.side_variance + who.variance(t + kRoam).value);
    slides.u.set(outline, slides.to.x - slides.from.x, slides.to.y - slides.from.y);
    slides.u.reach(outline, D{} + of.fall.side_reach, slides.reach);
    over = slides.met();
    beside = over * Below<D>(above).value;
  }

 public:
  D below(const PathMeeting& of, int level) const {
    return (top - of.drop.surface[of.drop.level_start[level]].top) * (1.0 / kLevelSoft) + 2.0;
  }
  D over_side(const PathMeeting& of) const {
    return (of.fall.side_top - bottom) * (1.0 / of.drop.constants.side_height);
  }
};

// --- where an entity may be -----------------------------------------------------------------------------------------

// Pairs of a time and a place that represent where an entity may be.
struct Pairs {
  int n, blocks;
  double cell, share[kMaxPairs];
  D time[kMaxPairs], off_x[kMaxPairs], off_y[kMaxPairs];  // per block

  // At a time if one is given, otherwise along the predicted path.
  Pairs(const MovingEntity& e, const MovingPlaces& places, const double* t) {
    const int times = t ? 1 : e.n_time;
    const double latest = t ? *t : e.time[times - 1];
    const bool certain = spread_of(e, D{} + latest).value[0] < kCertain;
    const int each = certain ? 1 : t ? places.n_place : (places.n_place + times - 1) / times;
    n = times * each, blocks = (n + kAbreast<D> - 1) / kAbreast<D>;
    cell = certain ? 1.0 : places.cell;
    for (int k = 0; k < blocks * kAbreast<D>; ++k) {
      const int pair = k < n ? k : n - 1, b = k / kAbreast<D>, i = k % kAbreast<D>;
      const double* place = places.place + 2 * (pair % places.n_place);
      time[b][i] = t ? *t : e.time[pair / each];
      off_x[b][i] = certain ? 0.0 : place[0], off_y[b][i] = certain ? 0.0 : place[1];
      if (k < n) share[k] = 1.0 / n;
    }
  }
  D shares(int block) const {
    D out = {};
    for (int i = 0; i < kAbreast<D> && block * kAbreast<D> + i < n; ++i) out[i] = share[block * kAbreast<D> + i];
    return out;
  }
};

// Bounds the region where P of a hit may exceed about 1e-6, from the state at the release alone.
struct Nearness {
  double c[2], duration, blur, speed, size;

  Nearness(const DropTables& drop, const Flight<D>& flight, const MovingEntity& e, int i) {
    const DropConstants& k = drop.constants;
    const double lowest_top = drop.n_surface ? drop.surface[drop.n_surface - 1].top : e.lowest;
    const double lowest = lowest_top < e.lowest ? lowest_top : e.lowest;
    const double above = flight.c.z[i] - lowest, height = above > 0 ? above : 0.0;
    const double vx = flight.v.x[i], vy = flight.v.y[i], vz = flight.v.z[i], speed2 = vx * vx + vy * vy;
    c[0] = flight.c.x[i], c[1] = flight.c.y[i], size = drop.size;
    const double soft = 0.5 * (height + __builtin_sqrt(height * height + 1e-4));
    duration = (vz + __builtin_sqrt(vz * vz + 2 * kGravity * soft)) / kGravity + k.delay + 2 * kRoam;
    speed = __builtin_sqrt(speed2);
    const double s2 = k.size_spread * k.size_spread + k.side_spread * k.side_spread;
    const double late = k.velocity_spread * duration, deep = k.height_spread * height;
    blur = k.position_spread * k.position_spread + late * late + deep * deep +
           k.carry_spread * k.carry_spread * speed2 + s2 * size * size;
  }
  auto of(const Person& who, D time) const {
    const MovingEntity& e = who.entity;
    const D spread = who.cell * spread_of(e, time + duration).value;
    const Person::Place at = who.at(time);
    const D grown = square_root(who.off_x * who.off_x + who.off_y * who.off_y + 1e-24) * e.growth;
    const D reach = __builtin_sqrt(e.half[0] * e.half[0] + e.half[1] * e.half[1]) + 4.0 * size +
                    kFarSpreads * square_root(blur + spread * spread) + (e.top_speed + grown + speed) * duration;
    const D dx = c[0] - at.x, dy = c[1] - at.y;
    return dx * dx + dy * dy < reach * reach;
  }
};

// The places of an entity at which moving links or the carried object would touch it before any failure.
static inline auto touched(const Tables& tables, const Frame<D>* X_W, int lane, const Person& who, D time,
                           double protrusion) {
  const MovingEntity& e = who.entity;
  const Person::Place here = who.at(time);
  D rest[2], rate[2];
  follow<2, 2>(e, time, rest, rate);
  Outline outline;
  outline.turn(e, rest[1]);
  const double reach = e.round ? e.half[0] : __builtin_sqrt(e.half[0] * e.half[0] + e.half[1] * e.half[1]);
  auto found = here.x != here.x;
  for (int g = 0; g < tables.n_group; ++g) {
    const Group& group = tables.group[g];
    if (group.link == 0) continue;
    const Frame<D>& X = X_W[group.frame];
    const auto centre = [&](const float* s, double* out) {
      out[0] = X.p.x[lane] + X.R[0][lane] * s[0] + X.R[1][lane] * s[1] + X.R[2][lane] * s[2];
      out[1] = X.p.y[lane] + X.R[3][lane] * s[0] + X.R[4][lane] * s[1] + X.R[5][lane] * s[2];
      out[2] = X.p.z[lane] + X.R[6][lane] * s[0] + X.R[7][lane] * s[1] + X.R[8][lane] * s[2];
    };
    const auto may = [&](const float* bound) {
      double p[3];
      centre(bound, p);
      const D dx = p[0] - here.x, dy = p[1] - here.y, most = D{} + (double(bound[3]) + reach);
      return any((dx * dx + dy * dy < most * most) & ~found &
                 (absolute(p[2] - rest[0]) < double(bound[3]) + e.half[2]));
    };
    if (!may(group.bound)) continue;
    for (int c = group.first_cluster; c < group.first_cluster + group.n_cluster; ++c) {
      const Cluster& cluster = tables.cluster[c];
      if (!may(cluster.bound)) continue;
      for (int s = cluster.first; s < cluster.first + cluster.count; ++s) {
        const float* sphere = tables.sphere + 4 * s;
        double p[3];
        centre(sphere, p);
        const D dx = p[0] - here.x, dy = p[1] - here.y, dz = p[2] - rest[0];
        found |= apart(outline, e.half[2], dx, dy, dz).value < double(sphere[3]) - protrusion;
      }
    }
  }
  return found;
}

// --- many states ----------------------------------------------------------------------------------------------------

// The hits of one state on an entity: P of each pair, the shares of pairs that are free, and the weighted sum.
struct Encounter {
  Pairs pairs;
  Hit hit[kMaxPairs / kAbreast<D> + 1];
  double value = 0;

  Encounter(const MovingEntity& e, const MovingPlaces& places, const double* t) : pairs(e, places, t) {}

  Person person(const MovingEntity& e, int b) const { return {e, pairs.off_x[b], pairs.off_y[b], pairs.cell}; }
  bool near(const Nearness& nearness, const MovingEntity& e) const {
    for (int b = 0; b < pairs.blocks; ++b)
      if (any(nearness.of(person(e, b), pairs.time[b]))) return true;
    return false;
  }
  void run(const Tables& tables, const PathMeeting& of, const Nearness& nearness, const Frame<D>* X_W, int lane,
           const MovingPlaces& places, bool timed) {
    double most = 0;
    for (int b = 0; b < pairs.blocks; ++b) {
      Hit& h = hit[b];
      const auto near = nearness.of(person(of.entity, b), pairs.time[b]);
      h.value = D{};
      if (!any(near)) continue;
      h.time = pairs.time[b], h.off_x = pairs.off_x[b], h.off_y = pairs.off_y[b], h.cell = pairs.cell;
      h.run(of);
      h.value = where(near, h.value, D{});
      const double here = greatest_lane(h.value);
      most = here > most ? here : most;
    }
    if (timed && pairs.n > 1 && most > kHardlyHit) clear(tables, of.entity, X_W, lane, places.protrusion);
    value = 0;
    for (int b = 0; b < pairs.blocks; ++b) value += sum_of(hit[b].value * pairs.shares(b));
  }

 private:
  // Drops pairs whose place the robot occupies; if all are occupied, the shares stay as they are.
  void clear(const Tables& tables, const MovingEntity& e, const Frame<D>* X_W, int lane, double protrusion) {
    bool free[kMaxPairs];
    int count = 0;
    for (int b = 0; b < pairs.blocks; ++b) {
      const auto met = touched(tables, X_W, lane, person(e, b), pairs.time[b], protrusion);
      for (int i = 0; i < kAbreast<D> && b * kAbreast<D> + i < pairs.n; ++i)
        count += free[b * kAbreast<D> + i] = !met[i];
    }
    for (int k = 0; k < pairs.n && count > 0; ++k) pairs.share[k] = free[k] ? 1.0 / count : 0.0;
  }
};

// Visits every state and entity that may be hit: visit(lane, row, entity, encounter, dropped), at times `t` if not
// null. `start` and `finish` enclose the visits of one block of states; without visits, neither is called.
template <class Work>
static inline void for_each_encounter(const Tables& tables, const DropTables& drop, const MovingPaths& paths,
                                      const MovingPlaces& places, const double* severity, const States& states,
                                      const double* t, Work&& work) {
  Storage<Falling> falling;
  Storage<Dropped> dropped;
  for_each_release<D>(tables, states, [&](size_t first, const D* qs, const D* rates) {
    Frame<D> X_W[kMaxLinks];
    Flight<D> flight;
    forward_kinematics(tables, qs, X_W);
    release(tables, drop, X_W, rates, flight);
    falling.clear();
    for (int i = 0; i < kAbreast<D> && first + size_t(i) < states.n; ++i) {
      const size_t row = first + size_t(i);
      dropped.clear();
      for (int e = 0; e < paths.n_entity; ++e) {
        if (severity && severity[e] == 0) continue;
        const MovingEntity& entity = paths.entity[e];
        Encounter encounter(entity, places, t ? t + row : nullptr);
        const Nearness nearness(drop, flight, entity, i);
        if (!encounter.near(nearness, entity)) continue;
        if (!falling.get()) work.start(falling.make(tables, drop, qs, rates));
        const Dropped& fall = dropped.get() ? *dropped.get() : dropped.make(drop, *falling.get(), i);
        const PathMeeting meeting{drop, fall, entity};
        encounter.run(tables, meeting, nearness, X_W, i, places, t != nullptr);
        work.visit(i, row, e, meeting, encounter);
      }
    }
    if (falling.get()) work.finish(*falling.get(), first, rates);
  });
}

// P [n, n_entity].
static void drop_probability(const Tables& tables, const DropTables& drop, const MovingPaths& paths,
                             const MovingPlaces& places, const double* severity, const States& states, const double* t,
                             double* out) {
  struct {
    double* out;
    size_t count;
    void start(const Falling&) {}
    void visit(int, size_t row, int e, const PathMeeting&, const Encounter& met) {
      out[row * count + size_t(e)] = met.value;
    }
    void finish(const Falling&, size_t, const D*) {}
  } work{out, size_t(paths.n_entity)};
  for (size_t k = 0; k < states.n * work.count; ++k) out[k] = 0;
  for_each_encounter(tables, drop, paths, places, severity, states, t, work);
}

}  // namespace gp::GP_ISA::moving

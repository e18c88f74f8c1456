// Where a base goes that fails while it drives, and whom it meets there. The equations are those of
// mobile/coast/coast.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "checks.hpp"
#include "dual.hpp"

namespace gp {

// Rectangles from above that may be rounded and move: what is met.
struct FloorShape {
  int entity;  // -1: an obstacle
  double x, y, ux, uy, a, b, round, vx, vy;
  double spread = 0;  // standard deviation of its place

  double around() const { return length_of(a, b) + round; }  // radius of a circle around it
  double speed() const { return vx == 0 && vy == 0 ? 0.0 : length_of(vx, vy); }
  // Of a point at a time; inside of a rectangle minus the way to its nearest side.
  template <class T> T distance(const T& px, const T& py, const T& time) const {
    const T dx = px - x - vx * time, dy = py - y - vy * time;
    return from_middle(T(ux * dx + uy * dy), T(ux * dy - uy * dx));
  }
  // The same of a point in the shape's own axes.
  template <class T> T from_middle(const T& along, const T& across) const {
    const T ex = size_of(along) - a, ey = size_of(across) - b;
    const bool beside = value_of(ex) > 0, before = value_of(ey) > 0;
    if (beside && before) return length_of(ex, ey) - round;
    return larger(ex, ey) - round;
  }
};

inline std::vector<FloorShape> floor_shapes(const Integers& entity, const Reals& shape, const Reals* velocity,
                                            int n_entity) {
  require_numbers(shape, 7 * entity.size(), "shapes around a base", 2 * kMaxExtent);
  if (velocity) require_numbers(*velocity, 2 * entity.size(), "velocities around a base", kMaxPosition);
  std::vector<FloorShape> out;
  for (size_t k = 0; k < entity.size(); ++k) {
    const double* s = shape.data() + 7 * k;
    const int of = entity.data()[k];
    require(of >= -1 && of < n_entity, "entity of a shape");
    const double vx = velocity ? velocity->data()[2 * k] : 0.0, vy = velocity ? velocity->data()[2 * k + 1] : 0.0;
    out.push_back({of, s[0], s[1], s[2], s[3], s[4], s[5], s[6], vx, vy});
  }
  return out;
}

// A base from above: rectangles in its frame that may be rounded, and a circle around them all.
class Footprint2d {
 public:
  explicit Footprint2d(const Reals& outline) {
    require_numbers(outline, "outline of a base", kMaxExtent);
    require(outline.size() > 0 && outline.size() % 7 == 0, "outline of a base");
    for (size_t k = 0; k < outline.size(); k += 7) {
      const double* s = outline.data() + k;
      require(s[4] >= 0 && s[5] >= 0 && s[6] >= 0, "size of a part of a base");
      part_.push_back({-1, s[0], s[1], s[2], s[3], s[4], s[5], s[6], 0, 0});
      within_.push_back(std::hypot(s[4], s[5]) + s[6]);
      reach_ = std::max(reach_, std::hypot(s[0], s[1]) + within_.back());
    }
  }
  double reach() const { return reach_; }
  // Of the base at a place, with a heading of this cosine and sine, to a shape at a time.
  template <class T>
  T distance(const FloorShape& shape, const T& x, const T& y, const T& c, const T& s, const T& time) const {
    const T dx = shape.x + shape.vx * time - x, dy = shape.y + shape.vy * time - y;
    const Seen<T> seen{c * dx + s * dy, c * dy - s * dx, c * shape.ux + s * shape.uy, c * shape.uy - s * shape.ux};
    const double around = shape.around();
    T d(std::numeric_limits<double>::infinity());
    for (size_t k = 0; k < part_.size(); ++k) {
      const double apart = length_of(value_of(seen.x) - part_[k].x, value_of(seen.y) - part_[k].y);
      if (apart - within_[k] - around < value_of(d)) d = smaller(d, between(part_[k], shape, seen));
    }
    return d;
  }

 private:
  // Where a shape is as seen from the base, and its direction.
  template <class T> struct Seen {
    T x, y, ux, uy;
  };

  // Of a part and a shape that rest; where they overlap, minus the way that parts them.
  template <class T> static T between(const FloorShape& part, const FloorShape& shape, const Seen<T>& at) {
    const T dx = at.x - part.x, dy = at.y - part.y;
    const T x = part.ux * dx + part.uy * dy, y = part.ux * dy - part.uy * dx;  // in the axes of the part
    if (shape.a == 0 && shape.b == 0) return part.from_middle(x, y) - shape.round;
    const T back_x = -(at.ux * dx + at.uy * dy), back_y = at.uy * dx - at.ux * dy;  // the part, in those of the shape
    if (part.a == 0 && part.b == 0) return shape.from_middle(back_x, back_y) - part.round;
    const T c = part.ux * at.ux + part.uy * at.uy, s = part.ux * at.uy - part.uy * at.ux;
    const T cc = size_of(c), ss = size_of(s);
    const T apart = larger(larger(size_of(x) - part.a - cc * shape.a - ss * shape.b,
                                  size_of(y) - part.b - ss * shape.a - cc * shape.b),
                           larger(size_of(back_x) - shape.a - cc * part.a - ss * part.b,
                                  size_of(back_y) - shape.b - ss * part.a - cc * part.b));
    const double rounds = part.round + shape.round;
    if (value_of(apart) <= 0) return apart - rounds;
    return smaller(nearest(part, shape, Seen<T>{x, y, c, s}), nearest(shape, part, Seen<T>{back_x, back_y, c, T(-s)})) - rounds;
  }
  // Distance of the corners of the second from the first without its rounding, in the axes of the first.
  template <class T> static T nearest(const FloorShape& one, const FloorShape& other, const Seen<T>& at) {
    T d(std::numeric_limits<double>::infinity());
    for (const double a : {-other.a, other.a})
      for (const double b : {-other.b, other.b})
        d = smaller(d, one.from_middle(T(at.x + a * at.ux - b * at.uy), T(at.y + a * at.uy + b * at.ux)));
    return d + one.round;
  }

  std::vector<FloorShape> part_;
  std::vector<double> within_;  // circles around them
  double reach_ = 0;
};

struct CoastingArrays {
  Reals outline;    // parts of the base in its frame, as shapes: rectangles that may be rounded
  Reals stops;      // probability, deceleration, drag, delay, whether wheels are let go, curvature that is added
  Reals constants;  // speed that severities are for, position spread, drift, angle by rate squared once let go
  Reals share;      // probability of each of the tables of places
  Reals speeds;     // speeds along the heading of the tables, from 0 on [m/s]
  Reals rates;      // rates of turning of the tables [rad/s]
  Reals places;     // (speed, rate, table, sample, 5): x, y, turned in the frame of the base; speed; time
  Reals astray;     // bases that have been astray for a while: for how long [s] times probability, how far aside [m],
                    // angle turned, standard deviation of how far
};

class Coasting {
  // Places of one way, in the order in which the base comes there; `gone` is how far what is fastest of it went since
  // the place before.
  template <class T> struct Place {
    T at[4], time, spread, gone;
  };

 public:
  // The same of a base that spins, in its own frame.
  template <class T> struct Spun {
    T x, y, cos, sin, time, spread, gone, energy;
  };

  // Which place and shape decides something: a place along a way, and a shape of Work::whom or Work::what.
  struct Pair {
    int place = -1, shape = -1;
    bool operator==(const Pair&) const = default;
  };
  // What decides how much one stop is worth against an entity, and what may have stopped the base before: an obstacle,
  // or whom it met.
  struct Decided {
    Pair met, before;
    bool by_obstacle = false;
  };

  // What is written to for each state.
  struct Work {
    Work(const Coasting& of, size_t n_entity) : hit(n_entity), free(of.stop_.size()), braked(of.stop_.size()) {}
    std::vector<double> hit, most, met, free, braked;
    std::vector<double> apart, touched;  // by place and shape that is near enough
    std::vector<double> stops;           // by shape that is near enough: how likely the base loses its energy there
    std::vector<double> energy;          // by place and stop, over that at the speed that severities are for
    std::vector<double> share;           // probability of each stop
    std::vector<size_t> whom, what;      // shapes that are near enough: of entities, and obstacles
    int only = -1;                       // the one entity that is asked for, if it is one
    size_t asked = 0;                    // how many of whom, which come first, are asked for
    std::vector<Place<double>> place;
    std::vector<double> gone, clear;  // how far the base went to each place; for each shape up to where nothing is near
    std::vector<Spun<double>> spun;   // of the tables, at the speed and rate of turning of the state before
    std::vector<double> spun_reach;   // how far off its places each table's are
    double spun_speed = 0, spun_rate = 0;
    // With derivatives, where they are wanted.
    bool slopes = false;
    std::vector<Dual> hit_slopes;
    std::vector<Decided> decided;  // by entity and stop
    std::vector<Pair> met_at;      // by entity
    struct Known {
      Pair pair;
      bool obstacle;
      Dual touches, along;
    };
    std::vector<Known> known;
    std::vector<double> later;  // times at places at a slightly greater speed
  };
  template <class T> struct Moving {
    T x, y, yaw, v, omega;
    T time{0.0};  // since when those who move are where they are
  };
  using State = Moving<double>;

  explicit Coasting(const CoastingArrays& of) : footprint_(of.outline) {
    require_numbers(of.stops, "ways to come to rest"), require_numbers(of.constants, 4, "constants of a base");
    require(of.stops.size() % kStop == 0, "ways to come to rest");
    for (size_t k = 0; k < of.stops.size(); k += kStop) {
      const double* s = of.stops.data() + k;
      require(s[0] >= 0 && s[1] > 0 && s[2] >= 0 && s[3] >= 0, "way to come to rest");
      stop_.push_back({s[0], s[1], s[2], s[3], s[4] != 0, s[5]});
    }
    for (const Stop& stop : stop_) {
      const Family family{stop.released, stop.bend};
      if (std::find(family_.begin(), family_.end(), family) == family_.end()) family_.push_back(family);
    }
    for (const Family& family : family_) {
      own_.emplace_back(), any_.emplace_back();
      for (size_t i = 0; i < stop_.size(); ++i) {
        if (stop_[i].bend != family.bend) continue;
        any_.back().push_back(i);
        if (stop_[i].released == family.released) own_.back().push_back(i);
      }
    }
    unit_ = of.constants.data()[0], spread_ = of.constants.data()[1], drift_ = of.constants.data()[2];
    turn_ = of.constants.data()[3];
    require(unit_ > 0 && spread_ > 0 && drift_ >= 0 && turn_ >= 0, "constants of a base");
    tables(of), strays(of.astray);
  }

  const Footprint2d& footprint() const { return footprint_; }

  // Whether somebody may be met at all: at no time a base goes farther than at its first speed.
  bool reaches(const State& at, const FloorShape& who) const {
    const double speed = std::fabs(at.v);
    if (speed <= kStill) return false;
    double far = std::max(farthest_, aside_), longest = lasts_;
    for (const Stop& stop : stop_) {
      far = std::max(far, speed * stop.delay + speed * speed / (2 * stop.a));
      longest = std::max(longest, stop.delay + speed / stop.a);
    }
    const double step = longest / kLooks, between = std::hypot(who.vx, who.vy) * step;
    for (int k = 0; k < kLooks; ++k) {
      const double gone = std::min(far, speed * step * (k + 1));
      if (who.distance(at.x, at.y, step * k) < around(who, far) + between + gone) return true;
    }
    return false;
  }
  double around(const FloorShape& who, double far) const {
    return footprint_.reach() + kFarOff * std::hypot(spread_, drift_ * far, who.spread);
  }
  // How far somebody is at least while a base comes to rest that goes so far, less what both reach and blur.
  double nearest(double x, double y, const FloorShape& who, double longest, double far) const {
    const double v = std::hypot(who.vx, who.vy), step = longest / kLooks;
    double d = who.distance(x, y, 0.0);
    for (int k = 1; v > 0 && k < kLooks; ++k) d = std::min(d, who.distance(x, y, step * k));
    return d - v * step - around(who, std::max(far, farthest_));
  }

  static constexpr int kAll = -1;

  // P by entity of one state, in work.hit; with severities, of those that have one. False if it is zero for all. If one
  // entity alone is asked for, the others are there to stop the base before it, and P of them is not found.
  bool hits(const State& at, const std::vector<FloorShape>& shape, const double* severity, Work& work,
            int only = kAll) const {
    work.slopes = false, work.only = only;
    return follow_all(at, nullptr, shape, severity, work);
  }
  // The same with derivatives, in work.hit_slopes.
  bool hits(const Moving<Dual>& at, const std::vector<FloorShape>& shape, const double* severity, Work& work,
            int only = kAll) const {
    work.only = only;
    work.slopes = true;
    work.hit_slopes.assign(work.hit.size(), Dual(0.0));
    const State value{at.x.value(), at.y.value(), at.yaw.value(), at.v.value(), at.omega.value(), at.time.value()};
    return follow_all(value, &at, shape, severity, work);
  }

 private:
  struct Family {
    bool released;
    double bend;
    bool operator==(const Family&) const = default;
  };
  // Where a failing base goes: its gear, curvature, the angle by which it turns at most; its speed, and how far.
  template <class T> struct Way {
    double sign;
    T bend, most, speed, far;
  };
  struct Stop {
    double p, a, k, delay;
    bool released;
    double bend;
  };
  struct Stray {
    double lasts, aside, turned, spread;
  };
  bool has(const Family& family) const { return std::find(family_.begin(), family_.end(), family) != family_.end(); }

  // Distance of a shape from a base at a place, if it is near enough to be touched.
  template <class T> T apart(const FloorShape& shape, const Place<T>& place) const {
    if (shape.distance(value_of(place.at[0]), value_of(place.at[1]), value_of(place.time)) > touched_within(shape, place))
      return T(kFar);
    return distance(shape, place);
  }
  // Distance of the middle of the base within which a shape may be touched.
  template <class T> double touched_within(const FloorShape& shape, const Place<T>& place) const {
    return footprint_.reach() + kFarOff * length_of(value_of(place.spread), shape.spread);
  }
  template <class T> T distance(const FloorShape& shape, const Place<T>& place) const {
    return footprint_.distance(shape, place.at[0], place.at[1], place.at[2], place.at[3], place.time);
  }
  template <class T> static T blur(const FloorShape& shape, const Place<T>& place) {
    return shape.spread > 0 ? length_of(place.spread, T(shape.spread)) : place.spread;
  }
  template <class T> static bool is_far(const T& apart) { return value_of(apart) >= kFar; }
  // How likely it is touched.
  template <class T> static T touch(const T& apart, const FloorShape& shape, const Place<T>& place) {
    const double most = kFarOff * length_of(value_of(place.spread), shape.spread);
    if (value_of(apart) > most) return T(0.0);
    return 0.5 * complementary_error(T(apart / blur(shape, place) * 0.7071067811865476));
  }
  // Share of the energy that is along the normal where shape j of work.whom is touched: the base closes in on it by
  // part of the way alone that it goes. Of who is small beside the blur the normal is as unknown: half of the energy.
  double head_on(const FloorShape& shape, size_t k, size_t j, const Work& work) const {
    const size_t n = work.whom.size(), to = std::max<size_t>(k, 1);
    if (work.place.size() < 2) return normal_share(0.0, shape, work.place[k]);
    const auto from = [&](size_t i) {
      const double known = work.apart[i * n + j];
      return is_far(known) ? distance(shape, work.place[i]) : known;
    };
    return normal_share((from(to - 1) - from(to)) / std::max(work.place[to].gone, kHardly), shape, work.place[k]);
  }
  template <class T> static T normal_share(const T& closing, const FloorShape& shape, const Place<T>& place) {
    const T along = gp::between(closing, 0.0, 1.0), spread = blur(shape, place);
    const double size = shape.around();
    const T unknown = spread * spread / (spread * spread + size * size);
    return (1 - unknown) * along * along + 0.5 * unknown;
  }
  // Whether a shape may be touched at a place: not while the base has gone, and time has passed, less than is clear
  // around it. `clear` is up to where that is known, as how far the base has gone, with what the shape moves.
  template <class T>
  bool may_touch(const FloorShape& shape, const Place<T>& place, double gone, double moves, double& clear) const {
    if (gone + moves * value_of(place.time) < clear) return false;
    const double d = shape.distance(value_of(place.at[0]), value_of(place.at[1]), value_of(place.time));
    const double room = d - touched_within(shape, place);
    if (room <= 0) return true;
    // What is blurred more and more comes nearer besides.
    clear = gone + moves * value_of(place.time) + room / (1 + kFarOff * drift_);
    return false;
  }
  bool follow_all(const State& at, const Moving<Dual>* slopes, const std::vector<FloorShape>& shape,
                  const double* severity, Work& work) const {
    std::fill(work.hit.begin(), work.hit.end(), 0.0);
    const double speed = std::fabs(at.v);
    if (speed <= kStill) return false;
    double far = 0, longest = 0;
    for (size_t i = 0; i < stop_.size(); ++i) {
      work.free[i] = speed * stop_[i].delay, work.braked[i] = braked(stop_[i], speed);
      far = std::max(far, work.free[i] + work.braked[i]);
      longest = std::max(longest, stop_[i].delay + speed / stop_[i].a);
    }
    const double most =
        std::max({far, farthest_, aside_}) + footprint_.reach() + kFarOff * std::hypot(spread_, drift_ * far);
    work.whom.clear(), work.what.clear();
    for (size_t k = 0; k < shape.size(); ++k) {
      const bool counts = shape[k].entity < 0 || !severity || severity[shape[k].entity] > 0;
      const double moves = shape[k].speed() * std::max(longest, lasts_) + kFarOff * shape[k].spread;
      if (counts && shape[k].distance(at.x, at.y, 0.0) < most + moves)
        (shape[k].entity < 0 ? work.what : work.whom).push_back(k);
    }
    // Those who are asked for come first.
    const auto asked = std::stable_partition(work.whom.begin(), work.whom.end(), [&](size_t k) {
      return work.only == kAll || shape[k].entity == work.only;
    });
    work.asked = size_t(asked - work.whom.begin());
    if (work.asked == 0) return false;
    double gap = std::numeric_limits<double>::infinity();  // to the next that may be met, all blur taken off
    for (size_t j = 0; j < work.asked; ++j)
      gap = std::min(gap, nearest(at.x, at.y, shape[work.whom[j]], std::max(longest, lasts_), far));
    // Released wheels go along the others' arc if nothing turns so far.
    const bool alike = std::fabs(at.omega / at.v) * far <= turn_ * at.omega * at.omega;
    for (size_t f = 0; f < family_.size(); ++f) {
      const Family& family = family_[f];
      if (alike && family.released && has({false, family.bend})) continue;
      const std::vector<size_t>& stops = alike ? any_[f] : own_[f];
      double goes = 0;
      for (const size_t i : stops) goes = std::max(goes, work.free[i] + work.braked[i]);
      if (gap > goes) continue;
      const Way<double> way = this->way(at, family, far);
      arc_places(at, way, stops, work);
      meet(shape, work);
      if (!slopes || work.decided.empty()) continue;
      size_t last = 0;
      for (size_t i = 1; i < stop_.size(); ++i)
        if (work.free[i] + work.braked[i] > work.free[last] + work.braked[last]) last = i;
      const Dual v = size_of(slopes->v), all = v * stop_[last].delay + braked(stop_[last], v);
      const Way<Dual> along = this->way(*slopes, family, all);
      later(way, stops, work);
      pull(
          shape, work, [&](int k) { return arc_place(*slopes, along, k, work); },
          [&](int k, size_t i) { return arc_energy(along, k, stop_[stops[i]]); });
    }
    if (!share_.empty()) tabulated(at, slopes, gap, shape, work);
    if (!stray_.empty()) {
      astray(at, shape, work, work.hit);
      if (slopes) astray(*slopes, shape, work, work.hit_slopes);
    }
    return true;
  }
  template <class T> static T braked(const Stop& stop, const T& speed) {
    if (stop.k > 0) return speed / stop.k - stop.a / (stop.k * stop.k) * log_of_one_plus(T(stop.k * speed / stop.a));
    return speed * speed / (2 * stop.a);
  }
  template <class T> Way<T> way(const Moving<T>& at, const Family& family, const T& far) const {
    const double sign = value_of(at.v) < 0 ? -1 : 1;
    const T turns = family.released ? turn_ * at.omega * at.omega : T(kFar);
    return {sign, at.omega / at.v * sign + family.bend, turns, size_of(at.v), far};
  }

  // Raise work.hit by what is met along a way before an obstacle stops the base: of each of its stops what is worth
  // most, for one goes farther than another. Obstacles are asked for only as far as there is somebody to be met.
  void meet(const std::vector<FloorShape>& shape, Work& work) const {
    work.decided.clear();
    if (work.place.empty()) return;
    const size_t stops = work.share.size(), n = work.whom.size(), places = work.place.size();
    size_t last = 0;
    work.apart.assign(places * n, kFar), work.touched.assign(places * n, 0.0);
    work.gone.assign(places, 0.0);
    for (size_t k = 1; k < places; ++k) {
      const double *a = work.place[k - 1].at, *b = work.place[k].at;
      work.gone[k] = work.gone[k - 1] + length_of(b[0] - a[0], b[1] - a[1]);
    }
    for (size_t j = 0; j < n; ++j) {
      if (j == work.asked && last == 0) return;
      const FloorShape& who = shape[work.whom[j]];
      const double moves = who.speed();
      double clear = 0;
      for (size_t k = 0; k < (j < work.asked ? places : last); ++k) {
        const Place<double>& place = work.place[k];
        if (!may_touch(who, place, work.gone[k], moves, clear)) continue;
        const double d = work.apart[k * n + j] = distance(who, place);
        const double touches = work.touched[k * n + j] = touch(d, who, place);
        if (j < work.asked && touches > kHardly) last = std::max(last, k + 1);
      }
    }
    if (last == 0) return;
    work.most.assign(work.hit.size() * stops, 0.0);
    work.met.assign(work.hit.size(), 0.0);
    work.stops.resize(n);
    work.clear.assign(work.what.size(), 0.0);
    if (work.slopes) work.decided.assign(work.most.size(), {}), work.met_at.assign(work.hit.size(), {});
    double stopped = 0;
    Pair stopped_at;
    for (size_t k = 0; k < last; ++k) {
      const Place<double>& place = work.place[k];
      for (size_t j = 0; j < work.what.size(); ++j) {
        const FloorShape& what = shape[work.what[j]];
        if (!may_touch(what, place, work.gone[k], what.speed(), work.clear[j])) continue;
        const double touches = touch(distance(what, place), what, place);
        if (touches > stopped) stopped = touches, stopped_at = {int(k), int(j)};
      }
      if (stopped >= 1 - kHardly) break;
      for (size_t j = 0; j < n; ++j) {
        const double touches = work.touched[k * n + j];
        work.stops[j] = 0;
        if (touches <= kHardly) continue;
        const size_t own = size_t(shape[work.whom[j]].entity);
        double before = stopped;  // whom it met before stops it as well
        Decided decided{{int(k), int(j)}, stopped_at, true};
        for (size_t i = 0; i < n; ++i) {
          const size_t other = size_t(shape[work.whom[i]].entity);
          if (other == own || work.met[other] <= before) continue;
          before = work.met[other];
          if (work.slopes) decided.before = work.met_at[other], decided.by_obstacle = false;
        }
        const double along = head_on(shape[work.whom[j]], k, j, work), reaches = (1 - before) * touches;
        work.stops[j] = touches * along;
        if (j >= work.asked) continue;
        const double* energy = &work.energy[k * stops];
        double* most = &work.most[own * stops];
        for (size_t i = 0; i < stops; ++i) {
          const double worth = std::min(1.0, energy[i] * along) * reaches;
          if (worth <= most[i]) continue;
          most[i] = worth;
          if (work.slopes) work.decided[own * stops + i] = decided;
        }
      }
      for (size_t j = 0; j < n; ++j) {
        const size_t own = size_t(shape[work.whom[j]].entity);
        if (work.stops[j] <= work.met[own]) continue;
        work.met[own] = work.stops[j];
        if (work.slopes) work.met_at[own] = {int(k), int(j)};
      }
    }
    for (size_t e = 0; e < work.hit.size(); ++e)
      for (size_t i = 0; i < stops; ++i) work.hit[e] += work.share[i] * work.most[e * stops + i];
  }
  // Raise work.hit_slopes by the derivatives of what meet() has found: of what decided it alone. Places and energies
  // with derivatives are asked for as place(k) and energy(k, stop).
  template <class PlaceOf, class Energy>
  void pull(const std::vector<FloorShape>& shape, Work& work, const PlaceOf& place, const Energy& energy) const {
    const size_t stops = work.share.size();
    work.known.clear();
    const auto known = [&](const Pair& pair, bool obstacle) -> Work::Known {
      for (const Work::Known& one : work.known)
        if (one.pair == pair && one.obstacle == obstacle) return one;
      const FloorShape& who = shape[obstacle ? work.what[size_t(pair.shape)] : work.whom[size_t(pair.shape)]];
      const int to = std::max(pair.place, 1), last = int(work.place.size()) - 1;
      const Place<Dual> here = place(pair.place);
      const Dual apart = distance(who, here);
      Work::Known one{pair, obstacle, touch(apart, who, here), Dual(0.0)};
      if (!obstacle && last > 0) {
        const Place<Dual> from = pair.place > 0 ? place(to - 1) : here, there = pair.place > 0 ? here : place(to);
        const Dual closing = pair.place > 0 ? distance(who, from) - apart : apart - distance(who, there);
        one.along = normal_share(Dual(closing / larger(there.gone, Dual(kHardly))), who, here);
      } else if (!obstacle) {
        one.along = normal_share(Dual(0.0), who, here);
      }
      work.known.push_back(one);
      return one;
    };
    for (size_t e = 0; e < work.hit.size(); ++e)
      for (size_t i = 0; i < stops; ++i) {
        const Decided& decided = work.decided[e * stops + i];
        if (decided.met.place < 0) continue;
        const Work::Known met = known(decided.met, false);
        Dual reaches = met.touches;
        if (decided.before.place >= 0) {
          const Work::Known before = known(decided.before, decided.by_obstacle);
          reaches = reaches * (1 - (decided.by_obstacle ? before.touches : before.touches * before.along));
        }
        const Dual worth = smaller(Dual(1.0), Dual(energy(decided.met.place, i) * met.along));
        work.hit_slopes[e] += work.share[i] * (worth * reaches);
      }
  }

  // The k-th place along an arc and what comes after it, but for its time.
  template <class T> Place<T> arc_place(const Moving<T>& q, const Way<T>& way, int k) const {
    const bool bends = std::fabs(value_of(way.bend)) > 0;
    const T arc = bends ? way.most / size_of(way.bend) : T(kFar), before = done(way, k - 1), all = done(way, k);
    const T curved = smaller(all, arc), straight = all - curved;
    const T turned = way.bend * curved, half = 0.5 * turned, chord = way.sign * curved * sine_ratio(half);
    const T ch = cosine(T(q.yaw + turned)), sh = sine(T(q.yaw + turned)), middle = q.yaw + half;
    return {{q.x + chord * cosine(middle) + way.sign * straight * ch,
             q.y + chord * sine(middle) + way.sign * straight * sh, ch, sh},
            q.time,
            length_of(T(spread_), T(drift_ * all)),
            k > 0 ? all - before : all};
  }
  Place<Dual> arc_place(const Moving<Dual>& q, const Way<Dual>& way, int k, const Work& work) const {
    Place<Dual> place = arc_place(q, way, k);
    const double time = work.place[size_t(k)].time - q.time.value();
    place.time += size_of(q.v).through(time, (work.later[size_t(k)] - time) / kNudge);
    return place;
  }
  template <class T> static T done(const Way<T>& way, int k) { return smaller(way.far, T(kSpacing * k)); }
  // What is touched at a place may have been met anywhere since the place before.
  template <class T> static T half_done(const Way<T>& way, int k) {
    return k == 0 ? T(0.0) : T(0.5 * (done(way, k) + kSpacing * (k - 1)));
  }
  // The energy that is left there to a base that comes to rest in one way.
  template <class T> T arc_energy(const Way<T>& way, int k, const Stop& stop) const {
    const T free = way.speed * stop.delay, stops = larger(braked(stop, way.speed), T(1e-12));
    const T left = gp::between(T(1 - (half_done(way, k) - free) / stops), 0.0, 1.0);
    return left * way.speed * way.speed / (unit_ * unit_);
  }
  // Places along an arc and what comes after it.
  void arc_places(const State& q, const Way<double>& way, const std::vector<size_t>& stops, Work& work) const {
    const double whole = way.speed * way.speed / (unit_ * unit_);
    double time = q.time;
    work.place.clear(), work.energy.clear(), work.share.clear();
    for (const size_t i : stops) work.share.push_back(stop_[i].p);
    for (int k = 0; k < kSamples && kSpacing * (k - 1) < way.far; ++k) {
      const double met = half_done(way, k);
      double moving = 0, left_of = 0;
      const size_t row = work.energy.size();
      for (const size_t i : stops) {
        const double left = std::clamp(1 - (met - work.free[i]) / std::max(work.braked[i], 1e-12), 0.0, 1.0);
        work.energy.push_back(left * whole);
        if (left > 0) moving += stop_[i].p, left_of += stop_[i].p * left;
      }
      if (left_of <= 0 && k > 1) {  // two places tell which way it goes
        work.energy.resize(row);
        break;
      }
      Place<double> place = arc_place(q, way, k);
      time += place.gone / (way.speed * std::max(moving > 0 ? std::sqrt(left_of / moving) : 0.0, kSlowest));
      place.time = time;
      work.place.push_back(place);
    }
  }
  // When the base would be at the same places if it were slightly faster, for how times depend on the speed.
  void later(Way<double> way, const std::vector<size_t>& stops, Work& work) const {
    way.speed += kNudge;
    work.later.clear();
    double time = 0;
    for (int k = 0; k < int(work.place.size()); ++k) {
      double moving = 0, left_of = 0;
      for (const size_t i : stops) {
        const double left = arc_energy(way, k, stop_[i]) * unit_ * unit_ / (way.speed * way.speed);
        if (left > 0) moving += stop_[i].p, left_of += stop_[i].p * left;
      }
      const double slower = moving > 0 ? std::sqrt(left_of / moving) : 0.0;
      work.later.push_back(time += work.place[size_t(k)].gone / (way.speed * std::max(slower, kSlowest)));
    }
  }
  static double sine_ratio(double x) { return std::fabs(x) > 1e-9 ? std::sin(x) / x : 1.0; }
  static Dual sine_ratio(const Dual& x) { return std::fabs(x.value()) > 1e-9 ? sine(x) / x : Dual(1.0); }

  // Places of bases that spin, from tables by speed and rate of turning; what drives backwards is the same turned
  // round.
  void tabulated(const State& q, const Moving<Dual>* slopes, double gap, const std::vector<FloorShape>& shape,
                 Work& work) const {
    const double speed = std::fabs(q.v);
    // States of a batch often differ by place and time alone.
    if (work.spun.empty() || work.spun_speed != speed || work.spun_rate != q.omega) spin(speed, q.omega, work);
    for (size_t f = 0; f < share_.size(); ++f) {
      if (gap > work.spun_reach[f]) continue;
      work.place.clear(), work.energy.clear(), work.share.assign(1, share_[f]);
      for (size_t k = 0; k < samples_; ++k) {
        const Spun<double>& row = work.spun[f * samples_ + k];
        work.place.push_back(spun_place(q, row)), work.energy.push_back(row.energy);
      }
      meet(shape, work);
      if (!slopes || work.decided.empty()) continue;
      const auto row = [&](int k) { return spun(size_of(slopes->v), slopes->omega, f, size_t(k)); };
      pull(
          shape, work, [&](int k) { return spun_place(*slopes, row(k)); },
          [&](int k, size_t) { return row(k).energy; });
    }
  }
  template <class T> static Place<T> spun_place(const Moving<T>& q, const Spun<T>& row) {
    const double sign = value_of(q.v) < 0 ? -1 : 1;
    const T c = cosine(q.yaw), s = sine(q.yaw), x = sign * row.x, y = sign * row.y;
    return {{q.x + c * x - s * y, q.y + s * x + c * y, c * row.cos - s * row.sin, s * row.cos + c * row.sin},
            row.time + q.time,
            row.spread,
            row.gone};
  }
  void spin(double speed, double rate, Work& work) const {
    work.spun_reach.assign(share_.size(), 0.0);
    work.spun.clear(), work.spun_speed = speed, work.spun_rate = rate;
    for (size_t f = 0; f < share_.size(); ++f)
      for (size_t k = 0; k < samples_; ++k) {
        work.spun.push_back(spun(speed, rate, f, k));
        work.spun_reach[f] = std::max(work.spun_reach[f], length_of(work.spun.back().x, work.spun.back().y));
      }
  }
  template <class T> Spun<T> spun(const T& speed, const T& rate, size_t table, size_t sample) const {
    const Node<T> v = node(speeds_, speed), w = node(rates_, rate);
    T p[kPlace] = {}, before(0.0);
    for (int i = 0; i < 2; ++i)
      for (int j = 0; j < 2; ++j) {
        const T weight = (i ? v.part : 1 - v.part) * (j ? w.part : 1 - w.part);
        const size_t cell = (v.low + size_t(i)) * rates_.size() + w.low + size_t(j);
        const double* row = &place_[((cell * share_.size() + table) * samples_ + sample) * kPlace];
        for (size_t n = 0; n < kPlace; ++n) p[n] += weight * row[n];
        if (sample > 0) before += weight * row[4 - long(kPlace)];
      }
    const T far = length_of(p[0], p[1]), gone = sample == 0 ? T(0.0) : T(p[3] * (p[4] - before));
    return {p[0], p[1], cosine(p[2]), sine(p[2]), p[4], length_of(T(spread_), T(drift_ * far)), gone,
            p[3] * p[3] / (unit_ * unit_)};
  }
  // Bases that went astray before they came here, beside the way: who is met in the next moment that is not met yet,
  // for as long as they have been astray. Along a way this adds up to how likely they are met at all.
  template <class T>
  void astray(const Moving<T>& q, const std::vector<FloorShape>& shape, const Work& work, std::vector<T>& hit) const {
    const double sign = value_of(q.v) < 0 ? -1 : 1, step = sign * kNext;
    const T speed = size_of(q.v), whole = speed * speed / (unit_ * unit_), half = 0.5 * q.omega / speed * kNext;
    const T c = cosine(q.yaw), s = sine(q.yaw);
    std::vector<T> met(hit.size());
    for (const Stray& stray : stray_) {
      const T yaw = q.yaw + stray.turned * sign, spread(stray.spread);
      const Place<T> between{{q.x - 0.5 * stray.aside * s, q.y + 0.5 * stray.aside * c, c, s}, q.time, spread, T(0.0)};
      const Place<T> now{{q.x - stray.aside * s, q.y + stray.aside * c, cosine(yaw), sine(yaw)}, q.time, spread, T(0.0)};
      const T middle = yaw + half, end = yaw + 2 * half;
      const Place<T> next{{now.at[0] + step * cosine(middle), now.at[1] + step * sine(middle), cosine(end), sine(end)},
                          q.time,
                          spread,
                          T(kNext)};
      std::fill(met.begin(), met.end(), T(0.0));
      bool any = false;
      for (size_t j = 0; j < work.asked; ++j) {
        const size_t k = work.whom[j];
        const T then = apart(shape[k], next);
        if (is_far(then)) continue;
        const T before = distance(shape[k], now), more = touch(then, shape[k], next) - touch(before, shape[k], now);
        if (value_of(more) <= kHardly) continue;
        T& most = met[size_t(shape[k].entity)];
        const T along = normal_share(T((before - then) / kNext), shape[k], next);
        most = larger(most, T(more * smaller(T(1.0), T(along * whole)))), any = true;
      }
      if (!any) continue;
      T stopped(0.0);
      for (const size_t k : work.what)
        for (const Place<T>& place : {between, now})
          stopped = larger(stopped, touch(apart(shape[k], place), shape[k], place));
      for (size_t e = 0; e < hit.size(); ++e)
        hit[e] = smaller(T(1.0), T(hit[e] + stray.lasts * speed / kNext * (1 - stopped) * met[e]));
    }
  }
  template <class T> struct Node {
    size_t low;
    T part;
  };
  template <class T> static Node<T> node(const std::vector<double>& grid, const T& value) {
    const size_t last = grid.size() - 1;
    const size_t above = size_t(std::upper_bound(grid.begin(), grid.end(), value_of(value)) - grid.begin());
    const size_t low = std::min(above > 0 ? above - 1 : 0, last - 1);
    return {low, gp::between(T((value - grid[low]) / (grid[low + 1] - grid[low])), 0.0, 1.0)};
  }
  static std::vector<double> ascending(const Reals& values, const char* what) {
    require_numbers(values, what);
    require(values.size() >= 2, what);
    for (size_t k = 1; k < values.size(); ++k) require(values.data()[k] > values.data()[k - 1], what);
    return {values.data(), values.data() + values.size()};
  }
  void strays(const Reals& of) {
    require_numbers(of, "bases astray");
    require(of.size() % kStrayed == 0, "bases astray");
    for (size_t k = 0; k < of.size(); k += kStrayed) {
      const double* s = of.data() + k;
      require(s[0] >= 0 && s[3] > 0, "base astray");
      stray_.push_back({s[0], s[1], s[2], s[3]});
      aside_ = std::max(aside_, std::fabs(s[1]) + kNext + kFarOff * s[3]);
    }
  }
  void tables(const CoastingArrays& of) {
    require_numbers(of.share, "probability of a table"), require_numbers(of.places, "places of a base");
    if (of.share.size() == 0) return;
    share_.assign(of.share.data(), of.share.data() + of.share.size());
    for (double p : share_) require(p >= 0, "probability of a table");
    speeds_ = ascending(of.speeds, "speeds of the tables"), rates_ = ascending(of.rates, "rates of the tables");
    const size_t whole = speeds_.size() * rates_.size() * share_.size() * kPlace;
    require(of.places.size() > 0 && of.places.size() % whole == 0, "places of a base");
    samples_ = of.places.size() / whole;
    require(samples_ > 1, "places of a base");
    place_.assign(of.places.data(), of.places.data() + of.places.size());
    for (size_t k = 0; k < place_.size(); k += kPlace) {
      farthest_ = std::max(farthest_, std::hypot(place_[k], place_[k + 1]));
      lasts_ = std::max(lasts_, place_[k + 4]);
    }
  }

  static constexpr size_t kStop = 6, kPlace = 5, kStrayed = 4;
  static constexpr int kSamples = 64;      // places along the way at which is seen what it meets, at most
  static constexpr int kLooks = 16;        // times at which is seen whether somebody may be near
  static constexpr double kSpacing = 0.1;  // between them [m]
  static constexpr double kNext = 0.05;    // how far the next moment of a base is that is astray [m]
  static constexpr double kStill = 1e-6;   // speed below which a base stands [m/s]
  static constexpr double kFarOff = 6;     // spreads beyond which nothing is touched
  static constexpr double kNudge = 1e-6;   // of a speed, for a difference [m/s]
  static constexpr double kFar = 1e9;      // distance of what is nowhere near [m]
  static constexpr double kHardly = 1e-9;  // probability of a touch that is none
  static constexpr double kSlowest = 0.1;  // share of the speed below which time is not stretched further

  Footprint2d footprint_;
  std::vector<Stop> stop_;
  std::vector<Family> family_;
  std::vector<std::vector<size_t>> own_, any_;  // stops of each: its own, and those of both kinds of wheels
  std::vector<double> share_, speeds_, rates_, place_;
  std::vector<Stray> stray_;
  size_t samples_ = 0;
  double unit_ = 1, spread_ = 1, drift_ = 0, turn_ = 0, farthest_ = 0, lasts_ = 0;
  double aside_ = 0;  // how far beside their way bases are that are astray, blur and all
};

}  // namespace gp

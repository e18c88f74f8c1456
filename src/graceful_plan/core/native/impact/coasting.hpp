// Where a base goes that fails while it drives, and whom it meets there. The equations are those of
// costs/models/coast/coast.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "checks.hpp"

namespace gp {

// std::hypot is several times slower; nothing here is so large that squares overflow.
inline double root_of_squares(double a, double b) { return std::sqrt(a * a + b * b); }

// Rectangles from above that may be rounded and move: what is met.
struct FloorShape {
  int entity;  // -1: an obstacle
  double x, y, ux, uy, a, b, round, vx, vy;
  double spread = 0;  // standard deviation of its place

  double around() const { return root_of_squares(a, b) + round; }  // radius of a circle around it
  // Of a point at a time; inside of a rectangle minus the way to its nearest side.
  double distance(double px, double py, double time) const {
    const double dx = px - x - vx * time, dy = py - y - vy * time;
    const double ex = std::fabs(ux * dx + uy * dy) - a, ey = std::fabs(-uy * dx + ux * dy) - b;
    const double ox = std::max(ex, 0.0), oy = std::max(ey, 0.0);
    return std::sqrt(ox * ox + oy * oy) + std::min(std::max(ex, ey), 0.0) - round;
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
      within_.push_back(root_of_squares(s[4], s[5]) + s[6]);
      reach_ = std::max(reach_, root_of_squares(s[0], s[1]) + within_.back());
    }
  }
  double reach() const { return reach_; }
  // Of the base at a place, with a heading of this cosine and sine, to a shape at a time; infinite or more than `far`
  // if it is that.
  double distance(const FloorShape& shape, double x, double y, double c, double s, double time,
                  double far = std::numeric_limits<double>::infinity()) const {
    const double dx = shape.x + shape.vx * time - x, dy = shape.y + shape.vy * time - y;
    const FloorShape seen{shape.entity,
                          c * dx + s * dy,
                          c * dy - s * dx,
                          c * shape.ux + s * shape.uy,
                          c * shape.uy - s * shape.ux,
                          shape.a,
                          shape.b,
                          shape.round,
                          0,
                          0};
    double d = std::numeric_limits<double>::infinity();
    for (size_t k = 0; k < part_.size(); ++k)
      if (seen.distance(part_[k].x, part_[k].y, 0) - within_[k] < std::min(d, far))
        d = std::min(d, between(part_[k], seen));
    return d;
  }

 private:
  // Of two shapes that rest; where they overlap, minus the way that parts them.
  static double between(const FloorShape& one, const FloorShape& other) {
    if (other.a == 0 && other.b == 0) return one.distance(other.x, other.y, 0) - other.round;
    if (one.a == 0 && one.b == 0) return other.distance(one.x, one.y, 0) - one.round;
    const double apart = std::max(gap(one, other), gap(other, one));
    const double corners = apart > 0 ? std::min(nearest(one, other), nearest(other, one)) : apart;
    return corners - one.round - other.round;
  }
  // How far apart two rectangles are along the sides of the first.
  static double gap(const FloorShape& one, const FloorShape& other) {
    const double dx = other.x - one.x, dy = other.y - one.y;
    const double c = std::fabs(one.ux * other.ux + one.uy * other.uy);
    const double s = std::fabs(one.ux * other.uy - one.uy * other.ux);
    return std::max(std::fabs(one.ux * dx + one.uy * dy) - one.a - c * other.a - s * other.b,
                    std::fabs(one.ux * dy - one.uy * dx) - one.b - s * other.a - c * other.b);
  }
  // Distance of the corners of the second from the first.
  static double nearest(const FloorShape& one, const FloorShape& other) {
    double d = std::numeric_limits<double>::infinity();
    for (const double a : {-other.a, other.a})
      for (const double b : {-other.b, other.b})
        d = std::min(d, one.distance(other.x + a * other.ux - b * other.uy, other.y + a * other.uy + b * other.ux, 0));
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
  // the place before, `far` how far it is at most from where the base failed.
  struct Place {
    double at[4], time, spread, gone, far;
  };

 public:
  // A shape, and how far it is from where the base fails; of one that moves, or may be elsewhere, less than that.
  struct Near {
    size_t shape;
    double away;
    bool operator<(const Near& other) const { return away < other.away; }
  };
  // The same of a base that spins, in its own frame.
  struct Spun {
    double x, y, cos, sin, time, spread, gone, energy, far;
  };

  // Where along each way one entity was met, as far as that decided P: for states next to the one that it is known of.
  struct Focus {
    struct Range {
      size_t first = 1, last = 0;  // places; none if they are in this order
      bool blocked = false;        // whether anything may have stopped the base before
      bool empty() const { return first > last; }
    };
    bool known = false;
    std::vector<Range> of;
  };
  // What is written to for each state.
  struct Work {
    Work(const Coasting& of, size_t n_entity) : hit(n_entity), free(of.stop_.size()), braked(of.stop_.size()) {}
    std::vector<double> hit, most, met, free, braked;
    std::vector<double> apart, touched;  // by place and shape that is near enough
    std::vector<double> stops;           // by shape that is near enough: how likely the base loses its energy there
    std::vector<double> energy;          // by place and stop, over that at the speed that severities are for
    std::vector<double> share;           // probability of each stop
    std::vector<Near> whom, what;        // shapes that are near enough: of entities, and obstacles
    std::vector<size_t> decides;         // place of each stop that is worth most
    std::vector<double> blocked;         // P that something stopped the base before that
    Focus* focus = nullptr;
    size_t asked = 0;  // how many of whom, which come first, are asked for; others by how far they are
    std::vector<Place> place;
    std::vector<Spun> spun;           // of the tables, at the speed and rate of turning of the state before
    std::vector<uint8_t> spun_known;  // which of the tables
    double spun_speed = 0, spun_rate = 0;
  };
  struct State {
    double x, y, yaw, v, omega;
  };

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

  static constexpr int kAll = -1;

  // Whether somebody may be met at all: at no time a base goes farther than at its first speed.
  bool reaches(const State& at, const FloorShape& who) const {
    const double speed = std::fabs(at.v);
    if (speed <= kStill) return false;
    double far = std::max(farthest_, aside_), longest = lasts_;
    for (const Stop& stop : stop_) {
      far = std::max(far, speed * stop.delay + speed * speed / (2 * stop.a));
      longest = std::max(longest, stop.delay + speed / stop.a);
    }
    const double step = longest / kLooks, between = root_of_squares(who.vx, who.vy) * step;
    for (int k = 0; k < kLooks; ++k) {
      const double gone = std::min(far, speed * step * (k + 1));
      if (who.distance(at.x, at.y, step * k) < around(who, far) + between + gone) return true;
    }
    return false;
  }
  double around(const FloorShape& who, double far) const {
    return footprint_.reach() +
           kFarOff * std::sqrt(spread_ * spread_ + drift_ * far * drift_ * far + who.spread * who.spread);
  }
  // How far somebody is at least while a base comes to rest that goes so far, less what both reach and blur.
  double nearest(const State& at, const FloorShape& who, double longest, double far) const {
    const double v = root_of_squares(who.vx, who.vy), step = longest / kLooks;
    double d = who.distance(at.x, at.y, 0);
    for (int k = 1; v > 0 && k < kLooks; ++k) d = std::min(d, who.distance(at.x, at.y, step * k));
    return d - v * step - around(who, std::max(far, farthest_));
  }

  // P by entity of one state, in work.hit; with severities, of those that have one. False if it is zero for all. If one
  // entity alone is asked for, the others are there to stop the base before it, and P of them is not found.
  bool hits(const State& at, const std::vector<FloorShape>& shape, const double* severity, Work& work, int only = kAll,
            Focus* focus = nullptr) const {
    work.focus = focus;
    if (focus && !focus->known) focus->of.assign(family_.size() + share_.size(), {});
    std::fill(work.hit.begin(), work.hit.end(), 0.0);
    const double speed = std::fabs(at.v);
    if (speed <= kStill) return false;
    double far = 0, longest = 0;
    for (size_t i = 0; i < stop_.size(); ++i) {
      const Stop& stop = stop_[i];
      work.free[i] = speed * stop.delay;
      work.braked[i] = stop.k > 0 ? speed / stop.k - stop.a / (stop.k * stop.k) * std::log1p(stop.k * speed / stop.a)
                                  : speed * speed / (2 * stop.a);
      far = std::max(far, work.free[i] + work.braked[i]);
      longest = std::max(longest, stop.delay + speed / stop.a);
    }
    const double most =
        std::max({far, farthest_, aside_}) + footprint_.reach() + kFarOff * root_of_squares(spread_, drift_ * far);
    work.whom.clear(), work.what.clear();
    for (size_t k = 0; k < shape.size(); ++k) {
      const bool counts = shape[k].entity < 0 || !severity || severity[shape[k].entity] > 0;
      const double moves =
          root_of_squares(shape[k].vx, shape[k].vy) * std::max(longest, lasts_) + kFarOff * shape[k].spread;
      const double away = shape[k].distance(at.x, at.y, 0);
      if (counts && away < most + moves)
        (shape[k].entity < 0 ? work.what : work.whom).push_back({k, moves > 0 ? away - most - moves : away});
    }
    // Those who are asked for come first.
    const auto asked = std::partition(work.whom.begin(), work.whom.end(), [&](const Near& near) {
      return only == kAll || shape[near.shape].entity == only;
    });
    work.asked = size_t(asked - work.whom.begin());
    if (work.asked == 0) return false;
    std::sort(asked, work.whom.end()), std::sort(work.what.begin(), work.what.end());
    double gap = std::numeric_limits<double>::infinity();  // to the next that may be met, all blur taken off
    for (size_t j = 0; j < work.asked; ++j)
      gap = std::min(gap, nearest(at, shape[work.whom[j].shape], std::max(longest, lasts_), far));
    const double sign = at.v < 0 ? -1 : 1, bend = at.omega / at.v * sign;
    const double straightens = turn_ * at.omega * at.omega;
    // Released wheels go along the others' arc if nothing turns so far.
    const bool alike = std::fabs(bend) * far <= straightens;
    for (size_t f = 0; f < family_.size(); ++f) {
      const Family& family = family_[f];
      if (alike && family.released && has({false, family.bend})) continue;
      double goes = 0;
      for (const size_t i : alike ? any_[f] : own_[f]) goes = std::max(goes, work.free[i] + work.braked[i]);
      if (gap > goes || passes_over(work, f)) continue;
      const double turns = family.released ? straightens : std::numeric_limits<double>::infinity();
      follow(at, {sign, bend + family.bend, turns, speed, far, alike ? any_[f] : own_[f], f}, shape, work);
    }
    if (!share_.empty()) tabulated(at, gap, shape, work);
    if (!stray_.empty()) astray(at, shape, work);
    return true;
  }

 private:
  struct Family {
    bool released;
    double bend;
    bool operator==(const Family&) const = default;
  };
  // Where a failing base goes: its gear, curvature, the angle by which it turns at most; its speed, and how far; which
  // stops are meant.
  struct Way {
    double sign, bend, most, speed, far;
    const std::vector<size_t>& stops;
    size_t trail;
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

  // Whether it is known that nobody is met along a way.
  static bool passes_over(const Work& work, size_t trail) {
    return work.focus && work.focus->known && work.focus->of[trail].empty();
  }

  // Distance of a shape from a base at a place, if it is near enough to be touched.
  double apart(const FloorShape& shape, const Place& place) const {
    const double far = kFarOff * blur(shape, place), reach = footprint_.reach() + far;
    if (shape.distance(place.at[0], place.at[1], place.time) > reach) return std::numeric_limits<double>::infinity();
    return footprint_.distance(shape, place.at[0], place.at[1], place.at[2], place.at[3], place.time, far);
  }
  double distance(const FloorShape& shape, const Place& place) const {
    return footprint_.distance(shape, place.at[0], place.at[1], place.at[2], place.at[3], place.time);
  }
  static double blur(const FloorShape& shape, const Place& place) {
    return shape.spread > 0 ? root_of_squares(place.spread, shape.spread) : place.spread;
  }
  // How likely it is touched.
  static double touch(double apart, const FloorShape& shape, const Place& place) {
    return std::isinf(apart) ? 0.0 : 0.5 * std::erfc(apart / blur(shape, place) * 0.7071067811865476);
  }
  // How far what rests may be from where the base fails and still be touched at a place.
  double reached(const Place& place) const { return place.far + footprint_.reach() + kFarOff * place.spread; }
  // How likely an obstacle is touched at a place.
  double stopped_at(const Place& place, const std::vector<FloorShape>& shape, const Work& work) const {
    const double within = reached(place);
    double most = 0;
    for (const Near& near : work.what) {
      if (near.away >= within) break;
      most = std::max(most, touch(apart(shape[near.shape], place), shape[near.shape], place));
    }
    return most;
  }
  // Share of the energy that is along the normal where shape j of work.whom is touched: the base closes in on it by
  // part of the way alone that it goes. Of who is small beside the blur the normal is as unknown: half of the energy.
  double head_on(const FloorShape& shape, size_t k, size_t j, const Work& work) const {
    const size_t n = work.whom.size(), to = std::max<size_t>(k, 1);
    const auto from = [&](size_t i) {
      const double known = work.apart[i * n + j];
      return std::isinf(known) ? distance(shape, work.place[i]) : known;
    };
    return normal_share((from(to - 1) - from(to)) / std::max(work.place[to].gone, kHardly), shape, work.place[k]);
  }
  static double normal_share(double closing, const FloorShape& shape, const Place& place) {
    const double along = std::clamp(closing, 0.0, 1.0), spread = blur(shape, place), size = shape.around();
    const double unknown = spread * spread / (spread * spread + size * size);
    return (1 - unknown) * along * along + 0.5 * unknown;
  }
  // Raise work.hit by what is met along a way before an obstacle stops the base: of each of its stops what is worth
  // most, for one goes farther than another. Obstacles are asked for only as far as there is somebody to be met.
  void meet(const std::vector<FloorShape>& shape, Work& work, size_t trail) const {
    if (work.place.empty()) return;
    if (work.asked < work.whom.size() || work.focus) return meet_one(shape, work, trail);
    const size_t stops = work.share.size(), n = work.whom.size();
    size_t last = 0;
    work.apart.resize(work.place.size() * n), work.touched.resize(work.place.size() * n);
    for (size_t k = 0; k < work.place.size(); ++k) {
      const Place& place = work.place[k];
      for (size_t j = 0; j < n; ++j) {
        const FloorShape& who = shape[work.whom[j].shape];
        const double d = work.apart[k * n + j] = apart(who, place);
        const double touches = work.touched[k * n + j] = touch(d, who, place);
        if (touches > kHardly) last = k + 1;
      }
    }
    if (last == 0) return;
    work.most.assign(work.hit.size() * stops, 0.0);
    double stopped = 0;
    work.met.assign(work.hit.size(), 0.0);
    work.stops.resize(n);
    for (size_t k = 0; k < last; ++k) {
      stopped = std::max(stopped, stopped_at(work.place[k], shape, work));
      for (size_t j = 0; j < n; ++j) {
        const double touches = work.touched[k * n + j];
        work.stops[j] = 0;
        if (touches <= kHardly) continue;
        const size_t own = size_t(shape[work.whom[j].shape].entity);
        double before = stopped;  // whom it met before stops it as well
        for (size_t i = 0; i < n; ++i) {
          const size_t other = size_t(shape[work.whom[i].shape].entity);
          if (other != own) before = std::max(before, work.met[other]);
        }
        const double along = head_on(shape[work.whom[j].shape], k, j, work);
        work.stops[j] = touches * along;
        const double* energy = &work.energy[k * stops];
        double* most = &work.most[own * stops];
        for (size_t i = 0; i < stops; ++i)
          most[i] = std::max(most[i], std::min(1.0, energy[i] * along) * ((1 - before) * touches));
      }
      for (size_t j = 0; j < n; ++j) {
        double& met = work.met[size_t(shape[work.whom[j].shape].entity)];
        met = std::max(met, work.stops[j]);
      }
    }
    for (size_t e = 0; e < work.hit.size(); ++e)
      for (size_t i = 0; i < stops; ++i) work.hit[e] += work.share[i] * work.most[e * stops + i];
  }
  // The same of one entity. Places that are worth no more than others, whoever is touched there, are passed over; the
  // others are looked at where it is known that the base comes so far.
  void meet_one(const std::vector<FloorShape>& shape, Work& work, size_t trail) const {
    const size_t stops = work.share.size(), n = work.whom.size();
    Focus::Range* range = work.focus ? &work.focus->of[trail] : nullptr;
    const bool known = range && work.focus->known, alone = known && !range->blocked;
    const size_t end = known ? std::min(work.place.size(), range->last + 1) : work.place.size();
    work.apart.assign(end * n, std::numeric_limits<double>::infinity());
    work.most.assign(stops, 0.0), work.decides.assign(stops, 0), work.blocked.assign(stops, 0.0);
    size_t obstacles = 0, others = 0;  // places at which they were looked at
    double stopped = 0, met = 0;
    for (size_t k = known ? range->first : 0; k < end; ++k) {
      const double* energy = &work.energy[k * stops];
      const auto worth = [&](double touched) {
        for (size_t i = 0; i < stops; ++i)
          if (std::min(1.0, energy[i]) * touched > work.most[i]) return true;
        return false;
      };
      if (!worth(1.0)) continue;
      for (size_t j = 0; j < work.asked; ++j) {
        const FloorShape& who = shape[work.whom[j].shape];
        const double d = work.apart[k * n + j] = apart(who, work.place[k]), touched = touch(d, who, work.place[k]);
        if (touched <= kHardly || !worth(touched)) continue;
        for (; !alone && obstacles <= k; ++obstacles)
          stopped = std::max(stopped, stopped_at(work.place[obstacles], shape, work));
        for (; !alone && others < k; ++others) met = std::max(met, others_at(others, shape, work));
        const double before = std::max(stopped, met), along = head_on(who, k, j, work);
        for (size_t i = 0; i < stops; ++i) {
          const double harm = std::min(1.0, energy[i] * along) * ((1 - before) * touched);
          if (harm > work.most[i]) work.most[i] = harm, work.decides[i] = k, work.blocked[i] = before;
        }
      }
    }
    double& hit = work.hit[size_t(shape[work.whom.front().shape].entity)];
    for (size_t i = 0; i < stops; ++i) {
      hit += work.share[i] * work.most[i];
      if (!range || known || !(work.most[i] > 0)) continue;
      const size_t k = work.decides[i];
      *range = {range->empty() ? k : std::min(range->first, k), std::max(range->last, k),
                range->blocked || work.blocked[i] > kBlocked};
    }
  }
  // How likely the base loses its energy at a place to somebody who is not asked for.
  double others_at(size_t k, const std::vector<FloorShape>& shape, Work& work) const {
    const size_t n = work.whom.size();
    const double within = reached(work.place[k]);
    double most = 0;
    for (size_t j = work.asked; j < n && work.whom[j].away < within; ++j) {
      const FloorShape& who = shape[work.whom[j].shape];
      const double d = work.apart[k * n + j] = apart(who, work.place[k]), touched = touch(d, who, work.place[k]);
      if (touched > std::max(kHardly, most)) most = std::max(most, touched * head_on(who, k, j, work));
    }
    return most;
  }

  // Follow an arc and what comes after it, and raise work.hit.
  void follow(const State& q, const Way& way, const std::vector<FloorShape>& shape, Work& work) const {
    const double whole = way.speed * way.speed / (unit_ * unit_);
    const double arc = way.bend != 0 ? way.most / std::fabs(way.bend) : std::numeric_limits<double>::infinity();
    double time = 0, before = 0;
    work.place.clear(), work.energy.clear(), work.share.clear();
    for (const size_t i : way.stops) work.share.push_back(stop_[i].p);
    const bool known = work.focus && work.focus->known;
    const size_t most = known ? std::max<size_t>(work.focus->of[way.trail].last, 1) + 1 : size_t(kSamples);
    for (int k = 0; size_t(k) < most && kSpacing * (k - 1) < way.far; ++k) {
      const double done = std::min(way.far, kSpacing * k), curved = std::min(done, arc), straight = done - curved;
      const double turned = way.bend * curved, half = 0.5 * turned;
      const double chord = way.sign * curved * (std::fabs(half) > 1e-9 ? std::sin(half) / half : 1.0);
      const double ch = std::cos(q.yaw + turned), sh = std::sin(q.yaw + turned);
      const double at[4] = {q.x + chord * std::cos(q.yaw + half) + way.sign * straight * ch,
                            q.y + chord * std::sin(q.yaw + half) + way.sign * straight * sh, ch, sh};
      // What is touched at a place may have been met anywhere since the place before.
      const double met = k == 0 ? done : 0.5 * (done + kSpacing * (k - 1));
      double moving = 0, left_of = 0;
      const size_t row = work.energy.size();
      for (const size_t i : way.stops) {
        const double left = std::clamp(1 - (met - work.free[i]) / std::max(work.braked[i], 1e-12), 0.0, 1.0);
        work.energy.push_back(left * whole);
        if (left > 0) moving += stop_[i].p, left_of += stop_[i].p * left;
      }
      if (left_of <= 0 && k > 1) {  // two places tell which way it goes
        work.energy.resize(row);
        break;
      }
      const double gone = done - before;
      const double slower = moving > 0 ? std::sqrt(left_of / moving) : 0;
      time += gone / (way.speed * std::max(slower, kSlowest)), before = done;
      work.place.push_back({{at[0], at[1], at[2], at[3]}, time, root_of_squares(spread_, drift_ * done), gone, done});
    }
    meet(shape, work, way.trail);
  }

  // Places of bases that spin, from tables by speed and rate of turning; what drives backwards is the same turned
  // round.
  void tabulated(const State& q, double gap, const std::vector<FloorShape>& shape, Work& work) const {
    const double speed = std::fabs(q.v), sign = q.v < 0 ? -1 : 1, c = std::cos(q.yaw), s = std::sin(q.yaw);
    // States of a batch often differ by place and time alone.
    if (work.spun_known.empty() || work.spun_speed != speed || work.spun_rate != q.omega) {
      work.spun_speed = speed, work.spun_rate = q.omega;
      work.spun_known.assign(share_.size(), 0), work.spun.resize(share_.size() * samples_);
    }
    const Cells cells = cells_at(speed, q.omega);
    for (size_t f = 0; f < share_.size(); ++f) {
      double most = 0;
      for (size_t i = 0; i < cells.n; ++i) most = std::max(most, reach_of_[cells.at[i] * share_.size() + f]);
      if (gap > most || passes_over(work, family_.size() + f)) continue;
      if (!work.spun_known[f]) spin(cells, f, work);
      work.place.clear(), work.energy.clear(), work.share.assign(1, share_[f]);
      for (size_t k = 0; k < samples_; ++k) {
        const Spun& row = work.spun[f * samples_ + k];
        const double x = sign * row.x, y = sign * row.y;
        work.place.push_back(
            {{q.x + c * x - s * y, q.y + s * x + c * y, c * row.cos - s * row.sin, s * row.cos + c * row.sin},
             row.time,
             row.spread,
             row.gone,
             row.far});
        work.energy.push_back(row.energy);
      }
      meet(shape, work, family_.size() + f);
    }
  }
  // Entries of the tables around a speed and a rate of turning, and their weights.
  struct Cells {
    size_t n = 0, at[4];
    double weight[4];
  };
  Cells cells_at(double speed, double rate) const {
    const Node v = node(speeds_, speed), w = node(rates_, rate);
    Cells cells;
    for (size_t i = 0; i < 2; ++i)
      for (size_t j = 0; j < 2; ++j) {
        const double weight = (i ? v.part : 1 - v.part) * (j ? w.part : 1 - w.part);
        if (weight == 0) continue;
        cells.at[cells.n] = (v.low + i) * rates_.size() + w.low + j, cells.weight[cells.n++] = weight;
      }
    return cells;
  }
  // Interpolates one table.
  void spin(const Cells& cells, size_t f, Work& work) const {
    double before = 0;
    for (size_t k = 0; k < samples_; ++k) {
      double p[kPlace] = {};
      for (size_t i = 0; i < cells.n; ++i) {
        const double* row = &place_[((cells.at[i] * share_.size() + f) * samples_ + k) * kPlace];
        for (size_t n = 0; n < kPlace; ++n) p[n] += cells.weight[i] * row[n];
      }
      const double far = root_of_squares(p[0], p[1]), gone = k == 0 ? 0.0 : p[3] * (p[4] - before);
      work.spun[f * samples_ + k] = {p[0],
                                     p[1],
                                     std::cos(p[2]),
                                     std::sin(p[2]),
                                     p[4],
                                     root_of_squares(spread_, drift_ * far),
                                     gone,
                                     p[3] * p[3] / (unit_ * unit_),
                                     far};
      before = p[4];
    }
    work.spun_known[f] = 1;
  }
  // Bases that went astray before they came here, beside the way: who is met in the next moment that is not met yet,
  // for as long as they have been astray. Along a way this adds up to how likely they are met at all.
  void astray(const State& q, const std::vector<FloorShape>& shape, Work& work) const {
    const double speed = std::fabs(q.v), sign = q.v < 0 ? -1 : 1, whole = speed * speed / (unit_ * unit_);
    const double half = 0.5 * q.omega / speed * kNext, step = sign * kNext;
    const double c = std::cos(q.yaw), s = std::sin(q.yaw);
    for (const Stray& stray : stray_) {
      const double yaw = q.yaw + stray.turned * sign, aside = std::fabs(stray.aside);
      const Place between{{q.x - 0.5 * stray.aside * s, q.y + 0.5 * stray.aside * c, c, s}, 0, stray.spread, 0, aside};
      const Place now{
          {q.x - stray.aside * s, q.y + stray.aside * c, std::cos(yaw), std::sin(yaw)}, 0, stray.spread, 0, aside};
      const Place next{{now.at[0] + step * std::cos(yaw + half), now.at[1] + step * std::sin(yaw + half),
                        std::cos(yaw + 2 * half), std::sin(yaw + 2 * half)},
                       0,
                       stray.spread,
                       kNext,
                       aside + kNext};
      work.met.assign(work.hit.size(), 0.0);
      bool any = false;
      for (size_t j = 0; j < work.asked; ++j) {
        const size_t k = work.whom[j].shape;
        const double then = apart(shape[k], next), before = std::isinf(then) ? then : distance(shape[k], now);
        const double more = touch(then, shape[k], next) - touch(before, shape[k], now);
        if (more <= kHardly) continue;
        double& met = work.met[size_t(shape[k].entity)];
        const double along = normal_share((before - then) / kNext, shape[k], next);
        met = std::max(met, more * std::min(1.0, along * whole)), any = true;
      }
      if (!any) continue;
      double stopped = 0;
      for (const Place& place : {between, now}) stopped = std::max(stopped, stopped_at(place, shape, work));
      for (size_t e = 0; e < work.hit.size(); ++e)
        work.hit[e] = std::min(1.0, work.hit[e] + stray.lasts * speed / kNext * (1 - stopped) * work.met[e]);
    }
  }
  struct Node {
    size_t low;
    double part;
  };
  static Node node(const std::vector<double>& grid, double value) {
    const size_t last = grid.size() - 1;
    const size_t above = size_t(std::upper_bound(grid.begin(), grid.end(), value) - grid.begin());
    const size_t low = std::min(above > 0 ? above - 1 : 0, last - 1);
    return {low, std::clamp((value - grid[low]) / (grid[low + 1] - grid[low]), 0.0, 1.0)};
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
    reach_of_.assign(place_.size() / (kPlace * samples_), 0.0);
    for (size_t k = 0; k < place_.size(); k += kPlace) {
      double& reach = reach_of_[k / (kPlace * samples_)];
      reach = std::max(reach, root_of_squares(place_[k], place_[k + 1]));
      farthest_ = std::max(farthest_, root_of_squares(place_[k], place_[k + 1]));
      lasts_ = std::max(lasts_, place_[k + 4]);
    }
  }

  static constexpr size_t kStop = 6, kPlace = 5, kStrayed = 4;
  static constexpr int kSamples = 64;       // places along the way at which is seen what it meets, at most
  static constexpr int kLooks = 16;         // times at which is seen whether somebody may be near
  static constexpr double kSpacing = 0.1;   // between them [m]
  static constexpr double kNext = 0.05;     // how far the next moment of a base is that is astray [m]
  static constexpr double kStill = 1e-6;    // speed below which a base stands [m/s]
  static constexpr double kFarOff = 6;      // spreads beyond which nothing is touched
  static constexpr double kHardly = 1e-9;   // probability of a touch that is none
  static constexpr double kBlocked = 1e-6;  // probability below which nothing has stopped a base before
  static constexpr double kSlowest = 0.1;   // share of the speed below which time is not stretched further

  Footprint2d footprint_;
  std::vector<Stop> stop_;
  std::vector<Family> family_;
  std::vector<std::vector<size_t>> own_, any_;  // stops of each: its own, and those of both kinds of wheels
  std::vector<double> share_, speeds_, rates_, place_;
  std::vector<double> reach_of_;  // by entry and table: how far off its places are at most
  std::vector<Stray> stray_;
  size_t samples_ = 0;
  double unit_ = 1, spread_ = 1, drift_ = 0, turn_ = 0, farthest_ = 0, lasts_ = 0;
  double aside_ = 0;  // how far beside their way bases are that are astray, blur and all
};

}  // namespace gp

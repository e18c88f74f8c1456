// A base that fails while it drives: it goes on along its arc, and meets what is there. The equations are those of
// costs/models/coast/coast.py.
#pragma once
#include <algorithm>
#include <cmath>

#include "impact/impact.hpp"

namespace gp {

struct CoastArrays {
  Reals disc;       // centre in the frame of the base (2), radius
  Integers entity;  // of each shape; -1 for obstacles
  Reals shape;      // centre (2), direction (2), half sizes (2), rounding
  int n_entity;
  Reals stops;      // probability, deceleration, drag, delay, whether the wheels are let go
  Reals constants;  // speed that severities are for, position spread, drift, angle by rate squared once let go
};

class CoastModel {
 public:
  // What is written to for each state.
  struct Work {
    explicit Work(const CoastModel& of)
        : near(of.shape_.size()),
          hit(of.n_entity_),
          most(of.n_entity_),
          free(of.stop_.size()),
          braked(of.stop_.size()) {}
    std::vector<char> near;
    Point hit, most, free, braked;
  };

  CoastModel(const Core& core, const CoastArrays& of) : core_(core), n_entity_(size_t(of.n_entity)) {
    require(core.tables().n_joint >= 3, "joints of a base");
    require(of.n_entity >= 0 && of.n_entity <= kMaxEntities, "number of entities");
    require_numbers(of.disc, "discs of a base", kMaxExtent);
    require_numbers(of.shape, 7 * of.entity.size(), "shapes around a base", 2 * kMaxExtent);
    require_numbers(of.stops, "ways to come to rest"), require_numbers(of.constants, 4, "constants of a base");
    require(of.disc.size() > 0 && of.disc.size() % 3 == 0, "discs of a base");
    require(of.stops.size() > 0 && of.stops.size() % 5 == 0, "ways to come to rest");
    for (size_t k = 0; k < of.disc.size(); k += 3) {
      const double* d = of.disc.data() + k;
      require(d[2] > 0, "radius of a disc");
      disc_.push_back({d[0], d[1], d[2]});
      reach_ = std::max(reach_, std::hypot(d[0], d[1]) + d[2]);
    }
    for (size_t k = 0; k < of.entity.size(); ++k) {
      const double* s = of.shape.data() + 7 * k;
      const int entity = of.entity.data()[k];
      require(entity >= -1 && entity < of.n_entity, "entity of a shape");
      shape_.push_back({entity, s[0], s[1], s[2], s[3], s[4], s[5], s[6]});
    }
    for (size_t k = 0; k < of.stops.size(); k += 5) {
      const double* s = of.stops.data() + k;
      require(s[0] >= 0 && s[1] > 0 && s[2] >= 0 && s[3] >= 0, "way to come to rest");
      stop_.push_back({s[0], s[1], s[2], s[3], s[4] != 0});
    }
    unit_ = of.constants.data()[0], spread_ = of.constants.data()[1], drift_ = of.constants.data()[2];
    turn_ = of.constants.data()[3];
    require(unit_ > 0 && spread_ > 0 && drift_ >= 0 && turn_ >= 0, "constants of a base");
  }

  const Core& core() const { return core_; }
  size_t n_entity() const { return n_entity_; }

  // P by entity.
  auto probability(Reals q, Reals qd) const {
    double* out;
    auto array = make<double>({core_.rows(q), n_entity_}, out);
    const States states = core_.states(q, qd);
    nb::gil_scoped_release release;
    const size_t nq = size_t(core_.tables().n_joint);
    Work work(*this);
    for (size_t i = 0; i < states.n; ++i) {
      hits(states.q + i * nq, states.qd + i * nq, nullptr, work);
      out = std::copy(work.hit.begin(), work.hit.end(), out);
    }
    return array;
  }

  // P by entity of one state, in work.hit; with severities, of those that have one. False if it is zero for all.
  bool hits(const double* q, const double* qd, const double* severity, Work& work) const {
    std::fill(work.hit.begin(), work.hit.end(), 0.0);
    const double c = std::cos(q[2]), s = std::sin(q[2]), v = qd[0] * c + qd[1] * s, speed = std::fabs(v);
    if (speed <= kStill) return false;
    double far = 0;
    for (size_t i = 0; i < stop_.size(); ++i) {
      const Stop& stop = stop_[i];
      work.free[i] = speed * stop.delay;
      work.braked[i] = stop.k > 0 ? speed / stop.k - stop.a / (stop.k * stop.k) * std::log1p(stop.k * speed / stop.a)
                                  : speed * speed / (2 * stop.a);
      far = std::max(far, work.free[i] + work.braked[i]);
    }
    const double most = far + reach_ + kFarOff * std::hypot(spread_, drift_ * far);
    bool any = false;
    for (size_t k = 0; k < shape_.size(); ++k) {
      const bool counts = shape_[k].entity < 0 || !severity || severity[shape_[k].entity] > 0;
      work.near[k] = counts && distance(shape_[k], q[0], q[1]) < most;
      any |= work.near[k] && shape_[k].entity >= 0;
    }
    if (!any) return false;
    const double sign = v < 0 ? -1 : 1, bend = qd[2] / v * sign;
    // Those that turn on for ever, then those that straighten; one alone where nothing turns.
    const double straightens = turn_ * qd[2] * qd[2];
    const bool alike = std::fabs(bend) * far <= straightens;
    for (int released = 0; released < (alike ? 1 : 2); ++released) {
      const Way way{sign, bend, released ? straightens : std::numeric_limits<double>::infinity(), speed, far};
      follow(q, way, alike ? -1 : released, work);
    }
    return true;
  }

 private:
  // Where a failing base goes: its gear, curvature, the angle by which it turns at most; its speed, and how far.
  struct Way {
    double sign, bend, most, speed, far;
  };
  // Follow it and raise work.hit; only stops that are released or not, all if `which` is negative.
  void follow(const double* q, const Way& way, int which, Work& work) const {
    const double worth = way.speed * way.speed / (unit_ * unit_);
    const double arc = way.bend != 0 ? way.most / std::fabs(way.bend) : std::numeric_limits<double>::infinity();
    double stopped = 0;
    for (int k = 0; k < kSamples && kSpacing * (k - 1) < way.far; ++k) {
      const double done = std::min(way.far, kSpacing * k), curved = std::min(done, arc), straight = done - curved;
      const double turned = way.bend * curved, half = 0.5 * turned;
      const double chord = way.sign * curved * (std::fabs(half) > 1e-9 ? std::sin(half) / half : 1.0);
      const double ch = std::cos(q[2] + turned), sh = std::sin(q[2] + turned);
      const double x = q[0] + chord * std::cos(q[2] + half) + way.sign * straight * ch,
                   y = q[1] + chord * std::sin(q[2] + half) + way.sign * straight * sh;
      const double spread = std::hypot(spread_, drift_ * done);
      // What is touched at a place may have been met anywhere since the place before.
      const double met = k == 0 ? done : 0.5 * (done + kSpacing * (k - 1));
      double energy = 0;
      for (size_t i = 0; i < stop_.size(); ++i) {
        if (which >= 0 && int(stop_[i].released) != which) continue;
        const double left = 1 - (met - work.free[i]) / std::max(work.braked[i], 1e-12);
        energy += stop_[i].p * std::min(1.0, std::clamp(left, 0.0, 1.0) * worth);
      }
      if (energy <= 0) break;
      const auto touch = [&](const Shape& shape) {
        if (distance(shape, x, y) > reach_ + kFarOff * spread) return 0.0;
        double d = std::numeric_limits<double>::infinity();
        for (const Disc& disc : disc_)
          d = std::min(d, distance(shape, x + ch * disc.x - sh * disc.y, y + sh * disc.x + ch * disc.y) - disc.r);
        return 0.5 * std::erfc(d / spread * 0.7071067811865476);
      };
      for (size_t j = 0; j < shape_.size(); ++j)
        if (work.near[j] && shape_[j].entity < 0) stopped = std::max(stopped, touch(shape_[j]));
      for (size_t j = 0; j < shape_.size(); ++j) {
        if (!work.near[j] || shape_[j].entity < 0) continue;
        double& most = work.most[size_t(shape_[j].entity)];
        most = std::max(most, energy * (1 - stopped) * touch(shape_[j]));
      }
    }
    for (size_t e = 0; e < n_entity_; ++e) work.hit[e] += work.most[e], work.most[e] = 0;
  }

  static constexpr int kSamples = 64;      // places along the way at which is seen what it meets, at most
  static constexpr double kSpacing = 0.1;  // between them [m]
  static constexpr double kStill = 1e-6;   // speed below which a base stands [m/s]
  static constexpr double kFarOff = 6;     // spreads beyond which nothing is touched
  struct Disc {
    double x, y, r;
  };
  struct Shape {
    int entity;
    double x, y, ux, uy, a, b, round;
  };
  struct Stop {
    double p, a, k, delay;
    bool released;
  };

  // Of a point to a rounded rectangle; inside minus the way to its nearest side.
  static double distance(const Shape& s, double x, double y) {
    const double dx = x - s.x, dy = y - s.y;
    const double ex = std::fabs(s.ux * dx + s.uy * dy) - s.a, ey = std::fabs(-s.uy * dx + s.ux * dy) - s.b;
    const double ox = std::max(ex, 0.0), oy = std::max(ey, 0.0);
    return std::sqrt(ox * ox + oy * oy) + std::min(std::max(ex, ey), 0.0) - s.round;
  }

  const Core& core_;
  const size_t n_entity_;
  std::vector<Disc> disc_;
  std::vector<Shape> shape_;
  std::vector<Stop> stop_;
  double reach_ = 0, unit_ = 1, spread_ = 1, drift_ = 0, turn_ = 0;
};

// The coast model with severities; along edges at their mean pace.
class CoastImpact final : public Impact {
 public:
  CoastImpact(const CoastModel& model, Reals severity, Reals speed, double slow, double fast)
      : Impact(model.core(), severity), model_(model), speed_(point(speed)), pace_{slow, fast} {
    require(severity_.size() == model.n_entity(), "severity of each entity");
    require_positive(speed, size_t(core_.tables().n_joint), "speed of each joint");
    require(slow >= 0 && fast >= slow && fast < 1e9, "pace");
  }
  void states(const double*, size_t n, double* impact) const override { std::fill_n(impact, n, 0.0); }  // at rest
  void moving_states(const States& states, double* impact) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    CoastModel::Work work(model_);
    for (size_t i = 0; i < states.n; ++i) {
      impact[i] = 0;
      if (!model_.hits(states.q + i * nq, states.qd + i * nq, severity_.data(), work)) continue;
      for (size_t e = 0; e < severity_.size(); ++e) impact[i] += severity_[e] * work.hit[e];
    }
  }
  bool asks_for_velocity() const override { return true; }
  void edges(const Edges& edges, double* cost) const override {
    EdgeStates sampled(core_, speed_.data(), pace_, {edges.q0, edges.q1, edges.n, std::max(edges.step, kStep)},
                       Sampling::kMean);
    moving_states(sampled.states(), sampled.impact.data());
    Point slopes(2 * edges.n * size_t(core_.tables().n_joint));
    sampled.integrate({cost, slopes.data(), slopes.data() + slopes.size() / 2});
  }

 private:
  static constexpr double kStep = 0.1;  // between samples of an edge, which blur as far [m or rad]

  const CoastModel& model_;
  const Point speed_;
  const double pace_[2];
};

}  // namespace gp

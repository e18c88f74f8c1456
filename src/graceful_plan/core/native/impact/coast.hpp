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
  Reals stops;      // probability, deceleration, drag, delay
  Reals constants;  // speed that severities are for, position spread, drift
  Reals speed;      // of each joint
};

class CoastImpact final : public Impact {
 public:
  CoastImpact(const Core& core, const CoastArrays& of, Reals severity, double slow, double fast)
      : Impact(core, severity), speed_(point(of.speed)), pace_{slow, fast} {
    require(core.tables().n_joint >= 3 && speed_.size() == size_t(core.tables().n_joint), "joints of a base");
    require(of.disc.size() > 0 && of.disc.size() % 3 == 0, "discs of a base");
    require(of.shape.size() == 7 * of.entity.size(), "shapes around a base");
    require(of.stops.size() > 0 && of.stops.size() % 4 == 0 && of.constants.size() == 3, "constants of a base");
    require(slow >= 0 && fast >= slow && fast < 1e9, "pace");
    for (double v : speed_) require(v > 0, "speed");
    for (size_t k = 0; k < of.disc.size(); k += 3)
      disc_.push_back({of.disc.data()[k], of.disc.data()[k + 1], of.disc.data()[k + 2]});
    for (const Disc& d : disc_) reach_ = std::max(reach_, std::hypot(d.x, d.y) + d.r);
    for (size_t k = 0; k < of.entity.size(); ++k) {
      const double* s = of.shape.data() + 7 * k;
      const int entity = of.entity.data()[k];
      require(entity >= -1 && entity < int(severity_.size()), "entity of a shape");
      if (entity >= 0 && severity_[size_t(entity)] <= 0) continue;
      shape_.push_back({entity, s[0], s[1], s[2], s[3], s[4], s[5], s[6]});
    }
    for (size_t k = 0; k < of.stops.size(); k += 4) {
      const double* s = of.stops.data() + k;
      require(s[0] >= 0 && s[1] > 0 && s[2] >= 0 && s[3] >= 0, "way to come to rest");
      stop_.push_back({s[0], s[1], s[2], s[3]});
    }
    unit_ = of.constants.data()[0], spread_ = of.constants.data()[1], drift_ = of.constants.data()[2];
    require(unit_ > 0 && spread_ > 0 && drift_ >= 0, "constants of a base");
  }
  void states(const double*, size_t n, double* impact) const override { std::fill_n(impact, n, 0.0); }  // at rest
  void moving_states(const States& states, double* impact) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    Work work(shape_.size(), severity_.size(), stop_.size());
    for (size_t i = 0; i < states.n; ++i) impact[i] = state(states.q + i * nq, states.qd + i * nq, work);
  }
  bool asks_for_velocity() const override { return true; }
  void edges(const Edges& edges, double* cost) const override {
    EdgeStates sampled(core_, speed_.data(), pace_, edges, Sampling::kExact);
    moving_states(sampled.states(), sampled.impact.data());
    Point slopes(2 * edges.n * size_t(core_.tables().n_joint));
    sampled.integrate({cost, slopes.data(), slopes.data() + slopes.size() / 2});
  }

 private:
  static constexpr int kSamples = 64;                  // as in coast.py
  static constexpr double kSpacing = 0.1;              // [m]
  static constexpr double kStill = 1e-6, kFarOff = 6;  // [m/s]; spreads
  struct Disc {
    double x, y, r;
  };
  struct Shape {
    int entity;
    double x, y, ux, uy, a, b, round;
  };
  struct Stop {
    double p, a, k, delay;
  };
  struct Work {
    Work(size_t shapes, size_t entities, size_t stops) : near(shapes), hit(entities), free(stops), braked(stops) {}
    std::vector<char> near;
    Point hit, free, braked;
  };

  double state(const double* q, const double* qd, Work& work) const {
    const double c = std::cos(q[2]), s = std::sin(q[2]), v = qd[0] * c + qd[1] * s, speed = std::fabs(v);
    if (speed <= kStill || shape_.empty()) return 0;
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
      work.near[k] = distance(shape_[k], q[0], q[1]) < most;
      any |= work.near[k] && shape_[k].entity >= 0;
    }
    if (!any) return 0;
    std::fill(work.hit.begin(), work.hit.end(), 0.0);
    const double sign = v < 0 ? -1 : 1, bend = qd[2] / v * sign, worth = speed * speed / (unit_ * unit_);
    double stopped = 0;
    for (int k = 0; k < kSamples && kSpacing * (k - 1) < far; ++k) {
      const double way = std::min(far, kSpacing * k), turned = bend * way, half = 0.5 * turned;
      const double chord = sign * way * (std::fabs(half) > 1e-9 ? std::sin(half) / half : 1.0);
      const double x = q[0] + chord * std::cos(q[2] + half), y = q[1] + chord * std::sin(q[2] + half);
      const double ch = std::cos(q[2] + turned), sh = std::sin(q[2] + turned),
                   spread = std::hypot(spread_, drift_ * way);
      // What is touched at a place may have been met anywhere since the place before.
      const double met = k == 0 ? way : 0.5 * (way + kSpacing * (k - 1));
      double energy = 0;
      for (size_t i = 0; i < stop_.size(); ++i) {
        const double left = 1 - (met - work.free[i]) / std::max(work.braked[i], 1e-12);
        energy += stop_[i].p * std::min(1.0, std::clamp(left, 0.0, 1.0) * worth);
      }
      if (energy <= 0) break;
      const auto touch = [&](const Shape& shape) {
        double d = 1e30;
        for (const Disc& disc : disc_)
          d = std::min(d, distance(shape, x + ch * disc.x - sh * disc.y, y + sh * disc.x + ch * disc.y) - disc.r);
        return 0.5 * std::erfc(d / spread * 0.7071067811865476);
      };
      for (size_t j = 0; j < shape_.size(); ++j)
        if (work.near[j] && shape_[j].entity < 0) stopped = std::max(stopped, touch(shape_[j]));
      for (size_t j = 0; j < shape_.size(); ++j) {
        if (!work.near[j] || shape_[j].entity < 0) continue;
        double& hit = work.hit[size_t(shape_[j].entity)];
        hit = std::max(hit, energy * (1 - stopped) * touch(shape_[j]));
      }
    }
    double impact = 0;
    for (size_t e = 0; e < severity_.size(); ++e) impact += severity_[e] * work.hit[e];
    return impact;
  }
  // Of a point to a rounded rectangle; inside minus the way to its nearest side.
  static double distance(const Shape& s, double x, double y) {
    const double dx = x - s.x, dy = y - s.y;
    const double ex = std::fabs(s.ux * dx + s.uy * dy) - s.a, ey = std::fabs(-s.uy * dx + s.ux * dy) - s.b;
    return std::hypot(std::max(ex, 0.0), std::max(ey, 0.0)) + std::min(std::max(ex, ey), 0.0) - s.round;
  }

  const Point speed_;
  const double pace_[2];
  std::vector<Disc> disc_;
  std::vector<Shape> shape_;
  std::vector<Stop> stop_;
  double reach_ = 0, unit_ = 1, spread_ = 1, drift_ = 0;
};

}  // namespace gp

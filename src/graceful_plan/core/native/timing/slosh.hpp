// Sloshing of a liquid along a curve: a pendulum driven by the felt acceleration, a penalty where the surface rises
// above the rim, and derivatives of the penalty.
//
// The pendulum is that of pendulum.hpp; its steps are fractions of the curve's intervals. Derivatives are computed in
// reverse mode.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "timing/pendulum.hpp"

namespace gp {

struct SloshLimit {
  Vector3 axis;       // of the vessel, in the link
  double angle;       // largest angle between the axis and the surface's normal
  Pendulum pendulum;  // length 0 if the surface stays perpendicular to the felt acceleration, as of dry contents
};

class Swing {
 public:
  // Inputs of the pendulum: axis of the vessel, felt acceleration at both ends of each interval, durations.
  struct Drive {
    std::vector<Vector3> axis;          // [n + 1], in W
    std::vector<Vector3> begun, ended;  // [n]
    std::vector<double> pause;          // [n]
    void resize(size_t n) { axis.resize(n + 1), begun.resize(n), ended.resize(n), pause.resize(n); }
    void clear(size_t n) { axis.assign(n + 1, {}), begun.assign(n, {}), ended.assign(n, {}), pause.assign(n, 0.0); }
  };

  explicit Swing(const SloshLimit& limit) : limit_(limit), least_(std::cos(limit.angle)) {}

  // The penalty: the excess of angles over the limit, in units of kUnit times the limit, quadratic up to one unit, then
  // linear, and summed. Halving an angle by slowing down takes sqrt(2) times as long, so the penalty is of that order;
  // with a penalty ten times as steep, descents did not move.
  double charge(const Drive& drive, double gravity) {
    const size_t n = drive.pause.size();
    steps_ = int((kSteps + n - 1) / n), step_share_ = 1.0 / steps_, per_ = -1 / limit_.pendulum.length;
    frequency_ = std::sqrt(gravity / limit_.pendulum.length);
    state_.clear();
    excess_.clear();
    Bob bob;
    double sum = 0;
    for (size_t k = 0; k < n; ++k) {
      sum += exceed(drive.axis[k], bob.d);
      const double h = step_of(drive.pause[k]);
      for (int s = 0; s < steps_; ++s) advance(pull(drive, k, s), h, bob);
    }
    // Then the robot rests.
    const Vector3 rest{0, 0, -gravity / limit_.pendulum.length};
    sum += exceed(drive.axis[n], bob.d);
    for (int s = 0; s < kAfter; ++s) {
      advance(rest, kRest / frequency_, bob);
      if (s % steps_ == 0) sum += exceed(drive.axis[n], bob.d);
    }
    return sum;
  }
  // Whether the last penalty was above zero.
  bool exceeds() const {
    return std::any_of(excess_.begin(), excess_.end(), [](const Excess& excess) { return excess.slope != 0; });
  }

  // Adds derivatives of a weight times the last penalty.
  void back(const Drive& drive, double weight, Drive& out) const {
    const size_t n = drive.pause.size();
    Vector3 by_d{}, by_rate{};
    size_t looked = excess_.size(), at = state_.size();
    const auto look = [&](size_t k) {
      const Excess& excess = excess_[--looked];
      if (excess.slope == 0) return;
      for (size_t i = 0; i < 3; ++i) {  // the cosine is -axis . d
        by_d[i] -= weight * excess.slope * drive.axis[k][i];
        out.axis[k][i] -= weight * excess.slope * excess.d[i];
      }
    };
    double unused = 0;
    Vector3 none{};
    for (int s = kAfter; s-- > 0;) {
      if (s % steps_ == 0) look(n);
      retreat(state_[--at], by_d, by_rate, none, unused);
    }
    look(n);
    for (size_t k = n; k-- > 0;) {
      double by_step = 0;
      for (int s = steps_; s-- > 0;) {
        Vector3 by_pull{};
        retreat(state_[--at], by_d, by_rate, by_pull, by_step);
        const double share = (s + 0.5) * step_share_;
        add3(out.begun[k], (1 - share) * per_, by_pull), add3(out.ended[k], share * per_, by_pull);
      }
      if (step_of(drive.pause[k]) < kLongest / frequency_) out.pause[k] += by_step / steps_;
      look(k);
    }
  }

 private:
  static constexpr size_t kSteps = 120;    // least number of steps along the curve
  static constexpr int kAfter = 24;        // number of steps after its end: about two thirds of a period
  static constexpr double kRest = 0.18;    // step length after the end [1/frequency]
  static constexpr double kLongest = 0.8;  // longest step [1/frequency]; with longer ones the pendulum would gain
                                           // energy
  static constexpr double kUnit = 0.3;     // relative to the limit
  static constexpr double kKnee = 1.0;     // units beyond which the penalty is linear

  struct State {  // before a step
    Vector3 d, rate, pull;
    double h, shrunk;
  };
  struct Excess {
    Vector3 d;
    double slope;  // of the penalty with respect to the cosine
  };

  double step_of(double pause) const { return std::min(pause / steps_, kLongest / frequency_); }
  Vector3 pull(const Drive& drive, size_t k, int s) const {
    const double share = (s + 0.5) * step_share_;
    Vector3 pull = scaled3(drive.begun[k], (1 - share) * per_);
    add3(pull, share * per_, drive.ended[k]);
    return pull;
  }

  double exceed(const Vector3& axis, const Vector3& d) {
    const double cosine = std::clamp(-dot3(axis, d), -1.0, 1.0);
    if (cosine >= least_) {
      excess_.push_back({d, 0});
      return 0;
    }
    const double unit = kUnit * limit_.angle, lack = (std::acos(cosine) - limit_.angle) / unit;
    const double sine = std::max(std::sqrt(1 - cosine * cosine), 1e-6);
    const double depth = std::min(lack, kKnee);
    excess_.push_back({d, -2 * depth / unit / sine});
    return depth * depth + 2 * kKnee * (lack - depth);
  }

  void advance(const Vector3& pull, double h, Bob& bob) {
    state_.push_back({bob.d, bob.rate, pull, h, 0});
    state_.back().shrunk = bob.advance(pull, h, limit_.pendulum.drag);
  }

  // Maps derivatives with respect to the state after a step to those with respect to the state before it.
  void retreat(const State& from, Vector3& by_d, Vector3& by_rate, Vector3& by_pull, double& by_h) const {
    const auto& [d, rate, pull, h, shrunk] = from;
    const double along = dot3(pull, d), drag = limit_.pendulum.drag;
    Vector3 force, faster, moved;
    for (size_t i = 0; i < 3; ++i) {
      force[i] = pull[i] - along * d[i] - drag * rate[i];
      faster[i] = rate[i] + h * force[i];
      moved[i] = d[i] + h * faster[i];
    }
    const Vector3 next = scaled3(moved, shrunk);
    const double radial = dot3(faster, next), by_radial = dot3(by_rate, next);
    Vector3 by_faster, by_moved;
    for (size_t i = 0; i < 3; ++i) {
      by_faster[i] = by_rate[i] - by_radial * next[i];
      by_d[i] -= radial * by_rate[i] + by_radial * faster[i];
    }
    const double outward = dot3(by_d, next);
    for (size_t i = 0; i < 3; ++i) by_moved[i] = (by_d[i] - outward * next[i]) * shrunk;
    by_h += dot3(by_moved, faster);
    for (size_t i = 0; i < 3; ++i) by_faster[i] += h * by_moved[i];
    by_h += dot3(by_faster, force);
    const double across = dot3(by_faster, d);
    for (size_t i = 0; i < 3; ++i) {
      by_pull[i] += h * (by_faster[i] - across * d[i]);
      by_d[i] = by_moved[i] - h * (along * by_faster[i] + across * pull[i]);
      by_rate[i] = (1 - h * drag) * by_faster[i];
    }
  }

  SloshLimit limit_;
  double least_;  // cosine of the largest angle
  int steps_ = 1;
  double step_share_ = 1, per_ = -1;  // step as a share of its interval; pull per felt acceleration [1/m]
  double frequency_ = 1;
  std::vector<State> state_;
  std::vector<Excess> excess_;
};

}  // namespace gp

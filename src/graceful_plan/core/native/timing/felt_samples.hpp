// Felt acceleration at even samples of a curve, and derivatives of its limits on the motion, for descents.
//
// The derivatives p' and p'' are differences between samples, so derivatives of the limits need only Jacobians.
#pragma once
#include <algorithm>
#include <vector>

#include "search/planning.hpp"
#include "timing/felt.hpp"

namespace gp {

class FeltSamples {
 public:
  // Without `slosh`, sloshing is not penalised.
  FeltSamples(const Space& space, std::vector<SpecificForceLimit> limits, bool slosh) : limits_(std::move(limits)) {
    for (const SpecificForceLimit& limit : limits_) {
      rider_.push_back(space.rider(limit.link, limit.point));
      first_facet_.push_back(facets_), facets_ += limit.facets.size();
      limit_of_.resize(facets_, first_facet_.size() - 1);
      swing_.push_back(limit.slosh && slosh ? std::optional<Swing>(*limit.slosh) : std::nullopt);
    }
    drive_.resize(limits_.size()), by_drive_.resize(limits_.size());
  }
  bool empty() const { return limits_.empty(); }

  // Adds the limits at both ends of every interval; samples are `step` apart.
  const CurveLimits& enter(Space& space, const std::vector<double>& q, double step, const std::vector<Box>& box) {
    samples_ = box.size() + 1, dim_ = q.size() / samples_, h_ = step;
    rows_.clear();
    if (empty()) {
      for (size_t k = 0; k + 1 < samples_; ++k) rows_.begin_interval(box[k]), rows_.end_interval();
      return rows_;
    }
    space.poses({q.data(), int(samples_ - 1)}, poses_);
    stride_ = poses_.size() / samples_;
    rests_.resize(facets_ * samples_);
    p_.resize(limits_.size() * samples_), motion_.resize(p_.size());
    velocity_.resize(p_.size()), bend_.resize(p_.size());
    d_p_.assign(p_.size(), {}), d_turn_.assign(p_.size(), {});
    for (size_t l = 0; l < limits_.size(); ++l) {
      const Rider& rider = rider_[l];
      Vector3* p = &p_[l * samples_];
      for (size_t k = 0; k < samples_; ++k) p[k] = rider.at(poses(k));
      for (size_t k = 0; k < samples_; ++k) {
        Vector3 &velocity = velocity_[l * samples_ + k], &bend = bend_[l * samples_ + k];
        differences(l, k, velocity, bend);
        const LinkPoses at = poses(k);
        motion_[l * samples_ + k] = {at.within(rider.link, velocity), at.within(rider.link, bend),
                                     at.within(rider.link, {0, 0, 1})};
        rests(limits_[l], motion_[l * samples_ + k].up, &rests_[facets_ * k + first_facet_[l]]);
      }
    }
    for (size_t k = 0; k < samples_; ++k)
      for (size_t l = 0; l < limits_.size(); ++l)
        for (size_t f = first_facet_[l]; f < first_facet_[l] + limits_[l].facets.size(); ++f)
          rests_[facets_ * k + f] = std::max(rests_[facets_ * k + f], kLeastRoom * limits_[l].gravity);
    for (size_t k = 0; k + 1 < samples_; ++k) {
      rows_.begin_interval(box[k]);
      for (size_t l = 0; l < limits_.size(); ++l)
        for (size_t end = 0; end < 2; ++end)
          add_facets(limits_[l], motion_[l * samples_ + k + end], &rests_[facets_ * (k + end) + first_facet_[l]],
                     end ? 2 * h_ : 0.0, 1.0, 2 * first_facet_[l] + end, rows_);
      rows_.end_interval();
    }
    slope_.resize(rows_.rows().size());
    return rows_;
  }

  // Penalty for sloshing along the curve of the last enter(), travelled at squared speeds `x`, with duration `pause` of
  // each interval.
  double slosh(const std::vector<double>& x, const std::vector<double>& pause) {
    double sum = 0;
    for (size_t l = 0; l < limits_.size(); ++l) {
      if (!swing_[l]) continue;
      const size_t n = pause.size();
      Swing::Drive& drive = drive_[l];
      drive.resize(n);
      drive.pause = pause;
      for (size_t k = 0; k <= n; ++k) {
        const Vector3 &velocity = velocity_[l * samples_ + k], &bend = bend_[l * samples_ + k];
        drive.axis[k] = poses(k).turned(rider_[l].link, limits_[l].slosh->axis);
        for (size_t i = 0; i < 3; ++i) {
          const double gravity = i == 2 ? limits_[l].gravity : 0;
          if (k < n) drive.begun[k][i] = velocity[i] * push(x, k) + bend[i] * x[k] + gravity;
          if (k > 0) drive.ended[k - 1][i] = velocity[i] * push(x, k - 1) + bend[i] * x[k] + gravity;
        }
      }
      sum += swing_[l]->charge(drive, limits_[l].gravity);
    }
    return sum;
  }

  // Adds derivatives of a weight times the last slosh(); back() adds those with respect to q.
  void back_slosh(const std::vector<double>& x, double weight, std::vector<double>& d_x, std::vector<double>& d_pause) {
    for (size_t l = 0; l < limits_.size(); ++l) {
      if (!swing_[l] || !swing_[l]->exceeds()) continue;
      const size_t n = d_pause.size();
      Swing::Drive& by = by_drive_[l];
      by.clear(n);
      swing_[l]->back(drive_[l], weight, by);
      for (size_t k = 0; k < n; ++k) d_pause[k] += by.pause[k];
      for (size_t k = 0; k <= n; ++k) {
        const Vector3 &velocity = velocity_[l * samples_ + k], &bend = bend_[l * samples_ + k];
        Vector3 d_velocity{}, d_bend{};
        for (size_t i = 0; i < 3; ++i) {
          if (k < n) {
            const double d = by.begun[k][i], d_push = d * velocity[i] / (2 * h_);
            d_velocity[i] += d * push(x, k), d_bend[i] += d * x[k], d_x[k] += d * bend[i];
            d_x[k + 1] += d_push, d_x[k] -= d_push;
          }
          if (k > 0) {
            const double d = by.ended[k - 1][i], d_push = d * velocity[i] / (2 * h_);
            d_velocity[i] += d * push(x, k - 1), d_bend[i] += d * x[k], d_x[k] += d * bend[i];
            d_x[k] += d_push, d_x[k - 1] -= d_push;
          }
        }
        add3(d_turn_[l * samples_ + k], 1, cross3(drive_[l].axis[k], by.axis[k]));
        back_differences(l, k, d_velocity, d_bend);
      }
    }
  }

  CurveLimits::Slope* slopes() {
    std::fill(slope_.begin(), slope_.end(), CurveLimits::Slope{});
    return slope_.data();
  }

  // Maps derivatives with respect to the limits of the last enter(), and those of back_slosh(), to derivatives with
  // respect to q, which it adds.
  void back(std::vector<double>& d_q) {
    by_motion_.assign(motion_.size(), {});
    for (size_t k = 0; k + 1 < samples_; ++k)
      for (size_t r = rows_.first(k); r < rows_.first(k + 1); ++r) {
        const CurveLimits::Slope& d = slope_[r];
        if (d.a == 0 && d.b == 0 && d.c == 0) continue;
        const size_t tag = rows_.rows()[r].tag, end = tag % 2, l = limit_of_[tag / 2];
        const SpecificForceLimit& limit = limits_[l];
        FeltMotion& by = by_motion_[l * samples_ + k + end];
        const Vector3& v = limit.facets[tag / 2 - first_facet_[l]];
        add3(by.velocity, d.a, v), add3(by.bend, d.b + (end ? 2 * h_ * d.a : 0.0), v);
        if (rests_[facets_ * (k + end) + tag / 2] > kLeastRoom * limit.gravity) add3(by.up, -limit.gravity * d.c, v);
      }
    for (size_t l = 0; l < limits_.size(); ++l) {
      for (size_t k = 0; k < samples_; ++k) back_motion(l, k);
      for (size_t k = 0; k < samples_; ++k) {
        const Vector3 &d_p = d_p_[l * samples_ + k], &d_turn = d_turn_[l * samples_ + k];
        if (!is_zero(d_p) || !is_zero(d_turn))
          rider_[l].pull_back(poses(k), p_[l * samples_ + k], d_p, d_turn, &d_q[k * dim_]);
      }
    }
  }

 private:
  static constexpr double kLeastRoom = 0.02;  // of gravity: where a limit does not hold at rest, the robot crawls

  LinkPoses poses(size_t k) const { return {&poses_[k * stride_]}; }
  // Acceleration of the parameter on an interval.
  double push(const std::vector<double>& x, size_t k) const { return (x[k + 1] - x[k]) / (2 * h_); }

  static bool is_zero(const Vector3& a) { return a[0] == 0 && a[1] == 0 && a[2] == 0; }

  void back_motion(size_t l, size_t k) {
    const FeltMotion &by = by_motion_[l * samples_ + k], &motion = motion_[l * samples_ + k];
    if (is_zero(by.velocity) && is_zero(by.bend) && is_zero(by.up)) return;
    // m = R^T w changes by R^T (w x z) as the link rotates about z, and by . m by z . R (by x m).
    Vector3 about = cross3(by.velocity, motion.velocity);
    add3(about, 1, cross3(by.bend, motion.bend)), add3(about, 1, cross3(by.up, motion.up));
    const LinkPoses at = poses(k);
    const size_t link = rider_[l].link;
    add3(d_turn_[l * samples_ + k], 1, at.turned(link, about));
    back_differences(l, k, at.turned(link, by.velocity), at.turned(link, by.bend));
  }

  // Central first differences, at the ends those of a parabola; second differences, at the ends those of their
  // neighbours.
  struct Stencil {
    size_t at[3];
    double first[3], second[3];
  };
  Stencil stencil(size_t k) const {
    const size_t middle = std::clamp(k, size_t(1), samples_ - 2);
    Stencil s{{middle - 1, middle, middle + 1}, {-0.5, 0.0, 0.5}, {1.0, -2.0, 1.0}};
    const double off = double(k) - double(middle);
    for (int m = 0; m < 3; ++m) s.first[m] = (s.first[m] + off * s.second[m]) / h_, s.second[m] /= h_ * h_;
    return s;
  }
  void differences(size_t l, size_t k, Vector3& velocity, Vector3& bend) const {
    const Stencil s = stencil(k);
    velocity = bend = {};
    for (int m = 0; m < 3; ++m) {
      const Vector3& p = p_[l * samples_ + s.at[m]];
      add3(velocity, s.first[m], p), add3(bend, s.second[m], p);
    }
  }
  void back_differences(size_t l, size_t k, const Vector3& d_velocity, const Vector3& d_bend) {
    const Stencil s = stencil(k);
    for (int m = 0; m < 3; ++m) {
      Vector3& d_p = d_p_[l * samples_ + s.at[m]];
      add3(d_p, s.first[m], d_velocity), add3(d_p, s.second[m], d_bend);
    }
  }

  std::vector<SpecificForceLimit> limits_;
  std::vector<Rider> rider_;
  std::vector<size_t> first_facet_, limit_of_;
  size_t facets_ = 0, samples_ = 0, dim_ = 0, stride_ = 0;
  double h_ = 0;
  CurveLimits rows_;
  std::vector<CurveLimits::Slope> slope_;
  std::vector<double> poses_, rests_;
  std::vector<Vector3> p_, velocity_, bend_, d_p_, d_turn_;  // in W
  std::vector<FeltMotion> motion_, by_motion_;
  std::vector<std::optional<Swing>> swing_;
  std::vector<Swing::Drive> drive_, by_drive_;
};

}  // namespace gp

// What is felt where something is carried, as limits on how fast a curve is travelled.
//
// At a point p of the robot that moves by p' per unit of the curve's parameter, the acceleration is p' u + p'' x:
// linear in the parameter's acceleration u and squared speed x, like the joints' accelerations. What is felt there is
// that acceleration less gravity. A facet v, a vector that turns with the robot, asks that v . (p' u + p'' x + g e_z)
// <= room: facets around an axis without room hold what is felt inside a pyramid, which stands for a cone; those with
// room hold a load below what a grasp can carry.
//
// Derivatives p' and p'' are differences between even samples, so that those of the limits need no more than Jacobians.
#pragma once
#include <algorithm>
#include <array>
#include <optional>
#include <vector>

#include "search/planning.hpp"
#include "timing/slosh.hpp"
#include "timing/speed_profile.hpp"

namespace gp {

struct FeltLimit {
  int link;
  std::array<double, 3> point;                // in the link
  std::vector<std::array<double, 3>> facets;  // in the axes of the link
  std::vector<double> room;                   // of each facet [m/s^2]
  double gravity;                             // [m/s^2]
  std::optional<SloshLimit> slosh;            // of what is carried there, if it is a liquid
};

class FeltLimits {
 public:
  explicit FeltLimits(std::vector<FeltLimit> limits) : limits_(std::move(limits)) {
    for (const FeltLimit& limit : limits_) {
      facets_ += limit.facets.size();
      swing_.push_back(limit.slosh ? std::optional<Swing>(*limit.slosh) : std::nullopt);
    }
    drive_.resize(limits_.size()), by_drive_.resize(limits_.size());
  }
  bool empty() const { return facets_ == 0; }

  // Enter the limits at both ends of every interval; samples are `step` apart.
  void enter(Space& space, const std::vector<double>& q, double step, CurveSamples& curve) {
    const size_t samples = curve.n + 1, dim = curve.dim;
    h_ = step, dim_ = dim;
    row_.assign(3 * 2 * facets_ * curve.n, 0.0), slope_.resize(row_.size());
    ride_.resize(limits_.size() * samples);
    size_t first = 0;
    for (size_t l = 0; l < limits_.size(); ++l) {
      space.ride({q.data(), int(curve.n)}, limits_[l].link, limits_[l].point.data(), &ride_[l * samples]);
      const Ride* ride = &ride_[l * samples];
      for (size_t k = 0; k < samples; ++k) {
        double velocity[3], bend[3];
        differences(ride, samples, k, velocity, bend);
        for (size_t f = 0; f < limits_[l].facets.size(); ++f) enter_facet(l, first + f, k, samples, velocity, bend);
      }
      first += limits_[l].facets.size();
    }
    curve.n_limit = 2 * facets_, curve.limit = row_.data();
  }

  // What sloshing is charged along the curve of the last enter(), travelled at squared speeds `x`, so long on each
  // interval.
  double slosh(const std::vector<double>& x, const std::vector<double>& pause) {
    double sum = 0;
    for (size_t l = 0; l < limits_.size(); ++l) {
      if (!swing_[l]) continue;
      const size_t n = pause.size(), samples = n + 1;
      const Ride* ride = &ride_[l * samples];
      Swing::Drive& drive = drive_[l];
      drive.resize(n);
      drive.pause = pause;
      for (size_t k = 0; k < samples; ++k) {
        double velocity[3], bend[3];
        differences(ride, samples, k, velocity, bend);
        turn(ride[k], limits_[l].slosh->axis, drive.axis[k].data());
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

  // Derivatives of a weight times the last slosh(), added up.
  void back_slosh(const std::vector<double>& x, double weight, std::vector<double>& d_x, std::vector<double>& d_pause,
                  std::vector<double>& d_q) {
    for (size_t l = 0; l < limits_.size(); ++l) {
      if (!swing_[l]) continue;
      const size_t n = d_pause.size(), samples = n + 1;
      const Ride* ride = &ride_[l * samples];
      Swing::Drive& by = by_drive_[l];
      by = {};
      by.resize(n);
      swing_[l]->back(drive_[l], weight, by);
      for (size_t k = 0; k < n; ++k) d_pause[k] += by.pause[k];
      for (size_t k = 0; k < samples; ++k) {
        double velocity[3], bend[3], d_velocity[3] = {}, d_bend[3] = {};
        differences(ride, samples, k, velocity, bend);
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
        back_turn(ride[k], drive_[l].axis[k].data(), by.axis[k].data(), &d_q[k * dim_]);
        back_differences(ride, samples, k, d_velocity, d_bend, d_q);
      }
    }
  }

  double* slopes() {
    std::fill(slope_.begin(), slope_.end(), 0.0);
    return slope_.data();
  }

  // From derivatives with respect to the limits of the last enter() to those with respect to q, added up.
  void back(std::vector<double>& d_q) const {
    const size_t samples = d_q.size() / dim_;
    size_t first = 0;
    for (size_t l = 0; l < limits_.size(); ++l) {
      const Ride* ride = &ride_[l * samples];
      for (size_t k = 0; k < samples; ++k) {
        double velocity[3], bend[3], d_velocity[3] = {}, d_bend[3] = {};
        differences(ride, samples, k, velocity, bend);
        for (size_t f = 0; f < limits_[l].facets.size(); ++f) {
          const std::array<double, 3> by = collected(first + f, k, samples);
          if (by[0] == 0 && by[1] == 0 && by[2] == 0) continue;
          double v[3], d_v[3];
          turn(ride[k], limits_[l].facets[f], v);
          for (int i = 0; i < 3; ++i) {
            d_velocity[i] += by[0] * v[i], d_bend[i] += by[1] * v[i];
            d_v[i] = by[0] * velocity[i] + by[1] * bend[i];
          }
          if (rest(l, f, v) > kLeastRoom * limits_[l].gravity) d_v[2] -= limits_[l].gravity * by[2];
          back_turn(ride[k], v, d_v, &d_q[k * dim_]);
        }
        back_differences(ride, samples, k, d_velocity, d_bend, d_q);
      }
      first += limits_[l].facets.size();
    }
  }

 private:
  static constexpr double kLeastRoom = 0.02;  // of gravity: where the robot may not even rest, it crawls

  // What a facet, turned to W, leaves to the motion.
  double rest(size_t l, size_t f, const double v[3]) const { return limits_[l].room[f] - limits_[l].gravity * v[2]; }

  static void turn(const Ride& ride, const std::array<double, 3>& facet, double v[3]) {
    for (size_t i = 0; i < 3; ++i)
      v[i] = ride.R[3 * i] * facet[0] + ride.R[3 * i + 1] * facet[1] + ride.R[3 * i + 2] * facet[2];
  }

  // A joint about z turns v by z x v.
  void back_turn(const Ride& ride, const double v[3], const double d_v[3], double* d_q) const {
    const double about[3] = {v[1] * d_v[2] - v[2] * d_v[1], v[2] * d_v[0] - v[0] * d_v[2],
                             v[0] * d_v[1] - v[1] * d_v[0]};
    for (size_t j = 0; j < dim_; ++j)
      for (size_t i = 0; i < 3; ++i) d_q[j] += ride.turn[i * dim_ + j] * about[i];
  }
  // Acceleration of the parameter on an interval.
  double push(const std::vector<double>& x, size_t k) const { return (x[k + 1] - x[k]) / (2 * h_); }

  // First differences to both sides, at the ends those of a parabola; second ones, at the ends those next to them.
  struct Stencil {
    size_t at[3];
    double first[3], second[3];
  };
  Stencil stencil(size_t k, size_t samples) const {
    const size_t middle = std::clamp(k, size_t(1), samples - 2);
    Stencil s{{middle - 1, middle, middle + 1}, {-0.5, 0.0, 0.5}, {1.0, -2.0, 1.0}};
    const double off = double(k) - double(middle);
    for (int m = 0; m < 3; ++m) s.first[m] = (s.first[m] + off * s.second[m]) / h_, s.second[m] /= h_ * h_;
    return s;
  }
  void differences(const Ride* ride, size_t samples, size_t k, double velocity[3], double bend[3]) const {
    const Stencil s = stencil(k, samples);
    for (int i = 0; i < 3; ++i) {
      velocity[i] = bend[i] = 0;
      for (int m = 0; m < 3; ++m)
        velocity[i] += s.first[m] * ride[s.at[m]].p[i], bend[i] += s.second[m] * ride[s.at[m]].p[i];
    }
  }
  void back_differences(const Ride* ride, size_t samples, size_t k, const double d_velocity[3], const double d_bend[3],
                        std::vector<double>& d_q) const {
    const Stencil s = stencil(k, samples);
    for (int m = 0; m < 3; ++m) {
      double d_p[3];
      for (int i = 0; i < 3; ++i) d_p[i] = s.first[m] * d_velocity[i] + s.second[m] * d_bend[i];
      if (d_p[0] == 0 && d_p[1] == 0 && d_p[2] == 0) continue;
      for (size_t j = 0; j < dim_; ++j)
        for (size_t i = 0; i < 3; ++i) d_q[s.at[m] * dim_ + j] += ride[s.at[m]].J[i * dim_ + j] * d_p[i];
    }
  }

  // A limit holds at the beginning of the interval after a sample and at the end of the one before, where x + 2 step u
  // is the squared speed.
  double* begun(size_t facet, size_t k) { return &row_[3 * (2 * facets_ * k + facet)]; }
  double* ended(size_t facet, size_t k) { return &row_[3 * (2 * facets_ * (k - 1) + facets_ + facet)]; }
  void enter_facet(size_t l, size_t facet, size_t k, size_t samples, const double velocity[3], const double bend[3]) {
    double v[3];
    size_t first = 0;
    for (size_t m = 0; m < l; ++m) first += limits_[m].facets.size();
    const size_t f = facet - first;
    turn(ride_[l * samples + k], limits_[l].facets[f], v);
    const double a = v[0] * velocity[0] + v[1] * velocity[1] + v[2] * velocity[2];
    const double b = v[0] * bend[0] + v[1] * bend[1] + v[2] * bend[2];
    const double c = std::max(rest(l, f, v), kLeastRoom * limits_[l].gravity);
    if (k + 1 < samples) std::copy_n(std::array{a, b, c}.data(), 3, begun(facet, k));
    if (k > 0) std::copy_n(std::array{a + 2 * h_ * b, b, c}.data(), 3, ended(facet, k));
  }
  // Derivatives with respect to a, b and c of a facet at a sample.
  std::array<double, 3> collected(size_t facet, size_t k, size_t samples) const {
    std::array<double, 3> by{};
    if (k + 1 < samples)
      for (size_t i = 0; i < 3; ++i) by[i] += slope_[3 * (2 * facets_ * k + facet) + i];
    if (k > 0) {
      const double* d = &slope_[3 * (2 * facets_ * (k - 1) + facets_ + facet)];
      by[0] += d[0], by[1] += d[1] + 2 * h_ * d[0], by[2] += d[2];
    }
    return by;
  }

  std::vector<FeltLimit> limits_;
  size_t facets_ = 0, dim_ = 0;
  double h_ = 0;
  std::vector<double> row_, slope_;
  std::vector<Ride> ride_;
  std::vector<std::optional<Swing>> swing_;
  std::vector<Swing::Drive> drive_, by_drive_;
};

}  // namespace gp

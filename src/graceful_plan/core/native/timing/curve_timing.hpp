// The fastest motion along a curve within the limits of the joints, the limits on felt acceleration at carried objects,
// and with the surface of a liquid below its rim.
//
// A surface swings beyond the felt direction, by an amount that depends on the curve. Limits on felt acceleration
// therefore come in levels, from boldest to most careful; if the surface still swings too far at a level, the whole
// motion is slowed down. The fastest motion of all levels is the result.
//
// A motion may begin or end with a given speed. It cannot be slowed down as a whole then, so the result is that of the
// first level at which the surface stays below the rim. Where sampling lets it exceed a limit, it is timed again with
// limits that are as much tighter.
#pragma once
#include "core.hpp"
#include "timing/felt.hpp"
#include "timing/spill.hpp"
#include "timing/travel.hpp"

namespace gp {

class CurveTiming {
 public:
  using Level = std::vector<SpecificForceLimit>;

  CurveTiming(const Core* core, std::vector<Level> levels, Point velocity, Point acceleration)
      : core_(core),
        levels_(std::move(levels)),
        velocity_(velocity),
        acceleration_(acceleration),
        profile_(std::move(velocity), std::move(acceleration)) {
    if (levels_.empty()) levels_.emplace_back();  // no felt limits
    for (const SpecificForceLimit& limit : levels_.front()) rider_.push_back(core_->rider(limit.link, limit.point));
  }

  // A limit that does not hold even at rest, or the point where the motion comes to a halt.
  struct Trouble {
    int limit = -1;    // index in a level; -1 for none
    size_t point = 0;  // of the curve
    bool any = false;
  };

  // Times a curve through `q`, with further limits on each interval [n, further, 3], at a share of the speed. Unless
  // the curve stops at its beginning (end), the motion starts (ends) with a velocity of size `start` (`end`).
  bool run(const CurveSamples& curve, const double* q, const double* limit, size_t further, double speed, double start,
           double end) {
    start_ = curve.stop[0] ? SpeedProfile::kUnbounded : squared(start / speed, curve.slope, curve.dim);
    const double* last = curve.slope + (2 * curve.n - 1) * curve.dim;
    end_ = curve.stop[curve.n] ? SpeedProfile::kUnbounded : squared(end / speed, last, curve.dim);
    move(curve, q);
    if (moving()) return run_with_speeds(curve, q, {limit, further}, speed);
    const std::vector<Box>& box = profile_.enter(curve);
    bool found = false;
    for (const Level& level : levels_) {
      trouble_ = {};
      if (!time(curve, q, level, {limit, further}, box, speed)) {
        if (found) trouble_ = {};
        return found;
      }
      const double longest = found ? best_.duration() : std::numeric_limits<double>::infinity();
      if (now_.duration() >= longest) break;
      const double slower = slowdown(curve, level, longest);
      now_.stretch(slower);
      if (now_.duration() < longest) best_ = now_, best_speed_ = speed_;
      found = true;
      if (slower == 1) break;
    }
    return true;
  }
  const Travel& motion() const { return best_; }
  // Speed of the parameter at each point before any slowdown, also for a motion that comes to a halt.
  const std::vector<double>& speeds() const { return best_.t.empty() ? speed_ : best_speed_; }
  const Trouble& trouble() const { return trouble_; }

 private:
  static constexpr double kRounding = 1e-9;  // relative reserve below the limits for rounding, when others evaluate the
                                             // motion
  static constexpr double kLeastRoom = 1e-3;  // of gravity: least reserve of a facet at rest
  static constexpr double kSlowdown = 1.01;   // factor of each slowdown
  static constexpr int kMostSlowdowns = 310;  // most of them: a factor of 22 in all
  static constexpr double kLeastSlope = 1e-12;
  static constexpr int kRetimings = 5;             // of a motion with a given speed, for limits between samples
  static constexpr double kRetimingRoom = 1.2;     // factor on the excess from one of them to the next
  static constexpr double kSpeedTolerance = 1e-9;  // relative excess of a given squared speed over the feasible one

  // Whether the motion begins or ends with a given speed.
  bool moving() const { return std::min(start_, end_) < SpeedProfile::kUnbounded; }
  // Squared speed of the parameter for a velocity of a given size.
  static double squared(double size, const double* slope, size_t dim) {
    if (!std::isfinite(size)) return SpeedProfile::kUnbounded;
    double length = 0;
    for (size_t j = 0; j < dim; ++j) length += slope[j] * slope[j];
    return size * size / std::max(length, kLeastSlope);
  }

  struct Further {
    const double* row;
    size_t n;
  };

  // Computes the motion of the points with felt limits, which is the same for all levels.
  void move(const CurveSamples& curve, const double* q) {
    const size_t n = curve.n, dim = curve.dim, riders = rider_.size();
    felt_.resize(riders), vessel_.resize(riders);
    if (riders == 0) return;
    const size_t stride = 16 * size_t(core_->tables().n_link);
    poses_.resize((n + 1) * stride);
    core_->kernels().link_poses(core_->tables(), {q, nullptr, n + 1}, poses_.data());
    for (size_t l = 0; l < riders; ++l) {
      const Rider& rider = rider_[l];
      const std::optional<SloshLimit>& slosh = levels_.front()[l].slosh;
      felt_[l].resize(2 * n), vessel_[l].interval.resize(n), vessel_[l].axis.resize(n + 1);
      for (size_t i = 0; i < n; ++i)
        for (size_t end = 0; end < 2; ++end) {
          const LinkPoses at{&poses_[(i + end) * stride]};
          const size_t from = (2 * i + end) * dim;
          Vector3 &velocity = vessel_[l].interval[i].velocity[end], &bend = vessel_[l].interval[i].bend[end];
          rider.derive(at, rider.at(at), curve.slope + from, curve.bend + from, velocity, bend);
          felt_[l][2 * i + end] = {at.within(rider.link, velocity), at.within(rider.link, bend),
                                   at.within(rider.link, {0, 0, 1})};
          if (slosh) vessel_[l].axis[i + end] = at.turned(rider.link, slosh->axis);
        }
    }
  }

  bool time(const CurveSamples& curve, const double* q, const Level& level, const Further& further,
            const std::vector<Box>& box, double speed) {
    const size_t n = curve.n;
    rows_.clear();
    std::vector<double> tightest(level.size(), std::numeric_limits<double>::infinity());
    std::vector<size_t> where(level.size(), 0);
    for (size_t i = 0; i < n; ++i) {
      rows_.begin_interval(box[i]);
      for (size_t l = 0; l < level.size(); ++l)
        for (size_t end = 0; end < 2; ++end) {
          rests_.resize(level[l].facets.size());
          const FeltMotion& at = felt_[l][2 * i + end];
          const double room = rests(level[l], at.up, rests_.data());
          if (room < tightest[l]) tightest[l] = room, where[l] = i + end;
          add_facets(level[l], at, rests_.data(), end ? 2 * curve.step[i] : 0.0, speed, 0, rows_);
        }
      for (size_t k = 0; k < further.n; ++k) {
        const double* row = further.row + 3 * (i * further.n + k);
        rows_.add(row[0], row[1], row[2] / (speed * speed));
      }
      rows_.end_interval();
    }
    for (size_t l = 0; l < level.size(); ++l)
      if (tightest[l] < kLeastRoom * level[l].gravity) return trouble_ = {int(l), where[l], true}, false;
    squared_ = profile_.compute(curve, rows_, start_);
    if (start_ < SpeedProfile::kUnbounded && profile_.reachable() < start_ * (1 - kSpeedTolerance))
      return trouble_ = {-1, 0, true}, false;
    if (end_ < SpeedProfile::kUnbounded && squared_[n] < end_ * (1 - kSpeedTolerance))
      return trouble_ = {-1, n, true}, false;
    speed_.resize(n + 1);
    for (size_t i = 0; i <= n; ++i) speed_[i] = std::sqrt(squared_[i]);
    size_t halted = 0;
    if (!travel(curve, q, squared_, now_, halted)) return trouble_ = {-1, halted, true}, false;
    excess_ = cubics_excess(now_.t.size(), curve.dim, now_.t.data(), now_.q.data(), now_.qd.data(), now_.qdd.data(),
                            velocity_.data(), acceleration_.data());
    now_.excess = moving() ? 1.0 : excess_.both();
    stretched_ = (moving() ? 1.0 : now_.excess * (1 + kRounding)) / speed;
    now_.stretch(stretched_);
    return true;
  }

  // Times a motion that begins or ends with a speed, with tighter limits as long as it exceeds the given ones between
  // samples.
  bool run_with_speeds(const CurveSamples& curve, const double* q, const Further& further, double speed) {
    Excess tighter;
    for (int tried = 0; tried < kRetimings; ++tried) {
      profile_ = SpeedProfile(divided(velocity_, tighter.velocity),
                              divided(acceleration_, tighter.acceleration * tighter.acceleration));
      const std::vector<Box>& box = profile_.enter(curve, start_, end_);
      for (const Level& level : levels_) {
        trouble_ = {};
        if (!time(curve, q, level, further, box, speed)) return false;
        if (excess_.both() > 1 + kRounding) break;
        if (!is_calm(curve, level, 1.0)) continue;
        best_ = now_, best_speed_ = speed_;
        return true;
      }
      if (excess_.both() <= 1 + kRounding) break;  // a liquid swings too far at every level
      tighter.velocity *= 1 + kRetimingRoom * (excess_.velocity - 1);
      tighter.acceleration *= 1 + kRetimingRoom * (excess_.acceleration - 1);
    }
    return trouble_ = {-1, 0, true}, false;
  }
  static Point divided(Point limits, double factor) {
    for (double& limit : limits) limit /= factor;
    return limits;
  }

  // Whether no surface exceeds its rim in the motion slowed down by a factor.
  bool is_calm(const CurveSamples& curve, const Level& level, double slower) const {
    for (size_t l = 0; l < level.size(); ++l)
      if (level[l].slosh &&
          !stays_in(*level[l].slosh, level[l].gravity, curve, vessel_[l], squared_, stretched_ * slower))
        return false;
    return true;
  }

  // Smallest slowdown at which no surface exceeds its rim, or at which the motion takes longer than `longest`.
  double slowdown(const CurveSamples& curve, const Level& level, double longest) const {
    const double most_by_time = std::ceil(std::log(longest / now_.duration()) / std::log(kSlowdown));
    const int most = int(std::min(most_by_time, double(kMostSlowdowns)));
    int swings = -1, calm = 0;
    while (calm < most && !is_calm(curve, level, std::pow(kSlowdown, calm)))
      swings = calm, calm = std::min(std::max(1, 2 * calm), most);
    while (calm - swings > 1) {
      const int middle = (swings + calm) / 2;
      (is_calm(curve, level, std::pow(kSlowdown, middle)) ? calm : swings) = middle;
    }
    return std::pow(kSlowdown, calm);
  }

  const Core* core_;
  std::vector<Level> levels_;
  Point velocity_, acceleration_;
  SpeedProfile profile_;
  std::vector<Rider> rider_;
  CurveLimits rows_;
  std::vector<double> poses_, rests_, squared_, speed_, best_speed_;
  std::vector<std::vector<FeltMotion>> felt_;
  std::vector<VesselMotion> vessel_;
  double stretched_ = 1, start_ = SpeedProfile::kUnbounded, end_ = SpeedProfile::kUnbounded;
  Travel now_, best_;
  Excess excess_;
  Trouble trouble_;
};

}  // namespace gp

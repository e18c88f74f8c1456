// Local improvement of a timed motion. The control points of a smooth curve, travelled as fast as the velocity and
// acceleration limits of the joints allow, descend along the gradient of
//
//   J = V + w (integral of I) + (price of time) T,
//
// plus a penalty for low clearance; the integral is over time, length or samples. The gradient includes the speed
// profile, so corners cost the time they take. The method is BFGS with a line search for functions with kinks, such as
// those where another limit becomes the tightest.
//
// References:
//   A. Lewis and M. Overton, "Nonsmooth optimization via quasi-Newton methods", Mathematical Programming 141, 2013.
//   M. Zucker et al., "CHOMP: Covariant Hamiltonian optimization for motion planning", IJRR 32, 2013 (the initial
//   metric of the steps, which couples neighbours).
#pragma once
#include <deque>
#include <limits>
#include <memory>

#include "search/motion_curve.hpp"
#include "timing/felt_samples.hpp"
#include "timing/speed_profile.hpp"

namespace gp {

struct MotionSettings {
  Point velocity, acceleration;  // limits of the joints
  size_t controls = 16;
  size_t density = 6;        // samples between two knots
  bool rough = false;        // impacts in single precision
  double time_price = 0.02;  // [rad/s]
  double push = 1.0;         // weight of the penalty, relative to J
  double tolerance = 1e-4;   // relative decrease over kLookBack steps below which the descent has converged
  // Shares of the length at both ends where less than the wanted clearance is allowed: there the path leaves and
  // reaches places that are tight for the covering spheres.
  double tight_start = 0, tight_end = 0;
  std::vector<SpecificForceLimit> felt;  // limits on felt acceleration at carried objects
  bool fitted = false;                   // whether the path consists of the control points of a curve
  bool slosh = true;                     // whether sloshing of a liquid is penalised
  double points = 1;                     // number of samples of the motion, for sums over samples
  Point leaving;                         // velocity at the start [rad/s]; empty at rest
  double least_leg = 0;                  // least distance of the second control point from a moving start [rad]
  Point arriving;                        // velocity at the end [rad/s]; empty at rest
  double least_last_leg = 0;             // least distance of the last but one control point from a moving end [rad]
};

inline double size_of(const Point& vector) {
  double squared = 0;
  for (double x : vector) squared += x * x;
  return std::sqrt(squared);
}
inline Point unit(Point vector) {
  const double size = size_of(vector);
  for (double& x : vector) x /= size;
  return vector;
}

inline Point opposite(Point vector) {
  for (double& x : vector) x = -x;
  return vector;
}

class MotionDescent {
 public:
  // Starts from a path. The space must have state slopes; without a given curve, a JointCurve is used.
  MotionDescent(Space& space, const std::vector<Point>& path, const MotionSettings& settings,
                std::unique_ptr<MotionCurve> curve = nullptr)
      : space_(space),
        settings_(settings),
        dim_(size_t(space.dim)),
        curve_(curve ? std::move(curve)
                     : std::make_unique<JointCurve>(
                           space, settings.controls, settings.density,
                           ControlOnRay(unit(settings.leaving), settings.least_leg),
                           ControlOnRay(opposite(unit(settings.arriving)), settings.least_last_leg))),
        start_speed_(size_of(settings.leaving)),
        end_speed_(size_of(settings.arriving)),
        profile_(curve_->axis_velocity(settings.velocity), curve_->axis_acceleration(settings.acceleration)),
        felt_(space, settings.felt, settings.slosh),
        push_(settings.push) {
    const size_t samples = curve_->samples();
    at_.resize(samples, dim_, curve_->axes()), d_.resize(samples, dim_, curve_->axes());
    qd_.resize(samples * dim_), impact_by_q_ = impact_by_qd_ = by_clearance_ = qd_;
    impact_.resize(samples), density_.resize(samples), clearance_.resize(samples), wanted_.resize(samples);
    step_.assign(samples - 1, 1.0 / double(settings.density)), stop_.assign(samples, 0),
        stop_.front() = start_speed_ == 0, stop_.back() = end_speed_ == 0;
    if (settings.fitted && path.size() != settings.controls)
      throw std::invalid_argument("control points that are not those of the curve");
    x_ = settings.fitted ? curve_->adopted(path) : curve_->fitted(path);
    for (size_t i = 0; i < x_.size(); ++i) x_[i] = clipped(i, x_[i]);
    trial_ = x_;
    want();
    begin();
  }

  // Evaluates the whole motion and its gradient; returns false once converged.
  bool step() {
    if (settled_) return false;
    for (size_t i = 0; i < x_.size(); ++i) trial_[i] = clipped(i, x_[i] + share_ * direction_[i]);
    const Evaluation found = evaluate(trial_, trial_gradient_);
    double rise = 0, along = 0;
    for (size_t i = 0; i < x_.size(); ++i)
      rise += gradient_[i] * (trial_[i] - x_[i]), along += trial_gradient_[i] * direction_[i];
    if (!(found.energy <= now_.energy + kArmijo * rise)) {
      longest_ = share_, share_ = shortest_ + shrink(found.energy) * (longest_ - shortest_);
    } else if (along < kWolfe * along_ && std::isinf(longest_) && share_ < kLongestShare) {
      shortest_ = share_, share_ *= 2;
      keep(found);
    } else {
      keep(found);
      accept();
      return !settled_;
    }
    if (++tried_ < kTries) return true;
    if (kept_.energy < now_.energy)
      accept();
    else if (fresh_)
      settled_ = true;
    else
      restart();
    return !settled_;
  }

  // J plus the clearance penalty at its initial weight.
  double value() const { return now_.total; }
  double duration() const { return now_.duration; }
  // The least gap to a moving entity; infinite unless below kPassing.
  double gap() const { return now_.gap; }
  // Largest feasible speed at a moving start or end, relative to the given one, the smaller of both; infinite at rest.
  double speed_room() const { return now_.speed_room; }
  // Increases the weight of the clearance penalty.
  void harden() {
    push_ *= 4.0;
    begin();
  }
  std::vector<Point> controls() const { return curve_->controls(x_); }
  size_t unknowns() const { return x_.size(); }
  const Point& inner() const { return x_; }
  // The objective at given inner control points, and its gradient; for tests.
  double energy(const Point& controls, Point& gradient) { return evaluate(controls, gradient).energy; }

 private:
  struct Evaluation {
    double energy, total, duration, gap, speed_room;
  };
  static constexpr double kKeep = 0.001;   // clearance to keep in addition to the space's margin [m]
  static constexpr double kLongest = 0.3;  // longest step of a control point [rad]
  // Wolfe conditions of the line search (Nocedal and Wright, Numerical Optimization, ch. 3.1), and its longest step.
  static constexpr double kArmijo = 1e-4, kWolfe = 0.9, kLongestShare = 8.0;
  static constexpr double kLeastShrink = 0.05;  // least factor on a rejected step
  static constexpr int kTries = 10;             // evaluations of a line search
  static constexpr size_t kLookBack = 6;        // steps over which the decrease is measured

  // Factor for a step that was too long: the minimum of the parabola through its value and its initial slope, or a half
  // if the step did not start at the present point.
  double shrink(double energy) const {
    if (shortest_ > 0) return 0.5;
    const double fall = -along_ * share_, above = energy - now_.energy + fall;
    return std::clamp(0.5 * fall / above, kLeastShrink, 0.5);
  }

  double clipped(size_t i, double value) const { return std::clamp(value, curve_->lower()[i], curve_->upper()[i]); }

  // Computes the wanted clearance of each sample. Near tight ends, it is interpolated linearly between the clearance at
  // the end and the usual one.
  void want() {
    curve_->sample(x_, at_);
    const size_t samples = curve_->samples();
    const double everything = std::numeric_limits<double>::infinity();
    space_.clearances({at_.q.data(), int(samples), everything}, clearance_.data(), by_clearance_.data());
    const double usual = space_.margin + kKeep;
    const auto relaxed = [&](double end, double length, double tight) {
      return length < tight ? end + (usual - end) * length / tight : usual;
    };
    double whole = 0, length = 0;
    for (size_t k = 0; k + 1 < samples; ++k) whole += space_.distance(&at_.q[k * dim_], &at_.q[(k + 1) * dim_]);
    for (size_t k = 0; k < samples; ++k) {
      wanted_[k] = std::min(relaxed(std::min(usual, clearance_.front()), length, settings_.tight_start),
                            relaxed(std::min(usual, clearance_.back()), whole - length, settings_.tight_end));
      if (k + 1 < samples) length += space_.distance(&at_.q[k * dim_], &at_.q[(k + 1) * dim_]);
    }
  }

  void begin() {
    recent_.clear();
    scale_ = 0;
    now_ = evaluate(x_, gradient_);
    restart();
  }

  // Discards the estimate of the curvature.
  void restart() {
    const size_t n = x_.size();
    inverse_.assign(n * n, 0.0);
    // V alone has a curvature of about (controls / V) times second differences; the rest is assumed proportional.
    const double stiffness =
        double(settings_.controls - 1) / std::max(length_, 1e-3) * std::max(1.0, now_.energy / std::max(length_, 1e-3));
    const size_t m = settings_.controls - 2;
    for (size_t a = 0; a < m; ++a)
      for (size_t b = 0; b < m; ++b)  // the inverse of second differences between two fixed ends
        for (size_t j = 0; j < curve_->columns(); ++j)
          inverse_[(a * curve_->columns() + j) * n + b * curve_->columns() + j] =
              double((std::min(a, b) + 1) * (m - std::max(a, b))) / double(m + 1) / stiffness;
    fresh_ = true, settled_ = false;
    descend();
  }

  void keep(const Evaluation& found) {
    if (tried_kept_ && found.energy >= kept_.energy) return;
    kept_ = found, kept_x_ = trial_, kept_gradient_ = trial_gradient_, tried_kept_ = true;
  }

  void accept() {
    learn();
    recent_.push_back(now_.energy);
    std::swap(x_, kept_x_), std::swap(gradient_, kept_gradient_);
    now_ = kept_, fresh_ = false;
    if (recent_.size() > kLookBack) {
      settled_ = recent_.front() - now_.energy < settings_.tolerance * now_.energy;
      recent_.pop_front();
    }
    if (!settled_) descend();
  }

  // BFGS update of the inverse curvature.
  void learn() {
    const size_t n = x_.size();
    Point s(n), y(n), Hy(n);
    double sy = 0, yHy = 0, yy = 0;
    for (size_t i = 0; i < n; ++i) {
      s[i] = kept_x_[i] - x_[i], y[i] = kept_gradient_[i] - gradient_[i];
      sy += s[i] * y[i], yy += y[i] * y[i];
    }
    if (!(sy > 1e-12 * std::sqrt(yy))) return;
    for (size_t i = 0; i < n; ++i) {
      double sum = 0;
      for (size_t j = 0; j < n; ++j) sum += inverse_[i * n + j] * y[j];
      Hy[i] = sum, yHy += y[i] * sum;
    }
    if (fresh_) {  // the scale of the initial metric is a guess
      const double scale = sy / yHy;
      for (double& h : inverse_) h *= scale;
      for (double& h : Hy) h *= scale;
      yHy *= scale;
    }
    const double both = (1 + yHy / sy) / sy;
    for (size_t i = 0; i < n; ++i)
      for (size_t j = 0; j < n; ++j) inverse_[i * n + j] += both * s[i] * s[j] - (Hy[i] * s[j] + s[i] * Hy[j]) / sy;
  }

  // Computes the next search direction.
  void descend() {
    const size_t n = x_.size();
    Point slope = gradient_;
    for (size_t i = 0; i < n; ++i)  // directions beyond a limit are dropped
      if ((x_[i] <= curve_->lower()[i] && slope[i] > 0) || (x_[i] >= curve_->upper()[i] && slope[i] < 0)) slope[i] = 0;
    direction_.assign(n, 0.0);
    double longest = kLongest;
    along_ = 0;
    for (size_t i = 0; i < n; ++i) {
      for (size_t j = 0; j < n; ++j) direction_[i] -= inverse_[i * n + j] * slope[j];
      longest = std::max(longest, std::abs(direction_[i]));
      along_ += direction_[i] * slope[i];
    }
    share_ = kLongest / longest;
    shortest_ = 0, longest_ = std::numeric_limits<double>::infinity(), tried_ = 0, tried_kept_ = false;
    kept_ = now_;
    if (along_ < 0) return;
    settled_ = fresh_;
    if (!fresh_) restart();
  }

  Evaluation evaluate(const Point& x, Point& gradient) {
    const size_t samples = curve_->samples();
    curve_->sample(x, at_);
    CurveSamples curve{samples - 1, curve_->axes(), step_.data(), at_.slope.data(), at_.bend.data(), stop_.data()};
    const double start = squared(start_speed_, at_.slope.data());
    const double end = kSpeedRoom * squared(end_speed_, last_slope(at_));
    const CurveLimits& limits = felt_.enter(space_, at_.q, step_.front(), profile_.enter(curve, start, end));
    const std::vector<double>& fastest = profile_.compute(curve, limits, start);
    squared_.resize(samples), speed_.resize(samples), pause_.resize(samples - 1);
    double duration = 0;
    for (size_t k = 0; k < samples; ++k)
      squared_[k] = at_.share[k] * at_.share[k] * fastest[k], speed_[k] = std::sqrt(squared_[k]);
    for (size_t k = 0; k + 1 < samples; ++k)
      duration += pause_[k] = 2 * step_[k] / std::max(speed_[k] + speed_[k + 1], kSlowest);
    for (size_t k = 0; k < samples; ++k)
      for (size_t j = 0; j < dim_; ++j) qd_[k * dim_ + j] = at_.tangent[k * dim_ + j] * speed_[k];

    d_.clear();
    d_speed_.assign(samples, 0.0), d_pause_.assign(samples - 1, 0.0), d_squared_.assign(samples, 0.0);
    const double spread = lengthen();
    double motion = length_;
    if (!space_.motion_is_length()) motion = move();
    const bool moves = space_.has_moving();
    if (moves) arrive();
    const double harm = space_.w > 0 ? fail(d_speed_) : 0.0;
    const double total = motion + space_.w * harm + settings_.time_price * duration;
    if (scale_ == 0) scale_ = total;
    const double weight = push_ * scale_ / double(samples);
    const bool timed = space_.w > 0 && space_.measure() == Measure::kTime;
    SpeedPenalty too_fast, too_slow;
    if (start_speed_ > 0) too_fast = lack(kSpeedRoom * start, profile_.reachable(), push_ * scale_);
    if (end_speed_ > 0) too_slow = lack(end, fastest.back(), push_ * scale_);
    const double penalty =
        collide() + (moves ? pass() : 0.0) + weight * felt_.slosh(squared_, pause_) + too_fast.value + too_slow.value;
    felt_.back_slosh(squared_, weight, d_squared_, d_pause_);
    if (moves) delay();
    for (size_t k = 0; k + 1 < samples; ++k) {
      const double price =
          settings_.time_price + d_pause_[k] + 0.5 * space_.w * (timed ? impact_[k] + impact_[k + 1] : 0.0);
      const double by_speed = -price * pause_[k] / std::max(speed_[k] + speed_[k + 1], kSlowest);
      d_speed_[k] += by_speed, d_speed_[k + 1] += by_speed;
    }
    for (size_t k = 0; k < samples; ++k) {
      const double by_squared = stop_[k] || speed_[k] < kSlowest ? 0.0 : d_speed_[k] / (2 * speed_[k]) + d_squared_[k];
      d_.share[k] = 2 * at_.share[k] * fastest[k] * by_squared;
      d_speed_[k] = at_.share[k] * at_.share[k] * by_squared;  // from now on with respect to the squared largest speed
    }
    d_speed_.back() += too_slow.by_feasible;
    const SpeedProfile::EndSlopes d_end =
        profile_.back(curve, limits, d_speed_, {d_.slope.data(), d_.bend.data(), felt_.slopes()}, too_fast.by_feasible);
    // The logarithm of `start` has the same derivative as that of kSpeedRoom times it.
    if (start_speed_ > 0) back_squared(start, too_fast.by_log / start + d_end.start, at_.slope.data(), d_.slope.data());
    if (end_speed_ > 0) back_squared(end, too_slow.by_log / end + d_end.end, last_slope(at_), last_slope(d_));
    felt_.back(d_.q);
    curve_->collect(d_, gradient);
    const double charge = curve_->charge(x, settings_.time_price, gradient);
    double gap = std::numeric_limits<double>::infinity();
    for (size_t k = 1; moves && k + 1 < samples; ++k) gap = std::min(gap, gap_[k]);
    double room = std::numeric_limits<double>::infinity();
    if (start_speed_ > 0) room = std::sqrt(profile_.reachable() / start);
    if (end_speed_ > 0) room = std::min(room, std::sqrt(kSpeedRoom * fastest.back() / end));
    return {total + spread + penalty + charge, total + penalty / push_ + charge, duration, gap, room};
  }

  // Squared speed of the parameter where the joints have a speed, and its derivative by the slopes there.
  double squared(double speed, const double* slope) const {
    if (speed == 0) return SpeedProfile::kUnbounded;
    return speed * speed / std::max(squared_size(slope), kSlowest);
  }
  void back_squared(double squared, double d_squared, const double* slope, double* d_slope) const {
    const double size = std::max(squared_size(slope), kSlowest);
    for (size_t j = 0; j < curve_->axes(); ++j) d_slope[j] -= 2 * squared / size * slope[j] * d_squared;
  }
  double squared_size(const double* slope) const {
    double sum = 0;
    for (size_t j = 0; j < curve_->axes(); ++j) sum += slope[j] * slope[j];
    return sum;
  }
  const double* last_slope(const CurveStates& of) const { return &of.slope[of.slope.size() - curve_->axes()]; }
  double* last_slope(CurveStates& of) const { return &of.slope[of.slope.size() - curve_->axes()]; }

  // Penalty for curves that the robot cannot follow with the speed that is given at an end.
  struct SpeedPenalty {
    double value = 0, by_log = 0, by_feasible = 0;
  };
  static SpeedPenalty lack(double wanted, double feasible, double weight) {
    feasible = std::max(feasible, kSlowest);
    const double lack = std::log(wanted / feasible);
    if (!(lack > 0)) return {};
    return {weight * lack * lack, 2 * weight * lack, -2 * weight * lack / feasible};
  }

  // Computes the length of the curve; returns the excess of its energy over the length, which is zero for even samples.
  // The length alone would not determine where along the curve the control points are.
  double lengthen() {
    const size_t n = curve_->samples() - 1;
    double energy = 0;
    length_ = 0;
    for (size_t k = 0; k < n; ++k) {
      const double d = space_.distance(&at_.q[k * dim_], &at_.q[(k + 1) * dim_]);
      energy += d * d, length_ += d;
    }
    const double value = std::sqrt(double(n) * energy), factor = value > 0 ? double(n) / value : 0.0;
    for (size_t k = 0; k < n; ++k)
      for (size_t j = 0; j < dim_; ++j) {
        const double d = factor * (at_.q[(k + 1) * dim_ + j] - at_.q[k * dim_ + j]);
        d_.q[k * dim_ + j] -= d, d_.q[(k + 1) * dim_ + j] += d;
      }
    return value - length_;
  }

  // V as the integral of a density over length, with derivatives; lengthen() has added the length itself.
  double move() {
    const size_t samples = curve_->samples();
    space_.motion_slopes({at_.q.data(), at_.tangent.data(), int(samples), settings_.rough},
                         {density_.data(), impact_by_q_.data(), impact_by_qd_.data()});
    const double sum = stretch(density_, 1.0, -1.0);
    for (size_t k = 0; k < samples; ++k) {
      for (size_t j = 0; j < dim_; ++j) {
        d_.q[k * dim_ + j] += weight_[k] * impact_by_q_[k * dim_ + j];
        d_.tangent[k * dim_ + j] += weight_[k] * impact_by_qd_[k * dim_ + j];
      }
    }
    return sum;
  }

  // The integral of a density over length. Adds derivatives of the integral of (factor density + offset) with respect
  // to lengths; stores the weight of each sample in weight_.
  double stretch(const Point& density, double factor, double offset) {
    const size_t samples = curve_->samples();
    double sum = 0;
    weight_.assign(samples, 0.0);
    for (size_t k = 0; k + 1 < samples; ++k) {
      const double *a = &at_.q[k * dim_], *b = a + dim_, d = space_.distance(a, b),
                   mean = 0.5 * (density[k] + density[k + 1]);
      weight_[k] += 0.5 * d, weight_[k + 1] += 0.5 * d, sum += d * mean;
      for (size_t j = 0; d > 0 && j < dim_; ++j) {
        const double along = (factor * mean + offset) * (b[j] - a[j]) / d;
        d_.q[k * dim_ + j] -= along, d_.q[(k + 1) * dim_ + j] += along;
      }
    }
    return sum;
  }

  // The integral of the impact, with derivatives except those of the times.
  double fail(std::vector<double>& d_speed) {
    const size_t samples = curve_->samples();
    space_.state_slopes({at_.q.data(), qd_.data(), int(samples), settings_.rough},
                        {impact_.data(), impact_by_q_.data(), impact_by_qd_.data()});
    if (space_.has_moving())
      space_.moving_slopes({at_.q.data(), qd_.data(), time_.data(), int(samples)},
                           {impact_.data(), impact_by_q_.data(), impact_by_qd_.data(), by_time_.data()});
    const Measure measure = space_.measure();
    if (measure == Measure::kLength) stretch(impact_, space_.w, 0.0);
    double sum = 0;
    for (size_t k = 0; k < samples; ++k) {
      const double share = measure == Measure::kLength ? weight_[k]
                           : measure == Measure::kPoints
                               ? settings_.points / double(samples)
                               : 0.5 * ((k > 0 ? pause_[k - 1] : 0.0) + (k + 1 < samples ? pause_[k] : 0.0));
      sum += share * impact_[k];
      if (space_.has_moving()) d_time_[k] += space_.w * share * by_time_[k];
      for (size_t j = 0; j < dim_; ++j) {
        const double by_qd = space_.w * share * impact_by_qd_[k * dim_ + j];
        d_.q[k * dim_ + j] += space_.w * share * impact_by_q_[k * dim_ + j];
        d_.tangent[k * dim_ + j] += by_qd * speed_[k], d_speed[k] += by_qd * at_.tangent[k * dim_ + j];
      }
    }
    return sum;
  }

  double collide() {
    const size_t samples = curve_->samples();
    const double unit = space_.margin + kKeep;
    space_.clearances({at_.q.data(), int(samples), unit}, clearance_.data(), by_clearance_.data());
    const double weight = push_ * scale_ / double(samples);
    double sum = 0;
    for (size_t k = 1; k + 1 < samples; ++k) {
      const double lack = (wanted_[k] - clearance_[k]) / unit;
      if (!(lack > 0)) continue;
      // Linear beyond a few margins, since the depth of the nearest pair is unreliable there.
      const double knee = 5.0, depth = std::min(lack, knee);
      sum += weight * (depth * depth + 2 * knee * (lack - depth));
      for (size_t j = 0; j < dim_; ++j) d_.q[k * dim_ + j] -= 2 * weight * depth / unit * by_clearance_[k * dim_ + j];
    }
    return sum;
  }

  // Computes the time of each sample.
  void arrive() {
    const size_t samples = curve_->samples();
    time_.assign(samples, 0.0), by_time_.assign(samples, 0.0), d_time_.assign(samples, 0.0);
    for (size_t k = 0; k + 1 < samples; ++k) time_[k + 1] = time_[k] + pause_[k];
  }

  // Penalty for low clearance to moving entities at their places at these times.
  double pass() {
    const size_t samples = curve_->samples();
    gap_.resize(samples), by_gap_.resize(samples * dim_), gap_by_time_.resize(samples);
    space_.gaps({at_.q.data(), time_.data(), int(samples), kPassing},
                {gap_.data(), by_gap_.data(), gap_by_time_.data()});
    const double weight = push_ * scale_ / double(samples);
    double sum = 0;
    for (size_t k = 1; k + 1 < samples; ++k) {
      const double lack = (kPassing - gap_[k]) / kPassing;
      if (!(lack > 0)) continue;
      sum += kPassingWeight * weight * lack * lack;
      const double d = -2 * kPassingWeight * weight * lack / kPassing;
      for (size_t j = 0; j < dim_; ++j) d_.q[k * dim_ + j] += d * by_gap_[k * dim_ + j];
      d_time_[k] += d * gap_by_time_[k];
    }
    return sum;
  }

  // A longer pause delays all later samples.
  void delay() {
    double later = 0;
    for (size_t k = d_pause_.size(); k-- > 0;) later += d_time_[k + 1], d_pause_[k] += later;
  }

  static constexpr double kPassing = 0.15;  // wanted clearance to moving entities [m]; the judge requires more than 0
  static constexpr double kPassingWeight = 20.0;  // weight of its square, relative to that of other clearance
  static constexpr double kSlowest = 1e-9;        // lower bound of speeds of the curve parameter [1/s]
  static constexpr double kSpeedRoom = 1.1;       // wanted room for the squared speed at a moving start or end

  Space& space_;
  const MotionSettings settings_;
  const size_t dim_;
  const std::unique_ptr<MotionCurve> curve_;
  const double start_speed_, end_speed_;  // [rad/s]
  SpeedProfile profile_;
  FeltSamples felt_;
  double push_, scale_ = 0, length_ = 0;
  Point x_, trial_, gradient_, trial_gradient_, direction_, kept_x_, kept_gradient_, inverse_;
  CurveStates at_, d_;
  Point qd_, impact_, impact_by_q_, impact_by_qd_, density_, weight_, clearance_, by_clearance_, wanted_;
  Point step_, squared_, speed_, pause_, d_speed_, d_pause_, d_squared_;
  Point time_, by_time_, d_time_, gap_, by_gap_, gap_by_time_;  // for moving entities
  std::vector<uint8_t> stop_;
  Evaluation now_{}, kept_{};
  double share_ = 1, shortest_ = 0, longest_ = 0, along_ = 0;
  int tried_ = 0;
  bool settled_ = false, fresh_ = true, tried_kept_ = false;
  std::deque<double> recent_;
};

}  // namespace gp

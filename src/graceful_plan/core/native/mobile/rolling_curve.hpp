// Curves that a base drives without sideways motion: its heading is that of the tangent, or the opposite in reverse, so
// rolling needs no constraint. The joints of an arm and the share of the fastest speed are additional columns.
//
// The limits of a base are expressed as axes, like joints: motion along the heading, the heading, the lateral
// acceleration (speed times turning rate, whose square root is a speed along u), and the rim of the faster wheel.
#pragma once
#include <cmath>
#include <limits>

#include "search/motion_curve.hpp"

namespace gp {

// Limits of a base; see DiffDrive.
struct RollingLimits {
  double speed, turning, acceleration, turning_acceleration, across, rim, lever;
};

struct RollingSettings {
  RollingLimits limits;
  bool forward = true;
  double heading_before = 0, heading_after = 0;  // heading of the base before and after [rad]
  // Whether it turns in place before and after, so that the directions of the curve at its ends are free.
  bool turns_before = false, turns_after = false;
  bool holds_arm = false;  // whether the arm keeps its posture of the first end
};

class RollingCurve final : public MotionCurve {
 public:
  RollingCurve(const Space& space, size_t controls, size_t density, const RollingSettings& settings)
      : MotionCurve(controls, density, size_t(space.dim)),
        space_(space),
        settings_(settings),
        density_(density),
        arm_(size_t(space.dim) - kBase) {
    for (size_t span = 0; span < basis_.spans(); ++span) third_.push_back(basis_.third(span));
    point_.resize(samples()), share_.resize(samples());
  }

  size_t axes() const override { return kAxes + arm_; }
  Point axis_velocity(const Point& velocity) const override {
    const RollingLimits& l = settings_.limits;
    return with_arm({l.speed, l.turning, std::sqrt(l.across), l.rim}, velocity);
  }
  Point axis_acceleration(const Point& acceleration) const override {
    const RollingLimits& l = settings_.limits;
    return with_arm({l.acceleration, l.turning_acceleration, kUnlimited, kUnlimited}, acceleration);
  }

  // The headings at the ends of a path are kept unless the base turns there.
  Point fitted(const std::vector<Point>& path) override {
    std::vector<Point> controls(control_count(), Point(columns(), 0.0));
    const auto column = [&](const Point& q, size_t j) { return j < 2 ? q[j] : q[j + 1]; };
    const auto set = [&](Point& row, const Point& a, const Point& b, double share) {
      for (size_t j = 0; j + 1 < columns(); ++j) row[j] = column(a, j) + share * (column(b, j) - column(a, j));
    };
    set(controls.front(), path.front(), path.front(), 0.0), set(controls.back(), path.back(), path.back(), 0.0);
    along(space_, path, [&](size_t c, size_t i, double share) { set(controls[c], path[i], path[i + 1], share); });
    return entered(controls);
  }
  // Control points with columns x, y, arm joints, and the logarithm of the share of the fastest speed.
  Point adopted(const std::vector<Point>& controls) override { return entered(controls); }
  std::vector<Point> controls(const Point& x) const override {
    std::vector<Point> points;
    for (size_t c = 0; c < control_count(); ++c) {
      points.emplace_back(columns());
      control(x, c, points.back().data());
    }
    return points;
  }

  void sample(const Point& x, CurveStates& out) override {
    const size_t n = columns(), nq = n;
    controls_.resize(n * control_count());
    for (size_t c = 0; c < control_count(); ++c) control(x, c, &controls_[c * n]);
    for (size_t k = 0; k < samples(); ++k) {
      const SplineBasis::Row& row = row_[k];
      At& p = point_[k];
      p = {};
      double share = 0;
      double *q = &out.q[k * nq], *tangent = &out.tangent[k * nq];
      std::fill_n(q, nq, 0.0), std::fill_n(tangent, nq, 0.0);
      for (size_t m = 0; m < SplineBasis::kOrder; ++m) {
        const double* c = &controls_[(row.first + m) * n];
        for (size_t i = 0; i < 2; ++i)
          q[i] += row.value[m] * c[i], p.first[i] += row.slope[m] * c[i], p.second[i] += row.bend[m] * c[i];
        for (size_t a = 0; a < arm_; ++a)
          q[kBase + a] += row.value[m] * c[2 + a], tangent[kBase + a] += row.slope[m] * c[2 + a];
        share += row.value[m] * c[n - 1];
      }
      out.share[k] = share_[k] = std::exp(share);
      const double sign = settings_.forward ? 1.0 : -1.0;
      p.squared = std::max(p.first[0] * p.first[0] + p.first[1] * p.first[1], kLeastSquared);
      p.metres = std::sqrt(p.squared);
      p.along = (p.first[0] * p.second[0] + p.first[1] * p.second[1]) / p.squared;
      p.turn = cross(p.first, p.second) / p.squared;
      double heading = std::atan2(sign * p.first[1], sign * p.first[0]);
      const double before = k > 0 ? out.q[(k - 1) * nq + 2] : settings_.heading_before;
      q[2] = before + std::remainder(heading - before, 2 * kPi);
      tangent[0] = p.first[0], tangent[1] = p.first[1], tangent[2] = p.turn;
    }
    for (size_t i = 0; i + 1 < samples(); ++i) {
      const std::array<double, 2> third = third_at(i);
      for (size_t side = 0; side < 2; ++side) {
        const At& p = point_[i + side];
        double *slope = &out.slope[(2 * i + side) * axes()], *bend = &out.bend[(2 * i + side) * axes()];
        slope[0] = p.metres, bend[0] = p.metres * p.along;
        slope[1] = p.turn, bend[1] = cross(p.first, third) / p.squared - 2 * p.turn * p.along;
        slope[2] = std::sqrt(p.metres * std::abs(p.turn)), bend[2] = 0;
        slope[3] = p.metres + settings_.limits.lever * std::abs(p.turn), bend[3] = 0;
        for (size_t a = 0; a < arm_; ++a) {
          slope[kAxes + a] = out.tangent[(i + side) * nq + kBase + a];
          bend[kAxes + a] = second(i + side, 2 + a);
        }
      }
    }
  }

  void collect(const CurveStates& d, Point& gradient) const override {
    const size_t n = columns(), nq = n;
    Point by_control(n * control_count(), 0.0);
    std::vector<std::array<double, 2>> d_first(samples()), d_second(samples());
    Point d_arm_second(samples() * arm_), d_tangent = d.tangent;
    for (size_t i = 0; i + 1 < samples(); ++i) {
      const std::array<double, 2> third = third_at(i);
      std::array<double, 2> d_third{};
      for (size_t side = 0; side < 2; ++side) {
        const size_t k = i + side;
        const At& p = point_[k];
        const double *ds = &d.slope[(2 * i + side) * axes()], *db = &d.bend[(2 * i + side) * axes()];
        double d_metres = ds[0] + ds[3] + db[0] * p.along, d_along = db[0] * p.metres - 2 * db[1] * p.turn;
        const double sign = p.turn < 0 ? -1.0 : 1.0, swing = std::abs(p.turn);
        double d_turn = ds[1] - 2 * db[1] * p.along + sign * settings_.limits.lever * ds[3];
        if (ds[2] != 0) {
          const double root = std::max(std::sqrt(p.metres * swing), kLeastRoot);
          d_metres += ds[2] * 0.5 * swing / root, d_turn += sign * ds[2] * 0.5 * p.metres / root;
        }
        // Derivative of cross(first, third) / squared.
        const double quotient = cross(p.first, third) / p.squared;
        d_first[k][0] += db[1] * (third[1] / p.squared - 2 * quotient * p.first[0] / p.squared);
        d_first[k][1] += db[1] * (-third[0] / p.squared - 2 * quotient * p.first[1] / p.squared);
        d_third[0] += db[1] * -p.first[1] / p.squared, d_third[1] += db[1] * p.first[0] / p.squared;
        back(p, d_metres, d_along, d_turn, d_first[k], d_second[k]);
        for (size_t a = 0; a < arm_; ++a) {
          d_tangent[k * nq + kBase + a] += ds[kAxes + a];
          d_arm_second[k * arm_ + a] += db[kAxes + a];
        }
      }
      const size_t span = i / density_;
      for (size_t m = 0; m < SplineBasis::kOrder; ++m)
        for (size_t j = 0; j < 2; ++j) by_control[(span + m) * n + j] += third_[span][m] * d_third[j];
    }
    for (size_t k = 0; k < samples(); ++k) {
      const At& p = point_[k];
      const SplineBasis::Row& row = row_[k];
      const double *d_q = &d.q[k * nq], *d_t = &d_tangent[k * nq];
      d_first[k][0] += d_t[0] - d_q[2] * p.first[1] / p.squared;
      d_first[k][1] += d_t[1] + d_q[2] * p.first[0] / p.squared;
      back(p, 0, 0, d_t[2], d_first[k], d_second[k]);
      for (size_t m = 0; m < SplineBasis::kOrder; ++m) {
        double* out = &by_control[(row.first + m) * n];
        for (size_t j = 0; j < 2; ++j)
          out[j] += row.value[m] * d_q[j] + row.slope[m] * d_first[k][j] + row.bend[m] * d_second[k][j];
        for (size_t a = 0; a < arm_; ++a)
          out[2 + a] +=
              row.value[m] * d_q[kBase + a] + row.slope[m] * d_t[kBase + a] + row.bend[m] * d_arm_second[k * arm_ + a];
        out[n - 1] += row.value[m] * d.share[k] * share_[k];
      }
    }
    reduce(by_control, gradient);
  }

  // Cost of turning in place before and after: its angle, and its duration at a constant price of time.
  double charge(const Point& x, double time_price, Point& gradient) const override {
    double sum = 0;
    const size_t n = columns(), last = inner() - 1;
    const double price = 1.0 + time_price / settings_.limits.turning, sign = settings_.forward ? 1.0 : -1.0;
    const auto add = [&](size_t c, const Point& end, double towards, double wanted) {
      const double dx = towards * (x[c * n] - end[0]), dy = towards * (x[c * n + 1] - end[1]);
      const double squared = std::max(dx * dx + dy * dy, kLeastSquared);
      const double off = std::remainder(std::atan2(sign * dy, sign * dx) - wanted, 2 * kPi);
      const double soft = std::sqrt(off * off + kSoft * kSoft);
      sum += price * (soft - kSoft);
      const double d = price * off / soft * towards;
      gradient[c * n] -= d * dy / squared, gradient[c * n + 1] += d * dx / squared;
    };
    if (settings_.turns_before) add(0, first_, 1.0, settings_.heading_before);
    if (settings_.turns_after) add(last, last_, -1.0, settings_.heading_after);
    return sum;
  }

 private:
  static constexpr size_t kBase = 3, kAxes = 4;
  // kUnlimited: acceleration of axes without a limit; kLeastRoot: lower bound of a square root that is divided by.
  static constexpr double kPi = 3.14159265358979323846, kUnlimited = 1e9, kLeastRoot = 1e-6;
  static constexpr double kLeastSquared = 1e-8;  // least squared length of the tangent [m2]
  static constexpr double kSoft = 0.02;          // angle below which the cost of a turn in place is smoothed [rad]
  static constexpr double kSlowest = -3.0;       // logarithm of the least share of the speed
  static constexpr double kNearest = 0.02;       // from the ends to the next control points, in even steps, at least
  static constexpr double kFree = 1e6;           // upper bound for variables without a limit

  struct At {
    std::array<double, 2> first, second;
    double squared, metres, along, turn;
  };
  template <class A, class B> static double cross(const A& a, const B& b) { return a[0] * b[1] - a[1] * b[0]; }

  Point with_arm(std::initializer_list<double> base, const Point& joints) const {
    Point out(base);
    out.insert(out.end(), joints.begin() + kBase, joints.end());
    return out;
  }

  // Optimisation variables of control points; the directions at the ends are fixed unless the base turns there.
  Point entered(const std::vector<Point>& controls) {
    const size_t n = columns(), last = inner() - 1;
    first_ = controls.front(), last_ = controls.back();
    const double begin = settings_.heading_before, end = settings_.heading_after;
    const double sign = settings_.forward ? 1.0 : -1.0;
    begin_ = {sign * std::cos(begin), sign * std::sin(begin)}, end_ = {sign * std::cos(end), sign * std::sin(end)};
    Point x;
    for (size_t c = 1; c + 1 < controls.size(); ++c) x.insert(x.end(), controls[c].begin(), controls[c].end());
    double length = 0;
    for (size_t c = 0; c + 1 < controls.size(); ++c)
      length += std::hypot(controls[c + 1][0] - controls[c][0], controls[c + 1][1] - controls[c][1]);
    const double step = std::max(length, kNearest) / double(control_count() - 1);
    lower_.clear(), upper_.clear();
    for (size_t c = 0; c < inner(); ++c) {
      for (size_t j = 0; j + 1 < n; ++j) {
        lower_.push_back(space_.lower[j < 2 ? j : j + 1]), upper_.push_back(space_.upper[j < 2 ? j : j + 1]);
      }
      lower_.push_back(kSlowest), upper_.push_back(0.0);
    }
    for (size_t i = 0; settings_.holds_arm && i < x.size(); ++i)
      if (i % n >= 2 && i % n + 1 < n) x[i] = lower_[i] = upper_[i] = first_[i % n];
    const auto bind = [&](size_t c, const Point& at, const Point& from) {
      const double away = std::hypot(at[0] - from[0], at[1] - from[1]);
      x[c * n] = std::max(away, kNearest * step), x[c * n + 1] = 0.0;
      lower_[c * n] = kNearest * step, upper_[c * n] = kFree, lower_[c * n + 1] = upper_[c * n + 1] = 0.0;
    };
    if (!settings_.turns_before) bind(0, controls[1], first_);
    if (!settings_.turns_after) bind(last, controls[controls.size() - 2], last_);
    return x;
  }

  void control(const Point& x, size_t c, double* out) const {
    const size_t n = columns(), last = control_count() - 1;
    const Point& end = c < last ? first_ : last_;
    if (c == 0 || c == last) {
      std::copy_n(end.begin(), n, out);
      out[n - 1] = x[(c == 0 ? 1 : last - 1) * n - 1];  // the same speed as the adjacent control point
      return;
    }
    const double* row = &x[(c - 1) * n];
    std::copy_n(row, n, out);
    if (c == 1 && !settings_.turns_before)
      for (size_t i = 0; i < 2; ++i) out[i] = first_[i] + row[0] * begin_[i];
    if (c == last - 1 && !settings_.turns_after)
      for (size_t i = 0; i < 2; ++i) out[i] = last_[i] - row[0] * end_[i];
  }

  // Maps derivatives with respect to control points to derivatives with respect to the variables.
  void reduce(const Point& by_control, Point& gradient) const {
    const size_t n = columns(), last = control_count() - 1;
    gradient.assign(n * inner(), 0.0);
    for (size_t c = 1; c < last; ++c) {
      double* out = &gradient[(c - 1) * n];
      const double* d = &by_control[c * n];
      std::copy_n(d, n, out);
      const bool bound = (c == 1 && !settings_.turns_before) || (c == last - 1 && !settings_.turns_after);
      if (bound) {
        const std::array<double, 2>& way = c == 1 ? begin_ : end_;
        out[0] = (c == 1 ? 1.0 : -1.0) * (d[0] * way[0] + d[1] * way[1]), out[1] = 0.0;
      }
    }
    gradient[n - 1] += by_control[n - 1], gradient[(inner() - 1) * n + n - 1] += by_control[last * n + n - 1];
  }

  std::array<double, 2> third_at(size_t interval) const {
    const size_t span = interval / density_, n = columns();
    std::array<double, 2> out{};
    for (size_t m = 0; m < SplineBasis::kOrder; ++m)
      for (size_t i = 0; i < 2; ++i) out[i] += third_[span][m] * controls_[(span + m) * n + i];
    return out;
  }
  double second(size_t k, size_t column) const {
    double sum = 0;
    for (size_t m = 0; m < SplineBasis::kOrder; ++m)
      sum += row_[k].bend[m] * controls_[(row_[k].first + m) * columns() + column];
    return sum;
  }

  // Backpropagates derivatives of metres, along and turn.
  static void back(const At& p, double d_metres, double d_along, double d_turn, std::array<double, 2>& d_first,
                   std::array<double, 2>& d_second) {
    const std::array<double, 2>&v = p.first, &a = p.second;
    for (size_t i = 0; i < 2; ++i) {
      d_first[i] +=
          d_metres * v[i] / p.metres + (d_along * (a[i] - 2 * p.along * v[i]) - 2 * d_turn * p.turn * v[i]) / p.squared;
      d_second[i] += d_along * v[i] / p.squared;
    }
    d_first[0] += d_turn * a[1] / p.squared, d_first[1] -= d_turn * a[0] / p.squared;
    d_second[0] -= d_turn * v[1] / p.squared, d_second[1] += d_turn * v[0] / p.squared;
  }

  const Space& space_;
  const RollingSettings settings_;
  const size_t density_, arm_;
  std::vector<std::array<double, SplineBasis::kOrder>> third_;
  Point first_, last_, controls_, share_;
  std::array<double, 2> begin_{}, end_{};
  std::vector<At> point_;
};

}  // namespace gp

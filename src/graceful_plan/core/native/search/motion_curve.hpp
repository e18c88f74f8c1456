// Maps the control points of a spline to the curve of a motion: its configurations, and axes along which speed and
// acceleration are limited. For an arm, the axes are its joints.
#pragma once
#include <algorithm>
#include <vector>

#include "search/planning.hpp"
#include "timing/spline.hpp"

namespace gp {

// Even samples of a curve with parameter u, or derivatives of a sum with respect to these samples.
struct CurveStates {
  Point q, tangent;   // [sample, joint] configurations, and dq/du
  Point slope, bend;  // [interval, 2, axis] first and second derivatives by u at both ends of each interval
  Point share;        // [sample] of the largest speed

  void resize(size_t samples, size_t joints, size_t axes) {
    q.resize(samples * joints), tangent.resize(q.size()), share.resize(samples);
    slope.resize(2 * axes * (samples - 1)), bend.resize(slope.size());
  }
  void clear() {
    for (Point* of : {&q, &tangent, &slope, &bend, &share}) std::fill(of->begin(), of->end(), 0.0);
  }
};

class MotionCurve {
 public:
  MotionCurve(size_t controls, size_t density, size_t columns) : basis_(controls), columns_(columns) {
    for (size_t k = 0; k <= basis_.spans() * density; ++k) row_.push_back(basis_.at(double(k) / double(density)));
  }
  virtual ~MotionCurve() = default;

  size_t samples() const { return row_.size(); }
  // Number of unknowns per control point. The unknowns are those of the inner control points, point by point.
  size_t columns() const { return columns_; }
  const Point& lower() const { return lower_; }
  const Point& upper() const { return upper_; }
  virtual size_t axes() const = 0;
  // Limits of speed and acceleration along the axes, from those of the joints.
  virtual Point axis_velocity(const Point& velocity) const { return velocity; }
  virtual Point axis_acceleration(const Point& acceleration) const { return acceleration; }
  // Unknowns fitted to a path, or taken from the control points of a curve.
  virtual Point fitted(const std::vector<Point>& path) = 0;
  virtual Point adopted(const std::vector<Point>& controls) = 0;
  virtual std::vector<Point> controls(const Point& x) const = 0;
  virtual void sample(const Point& x, CurveStates& out) = 0;
  // Maps derivatives with respect to the last samples to derivatives with respect to the unknowns.
  virtual void collect(const CurveStates& d, Point& gradient) const = 0;
  // Additional cost of the unknowns themselves; adds its derivatives.
  virtual double charge(const Point&, double, Point&) const { return 0.0; }

 protected:
  size_t control_count() const { return basis_.spans() + 3; }
  size_t inner() const { return control_count() - 2; }
  // Places of control points along a polyline: for each inner one, the vertex before it and the share of its edge.
  template <class Place> void along(const Space& space, const std::vector<Point>& path, const Place& place) const {
    std::vector<double> at{0.0};
    for (size_t i = 0; i + 1 < path.size(); ++i)
      at.push_back(at.back() + space.distance(path[i].data(), path[i + 1].data()));
    size_t i = 0;
    for (size_t c = 1; c + 1 < control_count(); ++c) {
      const double s = at.back() * basis_.place(c);
      while (i + 2 < path.size() && at[i + 1] < s) ++i;
      const double gap = at[i + 1] - at[i], share = gap > 0 ? std::min(1.0, (s - at[i]) / gap) : 0.0;
      place(c, i, share);
    }
  }

  const SplineBasis basis_;
  const size_t columns_;
  std::vector<SplineBasis::Row> row_;
  Point lower_, upper_;
};

// The control point next to an end of a curve at which the motion has a velocity. It is projected onto a ray from that
// end, so that the curve leaves or arrives in that direction.
class ControlOnRay {
 public:
  // `direction`: unit vector from the end into the curve, or empty for a free control point. `least`: least distance
  // from the end [rad].
  ControlOnRay(Point direction, double least) : direction_(std::move(direction)), least_(least) {}

  bool given() const { return !direction_.empty(); }
  Point projected(const Point& end, const double* x) const {
    Point point = end;
    const double leg = std::max(least_, along(end, x));
    for (size_t j = 0; j < direction_.size(); ++j) point[j] += leg * direction_[j];
    return point;
  }
  void place(const Point& end, const double* x) { point_ = projected(end, x), shortest_ = along(end, x) <= least_; }
  // The control point of the last place().
  const double* point() const { return point_.data(); }
  // Maps a gradient with respect to the control point to one with respect to the unknowns of the last place().
  void collect(double* gradient) const {
    double along = 0;
    for (size_t j = 0; j < direction_.size(); ++j) along += direction_[j] * gradient[j];
    for (size_t j = 0; j < direction_.size(); ++j) gradient[j] = shortest_ ? 0.0 : along * direction_[j];
  }

 private:
  double along(const Point& end, const double* x) const {
    double sum = 0;
    for (size_t j = 0; j < direction_.size(); ++j) sum += direction_[j] * (x[j] - end[j]);
    return sum;
  }

  const Point direction_;
  const double least_;
  Point point_;
  bool shortest_ = false;  // whether the distance is the least one
};

// A curve in joint space: each joint is a column and an axis.
class JointCurve final : public MotionCurve {
 public:
  // `second` and `before_last` are the control points next to the ends.
  JointCurve(const Space& space, size_t controls, size_t density, ControlOnRay second, ControlOnRay before_last)
      : MotionCurve(controls, density, size_t(space.dim)),
        space_(space),
        second_(std::move(second)),
        before_last_(std::move(before_last)) {
    for (size_t c = 0; c < inner(); ++c) {
      lower_.insert(lower_.end(), space.lower.begin(), space.lower.end());
      upper_.insert(upper_.end(), space.upper.begin(), space.upper.end());
    }
  }

  size_t axes() const override { return columns(); }

  Point fitted(const std::vector<Point>& path) override {
    first_ = path.front(), last_ = path.back();
    Point x;
    along(space_, path, [&](size_t, size_t i, double share) {
      for (size_t j = 0; j < columns(); ++j) x.push_back(path[i][j] + share * (path[i + 1][j] - path[i][j]));
    });
    return x;
  }
  Point adopted(const std::vector<Point>& controls) override {
    first_ = controls.front(), last_ = controls.back();
    Point x;
    for (size_t c = 1; c + 1 < controls.size(); ++c) x.insert(x.end(), controls[c].begin(), controls[c].end());
    return x;
  }
  std::vector<Point> controls(const Point& x) const override {
    std::vector<Point> points{first_};
    for (size_t c = 0; c < inner(); ++c)
      points.emplace_back(x.begin() + long(c * columns()), x.begin() + long((c + 1) * columns()));
    points.push_back(last_);
    if (second_.given()) points[1] = second_.projected(first_, x.data());
    if (before_last_.given()) points[inner()] = before_last_.projected(last_, &x[(inner() - 1) * columns()]);
    return points;
  }

  void sample(const Point& x, CurveStates& out) override {
    const size_t n = control_count(), dim = columns();
    if (second_.given()) second_.place(first_, x.data());
    if (before_last_.given()) before_last_.place(last_, &x[(n - 3) * dim]);
    const auto control = [&](size_t c) {
      if (c == 1 && second_.given()) return second_.point();
      if (c == n - 2 && before_last_.given()) return before_last_.point();
      return c == 0 ? first_.data() : c == n - 1 ? last_.data() : &x[(c - 1) * dim];
    };
    std::fill(out.share.begin(), out.share.end(), 1.0);
    for (size_t k = 0; k < samples(); ++k) {
      const SplineBasis::Row& row = row_[k];
      // A sample is the end of one interval and the beginning of the next.
      const size_t at = k + 1 < samples() ? 2 * k * dim : (2 * k - 1) * dim;
      double *q = &out.q[k * dim], *slope = &out.slope[at], *bend = &out.bend[at];
      std::fill_n(q, dim, 0.0), std::fill_n(slope, dim, 0.0), std::fill_n(bend, dim, 0.0);
      for (size_t m = 0; m < SplineBasis::kOrder; ++m) {
        const double* c = control(row.first + m);
        for (size_t j = 0; j < dim; ++j)
          q[j] += row.value[m] * c[j], slope[j] += row.slope[m] * c[j], bend[j] += row.bend[m] * c[j];
      }
      std::copy_n(slope, dim, &out.tangent[k * dim]);
      if (k == 0 || k + 1 == samples()) continue;
      std::copy_n(slope, dim, slope - dim), std::copy_n(bend, dim, bend - dim);
    }
  }

  void collect(const CurveStates& d, Point& gradient) const override {
    const size_t n = control_count(), dim = columns();
    gradient.assign(dim * inner(), 0.0);
    Point slope(dim), bend(dim);
    for (size_t k = 0; k < samples(); ++k) {
      const SplineBasis::Row& row = row_[k];
      std::copy_n(&d.tangent[k * dim], dim, slope.begin()), std::fill(bend.begin(), bend.end(), 0.0);
      for (size_t side = 0; side < 2; ++side) {
        if (side == 0 ? k == 0 : k + 1 == samples()) continue;
        const size_t at = (2 * k - 1 + side) * dim;
        for (size_t j = 0; j < dim; ++j) slope[j] += d.slope[at + j], bend[j] += d.bend[at + j];
      }
      for (size_t m = 0; m < SplineBasis::kOrder; ++m) {
        const size_t c = row.first + m;
        if (c == 0 || c == n - 1) continue;
        double* out = &gradient[(c - 1) * dim];
        for (size_t j = 0; j < dim; ++j)
          out[j] += row.value[m] * d.q[k * dim + j] + row.slope[m] * slope[j] + row.bend[m] * bend[j];
      }
    }
    if (second_.given()) second_.collect(gradient.data());
    if (before_last_.given()) before_last_.collect(&gradient[(n - 3) * dim]);
  }

 private:
  const Space& space_;
  ControlOnRay second_, before_last_;
  Point first_, last_;
};

}  // namespace gp

// Time-optimal path parametrisation by reachability analysis (TOPP-RA) between stops, with symmetric limits of the
// joints' velocities and accelerations and one-sided limits of the same form, and the derivatives of its result.
//
// Let x be the squared speed of the curve's parameter and u its acceleration, constant on each interval. Every joint
// acceleration slope u + bend x is linear in (u, x), and so is the felt acceleration of a cup. Rest is feasible
// everywhere, so the set of x from which the end can be reached is [0, beta]. Both passes are therefore minima over
// linear functions instead of general LPs.
//
// References:
//   H. Pham and Q.-C. Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis",
//   IEEE Transactions on Robotics 34, 2018.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace gp {

// A curve at both ends of each interval, since its derivatives may have jumps there.
struct CurveSamples {
  size_t n;                    // intervals
  size_t dim;                  // joints
  const double* step;          // [n] length of each interval in the parameter
  const double *slope, *bend;  // [n, 2, dim] first and second derivative with respect to the parameter
  const uint8_t* stop;         // [n + 1] where the motion has to stop
};

// Bounds from the joints on an interval: largest |u|, and largest x at its beginning.
struct Box {
  double push, squared;
};

// One-sided limits a u + b x <= c with c > 0, sorted by interval; within an interval, upper bounds of u come first.
// Limits that are never the tightest are dropped.
class CurveLimits {
 public:
  struct Row {
    double a, reach, tilt;  // u <= reach - tilt x if a > 0, u >= -(reach + tilt x) if a < 0
    size_t tag;
  };
  struct Slope {  // derivatives with respect to a, b and c
    double a = 0, b = 0, c = 0;
  };
  static constexpr double kLeast = 1e-12;  // least absolute coefficient of a limit that is divided by

  void clear() { first_.assign(1, 0), middle_.clear(), bound_.clear(), row_.clear(); }
  const std::vector<Row>& rows() const { return row_; }
  size_t first(size_t interval) const { return first_[interval]; }
  size_t middle(size_t interval) const { return middle_[interval]; }
  // Upper (lower) bounds of u in rows beyond these values are never the tightest.
  double above(size_t interval) const { return bound_[interval].above; }
  double below(size_t interval) const { return bound_[interval].below; }

  void begin_interval(const Box& box) {
    above_ = below_ = box.push, squared_ = box.squared, upper_.clear(), lower_.clear();
  }
  // Upper bounds of |u| and x, as far as known.
  Box box() const { return {std::max(above_, below_), squared_}; }
  void add(double a, double b, double c, size_t tag = 0) {
    if (std::abs(a) < kLeast) a = kLeast;
    double& bound = a > 0 ? above_ : below_;
    if (std::abs(a) * bound + std::max(b, 0.0) * squared_ <= c) return;
    const double inverse = 1 / a;
    const Row row{a, c * std::abs(inverse), b * inverse, tag};
    bound = std::min(bound, row.reach + std::max(-b * std::abs(inverse), 0.0) * squared_);
    (a > 0 ? upper_ : lower_).push_back(row);
  }
  void end_interval() {
    keep(upper_, above_, 1), middle_.push_back(row_.size());
    keep(lower_, below_, -1), first_.push_back(row_.size());
    bound_.push_back({above_, below_});
  }

 private:
  void keep(const std::vector<Row>& rows, double bound, double side) {
    for (const Row& row : rows)
      if (row.reach - std::max(side * row.tilt, 0.0) * squared_ <= bound) row_.push_back(row);
  }

  struct Bound {
    double above, below;
  };
  std::vector<size_t> first_{0}, middle_;
  std::vector<Bound> bound_;
  std::vector<Row> row_, upper_, lower_;
  double above_ = 0, below_ = 0, squared_ = 0;  // of the current interval
};

struct CurveSlopes {  // derivatives with respect to slope, bend and limits; added to
  double *slope, *bend;
  CurveLimits::Slope* limit = nullptr;
};

class SpeedProfile {
 public:
  SpeedProfile(std::vector<double> velocity, std::vector<double> acceleration)
      : velocity_(std::move(velocity)), acceleration_(std::move(acceleration)) {}

  static constexpr double kUnbounded = 1e12;  // squared speed without a limit [1/s^2]
  static constexpr double kStartRoom = 1.2;   // bound of the squared speed at a moving start, relative to the given one

  // Takes a curve and returns the joints' bounds on each interval. Without a stop at the beginning, `start` is the
  // squared speed there, and without one at the end, `end` is the largest squared speed there. These speeds are given,
  // so the velocity limits do not apply to them.
  const std::vector<Box>& enter(const CurveSamples& curve, double start = kUnbounded, double end = kUnbounded) {
    const size_t n = curve.n;
    joint_rows_ = 2 * curve.dim * n;
    A_.resize(joint_rows_), reach_.resize(joint_rows_), tilt_.resize(joint_rows_), box_.resize(n);
    cap_.assign(n + 1, kUnbounded), cap_bound_.assign(n + 1, {});
    for (size_t i = 0; i < n; ++i) add_joints(curve, i);
    for (size_t i = 0; i <= n; ++i)
      if (curve.stop[i]) cap_[i] = 0, cap_bound_[i] = {};
    if (!curve.stop[0] && start < kUnbounded) cap_[0] = kStartRoom * start, cap_bound_[0] = {};
    if (!curve.stop[n] && end < kUnbounded) cap_[n] = end, cap_bound_[n] = {};
    for (size_t i = 0; i < n; ++i) {
      double push = kUnbounded;
      for (size_t r = 2 * curve.dim * i; r < 2 * curve.dim * (i + 1); ++r)
        push = std::min(push, reach_[r] + std::abs(tilt_[r]) * cap_[i]);
      box_[i] = {push, cap_[i]};
    }
    return box_;
  }

  // The largest squared speeds at the n + 1 points of the curve of enter(); the first one is at most `start`.
  const std::vector<double>& compute(const CurveSamples& curve, const CurveLimits& limits, double start = kUnbounded) {
    const size_t n = curve.n;
    add_limits(limits), activate(curve, limits);
    beta_ = cap_, bound_ = cap_bound_, x_.resize(n + 1), limited_.assign(n + 1, kBeta), overturns_.resize(n);
    for (size_t i = 0; i < n; ++i) cap(curve, i);
    for (size_t i = n; i-- > 0;) reach_back(curve, i), ease(curve, i);
    x_[0] = std::min(start, beta_[0]);
    for (size_t i = 0; i < n; ++i) go_on(curve, i);
    return x_;
  }

  // The largest squared speed at the beginning from which the end can be reached; at most kStartRoom times the given.
  double reachable() const { return beta_[0]; }

  // Derivatives with respect to the given squared speeds at the beginning and at the end.
  struct EndSlopes {
    double start, end;
  };
  // Maps derivatives `d_x` with respect to the squared speeds of the last compute(), and `d_reachable`, to the curve,
  // the limits and the given squared speeds.
  EndSlopes back(const CurveSamples& curve, const CurveLimits& limits, std::vector<double>& d_x, const CurveSlopes& out,
                 double d_reachable = 0) {
    const size_t n = curve.n;
    d_beta_.assign(n + 1, 0.0), d_reach_.assign(A_.size(), 0.0), d_tilt_.assign(A_.size(), 0.0);
    for (size_t i = n; i-- > 0;) {
      const double d = d_x[i + 1], S = 2 * curve.step[i];
      const size_t r = limited_[i + 1];
      if (r == kBeta) {
        d_beta_[i + 1] += d;
        continue;
      }
      d_x[i] += (1 - S * tilt_[r]) * d;
      d_tilt_[r] -= S * x_[i] * d, d_reach_[r] += S * d;
    }
    const bool given = x_[0] < beta_[0];
    d_beta_[0] += d_reachable + (given ? 0.0 : d_x[0]);
    for (size_t i = 0; i <= n; ++i) back_bound(curve, i, out);
    for (size_t i = 0; i < n; ++i) back_joints(curve, i, out);
    for (size_t k = 0; k < limits.rows().size(); ++k) {
      const size_t r = joint_rows_ + k;
      if (d_reach_[r] == 0 && d_tilt_[r] == 0) continue;
      out.limit[k].a += by_a(r), out.limit[k].b += d_tilt_[r] / A_[r];
      out.limit[k].c += d_reach_[r] / std::abs(A_[r]);
    }
    return {given ? d_x[0] : 0.0, d_beta_[n]};
  }

 private:
  static constexpr double kLeast = CurveLimits::kLeast;
  static constexpr size_t kBeta = size_t(-1), kEnd = size_t(-1);
  enum Kind : uint8_t { kFixed, kVelocity, kPair, kOverturn, kChain, kStill, kCorner };
  struct Bound {  // what limits beta: one end of a joint, two rows, or one row; a corner's second may be kEnd
    Kind kind = kFixed;
    size_t first = 0, second = 0;
  };

  // A row that may be the tightest: u <= reach - tilt x, or u >= -(reach + tilt x).
  struct Active {
    double reach, tilt;
    size_t row;
  };
  struct Actives {
    const Active *from, *to;
    const Active* begin() const { return from; }
    const Active* end() const { return to; }
  };
  Actives upper(size_t i) const { return {&active_[first_[2 * i]], &active_[first_[2 * i + 1]]}; }
  Actives lower(size_t i) const { return {&active_[first_[2 * i + 1]], &active_[first_[2 * i + 2]]}; }

  // Joints bound u on both sides, other limits on one.
  void activate(const CurveSamples& curve, const CurveLimits& limits) {
    active_.clear(), first_.assign(1, 0);
    const auto add = [&](size_t i, double side, double bound, size_t first, size_t end) {
      for (size_t r = 2 * curve.dim * i; r < 2 * curve.dim * (i + 1); ++r)
        if (reach_[r] - std::max(side * tilt_[r], 0.0) * cap_[i] <= bound) active_.push_back({reach_[r], tilt_[r], r});
      for (size_t k = first; k < end; ++k)
        active_.push_back({limits.rows()[k].reach, limits.rows()[k].tilt, joint_rows_ + k});
      first_.push_back(active_.size());
    };
    for (size_t i = 0; i < curve.n; ++i) {
      add(i, 1, limits.above(i), limits.first(i), limits.middle(i));
      add(i, -1, limits.below(i), limits.middle(i), limits.first(i + 1));
    }
    active_.push_back({});  // so that the last range has a valid end
  }

  // Limits at the beginning of an interval, and at its end, where the squared speed is x + 2 step u.
  void add_joints(const CurveSamples& curve, size_t i) {
    const size_t dim = curve.dim;
    const double *slope = curve.slope + 2 * dim * i, *bend = curve.bend + 2 * dim * i, S = 2 * curve.step[i];
    for (size_t j = 0; j < dim; ++j) {
      set_row(2 * dim * i + j, slope[j], bend[j], acceleration_[j]);
      set_row(2 * dim * i + dim + j, slope[dim + j] + S * bend[dim + j], bend[dim + j], acceleration_[j]);
    }
    for (size_t side = 0; side < 2; ++side) {
      if (curve.stop[i + side]) continue;
      for (size_t j = 0; j < dim; ++j) {
        const size_t at = 2 * dim * i + side * dim + j;
        const double fast = velocity_[j], size = std::max(std::abs(curve.slope[at]), kLeast);
        if (fast * fast < cap_[i + side] * size * size)
          cap_[i + side] = (fast / size) * (fast / size), cap_bound_[i + side] = {kVelocity, at, 0};
      }
    }
  }
  void add_limits(const CurveLimits& limits) {
    const size_t rows = joint_rows_ + limits.rows().size();
    A_.resize(rows), reach_.resize(rows), tilt_.resize(rows);
    for (size_t k = 0; k < limits.rows().size(); ++k) {
      const CurveLimits::Row& row = limits.rows()[k];
      A_[joint_rows_ + k] = row.a, reach_[joint_rows_ + k] = row.reach, tilt_[joint_rows_ + k] = row.tilt;
    }
  }
  void set_row(size_t r, double a, double b, double limit) {
    if (std::abs(a) < kLeast) a = kLeast;
    const double inverse = 1 / a;
    A_[r] = a, reach_[r] = limit * std::abs(inverse), tilt_[r] = b * inverse;
  }
  void limit(size_t i, double value, Bound bound) {
    if (value < beta_[i]) beta_[i] = value, bound_[i] = bound;
  }
  void cap(const CurveSamples& curve, size_t i) {
    const double S = 2 * curve.step[i], x = beta_[i];
    double floor = -kUnbounded, ceiling = kUnbounded, steepest = 0;
    for (const Active& row : upper(i))
      ceiling = std::min(ceiling, row.reach - row.tilt * x), steepest = std::max(steepest, row.tilt);
    for (const Active& row : lower(i)) floor = std::max(floor, -row.reach - row.tilt * x);
    overturns_[i] = S * steepest > 1;
    if (overturns_[i])
      for (const Active& row : upper(i)) {
        const double gain = 1 - S * row.tilt;  // x must not become negative within the interval
        if (gain < 0 && S * row.reach < beta_[i] * -gain) limit(i, S * row.reach / -gain, {kOverturn, row.row, 0});
      }
    if (floor > ceiling) part(i);
  }
  // Every lower bound of u must stay below every upper bound. Their gap is concave in x and positive at rest, so
  // Newton's method from a closed gap descends to its root, using the tightest row of each side at a time.
  void part(size_t i) {
    for (size_t pair = 0; pair < A_.size(); ++pair) {
      double floor = -kUnbounded, ceiling = kUnbounded;
      size_t lowest = 0, highest = 0;
      const double x = beta_[i];
      for (const Active& row : lower(i)) {
        const double below = -row.reach - row.tilt * x;
        if (below > floor) floor = below, highest = row.row;
      }
      for (const Active& row : upper(i)) {
        const double above = row.reach - row.tilt * x;
        if (above < ceiling) ceiling = above, lowest = row.row;
      }
      const double apart = tilt_[lowest] - tilt_[highest], room = reach_[lowest] + reach_[highest];
      if (!(apart * x > room)) return;
      limit(i, room / apart, {kPair, lowest, highest});
      if (!(beta_[i] < x)) return;
    }
  }
  void reach_back(const CurveSamples& curve, size_t i) {
    const double S = 2 * curve.step[i];
    for (const Active& row : lower(i)) {
      const double gain = 1 - S * row.tilt, most = beta_[i + 1] + S * row.reach;
      if (gain > 0 && most < beta_[i] * gain) limit(i, most / gain, {kChain, row.row, 0});
    }
  }
  // The upper bound gain x + push of the squared speed at an interval's end, with x that at its beginning. It comes
  // from an upper row, or from beta at the end, with gain 0.
  struct Line {
    double gain, push;
    size_t row;
    double at(double x) const { return gain * x + push; }
  };
  Line line(const CurveSamples& curve, size_t i, size_t r) const {
    if (r == kEnd) return {0, beta_[i + 1], kEnd};
    return {1 - 2 * curve.step[i] * tilt_[r], 2 * curve.step[i] * reach_[r], r};
  }
  // If the largest speed now forces a low speed next, as where a row hardly depends on u, a lower speed is better: the
  // one that maximises the sum of both. That optimum depends continuously on the curve, unlike the result of always
  // taking the largest speed.
  void ease(const CurveSamples& curve, size_t i) {
    if (!overturns_[i]) return;
    Line now = line(curve, i, kEnd);
    for (const Active& row : upper(i)) {
      const Line other = line(curve, i, row.row);
      if (other.at(beta_[i]) < now.at(beta_[i])) now = other;
    }
    while (now.gain < 0) {
      const double still = now.push / (now.gain * now.gain - now.gain);
      if (still >= beta_[i]) return;
      Line next = now;
      double corner = still;
      const auto look = [&](const Line& other) {
        if (!(other.gain > now.gain)) return;
        const double meet = (now.push - other.push) / (other.gain - now.gain);
        if (meet > corner) corner = meet, next = other;
      };
      look(line(curve, i, kEnd));
      for (const Active& row : upper(i)) look(line(curve, i, row.row));
      if (next.row == now.row) return limit(i, still, {kStill, now.row, 0});
      limit(i, corner, {kCorner, now.row, next.row});
      now = next;
    }
  }
  void go_on(const CurveSamples& curve, size_t i) {
    const double S = 2 * curve.step[i];
    // At a corner, the steeper row gives the same speed with less precision.
    const size_t steep = bound_[i].kind == kCorner && x_[i] >= beta_[i] ? bound_[i].first : kEnd;
    double best = beta_[i + 1];
    for (const Active& row : upper(i)) {
      const double next = (1 - S * row.tilt) * x_[i] + S * row.reach;
      if (next < best && row.row != steep) best = next, limited_[i + 1] = row.row;
    }
    x_[i + 1] = std::max(best, 0.0);
  }

  void back_bound(const CurveSamples& curve, size_t i, const CurveSlopes& out) {
    const Bound& by = bound_[i];
    const double d = d_beta_[i];
    if (d == 0 || by.kind == kFixed) return;
    if (by.kind == kVelocity) {
      const double slope = curve.slope[by.first];
      if (std::abs(slope) > kLeast) out.slope[by.first] -= 2 * beta_[i] / slope * d;
    } else if (by.kind == kPair) {
      const double apart = tilt_[by.first] - tilt_[by.second];
      d_reach_[by.first] += d / apart, d_reach_[by.second] += d / apart;
      d_tilt_[by.first] -= beta_[i] / apart * d, d_tilt_[by.second] += beta_[i] / apart * d;
    } else if (by.kind == kStill || by.kind == kCorner) {
      const Line first = line(curve, i, by.first);
      const auto move = [&](size_t r, double d_gain, double d_push) {
        if (r == kEnd)
          d_beta_[i + 1] += d_push;
        else
          d_tilt_[r] -= 2 * curve.step[i] * d_gain, d_reach_[r] += 2 * curve.step[i] * d_push;
      };
      if (by.kind == kStill) {
        const double scale = first.gain * first.gain - first.gain;
        return move(by.first, -d * beta_[i] * (2 * first.gain - 1) / scale, d / scale);
      }
      const double apart = line(curve, i, by.second).gain - first.gain;
      move(by.first, d * beta_[i] / apart, d / apart);
      move(by.second, -d * beta_[i] / apart, -d / apart);
    } else {
      const double S = 2 * curve.step[i], gain = 1 - S * tilt_[by.first];
      d_tilt_[by.first] += S * beta_[i] / gain * d;
      d_reach_[by.first] += S / std::abs(gain) * d;
      if (by.kind == kChain) d_beta_[i + 1] += d / gain;
    }
  }
  double by_a(size_t r) const { return -(reach_[r] * d_reach_[r] + tilt_[r] * d_tilt_[r]) / A_[r]; }
  void back_joints(const CurveSamples& curve, size_t i, const CurveSlopes& out) const {
    const size_t dim = curve.dim;
    for (size_t k = 0; k < 2 * dim; ++k) {
      const size_t r = 2 * dim * i + k;  // slopes have the same layout: joints at the beginning, then at the end
      if (d_reach_[r] == 0 && d_tilt_[r] == 0) continue;
      const double d_A = by_a(r);
      out.slope[r] += d_A;
      out.bend[r] += d_tilt_[r] / A_[r] + (k < dim ? 0.0 : 2 * curve.step[i] * d_A);
    }
  }

  std::vector<double> velocity_, acceleration_;
  size_t joint_rows_ = 0;
  std::vector<double> A_, reach_, tilt_;  // of the joints' rows, then of the limits
  std::vector<double> cap_, beta_, x_, d_beta_, d_reach_, d_tilt_;
  std::vector<Bound> cap_bound_, bound_;
  std::vector<Active> active_;
  std::vector<size_t> first_;  // into the active rows of each interval: upper ones, then lower ones
  std::vector<size_t> limited_;
  std::vector<uint8_t> overturns_;  // whether a high speed may force x below 0 at the end of an interval
  std::vector<Box> box_;
};

}  // namespace gp

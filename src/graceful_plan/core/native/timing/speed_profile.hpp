// How fast to go where on a curve: time-optimal path parametrisation by reachability analysis (TOPP-RA) between rests,
// under symmetric limits of the joints' velocities and accelerations and other limits of that form, and the derivatives
// of its result.
//
// With x the squared speed of the curve's parameter and u its acceleration, constant on each interval, every joint
// acceleration slope u + bend x is linear in (u, x), and so is what is felt in a cup. Standing still is feasible
// everywhere, so that the set of x from which the end can be reached is [0, beta]: both passes are a minimum over
// linear functions, no general LP.
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

// A curve at both ends of each interval, since derivatives may differ from the left and the right.
struct CurveSamples {
  size_t n;                    // intervals
  size_t dim;                  // joints
  const double* step;          // [n] length of each interval, in terms of the parameter
  const double *slope, *bend;  // [n, 2, dim] first and second derivative with respect to the parameter
  const uint8_t* stop;         // [n + 1] where the motion has to rest
  // One-sided limits a u + b x <= c on each interval, each (a, b, c) with c > 0.
  size_t n_limit = 0;
  const double* limit = nullptr;  // [n, n_limit, 3]
};

struct CurveSlopes {  // derivatives with respect to slope, bend and limits, added up
  double *slope, *bend;
  double* limit = nullptr;
};

class SpeedProfile {
 public:
  SpeedProfile(std::vector<double> velocity, std::vector<double> acceleration)
      : velocity_(std::move(velocity)), acceleration_(std::move(acceleration)) {}

  // The largest squared speeds at the n + 1 points.
  const std::vector<double>& compute(const CurveSamples& curve) {
    const size_t n = curve.n, rows = rows_of(curve);
    A_.resize(n * rows), B_.resize(n * rows), reach_.resize(n * rows), tilt_.resize(n * rows);
    side_.assign(n * rows, kBoth);
    beta_.assign(n + 1, kUnbounded), x_.resize(n + 1), bound_.assign(n + 1, {}), limited_.assign(n + 1, kBeta);
    for (size_t i = 0; i < n; ++i) add_rows(curve, i);
    for (size_t i = 0; i < n; ++i) cap(curve, i);
    for (size_t i = 0; i <= n; ++i)
      if (curve.stop[i]) beta_[i] = 0, bound_[i] = {};
    for (size_t i = n; i-- > 0;) reach_back(curve, i), ease(curve, i);
    x_[0] = beta_[0];
    for (size_t i = 0; i < n; ++i) go_on(curve, i);
    return x_;
  }

  // Derivatives of something whose derivatives with respect to the squared speeds are `d_x`; of the last compute().
  void back(const CurveSamples& curve, std::vector<double> d_x, const CurveSlopes& out) const {
    const size_t n = curve.n, rows = rows_of(curve);
    std::vector<double> d_beta(n + 1, 0.0), d_reach(n * rows, 0.0), d_tilt(n * rows, 0.0);
    for (size_t i = n; i-- > 0;) {
      const double d = d_x[i + 1], S = 2 * curve.step[i];
      if (limited_[i + 1] == kBeta) {
        d_beta[i + 1] += d;
        continue;
      }
      const size_t r = i * rows + size_t(limited_[i + 1]);
      d_x[i] += (1 - S * tilt_[r]) * d;
      d_tilt[r] -= S * x_[i] * d, d_reach[r] += S * d;
    }
    d_beta[0] += d_x[0];
    for (size_t i = 0; i <= n; ++i) back_bound(curve, i, d_beta, d_reach, d_tilt, out);
    for (size_t i = 0; i < n; ++i) back_rows(curve, i, d_reach, d_tilt, out);
  }

 private:
  static constexpr double kUnbounded = 1e12, kLeast = 1e-12;
  static constexpr int kBeta = -1;
  static constexpr size_t kEnd = size_t(-1);
  enum Kind : uint8_t { kFixed, kVelocity, kPair, kOverturn, kChain, kStill, kCorner };
  struct Bound {  // what limits beta: a joint at one side, two rows, one row; of a corner the second may be kEnd
    Kind kind = kFixed;
    size_t first = 0, second = 0;
  };

  enum Side : uint8_t { kUpper = 1, kLower = 2, kBoth = 3 };  // of u, which a row bounds

  static size_t rows_of(const CurveSamples& curve) { return 2 * curve.dim + curve.n_limit; }

  // |A u + B x| <= limit at the beginning of an interval, and at its end, where x + 2 step u holds; then the others.
  void add_rows(const CurveSamples& curve, size_t i) {
    const size_t dim = curve.dim, rows = rows_of(curve);
    const double *slope = curve.slope + 2 * dim * i, *bend = curve.bend + 2 * dim * i, S = 2 * curve.step[i];
    for (size_t j = 0; j < dim; ++j) {
      set_row(rows * i + j, slope[j], bend[j], acceleration_[j]);
      set_row(rows * i + dim + j, slope[dim + j] + S * bend[dim + j], bend[dim + j], acceleration_[j]);
    }
    for (size_t k = 0; k < curve.n_limit; ++k) {
      const double* limit = curve.limit + 3 * (curve.n_limit * i + k);
      const size_t r = rows * i + 2 * dim + k;
      set_row(r, limit[0], limit[1], limit[2]);
      side_[r] = A_[r] > 0 ? kUpper : kLower;
    }
  }
  void set_row(size_t r, double a, double b, double limit) {
    if (std::abs(a) < kLeast) a = kLeast;
    A_[r] = a, B_[r] = b, reach_[r] = limit / std::abs(a), tilt_[r] = b / a;
  }
  void lower(size_t i, double value, Bound bound) {
    if (value < beta_[i]) beta_[i] = value, bound_[i] = bound;
  }
  void cap(const CurveSamples& curve, size_t i) {
    const size_t dim = curve.dim, rows = rows_of(curve);
    const double S = 2 * curve.step[i];
    for (size_t side = 0; side < 2; ++side)
      for (size_t j = 0; j < dim; ++j) {
        const double fast = velocity_[j] / std::max(std::abs(curve.slope[2 * dim * i + side * dim + j]), kLeast);
        lower(i + side, fast * fast, {kVelocity, 2 * dim * i + side * dim + j, 0});
      }
    const double *reach = &reach_[rows * i], *tilt = &tilt_[rows * i];
    const uint8_t* bounds = &side_[rows * i];
    for (size_t r = 0; r < rows; ++r) {
      const double gain = 1 - S * tilt[r];  // not below rest within the interval
      if (gain < 0 && (bounds[r] & kUpper)) lower(i, S * reach[r] / -gain, {kOverturn, rows * i + r, 0});
    }
    // No lower bound of u may pass an upper one. Their gap is concave in x and open at rest, so that Newton's method
    // from where it is closed comes down on its root, with the tightest row of each side at a time.
    for (size_t pair = 0; pair < rows; ++pair) {
      double floor = -kUnbounded, ceiling = kUnbounded;
      size_t lowest = 0, highest = 0;
      for (size_t r = 0; r < rows; ++r) {
        const double below = -reach[r] - tilt[r] * beta_[i], above = reach[r] - tilt[r] * beta_[i];
        if ((bounds[r] & kLower) && below > floor) floor = below, highest = r;
        if ((bounds[r] & kUpper) && above < ceiling) ceiling = above, lowest = r;
      }
      const double apart = tilt[lowest] - tilt[highest], room = reach[lowest] + reach[highest];
      if (!(apart * beta_[i] > room)) return;
      const double before = beta_[i];
      lower(i, room / apart, {kPair, rows * i + lowest, rows * i + highest});
      if (!(beta_[i] < before)) return;
    }
  }
  void reach_back(const CurveSamples& curve, size_t i) {
    const size_t rows = rows_of(curve);
    const double S = 2 * curve.step[i];
    for (size_t r = rows * i; r < rows * (i + 1); ++r) {
      if (!(side_[r] & kLower)) continue;
      const double gain = 1 - S * tilt_[r];
      if (gain > 0) lower(i, (beta_[i + 1] + S * reach_[r]) / gain, {kChain, r, 0});
    }
  }
  // What an upper row says of the squared speed at the end of its interval: at most gain x + push, x that at its
  // beginning. So does beta there, with a gain of 0.
  struct Line {
    double gain, push;
    size_t row;
    double at(double x) const { return gain * x + push; }
  };
  Line line(const CurveSamples& curve, size_t i, size_t r) const {
    if (r == kEnd) return {0, beta_[i + 1], kEnd};
    return {1 - 2 * curve.step[i] * tilt_[r], 2 * curve.step[i] * reach_[r], r};
  }
  // Where to go as fast as can be now means to go slowly next, as where a row says next to nothing of u, less speed is
  // better: as much as makes the sum of both speeds the greatest. Where that is depends continuously on the curve; the
  // fastest next after the fastest now does not.
  void ease(const CurveSamples& curve, size_t i) {
    const size_t first = rows_of(curve) * i, end = first + rows_of(curve);
    Line now = line(curve, i, kEnd);
    for (size_t r = first; r < end; ++r) {
      if (!(side_[r] & kUpper)) continue;
      const Line other = line(curve, i, r);
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
      for (size_t r = first; r < end; ++r)
        if (side_[r] & kUpper) look(line(curve, i, r));
      if (next.row == now.row) return lower(i, still, {kStill, now.row, 0});
      lower(i, corner, {kCorner, now.row, next.row});
      now = next;
    }
  }
  void go_on(const CurveSamples& curve, size_t i) {
    const size_t rows = rows_of(curve);
    const double S = 2 * curve.step[i];
    // At a corner, the steeper of its rows says the same, but with less precision.
    const size_t steep = bound_[i].kind == kCorner && x_[i] >= beta_[i] ? bound_[i].first : kEnd;
    double best = beta_[i + 1];
    for (size_t k = 0; k < rows; ++k) {
      const size_t r = rows * i + k;
      if (!(side_[r] & kUpper) || r == steep) continue;
      const double next = (1 - S * tilt_[r]) * x_[i] + S * reach_[r];
      if (next < best) best = next, limited_[i + 1] = int(k);
    }
    x_[i + 1] = std::max(best, 0.0);
  }

  void back_bound(const CurveSamples& curve, size_t i, std::vector<double>& d_beta, std::vector<double>& d_reach,
                  std::vector<double>& d_tilt, const CurveSlopes& out) const {
    const Bound& by = bound_[i];
    const double d = d_beta[i];
    if (d == 0 || by.kind == kFixed) return;
    if (by.kind == kVelocity) {
      const double slope = curve.slope[by.first];
      if (std::abs(slope) > kLeast) out.slope[by.first] -= 2 * beta_[i] / slope * d;
    } else if (by.kind == kPair) {
      const double apart = tilt_[by.first] - tilt_[by.second];
      d_reach[by.first] += d / apart, d_reach[by.second] += d / apart;
      d_tilt[by.first] -= beta_[i] / apart * d, d_tilt[by.second] += beta_[i] / apart * d;
    } else if (by.kind == kStill || by.kind == kCorner) {
      const Line first = line(curve, i, by.first);
      const auto move = [&](size_t r, double d_gain, double d_push) {
        if (r == kEnd)
          d_beta[i + 1] += d_push;
        else
          d_tilt[r] -= 2 * curve.step[i] * d_gain, d_reach[r] += 2 * curve.step[i] * d_push;
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
      d_tilt[by.first] += S * beta_[i] / gain * d;
      d_reach[by.first] += S / std::abs(gain) * d;
      if (by.kind == kChain) d_beta[i + 1] += d / gain;
    }
  }
  void back_rows(const CurveSamples& curve, size_t i, const std::vector<double>& d_reach,
                 const std::vector<double>& d_tilt, const CurveSlopes& out) const {
    const size_t dim = curve.dim, rows = rows_of(curve);
    for (size_t k = 0; k < rows; ++k) {
      const size_t r = rows * i + k;
      if (d_reach[r] == 0 && d_tilt[r] == 0) continue;
      const double d_A = -(reach_[r] * d_reach[r] + tilt_[r] * d_tilt[r]) / A_[r], d_B = d_tilt[r] / A_[r];
      if (k < 2 * dim) {
        const size_t at = 2 * dim * i + k;  // slopes are laid out so too: the beginning's joints, then the end's
        out.slope[at] += d_A;
        out.bend[at] += d_B + (k < dim ? 0.0 : 2 * curve.step[i] * d_A);
      } else if (out.limit) {
        double* limit = out.limit + 3 * (curve.n_limit * i + k - 2 * dim);
        limit[0] += d_A, limit[1] += d_B, limit[2] += d_reach[r] / std::abs(A_[r]);
      }
    }
  }

  std::vector<double> velocity_, acceleration_;
  std::vector<double> A_, B_, reach_, tilt_, beta_, x_;
  std::vector<uint8_t> side_;
  std::vector<Bound> bound_;
  std::vector<int> limited_;
};

}  // namespace gp

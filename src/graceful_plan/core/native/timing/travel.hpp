// From squared speeds along a curve to a timed motion: samples with positions and velocities, and cubics between them.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "timing/speed_profile.hpp"

namespace gp {

struct Travel {
  std::vector<size_t> at;             // points of the curve that are samples
  std::vector<double> t, q, qd, qdd;  // [n], [n, dim]
  double excess = 1;                  // factor on the duration that the limits between samples require

  double duration() const { return t.back(); }
  void stretch(double factor) {
    for (double& x : t) x *= factor;
    for (double& x : qd) x /= factor;
    for (double& x : qdd) x /= factor * factor;
  }
};

// Factors >= 1 on the times at which velocities, and at which accelerations, keep their limits.
struct Excess {
  double velocity = 1, acceleration = 1;
  double both() const { return std::max(velocity, acceleration); }
};

// The excess of the cubics between n samples.
inline Excess cubics_excess(size_t n, size_t dim, const double* t, const double* q, const double* qd, const double* qdd,
                            const double* velocity, const double* acceleration) {
  double squared = 1, excess = 1;
  for (size_t i = 0; i + 1 < n; ++i) {
    const double h = t[i + 1] - t[i], per = 1 / h;
    for (size_t j = 0; j < dim; ++j) {
      const size_t a = i * dim + j, b = a + dim;
      const double mean = (q[b] - q[a]) * per, v0 = qd[a], v1 = qd[b];
      const double a0 = (6 * mean - 4 * v0 - 2 * v1) * per, a1 = (-6 * mean + 2 * v0 + 4 * v1) * per;
      const double push = std::max({std::abs(a0), std::abs(a1), std::abs(qdd[a])});
      if (push > squared * acceleration[j]) squared = push / acceleration[j];
      // Within a piece, the velocity peaks where the linear acceleration changes sign.
      const double crossing = a0 * a1 < 0 ? a0 / (a0 - a1) * h : 0.0;
      const double fast = std::max(std::abs(v0 + 0.5 * a0 * crossing), std::abs(v0));
      if (fast > excess * velocity[j]) excess = fast / velocity[j];
    }
  }
  return {excess, std::sqrt(squared)};
}

// Drops samples that follow the one before in less than `shortest` [s]; samples at rest stay.
inline std::vector<size_t> long_pieces(const std::vector<double>& t, const std::vector<uint8_t>& rests,
                                       double shortest) {
  std::vector<size_t> kept;
  for (size_t i = 0; i < t.size(); ++i) {
    const bool stays = rests[i] || i == 0 || i + 1 == t.size();
    if (!kept.empty() && !stays && t[i] - t[kept.back()] < shortest) continue;
    const auto may_go = [&](size_t k) { return !rests[k] && k > 0; };
    while (!kept.empty() && may_go(kept.back()) && t[i] - t[kept.back()] < shortest) kept.pop_back();
    kept.push_back(i);
  }
  return kept;
}

constexpr double kShortestPiece = 1e-5;  // [s]; controllers cannot resolve shorter pieces

// Travels a curve at squared speeds `x`, with constant acceleration of the parameter on each interval. Returns false if
// the motion comes to a halt, with the interval in `halted`.
inline bool travel(const CurveSamples& curve, const double* q, const std::vector<double>& x, Travel& out,
                   size_t& halted) {
  const size_t n = curve.n, dim = curve.dim;
  std::vector<double> t(n + 1, 0.0);
  std::vector<uint8_t> rests(n + 1, 0);
  double shortest = kShortestPiece;
  for (size_t i = 0; i < n; ++i) {
    const double mean = 0.5 * (std::sqrt(x[i]) + std::sqrt(x[i + 1]));
    if (!(mean > 0)) return halted = i, false;
    const double pause = curve.step[i] / mean;
    t[i + 1] = t[i] + pause, shortest = std::min(shortest, pause);
  }
  const auto side = [&](size_t i) { return i < n ? 2 * dim * i : 2 * dim * (n - 1) + dim; };
  for (size_t i = 0; i <= n; ++i) rests[i] = x[i] == 0;
  out.at.clear();
  if (shortest < kShortestPiece)
    out.at = long_pieces(t, rests, kShortestPiece);
  else
    for (size_t i = 0; i <= n; ++i) out.at.push_back(i);
  const size_t samples = out.at.size();
  out.t.resize(samples), out.q.resize(samples * dim), out.qd.resize(samples * dim), out.qdd.resize(samples * dim);
  for (size_t k = 0; k < samples; ++k) {
    const size_t i = out.at[k], last = std::min(i, n - 1);
    const double push = (x[last + 1] - x[last]) / (2 * curve.step[last]), speed = std::sqrt(x[i]);
    out.t[k] = t[i];
    for (size_t j = 0; j < dim; ++j) {
      const double slope = curve.slope[side(i) + j], bend = curve.bend[side(i) + j];
      out.q[k * dim + j] = q[i * dim + j], out.qd[k * dim + j] = slope * speed;
      out.qdd[k * dim + j] = slope * push + bend * x[i];
    }
  }
  return true;
}

}  // namespace gp

// Descent of a whole path along the gradient of J: Levenberg-Marquardt steps on the vertices of a polyline with fixed
// ends. The objective is the energy n/2 sum c_i^2 of the edges' costs c_i, as for geodesics. Its minima are paths of
// least total cost whose edges cost the same; the sum alone would let vertices slide along the path. A penalty keeps
// clearances at the margin.
//
// References:
//   Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", SIAM J. Appl. Math. 1963.
//   chain_curvature.hpp has those of the curvature.
#pragma once
#include <algorithm>
#include <deque>

#include "search/chain_curvature.hpp"
#include "search/planning.hpp"

namespace gp {

struct DescentSettings {
  double step = 0.06;       // distance between samples of the impact [rad]
  double push = 1.0;        // weight of the penalty, relative to J
  double tolerance = 1e-3;  // relative decrease of the energy over kLookBack steps below which the descent has
                            // converged
  bool rough = false;       // half the work per evaluation: one pace, and clearances at vertices only
};

class Descent {
 public:
  // The space must have slopes.
  Descent(Space& space, const std::vector<Point>& path, int pieces, DescentSettings settings)
      : space_(space),
        settings_(settings),
        dim_(size_t(space.dim)),
        n_(size_t(pieces)),
        push_(settings.push),
        curvature_(n_, dim_) {
    respace(path);
    cost_.resize(2 * n_), by_from_.resize(n_ * dim_), by_to_.resize(n_ * dim_);
    probe_.resize((2 * n_ - 1) * dim_), clearance_.resize(2 * n_ - 1), by_clearance_.resize(probe_.size());
    trial_ = slope_ = x_, gradient_.resize(2 * n_ * dim_), trial_gradient_.resize(gradient_.size());
    begin();
  }

  // Evaluates the whole path and its gradient; returns false once converged. A rejected step also updates the
  // curvature, and increases the damping.
  bool step() {
    if (settled_) return false;
    for (size_t i = 0; i < x_.size(); ++i) trial_[i] = x_[i] + share_ * direction_[i];
    clip(trial_);
    const Evaluation found = evaluate(trial_, trial_gradient_);
    curvature_.learn(x_, gradient_, trial_, trial_gradient_);
    if (found.energy <= now_.energy + 1e-4 * share_ * along_) {
      accept(found);
    } else {
      damping_ = std::max(kMoreDamping * damping_, kDamping);
      settled_ = ++refusals_ > kRefusals;
    }
    if (!settled_) descend();
    return !settled_;
  }

  // J plus the penalty for low clearance.
  double value() const { return now_.total; }
  // The objective.
  double energy() const { return now_.energy; }
  // Increases the weight of the clearance penalty.
  void harden() {
    push_ *= 4.0;
    begin();
  }
  std::vector<Point> path() const {
    std::vector<Point> points{first_};
    for (size_t i = 0; i + 1 < n_; ++i)
      points.emplace_back(x_.begin() + long(i * dim_), x_.begin() + long((i + 1) * dim_));
    points.push_back(last_);
    return points;
  }

 private:
  struct Evaluation {
    double energy, total;
  };
  static constexpr double kKeep = 0.001;   // clearance to keep in addition to the space's margin [m]
  static constexpr double kLongest = 0.5;  // longest step of a vertex [rad]
  // Levenberg-Marquardt damping: at the start, least after a rejected step, factors after rejected and accepted steps,
  // and the value below which it is 0.
  static constexpr double kBegin = 1.0, kDamping = 0.3, kMoreDamping = 4.0, kLessDamping = 0.25, kLeastDamping = 1e-3;
  static constexpr int kRefusals = 12;    // consecutive rejections before it stops
  static constexpr size_t kLookBack = 8;  // steps over which the decrease is measured

  // Cuts the path into pieces of equal length, within the limits.
  void respace(const std::vector<Point>& path) {
    first_ = path.front(), last_ = path.back();
    std::vector<double> at{0.0};
    for (size_t i = 0; i + 1 < path.size(); ++i)
      at.push_back(at.back() + space_.distance(path[i].data(), path[i + 1].data()));
    x_.clear();
    size_t i = 0;
    for (size_t k = 1; k < n_; ++k) {
      const double s = at.back() * double(k) / double(n_);
      while (i + 2 < path.size() && at[i + 1] < s) ++i;
      const double gap = at[i + 1] - at[i], share = gap > 0 ? std::min(1.0, (s - at[i]) / gap) : 0.0;
      for (size_t j = 0; j < dim_; ++j) x_.push_back(path[i][j] + share * (path[i + 1][j] - path[i][j]));
    }
    clip(x_);
  }

  void begin() {
    recent_.clear();
    refusals_ = 0, damping_ = kBegin, scale_ = 0;
    now_ = evaluate(x_, gradient_);
    // Assumes costs proportional to lengths.
    std::vector<double> stiffness(n_);
    const Point all = vertices(x_);
    for (size_t e = 0; e < n_; ++e) {
      const double length = space_.distance(&all[e * dim_], &all[(e + 1) * dim_]),
                   density = length > 0 ? edge_[e] / length : 1.0;
      stiffness[e] = double(n_) * density * density;
    }
    curvature_.reset(stiffness);
    settled_ = n_ < 2;
    if (!settled_) descend();
  }

  void accept(const Evaluation& found) {
    recent_.push_back(now_.energy);
    std::swap(x_, trial_), std::swap(gradient_, trial_gradient_);
    now_ = found;
    refusals_ = 0, damping_ *= kLessDamping;
    if (damping_ < kLeastDamping) damping_ = 0;
    if (recent_.size() <= kLookBack) return;
    settled_ = recent_.front() - now_.energy < settings_.tolerance * now_.energy;
    recent_.pop_front();
  }

  // Computes the next trial step.
  void descend() {
    for (size_t v = 0; v + 1 < n_; ++v)
      for (size_t j = 0; j < dim_; ++j)
        slope_[v * dim_ + j] = gradient_[(2 * v + 1) * dim_ + j] + gradient_[(2 * v + 2) * dim_ + j];
    // Directions beyond a limit are dropped.
    for (size_t i = 0; i < x_.size(); ++i)
      if ((x_[i] <= space_.lower[i % dim_] && slope_[i] > 0) || (x_[i] >= space_.upper[i % dim_] && slope_[i] < 0))
        slope_[i] = 0;
    curvature_.solve(slope_, damping_, direction_);
    double longest = kLongest;
    along_ = 0;
    for (size_t i = 0; i < x_.size(); ++i)
      along_ += direction_[i] * slope_[i], longest = std::max(longest, std::abs(direction_[i]));
    share_ = kLongest / longest;
    settled_ = !(along_ < 0);
  }

  void clip(Point& x) const {
    for (size_t i = 0; i < x.size(); ++i) x[i] = std::clamp(x[i], space_.lower[i % dim_], space_.upper[i % dim_]);
  }
  Point vertices(const Point& x) const {
    Point all(first_);
    all.insert(all.end(), x.begin(), x.end()), all.insert(all.end(), last_.begin(), last_.end());
    return all;
  }

  // The gradient holds the derivatives of each edge's term with respect to its two ends.
  Evaluation evaluate(const Point& x, Point& gradient) {
    const Point all = vertices(x);
    if (space_.w > 0)
      space_.slopes({all.data(), int(n_)}, settings_.step, settings_.rough,
                    {cost_.data(), by_from_.data(), by_to_.data()});
    edge_.resize(n_);
    double total = 0, energy = 0;
    for (size_t e = 0; e < n_; ++e) {
      const double *from = &all[e * dim_], *to = from + dim_, length = space_.distance(from, to),
                   c = length + space_.w * cost_[2 * e + 1];
      edge_[e] = c, total += c, energy += 0.5 * double(n_) * c * c;
      for (size_t j = 0; j < dim_; ++j) {
        const double along = length > 0 ? (to[j] - from[j]) / length : 0.0;
        gradient[2 * e * dim_ + j] = double(n_) * c * (space_.w * by_from_[e * dim_ + j] - along);
        gradient[(2 * e + 1) * dim_ + j] = double(n_) * c * (space_.w * by_to_[e * dim_ + j] + along);
      }
    }
    if (scale_ == 0) scale_ = total;
    const double penalty = collide(all, gradient);
    return {energy + scale_ * penalty, total + penalty};  // the energy is about J^2 / 2, so the penalty is scaled by J
  }

  // Penalty for vertices and midpoints of edges with low clearance.
  double collide(const Point& all, Point& gradient) {
    const size_t n = settings_.rough ? n_ - 1 : 2 * n_ - 1;
    const auto before = [&](size_t k) { return settings_.rough ? k + 1 : (k + 1) / 2; };
    const auto after = [&](size_t k) { return settings_.rough ? k + 1 : (k + 2) / 2; };
    for (size_t k = 0; k < n; ++k)
      for (size_t j = 0; j < dim_; ++j)
        probe_[k * dim_ + j] = 0.5 * (all[before(k) * dim_ + j] + all[after(k) * dim_ + j]);
    const double wanted = space_.margin + kKeep;
    space_.clearances({probe_.data(), int(n), wanted}, clearance_.data(), by_clearance_.data());
    const double weight = push_ * (settings_.rough ? 2.0 : 1.0) * scale_ / double(n_);
    double sum = 0;
    for (size_t k = 0; k < n; ++k) {
      const double lack = (wanted - clearance_[k]) / wanted;
      if (!(lack > 0)) continue;
      // Linear beyond a few margins, since the depth of the nearest pair is unreliable there.
      const double knee = 5.0, depth = std::min(lack, knee);
      sum += weight * (depth * depth + 2 * knee * (lack - depth));
      // A vertex counts as the end of the edge before it.
      const size_t a = before(k), edge = a == after(k) ? a - 1 : a;
      const double share = a == after(k) ? 0.0 : 0.5;
      for (size_t j = 0; j < dim_; ++j) {
        const double d = -2.0 * scale_ * weight * depth / wanted * by_clearance_[k * dim_ + j];
        gradient[2 * edge * dim_ + j] += share * d, gradient[(2 * edge + 1) * dim_ + j] += (1.0 - share) * d;
      }
    }
    return sum;
  }

  Space& space_;
  const DescentSettings settings_;
  const size_t dim_, n_;
  double push_;
  ChainCurvature curvature_;
  double scale_ = 0, along_ = 0, share_ = 1, damping_ = 0;
  int refusals_ = 0;
  bool settled_ = false;
  Evaluation now_{0, 0};
  Point first_, last_, x_, trial_, slope_, gradient_, trial_gradient_, direction_, edge_;
  Point cost_, by_from_, by_to_, probe_, clearance_, by_clearance_;
  std::deque<double> recent_;
};

}  // namespace gp

// Descent of a whole path along the gradient of J: L-BFGS on the vertices of a polyline with fixed ends, in the metric of the
// path's squared velocity (CHOMP's covariant gradient), with a penalty on clearances below the margin.
//
// References:
//   Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013.
//   Nocedal and Wright, "Numerical optimization", 2006, algorithm 7.4.
#pragma once
#include <algorithm>
#include <deque>

#include "planning.hpp"

namespace gp {

struct DescentSettings {
  double step = 0.06;    // between samples of the impact [rad]
  double keep = 0.001;   // clearance to keep on top of the space's margin [m]
  double push = 5.0;     // weight of the penalty, relative to J
  double tolerance = 1e-3;  // relative fall of the cost over some steps below which it is settled
  bool rough = false;    // half the work an evaluation: one pace, and clearances at the vertices only
};

class Descent {
 public:
  // In a space that has slopes.
  Descent(Space& space, const std::vector<Point>& path, int pieces, DescentSettings settings)
      : space_(space), settings_(settings), dim_(size_t(space.dim)), n_(size_t(pieces)), push_(settings.push) {
    respace(path);
    cost_.resize(2 * n_), by_from_.resize(n_ * dim_), by_to_.resize(n_ * dim_);
    probe_.resize((2 * n_ - 1) * dim_), clearance_.resize(2 * n_ - 1), by_clearance_.resize(probe_.size());
    trial_ = x_, slope_.resize(x_.size()), trial_slope_.resize(x_.size());
    begin();
  }

  // One evaluation of the whole path and its gradient; false once nothing is gained any more.
  bool step() {
    if (settled_) return false;
    const double length = tried_;
    for (size_t i = 0; i < x_.size(); ++i) trial_[i] = x_[i] + length * direction_[i];
    clip(trial_);
    const double f = evaluate(trial_, trial_slope_), expected = length * along_;
    if (f <= value_ + 1e-4 * expected) {
      accept(f);
      return !settled_;
    }
    const double parabola = -0.5 * length * expected / std::max(f - value_ - expected, 1e-300);
    tried_ = std::clamp(parabola, 0.1 * length, 0.5 * length);
    if (++refusals_ > 8) restart();
    return !settled_;
  }

  double value() const { return value_; }
  // Press harder against what is in the way.
  void harden() {
    push_ *= 4.0;
    begin();
  }
  std::vector<Point> path() const {
    std::vector<Point> points{first_};
    for (size_t i = 0; i + 1 < n_; ++i) points.emplace_back(x_.begin() + long(i * dim_), x_.begin() + long((i + 1) * dim_));
    points.push_back(last_);
    return points;
  }

 private:
  struct Pair {
    Point s, y;
    double rho;
  };
  static constexpr size_t kHistory = 8;
  static constexpr double kLongest = 0.25;  // of a vertex in one step [rad]

  // The path cut into pieces of equal length, within the limits.
  void respace(const std::vector<Point>& path) {
    first_ = path.front(), last_ = path.back();
    std::vector<double> at{0.0};
    for (size_t i = 0; i + 1 < path.size(); ++i) at.push_back(at.back() + space_.distance(path[i].data(), path[i + 1].data()));
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
    history_.clear();
    recent_.clear();
    scale_ = 0;
    value_ = evaluate(x_, slope_);
    settled_ = n_ < 2;
    if (!settled_) descend();
  }
  void restart() {
    if (history_.empty()) settled_ = true;
    history_.clear();
    if (!settled_) descend();
  }

  const double* vertex(const Point& x, size_t i) const { return i == 0 ? first_.data() : i == n_ ? last_.data() : x.data() + (i - 1) * dim_; }

  void clip(Point& x) const {
    for (size_t i = 0; i < x.size(); ++i) x[i] = std::clamp(x[i], space_.lower[i % dim_], space_.upper[i % dim_]);
  }

  double evaluate(const Point& x, Point& slope) {
    Point all(first_);
    all.insert(all.end(), x.begin(), x.end()), all.insert(all.end(), last_.begin(), last_.end());
    if (space_.w > 0) space_.slopes(all.data(), int(n_), settings_.step, settings_.rough, cost_.data(), by_from_.data(), by_to_.data());
    std::fill(slope.begin(), slope.end(), 0.0);
    double total = 0;
    for (size_t e = 0; e < n_; ++e) {
      const double length = space_.distance(&all[e * dim_], &all[(e + 1) * dim_]), c = length + (space_.w > 0 ? space_.w * cost_[2 * e + 1] : 0.0);
      total += c;
      for (size_t j = 0; j < dim_; ++j) {
        const double along = length > 0 ? (all[(e + 1) * dim_ + j] - all[e * dim_ + j]) / length : 0.0;
        if (e > 0) slope[(e - 1) * dim_ + j] += (space_.w > 0 ? space_.w * by_from_[e * dim_ + j] : 0.0) - along;
        if (e + 1 < n_) slope[e * dim_ + j] += (space_.w > 0 ? space_.w * by_to_[e * dim_ + j] : 0.0) + along;
      }
    }
    if (scale_ == 0) scale_ = push_ * total / double(n_);
    const double penalty = collide(all, slope);
    // Nothing is gained by going on into a limit.
    for (size_t i = 0; i < x.size(); ++i)
      if ((x[i] <= space_.lower[i % dim_] && slope[i] > 0) || (x[i] >= space_.upper[i % dim_] && slope[i] < 0)) slope[i] = 0;
    return total + penalty;
  }

  // Vertices and the middles of edges that come too close to something.
  double collide(const Point& all, Point& slope) {
    const size_t n = settings_.rough ? n_ - 1 : 2 * n_ - 1;
    const auto before = [&](size_t k) { return settings_.rough ? k + 1 : (k + 1) / 2; };
    const auto after = [&](size_t k) { return settings_.rough ? k + 1 : (k + 2) / 2; };
    for (size_t k = 0; k < n; ++k)
      for (size_t j = 0; j < dim_; ++j) probe_[k * dim_ + j] = 0.5 * (all[before(k) * dim_ + j] + all[after(k) * dim_ + j]);
    space_.clearances(probe_.data(), int(n), clearance_.data(), by_clearance_.data());
    const double wanted = space_.margin + settings_.keep, unit = std::max(wanted, settings_.keep);
    const double weight = settings_.rough ? 2.0 * scale_ : scale_;
    double sum = 0;
    for (size_t k = 0; k < n; ++k) {
      const double lack = (wanted - clearance_[k]) / unit;
      if (!(lack > 0)) continue;
      // Beyond a few margins it grows evenly: how deep the nearest pair is says little then.
      const double knee = 5.0, depth = std::min(lack, knee);
      sum += weight * (depth * depth + 2 * knee * (lack - depth));
      for (size_t j = 0; j < dim_; ++j) {
        const double d = -2.0 * weight * depth / unit * by_clearance_[k * dim_ + j];
        for (const size_t v : {before(k), after(k)})
          if (v > 0 && v < n_) slope[(v - 1) * dim_ + j] += 0.5 * d;
      }
    }
    return sum;
  }

  // A^-1 of a gradient, A the matrix of the path's squared velocity: n (2 on the diagonal, -1 beside it).
  void smooth(Point& g) const {
    const size_t m = n_ - 1;
    std::vector<double> ratio(m);
    double before = 0;
    for (size_t i = 0; i < m; ++i) {
      const double pivot = 2.0 - before;
      for (size_t j = 0; j < dim_; ++j) g[i * dim_ + j] = (g[i * dim_ + j] + (i > 0 ? g[(i - 1) * dim_ + j] : 0.0)) / pivot;
      ratio[i] = before = 1.0 / pivot;
    }
    for (size_t i = m - 1; i-- > 0;)
      for (size_t j = 0; j < dim_; ++j) g[i * dim_ + j] += ratio[i] * g[(i + 1) * dim_ + j];
    for (double& v : g) v /= double(n_);
  }

  static double dot(const Point& a, const Point& b) {
    double sum = 0;
    for (size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
    return sum;
  }

  void descend() {
    Point r = slope_;
    std::vector<double> alpha(history_.size());
    for (size_t k = history_.size(); k-- > 0;) {
      alpha[k] = history_[k].rho * dot(history_[k].s, r);
      for (size_t i = 0; i < r.size(); ++i) r[i] -= alpha[k] * history_[k].y[i];
    }
    smooth(r);
    if (!history_.empty()) {
      Point curved = history_.back().y;
      smooth(curved);
      const double gamma = 1.0 / (history_.back().rho * std::max(dot(history_.back().y, curved), 1e-300));
      for (double& v : r) v *= gamma;
    }
    for (size_t k = 0; k < history_.size(); ++k) {
      const double beta = history_[k].rho * dot(history_[k].y, r);
      for (size_t i = 0; i < r.size(); ++i) r[i] += (alpha[k] - beta) * history_[k].s[i];
    }
    double longest = 0;
    for (double& v : r) v = -v, longest = std::max(longest, std::abs(v));
    direction_ = std::move(r);
    along_ = dot(direction_, slope_);
    if (!(along_ < 0)) return restart();
    tried_ = history_.empty() ? 0.1 / longest : std::min(1.0, kLongest / longest);
    refusals_ = 0;
  }

  void accept(double f) {
    Pair pair{Point(x_.size()), Point(x_.size()), 0};
    for (size_t i = 0; i < x_.size(); ++i) pair.s[i] = trial_[i] - x_[i], pair.y[i] = trial_slope_[i] - slope_[i];
    const double sy = dot(pair.s, pair.y);
    if (sy > 1e-10 * std::sqrt(dot(pair.s, pair.s) * dot(pair.y, pair.y))) {
      pair.rho = 1.0 / sy;
      history_.push_back(std::move(pair));
      if (history_.size() > kHistory) history_.pop_front();
    }
    recent_.push_back(value_);
    std::swap(x_, trial_), std::swap(slope_, trial_slope_);
    value_ = f;
    if (recent_.size() > 8) {
      settled_ = recent_.front() - value_ < settings_.tolerance * value_;
      recent_.pop_front();
    }
    if (!settled_) descend();
  }

  Space& space_;
  const DescentSettings settings_;
  const size_t dim_, n_;
  double push_, scale_ = 0, value_ = 0, along_ = 0, tried_ = 1;
  int refusals_ = 0;
  bool settled_ = false;
  Point first_, last_, x_, slope_, trial_, trial_slope_, direction_;
  Point cost_, by_from_, by_to_, probe_, clearance_, by_clearance_;
  std::deque<Pair> history_;
  std::deque<double> recent_;
};

}  // namespace gp

// Refinement of a path by random moves: shortcuts, perturbed vertices, smooth bumps. A move is kept only if it lowers J
// and the new edges are free, so the path stays valid.
#pragma once
#include <algorithm>

#include "search/planning.hpp"

namespace gp {

class Refiner {
 public:
  Refiner(Space& space, Polyline path, double spacing, uint64_t seed)
      : space_(space), path_(std::move(path)), spacing_(spacing), sigma_{spacing, spacing}, random_(seed) {}

  const Polyline& path() const { return path_; }
  // Size of the vertex moves relative to the spacing; small values mean convergence.
  double settled() const { return std::max(sigma_[0], sigma_[1]) / spacing_; }

  // One trial move; returns true if J decreased.
  bool step() {
    ++moves_;
    if (path_.q.size() < 2) return false;
    if (moves_ % 50 == 1) respace();
    const double u = random_.uniform();
    if (path_.q.size() == 2 || u < 0.12) return shortcut();
    if (u < 0.20) return partial_shortcut();
    if (u < 0.32) return posture_shortcut();
    if (u < 0.60) return adapt(0, perturb(0));
    if (u < 0.90) return adapt(1, perturb(1 + random_.below(int(path_.q.size()) / 2)));
    return straighten();
  }

 private:
  // Step sizes by the one-fifth success rule.
  bool adapt(int kind, bool improved) {
    sigma_[kind] = std::clamp(sigma_[kind] * (improved ? 1.5 : 0.92), 1e-4 * spacing_, 4 * spacing_);
    return improved;
  }

  // Splits long edges and drops crowded vertices, so that vertices are about evenly spaced.
  void respace() {
    for (size_t i = path_.q.size() - 1; i-- > 1;) {
      const double gap = space_.distance(path_.q[i - 1].data(), path_.q[i + 1].data());
      if (gap < 0.8 * spacing_) replace(int(i) - 1, int(i) + 1, {});
    }
    for (size_t i = 0; i + 1 < path_.q.size(); ++i) {
      const double d = space_.distance(path_.q[i].data(), path_.q[i + 1].data());
      if (d < 1.6 * spacing_ || path_.q.size() > 200) continue;
      const int pieces = int(std::lround(d / spacing_));
      std::vector<Point> points;
      for (int k = 1; k < pieces; ++k) points.push_back(between(path_.q[i], path_.q[i + 1], double(k) / pieces));
      subdivide(i, points);
      i += points.size();
    }
  }

  Point between(const Point& a, const Point& b, double s) const {
    Point out(a.size());
    for (size_t j = 0; j < a.size(); ++j) out[j] = a[j] + s * (b[j] - a[j]);
    return out;
  }

  // The same path with more vertices; costs are evaluated again, since samples shift.
  void subdivide(size_t i, const std::vector<Point>& points) {
    path_.q.insert(path_.q.begin() + long(i) + 1, points.begin(), points.end());
    path_.edge.insert(path_.edge.begin() + long(i) + 1, points.size(), 0.0);
    path_.price(space_, i, points.size() + 1);
  }

  // Replaces the vertices strictly between `first` and `last` if J decreases and the new edges are free.
  bool replace(int first, int last, const std::vector<Point>& points) {
    double before = 0;
    for (int k = first; k < last; ++k) before += path_.edge[size_t(k)];
    const double limit = before * (1 - 1e-9);
    std::vector<const double*> chain{path_.q[size_t(first)].data()};
    for (const Point& p : points) chain.push_back(p.data());
    chain.push_back(path_.q[size_t(last)].data());
    double after = 0, motion = 0;
    for (size_t k = 0; k + 1 < chain.size(); ++k) motion += space_.motion(chain[k], chain[k + 1]);
    if (motion >= limit) return false;
    std::vector<double> costs;
    for (size_t k = 0; k + 1 < chain.size() && after < limit; ++k) {
      costs.push_back(space_.cost_below(chain[k], chain[k + 1], limit - after));
      after += costs.back();
    }
    if (!(after < limit)) return false;
    for (size_t k = 0; k + 1 < chain.size(); ++k)
      if (!space_.edge_free(chain[k], chain[k + 1])) return false;
    for (size_t k = 0; k + 1 < chain.size(); ++k)
      if (!space_.edge_certain(chain[k], chain[k + 1])) return false;
    path_.q.erase(path_.q.begin() + first + 1, path_.q.begin() + last);
    path_.q.insert(path_.q.begin() + first + 1, points.begin(), points.end());
    path_.edge.erase(path_.edge.begin() + first, path_.edge.begin() + last);
    path_.edge.insert(path_.edge.begin() + first, costs.begin(), costs.end());
    path_.sum();
    return true;
  }

  // Connects two random points on the path directly; the new section is subdivided like the rest.
  bool shortcut() {
    const int n = int(path_.q.size());
    int i = random_.below(n - 1), j = random_.below(n - 1);
    if (i > j) std::swap(i, j);
    if (i == j) return false;
    const Point a = between(path_.q[size_t(i)], path_.q[size_t(i) + 1], random_.uniform());
    const Point b = between(path_.q[size_t(j)], path_.q[size_t(j) + 1], random_.uniform());
    return replace(i, j + 1, fill(a, b));
  }

  std::vector<Point> fill(const Point& a, const Point& b) const {
    std::vector<Point> points{a};
    const int pieces = std::max(1, int(std::lround(space_.distance(a.data(), b.data()) / spacing_)));
    for (int k = 1; k < pieces; ++k) points.push_back(between(a, b, double(k) / pieces));
    points.push_back(b);
    return points;
  }

  // Straightens one joint's motion between two vertices and keeps that of the others (Geraerts and Overmars 2007).
  bool partial_shortcut() {
    const int n = int(path_.q.size());
    int i = random_.below(n), j = random_.below(n);
    if (i > j) std::swap(i, j);
    if (j - i < 2) return false;
    const size_t joint = size_t(random_.below(space_.dim));
    std::vector<Point> points(path_.q.begin() + i + 1, path_.q.begin() + j);
    for (int k = i + 1; k < j; ++k) {
      const double s = double(k - i) / (j - i);
      points[size_t(k - i - 1)][joint] = path_.q[size_t(i)][joint] * (1 - s) + path_.q[size_t(j)][joint] * s;
    }
    return replace(i, j, points);
  }

  // Straightens a section in joint space as far as the tool can stay in place. Otherwise a redundant arm wanders, and
  // no shortcut fixes that if the tool's own detour keeps the impact low.
  bool posture_shortcut() {
    const int n = int(path_.q.size());
    int i = random_.below(n), j = random_.below(n);
    if (i > j) std::swap(i, j);
    if (j - i < 2) return false;
    const double fraction = random_.uniform();
    std::vector<Point> points(path_.q.begin() + i + 1, path_.q.begin() + j);
    for (int k = i + 1; k < j; ++k) {
      Point& q = points[size_t(k - i - 1)];
      Point step = between(path_.q[size_t(i)], path_.q[size_t(j)], double(k - i) / (j - i));
      for (size_t d = 0; d < q.size(); ++d) step[d] = fraction * (step[d] - q[d]);
      if (!space_.keep_tool(q.data(), step.data())) return false;
      for (size_t d = 0; d < q.size(); ++d) q[d] = std::clamp(q[d] + step[d], space_.lower[d], space_.upper[d]);
    }
    return replace(i, j, points);
  }

  // Moves a vertex, or a window of vertices by a smooth bump, within the limits. Of several random displacements, it
  // tries the one with the lowest estimated cost: the impact at the vertex costs a fraction of that of two edges.
  bool perturb(int reach) {
    const int n = int(path_.q.size()), centre = 1 + random_.below(n - 2);
    const int first = std::max(0, centre - reach - 1), last = std::min(n - 1, centre + reach + 1);
    const Point direction =
        displacement(path_.q[size_t(first)], path_.q[size_t(centre)], path_.q[size_t(last)], sigma_[reach > 0]);
    std::vector<Point> points(path_.q.begin() + first + 1, path_.q.begin() + last);
    for (int k = first + 1; k < last; ++k) {
      const double s = double(k - centre) / (reach + 1), bump = (1 - s * s) * (1 - s * s);
      for (size_t j = 0; j < direction.size(); ++j) {
        double& value = points[size_t(k - first - 1)][j];
        value = std::clamp(value + bump * direction[j], space_.lower[j], space_.upper[j]);
      }
    }
    return replace(first, last, points);
  }

  // The vertex after the tool moves a little in a random direction; a joint moves the tool by about 0.4 m/rad.
  bool tool_displacement(const Point& vertex, double sigma, double* q) {
    const double step[3] = {random_.normal() * sigma * 0.4, random_.normal() * sigma * 0.4,
                            random_.normal() * sigma * 0.4};
    if (!space_.move_tool(vertex.data(), step, q)) return false;
    for (size_t j = 0; j < vertex.size(); ++j) q[j] = std::clamp(vertex[j] + q[j], space_.lower[j], space_.upper[j]);
    return true;
  }

  Point displacement(const Point& before, const Point& vertex, const Point& after, double sigma) {
    constexpr int kTried = 8;  // moves compared by their impact; the best one is kept
    const size_t dim = size_t(space_.dim);
    const int tried = space_.w > 0 && random_.uniform() < 0.7 ? kTried : 1;
    std::vector<double> moved(size_t(tried) * dim);
    for (int k = 0; k < tried; ++k) {
      double* q = moved.data() + size_t(k) * dim;
      if (k % 3 == 2 && tool_displacement(vertex, sigma, q)) continue;
      const bool one_joint = random_.uniform() < 0.5;
      const size_t joint = size_t(random_.below(space_.dim));
      for (size_t j = 0; j < dim; ++j) {
        const double scale = one_joint ? double(j == joint) : 1.0 / std::sqrt(double(dim));
        const double value = vertex[j] + random_.normal() * sigma * scale;
        q[j] = std::clamp(value, space_.lower[j], space_.upper[j]);
      }
    }
    int best = 0;
    if (tried > 1) {
      double impact[kTried], least = std::numeric_limits<double>::infinity();
      space_.impacts(moved.data(), tried, impact);
      for (int k = 0; k < tried; ++k) {
        const double* q = moved.data() + size_t(k) * dim;
        const double guess = space_.guess(before.data(), q, impact[k]) + space_.guess(q, after.data(), impact[k]);
        if (guess < least) least = guess, best = k;
      }
    }
    Point out(dim);
    for (size_t j = 0; j < dim; ++j) out[j] = moved[size_t(best) * dim + j] - vertex[j];
    return out;
  }

  // Pulls a vertex towards the chord of its neighbours.
  bool straighten() {
    const int n = int(path_.q.size()), i = 1 + random_.below(n - 2);
    const Point middle = between(path_.q[size_t(i) - 1], path_.q[size_t(i) + 1], 0.5);
    return replace(i - 1, i + 1, {between(path_.q[size_t(i)], middle, random_.uniform())});
  }

  Space& space_;
  Polyline path_;
  double spacing_;
  double sigma_[2];
  Random random_;
  int64_t moves_ = 0;
};

}  // namespace gp

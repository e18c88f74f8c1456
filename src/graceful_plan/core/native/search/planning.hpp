// What the native planners share: the space they plan in, paths with cached costs, random numbers, a tree.
#pragma once
#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "timing/rider.hpp"

namespace gp {

using Point = std::vector<double>;

// The edges between consecutive points, and what is known of them: V and S, and the derivatives of S with respect to
// the first and the second end of each.
struct Chain {
  const double* points;
  int n_edge;
};
struct ChainSlopes {
  double *cost, *by_from, *by_to;
};
// States row by row; `rough` if single precision will do.
struct MovingStates {
  const double *q, *qd;
  int n;
  bool rough;
};
// Configurations row by row, and the clearance below which they matter.
struct Probes {
  const double* q;
  int n;
  double wanted;
};
// The impact of states and its derivatives with respect to q and to qd, row by row.
struct StateSlopes {
  double *impact, *by_q, *by_qd;
};

// The same at times [s], and the derivatives with respect to these.
struct TimedStates {
  const double *q, *qd, *t;
  int n;
};
struct TimedSlopes {
  double *impact, *by_q, *by_qd, *by_t;
};
// Configurations at times, and the gap to entities that move below which they matter, with its derivatives.
struct TimedProbes {
  const double *q, *t;
  int n;
  double wanted;
};
struct GapSlopes {
  double *gap, *by_q, *by_t;
};

// What a density of states is integrated over along a motion: its time, its length, or the plain sum over its samples.
enum class Measure { kTime, kLength, kPoints };

// Something that rides on a link: where a point of it is, how it is turned, and how both move with the joints.
struct Ride {
  double p[3], R[9];
  Point J, turn;  // [3, nq]: of the point, and the axes about which joints turn it
};

// What a planner sees of the world and of the cost J = V + w S.
struct Space {
  int dim = 0;
  double w = 0;
  double margin = 0;  // clearance to keep [m]
  Point lower, upper;

  Space(Point low, Point high, double weight)
      : dim(int(low.size())), w(weight), lower(std::move(low)), upper(std::move(high)) {
    bool ordered = dim > 0 && lower.size() == upper.size() && std::isfinite(w) && w >= 0;
    for (size_t j = 0; ordered && j < lower.size(); ++j)
      ordered = std::isfinite(lower[j]) && std::isfinite(upper[j]) && lower[j] <= upper[j];
    if (!ordered) throw std::invalid_argument("limits and weight of a space are numbers, lower ones first");
  }
  virtual ~Space() = default;
  virtual bool edge_free(const double* a, const double* b) = 0;
  // The same at a finer step, for edges that become part of a path; asked after edge_free.
  virtual bool edge_certain(const double* a, const double* b) = 0;
  virtual double impact(const double* a, const double* b) = 0;         // S of an edge
  virtual void impacts(const double* points, int n, double* out) = 0;  // I of configurations, row by row
  // What the impact is integrated over: how long or how much of it an edge is.
  virtual double exposure(const double* a, const double* b) const { return distance(a, b); }
  // Leave of a displacement what does not move the tool; false if the space knows no tool.
  virtual bool keep_tool(const double*, double*) { return false; }
  // The smallest displacement that moves the tool by so much, to first order; false if the space knows no tool.
  virtual bool move_tool(const double*, const double*, double*) { return false; }
  // Whether configurations have to keep bounds that are thin among all configurations: sampling needs project() then.
  virtual bool has_bounds() const { return false; }
  // Move a configuration to where its bounds hold, with a margin; false if that is not found nearby.
  virtual bool project(double*) { return true; }
  // Poses of all links in so many configurations, [n, link, 4, 4]; only asked where the space knows links.
  virtual void poses(const Chain&, Point&) { throw std::logic_error("a space without links"); }
  virtual Rider rider(int, const Vector3&) const { throw std::logic_error("a space without links"); }
  // Whether the two below are known.
  virtual bool has_slopes() const { return false; }
  // Of edges sampled at so long steps; `rough` halves the work again.
  virtual void slopes(const Chain&, double, bool, const ChainSlopes&) {}
  // Of states that move.
  virtual bool has_state_slopes() const { return false; }
  virtual void state_slopes(const MovingStates&, const StateSlopes&) {}
  // Whether there are entities that move: what they add to the impact of states and its derivatives, and how far the
  // robot is from the nearest of them, infinite where that is more than what is wanted.
  virtual bool has_moving() const { return false; }
  virtual void moving_slopes(const TimedStates&, const TimedSlopes&) {}
  virtual void gaps(const TimedProbes&, const GapSlopes&) {}
  // What the impact of a motion is integrated over.
  virtual Measure measure() const { return Measure::kTime; }
  // Where motion() is not the length: its density over length, at states whose `qd` is a tangent of the path.
  virtual void motion_slopes(const MovingStates&, const StateSlopes&) {}
  // Signed clearances of configurations and their gradients where they are below `wanted`, which is seen much faster
  // than how far the rest is away; infinite elsewhere.
  virtual void clearances(const Probes&, double*, double*) {}
  virtual double motion(const double* a, const double* b) { return distance(a, b); }
  // Whether motion() is the length, so that distances bound the cost from below.
  virtual bool motion_is_length() const { return true; }

  double distance(const double* a, const double* b) const {
    double d2 = 0;
    for (int j = 0; j < dim; ++j) d2 += (b[j] - a[j]) * (b[j] - a[j]);
    return std::sqrt(d2);
  }
  double cost(const double* a, const double* b) {
    const double v = motion(a, b);
    return w > 0 ? v + w * impact(a, b) : v;
  }
  // The cost of each edge of a chain; one question where questions are dear.
  virtual void costs(const Chain& of, double* out) {
    for (int e = 0; e < of.n_edge; ++e) out[e] = cost(of.points + e * dim, of.points + (e + 1) * dim);
  }
  // The cost, or infinity as soon as it is known to reach `limit`: impact is never negative, and dear.
  double cost_below(const double* a, const double* b, double limit) {
    const double v = motion(a, b);
    if (v >= limit) return std::numeric_limits<double>::infinity();
    return w > 0 ? v + w * impact(a, b) : v;
  }
  // About what an edge costs along which the impact is so much.
  double guess(const double* a, const double* b, double mean_impact) const {
    return distance(a, b) + w * mean_impact * exposure(a, b);
  }
  double extent() const { return distance(lower.data(), upper.data()); }
  // Whether the edges between the vertices `first` and `last` of a path are free and certain: the cheap question for
  // all first.
  bool path_free(const std::vector<Point>& path, size_t first, size_t last) {
    for (size_t k = first; k < last; ++k)
      if (!edge_free(path[k].data(), path[k + 1].data())) return false;
    for (size_t k = first; k < last; ++k)
      if (!edge_certain(path[k].data(), path[k + 1].data())) return false;
    return true;
  }
  bool path_free(const std::vector<Point>& path) { return path_free(path, 0, path.size() - 1); }
};

// xoshiro256++ by Blackman and Vigna (public domain algorithm), seeded by splitmix64.
class Random {
 public:
  explicit Random(uint64_t seed) {
    for (uint64_t& s : state_) {
      uint64_t z = (seed += 0x9e3779b97f4a7c15ull);
      z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
      z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
      s = z ^ (z >> 31);
    }
  }
  uint64_t bits() {
    const uint64_t out = rotl(state_[0] + state_[3], 23) + state_[0], t = state_[1] << 17;
    state_[2] ^= state_[0], state_[3] ^= state_[1], state_[1] ^= state_[2], state_[0] ^= state_[3], state_[2] ^= t;
    state_[3] = rotl(state_[3], 45);
    return out;
  }
  double uniform() { return double(bits() >> 11) * 0x1.0p-53; }
  double uniform(double a, double b) { return a + (b - a) * uniform(); }
  int below(int n) { return int(uniform() * n); }
  double normal() { return std::sqrt(-2 * std::log(1 - uniform())) * std::cos(6.283185307179586 * uniform()); }

 private:
  static uint64_t rotl(uint64_t x, int k) { return (x << k) | (x >> (64 - k)); }
  uint64_t state_[4];
};

// Iterations and seconds that one call may use.
class Slice {
 public:
  Slice(int64_t iterations, double seconds)
      : limit_(iterations), seconds_(seconds), start_(std::chrono::steady_clock::now()) {}
  bool next() {
    if (used_ == limit_) return false;
    if (used_ > 0 && std::isfinite(seconds_) &&
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count() > seconds_)
      return false;
    ++used_;
    return true;
  }
  int64_t used() const { return used_; }

 private:
  int64_t limit_, used_ = 0;
  double seconds_;
  std::chrono::steady_clock::time_point start_;
};

// A polyline with the cost of every edge.
struct Polyline {
  std::vector<Point> q;
  std::vector<double> edge;
  double total = std::numeric_limits<double>::infinity();

  static Polyline of(Space& space, std::vector<Point> points) {
    Polyline path{std::move(points), {}, 0};
    path.price(space, 0, path.q.size() - 1);
    return path;
  }
  // Evaluate so many edges anew, from the one that begins at a vertex.
  void price(Space& space, size_t first, size_t n) {
    Point rows;
    for (size_t k = first; k <= first + n; ++k) rows.insert(rows.end(), q[k].begin(), q[k].end());
    edge.resize(q.size() - 1);
    if (n > 0) space.costs({rows.data(), int(n)}, edge.data() + first);
    sum();
  }
  void sum() {
    total = 0;
    for (double c : edge) total += c;
  }
};

// Nodes in one array for a linear scan, which beats every other structure below some thousands of nodes.
struct Tree {
  int dim;
  std::vector<double> q, cost;
  std::vector<int> parent;

  explicit Tree(int d) : dim(d) {}
  int size() const { return int(parent.size()); }
  const double* node(int i) const { return q.data() + size_t(i) * size_t(dim); }
  int add(const double* point, int from, double cost_to_come) {
    q.insert(q.end(), point, point + dim);
    parent.push_back(from);
    cost.push_back(cost_to_come);
    return size() - 1;
  }
  // Nearest node whose cost plus distance stays below `cost_limit`; -1 if there is none.
  int nearest(const double* point, double cost_limit = std::numeric_limits<double>::infinity()) const {
    int best = -1;
    double best_d2 = std::numeric_limits<double>::infinity();
    const double* row = q.data();
    for (int i = 0; i < size(); ++i, row += dim) {
      double d2 = 0;
      for (int j = 0; j < dim; ++j) d2 += (row[j] - point[j]) * (row[j] - point[j]);
      if (d2 < best_d2 && (std::isinf(cost_limit) || cost[size_t(i)] + std::sqrt(d2) < cost_limit))
        best_d2 = d2, best = i;
    }
    return best;
  }
};

}  // namespace gp

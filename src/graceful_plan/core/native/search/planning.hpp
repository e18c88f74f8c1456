// Shared by the native planners: the space they plan in, paths with cached costs, random numbers, a tree.
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

// The edges between consecutive points, and their V and S with the derivatives of S with respect to the first and
// second end of each edge.
struct Chain {
  const double* points;
  int n_edge;
};
struct ChainSlopes {
  double *cost, *by_from, *by_to;
};
// Rows of states; `rough` if single precision is enough.
struct MovingStates {
  const double *q, *qd;
  int n;
  bool rough;
};
// Rows of configurations, and the clearance below which they matter.
struct Probes {
  const double* q;
  int n;
  double wanted;
};
// Rows of the impact of states, and its derivatives with respect to q and qd.
struct StateSlopes {
  double *impact, *by_q, *by_qd;
};

// The same at times t [s], with derivatives with respect to t.
struct TimedStates {
  const double *q, *qd, *t;
  int n;
};
struct TimedSlopes {
  double *impact, *by_q, *by_qd, *by_t;
};
// Configurations at times; gaps to moving entities matter below `wanted`, and come with derivatives.
struct TimedProbes {
  const double *q, *t;
  int n;
  double wanted;
};
struct GapSlopes {
  double *gap, *by_q, *by_t;
};

// The measure over which a density of states is integrated along a motion: time, length, or a plain sum over samples.
enum class Measure { kTime, kLength, kPoints };

// A point and a rotation attached to a link, and their derivatives with respect to the joints.
struct Ride {
  double p[3], R[9];
  Point J, turn;  // [3, nq]: Jacobian of the point; axes about which joints rotate it
};

// A planner's view of the world and of the cost J = V + w S.
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
  // Finer check of edges that become part of a path; called after edge_free.
  virtual bool edge_certain(const double* a, const double* b) = 0;
  virtual double impact(const double* a, const double* b) = 0;         // S of an edge
  virtual void impacts(const double* points, int n, double* out) = 0;  // I of configurations (rows)
  // The measure of an edge over which its impact is integrated, such as its duration or length.
  virtual double exposure(const double* a, const double* b) const { return distance(a, b); }
  // Removes the part of a displacement that moves the tool; false if the space has no tool.
  virtual bool keep_tool(const double*, double*) { return false; }
  // The smallest displacement that moves the tool by a step, to first order; false if the space has no tool.
  virtual bool move_tool(const double*, const double*, double*) { return false; }
  // Whether configurations must satisfy bounds that few samples satisfy, so that sampling needs project().
  virtual bool has_bounds() const { return false; }
  // Moves a configuration to where its bounds hold with a margin; false if it finds none nearby.
  virtual bool project(double*) { return true; }
  // Poses of all links, [n, link, 4, 4]; requires a space with links.
  virtual void poses(const Chain&, Point&) { throw std::logic_error("a space without links"); }
  virtual Rider rider(int, const Vector3&) const { throw std::logic_error("a space without links"); }
  // Whether slopes() is implemented.
  virtual bool has_slopes() const { return false; }
  // Costs of edges and their derivatives, sampled at the given step; `rough` halves the work.
  virtual void slopes(const Chain&, double, bool, const ChainSlopes&) {}
  // Whether state_slopes() of moving states is implemented.
  virtual bool has_state_slopes() const { return false; }
  virtual void state_slopes(const MovingStates&, const StateSlopes&) {}
  // Whether there are moving entities. moving_slopes() adds their impact and its derivatives, gaps() computes the gap
  // between the robot and the nearest one, infinite unless below `wanted`.
  virtual bool has_moving() const { return false; }
  virtual void moving_slopes(const TimedStates&, const TimedSlopes&) {}
  virtual void gaps(const TimedProbes&, const GapSlopes&) {}
  // The measure over which the impact of a motion is integrated.
  virtual Measure measure() const { return Measure::kTime; }
  // If motion() is not the length: its density over length, at states whose `qd` is a tangent of the path.
  virtual void motion_slopes(const MovingStates&, const StateSlopes&) {}
  // Signed clearances and their gradients where the clearance is below `wanted`, infinite elsewhere; the bound makes
  // this much faster than exact distances everywhere.
  virtual void clearances(const Probes&, double*, double*) {}
  virtual double motion(const double* a, const double* b) { return distance(a, b); }
  // Whether motion() is the length, so that distances are lower bounds of the cost.
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
  // The cost of each edge of a chain; a single call where calls are expensive.
  virtual void costs(const Chain& of, double* out) {
    for (int e = 0; e < of.n_edge; ++e) out[e] = cost(of.points + e * dim, of.points + (e + 1) * dim);
  }
  // The cost, or infinity if a lower bound reaches `limit`: impact is non-negative and expensive to evaluate.
  double cost_below(const double* a, const double* b, double limit) {
    const double v = motion(a, b);
    if (v >= limit) return std::numeric_limits<double>::infinity();
    return w > 0 ? v + w * impact(a, b) : v;
  }
  // Estimated cost of an edge with a given mean impact.
  double guess(const double* a, const double* b, double mean_impact) const {
    return distance(a, b) + w * mean_impact * exposure(a, b);
  }
  double extent() const { return distance(lower.data(), upper.data()); }
  // Whether the edges between vertices `first` and `last` of a path are free; the cheap check runs on all edges first.
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

// Numbers of iterations and seconds that one call may use.
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
  // Evaluates n edges, starting with that from vertex `first`.
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

// Nodes in one array for linear scans, which are fastest up to some thousands of nodes.
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
  // Nearest node whose cost plus distance is below `cost_limit`; -1 if there is none.
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

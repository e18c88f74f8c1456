// The states at which the impact along straight edges is sampled, and the chain rule from derivatives at these states
// to derivatives at the ends of the edges.
#pragma once
#include "core.hpp"

namespace gp {

// Where edges are sampled. kExact: as edges() does. kBoth, kMean: at midpoints of pieces of at most a step, at both
// paces or at their mean. Alternating paces would not do for midpoints, since a descent would shorten the pieces at the
// worse pace.
enum class Sampling { kExact, kBoth, kMean };

struct EdgeSlopes {  // per edge: cost V and S, and the derivatives of S with respect to its ends
  double *cost, *d_q0, *d_q1;
};

// The caller fills in impact, d_q and d_qd of every state; integrate() then sums them up. An edge is travelled at a
// share (pace) of the velocity at which its slowest joint reaches its speed limit: qd = pace (q1 - q0) / T, T = max_j
// |q1_j - q0_j| / speed_j.
class EdgeStates {
 public:
  Point q, qd, impact, d_q, d_qd;  // rows

  EdgeStates(const Core& core, const double* speed, const double* pace, const Edges& edges, Sampling sampling)
      : dim_(size_t(core.tables().n_joint)),
        lanes_(core.lanes() / 2),
        speed_(speed),
        pace_(pace),
        q0_(edges.q0),
        q1_(edges.q1),
        sampling_(sampling) {
    for (size_t e = 0; e < edges.n; ++e) add_edge(q0_ + e * dim_, q1_ + e * dim_, edges.step);
    impact.resize(size()), d_q.resize(q.size()), d_qd.resize(q.size());
  }
  size_t size() const { return place_.size(); }

  States states() const { return {q.data(), qd.data(), size()}; }
  Slopes slopes() { return {impact.data(), d_q.data(), d_qd.data()}; }

  void integrate(const EdgeSlopes& out) const {
    size_t k = 0;
    for (size_t e = 0; e < edge_.size(); ++e) {
      const Edge& edge = edge_[e];
      double *by_a = out.d_q0 + e * dim_, *by_b = out.d_q1 + e * dim_, mean = 0;
      std::fill(by_a, by_a + dim_, 0.0), std::fill(by_b, by_b + dim_, 0.0);
      for (; k < edge.end; ++k) add_slopes(edge, k, by_a, by_b, mean);
      out.cost[2 * e] = edge.length, out.cost[2 * e + 1] = edge.length * mean;
      for (size_t j = 0; j < dim_; ++j) {
        const double along = edge.length > 0 ? (q1_[e * dim_ + j] - q0_[e * dim_ + j]) / edge.length * mean : 0.0;
        by_a[j] = edge.length * by_a[j] - along, by_b[j] = edge.length * by_b[j] + along;
      }
    }
  }

 private:
  struct Edge {
    double length, duration;
    size_t slowest, end;  // slowest: joint; end: one past the last state
  };
  struct Place {
    double along, weight, pace;
  };

  void add_edge(const double* a, const double* b, double step) {
    Edge edge{0, 0, 0, 0};
    for (size_t j = 0; j < dim_; ++j) {
      const double d = b[j] - a[j], seconds = std::abs(d) / speed_[j];
      edge.length += d * d;
      if (seconds > edge.duration) edge.duration = seconds, edge.slowest = j;
    }
    edge.length = std::sqrt(edge.length);
    if (edge.length > 0)
      sampling_ == Sampling::kExact ? add_trapezoid(edge, a, b, step) : add_midpoints(edge, a, b, step);
    edge.end = place_.size();
    edge_.push_back(edge);
  }
  void add_trapezoid(const Edge& edge, const double* a, const double* b, double step) {
    const int last = (int((edge.length / step + 1.0) / lanes_) + 1) * lanes_ - 1;  // as edge_cost in kernels.cpp
    for (int k = 0; k <= last; ++k)
      add_state(edge, a, b, double(k) / last, (k == 0 || k == last ? 0.5 : 1.0) / last, pace_[k % 2]);
  }
  void add_midpoints(const Edge& edge, const double* a, const double* b, double step) {
    const int pieces = int(std::ceil(edge.length / step));
    for (int k = 0; k < pieces; ++k) {
      const double middle = (k + 0.5) / pieces;
      if (sampling_ == Sampling::kMean)
        add_state(edge, a, b, middle, 1.0 / pieces, 0.5 * (pace_[0] + pace_[1]));
      else
        for (int fast = 0; fast < 2; ++fast) add_state(edge, a, b, middle, 0.5 / pieces, pace_[fast]);
    }
  }
  void add_state(const Edge& edge, const double* a, const double* b, double along, double weight, double pace) {
    place_.push_back({along, weight, pace});
    for (size_t j = 0; j < dim_; ++j) {
      q.push_back(a[j] + along * (b[j] - a[j]));
      qd.push_back(pace * (b[j] - a[j]) / edge.duration);
    }
  }
  // d qd / d delta = pace (1/T - delta dT/d delta / T^2), with delta = q1 - q0; only the slowest joint changes T.
  void add_slopes(const Edge& edge, size_t k, double* by_a, double* by_b, double& mean) const {
    const Place& at = place_[k];
    const double *by_q = d_q.data() + k * dim_, *by_qd = d_qd.data() + k * dim_, *rate = qd.data() + k * dim_;
    mean += at.weight * impact[k];
    double speeding = 0;
    for (size_t j = 0; j < dim_; ++j) speeding += by_qd[j] * rate[j];
    for (size_t j = 0; j < dim_; ++j) {
      double turn = at.pace * by_qd[j] / edge.duration;
      if (j == edge.slowest) turn -= speeding / edge.duration * (rate[j] < 0 ? -1.0 : 1.0) / speed_[j];
      by_a[j] += at.weight * ((1.0 - at.along) * by_q[j] - turn);
      by_b[j] += at.weight * (at.along * by_q[j] + turn);
    }
  }

  size_t dim_;
  int lanes_;
  const double *speed_, *pace_, *q0_, *q1_;
  Sampling sampling_;
  std::vector<Edge> edge_;
  std::vector<Place> place_;
};

}  // namespace gp

// Costs that depend on the configuration only; the terms of user-defined costs.
#pragma once
#include <algorithm>

#include "impact/impact.hpp"

namespace gp {

// Subclasses define the cost of states and its gradient; edges are integrated over length by the trapezoid rule.
class StateCost : public Impact {
 public:
  void states(const double* q, size_t n, double* impact) const override { charge(q, n, impact, nullptr); }
  void state_slopes(const States& of, bool, const Slopes& out) const override {
    charge(of.q, of.n, out.value, out.d_q);
    std::fill_n(out.d_qd, of.n * joints(), 0.0);
  }
  void edges(const Edges& of, double* cost) const override { integrate(of, {cost, nullptr, nullptr}); }
  bool has_gradients() const override { return true; }
  void edge_gradients(const Edges& of, Sampling, const EdgeSlopes& out) const override { integrate(of, out); }

 protected:
  explicit StateCost(const Core& core) : Impact(core) {}
  size_t joints() const { return size_t(core_.tables().n_joint); }
  // The value of each state and, unless `slope` is null, its gradient.
  virtual void charge(const double* q, size_t n, double* value, double* slope) const = 0;

 private:
  void integrate(const Edges& of, const EdgeSlopes& out) const {
    const size_t nq = joints();
    Point samples, length(of.n);
    std::vector<size_t> pieces(of.n);
    for (size_t e = 0; e < of.n; ++e) {
      const double *a = of.q0 + e * nq, *b = of.q1 + e * nq;
      length[e] = exposure(a, b);
      pieces[e] = std::max<size_t>(1, size_t(std::ceil(std::min(length[e] / of.step, kMaxSamples))));
      for (size_t k = 0; k <= pieces[e]; ++k)
        for (size_t j = 0; j < nq; ++j) samples.push_back(a[j] + (b[j] - a[j]) * double(k) / double(pieces[e]));
    }
    const size_t n = samples.size() / nq;
    Point value(n), slope(out.d_q0 ? samples.size() : 0);
    charge(samples.data(), n, value.data(), out.d_q0 ? slope.data() : nullptr);
    for (size_t e = 0, first = 0; e < of.n; first += pieces[e] + 1, ++e) {
      double mean = 0;
      if (out.d_q0) std::fill_n(out.d_q0 + e * nq, nq, 0.0), std::fill_n(out.d_q1 + e * nq, nq, 0.0);
      for (size_t k = 0; k <= pieces[e]; ++k) {
        const double share = (k == 0 || k == pieces[e] ? 0.5 : 1.0) / double(pieces[e]),
                     along = double(k) / double(pieces[e]);
        mean += share * value[first + k];
        for (size_t j = 0; out.d_q0 && j < nq; ++j) {
          const double d = share * length[e] * slope[(first + k) * nq + j];
          out.d_q0[e * nq + j] += (1 - along) * d, out.d_q1[e * nq + j] += along * d;
        }
      }
      out.cost[2 * e] = length[e], out.cost[2 * e + 1] = length[e] * mean;
      for (size_t j = 0; out.d_q0 && length[e] > 0 && j < nq; ++j) {
        const double d = mean * (of.q1[e * nq + j] - of.q0[e * nq + j]) / length[e];
        out.d_q0[e * nq + j] -= d, out.d_q1[e * nq + j] += d;
      }
    }
  }
};

// Cost of small clearance: max(0, 1 - clearance / distance). The clearance is that of another core, which has fewer
// obstacles than the core of the planner.
class ClearanceCost final : public StateCost {
 public:
  ClearanceCost(const Core& core, const Core& seen, double distance)
      : StateCost(core), seen_(seen), distance_(distance) {
    require(seen.tables().n_joint == core.tables().n_joint, "core of a different robot");
    require(in_range(distance, 1e-9, kMaxExtent), "distance");
  }

 protected:
  void charge(const double* q, size_t n, double* value, double* slope) const override {
    const size_t nq = joints();
    seen_.kernels().clearance(seen_.tables(), {q, nullptr, n}, distance_, value, slope);
    for (size_t k = 0; k < n; ++k) {
      value[k] = value[k] < distance_ ? 1 - value[k] / distance_ : 0.0;
      for (size_t j = 0; slope && j < nq; ++j) slope[k * nq + j] /= -distance_;
    }
  }

 private:
  const Core& seen_;
  const double distance_;
};

// A model times a factor; with SumImpact, it makes weighted sums.
class ScaledImpact final : public Impact {
 public:
  ScaledImpact(const Impact& model, double factor) : Impact(model.core()), model_(model), factor_(factor) {
    require(in_range(factor, 0), "factor");
  }
  void states(const double* q, size_t n, double* impact) const override {
    model_.states(q, n, impact), scale(impact, n);
  }
  void rough_states(const double* q, size_t n, double* impact) const override {
    model_.rough_states(q, n, impact), scale(impact, n);
  }
  void moving_states(const States& states, double* impact) const override {
    model_.moving_states(states, impact), scale(impact, states.n);
  }
  bool uses_velocity() const override { return model_.uses_velocity(); }
  void state_slopes(const States& of, bool rough, const Slopes& out) const override {
    const size_t size = of.n * size_t(core_.tables().n_joint);
    model_.state_slopes(of, rough, out);
    scale(out.value, of.n), scale(out.d_q, size), scale(out.d_qd, size);
  }
  void edges(const Edges& of, double* cost) const override {
    model_.edges(of, cost);
    for (size_t e = 0; e < of.n; ++e) cost[2 * e + 1] *= factor_;
  }
  void rough_edges(const Edges& of, double* cost) const override {
    model_.rough_edges(of, cost);
    for (size_t e = 0; e < of.n; ++e) cost[2 * e + 1] *= factor_;
  }
  bool has_gradients() const override { return model_.has_gradients(); }
  void edge_gradients(const Edges& of, Sampling sampling, const EdgeSlopes& out) const override {
    const size_t size = of.n * size_t(core_.tables().n_joint);
    model_.edge_gradients(of, sampling, out);
    for (size_t e = 0; e < of.n; ++e) out.cost[2 * e + 1] *= factor_;
    scale(out.d_q0, size), scale(out.d_q1, size);
  }

 private:
  void scale(double* values, size_t n) const {
    for (size_t i = 0; i < n; ++i) values[i] *= factor_;
  }

  const Impact& model_;
  const double factor_;
};

}  // namespace gp

// Costs of a user's own: Python is asked for whole batches, and the core does the rest.
#pragma once
#include <algorithm>
#include <utility>

#include "impact/impact.hpp"

namespace gp {

// Answers come from Python, which knows what they are integrated over:
//   states(q) -> [n], slopes(q, qd) -> ([n], [n, nq], [n, nq]), edges(q0, q1) -> [n, 2],
//   edge_slopes(q0, q1, step) -> ([n, 2], [n, nq], [n, nq]), motion(q, tangent) -> as slopes.
// Without edge_slopes and motion (None), edges have no gradients, and V is the length.
class OwnCost final : public Impact {
 public:
  struct Questions {
    nb::object states, slopes, edges, edge_slopes, motion;
  };

  // `speed`: where time counts, that of the joints along edges.
  OwnCost(const Core& core, Questions ask, Measure measure, Reals speed)
      : Impact(core), ask_(std::move(ask)), measure_(measure), speed_(point(speed)) {
    require(speed_.size() == size_t(core.tables().n_joint), "speed");
  }
  Measure measure() const override { return measure_; }
  bool in_python() const override { return true; }
  bool motion_is_length() const override { return ask_.motion.is_none(); }
  void states(const double* q, size_t n, double* impact) const override {
    nb::gil_scoped_acquire gil;
    copy_answer(ask_.states(rows(q, n)), n, impact);
  }
  void edges(const Edges& of, double* cost) const override {
    nb::gil_scoped_acquire gil;
    copy_answer(ask_.edges(rows(of.q0, of.n), rows(of.q1, of.n)), 2 * of.n, cost);
  }
  void state_slopes(const States& of, bool, const Slopes& out) const override { ask_slopes(ask_.slopes, of, out); }
  void motion_slopes(const States& of, const Slopes& out) const override { ask_slopes(ask_.motion, of, out); }
  bool has_gradients() const override { return !ask_.edge_slopes.is_none(); }
  void edge_gradients(const Edges& of, Sampling, const EdgeSlopes& out) const override {
    nb::gil_scoped_acquire gil;
    const nb::tuple answer =
        nb::cast<nb::tuple>(ask_.edge_slopes(rows(of.q0, of.n), rows(of.q1, of.n), std::min(of.step, kLongestStep)));
    copy_answer(answer[0], 2 * of.n, out.cost);
    copy_answer(answer[1], of.n * speed_.size(), out.d_q0), copy_answer(answer[2], of.n * speed_.size(), out.d_q1);
  }
  double exposure(const double* a, const double* b) const override {
    if (measure_ == Measure::kPoints) return 1.0;
    if (measure_ == Measure::kLength) return Impact::exposure(a, b);
    double seconds = 0;
    for (size_t j = 0; j < speed_.size(); ++j) seconds = std::max(seconds, std::abs(b[j] - a[j]) / speed_[j]);
    return seconds;
  }

 private:
  static constexpr double kLongestStep = 1.0;

  nb::object rows(const double* data, size_t n) const {
    double* copy;
    auto array = make<double>({n, speed_.size()}, copy);
    std::copy_n(data, n * speed_.size(), copy);
    return nb::cast(array);
  }
  static void copy_answer(const nb::handle& answer, size_t size, double* out) {
    const auto array = nb::cast<Reals>(answer);
    require(array.size() == size, "one answer for each that was asked for");
    std::copy_n(array.data(), size, out);
  }
  void ask_slopes(const nb::object& question, const States& of, const Slopes& out) const {
    nb::gil_scoped_acquire gil;
    const size_t size = of.n * speed_.size();
    const nb::tuple answer = nb::cast<nb::tuple>(question(rows(of.q, of.n), rows(of.qd, of.n)));
    copy_answer(answer[0], of.n, out.value), copy_answer(answer[1], size, out.d_q);
    copy_answer(answer[2], size, out.d_qd);
  }

  const Questions ask_;
  const Measure measure_;
  const Point speed_;
};

// How near a robot is to something: 1 - clearance / distance where that is positive, of the clearance that a core
// knows, which may be one with less to hit than the one that is planned with.
class ClearanceCost final : public Impact {
 public:
  ClearanceCost(const Core& core, double distance) : Impact(core), distance_(distance) {
    require(distance > 0, "distance");
  }
  void states(const double* q, size_t n, double* impact) const override { charge(q, n, impact, nullptr); }
  void state_slopes(const States& of, bool, const Slopes& out) const override {
    charge(of.q, of.n, out.value, out.d_q);
    std::fill_n(out.d_qd, of.n * joints(), 0.0);
  }
  void edges(const Edges& of, double* cost) const override { integrate(of, {cost, nullptr, nullptr}); }
  bool has_gradients() const override { return true; }
  void edge_gradients(const Edges& of, Sampling, const EdgeSlopes& out) const override { integrate(of, out); }

 private:
  size_t joints() const { return size_t(core_.tables().n_joint); }

  // The value and, unless it is null, its gradient; most states are far from everything, which is seen fast.
  void charge(const double* q, size_t n, double* value, double* slope) const {
    const size_t nq = joints();
    std::vector<uint8_t> free(n, 0);
    core_.kernels().free_states(core_.tables(), {q, nullptr, n}, distance_, free.data());
    std::fill_n(value, n, 0.0);
    if (slope) std::fill_n(slope, n * nq, 0.0);
    Point close;
    std::vector<size_t> row;
    for (size_t k = 0; k < n; ++k)
      if (!free[k]) row.push_back(k), close.insert(close.end(), q + k * nq, q + (k + 1) * nq);
    if (row.empty()) return;
    Point clearance(row.size()), gradient(slope ? close.size() : 0);
    core_.kernels().clearance(core_.tables(), {close.data(), nullptr, row.size()}, clearance.data(),
                              slope ? gradient.data() : nullptr);
    for (size_t i = 0; i < row.size(); ++i) {
      if (!(clearance[i] < distance_)) continue;
      value[row[i]] = 1 - clearance[i] / distance_;
      for (size_t j = 0; slope && j < nq; ++j) slope[row[i] * nq + j] = -gradient[i * nq + j] / distance_;
    }
  }

  // Trapezoid sums over length, and their derivatives if they are asked for.
  void integrate(const Edges& of, const EdgeSlopes& out) const {
    const size_t nq = joints();
    Point samples;
    std::vector<size_t> pieces(of.n);
    Point length(of.n);
    for (size_t e = 0; e < of.n; ++e) {
      const double *a = of.q0 + e * nq, *b = of.q1 + e * nq;
      length[e] = exposure(a, b), pieces[e] = std::max<size_t>(1, size_t(std::ceil(length[e] / of.step)));
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

  const double distance_;
};

}  // namespace gp

// User-defined costs: Python evaluates whole batches, the core does the rest.
#pragma once
#include <algorithm>
#include <utility>

#include "bindings/bindings.hpp"
#include "impact/impact.hpp"

namespace gp {

// The callbacks; Python decides what edges are integrated over:
//   states(q) -> [n], slopes(q, qd) -> ([n], [n, nq], [n, nq]), edges(q0, q1) -> [n, 2],
//   edge_slopes(q0, q1, step) -> ([n, 2], [n, nq], [n, nq]), motion(q, tangent) -> as slopes.
// If edge_slopes and motion are None, edges have no gradients, and V is the length.
class OwnCost final : public Impact {
 public:
  struct InterruptibleProblem {
    nb::object states, slopes, edges, edge_slopes, motion;
  };

  // `speed`: of the joints along edges, for integrals over time.
  OwnCost(const Core& core, InterruptibleProblem ask, Measure measure, Reals speed)
      : Impact(core), ask_(std::move(ask)), measure_(measure), speed_(point(speed)) {
    require_positive(speed, size_t(core.tables().n_joint), "speed");
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
  static constexpr double kLongestStep = 1.0;  // longest step of an edge that Python is asked for [rad or m]

  nb::object rows(const double* data, size_t n) const {
    double* copy;
    auto array = make<double>({n, speed_.size()}, copy);
    std::copy_n(data, n * speed_.size(), copy);
    return nb::cast(std::move(array));
  }
  static void copy_answer(const nb::handle& answer, size_t size, double* out) {
    const auto array = nb::cast<Given<double>>(answer);
    require(array.size() == size, "one value per requested state or edge");
    std::copy_n(array.data(), size, out);
  }
  void ask_slopes(const nb::object& question, const States& of, const Slopes& out) const {
    nb::gil_scoped_acquire gil;
    const size_t size = of.n * speed_.size();
    const nb::tuple answer = nb::cast<nb::tuple>(question(rows(of.q, of.n), rows(of.qd, of.n)));
    copy_answer(answer[0], of.n, out.value), copy_answer(answer[1], size, out.d_q);
    copy_answer(answer[2], size, out.d_qd);
  }

  const InterruptibleProblem ask_;
  const Measure measure_;
  const Point speed_;
};

}  // namespace gp

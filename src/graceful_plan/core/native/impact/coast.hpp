// What a base harms that fails while it drives, as an impact for planners.
#pragma once
#include "impact/coasting.hpp"
#include "impact/impact.hpp"

namespace gp {

class CoastModel {
 public:
  CoastModel(const Core& core, const CoastingArrays& of, const Integers& entity, const Reals& shape, int n_entity)
      : core_(core),
        coasting_(of),
        shape_(floor_shapes(entity, shape, nullptr, n_entity)),
        n_entity_(size_t(n_entity)) {
    require(core.tables().n_joint >= 3, "joints of a base");
    require(n_entity >= 0 && n_entity <= kMaxEntities, "number of entities");
  }

  const Core& core() const { return core_; }
  size_t n_entity() const { return n_entity_; }
  Coasting::Work work() const { return {coasting_, n_entity_}; }

  // P by entity.
  auto probability(Reals q, Reals qd) const {
    double* out;
    auto array = make<double>({core_.rows(q), n_entity_}, out);
    const States states = core_.states(q, qd);
    nb::gil_scoped_release release;
    const size_t nq = size_t(core_.tables().n_joint);
    Coasting::Work work = this->work();
    for (size_t i = 0; i < states.n; ++i) {
      hits(states.q + i * nq, states.qd + i * nq, nullptr, work);
      out = std::copy(work.hit.begin(), work.hit.end(), out);
    }
    return array;
  }
  // P that somebody is met who is there when the base fails, and goes on as now.
  struct Encounter {
    Coasting::Work work;
    std::vector<FloorShape> shape;
  };
  Encounter encounter() const { return {{coasting_, n_entity_ + 1}, shape_}; }
  double met(const Coasting::State& at, const FloorShape& who, Encounter& with, Coasting::Focus* focus) const {
    if (!coasting_.reaches(at, who)) return 0;
    with.shape.push_back(who);
    const bool hit = coasting_.hits(at, with.shape, nullptr, with.work, int(n_entity_), focus);
    with.shape.pop_back();
    return hit ? with.work.hit[n_entity_] : 0.0;
  }
  Coasting::State state(const double* q, const double* qd) const {
    return {q[0], q[1], q[2], qd[0] * std::cos(q[2]) + qd[1] * std::sin(q[2]), qd[2]};
  }
  // Adds the derivatives of something by the state of the base, whose value there is known, by differences.
  template <class Value>
  static void add_slopes(const double* q, const double* qd, const Coasting::State& at, double known, Value value,
                         double* d_q, double* d_qd) {
    const auto slope = [&](double Coasting::State::* of) {
      Coasting::State moved = at;
      moved.*of += kNudge;
      return (value(moved) - known) / kNudge;
    };
    // Those at the same velocities first: tables are looked up once for all of them.
    d_q[0] += slope(&Coasting::State::x), d_q[1] += slope(&Coasting::State::y), d_q[2] += slope(&Coasting::State::yaw);
    const double by_speed = slope(&Coasting::State::v), c = std::cos(q[2]), s = std::sin(q[2]);
    d_q[2] += by_speed * (c * qd[1] - s * qd[0]);
    d_qd[0] += by_speed * c, d_qd[1] += by_speed * s, d_qd[2] += slope(&Coasting::State::omega);
  }
  static constexpr double kNudge = 1e-4;  // of a difference [m, rad, m/s, rad/s, s]
  bool hits(const Coasting::State& at, const double* severity, Coasting::Work& work) const {
    return coasting_.hits(at, shape_, severity, work);
  }
  bool hits(const double* q, const double* qd, const double* severity, Coasting::Work& work) const {
    return coasting_.hits(state(q, qd), shape_, severity, work);
  }

 private:
  const Core& core_;
  const Coasting coasting_;
  const std::vector<FloorShape> shape_;
  const size_t n_entity_;
};

// The coast model with severities; along edges at their mean pace.
class CoastImpact final : public Impact {
 public:
  CoastImpact(const CoastModel& model, Reals severity, Reals speed, double slow, double fast)
      : Impact(model.core(), severity), model_(model), speed_(point(speed)), pace_{slow, fast} {
    require(severity_.size() == model.n_entity(), "severity of each entity");
    require_positive(speed, size_t(core_.tables().n_joint), "speed of each joint");
    require(slow >= 0 && fast >= slow && fast < 1e9, "pace");
  }
  void states(const double*, size_t n, double* impact) const override { std::fill_n(impact, n, 0.0); }  // at rest
  void moving_states(const States& states, double* impact) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    Coasting::Work work = model_.work();
    for (size_t i = 0; i < states.n; ++i) {
      impact[i] = 0;
      if (!model_.hits(states.q + i * nq, states.qd + i * nq, severity_.data(), work)) continue;
      for (size_t e = 0; e < severity_.size(); ++e) impact[i] += severity_[e] * work.hit[e];
    }
  }
  bool asks_for_velocity() const override { return true; }
  void state_slopes(const States& states, bool, const Slopes& out) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    Coasting::Work work = model_.work();
    std::fill_n(out.d_q, states.n * nq, 0.0), std::fill_n(out.d_qd, states.n * nq, 0.0);
    const auto value = [&](const Coasting::State& at) {
      double sum = 0;
      if (model_.hits(at, severity_.data(), work))
        for (size_t e = 0; e < severity_.size(); ++e) sum += severity_[e] * work.hit[e];
      return sum;
    };
    for (size_t i = 0; i < states.n; ++i) {
      const double *q = states.q + i * nq, *qd = states.qd + i * nq;
      const Coasting::State at = model_.state(q, qd);
      out.value[i] = value(at);
      CoastModel::add_slopes(q, qd, at, out.value[i], value, out.d_q + i * nq, out.d_qd + i * nq);
    }
  }
  void edges(const Edges& edges, double* cost) const override {
    EdgeStates sampled(core_, speed_.data(), pace_, {edges.q0, edges.q1, edges.n, std::max(edges.step, kStep)},
                       Sampling::kMean);
    moving_states(sampled.states(), sampled.impact.data());
    Point slopes(2 * edges.n * size_t(core_.tables().n_joint));
    sampled.integrate({cost, slopes.data(), slopes.data() + slopes.size() / 2});
  }

 private:
  static constexpr double kStep = 0.1;  // between samples of an edge, which blur as far [m or rad]

  const CoastModel& model_;
  const Point speed_;
  const double pace_[2];
};

}  // namespace gp

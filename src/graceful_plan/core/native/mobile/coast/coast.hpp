// Impact of a base that fails while driving, for planners.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "mobile/coast/coasting.hpp"
#include "impact/impact.hpp"

namespace gp {

class CoastModel {
 public:
  CoastModel(const Core& core, const CoastingArrays& of, const Integers& entity, const Reals& shape, int n_entity)
      : core_(core),
        coasting_(of, core.isa()),
        shape_(floor_shapes(entity, shape, nullptr, n_entity)),
        n_entity_(size_t(n_entity)) {
    require(core.tables().n_joint >= 3, "joints of a base");
    require(n_entity >= 0 && n_entity <= kMaxEntities, "number of entities");
  }

  const Core& core() const { return core_; }
  size_t n_entity() const { return n_entity_; }
  Coasting::Work work() const { return coasting_.work(n_entity_); }

  // P by entity.
  auto probability(Reals q, Reals qd) const {
    double* out;
    auto array = make<double>({core_.rows(q), n_entity_}, out);
    const States states = core_.states(q, qd);
    const size_t nq = size_t(core_.tables().n_joint);
    Coasting::Work work = this->work();
    for (size_t i = 0; i < states.n; ++i) {
      hits(states.q + i * nq, states.qd + i * nq, nullptr, work);
      out = std::copy(work.hit.begin(), work.hit.end(), out);
    }
    return array;
  }
  // P of hitting one additional entity `who`, which moves on at its current velocity after the failure.
  struct Encounter {
    Coasting::Work work;
    std::vector<FloorShape> shape;
  };
  Encounter encounter() const { return {coasting_.work(n_entity_ + 1), shape_}; }
  double met(const double* q, const double* qd, const FloorShape& who, Encounter& with) const {
    return meets(state(q, qd), who, with) ? with.work.hit[n_entity_] : 0.0;
  }
  // As `met`, with derivatives with respect to x, y, heading, speed along the heading, turning rate, and time.
  Dual met_slopes(const double* q, const double* qd, const FloorShape& who, Encounter& with) const {
    CoastState<Dual> at = slopes(q, qd);
    at.time = Dual::variable(0.0, 5);
    return meets(at, who, with) ? with.work.hit_slopes[n_entity_] : Dual(0.0);
  }
  bool hits(const double* q, const double* qd, const double* severity, Coasting::Work& work) const {
    return coasting_.hits(state(q, qd), shape_, severity, work);
  }
  // As `hits`, with derivatives with respect to x, y, heading, speed along the heading and turning rate.
  bool hits_slopes(const double* q, const double* qd, const double* severity, Coasting::Work& work) const {
    return coasting_.hits(slopes(q, qd), shape_, severity, work);
  }
  // Adds derivatives with respect to the joints of the base to d_q and d_qd. `of` has the derivatives with respect to
  // x, y, heading, speed along the heading and turning rate.
  static void add_slopes(const Dual& of, const double* q, const double* qd, double* d_q, double* d_qd) {
    const double c = std::cos(q[2]), s = std::sin(q[2]), by_speed = of.slope(3);
    for (int j = 0; j < 3; ++j) d_q[j] += of.slope(j);
    d_q[2] += by_speed * (qd[1] * c - qd[0] * s);
    d_qd[0] += by_speed * c, d_qd[1] += by_speed * s, d_qd[2] += of.slope(4);
  }

 private:
  static Coasting::State state(const double* q, const double* qd) { return {q[0], q[1], q[2], speed(q, qd), qd[2]}; }
  static CoastState<Dual> slopes(const double* q, const double* qd) {
    return {Dual::variable(q[0], 0), Dual::variable(q[1], 1), Dual::variable(q[2], 2), Dual::variable(speed(q, qd), 3),
            Dual::variable(qd[2], 4)};
  }
  template <class T> bool meets(const CoastState<T>& at, const FloorShape& who, Encounter& with) const {
    const Coasting::State value{value_of(at.x), value_of(at.y), value_of(at.yaw), value_of(at.v), value_of(at.omega)};
    if (!coasting_.reaches(value, who)) return false;
    with.shape.push_back(who);
    const bool hit = coasting_.hits(at, with.shape, nullptr, with.work, int(n_entity_));
    with.shape.pop_back();
    return hit;
  }
  static double speed(const double* q, const double* qd) { return qd[0] * std::cos(q[2]) + qd[1] * std::sin(q[2]); }

  const Core& core_;
  const Coasting coasting_;
  const std::vector<FloorShape> shape_;
  const size_t n_entity_;
};

// The coast model with severities, and a cheaper one with fewer stopping modes; edges are evaluated at their mean pace.
class CoastImpact final : public Impact {
 public:
  CoastImpact(const CoastModel& model, const CoastModel& rough, Reals severity, Reals speed, double slow, double fast)
      : Impact(model.core(), severity), model_(model), rough_(rough), speed_(point(speed)), pace_{slow, fast} {
    for (const CoastModel* one : {&model, &rough})
      require(severity_.size() == one->n_entity(), "severity of each entity");
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
  bool uses_velocity() const override { return true; }
  void state_slopes(const States& states, bool rough, const Slopes& out) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    const CoastModel& model = rough ? rough_ : model_;
    Coasting::Work work = model.work();
    std::fill_n(out.d_q, states.n * nq, 0.0), std::fill_n(out.d_qd, states.n * nq, 0.0);
    for (size_t i = 0; i < states.n; ++i) {
      out.value[i] = 0;
      const double *q = states.q + i * nq, *qd = states.qd + i * nq;
      if (!model.hits_slopes(q, qd, severity_.data(), work)) continue;
      Dual sum(0.0);
      for (size_t e = 0; e < severity_.size(); ++e) sum += severity_[e] * work.hit_slopes[e];
      out.value[i] = sum.value();
      CoastModel::add_slopes(sum, q, qd, out.d_q + i * nq, out.d_qd + i * nq);
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
  static constexpr double kStep = 0.1;  // between samples of an edge; they are blurred over this distance [m or rad]

  const CoastModel &model_, &rough_;
  const Point speed_;
  const double pace_[2];
};

}  // namespace gp

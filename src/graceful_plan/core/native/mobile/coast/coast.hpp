// Impact of a base that fails while driving, for planners: of the base, and of an object that its arm carries.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "mobile/coast/coasting.hpp"
#include "impact/impact.hpp"

namespace gp {

// A carried object: the box around its parts in the frame of its link, and the shapes that it may hit, at all heights.
class CarriedBox {
 public:
  // component: of the object among those of the core; without parts of it, nothing is carried.
  CarriedBox(const Core& core, int component, const Integers& entity, const Reals& shape, const Reals& height,
             int n_entity)
      : core_(core), shape_(floor_shapes(entity, shape, nullptr, n_entity)) {
    require_numbers(height, 2 * shape_.size(), "heights of shapes around a carried object", 2 * kMaxExtent);
    for (size_t k = 0; k < shape_.size(); ++k) height_.push_back({height.data()[2 * k], height.data()[2 * k + 1]});
    double low[3], high[3];
    std::fill_n(low, 3, kMaxExtent), std::fill_n(high, 3, -kMaxExtent);
    for (int k = 0; k < core.tables().n_part; ++k) {
      const Part& part = core.tables().part[k];
      if (part.component != component || (frame_ >= 0 && part.frame != frame_)) continue;
      frame_ = part.frame;
      for (int i = 0; i < 3; ++i) {
        double reach = 0;
        for (int j = 0; j < 3; ++j) reach += std::fabs(part.R[3 * i + j]) * part.half[j];
        low[i] = std::min(low[i], part.p[i] - reach), high[i] = std::max(high[i], part.p[i] + reach);
      }
    }
    for (int i = 0; i < 3; ++i) centre_[i] = 0.5 * (low[i] + high[i]), half_[i] = 0.5 * (high[i] - low[i]);
  }
  bool is_carried() const { return frame_ >= 0; }

  // The object in a configuration: a disc in the frame of the base, whose radius is the root mean square of the half
  // widths of the box, and the shapes at its height.
  struct Seen {
    Ride ride;
    double along = 0, across = 0;
    std::vector<FloorShape> shape;
    Footprint2d disc{std::vector<FloorShape>{}};
  };
  void see(const double* q, Seen& out) const {
    core_.ride(q, 1, frame_, centre_, &out.ride);
    const double c = std::cos(q[2]), s = std::sin(q[2]), dx = out.ride.p[0] - q[0], dy = out.ride.p[1] - q[1];
    out.along = c * dx + s * dy, out.across = c * dy - s * dx;
    double squared = 0, high = 0;
    for (int k = 0; k < 3; ++k) {
      squared += 0.5 * half_[k] * half_[k] * (1 - out.ride.R[6 + k] * out.ride.R[6 + k]);
      high += std::fabs(out.ride.R[6 + k]) * half_[k];
    }
    out.disc = Footprint2d(std::vector<FloorShape>{{-1, 0, 0, 1, 0, 0, 0, std::sqrt(std::max(0.0, squared)), 0, 0}});
    out.shape.clear();
    for (size_t k = 0; k < shape_.size(); ++k)
      if (height_[k][0] < out.ride.p[2] + high && height_[k][1] > out.ride.p[2] - high) out.shape.push_back(shape_[k]);
  }

 private:
  const Core& core_;
  const std::vector<FloorShape> shape_;
  std::vector<std::array<double, 2>> height_;  // bottom and top of each shape
  int frame_ = -1;
  double centre_[3], half_[3];
};

class CoastModel {
 public:
  CoastModel(const Core& core, const CoastingArrays& of, const Integers& entity, const Reals& shape, int n_entity,
             CarriedBox carried)
      : core_(core),
        coasting_(of, core.isa()),
        shape_(floor_shapes(entity, shape, nullptr, n_entity)),
        n_entity_(size_t(n_entity)),
        carried_(std::move(carried)) {
    require(core.tables().n_joint >= 3, "joints of a base");
    require(n_entity >= 0 && n_entity <= kMaxEntities, "number of entities");
  }

  const Core& core() const { return core_; }
  size_t n_entity() const { return n_entity_; }
  Coasting::Work work() const { return coasting_.work(n_entity_); }

  // P by entity, of the base and of the object that it carries.
  auto probability(Reals q, Reals qd) const {
    double* out;
    auto array = make<double>({core_.rows(q), 2, n_entity_}, out);
    const States states = core_.states(q, qd);
    const size_t nq = size_t(core_.tables().n_joint);
    Coasting::Work work = this->work();
    CarriedBox::Seen seen;
    for (size_t i = 0; i < states.n; ++i) {
      const double *at = states.q + i * nq, *speed = states.qd + i * nq;
      hits(at, speed, nullptr, work);
      out = std::copy(work.hit.begin(), work.hit.end(), out);
      std::fill(work.hit.begin(), work.hit.end(), 0.0);
      carried_hits(at, speed, nullptr, seen, work);
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
    return coasting_.hits(state(q, qd), shape_, {severity}, work);
  }
  // As `hits`, with derivatives with respect to x, y, heading, speed along the heading and turning rate.
  bool hits_slopes(const double* q, const double* qd, const double* severity, Coasting::Work& work) const {
    return coasting_.hits(slopes(q, qd), shape_, {severity}, work);
  }
  // As `hits`, for the carried object, which harms in full at any speed.
  bool carried_hits(const double* q, const double* qd, const double* severity, CarriedBox::Seen& seen,
                    Coasting::Work& work) const {
    if (!swings(q, qd)) return false;
    carried_.see(q, seen);
    Coasting::State at = state(q, qd);
    at.along = seen.along, at.across = seen.across;
    return coasting_.hits(at, seen.shape, {severity, -1, &seen.disc}, work);
  }
  // As `carried_hits`, with derivatives with respect to x, y, heading, speed along the heading, turning rate, and the
  // place of the object in the frame of the base.
  bool carried_slopes(const double* q, const double* qd, const double* severity, CarriedBox::Seen& seen,
                      Coasting::Work& work) const {
    if (!swings(q, qd)) return false;
    carried_.see(q, seen);
    CoastState<Dual> at = slopes(q, qd);
    at.along = Dual::variable(seen.along, 5), at.across = Dual::variable(seen.across, 6);
    return coasting_.hits(at, seen.shape, {severity, -1, &seen.disc}, work);
  }
  // Adds derivatives with respect to the joints of the arm to d_q.
  static void add_arm_slopes(const Dual& of, const double* q, const Ride& ride, size_t nq, double* d_q) {
    const double c = std::cos(q[2]), s = std::sin(q[2]);
    const double by_x = of.slope(5) * c - of.slope(6) * s, by_y = of.slope(5) * s + of.slope(6) * c;
    for (size_t j = 3; j < nq; ++j) d_q[j] += by_x * ride.J[j] + by_y * ride.J[nq + j];
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
    const bool hit = coasting_.hits(at, with.shape, {nullptr, int(n_entity_)}, with.work);
    with.shape.pop_back();
    return hit;
  }
  bool swings(const double* q, const double* qd) const {
    return carried_.is_carried() && (std::fabs(speed(q, qd)) > CoastTables::kStandstill || qd[2] != 0);
  }
  static double speed(const double* q, const double* qd) { return qd[0] * std::cos(q[2]) + qd[1] * std::sin(q[2]); }

  const Core& core_;
  const Coasting coasting_;
  const std::vector<FloorShape> shape_;
  const size_t n_entity_;
  const CarriedBox carried_;
};

// The coast model with severities, and a cheaper one with fewer stopping modes; edges are evaluated at their mean pace.
class CoastImpact final : public Impact {
 public:
  // severity: of hits by the base, then of those by the carried object.
  CoastImpact(const CoastModel& model, const CoastModel& rough, Reals severity, Reals speed, double slow, double fast)
      : Impact(model.core(), severity), model_(model), rough_(rough), speed_(point(speed)), pace_{slow, fast} {
    for (const CoastModel* one : {&model, &rough})
      require(severity_.size() == 2 * one->n_entity(), "severity of each entity for base and carried object");
    require_positive(speed, size_t(core_.tables().n_joint), "speed of each joint");
    require(slow >= 0 && fast >= slow && fast < 1e9, "pace");
    for (size_t e = 0; e < model.n_entity(); ++e) swings_ |= carried()[e] > 0;
  }
  void states(const double*, size_t n, double* impact) const override { std::fill_n(impact, n, 0.0); }  // at rest
  void moving_states(const States& states, double* impact) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    Coasting::Work work = model_.work();
    CarriedBox::Seen seen;
    for (size_t i = 0; i < states.n; ++i) {
      const double *q = states.q + i * nq, *qd = states.qd + i * nq;
      impact[i] = 0;
      if (model_.hits(q, qd, severity_.data(), work)) impact[i] += sum(severity_.data(), work.hit);
      if (swings_ && model_.carried_hits(q, qd, carried(), seen, work)) impact[i] += sum(carried(), work.hit);
    }
  }
  bool uses_velocity() const override { return true; }
  void state_slopes(const States& states, bool rough, const Slopes& out) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    const CoastModel& model = rough ? rough_ : model_;
    Coasting::Work work = model.work();
    CarriedBox::Seen seen;
    std::fill_n(out.d_q, states.n * nq, 0.0), std::fill_n(out.d_qd, states.n * nq, 0.0);
    for (size_t i = 0; i < states.n; ++i) {
      out.value[i] = 0;
      const double *q = states.q + i * nq, *qd = states.qd + i * nq;
      double *d_q = out.d_q + i * nq, *d_qd = out.d_qd + i * nq;
      if (model.hits_slopes(q, qd, severity_.data(), work)) {
        const Dual total = sum(severity_.data(), work.hit_slopes);
        out.value[i] += total.value();
        CoastModel::add_slopes(total, q, qd, d_q, d_qd);
      }
      if (swings_ && model.carried_slopes(q, qd, carried(), seen, work)) {
        const Dual total = sum(carried(), work.hit_slopes);
        out.value[i] += total.value();
        CoastModel::add_slopes(total, q, qd, d_q, d_qd);
        CoastModel::add_arm_slopes(total, q, seen.ride, nq, d_q);
      }
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
  const double* carried() const { return severity_.data() + severity_.size() / 2; }
  template <class T> static T sum(const double* severity, const std::vector<T>& hit) {
    T total(0.0);
    for (size_t e = 0; e < hit.size(); ++e) total += severity[e] * hit[e];
    return total;
  }

  static constexpr double kStep = 0.1;  // between samples of an edge; they are blurred over this distance [m or rad]

  const CoastModel &model_, &rough_;
  const Point speed_;
  const double pace_[2];
  bool swings_ = false;  // whether hits by the carried object harm
};

}  // namespace gp

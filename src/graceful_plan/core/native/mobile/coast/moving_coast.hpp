// Moving entities that a base hits when it fails while driving; they continue at their velocity at the failure.
#pragma once
#include "impact/moving/moving_impact.hpp"
#include "mobile/coast/coast.hpp"

namespace gp {

class MovingCoast final : public MovingSource {
 public:
  // bottom, top: range of heights of the base's footprint.
  MovingCoast(const MovingTable& table, const CoastModel& model, double bottom, double top)
      : MovingSource(model.core(), table), model_(model), bottom_(bottom), top_(top) {
    require(in_range(bottom, -kMaxExtent, top) && top <= kMaxExtent, "heights of a base");
  }
  void probability(const States& states, const double* t, const double* severity, double* out) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    CoastModel::Encounter encounter = model_.encounter();
    for (size_t i = 0; i < states.n; ++i) {
      const double *q = states.q + i * nq, *qd = states.qd + i * nq;
      for (size_t e = 0; e < table_.size(); ++e, ++out) {
        *out = 0;
        if (severity && severity[e] == 0) continue;
        const MovingEntity& entity = table_.paths().entity[e];
        if (t) {
          *out = met(q, qd, entity, t[i], encounter);
          continue;
        }
        for (int k = 0; k < entity.n_time; ++k) *out += met(q, qd, entity, entity.time[k], encounter) / entity.n_time;
      }
    }
  }
  void slopes(const States& states, const double* t, const double* severity, const MovingSlopes& out) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    CoastModel::Encounter encounter = model_.encounter();
    for (size_t i = 0; i < states.n; ++i) {
      const double *q = states.q + i * nq, *qd = states.qd + i * nq;
      for (size_t e = 0; e < table_.size(); ++e) {
        FloorShape who;
        if (severity[e] == 0 || !seen(table_.paths().entity[e], t[i], who)) continue;
        const Dual P = severity[e] * model_.met_slopes(q, qd, who, encounter);
        out.value[i] += P.value(), out.d_t[i] += P.slope(5);
        CoastModel::add_slopes(P, q, qd, out.d_q + i * nq, out.d_qd + i * nq);
      }
    }
  }

 private:
  static constexpr double kSoon = 1e-3;  // interval of the finite difference for velocities [s]

  double met(const double* q, const double* qd, const MovingEntity& e, double t,
             CoastModel::Encounter& encounter) const {
    FloorShape who;
    return seen(e, t, who) ? model_.met(q, qd, who, encounter) : 0.0;
  }
  // Whether an entity is at the height of the base at a time; `who` is then its planar shape.
  bool seen(const MovingEntity& e, double t, FloorShape& who) const {
    const MovingTable::Place here = table_.at(e, t), soon = table_.at(e, t + kSoon);
    if (here.z - e.half[2] >= top_ || here.z + e.half[2] <= bottom_) return false;
    who = {int(model_.n_entity()),
           here.x,
           here.y,
           std::cos(here.yaw),
           std::sin(here.yaw),
           e.round ? 0.0 : e.half[0],
           e.round ? 0.0 : e.half[1],
           e.round ? e.half[0] : 0.0,
           (soon.x - here.x) / kSoon,
           (soon.y - here.y) / kSoon,
           here.spread};
    return true;
  }

  const CoastModel& model_;
  const double bottom_, top_;
};

}  // namespace gp

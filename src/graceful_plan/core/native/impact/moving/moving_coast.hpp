// Whom of those who move a base meets that fails while it drives: who goes on at the velocity of that moment.
#pragma once
#include "impact/coast.hpp"
#include "impact/moving/moving_impact.hpp"

namespace gp {

class MovingCoast final : public MovingSource {
 public:
  // bottom, top: heights between which the base meets anything.
  MovingCoast(const MovingTable& table, const CoastModel& model, double bottom, double top)
      : MovingSource(model.core(), table), model_(model), bottom_(bottom), top_(top) {
    require(in_range(bottom, -kMaxExtent, top) && top <= kMaxExtent, "heights of a base");
  }
  void probability(const States& states, const double* t, const double* severity, double* out) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    CoastModel::Encounter encounter = model_.encounter();
    for (size_t i = 0; i < states.n; ++i) {
      const Coasting::State at = model_.state(states.q + i * nq, states.qd + i * nq);
      for (size_t e = 0; e < table_.size(); ++e, ++out) {
        *out = 0;
        if (severity && severity[e] == 0) continue;
        const MovingEntity& entity = table_.paths().entity[e];
        if (t) {
          *out = met(at, entity, t[i], encounter, nullptr);
          continue;
        }
        for (int k = 0; k < entity.n_time; ++k)
          *out += met(at, entity, entity.time[k], encounter, nullptr) / entity.n_time;
      }
    }
  }
  // By differences, of those who may be hit at all: between places that decide P, which stay the same nearby.
  void slopes(const States& states, const double* t, const double* severity, const MovingSlopes& out) const override {
    const size_t nq = size_t(core_.tables().n_joint);
    CoastModel::Encounter encounter = model_.encounter();
    Coasting::Focus focus;
    for (size_t i = 0; i < states.n; ++i) {
      const double *q = states.q + i * nq, *qd = states.qd + i * nq;
      const Coasting::State at = model_.state(q, qd);
      for (size_t e = 0; e < table_.size(); ++e) {
        if (severity[e] == 0) continue;
        const MovingEntity& entity = table_.paths().entity[e];
        focus.known = false;
        const double P = met(at, entity, t[i], encounter, &focus);
        focus.known = true;
        out.value[i] += severity[e] * P;
        if (!(P > kHardly)) continue;
        const auto value = [&](const Coasting::State& moved, double later = 0) {
          return severity[e] * met(moved, entity, t[i] + later, encounter, &focus);
        };
        out.d_t[i] += (value(at, CoastModel::kNudge) - severity[e] * P) / CoastModel::kNudge;
        CoastModel::add_slopes(q, qd, at, severity[e] * P, value, out.d_q + i * nq, out.d_qd + i * nq);
      }
    }
  }

 private:
  static constexpr double kSoon = 1e-3;    // over which a velocity is looked at [s]
  static constexpr double kHardly = 1e-6;  // P below which nobody is hit

  double met(const Coasting::State& at, const MovingEntity& e, double t, CoastModel::Encounter& encounter,
             Coasting::Focus* focus) const {
    const MovingTable::Place here = table_.at(e, t), soon = table_.at(e, t + kSoon);
    if (here.z - e.half[2] >= top_ || here.z + e.half[2] <= bottom_) return 0;
    FloorShape who{int(model_.n_entity()),
                   here.x,
                   here.y,
                   std::cos(here.yaw),
                   std::sin(here.yaw),
                   0,
                   0,
                   0,
                   (soon.x - here.x) / kSoon,
                   (soon.y - here.y) / kSoon,
                   here.spread};
    if (e.round)
      who.round = e.half[0];
    else
      who.a = e.half[0], who.b = e.half[1];
    return model_.met(at, who, encounter, focus);
  }

  const CoastModel& model_;
  const double bottom_, top_;
};

}  // namespace gp

// The drop and spill models together: probabilities, impact, and the gradient of the impact.
#pragma once
#include <cstddef>

#include "cutoffs.hpp"
#include "geometry/kinematics.hpp"
#include "impact/contents/spill.hpp"
#include "impact/contents/spill_gradient.hpp"
#include "impact/contents/stop.hpp"
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/entity_damage.hpp"
#include "impact/flight/flight.hpp"
#include "impact/flight/flight_gradient.hpp"
#include "impact/learned/network.hpp"
#include "impact/learned/network_gradient.hpp"
#include "impact/own_loss.hpp"
#include "impact/own_loss_gradient.hpp"
#include "impact/tumble_gradient.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// --- values ---------------------------------------------------------------------------------------------------------

static inline bool matters(const DropTables& drop, const double* severity) {
  for (int e = 0; e < drop.n_entity; ++e)
    if (severity[e] != 0.0) return true;
  return false;
}

// Whether the robot moves and its stops may spill contents.
template <class V> static inline bool stops(const DropTables& drop, const V* qd) { return drop.stop.spread > 0 && qd; }

// Whether damage to the object itself counts; its severity comes last.
static inline bool own_matters(const DropTables& drop, const double* severity) {
  return drop.loss.sharpness > 0 && (!severity || severity[kDropRows * drop.n_entity] != 0.0);
}

// Visits every surface of an entity with the probabilities of its hits, before the network corrects them.
template <class V, class Visit>
static inline void for_each_hit(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing,
                                Visit visit) {
  Tumble<V> tumble(drop, flight, landing);
  const Sweep<V> sweep(drop, flight, landing);
  const Leaving<V> leaving(drop, landing);
  const SideImpact<V> brunt(flight, landing);
  V lower = landing.landed;
  for (int l = 0; l < drop.n_level; ++l) {
    const bool tumbles = tumble.enter(drop);
    for (int k = drop.level_start[l]; k < drop.level_start[l + 1]; ++k) {
      const Surface& s = drop.surface[k];
      const V C = landing.contact[k], G = tumbles ? tumble.hit(s, true) : V{};
      const V H = maximum(sweep.hit(drop, flight, s, landing.time[k], relu(lower - C)), brunt.on(flight, k));
      if (s.entity >= 0) visit(k, leaving, Hits<V>{C, G, H}, lower);
    }
    tumble.leave(drop, landing, l);
    lower -= landing.first[l];
  }
}

// Computes P of entities; returns P that the object itself is damaged, if that counts.
template <class V>
static inline V carried_probability(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing,
                                    const double* severity, V* P) {
  const bool own = own_matters(drop, severity);
  OwnLoss<V> loss;
  Tumble<V> tumble(drop, flight, landing);
  const Sweep<V> sweep(drop, flight, landing);
  const Leaving<V> leaving(drop, landing);
  const SideImpact<V> brunt(flight, landing);
  V lower = landing.landed;  // sum of F over this level and all lower ones
  V F[kMaxEntities];         // P that the first impact is on the entity
  for (int e = 0; e < drop.n_entity; ++e) F[e] = V{};
  for (int l = 0; l < drop.n_level; ++l) {
    const bool tumbles = tumble.enter(drop), sweeps = any(lower > kNothing<V>);
    if (own && tumbles) loss.enter(tumble);
    for (int k = drop.level_start[l]; k < drop.level_start[l + 1]; ++k) {
      const Surface& s = drop.surface[k];
      const bool wanted = s.entity >= 0 && !(severity && severity[s.entity] == 0.0);
      const V G = tumbles ? tumble.hit(s, wanted) : V{}, C = landing.contact[k];
      if (own && tumbles) loss.end(drop, s, tumble);
      if (!wanted) continue;
      V H = brunt.on(flight, k);
      if (sweeps) H = maximum(H, sweep.hit(drop, flight, s, landing.time[k], relu(lower - C)));
      F[s.entity] += landing.share[l] * landing.overlap[k];
      P[s.entity] = maximum(P[s.entity], hit_of(drop, flight, landing, leaving, k, {C, G, H}, lower));
    }
    tumble.leave(drop, landing, l);
    if (own) loss.leave(drop, landing, l, tumble, first_damage(drop, flight, landing, l));
    lower -= landing.first[l];
  }
  for (int e = 0; e < drop.n_entity; ++e) P[e] = maximum(P[e], F[e]);
  hits_to_damage(drop, flight, P);
  return probable(loss.probability);
}

// P [kDropRows, n_entity] of entities, then P that the object itself is damaged. If severities are given, entities
// without severity stay at 0.
template <class V>
static inline void drop_probability(const Tables& tables, const DropTables& drop, const double* severity, const V* q,
                                    const V* qd, V* P) {
  const Fall<V> fall(tables, drop, q, qd);
  const auto& [X_W, flight, landing] = fall;
  const int itself = kDropRows * drop.n_entity;
  for (int e = 0; e <= itself; ++e) P[e] = V{};
  if (!severity || matters(drop, severity) || own_matters(drop, severity))
    P[itself] = carried_probability(drop, flight, landing, severity, P);
  if (!drop.spill.surface) return;
  Mouth<V> mouth;
  pour(drop.spill, X_W[drop.frame], flight, mouth);
  const auto reach = [&](int row, const SpillConstants& k, V weight, V rho) {
    const double* own = severity ? severity + row * drop.n_entity : nullptr;
    Spill<V> spill(k);
    spill.run(drop, flight, landing, mouth, rho, own);
    V* reached = P + row * drop.n_entity;
    for (int i = 0; i < drop.n_surface; ++i)
      if (Spill<V>::wanted(drop, i, own))
        reached[drop.surface[i].entity] = maximum(reached[drop.surface[i].entity], weight * spill.probability(i));
  };
  const auto counts = [&](int row) { return !severity || matters(drop, severity + row * drop.n_entity); };
  for (int row = 1; row <= kSpillUses; ++row)
    if (const SpillConstants& k = drop.spill.use[row - 1]; counts(row))
      reach(row, k, V{} + 1.0, Filling<V>(drop.spill, k, mouth).rho);
  if (!stops(drop, qd) || !counts(kStopRow)) return;
  const Stop<V> stop(drop.spill, drop.stop, mouth, stopping_time(tables, drop.stop, qd));
  if (any(stop.chance > kNothing<V>)) reach(kStopRow, drop.stop.places, stop.chance, stop.rho);
}

template <class V>
static inline V drop_impact_of(const Tables& tables, const DropTables& drop, const double* severity, const V* q,
                               const V* qd) {
  V P[kDropRows * kMaxEntities + 1], impact = {};
  drop_probability(tables, drop, severity, q, qd, P);
  for (int e = 0; e <= kDropRows * drop.n_entity; ++e) impact += P[e] * severity[e];
  return impact;
}

// --- gradient -------------------------------------------------------------------------------------------------------

// Adds the contribution of contents to the impact and the derivatives; returns the derivative with respect to a small
// rotation of the object. d_stop: derivative with respect to the time the robot needs to stop.
template <class V>
static inline Vec<V> back_contents(Backward<V>& back, const double* severity, const V* qd, V& impact, V& d_stop) {
  const DropTables& drop = back.drop;
  Vec<V> d_turn = {V{}, V{}, V{}};
  if (!drop.spill.surface) return d_turn;
  Mouth<V> mouth;
  MouthSlope<V> d_mouth;
  pour(drop.spill, back.X_W[drop.frame], back.flight, mouth);
  for (int row = 1; row <= kSpillUses; ++row) {
    const double* own = severity + row * drop.n_entity;
    if (!matters(drop, own)) continue;
    const SpillConstants& k = drop.spill.use[row - 1];
    Outflow<V> out{k, V{} + 1.0, Filling<V>(drop.spill, k, mouth).rho};
    impact += back_spill(back, mouth, out, own, d_mouth);
    back_filling(drop.spill, k, mouth, out.d_rho, d_mouth);
  }
  const double* spilled = severity + kStopRow * drop.n_entity;
  if (stops(drop, qd) && matters(drop, spilled)) {
    const Stop<V> stop(drop.spill, drop.stop, mouth, stopping_time(back.tables, drop.stop, qd));
    if (any(stop.chance > kNothing<V>)) {
      Outflow<V> out{drop.stop.places, stop.chance, stop.rho};
      const V reached = back_spill(back, mouth, out, spilled, d_mouth);
      impact += stop.chance * reached;
      d_stop = back_stop(drop.spill, drop.stop, mouth, stop, reached, out.d_rho, d_mouth);
    }
  }
  return back_pour(back.flight, mouth, d_mouth, back.d_flight);
}

template <class V> struct LaneSlopes {
  V d_q[kMaxJoints], d_qd[kMaxJoints];
};

template <class V>
static inline V drop_impact_gradient(const Tables& tables, const DropTables& drop, const double* severity, const V* q,
                                     const V* qd, LaneSlopes<V>& out) {
  const Fall<V> fall(tables, drop, q, qd);
  const auto& [X_W, flight, landing] = fall;
  // Forward pass, as in drop_probability, with a record.
  Tumble<V> tumble(drop, flight, landing);
  const Sweep<V> sweep(drop, flight, landing);
  const Leaving<V> leaving(drop, landing);
  const SideImpact<V> brunt(flight, landing);
  V G[kMaxSurfaces], H[kMaxSurfaces], hit[kMaxSurfaces], lower[kMaxSurfaces], mass[kMaxSurfaces], P[kMaxEntities],
      F[kMaxEntities];
  Point2<V> drift[kMaxSurfaces];
  const bool own = own_matters(drop, severity);
  OwnLoss<V> loss;
  OwnLossSlope<V> d_own(severity[kDropRows * drop.n_entity]);
  V left = landing.landed;
  for (int e = 0; e < drop.n_entity; ++e) P[e] = F[e] = V{};
  for (int l = 0; l < drop.n_level; ++l) {
    mass[l] = tumble.mass, drift[l] = tumble.drift, lower[l] = left;
    const bool tumbles = tumble.enter(drop);
    if (own) d_own.keep(l, loss);
    if (own && tumbles) loss.enter(tumble);
    for (int k = drop.level_start[l]; k < drop.level_start[l + 1]; ++k) {
      const Surface& s = drop.surface[k];
      const V C = landing.contact[k];
      G[k] = tumbles ? tumble.hit(s, true) : V{};
      if (own && tumbles) loss.end(drop, s, tumble);
      H[k] = maximum(sweep.hit(drop, flight, s, landing.time[k], relu(left - C)), brunt.on(flight, k));
      if (s.entity < 0 || severity[s.entity] == 0.0) continue;
      hit[k] = hit_of(drop, flight, landing, leaving, k, {C, G[k], H[k]}, left);
      P[s.entity] = maximum(P[s.entity], hit[k]);
      F[s.entity] += landing.share[l] * landing.overlap[k];
    }
    tumble.leave(drop, landing, l);
    if (own) loss.leave(drop, landing, l, tumble, d_own.damaged[l] = first_damage(drop, flight, landing, l));
    left -= landing.first[l];
  }
  // Reverse pass.
  Backward<V> back(tables, drop, fall);
  LandingSlope<V>& d_landing = back.d_landing;
  TumbleSlope<V> d_tumble;
  SweepSlope<V> d_sweep;
  LeavingSlope<V> d_leaving;
  // d_F: severities of entities whose P is the sum of F; open: of the others, until the surface with the largest P.
  V open[kMaxEntities], d_F[kMaxEntities], d_G[kMaxSurfaces], d_brunt = {};
  for (int e = 0; e < drop.n_entity; ++e) d_F[e] = where(F[e] > P[e], V{} + 1.0, V{}), P[e] = maximum(P[e], F[e]);
  V impact = damage_impact(drop, flight, severity, P, open, back.d_flight);
  if (own) impact += probable(loss.probability) * d_own.severity;
  for (int e = 0; e < drop.n_entity; ++e) d_F[e] *= open[e], open[e] -= d_F[e];
  V d_lowers[kMaxSurfaces];
  for (int l = 0; l < drop.n_level; ++l) {
    d_lowers[l] = V{};
    for (int k = drop.level_start[l]; k < drop.level_start[l + 1]; ++k) {
      const Surface& s = drop.surface[k];
      d_G[k] = V{};
      if (s.entity < 0 || severity[s.entity] == 0.0) continue;
      d_landing.lands[k] += d_F[s.entity];
      const auto greatest = hit[k] == P[s.entity];
      const V d = where(greatest, open[s.entity], V{}), C = landing.contact[k];
      open[s.entity] = where(greatest, V{}, open[s.entity]);
      const HitSlope<V> d_hit = back_hit(back, leaving, k, {C, G[k], H[k]}, lower[l], d, d_leaving);
      d_landing.contact[k] += d_hit.contact, d_G[k] = d_hit.tumble, d_lowers[l] += d_hit.lower;
      if (!any(H[k] > 0.0)) continue;
      const auto stopped = flight.stop.is_of(k) & (H[k] == brunt.value);
      d_brunt += where(stopped, d_hit.side, V{});
      const V d_side = where(stopped, V{}, d_hit.side);
      const V d_beside = where(lower[l] > C, back_sweep_hit(back, sweep, k, relu(lower[l] - C), d_side, d_sweep), V{});
      d_landing.contact[k] -= d_beside, d_lowers[l] += d_beside;
    }
  }
  V d_lower = back_brunt(back, brunt, d_brunt);
  for (int l = 0; l < drop.n_level; ++l) d_lower += d_lowers[l], d_landing.first[l] += d_lower;
  for (int l = drop.n_level; l-- > 0;) {
    tumble.mass = mass[l], tumble.drift = drift[l];
    if (own) loss.lift = d_own.lift_at[l], loss.borne = d_own.borne_at[l];
    back_tumble_level(back, tumble, l, d_G, d_tumble, loss, own ? &d_own : nullptr);
    if (own) back_first_damage(back, l, d_own.d_damaged[l]);
  }
  back_tumble(back, tumble, d_tumble);
  back_sweep(back, sweep, d_sweep);
  if (drop.network.hidden) back_leaving(back, leaving, d_leaving);
  V d_stop = {};
  const Vec<V> d_pour = back_contents(back, severity, qd, impact, d_stop);
  back_land(back);
  back_find_stop(back);
  Vec<V> d_turn = back_release(back);
  d_turn = {d_turn.x + d_pour.x, d_turn.y + d_pour.y, d_turn.z + d_pour.z};
  back_joints(back, qd, d_turn, out.d_q, out.d_qd);
  if (stops(drop, qd))
    back_stopping_time(tables, drop.stop, qd, stopping_time(tables, drop.stop, qd), d_stop, out.d_qd);
  return impact;
}

// --- many states ----------------------------------------------------------------------------------------------------

template <class V, class Visit>
static inline void for_each_release(const Tables& tables, const States& states, Visit visit) {
  V qs[kMaxJoints], rates[kMaxJoints];
  for (size_t first = 0; first < states.n; first += kAbreast<V>) {
    load(tables, states.q, first, states.n, qs);
    if (states.qd) load(tables, states.qd, first, states.n, rates);
    visit(first, qs, states.qd ? rates : nullptr);
  }
}

template <class V>
static void drop_impact(const Tables& tables, const DropTables& drop, const double* severity, const States& states,
                        double* out) {
  for_each_release<V>(tables, states, [&](size_t first, const V* qs, const V* rates) {
    const V value = drop_impact_of(tables, drop, severity, qs, rates);
    for (int i = 0; i < kAbreast<V> && first + size_t(i) < states.n; ++i) out[first + size_t(i)] = value[i];
  });
}

template <class V>
static void drop_gradient(const Tables& tables, const DropTables& drop, const double* severity, const States& states,
                          const Slopes& out) {
  LaneSlopes<V> slopes;
  const size_t nq = size_t(tables.n_joint);
  for_each_release<V>(tables, states, [&](size_t first, const V* qs, const V* rates) {
    const V value = drop_impact_gradient(tables, drop, severity, qs, rates, slopes);
    for (int i = 0; i < kAbreast<V> && first + size_t(i) < states.n; ++i) {
      const size_t row = first + size_t(i);
      out.value[row] = value[i];
      for (size_t j = 0; j < nq; ++j)
        out.d_q[row * nq + j] = slopes.d_q[j][i], out.d_qd[row * nq + j] = slopes.d_qd[j][i];
    }
  });
}

}  // namespace gp::GP_ISA

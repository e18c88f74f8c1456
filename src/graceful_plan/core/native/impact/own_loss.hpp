// Step 5 of the drop model: own loss, the damage to the carried object itself.
#pragma once
#include "cutoffs.hpp"
#include "impact/drop.hpp"
#include "impact/flight/flight.hpp"
#include "impact/normal.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// P that the object is damaged on a surface, from the log of its vertical energy per mass, and the derivative.
template <class V> struct Damage {
  V value, slope;

  [[gnu::always_inline]] Damage(const LossTables& loss, const Surface& s, V log_energy) {
    const V z = (log_energy - s.strength) * loss.sharpness, a = z - loss.shift[0], b = z - loss.shift[1];
    const Normal<V> of_a(a), of_b(b);
    const V both = reciprocal((1.0 + of_a.above) * (1.0 + of_b.above));  // one division for both
    const V below_a = (1.0 + of_b.above) * both, below_b = (1.0 + of_a.above) * both;
    value = loss.weight[0] * below_a + loss.weight[1] * below_b;
    slope = (loss.weight[0] * below_a * (1.0 - below_a) * of_a.grade +
             loss.weight[1] * below_b * (1.0 - below_b) * of_b.grade) *
            loss.sharpness;
  }
};

// Vertical speed at the first contact with a surface.
template <class V> static inline V arrival_speed(const DropTables& drop, const Flight<V>& flight, V time) {
  return kGravity * (time - drop.constants.delay) - flight.v.z;
}
template <class V> static inline V log_arrival(V speed) { return logarithm(maximum(0.5 * speed * speed, V{} + 1e-9)); }

// P that the first contact with a level damages the object.
template <class V>
static inline V first_damage(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing, int level) {
  V sum = {}, log_energy = {};
  if (!any(landing.first[level] > kRare<V>)) return sum;
  double top = __builtin_inf();
  for (int k = drop.level_start[level]; k < drop.level_start[level + 1]; ++k) {
    const Surface& s = drop.surface[k];
    const V lands = landing.share[level] * landing.overlap[k];
    if (!any(lands > kRare<V>)) continue;
    if (s.top != top) log_energy = log_arrival(arrival_speed(drop, flight, landing.time[k]));
    top = s.top;
    sum += lands * Damage<V>(drop.loss, s, log_energy).value;
  }
  return sum;
}

// Own loss along a Tumble: after falling off, the object is damaged where it is stopped, unless the first contact did
// so.
template <class V> struct OwnLoss {
  V probability = {};
  V lift = {}, borne = {};  // A, K in the specification of step 5
  // On the present level: 1/(B + 1e-6), h, and the damage already done by the first contact.
  V share = {}, height = {}, known = {};
  V log_energy = {};
  double top = 0;

  void enter(const Tumble<V>& tumble) {
    share = reciprocal(tumble.mass + kLeastMass);
    height = lift * share, known = borne * share, top = __builtin_inf();
  }
  // Damage if the object is stopped by a surface.
  Damage<V> fall(const DropTables& drop, const Surface& s) {
    if (s.top != top) {
      const V h = height - s.top;
      log_energy = logarithm(maximum((0.5 * kGravity) * (h + square_root(h * h + 1e-4)), V{} + 1e-9));
    }
    top = s.top;
    return Damage<V>(drop.loss, s, log_energy);
  }
  void end(const DropTables& drop, const Surface& s, const Tumble<V>& tumble) {
    if (!s.holds) return;
    const V ends = tumble.mass * tumble.caught;
    if (any(ends > kRare<V>)) probability += ends * relu(fall(drop, s).value - known);
  }
  // Call it after tumble.leave(); `damaged`: first_damage() of the level.
  void leave(const DropTables& drop, const Landing<V>& landing, int level, const Tumble<V>& tumble, V damaged) {
    probability += damaged;
    lift = lift * tumble.keep + tumble.falls * landing.leaving[level] * drop.surface[drop.level_start[level]].top;
    borne = borne * tumble.keep + tumble.falls * landing.leaves[level] * damaged;
  }
};

}  // namespace gp::GP_ISA

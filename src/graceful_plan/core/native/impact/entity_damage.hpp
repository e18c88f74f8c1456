// Step 6 of the drop model: P that the carried object damages an entity that it hits.
#pragma once
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "impact/normal.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// P(damage | hit) of one entity, as a function of the height of the object's lowest point and of its squared speed.
template <class V> struct EntityDamage {
  V value, d_low, d_v;  // d_v times the velocity is the derivative with respect to the velocity

  EntityDamage(const DamageTables& damage, const Fragility& entity, V low, V v2) {
    const double b = damage.loss, sigma = 1.0 / entity.sharpness;
    const V h = low - entity.top, soft = square_root(h * h + 1e-4), fallen = 0.5 * (h + soft);
    const V energy = kGravity * fallen + 0.5 * v2 + 1e-9;
    const V a = maximum(logarithm(energy) - entity.strength, V{} - 6.0 * sigma);  // less is no damage
    const V z = a * entity.sharpness, lost = exponential(-a * (1.0 / b) + 0.5 * sigma * sigma / (b * b));
    const Normal<V> acts(z), misses(z - sigma / b);
    const V p = reciprocal(1.0 + acts.above), r = reciprocal(1.0 + misses.above);
    value = relu(p - lost * r);
    const V d_p = p * (1.0 - p) * acts.grade, d_r = r * (1.0 - r) * misses.grade;
    const V by_a = (d_p - lost * d_r) * entity.sharpness + lost * r * (1.0 / b);
    const V by_energy = where((value > 0.0) & (z > -6.0), by_a * reciprocal(energy), V{});
    d_low = by_energy * kGravity * fallen * reciprocal(soft), d_v = by_energy;
  }
};

template <class V> static inline V squared_speed(const Flight<V>& flight) {
  return flight.v.x * flight.v.x + flight.v.y * flight.v.y + flight.v.z * flight.v.z;
}

// Turns the P of hits on entities into those of damage.
template <class V> static inline void hits_to_damage(const DropTables& drop, const Flight<V>& flight, V* P) {
  const DamageTables& damage = drop.damage;
  if (!damage.entity) return;
  const V v2 = squared_speed(flight);
  for (int e = 0; e < drop.n_entity; ++e)
    if (any(P[e] > kNothing<V>)) P[e] *= EntityDamage<V>(damage, damage.entity[e], flight.low, v2).value;
}

// The expected severity of the hits P, and its derivative `open` with respect to each P; adds those by the energy of
// the hits to `d_flight`.
template <class V>
static inline V damage_impact(const DropTables& drop, const Flight<V>& flight, const double* severity, const V* P,
                              V* open, FlightSlope<V>& d_flight) {
  const DamageTables& damage = drop.damage;
  V impact = {}, by_low = {}, by_v = {};
  const V v2 = squared_speed(flight);
  for (int e = 0; e < drop.n_entity; ++e) {
    const V harm = P[e] * severity[e];
    open[e] = V{} + severity[e];
    if (damage.entity && any(harm > 0.0)) {
      const EntityDamage<V> given(damage, damage.entity[e], flight.low, v2);
      open[e] *= given.value, by_low += harm * given.d_low, by_v += harm * given.d_v;
    }
    impact += P[e] * open[e];
  }
  d_flight.low += by_low;
  d_flight.v.x += by_v * flight.v.x, d_flight.v.y += by_v * flight.v.y, d_flight.v.z += by_v * flight.v.z;
  return impact;
}

}  // namespace gp::GP_ISA

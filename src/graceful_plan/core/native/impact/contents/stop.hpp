// The inertial spill: contents that leave the container in a protective stop. costs/models/spill specifies the model
// and its letters.
#pragma once
#include "cutoffs.hpp"
#include "impact/contents/spill.hpp"
#include "impact/contents/spill_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// --- values ----------------------------------------------------------------------------------------------------------

// The contents that a container keeps, given the cosine between its axis and the upward felt direction.
template <class V> struct Leaning {
  V root, up, slope, x, fill, fourth, kept;

  Leaning(const SpillTables& spill, V cosine) {
    root = square_root(cosine * cosine + 0.01), up = 0.5 * (cosine + root);
    slope = square_root(1.0051 - up * up) * reciprocal(up);
    x = relu(slope - spill.repose) * (spill.rim / spill.depth);
    fill = (1.0 + x * (1.0 + x * (1.0 + 1.7 * x))) * (1.0 / spill.full);
    fourth = 1.0 + fill * fill * fill * fill;
    kept = exponential(-0.25 * logarithm(fourth));
  }
};

// e: P that all contents stay, except for a negligible amount.
template <class V> struct Staying {
  V exponent, value;

  Staying(const StopTables& stop, const Leaning<V>& leaning)
      : exponent(logarithm(leaning.fill) * (1.0 / (kBeta * stop.spread))), value(reciprocal(1.0 + odds(exponent))) {}
};

// T: time that the robot needs to stop.
template <class V> static inline V stopping_time(const Tables& tables, const StopTables& stop, const V* qd) {
  V longest = {};
  for (int j = 0; j < tables.n_joint; ++j) longest = maximum(longest, absolute(qd[j]) * stop.slowness[j]);
  return longest;
}

constexpr double kLeastFelt = 1e-4;  // added to squared accelerations [m^2/s^4]

template <class V> struct Stop {
  V time, rate;  // a = rate vm: acceleration of the mouth
  Vec<V> felt;
  V inverse, cosine;  // 1 / |felt|; cosine between the axis and the felt direction
  Leaning<V> before, braked;
  Staying<V> stayed, stays;
  V chance, lost, rho;

  Stop(const SpillTables& spill, const StopTables& stop, const Mouth<V>& mouth, V seconds)
      : time(seconds),
        rate(stop.amplification * inverse_root(time * time + stop.response * stop.response)),
        felt{-rate * mouth.vx, -rate * mouth.vy, kGravity - rate * mouth.vz},
        inverse(inverse_root(felt.x * felt.x + felt.y * felt.y + felt.z * felt.z + kLeastFelt)),
        cosine((mouth.axis.x * felt.x + mouth.axis.y * felt.y + mouth.axis.z * felt.z) * inverse),
        before(spill, mouth.axis.z * kGravity * still()),
        braked(spill, cosine),
        stayed(stop, before),
        stays(stop, braked) {
    chance = relu(1.0 - stays.value * reciprocal(stayed.value));
    lost = relu(before.kept - braked.kept);
    rho = spill.radius * exponential(spill.power * logarithm(lost + kLeastLost));
  }
  // The value of `inverse` at rest, so that a stop without acceleration changes nothing.
  static V still() { return inverse_root(V{} + (kGravity * kGravity + kLeastFelt)); }
};

// --- reverse mode, as in drop_gradient.hpp ---------------------------------------------------------------------------

// Returns the derivative with respect to the cosine.
template <class V>
static inline V back_leaning(const SpillTables& spill, const Leaning<V>& leaning, V d_logarithm, V d_kept) {
  const V cube = leaning.fill * leaning.fill * leaning.fill;
  const V d_fill = d_logarithm * reciprocal(leaning.fill) - d_kept * leaning.kept * cube * reciprocal(leaning.fourth);
  const V d_x = d_fill * (1.0 + leaning.x * (2.0 + 5.1 * leaning.x)) * (1.0 / spill.full);
  const V d_slope = where(leaning.slope > spill.repose, d_x * (spill.rim / spill.depth), V{});
  const V d_up = -d_slope * (inverse_root(1.0051 - leaning.up * leaning.up) + leaning.slope * reciprocal(leaning.up));
  return d_up * leaning.up * reciprocal(leaning.root);
}

// Returns the derivative with respect to the time that the robot needs to stop.
template <class V>
static inline V back_stop(const SpillTables& spill, const StopTables& tables, const Mouth<V>& mouth,
                          const Stop<V>& stop, V d_chance, V d_rho, MouthSlope<V>& d_mouth) {
  const V d_out = where(stop.chance > 0.0, d_chance, V{});
  const V d_lost = where(stop.lost > 0.0, d_rho * stop.rho * spill.power * reciprocal(stop.lost + kLeastLost), V{});
  // Derivative of 1 - e'/e with respect to ln fill; it is 0 where exponents are clamped.
  const V ratio = d_out * stop.stays.value * reciprocal(stop.stayed.value) * (1.0 / (kBeta * tables.spread));
  const auto slope = [&](const Staying<V>& at) { return where(at.exponent < kHeld<V>, ratio * (1.0 - at.value), V{}); };
  const V d_before = back_leaning(spill, stop.before, -slope(stop.stayed), d_lost),
          d_braked = back_leaning(spill, stop.braked, slope(stop.stays), -d_lost);
  const V along = d_braked * stop.inverse, back = d_braked * stop.cosine * stop.inverse * stop.inverse;
  d_mouth.axis.x += along * stop.felt.x, d_mouth.axis.y += along * stop.felt.y;
  d_mouth.axis.z += along * stop.felt.z + d_before * kGravity * Stop<V>::still();
  const Vec<V> d_felt = {along * mouth.axis.x - back * stop.felt.x, along * mouth.axis.y - back * stop.felt.y,
                         along * mouth.axis.z - back * stop.felt.z};
  d_mouth.vx -= stop.rate * d_felt.x, d_mouth.vy -= stop.rate * d_felt.y, d_mouth.vz -= stop.rate * d_felt.z;
  const V d_rate = -(mouth.vx * d_felt.x + mouth.vy * d_felt.y + mouth.vz * d_felt.z);
  const V slowed = stop.time * stop.time + tables.response * tables.response;
  return -d_rate * stop.rate * stop.time * reciprocal(slowed);
}

// If several joints need equally long, the first one counts.
template <class V>
static inline void back_stopping_time(const Tables& tables, const StopTables& stop, const V* qd, V longest, V d_time,
                                      V* d_qd) {
  V open = d_time;
  for (int j = 0; j < tables.n_joint; ++j) {
    const auto slowest = absolute(qd[j]) * stop.slowness[j] == longest;
    d_qd[j] += where(slowest, where(qd[j] < 0.0, -open, open) * stop.slowness[j], V{});
    open = where(slowest, V{}, open);
  }
}

}  // namespace gp::GP_ISA

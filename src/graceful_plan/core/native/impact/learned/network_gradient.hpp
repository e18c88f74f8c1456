// The gradient of the network's correction: network.hpp in reverse mode; see drop_gradient.hpp.
#pragma once
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "impact/learned/network.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

template <class V> struct HitSlope {
  V contact, tumble, side, lower;
};

template <class V> struct LeavingSlope {
  V probability = {}, x = {}, y = {};
};

template <class V> static inline void back_any_of_them(const Hits<V>& hits, V d, HitSlope<V>& out) {
  out.contact += d * (1.0 - hits.tumble) * (1.0 - hits.side);
  out.tumble += d * (1.0 - hits.contact) * (1.0 - hits.side);
  out.side += d * (1.0 - hits.contact) * (1.0 - hits.tumble);
}

// Derivatives with respect to the inputs of the network.
template <class V>
static inline void back_answer(const DropNetwork& net, const Answer<V>& answer, V d_log_factor,
                               V d_told[kNetworkInputs]) {
  using T = Scalar<V>;
  const T *w1 = net.of<T>(), *w2 = w1 + net.hidden * kNetworkInputs, *b2 = w2 + net.hidden * net.hidden,
          *w3 = b2 + net.hidden;
  const V d_raw = d_log_factor * net.bound * squash_slope(answer.raw);
  V d_first[kMaxHidden] = {};
  for (int j = 0; j < net.hidden; ++j) {
    const V d = d_raw * w3[j] * squash_slope(answer.second[j]);
    for (int i = 0; i < net.hidden; ++i) d_first[i] += d * w2[j * net.hidden + i];
  }
  for (int i = 0; i < kNetworkInputs; ++i) d_told[i] = V{};
  for (int j = 0; j < net.hidden; ++j) {
    const V d = d_first[j] * squash_slope(answer.first[j]);
    for (int i = 0; i < kNetworkInputs; ++i) d_told[i] += d * w1[j * kNetworkInputs + i];
  }
}

template <class V>
static inline void back_sight(Backward<V>& back, const Sight<V>& sight, const Leaving<V>& leaving, const Surface& s,
                              const V d[kNetworkInputs], LeavingSlope<V>& d_leaving) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  const double per_size = 1.0 / drop.size;
  // Distances beside the surface: the larger one is the first input.
  const auto x_first = squash(sight.beside_x) > squash(sight.beside_y);
  const V d_gx = where(x_first, d[0], d[1]), d_gy = where(x_first, d[1], d[0]);
  const V d_x = d_gx * squash_slope(sight.beside_x) * per_size * sight.x * reciprocal(sight.ax);
  const V d_y = d_gy * squash_slope(sight.beside_y) * per_size * sight.y * reciprocal(sight.ay);
  back_turned(s, {d_x, d_y}, d_landing.x, d_landing.y);
  // Towards the surface: velocity and falls.
  const V ahead = flight.v.x * sight.dx + flight.v.y * sight.dy, away = leaving.x * sight.dx + leaving.y * sight.dy;
  const V r = sight.inverse_far, d_r3 = -(d[2] * ahead + d[12] * away) * r * r * r;
  d_flight.v.x += d[2] * sight.dx * r, d_flight.v.y += d[2] * sight.dy * r;
  d_leaving.x += d[12] * sight.dx * r, d_leaving.y += d[12] * sight.dy * r;
  d_landing.x -= (d[2] * flight.v.x + d[12] * leaving.x) * r + d_r3 * sight.dx;
  d_landing.y -= (d[2] * flight.v.y + d[12] * leaving.y) * r + d_r3 * sight.dy;
  d_leaving.probability += d[11];
  // Velocities, heights and posture.
  d_flight.speed += d[3], d_flight.v.z += d[4] * squash_slope(flight.v.z);
  d_flight.low += d[5] * squash_slope(sight.drop_height) * kDeep - (d[8] + d[10]) * per_size;
  d_landing.height += (d[6] * squash_slope(sight.above_top) + d[7] * squash_slope(sight.above_bottom)) * per_size;
  d_flight.high += d[8] * per_size, d_flight.tilt += d[9], d_flight.c.z += d[10] * per_size;
  d_landing.fallen += d[16] * squash_slope(landing.fallen * kDeep) * kDeep;
}

template <class V>
static inline void back_leaving(Backward<V>& back, const Leaving<V>& leaving, const LeavingSlope<V>& d) {
  const DropTables& drop = back.drop;
  LandingSlope<V>& d_landing = back.d_landing;
  for (int l = 0; l < drop.n_level; ++l) {
    const Point2<V>& n = back.landing.away[l];
    const V M = back.landing.leaving[l] * leaving.share;
    d_landing.leaving[l] += leaving.share * (d.probability + d.x * n.x + d.y * n.y);
    d_landing.away[l].x += d.x * M, d_landing.away[l].y += d.y * M;
  }
  d_landing.total -= leaving.share * (d.probability * leaving.probability + d.x * leaving.x + d.y * leaving.y);
}

// Maps the derivative with respect to P of a hit to those with respect to its arguments.
template <class V>
static inline HitSlope<V> back_hit(Backward<V>& back, const Leaving<V>& leaving, int surface, const Hits<V>& hits,
                                   V lower, V d, LeavingSlope<V>& d_leaving) {
  const DropTables& drop = back.drop;
  HitSlope<V> out{V{}, V{}, V{}, V{}};
  const V P = hits.any_of_them();
  if (!drop.network.hidden || !any((P > kCorrected) & (d != 0.0))) {
    back_any_of_them(hits, d, out);
    return out;
  }
  const Surface& s = drop.surface[surface];
  const Sight<V> sight(drop, back.flight, back.landing, leaving, s, hits, lower);
  const Answer<V> answer(drop.network, surface, sight.told);
  const Corrected<V> corrected(P, answer.log_factor);
  const V d_exponent = d * corrected.value * (1.0 - corrected.value);  // 1 - value = (1 - P)/(1 - P + P f)
  const V inverse_P = reciprocal(maximum(P, V{} + kCorrected));
  const V d_fade = where(P > kCorrected, kCorrected * inverse_P * inverse_P, V{});
  back_any_of_them(
      hits, d * corrected.factor * corrected.inverse * corrected.inverse + d_exponent * answer.log_factor * d_fade,
      out);
  V d_told[kNetworkInputs];
  back_answer(drop.network, answer, d_exponent * corrected.fade, d_told);
  back_sight(back, sight, leaving, s, d_told, d_leaving);
  out.contact += d_told[13], out.tumble += d_told[14], out.side += d_told[15], out.lower += d_told[17];
  return out;
}

}  // namespace gp::GP_ISA

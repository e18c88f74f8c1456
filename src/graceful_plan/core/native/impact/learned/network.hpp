// A network that multiplies the odds of each hit of the drop model by a learned factor. costs/models/drop/network.py
// describes its training, and its inputs in the order used here.
#pragma once
#include "impact/drop.hpp"
#include "impact/flight/flight.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

constexpr double kCorrected = 1e-4;  // smaller probabilities are not corrected
constexpr double kRounded = 1e-4;    // square of the length over which distances from an axis are rounded off [m^2]
constexpr double kDeep = 10.0;       // inverse of a medium height of fall [1/m]

// Maps all numbers to -1 to 1; with the derivative.
template <class V> static inline V squash(V x) { return x * inverse_root(1.0 + x * x); }
template <class V> static inline V squash_slope(V x) {
  const V r = inverse_root(1.0 + x * x);
  return r * r * r;
}

// C, G, H: P of a hit by the first contact, by the fall after it, and from the side.
template <class V> struct Hits {
  V contact, tumble, side;

  V any_of_them() const { return 1.0 - (1.0 - contact) * (1.0 - tumble) * (1.0 - side); }
};

// Inputs of the network for one surface, and intermediate values.
template <class V> struct Sight {
  V told[kNetworkInputs];
  V x, y, ax, ay;         // place of landing in the surface's axes; smooth absolute values
  V dx, dy, inverse_far;  // from there to the surface's centre, in W
  V beside_x, beside_y, drop_height, above_top, above_bottom;

  Sight(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing, const Leaving<V>& leaving,
        const Surface& s, const Hits<V>& hits, V lower) {
    const double per_size = 1.0 / drop.size;
    const Point2<V> at = placed(s, landing.x, landing.y);
    x = at.x, y = at.y;
    ax = square_root(x * x + kRounded), ay = square_root(y * y + kRounded);
    dx = s.centre[0] - landing.x, dy = s.centre[1] - landing.y;
    inverse_far = inverse_root(dx * dx + dy * dy + drop.size * drop.size);
    beside_x = (ax - s.half[0]) * per_size, beside_y = (ay - s.half[1]) * per_size;
    drop_height = (flight.low - s.top) * kDeep;
    above_top = (landing.height - s.top) * per_size, above_bottom = (landing.height - s.bottom) * per_size;
    const V gx = squash(beside_x), gy = squash(beside_y);
    told[0] = maximum(gx, gy), told[1] = minimum(gx, gy);
    told[2] = (flight.v.x * dx + flight.v.y * dy) * inverse_far;
    told[3] = flight.speed, told[4] = squash(flight.v.z);
    told[5] = squash(drop_height), told[6] = squash(above_top), told[7] = squash(above_bottom);
    told[8] = (flight.high - flight.low) * per_size, told[9] = flight.tilt;
    told[10] = (flight.c.z - flight.low) * per_size;
    told[11] = leaving.probability, told[12] = (leaving.x * dx + leaving.y * dy) * inverse_far;
    told[13] = hits.contact, told[14] = hits.tumble, told[15] = hits.side;
    told[16] = squash(landing.fallen * kDeep), told[17] = lower;
  }
};

// The network's output for one surface, with values for the reverse pass.
template <class V> struct Answer {
  V first[kMaxHidden], second[kMaxHidden], raw;  // before squash()
  V log_factor;                                  // log of the factor on the odds

  Answer(const DropNetwork& net, int surface, const V told[kNetworkInputs]) {
    using T = Scalar<V>;
    const T *w1 = net.of<T>(), *w2 = w1 + net.hidden * kNetworkInputs, *b2 = w2 + net.hidden * net.hidden,
            *w3 = b2 + net.hidden, *b1 = w3 + net.hidden + 1 + surface * net.hidden;
    V kept[kMaxHidden];
    for (int j = 0; j < net.hidden; ++j) {
      V sum = V{} + b1[j];
      for (int i = 0; i < kNetworkInputs; ++i) sum += w1[j * kNetworkInputs + i] * told[i];
      first[j] = sum, kept[j] = squash(sum);
    }
    raw = V{} + w3[net.hidden];
    for (int j = 0; j < net.hidden; ++j) {
      V sum = V{} + b2[j];
      for (int i = 0; i < net.hidden; ++i) sum += w2[j * net.hidden + i] * kept[i];
      second[j] = sum, raw += w3[j] * squash(sum);
    }
    log_factor = net.bound * squash(raw);
  }
};

// P -> P f/(1 - P + P f): odds times f; f fades to 1 where P is close to kCorrected.
template <class V> struct Corrected {
  V fade, factor, inverse, value;

  Corrected(V P, V log_factor) {
    fade = where(P > kCorrected, 1.0 - kCorrected * reciprocal(maximum(P, V{} + kCorrected)), V{});
    factor = exponential(log_factor * fade);
    inverse = reciprocal(1.0 - P + P * factor);
    value = probable(P * factor * inverse);
  }
};

// P of a hit of a surface, corrected by the network if there is one.
template <class V>
static inline V hit_of(const DropTables& drop, const Flight<V>& flight, const Landing<V>& landing,
                       const Leaving<V>& leaving, int surface, const Hits<V>& hits, V lower) {
  const V P = hits.any_of_them();
  if (!drop.network.hidden || !any(P > kCorrected)) return P;
  const Sight<V> sight(drop, flight, landing, leaving, drop.surface[surface], hits, lower);
  return Corrected<V>(P, Answer<V>(drop.network, surface, sight.told).log_factor).value;
}

}  // namespace gp::GP_ISA

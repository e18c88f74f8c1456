// A pendulum that hangs where something is felt: how the surface of a liquid answers, opposite to the bob.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>

namespace gp {

struct Pendulum {
  double length;  // [m]
  double drag;    // [1/s]
};

// Unit directions away from the bob at n even times, `dt` apart, from felt accelerations [n, 3]. It
// hangs at rest at first, whatever is felt then.
inline void swing(const Pendulum& pendulum, const double* felt, size_t n, double dt, double* out) {
  constexpr double kStep = 0.001;
  const int steps = std::max(1, int(std::ceil(dt / kStep)));
  const double h = dt / steps;
  const auto size = [](const double* a) { return std::sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); };
  double d[3] = {0, 0, -1}, rate[3] = {0, 0, 0};  // of the bob
  for (size_t k = 0; k < n; ++k) {
    for (int i = 0; i < 3; ++i) out[3 * k + i] = -d[i];
    const double *begin = felt + 3 * k, *end = k + 1 < n ? begin + 3 : begin;
    for (int s = 0; s < steps; ++s) {
      const double share = (s + 0.5) / steps;
      double pull[3], along = 0, radial = 0;
      for (int i = 0; i < 3; ++i) {
        pull[i] = -(begin[i] + share * (end[i] - begin[i])) / pendulum.length;
        along += pull[i] * d[i];
      }
      for (int i = 0; i < 3; ++i) {
        rate[i] += h * (pull[i] - along * d[i] - pendulum.drag * rate[i]);
        d[i] += h * rate[i];
      }
      const double length = size(d);
      for (int i = 0; i < 3; ++i) d[i] /= length, radial += rate[i] * d[i];
      for (int i = 0; i < 3; ++i) rate[i] -= radial * d[i];
    }
  }
}

}  // namespace gp

// A pendulum at a point with felt acceleration: a model of a liquid's surface, whose normal is opposite to the bob.
#pragma once
#include <cmath>

#include "timing/rider.hpp"

namespace gp {

struct Pendulum {
  double length;  // [m]
  double drag;    // [1/s]
};

// Unit direction d of the bob and its rate of change; at rest initially.
struct Bob {
  Vector3 d{0, 0, -1}, rate{};

  // A first-order step of h seconds. `pull`: negative felt acceleration, divided by the length. Returns the factor that
  // scaled the bob back to unit length.
  double advance(const Vector3& pull, double h, double drag) {
    kick(pull, h, drag);
    return drift(h);
  }
  // A second-order step; `pull` is that at the middle of the step.
  void leap(const Vector3& pull, double h, double drag) {
    drift(0.5 * h);
    kick(pull, h, drag);
    drift(0.5 * h);
  }

 private:
  void kick(const Vector3& pull, double h, double drag) {
    const double along = dot3(pull, d);
    for (size_t i = 0; i < 3; ++i) rate[i] += h * (pull[i] - along * d[i] - drag * rate[i]);
  }
  double drift(double h) {
    add3(d, h, rate);
    const double shrunk = 1 / std::sqrt(dot3(d, d));
    d = scaled3(d, shrunk);
    add3(rate, -dot3(rate, d), d);
    return shrunk;
  }
};

}  // namespace gp

// A pendulum that hangs where something is felt: how the surface of a liquid answers, opposite to the bob.
#pragma once
#include <cmath>

#include "timing/rider.hpp"

namespace gp {

struct Pendulum {
  double length;  // [m]
  double drag;    // [1/s]
};

// Where the bob is, a unit direction, and how fast that changes; at rest before it is moved.
struct Bob {
  Vector3 d{0, 0, -1}, rate{};

  // A step of so many seconds, of first order; `pull` is what is felt there, reversed, by the length.
  void advance(const Vector3& pull, double h, double drag) {
    kick(pull, h, drag);
    drift(h);
  }
  // The same of second order, where `pull` is that in the middle of the step.
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
  void drift(double h) {
    add3(d, h, rate);
    d = scaled3(d, 1 / std::sqrt(dot3(d, d)));
    add3(rate, -dot3(rate, d), d);
  }
};

}  // namespace gp

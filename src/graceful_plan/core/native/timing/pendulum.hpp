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

  // A step of so many seconds, of first order; `pull` is what is felt there, reversed, by the length. Returns by how
  // much the bob was shrunk back to unit length.
  double advance(const Vector3& pull, double h, double drag) {
    kick(pull, h, drag);
    return drift(h);
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
  double drift(double h) {
    add3(d, h, rate);
    const double shrunk = 1 / std::sqrt(dot3(d, d));
    d = scaled3(d, shrunk);
    add3(rate, -dot3(rate, d), d);
    return shrunk;
  }
};

}  // namespace gp

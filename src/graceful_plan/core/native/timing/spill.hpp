// Whether the contents of a vessel stay in it along a timed motion, with sloshing.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "timing/slosh.hpp"
#include "timing/speed_profile.hpp"

namespace gp {

// Motion of a vessel along a curve: derivatives of a point at both ends of each interval, and its axis, in W.
struct VesselMotion {
  struct Interval {
    Vector3 velocity[2], bend[2];
  };
  std::vector<Interval> interval;  // [n]
  std::vector<Vector3> axis;       // [n + 1]
};

// Whether the surface stays within its limit if the curve is travelled at squared speeds `x`, slowed down by a factor,
// and for some time after the end.
inline bool stays_in(const SloshLimit& limit, double gravity, const CurveSamples& curve, const VesselMotion& vessel,
                     const std::vector<double>& x, double factor) {
  constexpr double kPhase =
      0.03;  // largest step of the pendulum's swing [rad]; with 0.06, the judge found spills of tall bottles
  constexpr double kAfter = 0.5;      // time after the end [s]
  constexpr double kMostSteps = 1e4;  // largest number of steps in an interval, after which the pendulum is at rest
  const double least = std::cos(limit.angle), slower = 1 / (factor * factor);
  const bool liquid = limit.pendulum.length > 0;
  const double longest = kPhase * std::sqrt(limit.pendulum.length / gravity);
  const auto below = [&](const Vector3& axis, const Vector3& normal, double size) {
    return dot3(axis, normal) >= least * size;
  };
  Bob bob;
  const auto calm = [&](const Vector3& axis) { return below(axis, scaled3(bob.d, -1), 1.0); };
  for (size_t i = 0; i < curve.n; ++i) {
    const double push = (x[i + 1] - x[i]) / (2 * curve.step[i]);
    Vector3 felt[2];
    for (size_t end = 0; end < 2; ++end) {
      felt[end] = {0, 0, gravity};
      add3(felt[end], slower * push, vessel.interval[i].velocity[end]);
      add3(felt[end], slower * x[i + end], vessel.interval[i].bend[end]);
      if (!liquid && !below(vessel.axis[i + end], felt[end], std::sqrt(dot3(felt[end], felt[end])))) return false;
    }
    if (!liquid) continue;
    const double pause = factor * 2 * curve.step[i] / (std::sqrt(x[i]) + std::sqrt(x[i + 1]));
    const int steps = int(std::clamp(std::ceil(pause / longest), 1.0, kMostSteps));
    const double h = std::min(pause / steps, longest), per = -1 / limit.pendulum.length;
    for (int s = 0; s < steps; ++s) {
      const double share = double(s) / steps, middle = (s + 0.5) / steps;
      Vector3 axis = scaled3(vessel.axis[i], 1 - share), pull = scaled3(felt[0], per * (1 - middle));
      add3(axis, share, vessel.axis[i + 1]), add3(pull, per * middle, felt[1]);
      if (!calm(axis)) return false;
      bob.leap(pull, h, limit.pendulum.drag);
    }
  }
  for (double after = 0; liquid && after < kAfter; after += longest) {
    if (!calm(vessel.axis.back())) return false;
    bob.leap({0, 0, -gravity / limit.pendulum.length}, longest, limit.pendulum.drag);
  }
  return true;
}

}  // namespace gp

// What is felt where something is carried, as limits on how fast a curve is travelled.
//
// At a point p of the robot that moves by p' per unit of the curve's parameter, the acceleration is p' u + p'' x:
// linear in the parameter's acceleration u and squared speed x, like the joints' accelerations. What is felt there is
// that acceleration less gravity. A facet v, a vector that turns with the robot, asks that v . (p' u + p'' x + g e_z)
// <= room: facets around an axis without room hold what is felt inside a pyramid, which stands for a cone; those with
// room hold a load below what a grasp can carry.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "timing/rider.hpp"
#include "timing/slosh.hpp"
#include "timing/speed_profile.hpp"

namespace gp {

struct FeltLimit {
  int link;
  Vector3 point;                    // in the link
  std::vector<Vector3> facets;      // in the axes of the link
  std::vector<double> size;         // of each facet
  std::vector<double> room;         // of each facet [m/s^2]
  double gravity;                   // [m/s^2]
  std::optional<SloshLimit> slosh;  // of what is carried there, if it has a surface
};

// How a point that something is felt at moves at an end of an interval, in the axes of its link.
struct FeltMotion {
  Vector3 velocity, bend, up;
};

// What each facet of a limit leaves to the motion; returns the least.
inline double rests(const FeltLimit& limit, const Vector3& up, double* out) {
  double least = std::numeric_limits<double>::infinity();
  for (size_t f = 0; f < limit.facets.size(); ++f) {
    out[f] = limit.room[f] - limit.gravity * dot3(limit.facets[f], up);
    least = std::min(least, out[f]);
  }
  return least;
}

// Add the facets of a limit at the beginning of the interval that is begun, or at its end, where the squared speed is
// x + S u. Motions that are slowed down to a share of their speed afterwards may feel more before. Tags are those of
// the first facet and, by twos, of the others.
inline void add_facets(const FeltLimit& limit, const FeltMotion& at, const double* rests, double S, double speed,
                       size_t tag, CurveLimits& out) {
  const double per = 1 / (speed * speed);
  Vector3 velocity = at.velocity;
  add3(velocity, S, at.bend);
  const double fast = std::sqrt(dot3(velocity, velocity)), bent = std::sqrt(dot3(at.bend, at.bend));
  const auto most = [&] { return fast * out.box().push + bent * out.box().squared; };
  double felt = most();  // less and less, as other facets leave less
  for (size_t f = 0; f < limit.facets.size(); ++f) {
    const double room = rests[f] * per;
    if (felt * limit.size[f] <= room) continue;
    out.add(dot3(limit.facets[f], velocity), dot3(limit.facets[f], at.bend), room, tag + 2 * f);
    felt = most();
  }
}

}  // namespace gp

// Limits on the felt acceleration at carried objects, as limits on the speed along a curve.
//
// At a point p of the robot that moves by p' per unit of the curve's parameter, the acceleration is p' u + p'' x:
// linear in the parameter's acceleration u and squared speed x, like the joints' accelerations. The felt acceleration
// is this minus gravity. A facet v, a vector fixed to the link, requires v . (p' u + p'' x + g e_z) <= room. Facets
// around an axis with room 0 confine the felt direction to a pyramid that stands for a cone; facets with room > 0 keep
// the load on a grasp within its capacity.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "timing/rider.hpp"
#include "timing/slosh.hpp"
#include "timing/speed_profile.hpp"

namespace gp {

struct SpecificForceLimit {
  int link;
  Vector3 point;                    // in the link
  std::vector<Vector3> facets;      // in the axes of the link
  std::vector<double> size;         // length of each facet
  std::vector<double> room;         // limit of each facet [m/s^2]
  double gravity;                   // [m/s^2]
  std::optional<SloshLimit> slosh;  // for contents with a surface
};

// Motion of a point with a felt limit at an end of an interval, in the axes of its link.
struct FeltMotion {
  Vector3 velocity, bend, up;
};

// Computes the reserve of each facet at rest [m/s^2]; returns the least.
inline double rests(const SpecificForceLimit& limit, const Vector3& up, double* out) {
  double least = std::numeric_limits<double>::infinity();
  for (size_t f = 0; f < limit.facets.size(); ++f) {
    out[f] = limit.room[f] - limit.gravity * dot3(limit.facets[f], up);
    least = std::min(least, out[f]);
  }
  return least;
}

// Adds the facets of a limit at the beginning of the current interval, or at its end, where the squared speed is x + S
// u. If the motion is slowed down afterwards to a share `speed`, the limits may be wider by 1/speed^2. Facet f has the
// tag `tag` + 2 f.
inline void add_facets(const SpecificForceLimit& limit, const FeltMotion& at, const double* rests, double S,
                       double speed, size_t tag, CurveLimits& out) {
  const double per = 1 / (speed * speed);
  Vector3 velocity = at.velocity;
  add3(velocity, S, at.bend);
  const double fast = std::sqrt(dot3(velocity, velocity)), bent = std::sqrt(dot3(at.bend, at.bend));
  const auto most = [&] { return fast * out.box().push + bent * out.box().squared; };
  double felt = most();  // decreases as other facets tighten the box
  for (size_t f = 0; f < limit.facets.size(); ++f) {
    const double room = rests[f] * per;
    if (felt * limit.size[f] <= room) continue;
    out.add(dot3(limit.facets[f], velocity), dot3(limit.facets[f], at.bend), room, tag + 2 * f);
    felt = most();
  }
}

}  // namespace gp

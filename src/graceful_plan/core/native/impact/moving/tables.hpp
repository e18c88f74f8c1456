// Moving entities, as the kernels see them; costs/models/moving has the specification and explains the names.
#pragma once
#include <cstdint>

namespace gp {

constexpr int kMaxPairs = 64;  // pairs of a place and a time that represent where an entity may be

struct PathKnot {
  double t, at[4], rate[4];  // x, y, z, yaw, and their rates until the next knot
};

struct MovingEntity {  // an upright box or cylinder on a predicted path
  int32_t round, n_knot, n_time;
  double half[3], spread, growth;  // half: half sizes of the upright bounding box
  double top_speed, lowest;        // lowest: height of its bottom at the lowest point of the path
  const PathKnot* knot;
  const double* time;  // times that represent the path if no time is known
};

struct MovingPaths {
  int32_t n_entity;
  const MovingEntity* entity;
};

struct MovingPlaces {
  int32_t n_place;
  const double* place;  // [n_place, 2]: samples of a normal distribution with standard deviation 1
  double cell;          // standard deviation represented by one place
  double protrusion;    // largest protrusion of spheres from their geoms [m]
};

// A value per state, and its derivatives with respect to q and qd [n, n_joint] and time; kernels add to all of them.
struct MovingSlopes {
  double *value, *d_q, *d_qd, *d_t;
};

}  // namespace gp

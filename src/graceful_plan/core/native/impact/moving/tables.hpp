// Entities that move, as kernels see them; costs/models/moving has the specification and the names of what stands here.
#pragma once
#include <cstdint>

namespace gp {

constexpr int kMaxPairs = 64;  // of a place and a time that stand for where an entity may be

struct PathKnot {
  double t, at[4], rate[4];  // x, y, z, yaw, and their rates until the next knot
};

struct MovingEntity {  // an upright box or cylinder on a predicted path
  int32_t round, n_knot, n_time;
  double half[3], spread, growth;  // half: half sizes of the upright box around it
  double top_speed, lowest;        // lowest: height of its bottom where the path is lowest
  const PathKnot* knot;
  const double* time;  // those that stand for the path where no time is known
};

struct MovingPaths {
  int32_t n_entity;
  const MovingEntity* entity;
};

struct MovingPlaces {
  int32_t n_place;
  const double* place;  // [n_place, 2]: they stand for a normal distribution with standard deviation 1
  double cell;          // standard deviation of what one of them stands for
  double protrusion;    // how far spheres stick out of what they cover [m]
};

// A value per state, and its derivatives with respect to q and qd [n, n_joint] and to the time; all are added to.
struct MovingSlopes {
  double *value, *d_q, *d_qd, *d_t;
};

}  // namespace gp

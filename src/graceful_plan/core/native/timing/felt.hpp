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
  std::vector<double> room;         // of each facet [m/s^2]
  double gravity;                   // [m/s^2]
  std::optional<SloshLimit> slosh;  // of what is carried there, if it has a surface
};

// How a point that something is felt at moves at an end of an interval, in the axes of its link.
struct FeltMotion {
  Vector3 velocity, bend, up;
};

struct IntervalEnd {
  size_t end;  // 0 for its beginning
  double step;
  const Box& box;
};

// A facet at one end of an interval.
struct FacetPlace {
  size_t limit, facet, end;
};

// The rows of all facets that may be the tightest somewhere in what the joints leave to their intervals.
class FeltRows {
 public:
  const CurveLimits& limits() const { return limits_; }
  const FacetPlace& place(size_t row) const { return place_[row]; }
  void clear() { limits_.clear(), place_.clear(); }
  // Of a limit, at one end of an interval: at its end the squared speed is x + 2 step u. No facet is left less room
  // than so much; returns the least that any has at rest. Motions that are slowed down to a share of their speed
  // afterwards may feel more before.
  double add(const FeltLimit& limit, size_t index, const FeltMotion& at, const IntervalEnd& of, double least_room,
             double speed = 1.0) {
    const double S = of.end ? 2 * of.step : 0.0, per = 1 / (speed * speed);
    double tightest = std::numeric_limits<double>::infinity();
    for (size_t f = 0; f < limit.facets.size(); ++f) {
      const Vector3& v = limit.facets[f];
      const double rest = limit.room[f] - limit.gravity * dot3(v, at.up), b = dot3(v, at.bend);
      const CurveLimits::Row row{dot3(v, at.velocity) + S * b, b, std::max(rest, least_room) * per};
      tightest = std::min(tightest, rest);
      if (of.box.meets(row)) limits_.row.push_back(row), place_.push_back({index, f, of.end});
    }
    return tightest;
  }
  // Any other row.
  void add(const CurveLimits::Row& row, const Box& box) {
    if (box.meets(row)) limits_.row.push_back(row), place_.push_back({});
  }
  void end_interval() { limits_.end_interval(); }

 private:
  CurveLimits limits_;
  std::vector<FacetPlace> place_;
};

}  // namespace gp

// Planar shapes of bases, entities and obstacles: rectangles that may be rounded and move. Distances are computed with
// doubles or duals. Everything is inlined, so each instruction set has its own copy.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>
#include <vector>

#include "dual.hpp"

namespace gp {

struct FloorShape {
  int entity;  // -1: an obstacle
  double x, y, ux, uy, a, b, round, vx, vy;
  double spread = 0;  // standard deviation of its position

  GP_INLINE double around() const { return length_of(a, b) + round; }  // radius of a circumscribed circle
  GP_INLINE double speed() const { return vx == 0 && vy == 0 ? 0.0 : length_of(vx, vy); }
  // Distance of a point at a time; inside the shape, minus the distance to its nearest side.
  template <class T> GP_INLINE T distance(const T& px, const T& py, const T& time) const {
    const T dx = px - x - vx * time, dy = py - y - vy * time;
    return from_middle(T(ux * dx + uy * dy), T(ux * dy - uy * dx));
  }
  // Distance of a point given in the shape's axes.
  template <class T> GP_INLINE T from_middle(const T& along, const T& across) const {
    const T ex = size_of(along) - a, ey = size_of(across) - b;
    const bool beside = value_of(ex) > 0, before = value_of(ey) > 0;
    if (beside && before) return length_of(ex, ey) - round;
    return larger(ex, ey) - round;
  }
};

// Footprint of a base: rectangles in its frame, possibly rounded, and a circle around them all.
class Footprint2d {
 public:
  explicit Footprint2d(const std::vector<FloorShape>& part) : part_(part) {
    for (const FloorShape& one : part_) {
      within_.push_back(one.around());
      reach_ = std::max(reach_, length_of(one.x, one.y) + within_.back());
    }
  }
  GP_INLINE double reach() const { return reach_; }
  const std::vector<FloorShape>& parts() const { return part_; }
  // Distance from the base, at a place and with a heading of this cosine and sine, to a shape at a time. Where they
  // overlap, minus the penetration depth. The deciding feature is found by values alone, without derivatives.
  template <class T>
  GP_INLINE T distance(const FloorShape& shape, const T& x, const T& y, const T& c, const T& s, const T& time) const {
    const Seen<double> seen = see(shape, value_of(x), value_of(y), value_of(c), value_of(s), value_of(time));
    const double around = shape.around();
    double least = std::numeric_limits<double>::infinity();
    size_t nearest = 0;
    int feature = 0;
    for (size_t k = 0; k < part_.size(); ++k) {
      if (length_of(seen.x - part_[k].x, seen.y - part_[k].y) - within_[k] - around >= least) continue;
      const Decided one = decide(part_[k], shape, seen);
      if (one.distance < least) least = one.distance, nearest = k, feature = one.feature;
    }
    if constexpr (std::is_same_v<T, double>)
      return least;
    else
      return measure(part_[nearest], shape, see(shape, x, y, c, s, time), feature);
  }

 private:
  // Position and direction of a shape in the frame of the base.
  template <class T> struct Seen {
    T x, y, ux, uy;
  };
  // Features that decide a distance: the centre of the shape or of the part, if it is a disc; the axis of least
  // overlap, if they overlap; otherwise a corner of either.
  enum Feature { kShape, kPart, kAxis, kCornerOfShape = kAxis + 4, kCornerOfPart = kCornerOfShape + 4 };
  struct Decided {
    double distance;
    int feature;
  };

  template <class T>
  GP_INLINE static Seen<T> see(const FloorShape& shape, const T& x, const T& y, const T& c, const T& s, const T& time) {
    const T dx = shape.x + shape.vx * time - x, dy = shape.y + shape.vy * time - y;
    return {c * dx + s * dy, c * dy - s * dx, c * shape.ux + s * shape.uy, c * shape.uy - s * shape.ux};
  }
  // Centre of the shape in the axes of the part, centre of the part in those of the shape, and the rotation between
  // them.
  template <class T> struct Turned {
    GP_INLINE Turned(const FloorShape& part, const Seen<T>& at) {
      const T dx = at.x - part.x, dy = at.y - part.y;
      x = part.ux * dx + part.uy * dy, y = part.ux * dy - part.uy * dx;
      back_x = -(at.ux * dx + at.uy * dy), back_y = at.uy * dx - at.ux * dy;
      c = part.ux * at.ux + part.uy * at.uy, s = part.ux * at.uy - part.uy * at.ux;
    }
    T x, y, back_x, back_y, c, s;
  };
  template <class T>
  GP_INLINE static T measure(const FloorShape& part, const FloorShape& shape, const Seen<T>& at, int feature) {
    const Turned<T> by(part, at);
    const double rounds = part.round + shape.round;
    if (feature == kShape) return part.from_middle(by.x, by.y) - shape.round;
    if (feature == kPart) return shape.from_middle(by.back_x, by.back_y) - part.round;
    if (feature < kCornerOfShape) return along_axis(part, shape, by, feature - kAxis) - rounds;
    const bool own = feature >= kCornerOfPart;
    const int corner = feature - (own ? kCornerOfPart : kCornerOfShape);
    const FloorShape &one = own ? shape : part, &other = own ? part : shape;
    const double a = corner & 1 ? other.a : -other.a, b = corner & 2 ? other.b : -other.b;
    const T x = own ? by.back_x + a * by.c + b * by.s : by.x + a * by.c - b * by.s;
    const T y = own ? by.back_y - a * by.s + b * by.c : by.y + a * by.s + b * by.c;
    return one.from_middle(x, y) + one.round - rounds;
  }
  template <class T>
  GP_INLINE static T along_axis(const FloorShape& part, const FloorShape& shape, const Turned<T>& by, int axis) {
    const T cc = size_of(by.c), ss = size_of(by.s);
    if (axis == 0) return size_of(by.x) - part.a - cc * shape.a - ss * shape.b;
    if (axis == 1) return size_of(by.y) - part.b - ss * shape.a - cc * shape.b;
    if (axis == 2) return size_of(by.back_x) - shape.a - cc * part.a - ss * part.b;
    return size_of(by.back_y) - shape.b - ss * part.a - cc * part.b;
  }
  GP_INLINE static Decided decide(const FloorShape& part, const FloorShape& shape, const Seen<double>& at) {
    if (shape.a == 0 && shape.b == 0) return {measure(part, shape, at, kShape), kShape};
    if (part.a == 0 && part.b == 0) return {measure(part, shape, at, kPart), kPart};
    const Turned<double> by(part, at);
    const double rounds = part.round + shape.round;
    Decided apart{along_axis(part, shape, by, 0), kAxis};
    for (int axis = 1; axis < 4; ++axis)
      if (const double d = along_axis(part, shape, by, axis); d > apart.distance) apart = {d, kAxis + axis};
    if (apart.distance <= 0) return {apart.distance - rounds, apart.feature};
    Decided nearest{std::numeric_limits<double>::infinity(), 0};
    for (int corner = kCornerOfShape; corner < kCornerOfPart + 4; ++corner)
      if (const double d = measure(part, shape, at, corner); d < nearest.distance) nearest = {d, corner};
    return nearest;
  }

  std::vector<FloorShape> part_;
  std::vector<double> within_;  // radii of circumscribed circles of the parts
  double reach_ = 0;
};

}  // namespace gp

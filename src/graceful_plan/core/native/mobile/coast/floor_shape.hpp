// What a base is from above, and what it meets: rectangles that may be rounded and move. Distances are of doubles and of
// duals; everything is inlined, so that each instruction set has its own.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "dual.hpp"

namespace gp {

struct FloorShape {
  int entity;  // -1: an obstacle
  double x, y, ux, uy, a, b, round, vx, vy;
  double spread = 0;  // standard deviation of its place

  GP_INLINE double around() const { return length_of(a, b) + round; }  // radius of a circle around it
  GP_INLINE double speed() const { return vx == 0 && vy == 0 ? 0.0 : length_of(vx, vy); }
  // Of a point at a time; inside of a rectangle minus the way to its nearest side.
  template <class T> GP_INLINE T distance(const T& px, const T& py, const T& time) const {
    const T dx = px - x - vx * time, dy = py - y - vy * time;
    return from_middle(T(ux * dx + uy * dy), T(ux * dy - uy * dx));
  }
  // The same of a point in the shape's own axes.
  template <class T> GP_INLINE T from_middle(const T& along, const T& across) const {
    const T ex = size_of(along) - a, ey = size_of(across) - b;
    const bool beside = value_of(ex) > 0, before = value_of(ey) > 0;
    if (beside && before) return length_of(ex, ey) - round;
    return larger(ex, ey) - round;
  }
};

// A base from above: rectangles in its frame that may be rounded, and a circle around them all.
class Footprint2d {
 public:
  explicit Footprint2d(const std::vector<FloorShape>& part) : part_(part) {
    for (const FloorShape& one : part_) {
      within_.push_back(one.around());
      reach_ = std::max(reach_, length_of(one.x, one.y) + within_.back());
    }
  }
  GP_INLINE double reach() const { return reach_; }
  // Of the base at a place, with a heading of this cosine and sine, to a shape at a time.
  template <class T>
  GP_INLINE T distance(const FloorShape& shape, const T& x, const T& y, const T& c, const T& s, const T& time) const {
    const T dx = shape.x + shape.vx * time - x, dy = shape.y + shape.vy * time - y;
    const Seen<T> seen{c * dx + s * dy, c * dy - s * dx, c * shape.ux + s * shape.uy, c * shape.uy - s * shape.ux};
    const double around = shape.around();
    T d(std::numeric_limits<double>::infinity());
    for (size_t k = 0; k < part_.size(); ++k) {
      const double apart = length_of(value_of(seen.x) - part_[k].x, value_of(seen.y) - part_[k].y);
      if (apart - within_[k] - around < value_of(d)) d = smaller(d, between(part_[k], shape, seen));
    }
    return d;
  }

 private:
  // Where a shape is as seen from the base, and its direction.
  template <class T> struct Seen {
    T x, y, ux, uy;
  };

  // Of a part and a shape that rest; where they overlap, minus the way that parts them.
  template <class T> GP_INLINE static T between(const FloorShape& part, const FloorShape& shape, const Seen<T>& at) {
    const T dx = at.x - part.x, dy = at.y - part.y;
    const T x = part.ux * dx + part.uy * dy, y = part.ux * dy - part.uy * dx;  // in the axes of the part
    if (shape.a == 0 && shape.b == 0) return part.from_middle(x, y) - shape.round;
    const T back_x = -(at.ux * dx + at.uy * dy), back_y = at.uy * dx - at.ux * dy;  // the part, in those of the shape
    if (part.a == 0 && part.b == 0) return shape.from_middle(back_x, back_y) - part.round;
    const T c = part.ux * at.ux + part.uy * at.uy, s = part.ux * at.uy - part.uy * at.ux;
    const T cc = size_of(c), ss = size_of(s);
    const T apart = larger(larger(size_of(x) - part.a - cc * shape.a - ss * shape.b,
                                  size_of(y) - part.b - ss * shape.a - cc * shape.b),
                           larger(size_of(back_x) - shape.a - cc * part.a - ss * part.b,
                                  size_of(back_y) - shape.b - ss * part.a - cc * part.b));
    const double rounds = part.round + shape.round;
    if (value_of(apart) <= 0) return apart - rounds;
    return smaller(nearest(part, shape, Seen<T>{x, y, c, s}),
                   nearest(shape, part, Seen<T>{back_x, back_y, c, T(-s)})) - rounds;
  }
  // Distance of the corners of the second from the first without its rounding, in the axes of the first.
  template <class T>
  GP_INLINE static T nearest(const FloorShape& one, const FloorShape& other, const Seen<T>& at) {
    T d(std::numeric_limits<double>::infinity());
    for (const double a : {-other.a, other.a})
      for (const double b : {-other.b, other.b})
        d = smaller(d, one.from_middle(T(at.x + a * at.ux - b * at.uy), T(at.y + a * at.uy + b * at.ux)));
    return d + one.round;
  }

  std::vector<FloorShape> part_;
  std::vector<double> within_;  // circles around them
  double reach_ = 0;
};

}  // namespace gp

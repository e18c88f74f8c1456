// Distances and touches at several places of a trajectory at once (SIMD). Included once per instruction set, inside its
// own namespace.
#pragma once
#include <cstddef>
#include <cstring>

#include "lanes.hpp"
#include "mobile/coast/floor_shape.hpp"

namespace gp::GP_ISA {

constexpr size_t kAbreastPlaces = size_t(kLanes<double>);

GP_INLINE D load_row(const double* from) {
  D values;
  std::memcpy(&values, from, sizeof(D));
  return values;
}
GP_INLINE void store_row(D values, double* to) { std::memcpy(to, &values, sizeof(D)); }

GP_INLINE D root_of(D x) { return square_root(maximum(x, D{} + 1e-200)); }
GP_INLINE D hypotenuse(D x, D y) { return root_of(x * x + y * y); }

// Probability that a standard normal variable exceeds x, accurate to 3e-13 for |x| <= 6.2: e^(-x^2/2) times a
// polynomial in 1 / (1 + x/4), fitted at Chebyshev nodes.
GP_INLINE D upper_tail(D x) {
  const D size = minimum(absolute(x), D{} + 8.0), t = 1.0 / (1.0 + 0.25 * size);
  const D tail = exponential(-0.5 * size * size) * horner(t, 3.760778425686284e-05, 0.09895096501783057,
                                                          0.10720110199643004, 0.05067068316457683, 0.24596325203425018,
                                                          -0.38495766714857715, 0.923851382636801, -1.228132720438457,
                                                          1.2713776041343292, -0.8688176058626289, 0.3566747688487137,
                                                          -0.08058237505294924, 0.007763002885206167);
  return x < 0 ? 1.0 - tail : tail;
}

// Places of a base, one per lane.
struct PlaceLanes {
  D x, y, cos, sin, time;
};

// Distances of points, given in the axes of a rectangle without rounding, to it.
GP_INLINE D from_rectangle(double a, double b, D x, D y) {
  const D ex = absolute(x) - a, ey = absolute(y) - b;
  return hypotenuse(relu(ex), relu(ey)) + minimum(maximum(ex, ey), D{});
}
GP_INLINE D beyond_squared(double a, double b, D x, D y) {
  const D ex = relu(absolute(x) - a), ey = relu(absolute(y) - b);
  return ex * ex + ey * ey;
}
// Footprint2d::distance for several places: exact below `cut`, elsewhere at least `cut`.
static inline D apart_abreast(const Footprint2d& base, const FloorShape& shape, const PlaceLanes& at, D cut) {
  const D dx = shape.x + shape.vx * at.time - at.x, dy = shape.y + shape.vy * at.time - at.y;
  const D seen_x = at.cos * dx + at.sin * dy, seen_y = at.cos * dy - at.sin * dx;
  const D ux = at.cos * shape.ux + at.sin * shape.uy, uy = at.cos * shape.uy - at.sin * shape.ux;
  const double around = shape.around();
  D least = cut;
  for (const FloorShape& part : base.parts()) {
    const D px = seen_x - part.x, py = seen_y - part.y;
    const D within = relu(least + (part.around() + around));
    if (!any_below(px * px + py * py, within * within)) continue;
    const D x = part.ux * px + part.uy * py, y = part.ux * py - part.uy * px;
    const double rounds = part.round + shape.round;
    if (shape.a == 0 && shape.b == 0) {
      least = minimum(least, from_rectangle(part.a, part.b, x, y) - rounds);
      continue;
    }
    const D back_x = -(ux * px + uy * py), back_y = uy * px - ux * py;
    if (part.a == 0 && part.b == 0) {
      least = minimum(least, from_rectangle(shape.a, shape.b, back_x, back_y) - rounds);
      continue;
    }
    const D c = part.ux * ux + part.uy * uy, s = part.ux * uy - part.uy * ux, cc = absolute(c), ss = absolute(s);
    const D overlap = maximum(
        maximum(absolute(x) - part.a - cc * shape.a - ss * shape.b, absolute(y) - part.b - ss * shape.a - cc * shape.b),
        maximum(absolute(back_x) - shape.a - cc * part.a - ss * part.b,
                absolute(back_y) - shape.b - ss * part.a - cc * part.b));
    if (!any_below(overlap - rounds, least)) continue;
    D squared = D{} + 1e300;
    for (const double a : {-1.0, 1.0})
      for (const double b : {-1.0, 1.0}) {
        const double sa = a * shape.a, sb = b * shape.b, pa = a * part.a, pb = b * part.b;
        squared = minimum(squared, beyond_squared(part.a, part.b, x + sa * c - sb * s, y + sa * s + sb * c));
        squared =
            minimum(squared, beyond_squared(shape.a, shape.b, back_x + pa * c + pb * s, back_y - pa * s + pb * c));
      }
    least = minimum(least, (overlap <= 0 ? overlap : root_of(squared)) - rounds);
  }
  return least;
}

}  // namespace gp::GP_ISA

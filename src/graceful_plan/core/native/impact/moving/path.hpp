// The predicted place of a moving entity at lanes of times, its outline, and distances to it.
#pragma once
#include <cstddef>

#include "impact/moving/tables.hpp"
#include "lanes.hpp"
#include "single.hpp"

namespace gp::GP_ISA::moving {

// The last knot not after a time, or the first one.
static inline int knot_before(const MovingEntity& e, double t) {
  int low = 0, high = e.n_knot;
  while (high - low > 1) {
    const int middle = (low + high) / 2;
    (e.knot[middle].t <= t ? low : high) = middle;
  }
  return low;
}

// Some of x, y, z and yaw, and their rates; the entity stands still before the first and after the last knot.
template <int kFirst, int kCount> static inline void follow(const MovingEntity& e, D t, D* at, D* rate) {
  const double begin = e.knot[0].t, end = e.knot[e.n_knot - 1].t;
  const D held = minimum(maximum(t, D{} + begin), D{} + end);
  const int first = knot_before(e, least_lane(held)), last = knot_before(e, greatest_lane(held));
  for (int i = 0; i < kCount; ++i) {
    const PathKnot& knot = e.knot[first];
    rate[i] = D{} + knot.rate[kFirst + i], at[i] = knot.at[kFirst + i] + (held - knot.t) * rate[i];
  }
  for (int k = first + 1; k <= last; ++k) {
    const PathKnot& knot = e.knot[k];
    const auto later = held >= knot.t;
    const D since = held - knot.t;
    for (int i = 0; i < kCount; ++i) {
      at[i] = where(later, knot.at[kFirst + i] + since * knot.rate[kFirst + i], at[i]);
      rate[i] = where(later, D{} + knot.rate[kFirst + i], rate[i]);
    }
  }
  const auto moves = (t > begin) & (t < end);
  for (int i = 0; i < kCount; ++i) rate[i] = where(moves, rate[i], D{});
}

struct Varying {
  D value, rate;
};

// Standard deviation of the entity's place.
static inline Varying spread_of(const MovingEntity& e, D t) {
  if (e.growth == 0) return {D{} + e.spread, D{}};
  const D grown = e.growth * relu(t - e.knot[0].t);
  const D value = square_root(grown * grown + (e.spread * e.spread + 1e-24));
  return {value, e.growth * grown * reciprocal(value)};
}

// The entity's outline seen from above, with its yaw; cylinders ignore the yaw.
struct Outline {
  bool round;
  double a, b;
  D cosine, sine;

  void turn(const MovingEntity& e, D yaw) {
    round = e.round != 0, a = e.half[0], b = e.half[1], cosine = D{} + 1.0, sine = D{};
    if (!round) sine_cosine(yaw, sine, cosine);
  }
  // Extent with a margin in a direction, given by components along the outline's axes.
  D reach(D x, D y, D margin) const {
    if (round) return maximum(a + margin, D{} + 1e-4);
    return maximum((a + margin) * absolute(x) + (b + margin) * absolute(y), D{} + 1e-4);
  }
};

// Signed distance of points to an upright box or cylinder, and its derivatives with respect to the point.
struct Apart {
  D value, x, y, z;

  // Derivative with respect to the entity's yaw; (dx, dy): from the entity's middle to the point.
  D turned(D dx, D dy) const { return x * dy - y * dx; }
};

static inline Apart apart(const Outline& o, double half, D dx, D dy, D dz) {
  Apart out;
  D beside;
  if (o.round) {
    const D rho = square_root(dx * dx + dy * dy + 1e-24), inverse = reciprocal(rho);
    beside = rho - o.a, out.x = dx * inverse, out.y = dy * inverse;
  } else {
    const D x = o.cosine * dx + o.sine * dy, y = o.cosine * dy - o.sine * dx;
    const D along = absolute(x) - o.a, across = absolute(y) - o.b, ox = relu(along), oy = relu(across);
    const D rho = square_root(ox * ox + oy * oy + 1e-24), inverse = reciprocal(rho);
    const auto inside = (along <= 0.0) & (across <= 0.0), first = along > across;
    beside = where(inside, maximum(along, across), rho);
    const D nx = where(inside, where(first, D{} + 1.0, D{}), ox * inverse);
    const D ny = where(inside, where(first, D{}, D{} + 1.0), oy * inverse);
    const D sx = where(x < 0.0, -nx, nx), sy = where(y < 0.0, -ny, ny);
    out.x = o.cosine * sx - o.sine * sy, out.y = o.sine * sx + o.cosine * sy;
  }
  const D above = absolute(dz) - half, up = where(dz < 0.0, D{} - 1.0, D{} + 1.0);
  const D ob = relu(beside), oz = relu(above), far = square_root(ob * ob + oz * oz + 1e-24), inverse = reciprocal(far);
  const auto inside = (beside <= 0.0) & (above <= 0.0), side = beside > above;
  out.value = where(inside, maximum(beside, above), far);
  const D share = where(inside, where(side, D{} + 1.0, D{}), ob * inverse);
  out.x *= share, out.y *= share, out.z = up * where(inside, where(side, D{}, D{} + 1.0), oz * inverse);
  return out;
}

// A large object that may be needed, built in preallocated memory; it has no destructor.
struct BuiltInPlace {
  static void* operator new(size_t, void* at) { return at; }
  static void operator delete(void*, void*) {}
};
template <class T> class Storage {
 public:
  T* get() const { return made_; }
  template <class... Given> T& make(const Given&... given) {
    return *(made_ = new (static_cast<void*>(bytes_)) T(given...));
  }
  void clear() { made_ = nullptr; }

 private:
  alignas(T) unsigned char bytes_[sizeof(T)];
  T* made_ = nullptr;
};

static inline double sum_of(D x) {
  double sum = 0;
  for (int i = 0; i < kAbreast<D>; ++i) sum += x[i];
  return sum;
}

// Times of up to W states; lanes past the end repeat the last one.
static inline D load_times(const double* t, size_t first, size_t n) {
  D out;
  for (int i = 0; i < kAbreast<D>; ++i) out[i] = t[first + size_t(i) < n ? first + size_t(i) : n - 1];
  return out;
}

}  // namespace gp::GP_ISA::moving

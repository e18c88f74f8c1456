// Bounds beyond collision for every configuration: axes within cones, points within boxes (rooms). Bounds are numbered
// cones first, then rooms. Each has a clearance, positive inside.
#pragma once
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

template <class V> static inline Vec<V> turned(const Frame<V>& X, const double v[3]) {
  using T = Scalar<V>;
  const T a = T(v[0]), b = T(v[1]), c = T(v[2]);
  return {X.R[0] * a + X.R[1] * b + X.R[2] * c, X.R[3] * a + X.R[4] * b + X.R[5] * c,
          X.R[6] * a + X.R[7] * b + X.R[8] * c};
}

template <class V> static inline V cosine(const Cone& cone, const Frame<V>* X_W) {
  using T = Scalar<V>;
  const Vec<V> axis = turned(X_W[cone.frame], cone.axis);
  return axis.x * T(cone.direction[0]) + axis.y * T(cone.direction[1]) + axis.z * T(cone.direction[2]);
}

// Distance of a point to the nearest side of its box, positive inside.
static inline F room_clearance(const Room& room, const Frame<F>* X_W) {
  const Frame<F>& X = X_W[room.frame];
  const Vec<F> turned_point = turned(X, room.point);
  const F p[3] = {X.p.x + turned_point.x - float(room.p[0]), X.p.y + turned_point.y - float(room.p[1]),
                  X.p.z + turned_point.z - float(room.p[2])};
  F least = F{} + 1e9f;
  for (int i = 0; i < 3; ++i) {
    const F at = p[0] * float(room.R[i]) + p[1] * float(room.R[3 + i]) + p[2] * float(room.R[6 + i]);
    least = minimum(least, minimum(at - float(room.lower[i]), float(room.upper[i]) - at));
  }
  return least;
}

// The lanes that violate some bound by `margin`.
static inline MaskF breaks(const Tables& tables, const Frame<F>* X_W, float margin) {
  MaskF out = {};
  for (int k = 0; k < tables.n_cone; ++k) {
    const double within = tables.cone[k].angle - double(margin) / kLever;
    out |= cosine(tables.cone[k], X_W) < float(__builtin_cos(within > 0 ? within : 0));
  }
  for (int k = 0; k < tables.n_room; ++k) out |= room_clearance(tables.room[k], X_W) < margin;
  return out;
}

// Calls visit(bound, clearance [m]) for each bound.
template <class Visit> static inline void for_each_bound(const Tables& tables, const Frame<F>* X_W, Visit visit) {
  for (int k = 0; k < tables.n_cone; ++k) {
    const F c = cosine(tables.cone[k], X_W);
    F clearance;
    for (int i = 0; i < kLanes<float>; ++i) {
      const double held = c[i] > 1 ? 1 : c[i] < -1 ? -1 : double(c[i]);
      clearance[i] = float(kLever * (tables.cone[k].angle - __builtin_acos(held)));
    }
    visit(k, clearance);
  }
  for (int k = 0; k < tables.n_room; ++k) visit(tables.n_cone + k, room_clearance(tables.room[k], X_W));
}

}  // namespace gp::GP_ISA

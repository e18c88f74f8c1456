// Forward kinematics of a tree of hinges and slides, W configurations at a time.
#pragma once
#include <cstddef>

#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// Computes the poses of all links that own a frame: the base, and every link with a joint, whose axis is its local z.
// Frames before `first` are already computed.
template <class V>
static inline void forward_kinematics(const Tables& tables, const V* q, Frame<V>* X_W, int first = 0) {
  using T = Scalar<V>;
  for (int l = first; l < tables.n_link; ++l) {
    const Link& link = tables.link[l];
    if (link.frame != l) continue;
    Frame<V>& X = X_W[l];
    if (link.parent < 0) {
      for (int k = 0; k < 9; ++k) X.R[k] = V{} + T(link.R[k]);
      X.p = {V{} + T(link.p[0]), V{} + T(link.p[1]), V{} + T(link.p[2])};
      continue;
    }
    const Frame<V>& P = X_W[tables.link[link.parent].frame];
    T C[9], t[3];
    for (int k = 0; k < 9; ++k) C[k] = T(link.R[k]);
    for (int k = 0; k < 3; ++k) t[k] = T(link.p[k]);
    V M[9];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        M[3 * i + j] = P.R[3 * i] * C[j] + P.R[3 * i + 1] * C[3 + j] + P.R[3 * i + 2] * C[6 + j];
    X.p = transform(P, t);
    if (link.slide) {
      for (int k = 0; k < 9; ++k) X.R[k] = M[k];
      X.p = {X.p.x + M[2] * q[link.joint], X.p.y + M[5] * q[link.joint], X.p.z + M[8] * q[link.joint]};
      continue;
    }
    V s, c;
    sine_cosine(q[link.joint], s, c);
    for (int i = 0; i < 3; ++i) {
      X.R[3 * i] = c * M[3 * i] + s * M[3 * i + 1];
      X.R[3 * i + 1] = c * M[3 * i + 1] - s * M[3 * i];
      X.R[3 * i + 2] = M[3 * i + 2];
    }
  }
}

// Loads up to W configurations; lanes past the end repeat the last configuration.
template <class V> static inline void load(const Tables& tables, const double* q, size_t first, size_t n, V* out) {
  using T = Scalar<V>;
  Lanes<T> values[kMaxJoints];
  for (int i = 0; i < kLanes<T>; ++i) {
    const double* row = q + (first + size_t(i) < n ? first + size_t(i) : n - 1) * size_t(tables.n_joint);
    for (int j = 0; j < tables.n_joint; ++j) values[j][i] = T(row[j]);
  }
  for (int j = 0; j < tables.n_joint; ++j) out[j] = V(values[j]);
}

template <class T>
static inline void interpolate(const Tables& tables, const double* q0, const double* q1, Lanes<T> s, Lanes<T>* out) {
  for (int j = 0; j < tables.n_joint; ++j) out[j] = T(q0[j]) + s * T(q1[j] - q0[j]);
}

static inline double distance(const Tables& tables, const double* q0, const double* q1) {
  double d2 = 0;
  for (int j = 0; j < tables.n_joint; ++j) d2 += (q1[j] - q0[j]) * (q1[j] - q0[j]);
  return __builtin_sqrt(d2);
}

}  // namespace gp::GP_ISA

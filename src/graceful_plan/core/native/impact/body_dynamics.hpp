// Rigid-body dynamics of an arm whose drives fail; letters as in costs/models/body. W states side by side.
#pragma once
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// Composite inertia of a frame and all frames beyond it: mass, first moment h and inertia J about the origin of W.
template <class V> struct Composite {
  V mass, h[3], J[6];  // J: xx yy zz xy xz yz

  void add(const Composite& other) {
    mass += other.mass;
    for (int i = 0; i < 3; ++i) h[i] += other.h[i];
    for (int i = 0; i < 6; ++i) J[i] += other.J[i];
  }
};

template <class V> static inline Composite<V> placed_inertia(const Inertia& rigid, const Frame<V>& X) {
  using T = Scalar<V>;
  T centre[3], I[9];
  for (int k = 0; k < 3; ++k) centre[k] = T(rigid.centre[k]);
  for (int k = 0; k < 9; ++k) I[k] = T(rigid.inertia[k]);
  const Vec<V> c = transform(X, centre);
  V A[9], R[6];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      A[3 * i + j] = X.R[3 * i] * I[j] + X.R[3 * i + 1] * I[3 + j] + X.R[3 * i + 2] * I[6 + j];
  constexpr int row[6] = {0, 1, 2, 0, 0, 1}, column[6] = {0, 1, 2, 1, 2, 2};
  for (int k = 0; k < 6; ++k) {
    const V *a = A + 3 * row[k], *b = X.R + 3 * column[k];
    R[k] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  }
  const T m = T(rigid.mass);
  return {V{} + m,
          {m * c.x, m * c.y, m * c.z},
          {R[0] + m * (c.y * c.y + c.z * c.z), R[1] + m * (c.x * c.x + c.z * c.z), R[2] + m * (c.x * c.x + c.y * c.y),
           R[3] - m * c.x * c.y, R[4] - m * c.x * c.z, R[5] - m * c.y * c.z}};
}

// Angular and linear velocity of the origin of W per unit velocity of a joint.
template <class V> struct Twist {
  Vec<V> w, v;
};

template <class V> static inline Twist<V> twist_of(const Link& link, const Frame<V>& X) {
  const Vec<V> z = {X.R[2], X.R[5], X.R[8]};
  if (link.slide) return {{V{}, V{}, V{}}, z};
  return {z, cross(X.p, z)};
}

template <class V> static inline Twist<V> momentum(const Composite<V>& c, const Twist<V>& t) {
  const Vec<V> h = {c.h[0], c.h[1], c.h[2]}, turn = cross(t.w, h), lever = cross(h, t.v);
  const V* J = c.J;
  return {{J[0] * t.w.x + J[3] * t.w.y + J[4] * t.w.z + lever.x, J[3] * t.w.x + J[1] * t.w.y + J[5] * t.w.z + lever.y,
           J[4] * t.w.x + J[5] * t.w.y + J[2] * t.w.z + lever.z},
          {c.mass * t.v.x + turn.x, c.mass * t.v.y + turn.y, c.mass * t.v.z + turn.z}};
}

template <class V> static inline V power(const Twist<V>& t, const Twist<V>& momentum) {
  return t.w.x * momentum.w.x + t.w.y * momentum.w.y + t.w.z * momentum.w.z + t.v.x * momentum.v.x +
         t.v.y * momentum.v.y + t.v.z * momentum.v.z;
}

template <class V> static inline V weight_torque(const Composite<V>& c, const Twist<V>& t) {
  return Scalar<V>(kGravity) * (t.w.x * c.h[1] - t.w.y * c.h[0] + c.mass * t.v.z);
}

// Computes the composites of all frames.
template <class V>
static inline void gather(const Tables& tables, const BodyTables& body, const Frame<V>* X_W, Composite<V>* all) {
  for (int l = 0; l < body.n_frame; ++l) all[l] = placed_inertia(body.inertia[l], X_W[l]);
  for (int l = body.n_frame - 1; l > 0; --l) all[tables.link[l].parent].add(all[l]);
}

// Computes the lower half of M and the gravity torques g.
template <class V>
static inline void mass_and_weight(const Tables& tables, const BodyTables& body, const Frame<V>* X_W, V M[][kMaxJoints],
                                   V* g) {
  Composite<V> all[kMaxJoints + 1];
  Twist<V> twist[kMaxJoints + 1];
  gather(tables, body, X_W, all);
  for (int l = 0; l < body.n_frame; ++l)
    if (tables.link[l].joint >= 0) twist[l] = twist_of(tables.link[l], X_W[l]);
  for (int i = 0; i < tables.n_joint; ++i)
    for (int j = 0; j < tables.n_joint; ++j) M[i][j] = V{};
  for (int j = 0; j < tables.n_joint; ++j) {
    const int link = body.drive[j].link;
    const Twist<V> moves = momentum(all[link], twist[link]);
    g[j] = weight_torque(all[link], twist[link]);
    for (int l = link; l >= 0; l = tables.link[l].parent) {
      const int i = tables.link[l].joint;
      if (i >= 0) M[i][j] = M[j][i] = power(twist[l], moves);
    }
    M[j][j] += Scalar<V>(body.drive[j].armature);
  }
}

// Solves A x = b by Cholesky's method; A is overwritten.
template <class V> static inline void solve(V A[][kMaxJoints], V* b, int n) {
  for (int j = 0; j < n; ++j) {
    V d = A[j][j];
    for (int k = 0; k < j; ++k) d -= A[j][k] * A[j][k];
    const V inverse = inverse_root(d);
    A[j][j] = inverse;
    for (int i = j + 1; i < n; ++i) {
      V x = A[i][j];
      for (int k = 0; k < j; ++k) x -= A[i][k] * A[j][k];
      A[i][j] = x * inverse;
    }
  }
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= A[i][k] * b[k];
    b[i] *= A[i][i];
  }
  for (int i = n - 1; i >= 0; --i) {
    for (int k = i + 1; k < n; ++k) b[i] -= A[k][i] * b[k];
    b[i] *= A[i][i];
  }
}

template <class V> static inline V towards_zero(V v, V by) { return v > 0 ? relu(v - by) : -relu(-v - by); }

template <class V> static inline V within(const JointDrive& drive, V x) {
  using T = Scalar<V>;
  return minimum(maximum(x, V{} + T(drive.lower)), V{} + T(drive.upper));
}

// Moves a joint by the mean of two velocities; at a limit its velocity becomes 0.
template <class V> static inline void move_joint(const JointDrive& drive, V& x, V& v, V next, double h) {
  using T = Scalar<V>;
  const V to = x + T(0.5 * h) * (v + next);
  v = (to < T(drive.lower)) | (to > T(drive.upper)) ? V{} : next;
  x = within(drive, to);
}

template <class V>
static inline void fall_together(const Tables& tables, const BodyTables& body, const Frame<V>* X_W, double h, V* x,
                                 V* v) {
  using T = Scalar<V>;
  const int n = tables.n_joint;
  V M[kMaxJoints][kMaxJoints], g[kMaxJoints], next[kMaxJoints], slip[kMaxJoints];
  mass_and_weight(tables, body, X_W, M, g);
  for (int i = 0; i < n; ++i) {
    next[i] = T(-h) * g[i];
    for (int j = 0; j < n; ++j) next[i] += M[i][j] * v[j];
  }
  for (int i = 0; i < n; ++i) {
    M[i][i] += T(h * body.drive[i].damping);
    slip[i] = T(h * body.drive[i].friction) * reciprocal(M[i][i]);
  }
  solve(M, next, n);
  for (int i = 0; i < n; ++i) move_joint(body.drive[i], x[i], v[i], towards_zero(next[i], slip[i]), h);
}

// Gravity torque on a joint turned by an angle from its expected position: g (still cos + turned sin).
template <class V> struct Load {
  V still, turned;

  V torque(V sine, V cosine) const { return Scalar<V>(kGravity) * (still * cosine + turned * sine); }
};

template <class V> static inline Load<V> load_on(const Link& link, const Composite<V>& c, const Frame<V>& X) {
  const Vec<V> a = {X.R[2], X.R[5], X.R[8]};
  if (link.slide) return {c.mass * a.z, V{}};
  const Vec<V> u = {c.h[0] - c.mass * X.p.x, c.h[1] - c.mass * X.p.y, c.h[2] - c.mass * X.p.z};
  return {a.x * u.y - a.y * u.x, a.z * (a.x * u.x + a.y * u.y + a.z * u.z) - u.z};
}

template <class V> struct JointMotion {
  V x, v;
};

// One step of a joint without power, with its own inertia and the load of the links beyond it.
template <class V>
static inline void fall_alone(const JointDrive& drive, double h, V inertia, V torque, JointMotion<V>& motion) {
  using T = Scalar<V>;
  const V share = reciprocal(inertia + T(h * (drive.damping + drive.resistance)));
  const V next = (inertia * motion.v - T(h) * torque) * share;
  move_joint(drive, motion.x, motion.v, towards_zero(next, T(h * drive.friction) * share), h);
}

}  // namespace gp::GP_ISA

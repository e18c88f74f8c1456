// The arm in one configuration, and the distances of its limbs to obstacles.
#pragma once
#include <cstdint>

#include "geometry/clearance.hpp"
#include "geometry/tangent.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

constexpr double kSlack = 1e-5;    // margin above rounding for distances that are ruled out [m]
constexpr double kAnywhere = 1e9;  // a distance beyond all others [m]

// --- configurations -------------------------------------------------------------------------------------------------

template <class V> static inline Vec<V> moved(const Frame<V>& T, const Vec<V>& p) {
  const V* R = T.R;
  return {T.p.x + R[0] * p.x + R[1] * p.y + R[2] * p.z, T.p.y + R[3] * p.x + R[4] * p.y + R[5] * p.z,
          T.p.z + R[6] * p.x + R[7] * p.y + R[8] * p.z};
}
template <class V> static inline Frame<V> moved(const Frame<V>& T, const Frame<V>& X) {
  Frame<V> Y;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      Y.R[3 * i + j] = T.R[3 * i] * X.R[j] + T.R[3 * i + 1] * X.R[3 + j] + T.R[3 * i + 2] * X.R[6 + j];
  Y.p = moved(T, X.p);
  return Y;
}

// Transform in W of everything beyond a joint when the joint moves by an angle or a distance; X: the joint's frame.
template <class V> static inline Frame<V> joint_motion(const Link& link, const Frame<V>& X, V by, V sine, V cosine) {
  const Vec<V> a = {X.R[2], X.R[5], X.R[8]}, o = X.p;
  const V one = V{} + 1;
  if (link.slide) return {{one, V{}, V{}, V{}, one, V{}, V{}, V{}, one}, {a.x * by, a.y * by, a.z * by}};
  const V rest = one - cosine, xy = rest * a.x * a.y, xz = rest * a.x * a.z, yz = rest * a.y * a.z;
  Frame<V> T = {
      {cosine + rest * a.x * a.x, xy - sine * a.z, xz + sine * a.y, xy + sine * a.z, cosine + rest * a.y * a.y,
       yz - sine * a.x, xz - sine * a.y, yz + sine * a.x, cosine + rest * a.z * a.z},
      {V{}, V{}, V{}}};
  const Vec<V> to = moved(T, o);
  T.p = {o.x - to.x, o.y - to.y, o.z - to.z};
  return T;
}

// The arm in one configuration: frames, centres of limbs, upper bounds of the rotation of frames since the failure.
template <class V> struct Stance {
  Frame<V>* X_W;   // [frame]
  Vec<V>* centre;  // [limb]
  V* turned;       // [frame]
};

// A stance, in which the links beyond a joint may have moved by T.
template <class V> class Place {
 public:
  Frame<V> T;
  Frame<V>* moved_frames = nullptr;  // [frame] storage for moved frames

  void set(const Stance<V>& at) { at_ = &at, hanging_ = known_ = 0; }
  void set(const Stance<V>& at, uint64_t hanging, const Frame<V>& motion, V more) {
    T = motion, at_ = &at, hanging_ = hanging, known_ = 0, more_ = more;
  }
  Vec<V> centre(int limb, int frame) const { return hangs(frame) ? moved(T, at_->centre[limb]) : at_->centre[limb]; }
  V turned(int frame) const { return hangs(frame) ? at_->turned[frame] + more_ : at_->turned[frame]; }
  const Frame<V>& frame(int frame) {
    if (!hangs(frame)) return at_->X_W[frame];
    if (!(known_ >> frame & 1)) moved_frames[frame] = moved(T, at_->X_W[frame]);
    known_ |= uint64_t(1) << frame;
    return moved_frames[frame];
  }

 private:
  bool hangs(int frame) const { return hanging_ >> frame & 1; }

  const Stance<V>* at_ = nullptr;
  uint64_t hanging_ = 0, known_ = 0;
  V more_ = {};
};

// --- distances ------------------------------------------------------------------------------------------------------

// A direction in W, in the axes of a frame.
template <class V> static inline Vec<V> seen_from(const Frame<V>& X, const Vec<V>& n) {
  const V* R = X.R;
  return {R[0] * n.x + R[3] * n.y + R[6] * n.z, R[1] * n.x + R[4] * n.y + R[7] * n.z,
          R[2] * n.x + R[5] * n.y + R[8] * n.z};
}

// A tangent plane below a distance, in the axes of a frame.
template <class V> struct Plane {
  Vec<V> n;
  V base;

  Plane(const Frame<V>& X, const Tangent<V>& t, const float* touched) : n(seen_from(X, t.n)) {
    base = t.d - dot(n, touched) - float(kSlack);
  }
  V at(const float* p) const { return base + dot(n, p); }
};

// Largest extent of a limb from its centre against a direction of its frame.
template <class V> static inline V reach_of(const Limb& limb, const Vec<V>& n) {
  return absolute(n.x) * limb.half[0] + absolute(n.y) * limb.half[1] + absolute(n.z) * limb.half[2] + limb.radius;
}

// A least distance and, if kNamed, the sphere that has it.
template <class V, bool kNamed> struct Least {
  V d;
  Mask<Scalar<V>> sphere;

  void update(V other, int which) {
    if constexpr (kNamed) sphere = other < d ? Mask<Scalar<V>>{} + which : sphere;
    d = minimum(d, other);
  }
};

// Not inlined, so that loops over spheres stay small.
template <class V>
[[gnu::noinline]] static V other_distance(const Tables& tables, const Obstacle& o, const Vec<V>& point, V far) {
  return signed_distance(tables, o, point, far);
}

// Updates `least` with the distances of a cluster's spheres to an obstacle. The plane rules out most spheres.
template <class V, bool kNamed>
[[gnu::always_inline]] static inline void look_at_cluster(const Tables& tables, const Obstacle& o,
                                                          const Cluster& cluster, const Frame<V>& X,
                                                          const Plane<V>& plane, Least<V, kNamed>& least) {
  unsigned left = 0;
  const float* first = tables.sphere + 4 * cluster.first;
  for (int k = 0; k < cluster.count; ++k) {
    const float* s = first + 4 * k;
    left |= unsigned(any_below(plane.at(s) - s[3], least.d)) << k;
  }
  for (bool again = false; left; left &= left - 1, again = true) {
    const int k = __builtin_ctz(left);
    const float* s = first + 4 * k;
    if (again && !any_below(plane.at(s) - s[3], least.d)) continue;
    const Vec<V> p = transform(X, s);
    const V d = o.kind == kBox ? box_distance(o.size, local(o, p)) : other_distance(tables, o, p, relu(least.d + s[3]));
    least.update(d - s[3], cluster.first + k);
  }
}

// look_at_cluster() for obstacles with expensive distances: each evaluated sphere gives a new plane for the others.
template <class V, bool kNamed>
[[gnu::noinline]] static void look_sparingly(const Tables& tables, const Obstacle& o, const Cluster& cluster,
                                             const Frame<V>& X, const Plane<V>& plane, Least<V, kNamed>& least) {
  V low[kClusterSize];
  const float* first = tables.sphere + 4 * cluster.first;
  for (int k = 0; k < cluster.count; ++k) low[k] = plane.at(first + 4 * k) - first[4 * k + 3];
  for (unsigned done = 0;;) {
    int next = -1;
    for (int k = 0; k < cluster.count; ++k)
      if (!(done >> k & 1) && any_below(low[k], least.d) && (next < 0 || low[k][0] < low[next][0])) next = k;
    if (next < 0) return;
    done |= 1u << next;
    const float* s = first + 4 * next;
    const Vec<V> p = transform(X, s);
    const Tangent<V> t = tangent(tables, o, p);
    const V d = o.kind == kMesh ? t.d : other_distance(tables, o, p, relu(least.d + s[3]));
    least.update(d - s[3], cluster.first + next);
    const Plane<V> here(X, t, s);
    for (int k = 0; k < cluster.count; ++k) low[k] = maximum(low[k], here.at(first + 4 * k) - first[4 * k + 3]);
  }
}

template <class V, bool kNamed>
static inline void look_at_limb(const Tables& tables, const Obstacle& o, const Limb& limb, const Frame<V>& X,
                                const Plane<V>& plane, Least<V, kNamed>& least) {
  const bool dear = o.kind == kMesh || o.kind == kEllipsoid;
  for (int c = limb.first_cluster; c < limb.first_cluster + limb.n_cluster; ++c) {
    const Cluster& cluster = tables.cluster[c];
    if (limb.n_cluster > 1 && !any_below(plane.at(cluster.bound) - cluster.bound[3], least.d)) continue;
    if (dear)
      look_sparingly(tables, o, cluster, X, plane, least);
    else
      look_at_cluster(tables, o, cluster, X, plane, least);
  }
}

}  // namespace gp::GP_ISA

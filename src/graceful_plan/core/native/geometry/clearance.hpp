// Distances of links' spheres to exact primitives, convex hulls and each other. Each pair of a link and an obstacle is
// first tested with bounding spheres, which mostly settles it.
#pragma once
#include "geometry/one_lane.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// A square root that allows 0; square_root of doubles in lanes.hpp does not.
static inline F root(F a) { return square_root(a); }
static inline Lanes<double> root(Lanes<double> a) { return square_root(maximum(a, Lanes<double>{} + 1e-60)); }

template <class V> static inline V dot(const Vec<V>& a, const float b[3]) {
  return a.x * b[0] + a.y * b[1] + a.z * b[2];
}

template <class V> [[gnu::always_inline]] static inline Vec<V> local(const Obstacle& o, const Vec<V>& point) {
  Vec<V> d = {point.x - o.p[0], point.y - o.p[1], point.z - o.p[2]};
  return {d.x * o.R[0] + d.y * o.R[3] + d.z * o.R[6], d.x * o.R[1] + d.y * o.R[4] + d.z * o.R[7],
          d.x * o.R[2] + d.y * o.R[5] + d.z * o.R[8]};
}

template <class V> static inline V box_distance(const float half[3], const Vec<V>& p) {
  V x = absolute(p.x) - half[0], y = absolute(p.y) - half[1], z = absolute(p.z) - half[2];
  V ox = relu(x), oy = relu(y), oz = relu(z);
  V inside = maximum(x, maximum(y, z));
  return root(ox * ox + oy * oy + oz * oz) + minimum(inside, V{});
}

template <class V> static inline V cylinder_distance(float radius, float half, const Vec<V>& p) {
  V r = root(p.x * p.x + p.y * p.y) - radius, z = absolute(p.z) - half;
  V out_r = relu(r), out_z = relu(z);
  return root(out_r * out_r + out_z * out_z) + minimum(maximum(r, z), V{});
}

template <class V> static inline V capsule_distance(float radius, float half, const Vec<V>& p) {
  V z = p.z - minimum(maximum(p.z, V{} - half), V{} + half);
  return root(p.x * p.x + p.y * p.y + z * z) - radius;
}

// Parameter t of the nearest point r_i^2 y_i / (t + r_i^2) on an ellipsoid to a point y outside. Newton's method solves
// the convex secular equation from below (Eberly, "Distance from a point to an ellipse, an ellipsoid"). r: semi-axes;
// k: the norm of y that is 1 on the ellipsoid.
template <class V> static inline V ellipsoid_parameter(const float r[3], const V y[3], V k, float r_min) {
  const V settled = V{} + Scalar<V>(sizeof(Scalar<V>) == 4 ? 1e-7 : 1e-15);
  V t = relu((k - 1.f) * (r_min * r_min));
  for (int step = 0; step < 8; ++step) {
    V g = V{} - 1.f, slope = {};
    for (int i = 0; i < 3; ++i) {
      V inverse = reciprocal(t + r[i] * r[i]);
      V u = r[i] * y[i] * inverse;
      g += u * u;
      slope += u * u * inverse;
    }
    const V further = relu(g * reciprocal(2.f * slope + 1e-20f));
    t += further;
    if (!any(further > settled * t)) break;
  }
  return t;
}
static inline float least_of(const float r[3]) {
  const float least = r[0] < r[1] ? r[0] : r[1];
  return least < r[2] ? least : r[2];
}

// A lower bound of the distance; inside, (k - 1) r_min, which has the right sign and bounds the size.
template <class V> static inline V ellipsoid_distance(const float r[3], const Vec<V>& p) {
  const V y[3] = {p.x, p.y, p.z};
  V k2 = {}, d2 = {};
  for (int i = 0; i < 3; ++i) k2 += y[i] * y[i] * (1.f / (r[i] * r[i]));
  const float r_min = least_of(r);
  const V k = root(k2), t = ellipsoid_parameter(r, y, k, r_min);
  for (int i = 0; i < 3; ++i) {
    V d = y[i] * t * reciprocal(t + r[i] * r[i]);
    d2 += d * d;
  }
  V lower_bound = (k - 1.f) * r_min;
  return k > 1.f ? maximum(root(d2) - 1e-6f, lower_bound) : lower_bound;
}

template <class V> static inline V squared(const Vec<V>& a) { return a.x * a.x + a.y * a.y + a.z * a.z; }

// Vector to a point from the nearest point of an edge of a face.
template <class V> static inline Vec<V> from_edge(const Vec<V>& p, const Triangle& t, int i) {
  const float *a = i == 0 ? t.a : i == 1 ? t.b : t.c, *e = t.edge[i];
  const Vec<V> d = {p.x - a[0], p.y - a[1], p.z - a[2]};
  const V s = minimum(maximum(dot(d, e) * e[3], V{}), V{} + 1.f);
  return {d.x - s * e[0], d.y - s * e[1], d.z - s * e[2]};
}

// Lower bound of the distance of a point outside the prism over a face; negative inside the prism.
template <class V> static inline V outside_of(const Vec<V>& p, const Triangle& t) {
  const float (&n)[3][4] = t.inward;
  return maximum(n[0][3] - dot(p, n[0]), maximum(n[1][3] - dot(p, n[1]), n[2][3] - dot(p, n[2])));
}

// Calls visit(face, height, outside) for the faces that see points from outside and may be nearer than sqrt(nearest),
// which visit may lower. Returns the largest height of each point over a face.
template <class V, class Visit>
static inline V for_each_near_face(const Tables& tables, const Obstacle& o, const Vec<V>& p, const V& nearest,
                                   Visit visit) {
  V highest = V{} - 1e30f;
  for (int k = o.first_triangle; k < o.first_triangle + o.n_triangle; ++k) {
    const Triangle& t = tables.triangle[k];
    const V height = dot(p, t.normal) - t.offset;
    highest = maximum(highest, height);
    if (!any_below(V{}, height)) continue;
    const V outside = outside_of(p, t), beside = relu(outside);
    if (any((height > 0.f) & (height * height + beside * beside < nearest))) visit(t, height, outside);
  }
  return highest;
}

// Distance to a hull where below `far`. The nearest face sees p: inside the prism over it, the distance is that to its
// plane, otherwise that to one of its edges.
template <class V>
static inline V mesh_distance(const Tables& tables, const Obstacle& o, const Vec<V>& p, V far = V{} + 1e15f) {
  V nearest = far * far;
  const V highest = for_each_near_face(tables, o, p, nearest, [&](const Triangle& t, V height, V outside) {
    const V edge =
        minimum(squared(from_edge(p, t, 0)), minimum(squared(from_edge(p, t, 1)), squared(from_edge(p, t, 2))));
    nearest = minimum(nearest, outside > 0.f ? (height > 0.f ? edge : nearest) : height * height);
  });
  return highest > 0.f ? root(nearest) : highest;
}

// Signed distance to an obstacle; for meshes, only where below `far` > 0.
template <class V>
static inline V signed_distance(const Tables& tables, const Obstacle& o, const Vec<V>& point, V far = V{} + 1e15f) {
  switch (o.kind) {
    case kPlane:
      return local(o, point).z;
    case kSphere:
      return root(squared_distance(point, {V{} + o.p[0], V{} + o.p[1], V{} + o.p[2]})) - o.size[0];
    case kCapsule:
      return capsule_distance(o.size[0], o.size[1], local(o, point));
    case kEllipsoid:
      return ellipsoid_distance(o.size, local(o, point));
    case kCylinder:
      return cylinder_distance(o.size[0], o.size[1], local(o, point));
    case kBox:
      return box_distance(o.size, local(o, point));
    default:
      return mesh_distance(tables, o, point, far);
  }
}

template <class V> static inline auto near_bound(const Obstacle& o, const Vec<V>& centre, V reach) {
  if (o.bound[3] < 0.f) return V{} == V{};
  V r = reach + o.bound[3];
  V dx = centre.x - o.bound[0], dy = centre.y - o.bound[1], dz = centre.z - o.bound[2];
  return dx * dx + dy * dy + dz * dz < r * r;
}

// If a face's plane separates the sphere from the hull, they do not touch; distances to triangles are computed only for
// the few other spheres.
static inline MaskF touches_mesh(const Tables& tables, const Obstacle& o, const Vec<F>& centre, float radius) {
  if (!any(near_bound(o, centre, F{} + radius))) return MaskF{};
  F deepest = F{} - 1e30f;
  for (int k = 0; k < o.n_triangle; ++k) {
    const Triangle& t = tables.triangle[o.first_triangle + k];
    deepest = maximum(deepest, dot(centre, t.normal) - t.offset);
  }
  if (!any(deepest < radius)) return MaskF{};
  return mesh_distance(tables, o, centre) < radius;
}

// Whether a sphere touches an obstacle; for boxes, the most common kind, without a square root.
static inline MaskF touches(const Tables& tables, const Obstacle& o, const Vec<F>& centre, float radius) {
  if (o.kind == kMesh) return touches_mesh(tables, o, centre, radius);
  if (o.kind != kBox) return signed_distance(tables, o, centre) < radius;
  Vec<F> p = local(o, centre);
  F x = relu(absolute(p.x) - o.size[0]), y = relu(absolute(p.y) - o.size[1]), z = relu(absolute(p.z) - o.size[2]);
  return x * x + y * y + z * z < radius * radius;
}

// World positions of bounding spheres, and of clusters and spheres once they are needed.
struct Placed {
  const Tables& tables;
  const Frame<F>* X_W;
  Vec<F> bound[kMaxLinks];
  Vec<F> cluster[kMaxClusters];
  Vec<F> sphere[kMaxSpheres];
  bool ready[kMaxLinks], ready_clusters[kMaxLinks];

  Placed(const Tables& t, const Frame<F>* X) : tables(t), X_W(X) {
    for (int g = 0; g < t.n_group; ++g) {
      bound[g] = transform(X[t.group[g].frame], t.group[g].bound);
      ready[g] = ready_clusters[g] = false;
    }
  }
  // Centres of the bounding spheres of clusters, indexed by cluster.
  const Vec<F>* clusters(int g) {
    const Group& group = tables.group[g];
    if (!ready_clusters[g])
      for (int c = group.first_cluster; c < group.first_cluster + group.n_cluster; ++c)
        cluster[c] = transform(X_W[group.frame], tables.cluster[c].bound);
    ready_clusters[g] = true;
    return cluster;
  }
  const Vec<F>* spheres(int g) {
    const Group& group = tables.group[g];
    if (!ready[g])
      for (int k = group.first; k < group.first + group.count; ++k)
        sphere[k] = transform(X_W[group.frame], tables.sphere + 4 * k);
    ready[g] = true;
    return sphere;
  }
};

// Calls visit(j) for obstacles that may be within reach(keep) of points, until visit returns true; keep: distance to
// keep.
template <class Reach, class Visit>
static inline bool for_each_obstacle_near(const Tables& tables, const Vec<F>& p, Reach reach, Visit visit) {
  for (int k = 0; k < tables.n_boundless; ++k)
    if (visit(tables.order[k])) return true;
  for (int n = 0; n < tables.n_cell;) {
    const Cell& cell = tables.cell[n];
    const F r = reach(cell.keep), x = relu(absolute(p.x - cell.centre[0]) - cell.half[0]),
            y = relu(absolute(p.y - cell.centre[1]) - cell.half[1]),
            z = relu(absolute(p.z - cell.centre[2]) - cell.half[2]);
    if (!any(x * x + y * y + z * z < r * r)) {
      n = cell.next;
      continue;
    }
    for (int k = cell.first; k < cell.first + cell.count; ++k)
      if (visit(tables.order[k])) return true;
    ++n;
  }
  return false;
}

// Adds the lanes in which spheres of two links are closer than allowed.
template <bool first_hit> static inline void touching_links(Placed& placed, int p, float margin, MaskF& hit) {
  const Tables& tables = placed.tables;
  const int a = tables.pair[2 * p], b = tables.pair[2 * p + 1];
  const Group &ga = tables.group[a], &gb = tables.group[b];
  const float kept = margin + tables.slack[p], reach = relu(ga.bound[3] + gb.bound[3] + kept);
  if (!any(squared_distance(placed.bound[a], placed.bound[b]) < reach * reach)) return;
  const Vec<F>*ca = placed.clusters(a), *cb = placed.clusters(b);
  for (int c = ga.first_cluster; c < ga.first_cluster + ga.n_cluster; ++c) {
    const Cluster& mine = tables.cluster[c];
    const float r = relu(mine.bound[3] + gb.bound[3] + kept);
    if (ga.n_cluster > 1 && !any(squared_distance(ca[c], placed.bound[b]) < r * r)) continue;
    for (int d = gb.first_cluster; d < gb.first_cluster + gb.n_cluster; ++d) {
      const Cluster& other = tables.cluster[d];
      const float rc = relu(mine.bound[3] + other.bound[3] + kept);
      const int near = lanes_set((squared_distance(ca[c], cb[d]) < rc * rc) & ~hit);
      if (!near) continue;
      if (are_few(near)) {
        for_each_lane(near, [&](int lane) {
          const InOneLane one(tables, placed.X_W[ga.frame], c, lane), two(tables, placed.X_W[gb.frame], d, lane);
          if (touch(one, mine.count, two, kept)) hit[lane] = -1;
        });
      } else {
        const Vec<F>*sa = placed.spheres(a), *sb = placed.spheres(b);
        for (int k = mine.first; k < mine.first + mine.count; ++k) {
          const float ra = tables.sphere[4 * k + 3] + kept, rb = relu(ra + other.bound[3]);
          if (mine.count > 1 && !any(squared_distance(sa[k], cb[d]) < rb * rb)) continue;
          for (int m = other.first; m < other.first + other.count; ++m) {
            const float r = relu(ra + tables.sphere[4 * m + 3]);
            hit |= squared_distance(sa[k], sb[m]) < r * r;
          }
        }
      }
      if (first_hit ? any(hit) : all(hit)) return;
    }
  }
}

// The lanes in collision. With `first_hit`, it returns once any lane is: one colliding state invalidates an edge.
template <bool first_hit> static inline MaskF collides(const Tables& tables, const Frame<F>* X_W, float margin) {
  Placed placed(tables, X_W);
  MaskF hit = {};
  for (int g = tables.n_group - 1; g >= 0; --g) {  // outermost links first, since they move most
    const Group& group = tables.group[g];
    if (group.frame == 0) continue;  // the base does not move
    const auto reach = [&](float keep) { return F{} + (group.bound[3] + margin + keep); };
    const bool enough = for_each_obstacle_near(tables, placed.bound[g], reach, [&](int j) {
      const Obstacle& o = tables.obstacle[j];
      if (o.ignores >> group.link & 1) return false;
      const float kept = margin + o.keep;
      if (!any(near_bound(o, placed.bound[g], F{} + (group.bound[3] + kept)))) return false;
      if (!any(touches(tables, o, placed.bound[g], group.bound[3] + kept))) return false;
      const Vec<F>*sphere = placed.spheres(g), *centre = placed.clusters(g);
      for (int c = group.first_cluster; c < group.first_cluster + group.n_cluster; ++c) {
        const Cluster& cluster = tables.cluster[c];
        if (group.n_cluster > 1 && !any(touches(tables, o, centre[c], cluster.bound[3] + kept))) continue;
        for (int k = cluster.first; k < cluster.first + cluster.count; ++k)
          hit |= touches(tables, o, sphere[k], tables.sphere[4 * k + 3] + kept);
        if (first_hit ? any(hit) : all(hit)) return true;
      }
      return false;
    });
    if (enough) return hit;
  }
  for (int p = 0; p < tables.n_pair; ++p) {
    touching_links<first_hit>(placed, p, margin, hit);
    if (first_hit ? any(hit) : all(hit)) return hit;
  }
  return hit;
}

}  // namespace gp::GP_ISA

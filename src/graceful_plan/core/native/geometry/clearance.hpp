// Spheres that ride on links against exact primitives, convex hulls and each other.
// Every pair of a link and an obstacle is first tried with bounding spheres; most of the time that is all.

// A square root that takes zero; that of doubles in lanes.hpp does not.
static inline F root(F a) { return square_root(a); }
static inline Lanes<double> root(Lanes<double> a) { return square_root(maximum(a, Lanes<double>{} + 1e-60)); }

template <class V> static inline V dot(const Vec<V>& a, const float b[3]) {
  return a.x * b[0] + a.y * b[1] + a.z * b[2];
}

template <class V> static inline Vec<V> local(const Obstacle& o, const Vec<V>& point) {
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

// Outside: Newton on the convex secular equation (Eberly, "Distance from a point to an ellipse, an ellipsoid") from
// below, so that the result never exceeds the distance. Inside: (k - 1) r_min, right in sign and a bound in size.
template <class V> static inline V ellipsoid_distance(const float r[3], const Vec<V>& p) {
  const V y[3] = {p.x, p.y, p.z};
  V k2 = {};
  for (int i = 0; i < 3; ++i) k2 += y[i] * y[i] * (1.f / (r[i] * r[i]));
  float r_min = r[0] < r[1] ? r[0] : r[1];
  r_min = r_min < r[2] ? r_min : r[2];
  V k = root(k2);
  V t = relu((k - 1.f) * (r_min * r_min));
  for (int step = 0; step < 8; ++step) {
    V g = V{} - 1.f, slope = {};
    for (int i = 0; i < 3; ++i) {
      V inverse = 1.f / (t + r[i] * r[i]);
      V u = r[i] * y[i] * inverse;
      g += u * u;
      slope += u * u * inverse;
    }
    t += relu(g / (2.f * slope + 1e-20f));
  }
  V d2 = {};
  for (int i = 0; i < 3; ++i) {
    V d = y[i] * t / (t + r[i] * r[i]);
    d2 += d * d;
  }
  V lower_bound = (k - 1.f) * r_min;
  return k > 1.f ? maximum(root(d2) - 1e-6f, lower_bound) : lower_bound;
}

template <class V> static inline V segment_squared(const Vec<V>& p, const float a[3], const float b[3]) {
  const float e[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
  const float inverse = 1.f / (e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + 1e-20f);
  Vec<V> d = {p.x - a[0], p.y - a[1], p.z - a[2]};
  V s = minimum(maximum(dot(d, e) * inverse, V{}), V{} + 1.f);
  V x = d.x - s * e[0], y = d.y - s * e[1], z = d.z - s * e[2];
  return x * x + y * y + z * z;
}

// Above a face's prism its plane is nearest, else one of its edges: the sign tests against the three edge planes tell.
template <class V> static inline V triangle_squared(const Vec<V>& p, const Triangle& t, V height) {
  V edge = minimum(segment_squared(p, t.a, t.b), minimum(segment_squared(p, t.b, t.c), segment_squared(p, t.c, t.a)));
  auto over = V{} == V{};
  const float* corner[4] = {t.a, t.b, t.c, t.a};
  for (int k = 0; k < 3; ++k) {
    const float *a = corner[k], *b = corner[k + 1];
    const float e[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
    const float inward[3] = {t.normal[1] * e[2] - t.normal[2] * e[1], t.normal[2] * e[0] - t.normal[0] * e[2],
                             t.normal[0] * e[1] - t.normal[1] * e[0]};
    over &= (p.x - a[0]) * inward[0] + (p.y - a[1]) * inward[1] + (p.z - a[2]) * inward[2] >= 0.f;
  }
  return over ? height * height : edge;
}

template <class V> static inline V mesh_distance(const Tables& tables, const Obstacle& o, const Vec<V>& p) {
  V deepest = V{} - 1e30f, nearest = V{} + 1e30f;
  for (int k = 0; k < o.n_triangle; ++k) {
    const Triangle& t = tables.triangle[o.first_triangle + k];
    V height = dot(p, t.normal) - t.offset;
    deepest = maximum(deepest, height);
    if (any(height > 0.f))
      nearest = minimum(nearest, triangle_squared(p, t, height));  // the nearest face is one that p sees
  }
  return deepest > 0.f ? root(nearest) : deepest;
}

template <class V> static inline V signed_distance(const Tables& tables, const Obstacle& o, const Vec<V>& point) {
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
      return mesh_distance(tables, o, point);
  }
}

template <class V> static inline auto near_bound(const Obstacle& o, const Vec<V>& centre, V reach) {
  if (o.bound[3] < 0.f) return V{} == V{};
  V r = reach + o.bound[3];
  V dx = centre.x - o.bound[0], dy = centre.y - o.bound[1], dz = centre.z - o.bound[2];
  return dx * dx + dy * dy + dz * dz < r * r;
}

// A plane of a face that separates the sphere from the hull settles it; distances to triangles are for the few that are
// left.
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

// Whether a sphere touches; for the box, by far the commonest, without a square root.
static inline MaskF touches(const Tables& tables, const Obstacle& o, const Vec<F>& centre, float radius) {
  if (o.kind == kMesh) return touches_mesh(tables, o, centre, radius);
  if (o.kind != kBox) return signed_distance(tables, o, centre) < radius;
  Vec<F> p = local(o, centre);
  F x = relu(absolute(p.x) - o.size[0]), y = relu(absolute(p.y) - o.size[1]), z = relu(absolute(p.z) - o.size[2]);
  return x * x + y * y + z * z < radius * radius;
}

// World positions of bounding spheres, and of spheres as far as somebody asked for them.
struct Placed {
  const Tables& tables;
  const Frame<F>* X_W;
  Vec<F> bound[kMaxLinks];
  Vec<F> sphere[kMaxSpheres];
  bool ready[kMaxLinks];

  Placed(const Tables& t, const Frame<F>* X) : tables(t), X_W(X) {
    for (int g = 0; g < t.n_group; ++g) {
      bound[g] = transform(X[t.group[g].frame], t.group[g].bound);
      ready[g] = false;
    }
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

// Which lanes collide. With `first_hit` it returns as soon as any lane does: one bad state spoils an edge.
template <bool first_hit> static inline MaskF collides(const Tables& tables, const Frame<F>* X_W, float margin) {
  Placed placed(tables, X_W);
  MaskF hit = {};
  for (int g = tables.n_group - 1; g >= 0; --g) {  // the far links move most: test them first
    const Group& group = tables.group[g];
    if (group.frame == 0) continue;  // the base does not move
    const float reach = group.bound[3] + margin;
    for (int j = 0; j < tables.n_obstacle; ++j) {
      const Obstacle& o = tables.obstacle[j];
      if (o.ignores >> group.link & 1) continue;
      if (!any(near_bound(o, placed.bound[g], F{} + reach))) continue;
      if (!any(touches(tables, o, placed.bound[g], reach))) continue;
      const Vec<F>* sphere = placed.spheres(g);
      for (int c = group.first_cluster; c < group.first_cluster + group.n_cluster; ++c) {
        const Cluster& cluster = tables.cluster[c];
        if (group.n_cluster > 1 &&
            !any(touches(tables, o, transform(X_W[group.frame], cluster.bound), cluster.bound[3] + margin)))
          continue;
        for (int k = cluster.first; k < cluster.first + cluster.count; ++k)
          hit |= touches(tables, o, sphere[k], tables.sphere[4 * k + 3] + margin);
        if (first_hit ? any(hit) : all(hit)) return hit;
      }
    }
  }
  for (int p = 0; p < tables.n_pair; ++p) {
    const int a = tables.pair[2 * p], b = tables.pair[2 * p + 1];
    const Group &ga = tables.group[a], &gb = tables.group[b];
    const float reach = ga.bound[3] + gb.bound[3] + margin;
    if (!any(squared_distance(placed.bound[a], placed.bound[b]) < reach * reach)) continue;
    const Vec<F>*sa = placed.spheres(a), *sb = placed.spheres(b);
    for (int k = ga.first; k < ga.first + ga.count; ++k) {
      const float ra = tables.sphere[4 * k + 3] + margin, rb = ra + gb.bound[3];
      if (!any(squared_distance(sa[k], placed.bound[b]) < rb * rb)) continue;
      for (int c = gb.first_cluster; c < gb.first_cluster + gb.n_cluster; ++c) {
        const Cluster& cluster = tables.cluster[c];
        const float rc = ra + cluster.bound[3];
        if (gb.n_cluster > 1 && !any(squared_distance(sa[k], transform(X_W[gb.frame], cluster.bound)) < rc * rc))
          continue;
        for (int m = cluster.first; m < cluster.first + cluster.count; ++m) {
          const float r = ra + tables.sphere[4 * m + 3];
          hit |= squared_distance(sa[k], sb[m]) < r * r;
        }
      }
    }
    if (first_hit ? any(hit) : all(hit)) return hit;
  }
  return hit;
}

// Who is nearest in each lane: sphere `a` against obstacle `b`, or against sphere -1 - b.
struct Nearest {
  F distance;
  MaskF a, b;

  void update(F d, int sphere, int other) {
    MaskF closer = d < distance;
    distance = closer ? d : distance;
    a = closer ? MaskF{} + sphere : a;
    b = closer ? MaskF{} + other : b;
  }
};

static inline Nearest nearest(const Tables& tables, const Frame<F>* X_W) {
  Placed placed(tables, X_W);
  Nearest best = {F{} + 1e9f, MaskF{} - 1, MaskF{}};
  for (int g = tables.n_group - 1; g >= 0; --g) {
    const Group& group = tables.group[g];
    if (group.frame == 0) continue;  // the base does not move
    for (int j = 0; j < tables.n_obstacle; ++j) {
      const Obstacle& o = tables.obstacle[j];
      if (o.ignores >> group.link & 1) continue;
      if (!any(near_bound(o, placed.bound[g], relu(best.distance + group.bound[3])))) continue;
      if (!any(signed_distance(tables, o, placed.bound[g]) - group.bound[3] < best.distance)) continue;
      const Vec<F>* sphere = placed.spheres(g);
      for (int c = group.first_cluster; c < group.first_cluster + group.n_cluster; ++c) {
        const Cluster& cluster = tables.cluster[c];
        const Vec<F> centre = transform(X_W[group.frame], cluster.bound);
        if (group.n_cluster > 1 && !any(signed_distance(tables, o, centre) - cluster.bound[3] < best.distance))
          continue;
        for (int k = cluster.first; k < cluster.first + cluster.count; ++k)
          best.update(signed_distance(tables, o, sphere[k]) - tables.sphere[4 * k + 3], k, j);
      }
    }
  }
  for (int p = 0; p < tables.n_pair; ++p) {
    const int a = tables.pair[2 * p], b = tables.pair[2 * p + 1];
    const Group &ga = tables.group[a], &gb = tables.group[b];
    F gap = square_root(squared_distance(placed.bound[a], placed.bound[b])) - (ga.bound[3] + gb.bound[3]);
    if (!any(gap < best.distance)) continue;
    const Vec<F>*sa = placed.spheres(a), *sb = placed.spheres(b);
    for (int k = ga.first; k < ga.first + ga.count; ++k)
      for (int m = gb.first; m < gb.first + gb.count; ++m)
        best.update(square_root(squared_distance(sa[k], sb[m])) - (tables.sphere[4 * k + 3] + tables.sphere[4 * m + 3]),
                    k, -1 - m);
  }
  return best;
}

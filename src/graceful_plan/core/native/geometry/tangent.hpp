// Tangent planes below signed distances. Obstacles are convex, and so are their distance functions d: with the normal n
// at a point c, d(p) >= d(c) + n . (p - c) for all p. One plane bounds the distances of all spheres of a link from
// below, also after the link has moved.
#pragma once
#include "geometry/clearance.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

template <class V> struct Tangent {
  V d;
  Vec<V> n;  // n: unit vector in W; d: the distance, or a lower bound where the distance is expensive
};

template <class V> static inline Vec<V> to_world(const Obstacle& o, const Vec<V>& n) {
  return {o.R[0] * n.x + o.R[1] * n.y + o.R[2] * n.z, o.R[3] * n.x + o.R[4] * n.y + o.R[5] * n.z,
          o.R[6] * n.x + o.R[7] * n.y + o.R[8] * n.z};
}

// Gives a the sign of another number.
template <class V> static inline V signed_as(V a, V sign) { return sign < 0 ? -a : a; }

template <class V> static inline Tangent<V> box_tangent(const float half[3], const Vec<V>& p) {
  const V x = absolute(p.x) - half[0], y = absolute(p.y) - half[1], z = absolute(p.z) - half[2];
  const V ox = relu(x), oy = relu(y), oz = relu(z), square = ox * ox + oy * oy + oz * oz;
  const V inverse = inverse_root(maximum(square, V{} + Scalar<V>(1e-24))), inside = maximum(x, maximum(y, z));
  const auto out = inside > 0;
  const V one = V{} + 1, nx = out ? ox * inverse : (x == inside ? one : V{});
  const V ny = out ? oy * inverse : ((x != inside) & (y == inside) ? one : V{});
  const V nz = out ? oz * inverse : ((x != inside) & (y != inside) ? one : V{});
  return {out ? square * inverse : inside, {signed_as(nx, p.x), signed_as(ny, p.y), signed_as(nz, p.z)}};
}

template <class V> static inline Tangent<V> point_tangent(const Vec<V>& p, float radius) {
  const V square = maximum(p.x * p.x + p.y * p.y + p.z * p.z, V{} + Scalar<V>(1e-24)), inverse = inverse_root(square);
  return {square * inverse - radius, {p.x * inverse, p.y * inverse, p.z * inverse}};
}

template <class V> static inline Tangent<V> cylinder_tangent(float radius, float half, const Vec<V>& p) {
  const V inverse = inverse_root(maximum(p.x * p.x + p.y * p.y, V{} + Scalar<V>(1e-24)));
  const V r = (p.x * p.x + p.y * p.y) * inverse - radius, z = absolute(p.z) - half, out_r = relu(r), out_z = relu(z);
  const V square = out_r * out_r + out_z * out_z, shrink = inverse_root(maximum(square, V{} + Scalar<V>(1e-24)));
  const V inside = maximum(r, z), one = V{} + 1;
  const auto out = inside > 0;
  const V along_r = (out ? out_r * shrink : (r == inside ? one : V{})) * inverse;
  const V along_z = out ? out_z * shrink : (r != inside ? one : V{});
  return {out ? square * shrink : inside, {along_r * p.x, along_r * p.y, signed_as(along_z, p.z)}};
}

// For every direction, the support function of an ellipsoid bounds the distance from below.
template <class V> static inline Tangent<V> ellipsoid_tangent(const float r[3], const Vec<V>& p) {
  const V y[3] = {p.x, p.y, p.z};
  V k2 = {};
  for (int i = 0; i < 3; ++i) k2 += y[i] * y[i] * (1.f / (r[i] * r[i]));
  const V t = ellipsoid_parameter(r, y, root(k2), least_of(r));
  const V n[3] = {p.x * reciprocal(t + r[0] * r[0]), p.y * reciprocal(t + r[1] * r[1]),
                  p.z * reciprocal(t + r[2] * r[2])};
  const V inverse = inverse_root(maximum(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], V{} + Scalar<V>(1e-24)));
  const V x = n[0] * inverse, y1 = n[1] * inverse, z = n[2] * inverse;
  const V reach = root(x * x * (r[0] * r[0]) + y1 * y1 * (r[1] * r[1]) + z * z * (r[2] * r[2]));
  return {p.x * x + p.y * y1 + p.z * z - reach, {x, y1, z}};
}

template <class V> static inline Vec<V> shorter(const Vec<V>& a, const Vec<V>& b) {
  const auto first = squared(a) < squared(b);
  return {first ? a.x : b.x, first ? a.y : b.y, first ? a.z : b.z};
}

// Inside: the face with the largest height over it. Outside: perpendicular to the vector from the nearest point.
template <class V> static inline Tangent<V> mesh_tangent(const Tables& tables, const Obstacle& o, const Vec<V>& p) {
  Tangent<V> best;
  Vec<V> way = {V{}, V{}, V{}};
  V square = V{} + 1e30f;
  best.d = for_each_near_face(tables, o, p, square, [&](const Triangle& t, V height, V outside) {
    const auto beside = outside > 0.f;
    Vec<V> here = {height * t.normal[0], height * t.normal[1], height * t.normal[2]};
    V here_square = height * height;
    if (any(beside)) {
      const Vec<V> edge = shorter(from_edge(p, t, 0), shorter(from_edge(p, t, 1), from_edge(p, t, 2)));
      here = {beside ? edge.x : here.x, beside ? edge.y : here.y, beside ? edge.z : here.z};
      here_square = beside ? squared(edge) : here_square;
    }
    const auto nearer = (height > 0.f) & (here_square < square);
    way = {nearer ? here.x : way.x, nearer ? here.y : way.y, nearer ? here.z : way.z};
    square = nearer ? here_square : square;
  });
  const V inverse = inverse_root(maximum(square, V{} + Scalar<V>(1e-24)));
  const auto out = (best.d > 0.f) & (square > 1e-12f);  // on a face, its normal is more accurate
  best.n = {way.x * inverse, way.y * inverse, way.z * inverse};
  for (int k = 0; any(~out) && k < o.n_triangle; ++k) {
    const Triangle& t = tables.triangle[o.first_triangle + k];
    const auto that = (dot(p, t.normal) - t.offset == best.d) & ~out;
    best.n = {that ? V{} + t.normal[0] : best.n.x, that ? V{} + t.normal[1] : best.n.y,
              that ? V{} + t.normal[2] : best.n.z};
  }
  best.d = out ? square * inverse : best.d;
  return best;
}

template <class V>
[[gnu::noinline]] static Tangent<V> other_tangent(const Tables& tables, const Obstacle& o, const Vec<V>& point) {
  if (o.kind == kMesh) return mesh_tangent(tables, o, point);
  const Vec<V> p = local(o, point);
  Tangent<V> t;
  if (o.kind == kCylinder)
    t = cylinder_tangent(o.size[0], o.size[1], p);
  else if (o.kind == kCapsule)
    t = point_tangent<V>({p.x, p.y, p.z - minimum(maximum(p.z, V{} - o.size[1]), V{} + o.size[1])}, o.size[0]);
  else if (o.kind == kEllipsoid)
    t = ellipsoid_tangent(o.size, p);
  else if (o.kind == kSphere)
    t = point_tangent(p, o.size[0]);
  else
    t = {p.z, {V{}, V{}, V{} + 1}};
  return {t.d, to_world(o, t.n)};
}

template <class V>
[[gnu::always_inline]] static inline Tangent<V> tangent(const Tables& tables, const Obstacle& o, const Vec<V>& point) {
  if (o.kind != kBox) return other_tangent(tables, o, point);  // fast path for boxes, the most common kind
  const Tangent<V> t = box_tangent(o.size, local(o, point));
  return {t.d, to_world(o, t.n)};
}

}  // namespace gp::GP_ISA

// The gradient of the clearance of a known nearest pair: scalar, in double precision, one configuration at a time.
#pragma once
#include <initializer_list>

#include "lanes.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

static inline double norm3(const double* v) { return __builtin_sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }
static inline double clamp(double v, double lower, double upper) { return v < lower ? lower : v > upper ? upper : v; }

static inline void box_normal(const double* half, const double* p, double* n) {
  double outside = 0, deepest = -1e30;
  int axis = 0;
  for (int k = 0; k < 3; ++k) {
    double d = __builtin_fabs(p[k]) - half[k], sign = p[k] < 0 ? -1.0 : 1.0;
    n[k] = d > 0 ? sign * d : 0.0;
    outside += n[k] * n[k];
    if (d > deepest) deepest = d, axis = k;
  }
  if (outside > 0) return;
  n[axis] = p[axis] < 0 ? -1.0 : 1.0;
}

static inline void cylinder_normal(double radius, double half, const double* p, double* n) {
  double rho = __builtin_sqrt(p[0] * p[0] + p[1] * p[1]), r = rho - radius, z = __builtin_fabs(p[2]) - half;
  double sign = p[2] < 0 ? -1.0 : 1.0, along_r = r > 0 ? r : 0, along_z = z > 0 ? z : 0;
  if (r <= 0 && z <= 0) along_r = r > z, along_z = r <= z;
  n[0] = rho > 0 ? along_r * p[0] / rho : along_r;
  n[1] = rho > 0 ? along_r * p[1] / rho : 0.0;
  n[2] = sign * along_z;
}

static inline void ellipsoid_normal(const float* r, const double* p, double* n) {
  double k2 = 0, t = 0, r_min = 1e30;
  for (int i = 0; i < 3; ++i) k2 += p[i] * p[i] / (double(r[i]) * r[i]), r_min = r[i] < r_min ? r[i] : r_min;
  if (k2 > 1) t = (__builtin_sqrt(k2) - 1) * r_min * r_min;
  for (int step = 0; k2 > 1 && step < 20; ++step) {
    double g = -1, slope = 0;
    for (int i = 0; i < 3; ++i) {
      double inverse = 1 / (t + double(r[i]) * r[i]), u = r[i] * p[i] * inverse;
      g += u * u, slope += u * u * inverse;
    }
    if (g <= 0) break;
    t += g / (2 * slope);
  }
  for (int i = 0; i < 3; ++i) n[i] = p[i] / (t + double(r[i]) * r[i]);
}

static inline void segment_normal(const float* a, const float* b, const double* p, double* n) {
  double e[3], d[3], along = 0, length = 1e-30;
  for (int k = 0; k < 3; ++k)
    e[k] = double(b[k]) - a[k], d[k] = p[k] - a[k], along += e[k] * d[k], length += e[k] * e[k];
  double s = clamp(along / length, 0, 1);
  for (int k = 0; k < 3; ++k) n[k] = d[k] - s * e[k];
}

static inline void mesh_normal(const Tables& tables, const Obstacle& o, const double* p, double* n) {
  const Triangle* face = nullptr;
  double deepest = -1e30, nearest = 1e30;
  for (int k = 0; k < o.n_triangle; ++k) {
    const Triangle& t = tables.triangle[o.first_triangle + k];
    double height = p[0] * t.normal[0] + p[1] * t.normal[1] + p[2] * t.normal[2] - t.offset;
    if (height > deepest) deepest = height, face = &t;
  }
  if (deepest <= 0) {
    for (int k = 0; k < 3; ++k) n[k] = face->normal[k];
    return;
  }
  for (int k = 0; k < o.n_triangle; ++k) {
    const Triangle& t = tables.triangle[o.first_triangle + k];
    double height = p[0] * t.normal[0] + p[1] * t.normal[1] + p[2] * t.normal[2] - t.offset;
    const float* corner[4] = {t.a, t.b, t.c, t.a};
    bool over = true;
    for (int i = 0; i < 3; ++i) {
      const float *a = corner[i], *b = corner[i + 1];
      double e[3] = {double(b[0]) - a[0], double(b[1]) - a[1], double(b[2]) - a[2]}, m[3];
      over &= (p[0] - a[0]) * (t.normal[1] * e[2] - t.normal[2] * e[1]) +
                  (p[1] - a[1]) * (t.normal[2] * e[0] - t.normal[0] * e[2]) +
                  (p[2] - a[2]) * (t.normal[0] * e[1] - t.normal[1] * e[0]) >=
              0;
      segment_normal(a, b, p, m);
      if (norm3(m) < nearest) {
        nearest = norm3(m);
        for (int c = 0; c < 3; ++c) n[c] = m[c];
      }
    }
    if (over && height > 0 && height < nearest) {
      nearest = height;
      for (int c = 0; c < 3; ++c) n[c] = t.normal[c];
    }
  }
}

// Unit normal in W along which the distance from the obstacle to `point` grows fastest.
static inline void outward_normal(const Tables& tables, const Obstacle& o, const double* point, double* normal) {
  double p[3], n[3] = {0, 0, 1};
  for (int k = 0; k < 3; ++k)
    p[k] = (point[0] - o.p[0]) * o.R[k] + (point[1] - o.p[1]) * o.R[3 + k] + (point[2] - o.p[2]) * o.R[6 + k];
  const double half[3] = {o.size[0], o.size[1], o.size[2]};
  if (o.kind == kSphere)
    for (int k = 0; k < 3; ++k) n[k] = p[k];
  else if (o.kind == kCapsule)
    n[0] = p[0], n[1] = p[1], n[2] = p[2] - clamp(p[2], -half[1], half[1]);
  else if (o.kind == kEllipsoid)
    ellipsoid_normal(o.size, p, n);
  else if (o.kind == kCylinder)
    cylinder_normal(half[0], half[1], p, n);
  else if (o.kind == kBox)
    box_normal(half, p, n);
  else if (o.kind == kMesh)
    mesh_normal(tables, o, point, n);
  double length = norm3(n);
  if (length < 1e-12) n[0] = n[1] = 0, n[2] = length = 1;
  if (o.kind == kMesh)  // triangles are in W already
    for (int k = 0; k < 3; ++k) normal[k] = n[k] / length;
  else
    for (int k = 0; k < 3; ++k)
      normal[k] = (o.R[3 * k] * n[0] + o.R[3 * k + 1] * n[1] + o.R[3 * k + 2] * n[2]) / length;
}

static inline int group_of(const Tables& tables, int sphere) {
  int g = 0;
  while (sphere >= tables.group[g].first + tables.group[g].count) ++g;
  return g;
}

struct Posture {  // one lane of a block of configurations
  const Tables& tables;
  const Frame<D>* X_W;
  int lane;
};

// Adds sign * normal . J to the gradient, with J the Jacobian of a point of a link.
static inline void add_jacobian(const Posture& at, int link, const double* point, const double* normal, double sign,
                                double* gradient) {
  const auto& [tables, X_W, lane] = at;
  for (int l = link; l >= 0; l = tables.link[l].parent) {
    const Link& joint = tables.link[l];
    if (joint.joint < 0) continue;
    const Frame<D>& X = X_W[l];
    const double z[3] = {X.R[2][lane], X.R[5][lane], X.R[8][lane]};
    double velocity[3] = {z[0], z[1], z[2]};
    if (!joint.slide) {
      const double r[3] = {point[0] - X.p.x[lane], point[1] - X.p.y[lane], point[2] - X.p.z[lane]};
      velocity[0] = z[1] * r[2] - z[2] * r[1];
      velocity[1] = z[2] * r[0] - z[0] * r[2];
      velocity[2] = z[0] * r[1] - z[1] * r[0];
    }
    gradient[joint.joint] += sign * (normal[0] * velocity[0] + normal[1] * velocity[1] + normal[2] * velocity[2]);
  }
}

static inline void sphere_position(const Posture& at, int sphere, const Group& group, double* out) {
  const auto& [tables, X_W, lane] = at;
  const Frame<D>& X = X_W[group.frame];
  const float* c = tables.sphere + 4 * sphere;
  out[0] = X.p.x[lane] + X.R[0][lane] * c[0] + X.R[1][lane] * c[1] + X.R[2][lane] * c[2];
  out[1] = X.p.y[lane] + X.R[3][lane] * c[0] + X.R[4][lane] * c[1] + X.R[5][lane] * c[2];
  out[2] = X.p.z[lane] + X.R[6][lane] * c[0] + X.R[7][lane] * c[1] + X.R[8][lane] * c[2];
}

static inline void in_world(const Posture& at, int frame, const double v[3], double* out) {
  const Frame<D>& X = at.X_W[frame];
  for (int i = 0; i < 3; ++i)
    out[i] = X.R[3 * i][at.lane] * v[0] + X.R[3 * i + 1][at.lane] * v[1] + X.R[3 * i + 2][at.lane] * v[2];
}

static inline void cross(const double* a, const double* b, double* out) {
  for (int i = 0; i < 3; ++i) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

// A joint about z reduces the angle between axis and direction at the rate z . (axis x direction) / sin(angle).
static inline void cone_gradient(const Posture& at, const Cone& cone, double* gradient) {
  double axis[3], about[3];
  in_world(at, cone.frame, cone.axis, axis);
  cross(axis, cone.direction, about);
  const double sine = norm3(about) + 1e-9;
  for (int l = cone.link; l >= 0; l = at.tables.link[l].parent) {
    const Link& joint = at.tables.link[l];
    if (joint.joint < 0 || joint.slide) continue;
    const Frame<D>& X = at.X_W[l];
    const double along = X.R[2][at.lane] * about[0] + X.R[5][at.lane] * about[1] + X.R[8][at.lane] * about[2];
    gradient[joint.joint] += kLever * along / sine;
  }
}

static inline void room_gradient(const Posture& at, const Room& room, double* gradient) {
  const Frame<D>& X = at.X_W[room.frame];
  const double origin[3] = {X.p.x[at.lane], X.p.y[at.lane], X.p.z[at.lane]};
  double point[3], least = 1e30, inward[3] = {0, 0, 0};
  in_world(at, room.frame, room.point, point);
  for (int i = 0; i < 3; ++i) point[i] += origin[i];
  for (int i = 0; i < 3; ++i) {
    double along = 0;
    for (int k = 0; k < 3; ++k) along += (point[k] - room.p[k]) * room.R[3 * k + i];
    for (double side : {1.0, -1.0}) {
      const double inside = side > 0 ? along - room.lower[i] : room.upper[i] - along;
      if (inside >= least) continue;
      least = inside;
      for (int k = 0; k < 3; ++k) inward[k] = side * room.R[3 * k + i];
    }
  }
  add_jacobian(at, room.link, point, inward, 1.0, gradient);
}

// `a` and `b` identify the pair as in `Nearest`.
static inline void clearance_gradient(const Posture& at, int a, int b, double* gradient) {
  const Tables& tables = at.tables;
  for (int j = 0; j < tables.n_joint; ++j) gradient[j] = 0;
  if (a == -1) return;
  if (a < -1) {
    const int bound = -2 - a;
    if (bound < tables.n_cone) return cone_gradient(at, tables.cone[bound], gradient);
    return room_gradient(at, tables.room[bound - tables.n_cone], gradient);
  }
  const Group& group = tables.group[group_of(tables, a)];
  double p[3], other[3], normal[3];
  sphere_position(at, a, group, p);
  if (b >= 0) {
    outward_normal(tables, tables.obstacle[b], p, normal);
    add_jacobian(at, group.link, p, normal, 1.0, gradient);
    return;
  }
  const Group& other_group = tables.group[group_of(tables, -1 - b)];
  sphere_position(at, -1 - b, other_group, other);
  for (int k = 0; k < 3; ++k) normal[k] = p[k] - other[k];
  const double length = norm3(normal) + 1e-30;
  for (int k = 0; k < 3; ++k) normal[k] /= length;
  add_jacobian(at, group.link, p, normal, 1.0, gradient);
  add_jacobian(at, other_group.link, other, normal, -1.0, gradient);
}

}  // namespace gp::GP_ISA

// Distances of links and the carried object to moving entities: P that a collapsing arm hits them, by a rule of thumb
// (costs/models/moving), and the gap between the intact robot and the nearest entity.
#pragma once
#include <cstddef>

#include "blocks.hpp"
#include "cutoffs.hpp"
#include "geometry/gradient.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "impact/moving/path.hpp"
#include "impact/moving/tables.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA::moving {

constexpr double kBodyReach = 0.15, kBodySpread = 0.1;  // reach of a collapsing arm, and its spread [m]; not fitted
constexpr double kPassesBelow = 0.02;                   // smoothing width for a link passing below an entity [m]

// A moving entity at the times of the states side by side.
struct Met {
  const MovingEntity& entity;
  D at[4], rate[4];
  Outline outline;

  Met(const MovingEntity& e, D t) : entity(e) {
    follow<0, 4>(e, t, at, rate);
    outline.turn(e, at[3]);
  }
  Vec<D> from(const Frame<D>& X, const float* sphere) const {
    const Vec<D> p = transform(X, sphere);
    return {p.x - at[0], p.y - at[1], p.z - at[2]};
  }
};

// Visits spheres of moving links: look(bound, away) returns whether spheres within a bounding sphere may matter,
// visit(sphere, away) is called for each of these. `away`: vector from the entity's middle to a centre.
template <class Look, class Visit>
static inline void for_each_sphere(const Tables& tables, const Frame<D>* X_W, const Met& met, Look look, Visit visit) {
  for (int g = 0; g < tables.n_group; ++g) {
    const Group& group = tables.group[g];
    if (group.link == 0) continue;
    const Frame<D>& X = X_W[group.frame];
    if (!look(double(group.bound[3]), met.from(X, group.bound))) continue;
    for (int c = group.first_cluster; c < group.first_cluster + group.n_cluster; ++c) {
      const Cluster& cluster = tables.cluster[c];
      if (group.n_cluster > 1 && !look(double(cluster.bound[3]), met.from(X, cluster.bound))) continue;
      for (int s = cluster.first; s < cluster.first + cluster.count; ++s) visit(s, met.from(X, tables.sphere + 4 * s));
    }
  }
}

// Adds derivatives with respect to a sphere's centre in one lane, mapped to joints.
static inline void add_sphere_slope(const Tables& tables, const Frame<D>* X_W, int lane, int sphere, const double* d,
                                    double* d_q) {
  const Group& group = tables.group[group_of(tables, sphere)];
  const Posture at{tables, X_W, lane};
  double p[3];
  sphere_position(at, sphere, group, p);
  add_jacobian(at, group.link, p, d, 1.0, d_q);
}

// --- gaps -----------------------------------------------------------------------------------------------------------

struct Gap {
  D value = D{} + __builtin_inf(), sphere = D{} - 1.0, by_t = {};
  Vec<D> by_p = {D{}, D{}, D{}};

  void look_at(const Tables& tables, const Frame<D>* X_W, const Met& met, double wanted) {
    for_each_sphere(
        tables, X_W, met,
        [&](double radius, const Vec<D>& away) {
          const D least = apart(met.outline, met.entity.half[2], away.x, away.y, away.z).value - radius;
          return any((least < wanted) & (least < value));
        },
        [&](int s, const Vec<D>& away) {
          const Apart found = apart(met.outline, met.entity.half[2], away.x, away.y, away.z);
          const D gap = found.value - double(tables.sphere[4 * s + 3]);
          const auto nearer = (gap < value) & (gap < wanted);
          if (!any(nearer)) return;
          value = where(nearer, gap, value), sphere = where(nearer, D{} + double(s), sphere);
          by_p = {where(nearer, found.x, by_p.x), where(nearer, found.y, by_p.y), where(nearer, found.z, by_p.z)};
          const D theirs = met.rate[3] * found.turned(away.x, away.y) - found.x * met.rate[0] - found.y * met.rate[1] -
                           found.z * met.rate[2];
          by_t = where(nearer, theirs, by_t);
        });
  }
};

// The least gap over entities [n], infinite unless below `wanted`, and its derivatives unless d_q is null.
static void gaps(const Tables& tables, const MovingPaths& paths, const States& states, const double* t, double wanted,
                 double* out, double* d_q, double* d_t) {
  const size_t nq = size_t(tables.n_joint);
  for_each_block<D>(tables, states, [&](size_t first, int count, const Frame<D>* X_W) {
    const D times = load_times(t, first, states.n);
    Gap gap;
    for (int e = 0; e < paths.n_entity; ++e) gap.look_at(tables, X_W, Met(paths.entity[e], times), wanted);
    for (int i = 0; i < count; ++i) {
      const size_t row = first + size_t(i);
      out[row] = gap.value[i];
      if (!d_q) continue;
      for (size_t j = 0; j < nq; ++j) d_q[row * nq + j] = 0;
      d_t[row] = gap.by_t[i];
      const double normal[3] = {gap.by_p.x[i], gap.by_p.y[i], gap.by_p.z[i]};
      if (gap.sphere[i] >= 0) add_sphere_slope(tables, X_W, i, int(gap.sphere[i]), normal, d_q + row * nq);
    }
  });
}

// --- collapsing arms ------------------------------------------------------------------------------------------------

struct Reached {
  D value = {}, sphere = D{} - 1.0;

  // Distance from the entity seen from above, 0 inside it, and its gradient.
  struct Beside {
    D far, x, y;

    Beside(const Outline& o, D dx, D dy) {
      if (o.round) {
        const D rho = square_root(dx * dx + dy * dy + 1e-24), inverse = where(rho > o.a, reciprocal(rho), D{});
        far = relu(rho - o.a), x = dx * inverse, y = dy * inverse;
        return;
      }
      const D px = o.cosine * dx + o.sine * dy, py = o.cosine * dy - o.sine * dx;
      const D along = relu(absolute(px) - o.a), across = relu(absolute(py) - o.b);
      const D rho = square_root(along * along + across * across + 1e-24), inverse = reciprocal(rho);
      far = where((along > 0.0) | (across > 0.0), rho, D{});
      const D sx = where(px < 0.0, -along, along) * inverse, sy = where(py < 0.0, -across, across) * inverse;
      x = o.cosine * sx - o.sine * sy, y = o.sine * sx + o.cosine * sy;
    }
  };

  void look_at(const Tables& tables, const Frame<D>* X_W, const Met& met, D inverse_spread) {
    for_each_sphere(
        tables, X_W, met,
        [&](double radius, const Vec<D>& away) {
          const D u = (radius + kBodyReach - Beside(met.outline, away.x, away.y).far) * inverse_spread;
          return any(u > -kTail<D> * kBeta) && any(Below<D>(u).value > value);
        },
        [&](int s, const Vec<D>& away) {
          const double radius = double(tables.sphere[4 * s + 3]);
          const D u = (radius + kBodyReach - Beside(met.outline, away.x, away.y).far) * inverse_spread;
          const D z = (away.z + (radius + met.entity.half[2])) * (1.0 / kPassesBelow);
          if (!any((u > -kTail<D> * kBeta) & (z > -kTail<D> * kBeta))) return;
          const D P = Below<D>(u).value * Below<D>(z).value;
          sphere = where(P > value, D{} + double(s), sphere), value = maximum(value, P);
        });
  }
};

static inline Varying arm_spread(const MovingEntity& e, D t) {
  const Varying spread = spread_of(e, t);
  const D both = square_root(spread.value * spread.value + kBodySpread * kBodySpread);
  return {both, spread.value * spread.rate * reciprocal(both)};
}

// P that a collapsing arm hits each entity [n, n_entity]; without times, the mean over the path.
static void arm_probability(const Tables& tables, const MovingPaths& paths, const double* severity,
                            const States& states, const double* t, double* out) {
  for_each_block<D>(tables, states, [&](size_t first, int count, const Frame<D>* X_W) {
    for (int e = 0; e < paths.n_entity; ++e) {
      const MovingEntity& entity = paths.entity[e];
      D P = {};
      const int times = t ? 1 : entity.n_time;
      for (int k = 0; k < times && !(severity && severity[e] == 0); ++k) {
        const D time = t ? load_times(t, first, states.n) : D{} + entity.time[k];
        Reached reached;
        reached.look_at(tables, X_W, Met(entity, time), reciprocal(arm_spread(entity, time).value));
        P += reached.value;
      }
      for (int i = 0; i < count; ++i) out[(first + size_t(i)) * size_t(paths.n_entity) + size_t(e)] = P[i] / times;
    }
  });
}

// Adds the sum of P S over entities, with its derivatives.
static void arm_gradient(const Tables& tables, const MovingPaths& paths, const double* severity, const States& states,
                         const double* t, const MovingSlopes& out) {
  const size_t nq = size_t(tables.n_joint);
  for_each_block<D>(tables, states, [&](size_t first, int count, const Frame<D>* X_W) {
    const D time = load_times(t, first, states.n);
    for (int e = 0; e < paths.n_entity; ++e) {
      if (severity[e] == 0) continue;
      const MovingEntity& entity = paths.entity[e];
      const Met met(entity, time);
      const Varying spread = arm_spread(entity, time);
      const D inverse = reciprocal(spread.value);
      Reached reached;
      reached.look_at(tables, X_W, met, inverse);
      for (int i = 0; i < count; ++i) {
        const size_t row = first + size_t(i);
        out.value[row] += severity[e] * reached.value[i];
        if (!(reached.value[i] > kNothing<D>)) continue;
        const int s = int(reached.sphere[i]);
        const double radius = double(tables.sphere[4 * s + 3]);
        const Vec<D> away = met.from(X_W[tables.group[group_of(tables, s)].frame], tables.sphere + 4 * s);
        const Reached::Beside beside(met.outline, away.x, away.y);
        const Below<D> near((radius + kBodyReach - beside.far) * inverse);
        const Below<D> above((away.z + (radius + entity.half[2])) * (1.0 / kPassesBelow));
        const D d_far = -severity[e] * near.u * above.value * inverse,
                d_z = severity[e] * near.value * above.u * (1.0 / kPassesBelow);
        const D d_spread = d_far * (radius + kBodyReach - beside.far) * inverse;
        const D d_x = d_far * beside.x, d_y = d_far * beside.y;
        const D d_t = d_spread * spread.rate + met.rate[3] * (d_x * away.y - d_y * away.x) - d_x * met.rate[0] -
                      d_y * met.rate[1] - d_z * met.rate[2];
        out.d_t[row] += d_t[i];
        const double d[3] = {d_x[i], d_y[i], d_z[i]};
        add_sphere_slope(tables, X_W, i, s, d, out.d_q + row * nq);
      }
    }
  });
}

}  // namespace gp::GP_ISA::moving

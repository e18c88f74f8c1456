// The nearest pair of spheres, or of a sphere and an obstacle, in each lane.
#pragma once
#include "geometry/bounds.hpp"
#include "geometry/clearance.hpp"
#include "geometry/one_lane.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// a >= 0: sphere `a` and obstacle `b`, or sphere -1 - b if b < 0. a < -1: bound -2 - a. a == -1: none.
struct Nearest {
  F distance;
  MaskF a, b;

  void update(F d, int sphere, int other) {
    MaskF closer = d < distance;
    distance = closer ? d : distance;
    a = closer ? MaskF{} + sphere : a;
    b = closer ? MaskF{} + other : b;
  }
  void update(F d, int first, bool of_spheres, int obstacle, int lane, int sphere) {
    const float least = least_lane(d);
    if (!(least < distance[lane])) return;
    int k = 0;
    while (d[k] != least) ++k;
    distance[lane] = least;
    a[lane] = of_spheres ? sphere : first + k;
    b[lane] = of_spheres ? -1 - (first + k) : obstacle;
  }
};

// Two clusters of a pair of links that may be nearest, and a lower bound of their distance.
struct Facing {
  F lower;
  MaskF pair, mine, other;

  void update(F distance, int p, int c, int d) {
    const MaskF nearer = distance < lower;
    lower = nearer ? distance : lower;
    pair = nearer ? MaskF{} + p : pair;
    mine = nearer ? MaskF{} + c : mine;
    other = nearer ? MaskF{} + d : other;
  }
};

// Updates `best` with the spheres of two clusters of a pair of links in one lane.
static inline void nearest_in_lane(const Placed& placed, int p, int c, int d, int lane, Nearest& best) {
  const Tables& tables = placed.tables;
  const Cluster &mine = tables.cluster[c], &other = tables.cluster[d];
  const float slack = tables.slack[p];
  const InOneLane one(tables, placed.X_W[tables.group[tables.pair[2 * p]].frame], c, lane);
  const Vec<F>& centre = placed.cluster[d];
  InOneLane two;
  bool placed_two = false;
  for (int u = 0; u < kPacks; ++u) {
    const F reach = relu(one.radius[u] + (slack + other.bound[3] + best.distance[lane]));
    const F away = squared_distance(one.centre[u], centre.x[lane], centre.y[lane], centre.z[lane]);
    for_each_lane(lanes_below(away, reach * reach), [&](int i) {
      if (!placed_two) two = InOneLane(tables, placed.X_W[tables.group[tables.pair[2 * p + 1]].frame], d, lane);
      placed_two = true;
      const float x = one.centre[u].x[i], y = one.centre[u].y[i], z = one.centre[u].z[i], r = one.radius[u][i] + slack;
      for (int v = 0; v < kPacks; ++v) {
        const F d2 = squared_distance(two.centre[v], x, y, z), within = relu(two.radius[v] + (r + best.distance[lane]));
        if (any_below(d2, within * within))
          best.update(square_root(d2) - (two.radius[v] + r), other.first + v * kLanes<float>, true, 0, lane,
                      mine.first + u * kLanes<float> + i);
      }
    });
  }
}

// Whether the links of a pair may be nearer than `distance` in any lane.
static inline bool may_be_nearer(const Placed& placed, int p, F distance) {
  const Tables& tables = placed.tables;
  const int a = tables.pair[2 * p], b = tables.pair[2 * p + 1];
  const float reach = tables.group[a].bound[3] + tables.group[b].bound[3] + tables.slack[p];
  const F within = relu(distance + reach);
  return any_below(squared_distance(placed.bound[a], placed.bound[b]), within * within);
}

// Takes the two clusters with the least lower bound in each lane first: their distance rules out most others.
static inline void begin_with_likeliest(Placed& placed, Nearest& best) {
  const Tables& tables = placed.tables;
  Facing likeliest = {best.distance, MaskF{} - 1, MaskF{}, MaskF{}};
  for (int p = 0; p < tables.n_pair; ++p) {
    if (!may_be_nearer(placed, p, likeliest.lower)) continue;
    const int a = tables.pair[2 * p], b = tables.pair[2 * p + 1];
    const Group &ga = tables.group[a], &gb = tables.group[b];
    const Vec<F>*ca = placed.clusters(a), *cb = placed.clusters(b);
    // Whether two bounding spheres may be nearer than the likeliest pair in any lane.
    const auto near = [&](const Vec<F>& p, const Vec<F>& q, float radii) {
      const F within = relu(likeliest.lower + radii);
      return any_below(squared_distance(p, q), within * within);
    };
    for (int c = ga.first_cluster; c < ga.first_cluster + ga.n_cluster; ++c) {
      const float radius = tables.cluster[c].bound[3] + tables.slack[p];
      if (!near(ca[c], placed.bound[b], radius + gb.bound[3])) continue;
      for (int d = gb.first_cluster; d < gb.first_cluster + gb.n_cluster; ++d) {
        const float radii = radius + tables.cluster[d].bound[3];
        if (near(ca[c], cb[d], radii)) likeliest.update(square_root(squared_distance(ca[c], cb[d])) - radii, p, c, d);
      }
    }
  }
  for_each_lane(lanes_set(likeliest.pair >= 0), [&](int lane) {
    nearest_in_lane(placed, likeliest.pair[lane], likeliest.mine[lane], likeliest.other[lane], lane, best);
  });
}

static inline void nearest_of_links(Placed& placed, int p, Nearest& best) {
  const Tables& tables = placed.tables;
  if (!may_be_nearer(placed, p, best.distance)) return;
  const int a = tables.pair[2 * p], b = tables.pair[2 * p + 1];
  const Group &ga = tables.group[a], &gb = tables.group[b];
  const float slack = tables.slack[p];
  const Vec<F>*ca = placed.clusters(a), *cb = placed.clusters(b);
  // The lanes in which two bounding spheres may be nearer than the best distance.
  const auto near = [&](const Vec<F>& p, const Vec<F>& q, float radii) {
    const F within = relu(best.distance + (radii + slack));
    return lanes_below(squared_distance(p, q), within * within);
  };
  for (int c = ga.first_cluster; c < ga.first_cluster + ga.n_cluster; ++c) {
    const Cluster& mine = tables.cluster[c];
    if (ga.n_cluster > 1 && !near(ca[c], placed.bound[b], mine.bound[3] + gb.bound[3])) continue;
    for (int d = gb.first_cluster; d < gb.first_cluster + gb.n_cluster; ++d) {
      const Cluster& other = tables.cluster[d];
      const int lanes = near(ca[c], cb[d], mine.bound[3] + other.bound[3]);
      if (are_few(lanes)) {
        for_each_lane(lanes, [&](int lane) { nearest_in_lane(placed, p, c, d, lane, best); });
        continue;
      }
      const Vec<F>*sa = placed.spheres(a), *sb = placed.spheres(b);
      for (int k = mine.first; k < mine.first + mine.count; ++k) {
        const float radius = tables.sphere[4 * k + 3];
        if (mine.count > 1 && !near(sa[k], cb[d], radius + other.bound[3])) continue;
        for (int m = other.first; m < other.first + other.count; ++m)
          best.update(square_root(squared_distance(sa[k], sb[m])) - (radius + tables.sphere[4 * m + 3] + slack), k,
                      -1 - m);
      }
    }
  }
}

static inline void nearest_to_obstacle(Placed& placed, int g, int j, Nearest& best) {
  const Tables& tables = placed.tables;
  const Group& group = tables.group[g];
  const Obstacle& o = tables.obstacle[j];
  const Vec<F>* centre = placed.clusters(g);
  for (int c = group.first_cluster; c < group.first_cluster + group.n_cluster; ++c) {
    const Cluster& cluster = tables.cluster[c];
    int lanes = (1 << kLanes<float>)-1;
    if (group.n_cluster > 1)
      lanes = lanes_below(signed_distance(tables, o, centre[c]) - (cluster.bound[3] + o.keep), best.distance);
    if (are_few(lanes)) {
      for_each_lane(lanes, [&](int lane) {
        const InOneLane one(tables, placed.X_W[group.frame], c, lane);
        for (int v = 0; v < kPacks; ++v)
          best.update(signed_distance(tables, o, one.centre[v]) - (one.radius[v] + o.keep),
                      cluster.first + v * kLanes<float>, false, j, lane, 0);
      });
      continue;
    }
    const Vec<F>* sphere = placed.spheres(g);
    for (int k = cluster.first; k < cluster.first + cluster.count; ++k)
      best.update(signed_distance(tables, o, sphere[k]) - (tables.sphere[4 * k + 3] + o.keep), k, j);
  }
}

// The nearest pair below `far`, or none (a == -1).
static inline Nearest nearest(const Tables& tables, const Frame<F>* X_W, float far) {
  Placed placed(tables, X_W);
  Nearest best = {F{} + far, MaskF{} - 1, MaskF{}};
  for_each_bound(tables, X_W, [&](int k, F clearance) { best.update(clearance, -2 - k, 0); });
  if (tables.n_cluster > 2 * tables.n_group) begin_with_likeliest(placed, best);
  for (int p = 0; p < tables.n_pair; ++p) nearest_of_links(placed, p, best);
  for (int g = tables.n_group - 1; g >= 0; --g) {
    const Group& group = tables.group[g];
    if (group.frame == 0) continue;  // the base does not move
    const auto reach = [&](float keep) { return relu(best.distance + (group.bound[3] + keep)); };
    for_each_obstacle_near(tables, placed.bound[g], reach, [&](int j) {
      const Obstacle& o = tables.obstacle[j];
      if (o.ignores >> group.link & 1) return false;
      if (!any(near_bound(o, placed.bound[g], reach(o.keep)))) return false;
      if (any(signed_distance(tables, o, placed.bound[g]) - (group.bound[3] + o.keep) < best.distance))
        nearest_to_obstacle(placed, g, j, best);
      return false;
    });
  }
  return best;
}

}  // namespace gp::GP_ISA

// Spheres of a cluster side by side, in one lane of a block of configurations. Dissimilar configurations need few
// clusters each, but different ones; evaluating these in all lanes would take several times as long.
#pragma once
#include <cstddef>

#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

constexpr int kPacks = (kClusterSize + kLanes<float> - 1) / kLanes<float>;

struct InOneLane {
  Vec<F> centre[kPacks];
  F radius[kPacks];  // far below 0 for missing spheres

  InOneLane() = default;
  InOneLane(const Tables& tables, const Frame<F>& X, int cluster, int lane) {
    const float* row = tables.packed + size_t(cluster) * 4 * kPackedSize;
    float R[9];
    for (int k = 0; k < 9; ++k) R[k] = X.R[k][lane];
    const float p[3] = {X.p.x[lane], X.p.y[lane], X.p.z[lane]};
    for (int v = 0; v < kPacks; ++v) {
      F at[4];
      for (int k = 0; k < 4; ++k) __builtin_memcpy(&at[k], row + k * kPackedSize + v * kLanes<float>, sizeof(F));
      centre[v] = {at[0] * R[0] + at[1] * R[1] + at[2] * R[2] + p[0], at[0] * R[3] + at[1] * R[4] + at[2] * R[5] + p[1],
                   at[0] * R[6] + at[1] * R[7] + at[2] * R[8] + p[2]};
      radius[v] = at[3];
    }
  }
};

template <class V> static inline V squared_distance(const Vec<V>& a, float x, float y, float z) {
  const V dx = a.x - x, dy = a.y - y, dz = a.z - z;
  return dx * dx + dy * dy + dz * dz;
}

// Whether any two spheres of the clusters are closer than `kept`.
static inline bool touch(const InOneLane& one, int count, const InOneLane& two, float kept) {
  for (int k = 0; k < count; ++k) {
    const int u = k / kLanes<float>, i = k % kLanes<float>;
    const float x = one.centre[u].x[i], y = one.centre[u].y[i], z = one.centre[u].z[i], r = one.radius[u][i] + kept;
    for (int v = 0; v < kPacks; ++v) {
      const F reach = relu(two.radius[v] + r);
      if (any_below(squared_distance(two.centre[v], x, y, z), reach * reach)) return true;
    }
  }
  return false;
}

// Whether so few lanes are set that single ones are faster than the block.
static inline bool are_few(int lanes) { return __builtin_popcount(unsigned(lanes)) * 2 < kLanes<float>; }

template <class Visit> static inline void for_each_lane(int lanes, Visit visit) {
  for (; lanes; lanes &= lanes - 1) visit(__builtin_ctz(unsigned(lanes)));
}

}  // namespace gp::GP_ISA

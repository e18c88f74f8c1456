// A tree of boxes around obstacles (bounding volume hierarchy): obstacles far from a link are skipped together.
#pragma once
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "tables.hpp"

namespace gp {

// The tree in depth-first order, and the obstacles in the order of its leaves, after those without bounds.
struct Cells {
  std::vector<Cell> cell;
  std::vector<int32_t> order;
  int32_t n_boundless = 0;

  explicit Cells(const std::vector<Obstacle>& obstacles) : obstacles_(obstacles) {
    order.resize(obstacles.size());
    std::iota(order.begin(), order.end(), 0);
    const auto bounded =
        std::stable_partition(order.begin(), order.end(), [&](int32_t j) { return obstacles[size_t(j)].bound[3] < 0; });
    n_boundless = int32_t(bounded - order.begin());
    for (const Obstacle& o : obstacles) box_.push_back(box_of(o));
    if (bounded != order.end()) split(n_boundless, int32_t(order.size()));
  }

 private:
  static constexpr int kLeaf = 4;  // most obstacles in a leaf

  struct Box {
    float lower[3], upper[3];
  };

  // Bounds a box itself; of other kinds, the bounding sphere.
  static Box box_of(const Obstacle& o) {
    Box box{};
    for (int k = 0; k < 3; ++k) {
      float half = o.bound[3], centre = o.bound[k];
      if (o.kind == kBox) {
        centre = o.p[k], half = 0;
        for (int i = 0; i < 3; ++i) half += std::abs(o.R[3 * k + i]) * o.size[i];
      }
      const float rounding = 1e-6f * (std::abs(centre) + half + 1);
      box.lower[k] = centre - half - rounding, box.upper[k] = centre + half + rounding;
    }
    return box;
  }

  void split(int32_t first, int32_t last) {
    Box around = box_[size_t(order[size_t(first)])];
    float keep = 0;
    for (int32_t i = first; i < last; ++i) {
      const size_t j = size_t(order[size_t(i)]);
      keep = std::max(keep, obstacles_[j].keep);
      for (int k = 0; k < 3; ++k) {
        around.lower[k] = std::min(around.lower[k], box_[j].lower[k]);
        around.upper[k] = std::max(around.upper[k], box_[j].upper[k]);
      }
    }
    Cell made{};
    int widest = 0;
    for (int k = 0; k < 3; ++k) {
      made.centre[k] = 0.5f * (around.lower[k] + around.upper[k]);
      made.half[k] = 0.5f * (around.upper[k] - around.lower[k]);
      if (made.half[k] > made.half[widest]) widest = k;
    }
    made.keep = keep, made.first = first;
    const bool leaf = last - first <= kLeaf;
    made.count = leaf ? last - first : 0;
    const size_t own = cell.size();
    cell.push_back(made);
    if (!leaf) {
      const int32_t middle = first + (last - first) / 2;
      const auto at = [&](int32_t j) { return box_[size_t(j)].lower[widest] + box_[size_t(j)].upper[widest]; };
      std::nth_element(order.begin() + first, order.begin() + middle, order.begin() + last,
                       [&](int32_t a, int32_t b) { return std::make_pair(at(a), a) < std::make_pair(at(b), b); });
      split(first, middle);
      split(middle, last);
    }
    cell[own].next = int32_t(cell.size());
  }

  const std::vector<Obstacle>& obstacles_;
  std::vector<Box> box_;
};

}  // namespace gp

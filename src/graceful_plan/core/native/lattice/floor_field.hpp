// What the search knows of a floor: which cells the footprint may be over, what impact costs there, and a bound from
// below of what it costs to get to the goal, over cells alone.
#pragma once

#include <cstdint>
#include <vector>

#include "lattice/primitives.hpp"

namespace gp::lattice {

// Row by row from below, in the frame of the map: cell (column x, row y) has its centre at (x + .5, y + .5) resolution.
struct Floor {
  int columns, rows;
  double resolution;
  const float* distance;  // [rows, columns] from the centre of a cell to the next obstacle, not above it [m]
  const float* impact;    // [rows, columns, headings] or none

  bool holds(const Cell& c) const { return c.x >= 0 && c.y >= 0 && c.x < columns && c.y < rows; }
  size_t index(const Cell& c) const { return size_t(c.y) * size_t(columns) + size_t(c.x); }
  Cell cell(double x, double y) const { return {int(std::floor(x / resolution)), int(std::floor(y / resolution))}; }
  double clearance(double x, double y) const {  // not above the distance from the point to the next obstacle
    const Cell c = cell(x, y);
    if (!holds(c)) return -1.0;
    return distance[index(c)] - std::hypot(x - (c.x + 0.5) * resolution, y - (c.y + 0.5) * resolution);
  }
};

// Cost to go over cells for the disc that turns inside of the footprint: A* backwards from the goal, until the start is
// reached and a tenth more. Where it did not get, the least cost that it can find there (as in D. Silver, "Cooperative
// pathfinding", AIIDE 2005, for its resumable search, which is not resumed here).
class CostToGo {
 public:
  // `least` is the least impact of each cell over headings and neighbours, times its weight, or empty.
  CostToGo(const Floor& floor, double inner, const std::vector<float>& least)
      : floor_(floor), inner_(inner), least_(least), cost_(size_t(floor.rows) * size_t(floor.columns), kFar) {}

  // Whether there is a way and the time to find it; afterwards `at` answers.
  template <class Late> bool flood(const Cell& start, const Cell& goal, double more, const Late& late) {
    start_ = start, goal_ = goal, found_ = false, edge_ = kFar;
    open_.clear();
    int64_t popped = 0;
    const size_t to = floor_.index(start);
    cost_[floor_.index(goal)] = 0.0F;
    push(goal, 0.0F);
    while (!open_.empty()) {
      const Entry top = open_.front();
      if (top.f > edge_) return true;
      if (++popped % kClockEvery == 0 && late()) return false;
      std::pop_heap(open_.begin(), open_.end(), later);
      open_.pop_back();
      const Cell cell{int(top.cell % uint32_t(floor_.columns)), int(top.cell / uint32_t(floor_.columns))};
      const float here = cost_[top.cell];
      if (top.f > here + far(cell, start_) * 1.000001F + 1e-5F) continue;  // found again, cheaper
      if (top.cell == to && !found_) found_ = true, edge_ = float(1.1 * double(top.f) + more);
      expand(cell, here);
    }
    complete_ = true;
    return found_;
  }
  // A bound from below [m] of getting from a cell to the goal's.
  double at(const Cell& cell) const {
    const float known = cost_[floor_.index(cell)], aside = far(cell, start_);
    if (known + aside <= edge_ && known < kFar) return known;
    return complete_ ? double(kFar) : std::max(edge_ - aside, far(cell, goal_));
  }

 private:
  static constexpr int64_t kClockEvery = 8192;
  static constexpr float kFar = std::numeric_limits<float>::infinity();
  struct Entry {
    float f;
    uint32_t cell;
  };
  static bool later(const Entry& a, const Entry& b) { return a.f > b.f || (a.f == b.f && a.cell > b.cell); }
  float far(const Cell& a, const Cell& b) const {  // octile
    const int dx = std::abs(a.x - b.x), dy = std::abs(a.y - b.y);
    return float(floor_.resolution) * (float(std::max(dx, dy)) + 0.41421356F * float(std::min(dx, dy)));
  }
  void push(const Cell& cell, float cost) {
    open_.push_back({cost + far(cell, start_), uint32_t(floor_.index(cell))});
    std::push_heap(open_.begin(), open_.end(), later);
  }
  void expand(const Cell& cell, float here) {
    const size_t from = floor_.index(cell);
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const Cell next{cell.x + dx, cell.y + dy};
        if ((dx == 0 && dy == 0) || !floor_.holds(next)) continue;
        const size_t to = floor_.index(next);
        // Float: the disc is let through where rounding decides.
        if (double(floor_.distance[to]) < inner_) continue;
        const float step = float(floor_.resolution) * (dx != 0 && dy != 0 ? 1.41421356F : 1.0F);
        const float cost = here + step * (least_.empty() ? 1.0F : 1.0F + std::min(least_[from], least_[to]));
        if (cost < cost_[to]) cost_[to] = cost, push(next, cost);
      }
    }
  }

  const Floor& floor_;
  double inner_;
  const std::vector<float>& least_;
  std::vector<float> cost_;
  std::vector<Entry> open_;
  Cell start_{}, goal_{};
  float edge_ = kFar;
  bool found_ = false, complete_ = false;
};

}  // namespace gp::lattice

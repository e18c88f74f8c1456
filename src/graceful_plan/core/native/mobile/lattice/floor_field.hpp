// The floor as the lattice search uses it: free cells for the footprint, impact in each cell, and a lower bound on the
// cost to the goal, computed over cells alone.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "mobile/grid/grid_search.hpp"
#include "mobile/lattice/primitives.hpp"

namespace gp::lattice {

// Rows from below, in the frame of the map: cell (column x, row y) has its centre at (x + .5, y + .5) resolution.
struct Floor {
  int columns, rows;
  double resolution;
  const float* distance;     // [rows, columns] lower bound on the distance from a cell's centre to an obstacle [m]
  const float* impact;       // [rows, columns, headings] for driving forward, or null
  const float* impact_back;  // the same for driving backwards

  bool holds(const Cell& c) const { return c.x >= 0 && c.y >= 0 && c.x < columns && c.y < rows; }
  size_t index(const Cell& c) const { return size_t(c.y) * size_t(columns) + size_t(c.x); }
  Cell cell(double x, double y) const { return {int(std::floor(x / resolution)), int(std::floor(y / resolution))}; }
  double clearance(double x, double y) const {  // lower bound on the distance from the point to the next obstacle
    const Cell c = cell(x, y);
    if (!holds(c)) return -1.0;
    return distance[index(c)] - std::hypot(x - (c.x + 0.5) * resolution, y - (c.y + 0.5) * resolution);
  }
};

// The floor as a search over cells uses it: free cells for the base, and the impact of driving in each of eight
// directions.
class Guide {
 public:
  static constexpr int kSteps = grid::GridMap::kSteps;
  using Eight = std::array<float, kSteps>;

  // For a lower bound: the free cells are those of the disc inside the footprint. The impact is the least over headings
  // within 45 degrees of the direction, because curves are made of such steps, and over neighbouring cells, because a
  // chain of cells deviates from the curve by up to one cell.
  static Guide bound(const Floor& floor, double inner, int headings) {
    Guide guide(floor, inner, nullptr);
    if (floor.impact) {
      const int reach = headings / 8 + 1;
      guide.ahead_ = spread(floor, guide.map_, guide.gathered(floor, floor.impact, headings, 0, reach, true));
      guide.back_ =
          spread(floor, guide.map_, guide.gathered(floor, floor.impact_back, headings, headings / 2, reach, true));
    }
    return guide;
  }
  // For an estimate: mean impact over the headings nearest to the direction. Cells with little clearance for the
  // footprint cost `kTight` times as much, because most paths through them are dead ends.
  static Guide estimate(const Floor& floor, double inner, double room, int headings) {
    std::vector<float> tight(size_t(floor.rows) * size_t(floor.columns));
    for (size_t k = 0; k < tight.size(); ++k) tight[k] = double(floor.distance[k]) < room ? kTight - 1.0F : 0.0F;
    Guide guide(floor, inner, tight.data());
    if (floor.impact) {
      guide.ahead_ = guide.gathered(floor, floor.impact, headings, 0, headings / 16, false);
      guide.back_ = guide.gathered(floor, floor.impact_back, headings, headings / 2, headings / 16, false);
    }
    return guide;
  }
  const grid::GridMap& map() const { return map_; }
  // Indexed by the steps of a search from the goal; the base drives each step in the opposite direction.
  const Eight& ahead(size_t at) const { return ahead_[at]; }
  const Eight& back(size_t at) const { return back_[at]; }

 private:
  static constexpr float kTight = 1000.0F;  // cost of a cell where the footprint hardly fits, relative to others

  Guide(const Floor& floor, double inner, const float* tight)
      : map_(closed(floor, inner).data(), tight, floor.rows, floor.columns, floor.resolution, true) {}
  static std::vector<uint8_t> closed(const Floor& floor, double inner) {
    std::vector<uint8_t> out(size_t(floor.rows) * size_t(floor.columns));
    // Distances are floats; cells at the limit stay open.
    for (size_t k = 0; k < out.size(); ++k) out[k] = double(floor.distance[k]) < inner;
    return out;
  }
  std::vector<Eight> gathered(const Floor& floor, const float* impact, int headings, int turned, int reach,
                              bool least) const {
    std::vector<Eight> out(map_.size(), Eight{});
    std::array<int, kSteps> middle{};
    for (int k = 0; k < kSteps; ++k) {
      const double yaw = std::atan2(-grid::GridMap::kDy[k], -grid::GridMap::kDx[k]);
      middle[size_t(k)] = int(std::lround(yaw * headings / (2.0 * kPi))) + turned + 2 * headings;
    }
    for (int y = 0; y < floor.rows; ++y) {
      for (int x = 0; x < floor.columns; ++x) {
        const float* of = impact + floor.index({x, y}) * size_t(headings);
        Eight& to = out[map_.index(x, y)];
        for (size_t k = 0; k < kSteps; ++k) {
          float low = of[middle[k] % headings], sum = 0.0F;
          for (int h = middle[k] - reach; h <= middle[k] + reach; ++h) {
            low = std::min(low, of[h % headings]), sum += of[h % headings];
          }
          to[k] = least ? low : sum / float(2 * reach + 1);
        }
      }
    }
    return out;
  }
  static std::vector<Eight> spread(const Floor& floor, const grid::GridMap& map, const std::vector<Eight>& own) {
    std::vector<Eight> out = own;
    for (int y = 0; y < floor.rows; ++y) {
      for (int x = 0; x < floor.columns; ++x) {
        Eight& to = out[map.index(x, y)];
        for (int dy = -1; dy <= 1; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            if (!floor.holds({x + dx, y + dy})) continue;
            const Eight& near = own[map.index(x + dx, y + dy)];
            for (size_t k = 0; k < kSteps; ++k) to[k] = std::min(to[k], near[k]);
          }
        }
      }
    }
    return out;
  }

  grid::GridMap map_;
  std::vector<Eight> ahead_, back_;
};

// Cost to go over cells, searched from the goal until some distance beyond the start: A*, or Dijkstra where there is
// impact. For cells that were not reached, `at` returns the least possible cost (as in D. Silver, "Cooperative
// pathfinding", AIIDE 2005, but without resuming the search).
class CostToGo {
 public:
  // `penalty`: cost of a metre backwards; infinite if the base does not drive backwards.
  CostToGo(const Guide& guide, double w, double penalty)
      : guide_(guide), search_(guide.map()), w_(w), penalty_(penalty) {}

  // Whether there is a path and it was found in time; afterwards `at` is valid.
  template <class Late> bool flood(const Cell& start, const Cell& goal, double share, double more, const Late& late) {
    const grid::GridMap& map = guide_.map();
    const size_t from = map.index(goal.x, goal.y), to = map.index(start.x, start.y);
    start_ = start, goal_ = goal;
    const double cell = map.resolution(), aslant = grid::kDiagonal * cell;
    const Four diagonal = {aslant, cell, aslant, 0.0}, straight = {cell, 0.0, cell, 0.0};
    if (w_ == 0.0 && map.has_extra_cost()) {
      edge_ = search_.flood_towards(from, to, share, more, true, grid::GridSearch::Mean{map}, late);
    } else if (w_ == 0.0) {
      const grid::GridSearch::Steps same{diagonal, straight, diagonal};
      edge_ = search_.flood_towards(from, to, share, more, true, [&](size_t) { return same; }, late);
    } else {
      const auto has_extra_cost = [&](size_t at) {
        const Guide::Eight &a = guide_.ahead(at), &b = guide_.back(at);
        double price[Guide::kSteps];
        for (size_t k = 0; k < Guide::kSteps; ++k) {
          price[k] = std::min(1.0 + w_ * double(a[k]), penalty_ + w_ * double(b[k]));
        }
        const double tight = 2.0 * double(map.half()[at]) / cell;  // a factor
        for (double& one : price) one *= tight;
        return grid::GridSearch::Steps{Four{price[0], price[1], price[2], 0.0} * diagonal,
                                       Four{price[3], 0.0, price[4], 0.0} * straight,
                                       Four{price[5], price[6], price[7], 0.0} * diagonal};
      };
      edge_ = search_.flood_towards(from, to, share, more, false, has_extra_cost, late);
    }
    return edge_ >= 0.0 && search_.costs()[to] < kUnreached && guide_.map().free(to);
  }
  // Lower bound [m] on the cost from a cell to the goal's cell.
  double at(const Cell& cell) const {
    const size_t k = guide_.map().index(cell.x, cell.y);
    if (!guide_.map().free(k)) return kUnreached;
    const double known = search_.costs()[k], aside = far(cell, start_);
    // An estimate may be too high: cells that were not reached lead away from the goal.
    if (guide_.map().has_extra_cost()) return std::min(known, edge_ + far(cell, goal_));
    if (w_ == 0.0) return known + aside <= edge_ ? known : std::max(edge_ - aside, far(cell, goal_));
    return std::min(known, edge_);
  }

 private:
  static constexpr double kUnreached = std::numeric_limits<double>::infinity();
  using Four = grid::GridSearch::Four;
  double far(const Cell& a, const Cell& b) const {  // octile
    const int dx = std::abs(a.x - b.x), dy = std::abs(a.y - b.y);
    return guide_.map().resolution() * (std::max(dx, dy) + (grid::kDiagonal - 1.0) * std::min(dx, dy));
  }

  const Guide& guide_;
  grid::GridSearch search_;
  double w_, penalty_;
  Cell start_{}, goal_{};
  double edge_ = kUnreached;
};

}  // namespace gp::lattice

// Theta*: A* over cells whose parents may be any cell in line of sight (K. Daniel, A. Nash, S. Koenig, A. Felner,
// "Theta*: any-angle path planning on grids", JAIR 39, 2010), here with costs of the cells along the line. Afterwards
// vertices are removed where that lowers the cost. The result is not exact, but never costs more than the best path
// over eight neighbours, which is searched as well.
#pragma once

#include "mobile/grid/grid_search.hpp"

namespace gp::grid {

// Cost of the straight line between the centres of two cells; infinite if it touches a closed cell, or once it reaches
// `most`. Where it passes exactly through a corner, both adjacent cells have to be free.
inline double straight_cost(const GridMap& map, size_t from, size_t to, double most) {
  int x = map.x(from), y = map.y(from);
  const int64_t nx = std::abs(map.x(to) - x), ny = std::abs(map.y(to) - y);
  const std::ptrdiff_t sx = map.x(to) > x ? 1 : -1, sy = map.y(to) > y ? map.stride() : -map.stride();
  if (nx == 0 && ny == 0) return 0.0;
  const double length = 2.0 * std::hypot(double(nx), double(ny));  // half() is the cost of half a cell
  std::ptrdiff_t at = std::ptrdiff_t(from);
  double sum = 0.0, begin = 0.0;
  for (int64_t i = 0, j = 0; i < nx || j < ny;) {
    // Cell borders are crossed at (2 i + 1) / (2 nx) and (2 j + 1) / (2 ny) of the line.
    const int64_t across = (2 * i + 1) * ny, along = (2 * j + 1) * nx;
    const bool right = j >= ny || (i < nx && across <= along), up = i >= nx || (j < ny && along <= across);
    const double end =
        right ? (2.0 * double(i) + 1.0) / (2.0 * double(nx)) : (2.0 * double(j) + 1.0) / (2.0 * double(ny));
    sum += (end - begin) * length * double(map.half()[at]);
    begin = end;
    if (right && up && !(map.free(size_t(at + sx)) && map.free(size_t(at + sy)))) return kInfinity;
    if (right) at += sx, ++i;
    if (up) at += sy, ++j;
    if (sum >= most || !map.free(size_t(at))) return kInfinity;
  }
  return sum + (1.0 - begin) * length * double(map.half()[at]);
}

class AnyAngle {
 public:
  explicit AnyAngle(const GridMap& map) : map_(map) {}

  template <class Late> GridPath path(size_t from, size_t to, const Late& late) {
    GridPath found;
    if (!map_.free(from) || !map_.free(to)) return found;
    GridSearch search(map_);
    GridPath steps = search.path(from, to, true, late);
    found.expansions = steps.expansions, found.stopped = steps.stopped;
    if (!steps.found) return found;
    GridPath sought = theta(from, to, late);
    found.expansions += sought.expansions, found.stopped = sought.stopped;
    pulled(&steps);
    if (sought.found) pulled(&sought);
    GridPath& best = sought.found && sought.cost < steps.cost ? sought : steps;
    found.found = true, found.cost = best.cost, found.cells = std::move(best.cells);
    return found;
  }

 private:
  static constexpr int64_t kClockEvery = 1024;

  double far(size_t a, size_t b) const {
    return map_.least() * std::hypot(double(map_.x(a) - map_.x(b)), double(map_.y(a) - map_.y(b)));
  }
  template <class Late> GridPath theta(size_t from, size_t to, const Late& late) {
    GridPath found;
    std::vector<double> cost(map_.size(), kInfinity);
    std::vector<uint32_t> parent(map_.size());
    std::vector<uint8_t> closed(map_.size(), 0);
    BucketQueue queue(map_.least());
    cost[from] = 0.0, parent[from] = uint32_t(from);
    queue.push(far(from, to), uint32_t(from));
    while (!queue.empty()) {
      queue.advance();
      const size_t at = queue.pop();
      if (closed[at]) continue;
      closed[at] = 1;
      if (at == to) break;
      if (++found.expansions % kClockEvery == 0 && late()) {
        found.stopped = true;
        return found;
      }
      const size_t above = parent[at];
      for (int k = 0; k < GridMap::kSteps; ++k) {
        const size_t next = size_t(std::ptrdiff_t(at) + map_.by()[k]);
        if (!(map_.steps()[at] >> k & 1) || closed[next]) continue;
        const double step = straight_cost(map_, at, next, kInfinity), seen = cost[next];
        double g = cost[at] + step;
        uint32_t via = uint32_t(at);
        if (above != at) {
          const double limit = std::min(g * (1.0 + 1e-12), seen) - cost[above];
          const double straight = cost[above] + straight_cost(map_, above, next, limit);
          if (straight <= g) g = straight, via = uint32_t(above);
        }
        if (g >= seen) continue;
        cost[next] = g, parent[next] = via;
        queue.push(g + far(next, to), uint32_t(next));
      }
    }
    if (!closed[to]) return found;
    found.found = true, found.cost = cost[to];
    for (size_t at = to; at != from; at = parent[at]) found.cells.push_back(uint32_t(at));
    found.cells.push_back(uint32_t(from));
    std::reverse(found.cells.begin(), found.cells.end());
    return found;
  }
  // Removes vertices as long as the cost does not increase, and recomputes the cost.
  void pulled(GridPath* path) const {
    std::vector<uint32_t>& cells = path->cells;
    for (bool shorter = true; shorter;) {
      shorter = false;
      std::vector<uint32_t> kept{cells.front()};
      for (size_t k = 1; k + 1 < cells.size(); ++k) {
        const double via = straight_cost(map_, kept.back(), cells[k], kInfinity) +
                           straight_cost(map_, cells[k], cells[k + 1], kInfinity);
        if (straight_cost(map_, kept.back(), cells[k + 1], kInfinity) <= via * (1.0 + 1e-12)) {
          shorter = true;
        } else {
          kept.push_back(cells[k]);
        }
      }
      if (cells.size() > 1) kept.push_back(cells.back());
      cells = std::move(kept);
    }
    path->cost = 0.0;
    for (size_t k = 1; k < cells.size(); ++k) path->cost += straight_cost(map_, cells[k - 1], cells[k], kInfinity);
  }

  const GridMap& map_;
};

}  // namespace gp::grid

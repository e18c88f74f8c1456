// Exact Dijkstra and A* searches over the eight neighbours of cells, with bucket queues.
#pragma once

#include <array>
#include <cstring>

#include "mobile/grid/bucket_queue.hpp"
#include "mobile/grid/grid_map.hpp"

namespace gp::grid {

struct GridPath {
  bool found = false, stopped = false;
  double cost = kInfinity;
  std::vector<uint32_t> cells;  // indices of the padded map
  int64_t expansions = 0;
};

class GridSearch {
 public:
  explicit GridSearch(const GridMap& map) : map_(map) {}

  // Least costs to all reachable cells; the array is padded like the map.
  template <class Late> bool flood(size_t from, const Late& late) {
    begin(from);
    const auto none = [](size_t) { return 0.0; };
    BucketQueue queue(map_.least());
    return run(queue, kNowhere, none, Mean{map_}, late);
  }
  // Like flood, but stops once the costs suffice for paths to a cell. They are exact where the cost (if `informed`,
  // plus the octile distance to the cell) is at most the returned limit: `share` times that cell's cost, plus `more`.
  // `price` gives the costs of the eight steps out of a cell. Returns a negative value if time is up. Use `informed`
  // only where steps cost their length, or much more; otherwise buckets make the search correct the same cells over and
  // over.
  template <class Price, class Late>
  double flood_towards(size_t from, size_t to, double share, double more, bool informed, const Price& price,
                       const Late& late) {
    begin(from);
    share_ = share, more_ = more;
    BucketQueue queue(map_.least());
    const auto none = [](size_t) { return 0.0; };
    const auto octile = [&](size_t at) { return this->octile(at, to); };
    if (!(informed ? run(queue, to, octile, price, late) : run(queue, to, none, price, late))) return -1.0;
    return emptied_ ? kInfinity : share * cost_[to] + more;
  }
  template <class Late> GridPath path(size_t from, size_t to, bool informed, const Late& late) {
    GridPath found;
    if (!map_.free(from) || !map_.free(to)) return found;
    begin(from);
    const auto none = [](size_t) { return 0.0; };
    const auto octile = [&](size_t at) { return this->octile(at, to); };
    BucketQueue buckets(map_.least());
    HeapQueue heap;
    const Mean mean{map_};
    found.stopped = !(!informed               ? run(buckets, to, none, mean, late)
                      : map_.has_extra_cost() ? run(heap, to, octile, mean, late)
                                              : run(buckets, to, octile, mean, late));
    found.expansions = expansions_;
    if (cost_[to] == kInfinity || found.stopped) return found;
    found.found = true, found.cost = cost_[to];
    for (size_t at = to; at != from; at = before(at)) found.cells.push_back(uint32_t(at));
    found.cells.push_back(uint32_t(from));
    std::reverse(found.cells.begin(), found.cells.end());
    return found;
  }
  using Four [[gnu::vector_size(32)]] = double;
  struct Steps {  // costs of the steps to a row of three neighbours each; the last lane is unused
    Four below, beside, above;
  };
  // Step cost: length times the mean of both cells.
  struct Mean {
    const GridMap& map;
    Steps operator()(size_t at) const {
      const float* h = map.half() + at;
      const double own = double(*h);
      const auto row = [&](const float* p) {
        return Four{double(p[-1]) + own, double(p[0]) + own, double(p[1]) + own, 0.0};
      };
      const Four aslant = {kDiagonal, 1.0, kDiagonal, 0.0};
      return {row(h - map.stride()) * aslant, row(h), row(h + map.stride()) * aslant};
    }
  };
  const std::vector<double>& costs() const { return cost_; }
  int64_t expansions() const { return expansions_; }

 private:
  static constexpr size_t kNowhere = ~size_t(0);
  static constexpr int64_t kClockEvery = 16384;

  void begin(size_t from) {
    // Closed cells get a cost below all others, so that no step into them is an improvement.
    cost_.assign(map_.size() + 1, -kInfinity);  // four are read at a time, one beyond the end
    for (size_t k = 0; k < map_.size(); ++k) cost_[k] = map_.free(k) ? kInfinity : -kInfinity;
    expansions_ = 0, from_ = from, emptied_ = false;
  }
  double octile(size_t a, size_t b) const {
    const int dx = std::abs(map_.x(a) - map_.x(b)), dy = std::abs(map_.y(a) - map_.y(b));
    return map_.least() * (std::max(dx, dy) + (kDiagonal - 1.0) * std::min(dx, dy)) * (1.0 - 1e-12);
  }
  // The predecessor of a cell on a cheapest path: the neighbour with the least sum of cost and step.
  size_t before(size_t at) const {
    size_t best = at;
    double least = kInfinity;
    for (int k = 0; k < GridMap::kSteps; ++k) {
      if (!(map_.steps()[at] >> k & 1)) continue;
      const size_t near = size_t(std::ptrdiff_t(at) + map_.by()[k]);
      const double cost = cost_[near] + step(at, near, k);
      if (cost < least) least = cost, best = near;
    }
    return best;
  }
  double step(size_t a, size_t b, int k) const {
    const double sum = double(map_.half()[a]) + double(map_.half()[b]);
    return GridMap::kDx[k] != 0 && GridMap::kDy[k] != 0 ? kDiagonal * sum : sum;
  }

  template <class Queue, class Bound, class Price, class Late>
  bool run(Queue& queue, size_t to, const Bound& bound, const Price& price, const Late& late) {
    const std::ptrdiff_t stride = map_.stride();
    std::vector<uint8_t> left = map_.steps();  // 0 once a cell has been expanded
    const bool informed = bound(from_) > 0.0;
    cost_[from_] = 0.0;
    queue.push(bound(from_), uint32_t(from_));
    while (!queue.empty()) {
      queue.advance();
      if (to != kNowhere && queue.floor() > share_ * cost_[to] + more_) return true;
      while (queue.more()) {
        const size_t at = queue.pop();
        const uint32_t ways = left[at];
        if (ways == 0) continue;  // a stale copy of a cell that was expanded at a lower cost
        left[at] = 0;
        if (++expansions_ % kClockEvery == 0 && late()) return false;
        const Steps steps = price(at);
        const double here = cost_[at];
        double found[9];
        const auto relax = [&](std::ptrdiff_t row, int shift, const Four& length) {
          Four now;
          std::memcpy(&now, &cost_[size_t(std::ptrdiff_t(at) + row - 1)], sizeof now);
          const Four next = here + length;
          uint32_t better = 0;
          for (int k = 0; k < 3; ++k) found[shift + k] = next[k], better |= uint32_t(next[k] < now[k]) << k;
          return better << shift;
        };
        // The 3 x 3 cells, without the one in the middle.
        const uint32_t nine =
            relax(-stride, 0, steps.below) | relax(0, 3, steps.beside) | relax(stride, 6, steps.above);
        uint32_t improved = ((nine & 15U) | (nine >> 1 & 240U)) & ways;
        for (; improved != 0; improved &= improved - 1) {
          const int k = __builtin_ctz(improved);
          const double g = found[k < 4 ? k : k + 1];
          const size_t next = size_t(std::ptrdiff_t(at) + map_.by()[k]);
          cost_[next] = g;
          if (informed) left[next] = map_.steps()[next];
          queue.push(informed ? g + bound(next) : g, uint32_t(next));
        }
      }
    }
    emptied_ = true;
    return true;
  }

  const GridMap& map_;
  std::vector<double> cost_;
  int64_t expansions_ = 0;
  size_t from_ = 0;
  bool emptied_ = false;             // whether all reachable cells were expanded
  double share_ = 1.0, more_ = 0.0;  // limits the search to share_ times the goal's cost, plus more_
};

}  // namespace gp::grid

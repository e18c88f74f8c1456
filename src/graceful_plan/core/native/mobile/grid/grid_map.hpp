// Free cells for a point, the cost per metre in each, and the possible steps from a cell to its eight neighbours.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace gp::grid {

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();
inline constexpr double kDiagonal = 1.4142135623730951;

// The map is padded with closed cells, so that no step leaves the arrays. A step costs its length times the mean cost
// per metre of the cells at its ends. A diagonal step needs both adjacent cells to be free, so no corner is cut (unless
// `cuts`).
class GridMap {
 public:
  static constexpr int kSteps = 8;

  // `charge`: additional cost per metre, at least 0, or null.
  GridMap(const uint8_t* closed, const float* charge, int rows, int columns, double resolution, bool cuts = false)
      : rows_(rows),
        columns_(columns),
        stride_(columns + 2),
        resolution_(resolution),
        has_extra_cost_(charge != nullptr) {
    const size_t n = size_t(rows + 2) * size_t(stride_);
    std::vector<uint8_t> free(n, 0);
    half_.assign(n, 0.0F), steps_.assign(n, 0);
    float least = std::numeric_limits<float>::infinity();
    for (int y = 0; y < rows; ++y) {
      for (int x = 0; x < columns; ++x) {
        const size_t from = size_t(y) * size_t(columns) + size_t(x), to = index(x, y);
        free[to] = !closed[from];
        half_[to] = float(0.5 * resolution * (1.0 + (charge ? double(charge[from]) : 0.0)));
        if (free[to]) least = std::min(least, half_[to]);
      }
    }
    least_ = std::isfinite(least) ? 2.0 * double(least) : resolution;
    for (int k = 0; k < kSteps; ++k) by_[size_t(k)] = kDy[k] * stride_ + kDx[k];
    for (int y = 0; y < rows; ++y) {
      for (int x = 0; x < columns; ++x) {
        const size_t at = index(x, y);
        if (!free[at]) continue;
        const auto open = [&](int dx, int dy) { return free[at + size_t(dy * stride_ + dx)] != 0; };
        for (int k = 0; k < kSteps; ++k) {
          const int dx = kDx[k], dy = kDy[k];
          const bool ok = open(dx, dy) && (cuts || dx == 0 || dy == 0 || (open(dx, 0) && open(0, dy)));
          steps_[at] = uint8_t(steps_[at] | (ok ? 1 << k : 0));
        }
      }
    }
    free_ = std::move(free);
  }

  int rows() const { return rows_; }
  int columns() const { return columns_; }
  int stride() const { return stride_; }
  double resolution() const { return resolution_; }
  size_t size() const { return free_.size(); }
  size_t index(int x, int y) const { return size_t(y + 1) * size_t(stride_) + size_t(x + 1); }
  int x(size_t at) const { return int(at % size_t(stride_)) - 1; }
  int y(size_t at) const { return int(at / size_t(stride_)) - 1; }
  bool holds(int x, int y) const { return x >= 0 && y >= 0 && x < columns_ && y < rows_; }
  bool free(size_t at) const { return free_[at] != 0; }
  // Half of the cost of a step by one cell width.
  const float* half() const { return half_.data(); }
  const std::vector<uint8_t>& steps() const { return steps_; }
  const std::ptrdiff_t* by() const { return by_.data(); }
  // Whether the map has charges, that is, costs per metre that differ between cells.
  bool has_extra_cost() const { return has_extra_cost_; }
  // Least cost of a step.
  double least() const { return least_; }

  static constexpr int kDx[kSteps] = {-1, 0, 1, -1, 1, -1, 0, 1};  // rows below, beside, above
  static constexpr int kDy[kSteps] = {-1, -1, -1, 0, 0, 1, 1, 1};

 private:
  int rows_, columns_, stride_;
  double resolution_, least_ = 0.0;
  bool has_extra_cost_;
  std::vector<uint8_t> free_, steps_;
  std::vector<float> half_;
  std::array<std::ptrdiff_t, kSteps> by_{};
};

}  // namespace gp::grid

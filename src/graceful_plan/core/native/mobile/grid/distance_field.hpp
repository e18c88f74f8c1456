// Exact distances from the centres of cells to the nearest obstacle, a union of squares: by columns, then by rows as
// the lower envelope of parabolas (A. Meijster, J. Roerdink, W. Hesselink, "A general algorithm for computing distance
// transforms in linear time", 2000; P. Felzenszwalb, D. Huttenlocher, "Distance transforms of sampled functions",
// 2012).
//
// The side of a square is half a cell nearer than its centre. From a cell in another column, the nearest point of a
// column of squares lies on the border of the column, so the parabolas of the envelope are centred at borders.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace gp::grid {

class DistanceField {
 public:
  // `outside`: whether the outside of the map is an obstacle. The distances are in cells times `resolution`, rounded
  // down; 0 on obstacles, and infinite if there are none.
  static void compute(const uint8_t* blocked, int rows, int columns, bool outside, double resolution, float* out) {
    DistanceField field(columns, outside);
    field.by_columns(blocked, rows, out);
    for (int y = 0; y < rows; ++y) field.by_row(out + size_t(y) * size_t(columns), resolution);
  }

 private:
  static constexpr float kNone = std::numeric_limits<float>::infinity();

  DistanceField(int columns, bool outside)
      : n_(columns),
        outside_(outside),
        at_(size_t(columns) + 1),
        from_(size_t(columns) + 2),
        height_(size_t(columns) + 1),
        inverse_(size_t(columns) + 1) {
    for (int k = 1; k <= columns; ++k) inverse_[size_t(k)] = 0.5 / k;
  }

  // Distance up or down to the next square of the column, in cells from centre to side; 0 on a square.
  void by_columns(const uint8_t* blocked, int rows, float* out) const {
    const size_t n = size_t(n_);
    const auto sweep = [&](int y, int before, bool first) {
      const uint8_t* b = blocked + size_t(y) * n;
      const float* last = before < 0 ? nullptr : out + size_t(before) * n;
      float* here = out + size_t(y) * n;
      for (size_t x = 0; x < n; ++x) {
        const float next = last ? (last[x] == 0.0F ? 0.5F : last[x] + 1.0F) : (outside_ ? 0.5F : kNone);
        here[x] = b[x] ? 0.0F : first ? next : std::min(here[x], next);
      }
    };
    for (int y = 0; y < rows; ++y) sweep(y, y - 1, true);
    for (int y = rows - 1; y >= 0; --y) sweep(y, y + 1 < rows ? y + 1 : -1, false);
  }

  void by_row(float* row, double resolution) {
    // Squared height at the border before column j: the lower of the two adjacent columns.
    const auto squared = [&](int x) {
      return x < 0 || x >= n_ ? (outside_ ? 0.0 : double(kNone)) : double(row[x]) * row[x];
    };
    int top = -1;
    double before = squared(-1);
    for (int j = 0; j <= n_; ++j) {
      const double after = squared(j), h = std::min(before, after);
      before = after;
      if (h == double(kNone)) continue;
      double begin = -1.0;
      while (top >= 0) {
        // Position from which the new parabola is below the last one.
        const int i = at_[size_t(top)];
        begin = 0.5 * (i + j) + (h - height_[size_t(top)]) * inverse_[size_t(j - i)];
        if (begin > from_[size_t(top)]) break;
        --top;
        begin = -1.0;
      }
      if (begin >= n_) continue;
      ++top;
      at_[size_t(top)] = j, height_[size_t(top)] = h, from_[size_t(top)] = begin;
    }
    if (top < 0) {
      for (int x = 0; x < n_; ++x) row[x] *= float(resolution);
      return;
    }
    from_[size_t(top) + 1] = double(n_) + 1.0;
    for (int x = 0, k = 0; x < n_; ++x) {
      const double centre = x + 0.5;
      while (from_[size_t(k) + 1] < centre) ++k;
      const double d = centre - at_[size_t(k)], own = double(row[x]);
      const double least = std::min(own * own, d * d + height_[size_t(k)]);
      const float distance = float(std::sqrt(least) * resolution * (1.0 - 1e-7));
      row[x] = own == 0.0 ? 0.0F : distance;
    }
  }

  int n_;
  bool outside_;
  std::vector<int> at_;  // border of each parabola of the envelope
  std::vector<double> from_, height_, inverse_;
};

}  // namespace gp::grid

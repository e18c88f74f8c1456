// Clamped cubic B-splines on even knots: curves with continuous curvature that stay within the hull of their control
// points, and at both ends begin and end there.
//
// Reference: C. de Boor, "A Practical Guide to Splines", 1978.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

namespace gp {

// Values and derivatives at even parameters, as weights of four control points each.
class SplineBasis {
 public:
  static constexpr size_t kOrder = 4;
  struct Row {
    size_t first;  // control point
    double value[kOrder], slope[kOrder], bend[kOrder];
  };

  // Of at least four control points; so many samples between two knots.
  SplineBasis(size_t controls, size_t density) : controls_(controls), step_(1.0 / double(density)) {
    const size_t last = (controls - 3) * density;
    for (size_t k = 0; k <= last; ++k) row_.push_back(row_at(k, density));
  }
  size_t samples() const { return row_.size(); }
  double step() const { return step_; }  // of the parameter
  const Row& operator[](size_t k) const { return row_[k]; }

  // Where control points lie on the curve, nearly: their parameter as a share of the whole (Greville abscissae).
  double place(size_t control) const {
    return (knot(control + 1) + knot(control + 2) + knot(control + 3)) / 3.0 / double(controls_ - 3);
  }

 private:
  // The first and the last four knots coincide.
  double knot(size_t i) const { return std::clamp(double(i) - 3.0, 0.0, double(controls_ - 3)); }

  // N of all degrees up to 3 at u, in the interval of the knots from 3 + span on; b[d] has d + 1 of them.
  void bases(size_t span, double u, double b[kOrder][kOrder]) const {
    b[0][0] = 1.0;
    for (size_t d = 1; d < kOrder; ++d)
      for (size_t k = 0; k <= d; ++k) {
        const size_t i = span + 3 - d + k;  // of the basis function
        double sum = 0;
        if (k > 0) sum += (u - knot(i)) / (knot(i + d) - knot(i)) * b[d - 1][k - 1];
        if (k < d) sum += (knot(i + d + 1) - u) / (knot(i + d + 1) - knot(i + 1)) * b[d - 1][k];
        b[d][k] = sum;
      }
  }
  Row row_at(size_t k, size_t density) const {
    const size_t span = std::min(k / density, controls_ - 4);
    double b[kOrder][kOrder];
    bases(span, double(k) * step_, b);
    Row row{span, {}, {}, {}};
    for (size_t m = 0; m < kOrder; ++m) {
      row.value[m] = b[3][m];
      const size_t i = span + m;
      // d N_i,3 = 3 (N_i,2 / (t_i+3 - t_i) - N_i+1,2 / (t_i+4 - t_i+1)), and the same once more.
      const auto rate = [&](size_t first, size_t degree) { return double(degree) / (knot(first + degree) - knot(first)); };
      if (m > 0) row.slope[m] += rate(i, 3) * b[2][m - 1];
      if (m < 3) row.slope[m] -= rate(i + 1, 3) * b[2][m];
      const auto quadratic_slope = [&](size_t n) {  // of the n-th of the three quadratic ones, function span + 1 + n
        double sum = 0;
        if (n > 0) sum += rate(span + 1 + n, 2) * b[1][n - 1];
        if (n < 2) sum -= rate(span + 2 + n, 2) * b[1][n];
        return sum;
      };
      if (m > 0) row.bend[m] += rate(i, 3) * quadratic_slope(m - 1);
      if (m < 3) row.bend[m] -= rate(i + 1, 3) * quadratic_slope(m);
    }
    return row;
  }

  size_t controls_;
  double step_;
  std::vector<Row> row_;
};

}  // namespace gp

// Clamped cubic B-splines on even knots: curves with continuous curvature that stay within the hull of their control
// points, and start and end at the first and last one.
//
// Reference: C. de Boor, "A Practical Guide to Splines", 1978.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace gp {

// Weights of four control points for each point of the curve.
class SplineBasis {
 public:
  static constexpr size_t kOrder = 4;
  struct Row {
    size_t first;  // first control point
    double value[kOrder], slope[kOrder], bend[kOrder];
  };
  // Weights of the third derivative, which is constant between two knots.
  std::array<double, kOrder> third(size_t span) const {
    const Row begin = at(double(span)), middle = at(double(span) + 0.5);
    std::array<double, kOrder> out{};
    for (size_t m = 0; m < kOrder; ++m) out[m] = 2.0 * (middle.bend[m] - begin.bend[m]);
    return out;
  }

  // Needs at least four control points. The parameter ranges from 0 to the number of intervals between knots.
  explicit SplineBasis(size_t controls) : controls_(controls) {}
  size_t spans() const { return controls_ - 3; }

  // Approximate place of a control point along the curve, as a share of the whole (Greville abscissae).
  double place(size_t control) const {
    return (knot(control + 1) + knot(control + 2) + knot(control + 3)) / 3.0 / double(spans());
  }

  Row at(double u) const {
    const size_t span = std::min(size_t(std::max(u, 0.0)), spans() - 1);
    double b[kOrder][kOrder];
    bases(span, u, b);
    Row row{span, {}, {}, {}};
    for (size_t m = 0; m < kOrder; ++m) {
      const size_t i = span + m;
      row.value[m] = b[3][m];
      // d N_i,3 = 3 (N_i,2 / (t_i+3 - t_i) - N_i+1,2 / (t_i+4 - t_i+1)); bend applies the rule twice.
      if (m > 0) row.slope[m] += rate(i, 3) * b[2][m - 1], row.bend[m] += rate(i, 3) * quadratic_slope(span, m - 1, b);
      if (m < 3) row.slope[m] -= rate(i + 1, 3) * b[2][m], row.bend[m] -= rate(i + 1, 3) * quadratic_slope(span, m, b);
    }
    return row;
  }

 private:
  // The first four knots coincide, and the last four.
  double knot(size_t i) const { return std::clamp(double(i) - 3.0, 0.0, double(spans())); }
  double rate(size_t first, size_t degree) const { return double(degree) / (knot(first + degree) - knot(first)); }

  // Basis functions N of all degrees up to 3 at u, between the knots 3 + span and 4 + span; b[d] has d + 1 of them.
  void bases(size_t span, double u, double b[kOrder][kOrder]) const {
    b[0][0] = 1.0;
    for (size_t d = 1; d < kOrder; ++d)
      for (size_t k = 0; k <= d; ++k) {
        const size_t i = span + 3 - d + k;  // index of the basis function
        double sum = 0;
        if (k > 0) sum += (u - knot(i)) / (knot(i + d) - knot(i)) * b[d - 1][k - 1];
        if (k < d) sum += (knot(i + d + 1) - u) / (knot(i + d + 1) - knot(i + 1)) * b[d - 1][k];
        b[d][k] = sum;
      }
  }
  // Slope of the n-th of the three quadratic basis functions, with index span + 1 + n.
  double quadratic_slope(size_t span, size_t n, const double b[kOrder][kOrder]) const {
    double sum = 0;
    if (n > 0) sum += rate(span + 1 + n, 2) * b[1][n - 1];
    if (n < 2) sum -= rate(span + 2 + n, 2) * b[1][n];
    return sum;
  }

  size_t controls_;
};

}  // namespace gp

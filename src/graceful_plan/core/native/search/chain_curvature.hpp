// The curvature of a sum over the links of a chain, estimated per link. Each term depends only on the two vertices of
// its link, so one step provides information about every link; L-BFGS would learn one direction of the whole chain.
//
// References:
//   Griewank and Toint, "Partitioned variable metric updates for large structured optimization problems", Numer. Math.
//   1982. Powell, "A fast algorithm for nonlinearly constrained optimization calculations", 1978 (the damping of BFGS).
#pragma once
#include <algorithm>
#include <cmath>

#include "search/planning.hpp"

namespace gp {

class ChainCurvature {
 public:
  ChainCurvature(size_t links, size_t dim)
      : n_(links), dim_(dim), matrix_(links * 4 * dim * dim), lower_((links - 1) * dim * dim), beside_(lower_.size()) {}

  // Resets the curvature to that of stiffness |to - from|^2 / 2 for each link.
  void reset(const std::vector<double>& stiffness) {
    std::fill(matrix_.begin(), matrix_.end(), 0.0);
    mean_ = 0;
    for (size_t e = 0; e < n_; ++e) {
      const double k = stiffness[e];
      double* B = of(e);
      for (size_t j = 0; j < dim_; ++j) {
        B[j * 2 * dim_ + j] = B[(dim_ + j) * 2 * dim_ + dim_ + j] = k * (1.0 + kPinned);
        B[j * 2 * dim_ + dim_ + j] = B[(dim_ + j) * 2 * dim_ + j] = -k;
      }
      mean_ += k / double(n_);
    }
  }

  // Damped BFGS update, from the inner vertices and the gradients (both ends of link 0, of link 1, ..) at two places.
  void learn(const Point& x, const Point& gradient, const Point& other_x, const Point& other_gradient) {
    const size_t size = 2 * dim_;
    Point s(size), y(size), Bs(size);
    for (size_t e = 0; e < n_; ++e) {
      for (size_t j = 0; j < dim_; ++j) {
        s[j] = e == 0 ? 0.0 : other_x[(e - 1) * dim_ + j] - x[(e - 1) * dim_ + j];
        s[dim_ + j] = e + 1 == n_ ? 0.0 : other_x[e * dim_ + j] - x[e * dim_ + j];
      }
      for (size_t i = 0; i < size; ++i) y[i] = other_gradient[e * size + i] - gradient[e * size + i];
      update(of(e), s, y, Bs);
    }
  }

  // -(curvature + damping)^-1 slope: block-tridiagonal, by Cholesky. The damping is relative, of the form of reset().
  void solve(const Point& slope, double damping, Point& direction) {
    const size_t d = dim_, m = n_ - 1;
    const double extra = damping * mean_;
    direction.resize(m * d);
    for (size_t v = 0; v < m; ++v) {
      double *A = &lower_[v * d * d], *r = &direction[v * d];
      const double *before = of(v), *after = of(v + 1);
      for (size_t i = 0; i < d; ++i) {
        r[i] = -slope[v * d + i];
        for (size_t j = 0; j < d; ++j)
          A[i * d + j] = before[(d + i) * 2 * d + d + j] + after[i * 2 * d + j] + (i == j ? 2.0 * extra : 0.0);
      }
      if (v > 0) eliminate(&beside_[(v - 1) * d * d], r - d, A, r);
      factorise(A);
      forward(A, r);
      if (v + 1 < m) couple(A, after, extra, &beside_[v * d * d]);
    }
    for (size_t v = m; v-- > 0;) {
      double* r = &direction[v * d];
      if (v + 1 < m)
        for (size_t i = 0; i < d; ++i)
          for (size_t j = 0; j < d; ++j) r[i] -= beside_[v * d * d + i * d + j] * r[d + j];
      backward(&lower_[v * d * d], r);
    }
  }

 private:
  static constexpr double kPinned = 0.002;  // stiffness that holds a link's ends in place, relative to its stiffness
  static constexpr double kDamped = 0.3;  // smallest curvature accepted along a step, relative to the present curvature

  double* of(size_t e) { return &matrix_[e * 4 * dim_ * dim_]; }

  static void update(double* B, const Point& s, Point& y, Point& Bs) {
    const size_t size = s.size();
    double sBs = 0, sy = 0;
    for (size_t i = 0; i < size; ++i) {
      Bs[i] = 0;
      for (size_t j = 0; j < size; ++j) Bs[i] += B[i * size + j] * s[j];
      sBs += s[i] * Bs[i], sy += s[i] * y[i];
    }
    if (!(sBs > 1e-30)) return;
    if (sy < kDamped * sBs) {
      const double share = (1.0 - kDamped) * sBs / (sBs - sy);
      for (size_t i = 0; i < size; ++i) y[i] = share * y[i] + (1.0 - share) * Bs[i];
      sy = kDamped * sBs;
    }
    for (size_t i = 0; i < size; ++i)
      for (size_t j = 0; j < size; ++j) B[i * size + j] += y[i] * y[j] / sy - Bs[i] * Bs[j] / sBs;
  }

  // A -= W^T W and r -= W^T z, to eliminate a vertex.
  void eliminate(const double* W, const double* z, double* A, double* r) const {
    for (size_t i = 0; i < dim_; ++i)
      for (size_t k = 0; k < dim_; ++k) {
        r[i] -= W[k * dim_ + i] * z[k];
        for (size_t j = 0; j < dim_; ++j) A[i * dim_ + j] -= W[k * dim_ + i] * W[k * dim_ + j];
      }
  }
  // Replaces a matrix by its Cholesky factor (lower triangle).
  void factorise(double* A) const {
    for (size_t i = 0; i < dim_; ++i)
      for (size_t j = 0; j <= i; ++j) {
        double sum = A[i * dim_ + j];
        for (size_t k = 0; k < j; ++k) sum -= A[i * dim_ + k] * A[j * dim_ + k];
        A[i * dim_ + j] = i == j ? std::sqrt(std::max(sum, 1e-9 * mean_)) : sum / A[j * dim_ + j];
      }
  }
  void forward(const double* A, double* r) const {
    for (size_t i = 0; i < dim_; ++i) {
      for (size_t k = 0; k < i; ++k) r[i] -= A[i * dim_ + k] * r[k];
      r[i] /= A[i * dim_ + i];
    }
  }
  void backward(const double* A, double* r) const {
    for (size_t i = dim_; i-- > 0;) {
      for (size_t k = i + 1; k < dim_; ++k) r[i] -= A[k * dim_ + i] * r[k];
      r[i] /= A[i * dim_ + i];
    }
  }
  // W = A^-1 C, with C the coupling of a vertex and the next one.
  void couple(const double* A, const double* link, double extra, double* W) const {
    for (size_t j = 0; j < dim_; ++j)
      for (size_t i = 0; i < dim_; ++i) {
        double sum = link[i * 2 * dim_ + dim_ + j] - (i == j ? extra : 0.0);
        for (size_t k = 0; k < i; ++k) sum -= A[i * dim_ + k] * W[k * dim_ + j];
        W[i * dim_ + j] = sum / A[i * dim_ + i];
      }
  }

  size_t n_, dim_;
  double mean_ = 0;
  Point matrix_, lower_, beside_;
};

}  // namespace gp

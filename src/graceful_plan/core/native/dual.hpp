// Dual numbers: forward-mode differentiation by up to seven variables, in one vector.
#pragma once
#include <cmath>

// Vectors are never passed to calls: instruction sets differ in whether these pass them in registers or in memory.
#define GP_INLINE inline __attribute__((always_inline))

namespace gp {

// A value and its derivatives by up to seven variables.
struct alignas(64) Dual {  // GCC's default alignment of a vector depends on the instruction set
  using Lanes = double __attribute__((vector_size(64)));
  static constexpr int kVariables = 7;
  Lanes a;  // the value, then the derivatives

  GP_INLINE Dual() : a{} {}
  GP_INLINE Dual(double value) : a{value} {}  // NOLINT: numbers mix with duals
  GP_INLINE explicit Dual(Lanes lanes) : a(lanes) {}
  GP_INLINE static Dual variable(double value, int k) {
    Dual x(value);
    x.a[k + 1] = 1.0;
    return x;
  }
  GP_INLINE double value() const { return a[0]; }
  GP_INLINE double slope(int k) const { return a[k + 1]; }
  // The dual of f(x), from the value of f and its derivative at x.
  GP_INLINE Dual through(double f, double slope) const {
    Dual y(a * slope);
    y.a[0] = f;
    return y;
  }

  GP_INLINE Dual& operator+=(const Dual& b) { return a += b.a, *this; }
  friend GP_INLINE Dual operator-(const Dual& x) { return Dual(-x.a); }
  friend GP_INLINE Dual operator+(const Dual& x, const Dual& y) { return Dual(x.a + y.a); }
  friend GP_INLINE Dual operator-(const Dual& x, const Dual& y) { return Dual(x.a - y.a); }
  friend GP_INLINE Dual operator*(const Dual& x, const Dual& y) {
    Dual z(x.a * y.a[0] + y.a * x.a[0]);
    z.a[0] = x.a[0] * y.a[0];
    return z;
  }
  friend GP_INLINE Dual operator/(const Dual& x, const Dual& y) {
    const double inverse = 1.0 / y.a[0], ratio = x.a[0] * inverse;
    Dual z((x.a - y.a * ratio) * inverse);
    z.a[0] = ratio;
    return z;
  }
  friend GP_INLINE Dual operator+(const Dual& x, double y) { return x + Dual(y); }
  friend GP_INLINE Dual operator+(double x, const Dual& y) { return Dual(x) + y; }
  friend GP_INLINE Dual operator-(const Dual& x, double y) { return x - Dual(y); }
  friend GP_INLINE Dual operator-(double x, const Dual& y) { return Dual(x) - y; }
  friend GP_INLINE Dual operator*(const Dual& x, double y) { return Dual(x.a * y); }
  friend GP_INLINE Dual operator*(double x, const Dual& y) { return Dual(y.a * x); }
  friend GP_INLINE Dual operator/(const Dual& x, double y) { return Dual(x.a / y); }
  friend GP_INLINE Dual operator/(double x, const Dual& y) { return Dual(x) / y; }
};

GP_INLINE double value_of(double x) { return x; }
GP_INLINE double value_of(const Dual& x) { return x.value(); }

// Functions of both kinds of numbers. At a kink, the derivative is that of one side; the derivative of root(0) is 0.
GP_INLINE double root(double x) { return std::sqrt(x); }
GP_INLINE Dual root(const Dual& x) {
  const double y = std::sqrt(x.value());
  return x.through(y, y > 0 ? 0.5 / y : 0.0);
}
GP_INLINE double size_of(double x) { return std::fabs(x); }
GP_INLINE Dual size_of(const Dual& x) { return x.value() < 0 ? -x : x; }
GP_INLINE double sine(double x) { return std::sin(x); }
GP_INLINE Dual sine(const Dual& x) { return x.through(std::sin(x.value()), std::cos(x.value())); }
GP_INLINE double cosine(double x) { return std::cos(x); }
GP_INLINE Dual cosine(const Dual& x) { return x.through(std::cos(x.value()), -std::sin(x.value())); }
GP_INLINE double log_of_one_plus(double x) { return std::log1p(x); }
GP_INLINE Dual log_of_one_plus(const Dual& x) { return x.through(std::log1p(x.value()), 1.0 / (1.0 + x.value())); }
GP_INLINE double complementary_error(double x) { return std::erfc(x); }
GP_INLINE Dual complementary_error(const Dual& x) {
  return x.through(std::erfc(x.value()), -1.1283791670955126 * std::exp(-x.value() * x.value()));
}
template <class T> GP_INLINE T length_of(const T& x, const T& y) { return root(x * x + y * y); }
template <class T> GP_INLINE T larger(const T& x, const T& y) { return value_of(x) < value_of(y) ? y : x; }
template <class T> GP_INLINE T smaller(const T& x, const T& y) { return value_of(y) < value_of(x) ? y : x; }
template <class T> GP_INLINE T between(const T& x, double low, double high) {
  return value_of(x) < low ? T(low) : value_of(x) > high ? T(high) : x;
}

}  // namespace gp

// Numbers with derivatives: forward-mode differentiation by a few variables at once, in one vector.
#pragma once
#include <cmath>

namespace gp {

// A value and its derivatives by up to seven variables.
struct Dual {
  using Lanes = double __attribute__((vector_size(64)));
  static constexpr int kVariables = 7;
  Lanes a;  // the value first

  Dual() : a{} {}
  Dual(double value) : a{value} {}  // NOLINT: numbers mix with duals
  explicit Dual(Lanes lanes) : a(lanes) {}
  static Dual variable(double value, int k) {
    Dual x(value);
    x.a[k + 1] = 1.0;
    return x;
  }
  double value() const { return a[0]; }
  double slope(int k) const { return a[k + 1]; }
  // f(x) from its value and derivative there.
  Dual through(double f, double slope) const {
    Dual y(a * slope);
    y.a[0] = f;
    return y;
  }

  Dual& operator+=(const Dual& b) { return a += b.a, *this; }
  friend Dual operator-(const Dual& x) { return Dual(-x.a); }
  friend Dual operator+(const Dual& x, const Dual& y) { return Dual(x.a + y.a); }
  friend Dual operator-(const Dual& x, const Dual& y) { return Dual(x.a - y.a); }
  friend Dual operator*(const Dual& x, const Dual& y) {
    Dual z(x.a * y.a[0] + y.a * x.a[0]);
    z.a[0] = x.a[0] * y.a[0];
    return z;
  }
  friend Dual operator/(const Dual& x, const Dual& y) {
    const double inverse = 1.0 / y.a[0], ratio = x.a[0] * inverse;
    Dual z((x.a - y.a * ratio) * inverse);
    z.a[0] = ratio;
    return z;
  }
  friend Dual operator+(const Dual& x, double y) { return x + Dual(y); }
  friend Dual operator+(double x, const Dual& y) { return Dual(x) + y; }
  friend Dual operator-(const Dual& x, double y) { return x - Dual(y); }
  friend Dual operator-(double x, const Dual& y) { return Dual(x) - y; }
  friend Dual operator*(const Dual& x, double y) { return Dual(x.a * y); }
  friend Dual operator*(double x, const Dual& y) { return Dual(y.a * x); }
  friend Dual operator/(const Dual& x, double y) { return Dual(x.a / y); }
  friend Dual operator/(double x, const Dual& y) { return Dual(x) / y; }
};

inline double value_of(double x) { return x; }
inline double value_of(const Dual& x) { return x.value(); }

// Of both kinds of numbers. At a kink the derivative is that of one side, at a root of 0 it is 0.
inline double root(double x) { return std::sqrt(x); }
inline Dual root(const Dual& x) {
  const double y = std::sqrt(x.value());
  return x.through(y, y > 0 ? 0.5 / y : 0.0);
}
inline double size_of(double x) { return std::fabs(x); }
inline Dual size_of(const Dual& x) { return x.value() < 0 ? -x : x; }
inline double sine(double x) { return std::sin(x); }
inline Dual sine(const Dual& x) { return x.through(std::sin(x.value()), std::cos(x.value())); }
inline double cosine(double x) { return std::cos(x); }
inline Dual cosine(const Dual& x) { return x.through(std::cos(x.value()), -std::sin(x.value())); }
inline double log_of_one_plus(double x) { return std::log1p(x); }
inline Dual log_of_one_plus(const Dual& x) { return x.through(std::log1p(x.value()), 1.0 / (1.0 + x.value())); }
inline double complementary_error(double x) { return std::erfc(x); }
inline Dual complementary_error(const Dual& x) {
  return x.through(std::erfc(x.value()), -1.1283791670955126 * std::exp(-x.value() * x.value()));
}
template <class T> T length_of(const T& x, const T& y) { return root(x * x + y * y); }
template <class T> T larger(const T& x, const T& y) { return value_of(x) < value_of(y) ? y : x; }
template <class T> T smaller(const T& x, const T& y) { return value_of(y) < value_of(x) ? y : x; }
template <class T> T between(const T& x, double low, double high) {
  return value_of(x) < low ? T(low) : value_of(x) > high ? T(high) : x;
}

}  // namespace gp

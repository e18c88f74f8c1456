// Single-precision numbers in the place of lanes of double precision (D), with twice as many lanes; arithmetic with
// doubles is allowed. Descents use them; their paths are compared by exact costs afterwards.
#pragma once
#include "lanes.hpp"

namespace gp::GP_ISA {

struct Single {
  F v;

  Single() = default;
  Single(double x) : v(F{} + float(x)) {}
  explicit Single(F x) : v(x) {}
  float operator[](int i) const { return v[i]; }
  Single operator-() const { return Single(-v); }
  Single& operator+=(Single b) { return v += b.v, *this; }
  Single& operator-=(Single b) { return v -= b.v, *this; }
  Single& operator*=(Single b) { return v *= b.v, *this; }
  friend Single operator+(Single a, Single b) { return Single(a.v + b.v); }
  friend Single operator-(Single a, Single b) { return Single(a.v - b.v); }
  friend Single operator*(Single a, Single b) { return Single(a.v * b.v); }
  friend MaskF operator<(Single a, Single b) { return a.v < b.v; }
  friend MaskF operator>(Single a, Single b) { return a.v > b.v; }
  friend MaskF operator==(Single a, Single b) { return a.v == b.v; }
  friend MaskF operator!=(Single a, Single b) { return a.v != b.v; }
};

template <> struct Content<Single> {
  using type = float;
};

static inline Single where(MaskF m, Single a, Single b) { return Single(m ? a.v : b.v); }
static inline Single minimum(Single a, Single b) { return Single(minimum(a.v, b.v)); }
static inline Single maximum(Single a, Single b) { return Single(maximum(a.v, b.v)); }
static inline Single absolute(Single a) { return Single((F)((MaskF)a.v & 0x7fffffff)); }
static inline Single relu(Single a) { return Single(relu(a.v)); }

// 1/x and 1/sqrt(x) for normal x > 0, relative error 2e-7.
static inline Single reciprocal(Single x) {
#if defined(__AVX512F__)
  const F y = (F)_mm512_maskz_rcp14_ps(__mmask16(0xffff), (__m512)x.v);
  return Single(y + y * (1.f - x.v * y));
#else
  return Single(1.f / x.v);
#endif
}
static inline Single inverse_root(Single x) {
#if defined(__AVX512F__)
  const F y = (F)_mm512_maskz_rsqrt14_ps(__mmask16(0xffff), (__m512)x.v);
  return Single(y + y * (0.5f - 0.5f * x.v * y * y));
#else
  return Single(1.f / square_root(x.v));
#endif
}
static inline Single square_root(Single x) { return x * inverse_root(x); }

// e^x for |x| <= 80, relative error 2e-7; method as for doubles.
[[gnu::always_inline]] static inline Single exponential(Single x) {
  const float magic = 12582912.f + 127.f;  // 1.5 * 2^23 and the bias of exponents
  const F shifted = x.v * 1.44269504f + magic, k = shifted - magic;
  const F r = (x.v - k * 0.693359375f) + k * 2.12194440e-4f, r2 = r * r;
  const F low = (1.f + r) + r2 * (0.5f + r * 0.16666665f), high = 0.041665795f + r * 0.0083334519f + r2 * 0.0013981999f;
  return Single((low + r2 * r2 * high) * (F)((MaskF)shifted << 23));
}

// ln x for normal x > 0; method as for doubles.
static inline Single logarithm(Single x) {
  const MaskF bits = (MaskF)x.v;
  const F exponent = (F)((bits >> 23) | 0x4b000000) - (8388608.f + 127.f);
  const F m = (F)((bits & 0x007fffff) | 0x3f800000);
  const MaskF upper = m > 1.41421356f;
  const F y = upper ? 0.5f * m : m, e = upper ? exponent + 1.f : exponent;
  const F s = (y - 1.f) * reciprocal(Single(y + 1.f)).v, z = s * s;
  return Single(e * 0.69314718f + 2.f * s * horner(z, 1.f, 0.33333333f, 0.2f, 0.14285714f, 0.11111111f));
}

static inline void sine_cosine(Single x, Single& s, Single& c) { sine_cosine(x.v, s.v, c.v); }

static inline F reciprocal(F x) { return reciprocal(Single(x)).v; }
static inline F inverse_root(F x) { return inverse_root(Single(x)).v; }
[[gnu::always_inline]] static inline F exponential(F x) { return exponential(Single(x)).v; }

}  // namespace gp::GP_ISA

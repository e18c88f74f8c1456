// W configurations side by side (lanes): GCC/Clang vector types, and the functions on them that the kernels need.
#pragma once
#include <cstddef>
#include <cstdint>

#include "target.hpp"

namespace gp::GP_ISA {

// Width of vectors [bytes].
#if defined(__AVX512F__)
constexpr int kWidth = 64;
#elif defined(__AVX2__)
constexpr int kWidth = 32;
#else
constexpr int kWidth = 16;
#endif

template <class T> struct Vector;
template <> struct Vector<float> {
  typedef float type __attribute__((vector_size(kWidth)));
  typedef int32_t mask __attribute__((vector_size(kWidth)));
};
template <> struct Vector<double> {
  typedef double type __attribute__((vector_size(kWidth)));
  typedef int64_t mask __attribute__((vector_size(kWidth)));
};
template <class T> using Lanes = typename Vector<T>::type;
template <class T> using Mask = typename Vector<T>::mask;
template <class T> constexpr int kLanes = kWidth / int(sizeof(T));

// F: lanes of single precision, D: of double precision; V stands for either.
using F = Lanes<float>;
using D = Lanes<double>;
using MaskF = Mask<float>;

// The scalar type of a vector type, and its number of lanes W.
template <class V> struct Content;
template <> struct Content<F> {
  using type = float;
};
template <> struct Content<D> {
  using type = double;
};
template <class V> using Scalar = typename Content<V>::type;
template <class V> constexpr int kAbreast = kLanes<Scalar<V>>;

// A bit mask of the lanes that are set.
#if defined(__AVX512F__)
static inline int lanes_set(MaskF m) { return _mm512_movepi32_mask((__m512i)m); }
static inline int lanes_set(Mask<double> m) { return _mm512_movepi64_mask((__m512i)m); }
#elif defined(__AVX2__)
static inline int lanes_set(MaskF m) { return _mm256_movemask_ps((__m256)m); }
static inline int lanes_set(Mask<double> m) { return _mm256_movemask_pd((__m256d)m); }
#elif defined(__SSE2__)
static inline int lanes_set(MaskF m) { return _mm_movemask_ps((__m128)m); }
static inline int lanes_set(Mask<double> m) { return _mm_movemask_pd((__m128d)m); }
#else
template <class M> static inline int lanes_set(M m) {
  int set = 0;
  for (size_t i = 0; i < sizeof(m) / sizeof(m[0]); ++i) set |= int(m[i] != 0) << i;
  return set;
}
#endif
static inline bool any(MaskF m) { return lanes_set(m) != 0; }
static inline bool any(Mask<double> m) { return lanes_set(m) != 0; }
static inline bool all(MaskF m) { return !any(~m); }

static inline D where(Mask<double> m, D a, D b) { return m ? a : b; }
template <class V> static inline V relu(V a) { return a > 0 ? a : V{}; }
template <class V> static inline V absolute(V a) { return a < 0 ? -a : a; }
template <class V> static inline V minimum(V a, V b) { return a < b ? a : b; }
template <class V> static inline V maximum(V a, V b) { return a > b ? a : b; }

#if defined(__AVX512F__)  // GCC 12 emits two instructions for each of the generic versions
static inline Lanes<double> minimum(Lanes<double> a, Lanes<double> b) {
  return (Lanes<double>)_mm512_maskz_min_pd(__mmask8(0xff), (__m512d)a, (__m512d)b);
}
static inline Lanes<double> maximum(Lanes<double> a, Lanes<double> b) {
  return (Lanes<double>)_mm512_maskz_max_pd(__mmask8(0xff), (__m512d)a, (__m512d)b);
}
#endif
static inline Lanes<double> absolute(Lanes<double> a) { return (Lanes<double>)((Mask<double>)a & 0x7fffffffffffffff); }
static inline Lanes<double> relu(Lanes<double> a) { return maximum(a, Lanes<double>{}); }

// The lanes where a < b, as a bit mask. From vector masks, GCC would make a vector and a mask again.
#if defined(__AVX512F__)
static inline int lanes_below(F a, F b) { return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_LT_OQ); }
static inline int lanes_below(D a, D b) { return _mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_LT_OQ); }
#else
template <class V> static inline int lanes_below(V a, V b) { return lanes_set(a < b); }
#endif
template <class V> static inline bool any_below(V a, V b) { return lanes_below(a, b) != 0; }

template <class V> static inline Scalar<V> least_lane(V a) {
  Scalar<V> r = a[0];
  for (int i = 1; i < kAbreast<V>; ++i) r = a[i] < r ? a[i] : r;
  return r;
}
#if defined(__AVX512F__)
static inline float least_lane(F a) {
  const __m256 h = _mm256_min_ps(_mm512_maskz_extractf32x8_ps(__mmask8(0xff), (__m512)a, 0),
                                 _mm512_maskz_extractf32x8_ps(__mmask8(0xff), (__m512)a, 1));
  __m128 q = _mm_min_ps(_mm256_castps256_ps128(h), _mm256_extractf128_ps(h, 1));
  q = _mm_min_ps(q, _mm_movehl_ps(q, q));
  return _mm_cvtss_f32(_mm_min_ss(q, _mm_shuffle_ps(q, q, 1)));
}
#endif
template <class V> static inline Scalar<V> greatest_lane(V a) { return -least_lane(-a); }

static inline F square_root(F a) {
#if defined(__AVX512F__)
  return (F)_mm512_maskz_sqrt_ps(__mmask16(0xffff), (__m512)a);  // _mm512_sqrt_ps trips -Wmaybe-uninitialized in GCC 12
#elif defined(__AVX2__)
  return (F)_mm256_sqrt_ps((__m256)a);
#elif defined(__SSE2__)
  return (F)_mm_sqrt_ps((__m128)a);
#else
  F r;
  for (int i = 0; i < kLanes<float>; ++i) r[i] = __builtin_sqrtf(a[i]);
  return r;
#endif
}

// 1/x and 1/sqrt(x) for normal x > 0, relative error 1e-15. With AVX-512, two Newton steps from the hardware estimate
// take a quarter of the time of a division or square root.
static inline Lanes<double> reciprocal(Lanes<double> x) {
#if defined(__AVX512F__)
  Lanes<double> y = (Lanes<double>)_mm512_maskz_rcp14_pd(__mmask8(0xff), (__m512d)x);
  y += y * (1.0 - x * y);
  return y + y * (1.0 - x * y);
#else
  return 1.0 / x;
#endif
}
static inline Lanes<double> inverse_root(Lanes<double> x) {
#if defined(__AVX512F__)
  const Lanes<double> half = 0.5 * x;
  Lanes<double> y = (Lanes<double>)_mm512_maskz_rsqrt14_pd(__mmask8(0xff), (__m512d)x);
  y += y * (0.5 - half * y * y);
  return y + y * (0.5 - half * y * y);
#elif defined(__AVX2__)
  return 1.0 / (Lanes<double>)_mm256_sqrt_pd((__m256d)x);
#elif defined(__SSE2__)
  return 1.0 / (Lanes<double>)_mm_sqrt_pd((__m128d)x);
#else
  Lanes<double> r;
  for (int i = 0; i < kLanes<double>; ++i) r[i] = 1.0 / __builtin_sqrt(x[i]);
  return r;
#endif
}
static inline Lanes<double> square_root(Lanes<double> x) {
#if defined(__AVX512F__)
  return x * inverse_root(x);
#elif defined(__AVX2__)
  return (Lanes<double>)_mm256_sqrt_pd((__m256d)x);
#elif defined(__SSE2__)
  return (Lanes<double>)_mm_sqrt_pd((__m128d)x);
#else
  Lanes<double> r;
  for (int i = 0; i < kLanes<double>; ++i) r[i] = __builtin_sqrt(x[i]);
  return r;
#endif
}

// c0 + x (c1 + x (c2 + ..)).
template <class V, class C> [[gnu::always_inline]] static inline V horner(V x, C c0, C c1) { return c0 + x * c1; }
template <class V, class C, class... Rest>
[[gnu::always_inline]] static inline V horner(V x, C c0, C c1, Rest... rest) {
  return c0 + x * horner(x, c1, rest...);
}

// e^x for |x| <= 700, relative error 1e-15. With x = k ln 2 + r, it evaluates a Chebyshev-optimal polynomial in r and
// puts k into the exponent of the double. Adding `magic` leaves k + 1023 in the low bits of the sum.
[[gnu::always_inline]] static inline Lanes<double> exponential(Lanes<double> x) {
  using D = Lanes<double>;
  const double magic = 6755399441055744.0 + 1023.0;  // 1.5 * 2^52 and the bias of exponents
  const D shifted = x * 1.4426950408889634074 + magic;
  const D k = shifted - magic;
  const D r = (x - k * 6.93147180369123816490e-01) - k * 1.90821492927058770002e-10;
  const D r2 = r * r, r4 = r2 * r2;
  const D low = (1.0 + r * 1.0000000000000075) + r2 * (0.49999999999998795 + r * 0.16666666666543611);
  const D middle =
      (0.041666666667569435 + r * 0.00833333338943906) + r2 * (0.001388888866441864 + r * 0.00019841165489612028);
  const D high = (2.4801793454767542e-05 + r * 2.764216950992623e-06) + r2 * 2.7518754445605016e-07;
  return (low + r4 * (middle + r4 * high)) * (D)((Mask<double>)shifted << 52);
}

// ln x for normal x > 0, error 1e-15: x = m 2^e with m around 1, and the series of artanh.
static inline Lanes<double> logarithm(Lanes<double> x) {
  using D = Lanes<double>;
  const Mask<double> bits = (Mask<double>)x;
  const D exponent =
      (D)((bits >> 52) | 0x4330000000000000) - (4503599627370496.0 + 1023.0);  // integer in the low bits of 2^52
  const D m = (D)((bits & 0x000fffffffffffff) | 0x3ff0000000000000);           // [1, 2)
  const auto upper = m > 1.4142135623730951;
  const D y = upper ? 0.5 * m : m, e = upper ? exponent + 1.0 : exponent;
  const D s = (y - 1.0) * reciprocal(y + 1.0), z = s * s;
  const D series =
      horner(z, 1.0, 1.0 / 3, 1.0 / 5, 1.0 / 7, 1.0 / 9, 1.0 / 11, 1.0 / 13, 1.0 / 15, 1.0 / 17, 1.0 / 19, 1.0 / 21);
  return e * 6.93147180559945286227e-01 + 2.0 * s * series;
}

// Sine and cosine for |x| < 1000, error 1e-7 (float) and 1e-15 (double). x is reduced to [-pi/4, pi/4] in two or three
// steps (Cody and Waite); the polynomials are those of Cephes. Adding `magic` leaves the quadrant in the low bits.
template <class V, class M> static inline void turn_back(M quadrant, V sine, V cosine, V& s, V& c) {
  const M swap = (quadrant & 1) != 0;
  const V first = swap ? cosine : sine, second = swap ? sine : cosine;
  s = (quadrant & 2) != 0 ? -first : first;
  c = ((quadrant + 1) & 2) != 0 ? -second : second;
}
static inline void sine_cosine(F x, F& s, F& c) {
  const float magic = 12582912.f;  // 1.5 * 2^23
  const F shifted = x * 0.6366197723675814f + magic, k = shifted - magic;
  const F r = ((x - k * 1.5703125f) - k * 4.837512969970703e-4f) - k * 7.549789954891882e-8f, z = r * r;
  const F sine = horner(z, -1.6666654611e-1f, 8.3321608736e-3f, -1.9515295891e-4f);
  const F cosine = horner(z, 4.166664568298827e-2f, -1.388731625493765e-3f, 2.443315711809948e-5f);
  turn_back((MaskF)shifted, r + r * z * sine, 1.f - 0.5f * z + z * z * cosine, s, c);
}
static inline void sine_cosine(Lanes<double> x, Lanes<double>& s, Lanes<double>& c) {
  using D = Lanes<double>;
  const double magic = 6755399441055744.0;  // 1.5 * 2^52
  const D shifted = x * 0.63661977236758134308 + magic, k = shifted - magic;
  const D r = (x - k * 1.57079632673412561417e+00) - k * 6.07710050650619224932e-11, z = r * r;
  const D sine = horner(z, -1.66666666666666307295e-1, 8.33333333332211858878e-3, -1.98412698295895385996e-4,
                        2.75573136213857245213e-6, -2.50507477628578072866e-8, 1.58962301576546568060e-10);
  const D cosine = horner(z, 4.16666666666665929218e-2, -1.38888888888730564116e-3, 2.48015872888517045348e-5,
                          -2.75573141792967388112e-7, 2.08757008419747316778e-9, -1.13585365213876817300e-11);
  turn_back((Mask<double>)shifted, r + r * z * sine, 1.0 - 0.5 * z + z * z * cosine, s, c);
}

template <class V> struct Vec {
  V x, y, z;
};
template <class V> struct Frame {
  V R[9];  // row-major
  Vec<V> p;
};

template <class V, class T> static inline Vec<V> rotate(const Frame<V>& X, const T v[3]) {
  return {X.R[0] * v[0] + X.R[1] * v[1] + X.R[2] * v[2], X.R[3] * v[0] + X.R[4] * v[1] + X.R[5] * v[2],
          X.R[6] * v[0] + X.R[7] * v[1] + X.R[8] * v[2]};
}
template <class V, class T> static inline Vec<V> transform(const Frame<V>& X, const T v[3]) {
  Vec<V> r = rotate(X, v);
  return {X.p.x + r.x, X.p.y + r.y, X.p.z + r.z};
}
template <class V> static inline V squared_distance(const Vec<V>& a, const Vec<V>& b) {
  V dx = a.x - b.x, dy = a.y - b.y, dz = a.z - b.z;
  return dx * dx + dy * dy + dz * dz;
}
template <class V> static inline V dot(const Vec<V>& a, const Vec<V>& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
template <class V> static inline Vec<V> cross(const Vec<V>& a, const Vec<V>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

}  // namespace gp::GP_ISA

// The judge's pendulum model of a liquid surface under apparent gravity. The judge shares no code with the planners, so
// this is a separate module with another integrator (classical Runge-Kutta).
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <stdexcept>

namespace nb = nanobind;

namespace {

// Longest step of the integration [s]: for a pendulum of half a centimetre (60 rad/s) under 2 g, the error of a step is
// a millionth of the swing.
constexpr double kStep = 0.0025;
constexpr double kLongestSample = 1.0;  // largest time between samples of apparent gravity [s]

struct Vector {
  double x, y, z;
};
Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vector operator*(double s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

struct State {
  Vector bob, rate;  // direction from the pivot, and its rate [1/s]
};
State operator+(State a, State b) { return {a.bob + b.bob, a.rate + b.rate}; }
State operator*(double s, State a) { return {s * a.bob, s * a.rate}; }

struct Pendulum {
  double length, drag;  // [m], [1/s]

  // The bob is pulled against the felt acceleration [m/s^2]; the last term keeps it on the unit sphere.
  State slope(State now, Vector felt) const {
    const Vector pull = (-1.0 / length) * felt;
    const double inward = dot(pull, now.bob) + dot(now.rate, now.rate);
    return {now.rate, pull - drag * now.rate - inward * now.bob};
  }

  State step(State now, Vector begin, Vector middle, Vector end, double h) const {
    const State k1 = slope(now, begin), k2 = slope(now + 0.5 * h * k1, middle);
    const State k3 = slope(now + 0.5 * h * k2, middle), k4 = slope(now + h * k3, end);
    State next = now + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
    next.bob = 1.0 / std::sqrt(dot(next.bob, next.bob)) * next.bob;  // back onto the unit sphere
    next.rate = next.rate - dot(next.rate, next.bob) * next.bob;
    return next;
  }
};

using Felt = nb::ndarray<const double, nb::numpy, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Normals = nb::ndarray<nb::numpy, double, nb::shape<-1, 3>>;

void check(bool holds, const char* otherwise) {
  if (!holds) throw std::invalid_argument(otherwise);
}

// Felt accelerations are linear in time between samples.
void swing(const Pendulum& pendulum, const Vector* felt, size_t n, double dt, Vector* out) {
  const int steps = std::max(1, int(std::ceil(dt / kStep)));
  const double h = dt / steps;
  State now{(-1.0 / std::sqrt(dot(felt[0], felt[0]))) * felt[0], {0.0, 0.0, 0.0}};
  for (size_t k = 0;; ++k) {
    out[k] = -1.0 * now.bob;
    if (k + 1 == n) return;
    const Vector change = felt[k + 1] - felt[k];
    const auto at = [&](double step) { return felt[k] + step / steps * change; };
    for (int i = 0; i < steps; ++i) now = pendulum.step(now, at(i), at(i + 0.5), at(i + 1.0), h);
  }
}

Normals swung(const Felt& felt, double dt, double length, double drag) {
  const size_t n = felt.shape(0);
  check(n >= 1, "felt: at least one row");
  check(dt > 0.0 && dt <= kLongestSample, "dt: a time above 0 and of at most 1 s");
  check(length > 0.0 && std::isfinite(length), "length: a finite length > 0 m");
  check(drag >= 0.0 && std::isfinite(drag), "drag: a finite rate >= 0 1/s");
  check(std::all_of(felt.data(), felt.data() + 3 * n, [](double x) { return std::isfinite(x); }),
        "felt: finite accelerations");
  const Vector* rows = reinterpret_cast<const Vector*>(felt.data());
  const double first = dot(rows[0], rows[0]);
  check(first > 0.0 && std::isfinite(first), "felt: the first row is neither 0 nor beyond all measure");
  auto normals = std::make_unique<Vector[]>(n);
  {
    nb::gil_scoped_release release;
    swing(Pendulum{length, drag}, rows, n, dt, normals.get());
  }
  Vector* kept = normals.release();
  nb::capsule owner(kept, [](void* p) noexcept { delete[] static_cast<Vector*>(p); });
  return Normals(reinterpret_cast<double*>(kept), {n, 3}, owner);
}

}  // namespace

NB_MODULE(_pendulum, m) {
  using namespace nb::literals;
  m.doc() = "The judge's pendulum; use graceful_plan.judge.rule_checks.";
  m.def("swung", &swung, "felt"_a, nb::kw_only(), "dt"_a, "length"_a, "drag"_a);
}

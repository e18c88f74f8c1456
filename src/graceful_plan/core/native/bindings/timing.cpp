// Bindings of timing: splines, limits on felt acceleration, the fastest motion along a curve.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "bindings/bindings.hpp"
#include "timing/curve_timing.hpp"
#include "timing/spline.hpp"

using namespace nb::literals;

namespace gp {
namespace {

using Flags = nb::ndarray<const bool, nb::ndim<1>, nb::c_contig>;

// A motion along a curve, as returned to Python; see timing/curve_timing.hpp.
struct TimedCurve {
  Travel motion;
  std::vector<double> speeds;
  CurveTiming::Trouble trouble;
  size_t dim;
};

Array<double> rows(const std::vector<double>& values, size_t dim) {
  double* out;
  auto array = make<double>({values.size() / dim, dim}, out);
  std::copy(values.begin(), values.end(), out);
  return array;
}
Array<double> row(const std::vector<double>& values) {
  double* out;
  auto array = make<double>({values.size()}, out);
  std::copy(values.begin(), values.end(), out);
  return array;
}

// Velocity limits may be infinite.
void require_limits(const Reals& velocity, const Reals& acceleration) {
  for (size_t j = 0; j < velocity.size(); ++j) require(velocity.data()[j] > 0, "velocity limits");
  require_positive(acceleration, velocity.size(), "acceleration limits");
}

// A curve given by Python.
struct GivenCurve {
  Reals step, q, slope, bend;

  // Returns the number of intervals after checking all sizes.
  size_t check(const Reals& velocity, const Reals& acceleration) const {
    const size_t n = step.size(), dim = velocity.size();
    require(n > 0 && q.size() == (n + 1) * dim && slope.size() == 2 * n * dim && bend.size() == 2 * n * dim, "a curve");
    require_positive(step, n, "steps of a curve");
    require_numbers(q, "a curve"), require_numbers(slope, "a curve"), require_numbers(bend, "a curve");
    require_limits(velocity, acceleration);
    return n;
  }
};

TimedCurve fastest(Reals step, Reals q, Reals slope, Reals bend, Flags stop, Reals velocity, Reals acceleration,
                   const std::optional<Reals>& limit, const Core* core, std::vector<CurveTiming::Level> levels,
                   double speed, std::optional<double> start, std::optional<double> end) {
  const size_t dim = velocity.size(), n = GivenCurve{step, q, slope, bend}.check(velocity, acceleration);
  require(stop.size() == n + 1, "a curve");
  require(!limit || (limit->ndim() == 3 && limit->shape(0) == n && limit->shape(2) == 3), "limits are [n, m, 3]");
  for (size_t i = 0; limit && i < limit->size(); ++i) require(!std::isnan(limit->data()[i]), "limits are numbers");
  require(in_range(speed, 1e-9, 1), "speed, a share of at most 1");
  for (const CurveTiming::Level& level : levels) {
    require(level.size() == levels.front().size(), "levels with equal numbers of felt limits");
    require(level.empty() || (core && core->tables().n_joint == int(dim)), "felt limits need a core of the same robot");
  }
  if (!levels.empty()) require_numbers(q, "a curve", kMaxPosition);
  require(!start || in_range(*start, 0), "speed at the start");
  require(!end || in_range(*end, 0), "speed at the end");
  std::vector<uint8_t> rests(stop.data(), stop.data() + n + 1);
  if (start) rests.front() = 0;
  if (end) rests.back() = 0;
  CurveTiming timing(core, std::move(levels), point(velocity), point(acceleration));
  nb::gil_scoped_release release;
  const bool found = timing.run({n, dim, step.data(), slope.data(), bend.data(), rests.data()}, q.data(),
                                limit ? limit->data() : nullptr, limit ? limit->shape(1) : 0, speed,
                                start.value_or(std::numeric_limits<double>::infinity()),
                                end.value_or(std::numeric_limits<double>::infinity()));
  if (!found) return {{}, timing.speeds(), timing.trouble(), dim};
  return {timing.motion(), timing.speeds(), {}, dim};
}

// Travels a curve at given speeds of its parameter.
TimedCurve travelled(Reals step, Reals q, Reals slope, Reals bend, Reals speeds, Reals velocity, Reals acceleration) {
  const size_t dim = velocity.size(), n = GivenCurve{step, q, slope, bend}.check(velocity, acceleration);
  require_numbers(speeds, n + 1, "speeds along a curve");
  TimedCurve found{{}, point(speeds), {}, dim};
  std::vector<double> squared;
  for (double speed : found.speeds) squared.push_back(speed * speed);
  Travel& motion = found.motion;
  size_t halted = 0;
  if (!travel({n, dim, step.data(), slope.data(), bend.data(), nullptr}, q.data(), squared, motion, halted))
    return {{}, {}, {-1, halted, true}, dim};
  motion.excess = cubics_excess(motion.t.size(), dim, motion.t.data(), motion.q.data(), motion.qd.data(),
                                motion.qdd.data(), velocity.data(), acceleration.data())
                      .both();
  return found;
}

double excess(Reals t, Reals q, Reals qd, Reals qdd, Reals velocity, Reals acceleration) {
  const size_t n = t.size(), dim = velocity.size();
  require_numbers(t, "times");
  for (const Reals& part : {q, qd, qdd}) require_numbers(part, n * dim, "samples of a motion");
  require_limits(velocity, acceleration);
  return cubics_excess(n, dim, t.data(), q.data(), qd.data(), qdd.data(), velocity.data(), acceleration.data()).both();
}

// First and second derivatives of a point of a link along a curve: [2, n, 3].
Array<double> point_derivatives(const Core& core, int link, Reals where, Reals q, Reals slope, Reals bend) {
  const size_t n = core.rows(q), dim = size_t(core.tables().n_joint), links = size_t(core.tables().n_link);
  require_numbers(where, 3, "a point", kMaxExtent);
  require_numbers(slope, n * dim, "a slope"), require_numbers(bend, n * dim, "a bend");
  const Rider rider = core.rider(link, {where.data()[0], where.data()[1], where.data()[2]});
  std::vector<double> poses(16 * links * n);
  core.kernels().link_poses(core.tables(), {q.data(), nullptr, n}, poses.data());
  double* out;
  auto array = make<double>({2, n, 3}, out);
  for (size_t k = 0; k < n; ++k) {
    const LinkPoses at{&poses[16 * links * k]};
    Vector3 first, second;
    rider.derive(at, rider.at(at), slope.data() + k * dim, bend.data() + k * dim, first, second);
    std::copy_n(first.data(), 3, out + 3 * k), std::copy_n(second.data(), 3, out + 3 * (n + k));
  }
  return array;
}

// A spline and its first two derivatives at given parameters: [3, n, dim].
Array<double> spline(Reals controls, Reals u) {
  require(controls.ndim() == 2 && controls.shape(0) >= 4, "controls are [n >= 4, nq]");
  require_numbers(controls, "controls");
  const SplineBasis basis(controls.shape(0));
  const size_t n = u.size(), dim = controls.shape(1);
  double* out;
  auto array = make<double>({3, n, dim}, out);
  std::fill(out, out + 3 * n * dim, 0.0);
  for (size_t k = 0; k < n; ++k) {
    require(u.data()[k] >= 0 && u.data()[k] <= double(basis.spans()), "a parameter of the spline");
    const SplineBasis::Row row = basis.at(u.data()[k]);
    for (size_t m = 0; m < SplineBasis::kOrder; ++m)
      for (size_t j = 0; j < dim; ++j) {
        const double c = controls.data()[(row.first + m) * dim + j];
        out[k * dim + j] += row.value[m] * c;
        out[(n + k) * dim + j] += row.slope[m] * c;
        out[(2 * n + k) * dim + j] += row.bend[m] * c;
      }
  }
  return array;
}

}  // namespace

void bind_timing(nb::module_& m) {
  nb::class_<SpecificForceLimit>(m, "SpecificForceLimit")
      .def(
          "__init__",
          [](SpecificForceLimit* self, int link, Reals point, Reals facets, Reals room, double gravity,
             std::optional<Reals> axis, double angle, double length, double drag) {
            require(link >= 0 && facets.ndim() == 2 && facets.shape(1) == 3 && in_range(gravity, 1e-9), "a felt limit");
            require_numbers(point, 3, "point of a felt limit", kMaxExtent), require_numbers(facets, "a felt limit");
            require_numbers(room, facets.shape(0), "one limit per facet");
            for (double number : {angle, length, drag}) require(in_range(number, 0), "a slosh limit");
            const std::vector<double> rooms(room.data(), room.data() + room.size());
            new (self) SpecificForceLimit{
                link, {point.data()[0], point.data()[1], point.data()[2]}, {}, {}, rooms, gravity, {}};
            if (axis) {
              require_numbers(*axis, 3, "axis of a slosh limit");
              require(in_range(angle, 1e-9), "a slosh limit");
              const double* a = axis->data();
              self->slosh = SloshLimit{{a[0], a[1], a[2]}, angle, {length, drag}};
            }
            for (size_t k = 0; k < facets.shape(0); ++k) {
              const double* v = facets.data() + 3 * k;
              self->facets.push_back({v[0], v[1], v[2]});
              self->size.push_back(std::sqrt(dot3(self->facets.back(), self->facets.back())));
            }
          },
          nb::kw_only(), "link"_a, "point"_a, "facets"_a, "room"_a, "gravity"_a, "axis"_a = nb::none(), "angle"_a = 0.0,
          "length"_a = 0.0, "drag"_a = 0.0);
  nb::class_<TimedCurve>(m, "TimedCurve")
      .def_prop_ro(
          "t", [](const TimedCurve& self) { return row(self.motion.t); }, nb::rv_policy::move)
      .def_prop_ro(
          "q", [](const TimedCurve& self) { return rows(self.motion.q, self.dim); }, nb::rv_policy::move)
      .def_prop_ro(
          "qd", [](const TimedCurve& self) { return rows(self.motion.qd, self.dim); }, nb::rv_policy::move)
      .def_prop_ro(
          "qdd", [](const TimedCurve& self) { return rows(self.motion.qdd, self.dim); }, nb::rv_policy::move)
      .def_prop_ro(
          "speeds", [](const TimedCurve& self) { return row(self.speeds); }, nb::rv_policy::move)
      .def_prop_ro("excess", [](const TimedCurve& self) { return self.motion.excess; })
      .def_prop_ro("failed_limit", [](const TimedCurve& self) { return self.trouble.limit; })
      .def_prop_ro("failed_point",
                   [](const TimedCurve& self) { return self.trouble.any ? int(self.trouble.point) : -1; });
  m.def("spline", &spline, "controls"_a, "u"_a);
  m.def("point_derivatives", &point_derivatives, "core"_a, nb::kw_only(), "link"_a, "point"_a, "q"_a, "slope"_a,
        "bend"_a);
  m.def("excess", &excess, nb::kw_only(), "t"_a, "q"_a, "qd"_a, "qdd"_a, "velocity"_a, "acceleration"_a);
  m.def("travelled", &travelled, nb::kw_only(), "step"_a, "q"_a, "slope"_a, "bend"_a, "speeds"_a, "velocity"_a,
        "acceleration"_a);
  m.def("fastest", &fastest, nb::kw_only(), "step"_a, "q"_a, "slope"_a, "bend"_a, "stop"_a, "velocity"_a,
        "acceleration"_a, "limit"_a = nb::none(), "core"_a.none() = nb::none(),
        "levels"_a = std::vector<CurveTiming::Level>{}, "speed"_a = 1.0, "start"_a = nb::none(), "end"_a = nb::none());
}

}  // namespace gp

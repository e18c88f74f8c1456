// Bindings of base controllers.
#include <nanobind/stl/tuple.h>

#include "mobile/bindings/mobile.hpp"
#include "mobile/control/dynamic_window.hpp"

using namespace nb::literals;

namespace gp {
namespace {

constexpr int kMostSamples = 1000;
constexpr size_t kMostEntities = 100000;

BaseLimits limits_of(const Named& values) {
  BaseLimits limits;
  fill(limits, values, "limits of a base");
  fields(limits, [&](const std::string& name, double& limit) {
    require(limit <= kMaxPosition && (name == "least" ? limit <= 0 && limit >= -kMaxPosition : limit > 0),
            "limits of a base");
  });
  return limits;
}

WindowSettings settings_of(const Named& values, int n_v, int n_omega) {
  WindowSettings set;
  fill(set, values, "settings of a dynamic window");
  fields(set, [](const std::string&, double& number) { require(number >= 0, "settings of a dynamic window"); });
  require(set.horizon >= 0.05 && set.horizon <= 60 && set.period > 0 && set.period <= set.horizon && set.near > 0 &&
              set.window >= set.period,
          "settings of a dynamic window");
  require(n_v >= 2 && n_omega >= 2 && n_v <= kMostSamples && n_omega <= kMostSamples, "samples of a dynamic window");
  set.n_v = n_v, set.n_omega = n_omega;
  return set;
}

nb::tuple choose_command(const DynamicWindow& window, Reals state, Reals path, Integers entity, Reals shape,
                         Reals velocity, Reals severity, bool every) {
  require_numbers(state, 5, "state of a base", kMaxExtent);
  require(severity.size() <= kMostEntities, "number of entities");
  require_numbers(severity, "severity");
  for (size_t k = 0; k < severity.size(); ++k) require(severity.data()[k] >= 0, "severity");
  DynamicWindow::Around around{floor_shapes(entity, shape, &velocity, int(severity.size())),
                               {severity.data(), severity.data() + severity.size()}};
  const FloorPath polyline(path);
  const double* s = state.data();
  DynamicWindow::Choice c;
  {
    nb::gil_scoped_release released;
    c = window.choose({s[0], s[1], s[2], s[3], s[4]}, polyline, around, every);
  }
  return nb::make_tuple(c.v, c.omega, c.score, c.clearance, c.impact, c.admissible, c.evaluated);
}

}  // namespace

void bind_control(nb::module_& m) {
  nb::class_<DynamicWindow>(m, "DynamicWindow")
      .def(
          "__init__",
          [](DynamicWindow* self, Reals outline, Reals stops, Named constants, Reals share, Reals speeds, Reals rates,
             Reals places, Reals astray, Reals weak, Named limits, Named settings, int n_v, int n_omega) {
            new (self) DynamicWindow({outline, stops, constants, share, speeds, rates, places, astray, weak},
                                     limits_of(limits), settings_of(settings, n_v, n_omega));
          },
          nb::kw_only(), "outline"_a, "stops"_a, "constants"_a, "share"_a, "speeds"_a, "rates"_a, "places"_a,
          "astray"_a, "weak"_a, "limits"_a, "settings"_a, "n_v"_a, "n_omega"_a)
      .def("choose", &choose_command, nb::kw_only(), "state"_a, "path"_a, "entity"_a, "shape"_a, "velocity"_a,
           "severity"_a, "every"_a = false);
}

}  // namespace gp

// Bindings of failures that hit moving entities.
#include "impact/moving/moving_impact.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include "bindings/bindings.hpp"

using namespace nb::literals;

namespace gp {

void bind_moving(nb::module_& m) {
  nb::class_<MovingTable>(m, "MovingTable")
      .def(
          "__init__",
          [](MovingTable* self, Integers round, Reals half, Reals blur, Integers knot_start, Reals knot,
             Integers time_start,
             Reals time) { new (self) MovingTable({round, half, blur, knot_start, knot, time_start, time}); },
          nb::kw_only(), "round"_a, "half"_a, "blur"_a, "knot_start"_a, "knot"_a, "time_start"_a, "time"_a);
  nb::class_<MovingSource>(m, "MovingSource")
      .def("probability", &MovingSource::probability_array, "q"_a, "qd"_a, "t"_a.none(), WithoutGil());
  nb::class_<MovingDrop, MovingSource>(m, "MovingDrop")
      .def(nb::init<const MovingTable&, const DropModel&, Reals, double, double>(), "table"_a, "model"_a, nb::kw_only(),
           "places"_a, "cell"_a, "protrusion"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
  nb::class_<MovingArm, MovingSource>(m, "MovingArm")
      .def(nb::init<const MovingTable&, const Core&>(), "table"_a, "core"_a, nb::keep_alive<1, 2>(),
           nb::keep_alive<1, 3>());
  nb::class_<MovingImpact>(m, "MovingImpact")
      .def(nb::init<const Core&, const MovingTable&>(), "core"_a, "table"_a, nb::keep_alive<1, 2>(),
           nb::keep_alive<1, 3>())
      .def("add", &MovingImpact::add, "source"_a, "severity"_a, nb::keep_alive<1, 2>())
      .def("impact", &MovingImpact::impact_array, "q"_a, "qd"_a, "t"_a.none(), WithoutGil())
      .def("slopes", &MovingImpact::slopes_array, "q"_a, "qd"_a, "t"_a, WithoutGil())
      .def("gaps", &MovingImpact::gaps_array, "q"_a, "t"_a, "wanted"_a, WithoutGil());
}

}  // namespace gp

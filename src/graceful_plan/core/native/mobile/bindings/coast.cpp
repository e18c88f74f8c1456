// Bindings of the coast model: harm of a failing base.
#include "mobile/coast/moving_coast.hpp"

#include "mobile/bindings/mobile.hpp"

using namespace nb::literals;

namespace gp {

void bind_coast(nb::module_& m) {
  nb::class_<CoastModel>(m, "CoastModel")
      .def(
          "__init__",
          [](CoastModel* self, const Core& core, Integers entity, Reals shape, int n_entity, Reals outline, Reals stops,
             Named constants, Reals share, Reals speeds, Reals rates, Reals places, Reals astray, Reals weak,
             int carried, Integers high_entity, Reals high_shape, Reals height) {
            new (self) CoastModel(core, {outline, stops, constants, share, speeds, rates, places, astray, weak}, entity,
                                  shape, n_entity, {core, carried, high_entity, high_shape, height, n_entity});
          },
          "core"_a, nb::kw_only(), "entity"_a, "shape"_a, "n_entity"_a, "outline"_a, "stops"_a, "constants"_a,
          "share"_a, "speeds"_a, "rates"_a, "places"_a, "astray"_a, "weak"_a, "carried"_a, "high_entity"_a,
          "high_shape"_a, "height"_a, nb::keep_alive<1, 2>())
      .def("probability", &CoastModel::probability, "q"_a, "qd"_a, WithoutGil());
  nb::class_<MovingCoast, MovingSource>(m, "MovingCoast")
      .def(nb::init<const MovingTable&, const CoastModel&, double, double>(), "table"_a, "model"_a, nb::kw_only(),
           "bottom"_a, "top"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
  nb::class_<CoastImpact, Impact>(m, "CoastImpact")
      .def(nb::init<const CoastModel&, const CoastModel&, Reals, Reals, double, double>(), "model"_a, "rough"_a,
           "severity"_a, "speed"_a, "slow"_a, "fast"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
}

}  // namespace gp

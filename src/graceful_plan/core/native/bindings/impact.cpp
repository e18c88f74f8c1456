// Bindings of the impact models.
#include "impact/impact.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "bindings/bindings.hpp"
#include "bindings/own_cost.hpp"
#include "impact/body_impact.hpp"
#include "impact/own/posture_costs.hpp"
#include "impact/own/state_cost.hpp"

using namespace nb::literals;

namespace gp {

void bind_impact(nb::module_& m) {
  m.def("drop_constants", [] { return names_of<DropConstants>(); });
  m.def("spill_constants", [] { return names_of<SpillConstants>(); });
  nb::class_<DropModel>(m, "DropModel")
      .def(
          "__init__",
          [](DropModel* self, const Core& core, int link, Reals centre, Integers part_shape, Reals part_offset,
             Reals part_rotation, Reals part_half, int main, double size, Integers target_entity, Reals target,
             Integers level_start, int n_entity, Reals speed, Named constants) {
            new (self) DropModel(core, {link, centre, part_shape, part_offset, part_rotation, part_half, main, size,
                                        target_entity, target, level_start, n_entity, speed, constants});
          },
          nb::kw_only(), "core"_a, "link"_a, "centre"_a, "part_shape"_a, "part_offset"_a, "part_rotation"_a,
          "part_half"_a, "main"_a, "size"_a, "target_entity"_a, "target"_a, "level_start"_a, "n_entity"_a, "speed"_a,
          "constants"_a, nb::keep_alive<1, 2>())
      .def("add_contents", &DropModel::add_contents, nb::kw_only(), "mouth"_a, "axis"_a, "container"_a, "stands"_a,
           "visible"_a, "constants"_a)
      .def("add_stop", &DropModel::add_stop, nb::kw_only(), "deceleration"_a, "constants"_a, "places"_a)
      .def("add_loss", &DropModel::add_loss, nb::kw_only(), "strength"_a, "sharpness"_a, "shift"_a, "weight"_a)
      .def("add_damage", &DropModel::add_damage, nb::kw_only(), "entity"_a, "loss"_a)
      .def("add_network", &DropModel::add_network, "hidden"_a, "bound"_a, "weights"_a)
      .def("probability", &DropModel::probability, "q"_a, "qd"_a, WithoutGil())
      .def("sights", &DropModel::sights, "q"_a, "qd"_a, WithoutGil())
      .def("impact", &DropModel::impact, "severity"_a, "q"_a, "qd"_a, WithoutGil())
      .def("gradient", &DropModel::gradient, "severity"_a, "q"_a, "qd"_a, "rough"_a = false, WithoutGil());
  nb::class_<BodyModel>(m, "BodyModel")
      .def(
          "__init__",
          [](BodyModel* self, const Core& core, Reals inertia, Reals drive, Integers row, Integers entity, int n_row,
             int n_entity, int n_step, Named constants) {
            new (self) BodyModel(core, {inertia, drive, row, entity, n_row, n_entity, n_step, constants});
          },
          nb::kw_only(), "core"_a, "inertia"_a, "drive"_a, "row"_a, "entity"_a, "n_row"_a, "n_entity"_a, "n_step"_a,
          "constants"_a, nb::keep_alive<1, 2>())
      .def("distances", &BodyModel::distances, "q"_a, "qd"_a, "ahead"_a = nb::none(), WithoutGil())
      .def("impact", &BodyModel::impact, "weight"_a, "severity"_a, "q"_a, "qd"_a, WithoutGil())
      .def("gradient", &BodyModel::gradient, "weight"_a, "severity"_a, "q"_a, "qd"_a, WithoutGil())
      .def("dynamics", &BodyModel::dynamics, "q"_a, WithoutGil());
  nb::class_<Impact>(m, "Impact")
      .def("states", &Impact::states_array, "q"_a, WithoutGil())
      .def("moving_states", &Impact::moving_states_array, "q"_a, "qd"_a, WithoutGil())
      .def("state_slopes", &Impact::state_slopes_array, "q"_a, "qd"_a, "rough"_a = false, WithoutGil())
      .def("edges", &Impact::edges_array, "q0"_a, "q1"_a, "step"_a, "rough"_a = false, WithoutGil())
      .def("edge_gradients", &Impact::edge_gradients_array, "q0"_a, "q1"_a, "step"_a, WithoutGil());
  nb::class_<BoxOverlapImpact, Impact>(m, "BoxOverlapImpact")
      .def(nb::init<const Core&, Reals>(), "core"_a, "severity"_a, nb::keep_alive<1, 2>());
  nb::class_<DropImpact, Impact>(m, "DropImpact")
      .def(nb::init<const DropModel&, Reals, double, double>(), "model"_a, "severity"_a, "slow"_a, "fast"_a,
           nb::keep_alive<1, 2>());
  nb::class_<SumImpact, Impact>(m, "SumImpact")
      .def(nb::init<const Impact&, const Impact&>(), "first"_a, "second"_a, nb::keep_alive<1, 2>(),
           nb::keep_alive<1, 3>());
  nb::enum_<Measure>(m, "Measure")
      .value("time", Measure::kTime)
      .value("length", Measure::kLength)
      .value("points", Measure::kPoints);
  nb::class_<OwnCost, Impact>(m, "OwnCost")
      .def(
          "__init__",
          [](OwnCost* self, const Core& core, Measure measure, Reals speed, nb::object states, nb::object slopes,
             nb::object edges, nb::object edge_slopes, nb::object motion) {
            new (self) OwnCost(core, {states, slopes, edges, edge_slopes, motion}, measure, speed);
          },
          "core"_a, nb::kw_only(), "measure"_a, "speed"_a, "states"_a, "slopes"_a, "edges"_a,
          "edge_slopes"_a = nb::none(), "motion"_a = nb::none(), nb::keep_alive<1, 2>());
  nb::class_<ClearanceCost, Impact>(m, "ClearanceCost")
      .def(nb::init<const Core&, const Core&, double>(), "core"_a, "seen"_a, "distance"_a, nb::keep_alive<1, 2>(),
           nb::keep_alive<1, 3>());
  nb::class_<JointCost, Impact>(m, "JointCost")
      .def(nb::init<const Core&, Reals, Reals>(), "core"_a, "centre"_a, "scale"_a, nb::keep_alive<1, 2>());
  nb::class_<EnergyCost, Impact>(m, "EnergyCost")
      .def(nb::init<const Core&, Reals, Reals>(), "core"_a, "inertia"_a, "limit"_a, nb::keep_alive<1, 2>());
  nb::class_<PoseCost, Impact>(m, "PoseCost")
      .def(
          "__init__",
          [](PoseCost* self, const Core& core, int link, Reals tool, Reals position, Reals turn, double full,
             double distance,
             double angle) { new (self) PoseCost(core, {link, tool, position, turn, full}, distance, angle); },
          "core"_a, nb::kw_only(), "link"_a, "tool"_a, "position"_a, "turn"_a, "full"_a, "distance"_a, "angle"_a,
          nb::keep_alive<1, 2>());
  nb::class_<ManipulabilityCost, Impact>(m, "ManipulabilityCost")
      .def(nb::init<const Core&, int, Reals, Integers, double>(), "core"_a, nb::kw_only(), "link"_a, "tool"_a,
           "chain"_a, "least"_a, nb::keep_alive<1, 2>());
  nb::class_<ScaledImpact, Impact>(m, "ScaledImpact")
      .def(nb::init<const Impact&, double>(), "model"_a, "factor"_a, nb::keep_alive<1, 2>());
  nb::class_<TimedImpact, Impact>(m, "TimedImpact")
      .def(nb::init<const Impact&, Reals>(), "model"_a, "speed"_a, nb::keep_alive<1, 2>());
  nb::class_<BodyImpact, Impact>(m, "BodyImpact")
      .def(nb::init<const BodyModel&, Reals, Reals, double, double>(), "model"_a, "weight"_a, "severity"_a, "slow"_a,
           "fast"_a, nb::keep_alive<1, 2>());
}

}  // namespace gp

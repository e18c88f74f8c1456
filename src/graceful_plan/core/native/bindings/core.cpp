// Bindings of scene tables: kinematics, collision, capacities of the core.
#include "core.hpp"

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "bindings/bindings.hpp"

using namespace nb::literals;

namespace gp {

void bind_core(nb::module_& m) {
  m.def("instruction_sets", [] {
    std::vector<std::string> names;
    for (const Isa& isa : available()) names.emplace_back(isa.name);
    return names;
  });
  m.def("lever", [] { return kLever; });
  m.def("capacity", [] {
    nb::dict limits;
    limits["joints"] = kMaxJoints, limits["links"] = kMaxLinks, limits["spheres"] = kMaxSpheres;
    limits["parts"] = kMaxParts, limits["entities"] = kMaxEntities;
    limits["carried parts"] = kMaxDropParts, limits["surfaces"] = kMaxSurfaces, limits["steps ahead"] = kMaxSteps;
    return limits;
  });
  nb::class_<Core>(m, "Core")
      .def(
          "__init__",
          [](Core* self, Integers parent, Integers joint, Integers slide, Reals X_PL, int n_joint, Integers sphere_link,
             Reals sphere, Reals bound, Integers self_pair, Reals self_slack, Integers obstacle_kind,
             Reals obstacle_pose, Reals obstacle_size, Reals obstacle_bound, Bits ignores, Integers hull_start,
             Reals triangles, Integers part_component, Integers part_link, Reals part_box, Integers target_entity,
             Reals target_box, int n_component, int n_entity, int tool_link, Reals tool_position, Reals keep,
             Integers cone_link, Reals cone_axis, Reals cone_direction, Reals cone_angle, Integers room_link,
             Reals room_point, Reals room_rotation, Reals room_position, Reals room_lower, Reals room_upper,
             const std::string& isa) {
            new (self) Core(
                {parent, joint, slide, X_PL, n_joint, sphere_link, sphere, bound, self_pair, self_slack, tool_link,
                 tool_position},
                {obstacle_kind, obstacle_pose, obstacle_size, obstacle_bound, ignores, hull_start, triangles, keep},
                {part_component, part_link, part_box, target_entity, target_box, n_component, n_entity},
                {.cone_link = cone_link,
                 .cone_axis = cone_axis,
                 .cone_direction = cone_direction,
                 .cone_angle = cone_angle,
                 .room_link = room_link,
                 .room_point = room_point,
                 .room_rotation = room_rotation,
                 .room_position = room_position,
                 .room_lower = room_lower,
                 .room_upper = room_upper},
                isa);
          },
          nb::kw_only(), "parent"_a, "joint"_a, "slide"_a, "X_PL"_a, "n_joint"_a, "sphere_link"_a, "sphere"_a,
          "bound"_a, "self_pair"_a, "self_slack"_a, "obstacle_kind"_a, "obstacle_pose"_a, "obstacle_size"_a,
          "obstacle_bound"_a, "ignores"_a, "hull_start"_a, "triangles"_a, "part_component"_a, "part_link"_a,
          "part_box"_a, "target_entity"_a, "target_box"_a, "n_component"_a, "n_entity"_a, "tool_link"_a,
          "tool_position"_a, "keep"_a, "cone_link"_a, "cone_axis"_a, "cone_direction"_a, "cone_angle"_a, "room_link"_a,
          "room_point"_a, "room_rotation"_a, "room_position"_a, "room_lower"_a, "room_upper"_a, "isa"_a)
      .def_prop_ro("isa", &Core::isa)
      .def_prop_ro("lanes", &Core::lanes)
      .def("link_poses", &Core::link_poses, "q"_a, WithoutGil())
      .def("free_states", &Core::free_states, "q"_a, "margin"_a, WithoutGil())
      .def("free_edges", &Core::free_edges, "q0"_a, "q1"_a, "step"_a, "margin"_a, WithoutGil())
      .def("projected", &Core::projected, "q"_a, "lower"_a, "upper"_a, "clearance"_a, WithoutGil())
      .def("clearance", &Core::clearance, "q"_a, WithoutGil())
      .def("clearance_gradient", &Core::clearance_gradient, "q"_a, WithoutGil())
      .def("interaction", &Core::interaction, "q"_a, WithoutGil())
      .def("reach", &Core::reach, nb::kw_only(), "seed"_a, "X_WG"_a, "free_yaw"_a, "radius"_a, "X_LT"_a, "lower"_a,
           "upper"_a, "held"_a, "ease"_a, "iterations"_a, "patience"_a, WithoutGil())
      .def("elementary", &Core::elementary, "x"_a);
}

}  // namespace gp

// Python bindings of the core, by topic: they own the tables, select the instruction set and release the GIL.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/string.h>

#include "bindings/ndarrays.hpp"

namespace nb = nanobind;

namespace gp {

using WithoutGil = nb::call_guard<nb::gil_scoped_release>;

void bind_core(nb::module_&);
void bind_covers(nb::module_&);
void bind_impact(nb::module_&);  // after bind_core
void bind_moving(nb::module_&);  // after bind_impact
void bind_timing(nb::module_&);  // after bind_core
void bind_search(nb::module_&);  // after bind_moving and bind_timing
void bind_mobile(nb::module_&);  // after bind_moving; absent in builds without mobile/

}  // namespace gp

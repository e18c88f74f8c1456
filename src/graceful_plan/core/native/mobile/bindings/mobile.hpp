// Declares the Python bindings of mobile bases.
#pragma once
#include "bindings/bindings.hpp"

namespace gp {

void bind_lattice(nb::module_&);
void bind_grid(nb::module_&);
void bind_timed(nb::module_&);
void bind_control(nb::module_&);
void bind_coast(nb::module_&);

}  // namespace gp

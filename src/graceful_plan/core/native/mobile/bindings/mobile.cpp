// Collects the bindings of mobile bases for the module.
#include "mobile/bindings/mobile.hpp"

namespace gp {

void bind_mobile(nb::module_& m) {
  bind_lattice(m);
  bind_grid(m);
  bind_timed(m);
  bind_control(m);
  bind_coast(m);
}

}  // namespace gp

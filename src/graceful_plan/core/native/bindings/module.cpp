// The module itself.
#include "bindings/bindings.hpp"

NB_MODULE(_native, m) {
  m.doc() = "Native core of graceful_plan; use graceful_plan.core.kernels.";
  gp::bind_core(m);
  gp::bind_impact(m);
  gp::bind_moving(m);
  gp::bind_timing(m);
  gp::bind_search(m);
  gp::bind_lattice(m);
  gp::bind_grid(m);
  gp::bind_timed(m);
  gp::bind_control(m);
}

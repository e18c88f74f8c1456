// The Python module.
#include "bindings/bindings.hpp"

NB_MODULE(_native, m) {
  m.doc() = "Native core of graceful_plan; use graceful_plan.core.kernels.";
  gp::bind_core(m);
  gp::bind_covers(m);
  gp::bind_impact(m);
  gp::bind_moving(m);
  gp::bind_timing(m);
  gp::bind_search(m);
#ifdef GP_MOBILE
  gp::bind_mobile(m);
#endif
}

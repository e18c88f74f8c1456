// Placeholder: the bindings of the native core come here.
#include <nanobind/nanobind.h>

#include "gp_isa.hpp"

#define X(isa)                                                                                                         \
    namespace gp::isa {                                                                                                \
    int lanes();                                                                                                       \
    }
GP_FOR_EACH_ISA(X)
#undef X

NB_MODULE(_native, module) {
#define X(isa) module.def("lanes_" #isa, &gp::isa::lanes);
    GP_FOR_EACH_ISA(X)
#undef X
}

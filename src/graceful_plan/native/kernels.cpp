// Placeholder: the kernels come here. Everything lives in a namespace named after the instruction set.
namespace gp::GP_ISA {
int lanes() { return GP_LANES; }
} // namespace gp::GP_ISA

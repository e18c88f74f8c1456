// The instruction set that kernels are compiled for. CMake compiles kernels.cpp and coast_kernels.cpp once per set,
// with its flags and GP_ISA, the name of the set. All their code is in the namespace gp::GP_ISA: no two sets share a
// function, so the linker cannot mix them. Without GP_ISA a header stands for the baseline.
#pragma once

#ifndef GP_ISA
#define GP_ISA baseline
#endif

#if defined(__x86_64__)
#include <immintrin.h>
#endif

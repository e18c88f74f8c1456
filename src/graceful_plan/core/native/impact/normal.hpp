// The normal distribution function, by Bowling et al. 2009: [1] of the specification, the docstring of
// costs/models/drop.
#pragma once
#include "impact/flight/flight.hpp"
#include "lanes.hpp"
#include "single.hpp"

namespace gp::GP_ISA {

// P(below z) = 1/(1 + above); its derivative is P (1 - P) grade.
template <class V> struct Normal {
  V above, grade;

  [[gnu::always_inline]] explicit Normal(V z) {
    const V z2 = z * z;
    above = odds(-z * (1.5976 + 0.07056 * z2)), grade = 1.5976 + 0.21168 * z2;
  }
};

}  // namespace gp::GP_ISA

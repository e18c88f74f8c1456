// Iteration over many configurations, a block of lanes at a time.
#pragma once
#include "geometry/kinematics.hpp"

namespace gp::GP_ISA {

// Calls visit(first, count, poses) for every block of lanes: rows first to first + count of q, and their frames.
template <class V, class Visit>
static inline void for_each_block(const Tables& tables, const States& states, Visit visit) {
  V qs[kMaxJoints];
  Frame<V> X_W[kMaxLinks];
  for (size_t first = 0; first < states.n; first += kAbreast<V>) {
    load(tables, states.q, first, states.n, qs);
    forward_kinematics(tables, qs, X_W);
    const size_t left = states.n - first;
    visit(first, left < size_t(kAbreast<V>) ? int(left) : kAbreast<V>, X_W);
  }
}

}  // namespace gp::GP_ISA

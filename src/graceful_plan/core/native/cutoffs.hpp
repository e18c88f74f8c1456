// Limits below or beyond which models of failures neglect contributions, by the precision of their lanes V.
#pragma once
#include "single.hpp"

namespace gp::GP_ISA {

constexpr double kFarSpreads = 8.0;  // standard deviations beyond which nothing is hit

template <class V>
constexpr double kTail = 29.0;                         // distance beyond which hits are neglected [scales of noise];
                                                       // e^-29 = 3e-13
template <class V> constexpr double kHeld = 60.0;      // exponents are clamped to +-kHeld
template <class V> constexpr double kNothing = 1e-13;  // probabilities below this are neglected
template <class V> constexpr double kRare = 1e-11;     // the same for rare events, of which few are summed
template <class V> constexpr double kTiny = 1e-300;    // lower bound of divisors

template <> constexpr double kTail<Single> = 14.0;
template <> constexpr double kHeld<Single> = 16.0;  // products of five e^kHeld are finite
template <> constexpr double kNothing<Single> = 1e-6;
template <> constexpr double kRare<Single> = 1e-6;
template <> constexpr double kTiny<Single> = 1e-30;

}  // namespace gp::GP_ISA

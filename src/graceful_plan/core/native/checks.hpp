// Checks of Python's arguments, made before anything is built from them: a wrong width would be read past the end, and
// NaN would pass through every comparison. All failures raise ValueError.
#pragma once
#include <atomic>
#include <cmath>
#include <stdexcept>
#include <string>

#include "arrays.hpp"

namespace gp {

constexpr double kMaxPosition = 1000;  // largest joint position [rad or m]; single precision is too coarse beyond
constexpr double kMaxExtent = 1e4;   // largest position and size [m]; single precision resolves half a millimetre there
constexpr double kMaxNumber = 1e15;  // largest other number; products of several stay finite
constexpr double kMaxSamples = 1e6;  // largest number of configurations that an edge is sampled at
constexpr double kLeastStep = 1e-6;  // least distance between configurations of an edge [rad]

inline void require(bool ok, const char* what) {
  if (!ok) throw std::invalid_argument(std::string("invalid argument: ") + what);
}

// Requires n finite numbers of absolute value at most `most`.
inline void require_numbers(const double* values, size_t n, const char* what, double most = kMaxNumber) {
  bool ok = true;
  for (size_t i = 0; i < n; ++i) ok &= std::fabs(values[i]) <= most;
  require(ok, what);
}
inline void require_numbers(const Reals& values, const char* what, double most = kMaxNumber) {
  require_numbers(values.data(), values.size(), what, most);
}
inline void require_numbers(const Reals& values, size_t size, const char* what, double most = kMaxNumber) {
  require(values.size() == size, what);
  require_numbers(values, what, most);
}
inline void require_positive(const Reals& values, size_t size, const char* what) {
  require_numbers(values, size, what);
  for (size_t i = 0; i < size; ++i) require(values.data()[i] > 0, what);
}
inline void require_within(const Integers& values, int low, int end, const char* what) {
  for (size_t i = 0; i < values.size(); ++i) require(values.data()[i] >= low && values.data()[i] < end, what);
}
// Requires configurations as rows.
inline void require_rows(const Reals& q, int width, const char* what, double most = kMaxPosition) {
  require(q.ndim() == 2 && q.shape(1) == size_t(width), what);
  require_numbers(q, what, most);
}
inline bool in_range(double value, double low, double high = kMaxNumber) { return value >= low && value <= high; }
inline void require_slice(int64_t iterations, double seconds) {
  require(iterations >= 0 && seconds >= 0, "iterations and seconds are numbers of at least 0");
}

// A lock held while a search runs without the GIL; a second thread is refused, since the search's trees are not shared.
class Turn {
 public:
  explicit Turn(std::atomic_flag& taken) : taken_(taken) {
    if (taken_.test_and_set()) throw std::runtime_error("this search already runs in another thread");
  }
  ~Turn() { taken_.clear(); }
  Turn(const Turn&) = delete;

 private:
  std::atomic_flag& taken_;
};

}  // namespace gp

// Conversions between Python's arrays and those of arrays.hpp.
#pragma once
#include "arrays.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <utility>
#include <vector>

namespace gp {

// What a View is made from: other element types and layouts are copied.
template <class T> using Given = nanobind::ndarray<const T, nanobind::c_contig, nanobind::device::cpu>;

// An array that Python owns.
template <class T> using Out = nanobind::ndarray<nanobind::numpy, T, nanobind::c_contig>;

template <class T> Out<T> owned(Array<T> array) {
  T* data = array.release();
  nanobind::capsule owner(data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return Out<T>(data, array.shape().size(), array.shape().data(), owner);
}
template <class T> Out<T> owned(std::vector<T> values, const std::vector<size_t>& shape) {
  auto* kept = new std::vector<T>(std::move(values));
  nanobind::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return Out<T>(kept->data(), shape.size(), shape.data(), owner);
}

}  // namespace gp

namespace nanobind::detail {

template <class T> struct type_caster<gp::View<T>> {
  NB_TYPE_CASTER(gp::View<T>, make_caster<gp::Given<T>>::Name)

  // The argument, or a copy of it that nanobind keeps in `cleanup`, lives until the call returns; outside of calls
  // there is no such list.
  bool from_python(handle src, uint32_t flags, cleanup_list* cleanup) noexcept {
    if (!cleanup || !given_.from_python(src, flags, cleanup)) return false;
    const gp::Given<T>& array = given_.value;
    size_t shape[kMaxAxes];
    if (array.ndim() > kMaxAxes) return false;
    for (size_t i = 0; i < array.ndim(); ++i) shape[i] = array.shape(i);
    value = gp::View<T>(array.data(), shape, array.ndim());
    return true;
  }

 private:
  static constexpr size_t kMaxAxes = 64;  // NumPy's limit

  make_caster<gp::Given<T>> given_;
};

template <class T> struct type_caster<gp::Array<T>> {
  static constexpr auto Name = make_caster<gp::Out<T>>::Name;

  static handle from_cpp(gp::Array<T> array, rv_policy policy, cleanup_list* cleanup) noexcept {
    return make_caster<gp::Out<T>>::from_cpp(gp::owned(std::move(array)), policy, cleanup);
  }
};

}  // namespace nanobind::detail

// Arrays that cross the border to Python, without Python's types: bindings/ndarrays.hpp converts them.
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

namespace gp {

// A contiguous, row-major array of the caller, readable until the call returns.
template <class T> class View {
 public:
  View() = default;
  View(const T* data, const std::vector<size_t>& shape) : View(data, shape.data(), shape.size()) {}
  View(const T* data, const size_t* shape, size_t ndim) : data_(data), ndim_(ndim), size_(1) {
    for (size_t i = 0; i < ndim; ++i) {
      size_ *= shape[i];
      if (i < kMaxAxes) shape_[i] = shape[i];
    }
  }
  const T* data() const { return data_; }
  size_t size() const { return size_; }
  size_t ndim() const { return ndim_; }
  size_t shape(size_t axis) const { return axis < ndim_ && axis < kMaxAxes ? shape_[axis] : 0; }

 private:
  static constexpr size_t kMaxAxes = 4;  // axes whose length can be asked for

  const T* data_ = nullptr;
  size_t ndim_ = 0, size_ = 0, shape_[kMaxAxes] = {};
};

using Reals = View<double>;
using Integers = View<int32_t>;
using Bits = View<uint64_t>;

// A contiguous, row-major array that becomes the caller's.
template <class T> class Array {
 public:
  // The elements are not initialised.
  explicit Array(std::vector<size_t> shape) : shape_(std::move(shape)) {
    size_t size = 1;
    for (size_t n : shape_) size *= n;
    data_.reset(new T[size ? size : 1]);
  }
  T* data() const { return data_.get(); }
  const std::vector<size_t>& shape() const { return shape_; }
  T* release() { return data_.release(); }

 private:
  std::vector<size_t> shape_;
  std::unique_ptr<T[]> data_;
};

// An array of this shape, and where its elements begin.
template <class T> Array<T> make(std::vector<size_t> shape, T*& data) {
  Array<T> array(std::move(shape));
  data = array.data();
  return array;
}

}  // namespace gp

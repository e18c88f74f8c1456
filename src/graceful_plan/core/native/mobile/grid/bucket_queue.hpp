// A queue of cells by cost, for searches whose edges cost at least one bucket width. The cells of a bucket come in any
// order, because none of them can lower the cost of another (E. Dinic's observation on R. Dial, "Shortest-path forest
// with topological ordering", CACM 12, 1969). Costs far ahead are kept in one unsorted list until their bucket is in
// range.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

namespace gp::grid {

class BucketQueue {
 public:
  explicit BucketQueue(double width) : scale_(1.0 / width), width_(width) {}

  // Costs must be at least that of the current bucket; costs that rounding puts below it go into the current bucket.
  void push(double cost, uint32_t item) {
    const double place = cost * scale_;
    const double ahead = place - first_;
    if (ahead < kRing) {
      ring_[ahead > double(now_) ? size_t(ahead) : size_t(now_)].push_back(item);
    } else {
      later_.push_back({place, item});
    }
    ++size_;
  }
  bool empty() const { return size_ == 0; }
  // Lower bound on the costs in the queue.
  double floor() const { return (first_ + now_) * width_; }
  // Moves on to the first non-empty bucket; the queue must not be empty.
  void advance() {
    for (;;) {
      for (; now_ < kRing; ++now_) {
        if (!ring_[size_t(now_)].empty()) return;
      }
      begin_anew();
    }
  }
  // Removes an item of the current bucket, which `advance` found.
  uint32_t pop() {
    auto& bucket = ring_[size_t(now_)];
    const uint32_t item = bucket.back();
    bucket.pop_back();
    --size_;
    return item;
  }
  bool more() const { return !ring_[size_t(now_)].empty(); }

 private:
  static constexpr int kRing = 2048;  // buckets; later ones wait in a list
  struct Later {
    double place;
    uint32_t item;
  };

  void begin_anew() {
    double least = std::numeric_limits<double>::infinity();
    for (const Later& one : later_) least = one.place < least ? one.place : least;
    first_ = least < 9e15 ? double(int64_t(least)) : least, now_ = 0;
    size_t kept = 0;
    for (const Later& one : later_) {
      if (one.place - first_ < kRing) {
        ring_[size_t(one.place - first_)].push_back(one.item);
      } else {
        later_[kept++] = one;
      }
    }
    later_.resize(kept);
  }

  double scale_, width_, first_ = 0.0;
  int now_ = 0;
  size_t size_ = 0;
  std::array<std::vector<uint32_t>, kRing> ring_;
  std::vector<Later> later_;
};

// A queue in the exact order of costs, for searches whose edges may cost next to nothing.
class HeapQueue {
 public:
  void push(double cost, uint32_t item) {
    heap_.push_back({cost, item});
    std::push_heap(heap_.begin(), heap_.end(), later);
  }
  bool empty() const { return heap_.empty(); }
  double floor() const { return heap_.front().cost; }
  void advance() { taken_ = false; }
  bool more() const { return !taken_; }
  uint32_t pop() {
    const uint32_t item = heap_.front().item;
    std::pop_heap(heap_.begin(), heap_.end(), later);
    heap_.pop_back();
    taken_ = true;
    return item;
  }

 private:
  struct Entry {
    double cost;
    uint32_t item;
  };
  static bool later(const Entry& a, const Entry& b) { return a.cost > b.cost || (a.cost == b.cost && a.item > b.item); }

  std::vector<Entry> heap_;
  bool taken_ = true;
};

}  // namespace gp::grid

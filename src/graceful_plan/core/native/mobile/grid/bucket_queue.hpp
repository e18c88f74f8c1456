// A queue of cells by cost, for searches whose edges cost at least one width: cells of one bucket come in any order,
// for none of them can make another cheaper (E. Dinic's observation on R. Dial, "Shortest-path forest with topological
// ordering", CACM 12, 1969). Costs far ahead wait in one heap of leftovers until their turn comes.
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

  // Costs are at least that of the bucket that was taken last; what rounds below goes into that one.
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
  // Least cost that what is left can have.
  double floor() const { return (first_ + now_) * width_; }
  // Go on to the first bucket that holds something; there has to be one.
  void advance() {
    for (;;) {
      for (; now_ < kRing; ++now_) {
        if (!ring_[size_t(now_)].empty()) return;
      }
      begin_anew();
    }
  }
  // The last one of the present bucket, which `advance` found.
  uint32_t pop() {
    auto& bucket = ring_[size_t(now_)];
    const uint32_t item = bucket.back();
    bucket.pop_back();
    --size_;
    return item;
  }
  bool more() const { return !ring_[size_t(now_)].empty(); }

 private:
  static constexpr int kRing = 2048;
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

// The same by exact costs, one after the other, for searches whose edges may add next to nothing to a bound.
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

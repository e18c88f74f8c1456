// Covers of bodies by balls around some of their sample points; core/greedy_cover.py says which balls and why.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

namespace gp {

// Points as separate coordinates, so that loops over them become vector code.
struct Points {
  std::vector<double> x, y, z;

  Points(const double* xyz, size_t n) : x(n), y(n), z(n) {
    for (size_t i = 0; i < n; ++i) x[i] = xyz[3 * i], y[i] = xyz[3 * i + 1], z[i] = xyz[3 * i + 2];
  }
  size_t size() const { return x.size(); }
  double squared(size_t a, size_t b) const {
    const double dx = x[a] - x[b], dy = y[a] - y[b], dz = z[a] - z[b];
    return dx * dx + dy * dy + dz * dz;
  }
};

// Greedy cover: each step takes a point that is not covered yet, and of the balls that cover it the one that covers
// most of the others.
class BallCover {
 public:
  // `reach` holds the squared radius within which the ball around each point surely covers, `depth` the depth of each
  // point; `candidates` balls are compared at each step.
  BallCover(const double* xyz, size_t n, const double* reach, const double* depth, size_t candidates)
      : points_(xyz, n), reach_(reach, reach + n), depth_(depth, depth + n), candidates_(candidates) {}

  // Covers all points, those in order[0 .. first) before the others. Returns the points whose balls are needed.
  std::vector<size_t> cover(const std::vector<size_t>& order, size_t first) {
    picked_.clear();
    cover_part({order.begin(), order.begin() + first});
    std::vector<size_t> rest(order.begin() + first, order.end());
    for (size_t ball : picked_) erase(rest, ball);
    cover_part(std::move(rest));
    return needed();
  }

 private:
  void erase(std::vector<size_t>& left, size_t ball) const {
    std::erase_if(left, [&](size_t i) { return points_.squared(i, ball) <= reach_[ball]; });
  }

  void cover_part(std::vector<size_t> left) {
    std::vector<size_t> around;
    while (!left.empty()) {
      const size_t point = left.front();
      const std::vector<size_t> able = candidates(point);
      // The candidates contain the point, so they cover nothing farther from it than a diameter.
      double widest = 0;
      for (size_t ball : able) widest = std::max(widest, reach_[ball]);
      around.clear();
      for (size_t i : left)
        if (points_.squared(i, point) <= 4 * widest) around.push_back(i);
      size_t best = able.front(), most = 0;
      for (size_t ball : able) {
        size_t count = 0;
        for (size_t i : around) count += points_.squared(i, ball) <= reach_[ball];
        if (count > most) most = count, best = ball;
      }
      picked_.push_back(best);
      erase(left, best);
      if (!left.empty() && left.front() == point) left.erase(left.begin());  // a ball without a reach covers its centre
    }
  }

  // Balls that cover a point: the deepest ones, and some spread evenly over all.
  std::vector<size_t> candidates(size_t point) const {
    std::vector<size_t> able;
    for (size_t k = 0; k < points_.size(); ++k)
      if (points_.squared(k, point) <= reach_[k]) able.push_back(k);
    if (able.empty()) return {point};
    const size_t n = std::min(able.size(), candidates_);
    std::vector<size_t> deepest = able, chosen;
    std::partial_sort(deepest.begin(), deepest.begin() + n, deepest.end(),
                      [&](size_t a, size_t b) { return depth_[a] != depth_[b] ? depth_[a] > depth_[b] : a < b; });
    chosen.assign(deepest.begin(), deepest.begin() + n);
    const double step = n > 1 ? double(able.size() - 1) / double(n - 1) : 0;
    for (size_t k = 0; k < n; ++k) chosen.push_back(able[std::min(able.size() - 1, size_t(double(k) * step))]);
    std::sort(chosen.begin(), chosen.end());
    chosen.erase(std::unique(chosen.begin(), chosen.end()), chosen.end());
    return chosen;
  }

  // Drops balls whose points others cover as well, those that cover least first.
  std::vector<size_t> needed() const {
    std::vector<std::vector<uint32_t>> covered(picked_.size());
    std::vector<uint32_t> times(points_.size(), 0);
    for (size_t b = 0; b < picked_.size(); ++b)
      for (size_t i = 0; i < points_.size(); ++i)
        if (points_.squared(i, picked_[b]) <= reach_[picked_[b]]) covered[b].push_back(uint32_t(i)), ++times[i];
    std::vector<size_t> order(picked_.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [&](size_t a, size_t b) { return covered[a].size() < covered[b].size(); });
    std::vector<char> stays(picked_.size(), 1);
    for (size_t b : order) {
      // A ball without a reach covers no sample by this measure, and its own centre needs it.
      const bool idle = !covered[b].empty() &&
                        std::all_of(covered[b].begin(), covered[b].end(), [&](uint32_t i) { return times[i] > 1; });
      if (!idle) continue;
      stays[b] = 0;
      for (uint32_t i : covered[b]) --times[i];
    }
    std::vector<size_t> kept;
    for (size_t b = 0; b < picked_.size(); ++b)
      if (stays[b]) kept.push_back(picked_[b]);
    return kept;
  }

  Points points_;
  std::vector<double> reach_, depth_;
  size_t candidates_;
  std::vector<size_t> picked_;
};

// The largest height of each point over the planes n . x = d, rows (n, d), and the first plane it is over.
inline void heights_over(const double* xyz, size_t n, const double* planes, size_t faces, double* height,
                         int32_t* face) {
  constexpr size_t kBlock = 128;
  const Points points(xyz, n);
  for (size_t begin = 0; begin < n; begin += kBlock) {
    const size_t count = std::min(kBlock, n - begin);
    double top[kBlock], of[kBlock];
    std::fill(top, top + count, -std::numeric_limits<double>::infinity());
    std::fill(of, of + count, 0.0);
    for (size_t f = 0; f < faces; ++f) {
      const double a = planes[4 * f], b = planes[4 * f + 1], c = planes[4 * f + 2], d = planes[4 * f + 3];
      const double* x = &points.x[begin];
      const double* y = &points.y[begin];
      const double* z = &points.z[begin];
      const double number = double(f);
      for (size_t i = 0; i < count; ++i) {
        const double over = a * x[i] + b * y[i] + c * z[i] - d;
        of[i] = over > top[i] ? number : of[i];
        top[i] = over > top[i] ? over : top[i];
      }
    }
    for (size_t i = 0; i < count; ++i) height[begin + i] = top[i], face[begin + i] = int32_t(of[i]);
  }
}

}  // namespace gp

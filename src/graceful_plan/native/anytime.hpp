// The default planner: RRT-Connect for the first path, then refinement of the best path by J, and contests between others that
// might become better. These come from cost-bounded RRT-Connect (AO-x: whatever it finds beats the incumbent), from
// RRT-Connect through the valleys of the impact, from plain RRT-Connect and from detours through via points.
#pragma once
#include <algorithm>
#include <memory>

#include "connect.hpp"
#include "refine.hpp"

namespace gp {

struct AnytimeSettings {
  ConnectSettings connect;
  double spacing = 0.2;
  int challengers = 8;
};

constexpr int64_t kFirstRound = 150, kLastRound = 5000;  // moves of each challenger

class Anytime {
 public:
  Anytime(Space& space, Point start, std::vector<Point> goals, AnytimeSettings settings, uint64_t seed)
      : space_(space), start_(start), goals_(goals), settings_(settings), random_(seed),
        connect_(space, std::move(start), std::move(goals), settings.connect, random_.bits()) {}

  // Work until the slice ends; true if the best path changed. Stops early at a proven optimum.
  bool run(Slice& slice) {
    const bool first = best_.q.empty();  // nobody should wait for the end of a slice to hear of the first path
    bool improved = false;
    while (!optimal() && !(first && improved) && slice.next()) improved |= step();
    return improved;
  }
  const Polyline& best() const { return best_; }

  // A straight path of cost w = 0 cannot be beaten.
  bool optimal() const {
    if (best_.q.empty() || !space_.motion_is_length()) return false;
    double bound = std::numeric_limits<double>::infinity();
    for (const Point& goal : goals_) bound = std::min(bound, space_.distance(start_.data(), goal.data()));
    return best_.total <= bound * (1 + 1e-9);
  }

 private:
  bool step() {
    ++steps_;
    if (best_.q.empty()) return connect_.step() && offer(Polyline::of(space_, connect_.path()));
    const bool settled = incumbent_->settled() < 0.02;
    if (steps_ % (settled ? 16 : 2) == 0) return incumbent_->step() && take(incumbent_->path());
    return contest();
  }

  // Rounds of successive halving: gather challengers, refine all of them a little, drop the worse half, refine the rest twice
  // as long, and so on until one is left, which is refined until it wins or settles.
  bool contest() {
    if (moves_per_round_ == 0) {
      if (int(challengers_.size()) < settings_.challengers) return explore();
      moves_per_round_ = kFirstRound, move_ = 0;
    }
    if (challengers_.empty()) return end_contest();
    std::unique_ptr<Refiner>& refiner = challengers_[size_t(move_++) % challengers_.size()];
    refiner->step();
    if (refiner->path().total < best_.total) {
      std::swap(incumbent_, refiner);
      return take(incumbent_->path());
    }
    if (move_ < moves_per_round_ * int64_t(challengers_.size())) return false;
    move_ = 0, moves_per_round_ *= 2;
    if (challengers_.size() == 1)
      return challengers_[0]->settled() < 0.02 || challengers_[0]->path().total > 1.1 * best_.total || moves_per_round_ > kLastRound
                 ? end_contest()
                 : false;
    std::stable_sort(challengers_.begin(), challengers_.end(), [](const auto& a, const auto& b) { return a->path().total < b->path().total; });
    challengers_.resize((challengers_.size() + 1) / 2);
    return false;
  }
  bool end_contest() {
    challengers_.clear();
    moves_per_round_ = 0;
    return false;
  }

  // Look for another path. A tree search goes on across steps until it succeeds or ages.
  bool explore() {
    if (searching_ && ++search_age_ < 300) {
      if (!connect_.step()) return false;
      searching_ = false;
      return offer(Polyline::of(space_, connect_.path()));
    }
    searching_ = false;
    const double u = random_.uniform(), infinite = std::numeric_limits<double>::infinity();
    if (u < 0.3) return detour();
    if (u < 0.6) return tool_detour();
    double impact_limit = infinite;
    if (u < 0.85 && space_.w > 0) impact_limit = mean_impact() * random_.uniform(0.05, 1.5);
    connect_.reset(u >= 0.93 ? best_.total : infinite, impact_limit);
    connect_.skip_direct();
    searching_ = true;
    search_age_ = 0;
    return false;
  }

  double mean_impact() const {
    double length = 0;
    for (size_t i = 0; i + 1 < best_.q.size(); ++i) length += space_.distance(best_.q[i].data(), best_.q[i + 1].data());
    return std::max(0.0, best_.total - length) / (space_.w * std::max(length, 1e-9));
  }

  // The straight path, or a stretch of the incumbent, sent through the most promising of some random via points.
  bool detour() {
    const std::vector<Point>& q = best_.q;
    size_t i = 0, j = q.size() - 1;
    if (random_.uniform() < 0.5 && q.size() > 3) {
      i = size_t(random_.below(int(q.size()))), j = size_t(random_.below(int(q.size())));
      if (i > j) std::swap(i, j);
      if (j - i < 2) return false;
    }
    const Point via = via_point(q[i], q[j]);
    if (!space_.edge_free(q[i].data(), via.data()) || !space_.edge_free(via.data(), q[j].data())) return false;
    if (!space_.edge_certain(q[i].data(), via.data()) || !space_.edge_certain(via.data(), q[j].data())) return false;
    std::vector<Point> points(q.begin(), q.begin() + long(i) + 1);
    points.push_back(via);
    points.insert(points.end(), q.begin() + long(j), q.end());
    return offer(Polyline::of(space_, std::move(points)));
  }

  // A stretch of the incumbent with the tool carried higher, lower or further aside, by steps along its Jacobian.
  bool tool_detour() {
    const int n = int(best_.q.size());
    if (n < 3) return detour();
    int i = random_.below(n), j = random_.below(n);
    if (random_.uniform() < 0.5) i = 0, j = n - 1;
    if (i > j) std::swap(i, j);
    if (j - i < 2) return false;
    const double size = 0.3 * random_.uniform();
    const double aside[3] = {random_.normal() * size, random_.normal() * size, random_.normal() * size};
    std::vector<Point> points = best_.q;
    for (int k = i + 1; k < j; ++k) {
      const double s = 2.0 * (k - i) / (j - i) - 1.0, bump = std::min(1.0, 1.6 * (1.0 - s * s));
      Point& q = points[size_t(k)];
      Point d(q.size());
      constexpr int kSteps = 6;
      const double step[3] = {aside[0] * bump / kSteps, aside[1] * bump / kSteps, aside[2] * bump / kSteps};
      for (int count = 0; count < kSteps; ++count) {
        if (!space_.move_tool(q.data(), step, d.data())) return false;
        for (size_t c = 0; c < q.size(); ++c) q[c] = std::clamp(q[c] + d[c], space_.lower[c], space_.upper[c]);
      }
    }
    for (int k = i; k < j; ++k)
      if (!space_.edge_free(points[size_t(k)].data(), points[size_t(k) + 1].data())) return false;
    for (int k = i; k < j; ++k)
      if (!space_.edge_certain(points[size_t(k)].data(), points[size_t(k) + 1].data())) return false;
    return offer(Polyline::of(space_, std::move(points)));
  }

  Point via_point(const Point& a, const Point& b) {
    constexpr int kTried = 16;
    const size_t dim = a.size();
    std::vector<double> points(kTried * dim);
    const int tried = space_.w > 0 ? kTried : 1;
    for (int k = 0; k < tried; ++k) {
      const double s = random_.uniform(), radius = 0.3 * space_.extent() * std::pow(random_.uniform(), 2.0);
      for (size_t d = 0; d < dim; ++d) {
        const double value = a[d] + s * (b[d] - a[d]) + radius * random_.normal() / std::sqrt(double(dim));
        points[size_t(k) * dim + d] = std::clamp(value, space_.lower[d], space_.upper[d]);
      }
    }
    double impact[kTried] = {}, least = std::numeric_limits<double>::infinity();
    if (tried > 1) space_.impacts(points.data(), tried, impact);
    const double* best = points.data();
    for (int k = 0; k < tried; ++k) {
      const double* via = points.data() + size_t(k) * dim;
      const double guess = (space_.distance(a.data(), via) + space_.distance(via, b.data())) * (1 + space_.w * impact[k]);
      if (guess < least) least = guess, best = via;
    }
    return Point(best, best + dim);
  }

  bool offer(Polyline path) {
    const double total = path.total;
    auto refiner = std::make_unique<Refiner>(space_, std::move(path), settings_.spacing, random_.bits());
    if (total < best_.total) {
      std::swap(incumbent_, refiner);
      if (refiner) challengers_.push_back(std::move(refiner));
      return take(incumbent_->path());
    }
    challengers_.push_back(std::move(refiner));
    return false;
  }

  bool take(const Polyline& path) {
    if (path.total >= best_.total) return false;
    best_ = path;
    return true;
  }

  Space& space_;
  Point start_;
  std::vector<Point> goals_;
  AnytimeSettings settings_;
  Random random_;
  Connect connect_;
  Polyline best_;
  std::unique_ptr<Refiner> incumbent_;
  std::vector<std::unique_ptr<Refiner>> challengers_;
  int64_t steps_ = 0, move_ = 0, moves_per_round_ = 0;
  bool searching_ = false;
  int search_age_ = 0;
};

}  // namespace gp

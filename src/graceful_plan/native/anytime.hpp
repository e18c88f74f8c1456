// The default planner: RRT-Connect for the first path, then rounds of searching another path and refining it by J. Searches alternate
// between cost-bounded RRT-Connect (AO-x: whatever it finds beats the incumbent), unbounded RRT-Connect and detours
// through random via points, which reach other homotopy classes; a candidate that refines badly is dropped early.
#pragma once
#include <deque>
#include <memory>

#include "connect.hpp"
#include "refine.hpp"

namespace gp {

struct AnytimeSettings {
  ConnectSettings connect;
  double spacing = 0.2;
  int pool = 4;
};

class Anytime {
 public:
  Anytime(Space& space, Point start, std::vector<Point> goals, AnytimeSettings settings, uint64_t seed)
      : space_(space), start_(start), goals_(goals), settings_(settings), random_(seed),
        connect_(space, std::move(start), std::move(goals), settings.connect, random_.bits()) {}

  // Work until the slice ends; true if the best path changed. Stops early at a proven optimum.
  bool run(Slice& slice) {
    bool improved = false;
    while (!optimal() && slice.next()) improved |= step();
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
    switch (steps_ % 4) {
      case 0: return explore();
      case 1: return challenge();
      default: return polish();
    }
  }

  // Refine the incumbent; when it has settled, the effort goes to the challengers.
  bool polish() {
    if (!incumbent_ || (incumbent_->settled() < 0.02 && steps_ % 8 > 2)) return challenge();
    return incumbent_->step() && take(incumbent_->path());
  }

  // Refine a challenger; drop it when after a fair number of moves it is far from the incumbent.
  bool challenge() {
    if (pool_.empty()) return incumbent_ && incumbent_->step() && take(incumbent_->path());
    turn_ = (turn_ + 1) % pool_.size();
    Refiner& refiner = *pool_[turn_];
    refiner.step();
    const double ratio = refiner.path().total / best_.total;
    if (ratio < 1) {
      std::swap(incumbent_, pool_[turn_]);
      return take(incumbent_->path());
    }
    const double moves = double(refiner.moves());
    if (ratio > 1.02 + 6 * std::exp(-moves / 150) || refiner.settled() < 0.02 || moves > 4000) pool_.erase(pool_.begin() + long(turn_));
    return false;
  }

  // Search for another path. An AO-x search is bounded by the incumbent and kept across steps until it succeeds or ages.
  bool explore() {
    if (int(pool_.size()) >= settings_.pool) return challenge();
    if (searching_ && ++search_age_ < 400) {
      if (!connect_.step()) return false;
      searching_ = false;
      return offer(Polyline::of(space_, connect_.path()));
    }
    searching_ = false;
    if (random_.uniform() < 0.6) return detour();
    connect_.reset(random_.uniform() < 0.5 ? best_.total : std::numeric_limits<double>::infinity());
    connect_.skip_direct();
    searching_ = true;
    search_age_ = 0;
    return false;
  }

  // Start - via - goal with straight edges, or the incumbent with one stretch sent through a via point.
  bool detour() {
    const std::vector<Point>& q = best_.q;
    size_t i = 0, j = q.size() - 1;
    if (random_.uniform() < 0.5 && q.size() > 3) {
      i = size_t(random_.below(int(q.size()))), j = size_t(random_.below(int(q.size())));
      if (i > j) std::swap(i, j);
      if (j - i < 2) return false;
    }
    const double base = space_.distance(q[i].data(), q[j].data()), radius = 0.25 * space_.extent() * std::pow(random_.uniform(), 2.0);
    Point via(q[i].size());
    const double s = random_.uniform();
    for (size_t d = 0; d < via.size(); ++d)
      via[d] = std::clamp(q[i][d] + s * (q[j][d] - q[i][d]) + radius * random_.normal() / std::sqrt(double(space_.dim)), space_.lower[d], space_.upper[d]);
    if (base < 1e-9 || !space_.edge_free(q[i].data(), via.data()) || !space_.edge_free(via.data(), q[j].data())) return false;
    if (!space_.edge_certain(q[i].data(), via.data()) || !space_.edge_certain(via.data(), q[j].data())) return false;
    std::vector<Point> points(q.begin(), q.begin() + long(i) + 1);
    points.push_back(via);
    points.insert(points.end(), q.begin() + long(j), q.end());
    return offer(Polyline::of(space_, std::move(points)));
  }

  bool offer(Polyline path) {
    if (path.total > 4 * best_.total) return false;
    pool_.push_back(std::make_unique<Refiner>(space_, path, settings_.spacing, random_.bits()));
    if (path.total >= best_.total) return false;
    if (incumbent_) std::swap(incumbent_, pool_.back());
    else incumbent_ = std::move(pool_.back()), pool_.pop_back();
    return take(path);
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
  std::vector<std::unique_ptr<Refiner>> pool_;
  size_t turn_ = 0;
  int64_t steps_ = 0;
  bool searching_ = false;
  int search_age_ = 0;
};

}  // namespace gp

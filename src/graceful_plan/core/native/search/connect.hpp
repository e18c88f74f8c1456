// RRT-Connect (Kuffner and LaValle 2000). With a finite cost bound it is the inner search of an AO-x planner (Hauser
// and Zhou 2016; AORRTC, Wilson et al. 2025): nodes that cannot be part of a path below the bound are not added.
#pragma once
#include <algorithm>

#include "search/planning.hpp"

namespace gp {

struct ConnectSettings {
  double range = 1.0;
  int max_nodes = 10000;
};

// With bounds, edges are short and their ends are projected (constrained bidirectional RRT, Berenson et al. 2009).
constexpr double kBoundedRange = 0.3;  // [rad]
constexpr double kLeastGain = 0.1;     // least progress of a step towards the target, relative to its range
constexpr int kPatience = 40;          // failed attempts of the smaller tree before the other one grows

// Searches for a first path draw this share of samples near tree nodes, from a normal distribution with a standard
// deviation of this share of each joint's range. If start or goal is in a cage, nearly all uniform samples are outside,
// and the tree runs into the same bars repeatedly. On 320 problems of benchmarks/motion_problems.py ("cage",
// "bookshelf_thin"), shares of 0.3 to 0.6 and widths of 0.15 to 0.3 performed about equally.
constexpr double kNearbyShare = 0.4;  // share of samples of a first path drawn near a node
constexpr double kNearby = 0.2;       // standard deviation of these, relative to the ranges of joints

class Connect {
 public:
  Connect(Space& space, Point start, std::vector<Point> goals, ConnectSettings settings, uint64_t seed)
      : space_(space),
        start_(std::move(start)),
        goals_(std::move(goals)),
        settings_(settings),
        random_(seed),
        a_(space.dim),
        b_(space.dim),
        bounded_(space.has_bounds()),
        range_(bounded_ ? std::min(settings.range, kBoundedRange) : settings.range) {
    reset(std::numeric_limits<double>::infinity());
  }

  // Clears the trees and looks for paths that cost less than `bound`. No edge may have a mean impact above
  // `impact_limit` or above that of the start and goal themselves.
  void reset(double bound, double impact_limit = std::numeric_limits<double>::infinity()) {
    bound_ = bound, impact_limit_ = impact_limit;
    a_ = Tree(space_.dim), b_ = Tree(space_.dim);
    a_.add(start_.data(), -1, 0);
    for (const Point& goal : goals_) b_.add(goal.data(), -1, 0);
    from_start_ = true;
    tried_direct_ = false;
    if (std::isinf(impact_limit)) return;
    space_.impacts(start_.data(), 1, &unavoidable_[0]);
    unavoidable_[1] = 0;
    for (const Point& goal : goals_) {
      double impact;
      space_.impacts(goal.data(), 1, &impact);
      unavoidable_[1] = std::max(unavoidable_[1], impact);
    }
  }

  // One iteration; returns true if it found a path, see path().
  bool step() {
    if (!tried_direct_) {
      tried_direct_ = true;
      return connect_directly();
    }
    if (a_.size() + b_.size() > settings_.max_nodes) reset(bound_, impact_limit_);
    tried_direct_ = true;
    // The smaller tree grows. Otherwise, the tree of an end in a narrow place would stay small while the other fills
    // the open space. After kPatience failures the larger one grows, since a tree may be unable to grow at all.
    const bool patient = stuck_ < kPatience;
    if (!patient) stuck_ = 0;
    if (a_.size() != b_.size()) from_start_ = (a_.size() < b_.size()) == patient;
    ++stuck_;
    Tree &grown = from_start_ ? a_ : b_, &other = from_start_ ? b_ : a_;
    from_start_ = !from_start_;
    Point target(size_t(space_.dim));
    if (!sample(grown, target) || (bounded_ && !space_.project(target.data()))) return false;
    double limit = std::isinf(bound_) ? bound_ : random_.uniform(0, 1) * bound_;
    const int near = grown.nearest(target.data(), limit);
    if (near < 0) return false;
    const int added = extend(grown, near, target.data());
    if (added < 0) return false;
    stuck_ = 0;
    const Point reached(grown.node(added), grown.node(added) + space_.dim);
    int from = other.nearest(reached.data(), bound_ - grown.cost[size_t(added)]);
    while (from >= 0) {
      const double d = space_.distance(other.node(from), reached.data());
      if (d <= range_) return join(grown, added, other, from, reached);
      from = a_.size() + b_.size() > settings_.max_nodes ? -1 : extend(other, from, reached.data());
    }
    return false;
  }

  const std::vector<Point>& path() const { return path_; }
  // Skips the straight edge, which an earlier search has tried.
  void skip_direct() { tried_direct_ = true; }

 private:
  // Connects the start by a free edge to the nearest goal possible.
  bool connect_directly() {
    std::vector<const Point*> nearest;
    for (const Point& goal : goals_) nearest.push_back(&goal);
    std::stable_sort(nearest.begin(), nearest.end(), [&](const Point* a, const Point* b) {
      return space_.distance(start_.data(), a->data()) < space_.distance(start_.data(), b->data());
    });
    for (const Point* at : nearest) {
      const Point& goal = *at;
      if (!std::isinf(bound_) && space_.cost(start_.data(), goal.data()) >= bound_) continue;
      if (!space_.edge_free(start_.data(), goal.data()) || !space_.edge_certain(start_.data(), goal.data())) continue;
      path_ = {start_, goal};
      return true;
    }
    return false;
  }

  // Samples uniformly within the limits or, for a first path, near a tree; with a bound, where a path below it can
  // pass.
  bool sample(const Tree& grown, Point& target) {
    const bool first = std::isinf(bound_) && std::isinf(impact_limit_) && !bounded_;
    if (first && random_.uniform() < kNearbyShare) {
      const double* node = grown.node(random_.below(grown.size()));
      for (size_t j = 0; j < target.size(); ++j) {
        const double width = kNearby * (space_.upper[j] - space_.lower[j]);
        target[j] = std::clamp(node[j] + width * random_.normal(), space_.lower[j], space_.upper[j]);
      }
      return true;
    }
    for (int attempt = 0; attempt < 50; ++attempt) {
      for (int j = 0; j < space_.dim; ++j)
        target[size_t(j)] = random_.uniform(space_.lower[size_t(j)], space_.upper[size_t(j)]);
      if (std::isinf(bound_) || !space_.motion_is_length()) return true;
      double to_goal = std::numeric_limits<double>::infinity();
      for (const Point& goal : goals_) to_goal = std::min(to_goal, space_.distance(target.data(), goal.data()));
      // Uniform samples rarely fall into a thin ellipsoid in seven dimensions, so shrink towards the segment.
      const Point& goal = goals_[size_t(random_.below(int(goals_.size())))];
      const double along = random_.uniform();
      for (int shrink = 0; shrink < 12; ++shrink) {
        double from_start = space_.distance(start_.data(), target.data());
        to_goal = std::numeric_limits<double>::infinity();
        for (const Point& g : goals_) to_goal = std::min(to_goal, space_.distance(target.data(), g.data()));
        if (from_start + to_goal < bound_) return true;
        for (int j = 0; j < space_.dim; ++j) {
          const double on_segment = start_[size_t(j)] + along * (goal[size_t(j)] - start_[size_t(j)]);
          target[size_t(j)] = on_segment + 0.7 * (target[size_t(j)] - on_segment);
        }
      }
    }
    return false;
  }

  double lower_bound(const Tree& tree, const double* point) const {
    if (!space_.motion_is_length()) return 0;
    if (&tree == &b_) return space_.distance(start_.data(), point);
    double best = std::numeric_limits<double>::infinity();
    for (const Point& goal : goals_) best = std::min(best, space_.distance(goal.data(), point));
    return best;
  }

  // Edges of the goal tree are travelled towards the goal.
  bool edge_free(const Tree& tree, const double* from, const double* to) {
    return &tree == &a_ ? space_.edge_free(from, to) : space_.edge_free(to, from);
  }
  bool is_mild(const Tree& tree, const double* from, const double* to) {
    if (std::isinf(impact_limit_)) return true;
    const bool forward = &tree == &a_;
    const double impact = forward ? space_.impact(from, to) : space_.impact(to, from);
    return impact <= std::max(impact_limit_, unavoidable_[forward ? 0 : 1]) * space_.exposure(from, to);
  }
  double edge_cost(const Tree& tree, const double* from, const double* to) {
    if (std::isinf(bound_)) return space_.distance(from, to);
    return &tree == &a_ ? space_.cost(from, to) : space_.cost(to, from);
  }

  // Adds a node at most `range` from `near` towards the target; -1 if it is blocked or too expensive.
  int extend(Tree& tree, int near, const double* target) {
    Point to(target, target + space_.dim);
    const Point from(tree.node(near), tree.node(near) + space_.dim);
    const double d = space_.distance(from.data(), target);
    if (d < 1e-9) return -1;
    if (d > range_)
      for (int j = 0; j < space_.dim; ++j) to[size_t(j)] = from[size_t(j)] + (target[j] - from[size_t(j)]) * range_ / d;
    if (bounded_ && d > range_) {
      // Projected steps without progress would repeat forever.
      if (!space_.project(to.data())) return -1;
      if (space_.distance(to.data(), target) > d - kLeastGain * range_) return -1;
    }
    const double cost = tree.cost[size_t(near)] + edge_cost(tree, from.data(), to.data());
    if (cost + lower_bound(tree, to.data()) >= bound_) return -1;
    if (!edge_free(tree, from.data(), to.data()) || !is_mild(tree, from.data(), to.data())) return -1;
    return tree.add(to.data(), near, cost);
  }

  bool join(const Tree& grown, int added, const Tree& other, int from, const Point& reached) {
    const Point there(other.node(from), other.node(from) + space_.dim);
    const double cost =
        grown.cost[size_t(added)] + other.cost[size_t(from)] + edge_cost(other, there.data(), reached.data());
    if (cost >= bound_ || !edge_free(other, there.data(), reached.data()) ||
        !is_mild(other, there.data(), reached.data()))
      return false;
    const bool grown_is_a = &grown == &a_;
    path_.clear();
    for (int i = grown_is_a ? added : from; i >= 0; i = a_.parent[size_t(i)])
      path_.emplace_back(a_.node(i), a_.node(i) + space_.dim);
    std::reverse(path_.begin(), path_.end());
    for (int i = grown_is_a ? from : added; i >= 0; i = b_.parent[size_t(i)])
      path_.emplace_back(b_.node(i), b_.node(i) + space_.dim);
    path_.erase(std::unique(path_.begin(), path_.end()), path_.end());
    for (size_t k = 0; k + 1 < path_.size(); ++k)
      if (!space_.edge_certain(path_[k].data(), path_[k + 1].data())) {
        reset(bound_, impact_limit_);  // an edge of these trees touches an obstacle between two checks
        tried_direct_ = true;
        return false;
      }
    return true;
  }

  Space& space_;
  Point start_;
  std::vector<Point> goals_;
  ConnectSettings settings_;
  Random random_;
  Tree a_, b_;
  double bound_, impact_limit_;
  const bool bounded_;
  const double range_;
  double unavoidable_[2] = {0, 0};
  bool from_start_, tried_direct_;
  int stuck_ = 0;  // iterations since a tree last grew
  std::vector<Point> path_;
};

}  // namespace gp

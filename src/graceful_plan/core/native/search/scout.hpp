// A small, short-lived roadmap between start and goals that finds corridors of low impact. Nodes lie around an axis,
// the cost of edges uses the impact at rest at their ends and middle, and collisions are checked on paths only.
#pragma once
#include <algorithm>
#include <queue>

#include "search/planning.hpp"

namespace gp {

class Scout {
 public:
  Scout(Space& space, Point start, std::vector<Point> goals, uint64_t seed)
      : space_(space), start_(std::move(start)), goals_(std::move(goals)), random_(seed) {}

  // Starts a roadmap of `nodes` nodes in a tube around an axis; `width`: relative to the distance between the ends of
  // the axis. It includes the `known` paths.
  void begin(std::vector<Point> axis, const std::vector<std::vector<Point>>& known, double width, int nodes) {
    axis_ = std::move(axis), width_ = width, size_ = size_t(nodes);
    nodes_ = {start_};
    nodes_.insert(nodes_.end(), goals_.begin(), goals_.end());
    for (const std::vector<Point>& path : known)
      for (size_t i = 1; i + 1 < path.size(); ++i) nodes_.push_back(path[i]);
    price_nodes();
    found_ = 0, tried_ = 0, priced_ = 0, searched_ = 0;
    sampled_.clear(), pairs_.clear(), edges_.clear(), near_.clear();
    stage_ = kSample;
  }
  // Does a little work, below a millisecond if impacts are cheap; returns true if there is a path.
  bool step() {
    if (stage_ == kSample)
      sample();
    else if (stage_ == kPrice)
      price();
    else if (stage_ == kSearch)
      return search();
    return false;
  }
  bool done() const { return stage_ == kDone; }
  const std::vector<Point>& path() const { return path_; }

 private:
  enum Stage { kSample, kPrice, kSearch, kDone };
  struct Edge {
    int a, b;
    double cost;
    int8_t checked;
  };
  struct Sampled {
    Point q;
    double impact, promise;
  };
  static constexpr int kChunk = 32;                  // amount of work in one step
  static constexpr int kNeighbours = 10;             // per node
  static constexpr int kPaths = 4, kSearches = 200;  // paths found or searches made until the roadmap is dropped
  static constexpr double kLeastRadius = 0.1;        // least radius of the tube, per joint [rad]
  static constexpr double kRepulsion = 2.0;  // extra cost of the edges of found paths, so that the next path differs

  void price_nodes() {
    impact_.resize(nodes_.size());
    std::vector<double> rows;
    for (const Point& node : nodes_) rows.insert(rows.end(), node.begin(), node.end());
    space_.impacts(rows.data(), int(nodes_.size()), impact_.data());
  }

  Point near_axis() {
    const size_t k = size_t(random_.below(int(axis_.size()) - 1)), dim = start_.size();
    const double s = random_.uniform();
    const double extent = space_.distance(axis_.front().data(), axis_.back().data());
    const double radius = width_ * std::abs(random_.normal()) * extent / std::sqrt(double(dim)) + kLeastRadius;
    Point q(dim);
    for (size_t j = 0; j < dim; ++j)
      q[j] = std::clamp(axis_[k][j] + s * (axis_[k + 1][j] - axis_[k][j]) + radius * random_.normal(), space_.lower[j],
                        space_.upper[j]);
    return q;
  }

  // Samples twice as many free configurations as nodes, and keeps the more promising half.
  void sample() {
    std::vector<double> rows;
    std::vector<Point> fresh;
    for (int k = 0; k < kChunk; ++k, ++tried_) {
      Point q = near_axis();
      if (!space_.edge_free(q.data(), q.data())) continue;
      rows.insert(rows.end(), q.begin(), q.end());
      fresh.push_back(std::move(q));
    }
    std::vector<double> impact(fresh.size());
    if (!fresh.empty()) space_.impacts(rows.data(), int(fresh.size()), impact.data());
    for (size_t k = 0; k < fresh.size(); ++k) {
      double to_goal = std::numeric_limits<double>::infinity();
      for (const Point& goal : goals_)
        to_goal = std::min(to_goal, space_.guess(fresh[k].data(), goal.data(), impact[k]));
      const double promise = space_.guess(start_.data(), fresh[k].data(), impact[k]) + to_goal;
      sampled_.push_back({std::move(fresh[k]), impact[k], promise});
    }
    const size_t wanted = size_ * 2;
    if (sampled_.size() < wanted && tried_ < int64_t(wanted) * 10) return;
    std::stable_sort(sampled_.begin(), sampled_.end(),
                     [](const Sampled& a, const Sampled& b) { return a.promise < b.promise; });
    if (sampled_.size() > size_) sampled_.resize(size_);
    for (Sampled& one : sampled_) nodes_.push_back(std::move(one.q)), impact_.push_back(one.impact);
    row_ = 0;
    stage_ = kPrice;
  }

  // Connects each node to its nearest neighbours, then evaluates the impact at the middle of each edge.
  void price() {
    if (row_ < nodes_.size()) return connect();
    std::vector<double> rows;
    const size_t first = priced_, last = std::min(edges_.size(), first + 4 * kChunk), dim = start_.size();
    for (size_t e = first; e < last; ++e)
      for (size_t j = 0; j < dim; ++j)
        rows.push_back(0.5 * (nodes_[size_t(edges_[e].a)][j] + nodes_[size_t(edges_[e].b)][j]));
    std::vector<double> middle(last - first);
    if (last > first) space_.impacts(rows.data(), int(last - first), middle.data());
    for (size_t e = first; e < last; ++e) {
      Edge& edge = edges_[e];
      const double mean = 0.25 * (impact_[size_t(edge.a)] + impact_[size_t(edge.b)]) + 0.5 * middle[e - first];
      edge.cost = space_.guess(nodes_[size_t(edge.a)].data(), nodes_[size_t(edge.b)].data(), mean);
    }
    priced_ = last;
    if (priced_ < edges_.size()) return;
    near_.assign(nodes_.size(), {});
    for (size_t e = 0; e < edges_.size(); ++e)
      near_[size_t(edges_[e].a)].push_back(int(e)), near_[size_t(edges_[e].b)].push_back(int(e));
    stage_ = kSearch;
  }
  void connect() {
    const size_t n = nodes_.size(), last = std::min(n, row_ + kChunk), k = std::min(size_t(kNeighbours), n - 1);
    std::vector<std::pair<double, size_t>> all(n);
    for (; row_ < last; ++row_) {
      for (size_t i = 0; i < n; ++i)
        all[i] = {i == row_ ? std::numeric_limits<double>::infinity()
                            : space_.distance(nodes_[row_].data(), nodes_[i].data()),
                  i};
      std::nth_element(all.begin(), all.begin() + long(k) - 1, all.end());
      for (size_t i = 0; i < k; ++i) pairs_.push_back(std::minmax(row_, all[i].second));
    }
    if (row_ < n) return;
    std::sort(pairs_.begin(), pairs_.end());
    pairs_.erase(std::unique(pairs_.begin(), pairs_.end()), pairs_.end());
    for (const auto& [a, b] : pairs_) edges_.push_back({int(a), int(b), 0.0, 0});
  }

  // Finds the cheapest path without known blocked edges; returns true if all of it is free.
  bool search() {
    const size_t n = nodes_.size();
    std::vector<double> cost(n, std::numeric_limits<double>::infinity());
    std::vector<int> by(n, -1);
    using Item = std::pair<double, int>;
    std::priority_queue<Item, std::vector<Item>, std::greater<>> open;
    cost[0] = 0, open.push({0.0, 0});
    int reached = -1;
    while (!open.empty()) {
      const auto [c, i] = open.top();
      open.pop();
      if (c > cost[size_t(i)]) continue;
      if (i >= 1 && i <= int(goals_.size())) {
        reached = i;
        break;
      }
      for (const int e : near_[size_t(i)]) {
        const Edge& edge = edges_[size_t(e)];
        if (edge.checked < 0) continue;
        const int to = edge.a == i ? edge.b : edge.a;
        if (c + edge.cost < cost[size_t(to)])
          cost[size_t(to)] = c + edge.cost, by[size_t(to)] = e, open.push({cost[size_t(to)], to});
      }
    }
    if (reached < 0 || ++searched_ > kSearches) {
      stage_ = kDone;
      return false;
    }
    std::vector<int> used;
    path_ = {nodes_[size_t(reached)]};
    bool free = true;
    for (int i = reached; i != 0;) {
      Edge& edge = edges_[size_t(by[size_t(i)])];
      used.push_back(by[size_t(i)]);
      const int from = edge.a == i ? edge.b : edge.a;
      if (edge.checked == 0)
        edge.checked = space_.edge_free(nodes_[size_t(from)].data(), nodes_[size_t(i)].data()) ? 1 : -1;
      free &= edge.checked > 0;
      i = from;
      path_.push_back(nodes_[size_t(i)]);
    }
    if (!free) return false;
    std::reverse(path_.begin(), path_.end());
    for (const int e : used) edges_[size_t(e)].cost *= kRepulsion;
    if (++found_ >= kPaths) stage_ = kDone;
    return true;
  }

  Space& space_;
  Point start_;
  std::vector<Point> goals_;
  Random random_;
  Stage stage_ = kDone;
  double width_ = 0.5;
  std::vector<Point> axis_, nodes_, path_;
  std::vector<double> impact_;
  std::vector<Sampled> sampled_;
  std::vector<std::pair<size_t, size_t>> pairs_;
  std::vector<Edge> edges_;
  std::vector<std::vector<int>> near_;
  size_t size_ = 0, row_ = 0, priced_ = 0;
  int64_t tried_ = 0;
  int found_ = 0, searched_ = 0;
};

}  // namespace gp

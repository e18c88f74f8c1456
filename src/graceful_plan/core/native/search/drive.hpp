// Paths for a base that rolls along its heading and turns in place: A* over positions and headings around the start.
//
// Sixteen headings point exactly to other cells, so every move is a straight edge in configuration space along which
// the base rolls: forward, backward, or a turn to the next heading. Near a goal, and occasionally from afar, three
// edges connect to it: turn, drive, turn. Edges are checked and evaluated once, when first needed, and kept when the
// weight of the heuristic changes.
//
// M. Likhachev, D. Ferguson: "Planning long dynamically feasible maneuvers for autonomous vehicles", IJRR 28 (2009);
// for the way to the goal D. Dolgov et al.: "Path planning for autonomous vehicles in unknown semi-structured
// environments", IJRR 29 (2010).
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <queue>
#include <unordered_map>

#include "search/planning.hpp"

namespace gp {

struct DriveSettings {
  double cell = 0.1;  // [m]
  bool reverse = true;
  double weight = 1;  // of the heuristic: bound on the cost relative to the optimum
  int max_nodes = 2000000;
};

class Drive {
 public:
  // The first three joints are x, y and heading. The others stay at their start until the base has arrived.
  Drive(Space& space, Point start, std::vector<Point> goals, DriveSettings settings)
      : space_(space), start_(std::move(start)), goals_(std::move(goals)), settings_(settings) {
    for (int k = 0; k < kHeadings; ++k)
      angle_[size_t(k)] = std::atan2(double(kMoves[size_t(k)][1]), kMoves[size_t(k)][0]);
    for (int k = 1; k < kHeadings; ++k)
      if (angle_[size_t(k)] < 0) angle_[size_t(k)] += kTurn;
    begin(settings.weight);
  }

  // Restarts the search with another weight; evaluated edges are kept.
  void begin(double weight) {
    settings_.weight = weight;
    for (Node& node : nodes_) node.g = kInfinite, node.closed = false;
    open_ = {};
    best_ = kInfinite, over_ = false, expanded_ = 0;
    const int first = node_at({0, 0, 0}, start_[2]);
    nodes_[size_t(first)].g = 0, nodes_[size_t(first)].parent = -1;
    push(first);
  }

  // Expands one node. Returns true if it found a path, see path(); the search is then over.
  bool step() {
    if (over_) return false;
    if (open_.empty() || int(nodes_.size()) > settings_.max_nodes) {
      over_ = true;
      return false;
    }
    const Entry top = open_.top();
    open_.pop();
    if (top.node < 0) return finish();
    Node& node = nodes_[size_t(top.node)];
    if (node.closed) return false;
    node.closed = true;
    const int far = int(reach(node) / (kNear * settings_.cell));
    if (!node.no_way && (far <= 1 || expanded_ % far == 0)) connect(top.node);
    ++expanded_;
    expand(top.node);
    return false;
  }

  bool over() const { return over_; }
  const std::vector<Point>& path() const { return path_; }
  double cost() const { return best_; }

 private:
  static constexpr double kTurn = 6.283185307179586, kInfinite = std::numeric_limits<double>::infinity();
  static constexpr double kNear = 8;  // distance to a goal within which every node tries to connect [cells]
  static constexpr int kHeadings = 16, kEdges = 4;  // edges: forward, backward, turn left, turn right
  static constexpr int kMoves[kHeadings][2] = {{1, 0},  {2, 1},  {1, 1},  {1, 2},   {0, 1},   {-1, 2},
                                               {-1, 1}, {-2, 1}, {-1, 0}, {-2, -1}, {-1, -1}, {-1, -2},
                                               {0, -1}, {1, -2}, {1, -1}, {2, -1}};
  static constexpr double kUnknown = -1;  // cost of an edge that has not been evaluated

  using Key = std::array<int, 3>;  // cells along and across the first heading, heading
  struct Hash {
    size_t operator()(const Key& key) const {
      uint64_t h = uint64_t(uint32_t(key[0])) * 0x9e3779b97f4a7c15ull;
      h = (h ^ (h >> 29) ^ uint32_t(key[1])) * 0xbf58476d1ce4e5b9ull;
      return size_t((h ^ (h >> 32) ^ uint32_t(key[2])) * 0x94d049bb133111ebull);
    }
  };
  struct Node {
    Key key;
    double yaw, g;
    int parent;
    bool closed, no_way;  // no_way: the connection found from here touches an obstacle between checks
    double edge[kEdges];  // cost of each, infinite if blocked
  };
  struct Entry {
    double f;
    int node;  // -1: the goal
    bool operator<(const Entry& other) const { return f > other.f; }
  };

  int node_at(const Key& key, double yaw) {
    const auto [at, is_new] = index_.try_emplace(key, int(nodes_.size()));
    if (is_new) nodes_.push_back({key, yaw, kInfinite, -1, false, false, {kUnknown, kUnknown, kUnknown, kUnknown}});
    return at->second;
  }
  Point state(const Key& key, double yaw) const {
    Point q = start_;
    const double c = std::cos(start_[2]), s = std::sin(start_[2]);
    q[0] += settings_.cell * (c * key[0] - s * key[1]);
    q[1] += settings_.cell * (s * key[0] + c * key[1]);
    q[2] = yaw;
    return q;
  }
  bool inside(const Point& q) const {
    for (size_t j = 0; j < 3; ++j)
      if (q[j] < space_.lower[j] || q[j] > space_.upper[j]) return false;
    return true;
  }
  double priced(const Point& a, const Point& b) {
    return inside(b) && space_.edge_free(a.data(), b.data()) ? space_.cost(a.data(), b.data()) : kInfinite;
  }

  void expand(int from) {
    const Key key = nodes_[size_t(from)].key;
    const double yaw = nodes_[size_t(from)].yaw, g = nodes_[size_t(from)].g;
    const Point here = state(key, yaw);
    for (int e = 0; e < kEdges; ++e) {
      if (e == 1 && !settings_.reverse) continue;
      Key next = key;
      double heading = yaw;
      if (e < 2) {
        const int sign = e == 0 ? 1 : -1;
        next[0] += sign * kMoves[size_t(key[2])][0], next[1] += sign * kMoves[size_t(key[2])][1];
      } else {
        next[2] = (key[2] + (e == 2 ? 1 : kHeadings - 1)) % kHeadings;
        heading += std::remainder(angle_[size_t(next[2])] - angle_[size_t(key[2])], kTurn);
      }
      double cost = nodes_[size_t(from)].edge[e];
      if (cost == kUnknown) {
        const auto known = index_.find(next);
        if (known != index_.end() && nodes_[size_t(known->second)].closed) continue;
        cost = nodes_[size_t(from)].edge[e] = priced(here, state(next, heading));
      }
      if (cost == kInfinite) continue;
      const int to = node_at(next, heading);
      Node& node = nodes_[size_t(to)];
      if (node.closed || g + cost >= node.g) continue;
      node.g = g + cost, node.parent = from, node.yaw = heading;
      push(to);
    }
  }

  // Connects a node to all goals: turn, drive, turn; also backwards. The cheapest connection competes with all other
  // nodes.
  void connect(int from) {
    const Node node = nodes_[size_t(from)];
    const Point here = state(node.key, node.yaw);
    for (const Point& goal : goals_) {
      const double dx = goal[0] - here[0], dy = goal[1] - here[1];
      const bool moves = std::hypot(dx, dy) > 1e-9;
      for (int gear = 0; gear < (settings_.reverse && moves ? 2 : 1); ++gear) {
        std::vector<Point> way{here};
        if (moves) {
          const double along = std::atan2(dy, dx) + (gear == 1 ? 0.5 * kTurn : 0);
          Point turned = here;
          turned[2] += std::remainder(along - here[2], kTurn);
          Point there = turned;
          there[0] = goal[0], there[1] = goal[1];
          way.push_back(turned), way.push_back(there);
        }
        Point standing = way.back();
        standing[2] += std::remainder(goal[2] - standing[2], kTurn);
        way.push_back(standing);
        // The other joints move last; whole turns of the heading do not matter.
        Point reached = goal;
        reached[2] = standing[2];
        way.push_back(reached);
        way.erase(std::unique(way.begin(), way.end()), way.end());
        double cost = node.g;
        for (size_t k = 0; k + 1 < way.size() && cost < best_; ++k)
          cost += space_.motion(way[k].data(), way[k + 1].data());
        if (cost >= best_) continue;
        cost = node.g;
        for (size_t k = 0; k + 1 < way.size() && cost < best_; ++k) cost += priced(way[k], way[k + 1]);
        if (cost >= best_) continue;
        best_ = cost, last_ = from, way_ = std::move(way);
        open_.push({best_, -1});
      }
    }
  }

  bool finish() {
    std::vector<int> chain;
    for (int i = last_; i >= 0; i = nodes_[size_t(i)].parent) chain.push_back(i);
    std::reverse(chain.begin(), chain.end());
    path_.clear();
    double yaw = start_[2];
    for (size_t k = 0; k < chain.size(); ++k) {
      const Node& node = nodes_[size_t(chain[k])];
      if (k > 0) {
        const Node& before = nodes_[size_t(chain[k - 1])];
        yaw += std::remainder(angle_[size_t(node.key[2])] - angle_[size_t(before.key[2])], kTurn);
      }
      path_.push_back(state(node.key, yaw));
    }
    const double off = way_.front()[2] - yaw;  // whole turns
    for (Point& q : way_) q[2] -= off;
    path_.insert(path_.end(), way_.begin() + 1, way_.end());
    path_.erase(std::unique(path_.begin(), path_.end()), path_.end());
    if (path_.size() < 2) path_.push_back(path_.front());
    over_ = true;
    for (size_t k = 0; k + 1 < path_.size(); ++k) {
      if (inside(path_[k + 1]) && space_.edge_certain(path_[k].data(), path_[k + 1].data())) continue;
      // The edge touches an obstacle between two checks: search again without it.
      if (k + 1 < chain.size())
        block(chain[k], chain[k + 1]);
      else
        nodes_[size_t(last_)].no_way = true;
      begin(settings_.weight);
      return false;
    }
    return true;
  }
  void block(int from, int to) {
    Node& node = nodes_[size_t(from)];
    const Key& next = nodes_[size_t(to)].key;
    for (int e = 0; e < kEdges; ++e) {
      Key there = node.key;
      if (e < 2) {
        const int sign = e == 0 ? 1 : -1;
        there[0] += sign * kMoves[size_t(node.key[2])][0], there[1] += sign * kMoves[size_t(node.key[2])][1];
      } else {
        there[2] = (node.key[2] + (e == 2 ? 1 : kHeadings - 1)) % kHeadings;
      }
      if (there == next) node.edge[e] = kInfinite;
    }
  }

  double reach(const Node& node) const {
    const Point here = state(node.key, node.yaw);
    double least = kInfinite;
    for (const Point& goal : goals_) least = std::min(least, std::hypot(goal[0] - here[0], goal[1] - here[1]));
    return least;
  }
  // Lower bound: every path drives at least the distance to a goal and turns at least the difference in heading.
  double bound(const Node& node) const {
    if (!space_.motion_is_length()) return 0;
    const Point here = state(node.key, node.yaw);
    double least = kInfinite;
    for (const Point& goal : goals_)
      least = std::min(least, std::hypot(goal[0] - here[0], goal[1] - here[1]) +
                                  std::fabs(std::remainder(goal[2] - here[2], kTurn)));
    return least;
  }
  void push(int i) { open_.push({nodes_[size_t(i)].g + settings_.weight * bound(nodes_[size_t(i)]), i}); }

  Space& space_;
  Point start_;
  std::vector<Point> goals_;
  DriveSettings settings_;
  std::array<double, kHeadings> angle_;
  std::vector<Node> nodes_;
  std::unordered_map<Key, int, Hash> index_;
  std::priority_queue<Entry> open_;
  double best_ = kInfinite;
  int last_ = -1, expanded_ = 0;
  bool over_ = false;
  std::vector<Point> way_, path_;
};

}  // namespace gp

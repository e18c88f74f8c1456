// A directed graph with costs on its edges: cheapest paths, and all non-dominated paths for two costs.
#pragma once
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <limits>
#include <queue>
#include <utility>
#include <vector>

namespace gp {

// Edges sorted by the node that they leave (or enter, for reversed edges); node i has edge[begin[i] .. begin[i + 1]).
struct Adjacency {
  std::vector<int> begin, edge;

  Adjacency(int n, const std::vector<int>& node) : begin(size_t(n) + 1, 0), edge(node.size()) {
    for (int i : node) ++begin[size_t(i) + 1];
    for (size_t i = 0; i < size_t(n); ++i) begin[i + 1] += begin[i];
    std::vector<int> next(begin.begin(), begin.end() - 1);
    for (size_t e = 0; e < node.size(); ++e) edge[size_t(next[size_t(node[e])]++)] = int(e);
  }
};

// A path: its edges, and both costs summed from its start.
struct FoundPath {
  std::vector<int> edge;
  double first, second;
};

struct Found {
  std::vector<FoundPath> paths;
  bool complete;
};

class Digraph {
 public:
  static constexpr double kUnreached = std::numeric_limits<double>::infinity();

  Digraph(int n, std::vector<int> tail, std::vector<int> head)
      : n_(n), tail_(std::move(tail)), head_(std::move(head)), out_(n, tail_), in_(n, head_) {}
  int size() const { return n_; }
  size_t edges() const { return tail_.size(); }

  // The edges of the cheapest path to the nearest goal, and its cost, infinite if there is none. Edge costs are at
  // least 0; infinite ones disable an edge.
  FoundPath cheapest(const double* cost, int start, const std::vector<int>& goals) const {
    std::vector<double> distance(size_t(n_), kUnreached);
    std::vector<int> from(size_t(n_), -1);
    std::vector<uint8_t> is_goal = flags(goals);
    Heap heap;
    distance[size_t(start)] = 0;
    heap.push({0, start});
    while (!heap.empty()) {
      const auto [d, i] = heap.top();
      heap.pop();
      if (d > distance[size_t(i)]) continue;
      if (is_goal[size_t(i)]) return {way_back(from, i), d, 0};
      for (int k = out_.begin[size_t(i)]; k < out_.begin[size_t(i) + 1]; ++k) {
        const size_t e = size_t(out_.edge[size_t(k)]), j = size_t(head_[e]);
        if (d + cost[e] < distance[j]) distance[j] = d + cost[e], from[j] = int(e), heap.push({distance[j], int(j)});
      }
    }
    return {{}, kUnreached, kUnreached};
  }

  // All non-dominated paths to a goal, by ascending first cost; of equal ones, one. With epsilon, a subset: for each
  // non-dominated path there is one that costs no more in the first and at most (1 + epsilon) times as much in the
  // second.
  //
  // Labels leave the heap by ascending first cost. A label is therefore dominated at its node if and only if an earlier
  // one had no larger second cost: BOA*, Hernandez Ulloa et al., "A simple and fast bi-objective search algorithm",
  // ICAPS 2020; pruning by epsilon at the goal as in Zhang et al., "A*pex", ICAPS 2022.
  Found front(const double* cost, int start, const std::vector<int>& goals, double epsilon, double seconds) const {
    const std::vector<double> first_to_go = to_go(cost, goals), second_to_go = to_go(cost + 1, goals);
    const std::vector<uint8_t> is_goal = flags(goals);
    std::vector<double> least(size_t(n_), kUnreached);  // least second cost at each node
    double least_at_goal = kUnreached;
    std::vector<Label> labels;
    std::priority_queue<Waiting, std::vector<Waiting>, Later> heap;
    Found found{{}, true};
    const auto dominated = [&](int node, double second) {
      return second >= least[size_t(node)] || (second + second_to_go[size_t(node)]) * (1 + epsilon) >= least_at_goal;
    };
    const auto offer = [&](int node, int edge, int parent, double first, double second) {
      if (first + first_to_go[size_t(node)] == kUnreached || dominated(node, second)) return;
      labels.push_back({node, edge, parent, first, second});
      heap.push({first + first_to_go[size_t(node)], second + second_to_go[size_t(node)], int(labels.size()) - 1});
    };
    const auto began = std::chrono::steady_clock::now();
    offer(start, -1, -1, 0, 0);
    for (int64_t count = 1; !heap.empty(); ++count) {
      const int id = heap.top().label;
      heap.pop();
      const Label label = labels[size_t(id)];
      if (dominated(label.node, label.second)) continue;
      if ((count & 1023) == 0 &&
          std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count() > seconds) {
        found.complete = false;
        return found;
      }
      least[size_t(label.node)] = label.second;
      if (is_goal[size_t(label.node)]) {
        least_at_goal = label.second;
        found.paths.push_back({way_back(labels, id), label.first, label.second});
        continue;
      }
      for (int k = out_.begin[size_t(label.node)]; k < out_.begin[size_t(label.node) + 1]; ++k) {
        const size_t e = size_t(out_.edge[size_t(k)]);
        offer(head_[e], int(e), id, label.first + cost[2 * e], label.second + cost[2 * e + 1]);
      }
    }
    return found;
  }

 private:
  using Heap = std::priority_queue<std::pair<double, int>, std::vector<std::pair<double, int>>, std::greater<>>;
  struct Label {
    int node, edge, parent;
    double first, second;
  };
  struct Waiting {
    double first, second;  // lower bounds for the whole path
    int label;
  };
  struct Later {
    bool operator()(const Waiting& a, const Waiting& b) const {
      return a.first != b.first ? a.first > b.first : a.second != b.second ? a.second > b.second : a.label > b.label;
    }
  };

  std::vector<uint8_t> flags(const std::vector<int>& nodes) const {
    std::vector<uint8_t> marked(size_t(n_), 0);
    for (int i : nodes) marked[size_t(i)] = 1;
    return marked;
  }

  // Least cost from each node to a goal, for the first or second cost; slightly reduced, so that rounding never hides a
  // path.
  std::vector<double> to_go(const double* cost, const std::vector<int>& goals) const {
    std::vector<double> distance(size_t(n_), kUnreached);
    Heap heap;
    for (int i : goals) distance[size_t(i)] = 0, heap.push({0, i});
    while (!heap.empty()) {
      const auto [d, i] = heap.top();
      heap.pop();
      if (d > distance[size_t(i)]) continue;
      for (int k = in_.begin[size_t(i)]; k < in_.begin[size_t(i) + 1]; ++k) {
        const size_t e = size_t(in_.edge[size_t(k)]), j = size_t(tail_[e]);
        if (d + cost[2 * e] < distance[j]) distance[j] = d + cost[2 * e], heap.push({distance[j], int(j)});
      }
    }
    for (double& d : distance) d *= 1 - 1e-12;
    return distance;
  }

  std::vector<int> way_back(const std::vector<int>& from, int node) const {
    std::vector<int> path;
    for (int e = from[size_t(node)]; e >= 0; e = from[size_t(tail_[size_t(e)])]) path.push_back(e);
    std::reverse(path.begin(), path.end());
    return path;
  }
  static std::vector<int> way_back(const std::vector<Label>& labels, int id) {
    std::vector<int> path;
    for (; labels[size_t(id)].parent >= 0; id = labels[size_t(id)].parent) path.push_back(labels[size_t(id)].edge);
    std::reverse(path.begin(), path.end());
    return path;
  }

  int n_;
  std::vector<int> tail_, head_;
  Adjacency out_, in_;
};

}  // namespace gp

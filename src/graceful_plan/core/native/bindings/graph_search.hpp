// Python bindings of graph.hpp.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "bindings/bindings.hpp"
#include "checks.hpp"
#include "search/graph.hpp"

namespace gp {

class GraphSearch {
 public:
  GraphSearch(int n, Integers tail, Integers head) : graph_(checked(n, tail, head), nodes(tail, n), nodes(head, n)) {}

  // Ids of the edges along the path, and its cost, infinite if there is none.
  nb::tuple cheapest(Reals cost, int start, Integers goals) const {
    require(cost.size() == graph_.edges(), "one cost per edge");
    check(cost);
    const std::vector<int> ends = targets(start, goals);
    FoundPath found;
    {
      nb::gil_scoped_release release;
      found = graph_.cheapest(cost.data(), start, ends);
    }
    return nb::make_tuple(ids(found.edge), found.first);
  }

  // The edge ids of each path; its two costs; whether the search was completed.
  nb::tuple front(Reals cost, int start, Integers goals, double epsilon, double seconds) const {
    require(cost.size() == 2 * graph_.edges(), "two costs per edge");
    require(epsilon >= 0 && std::isfinite(epsilon) && seconds >= 0, "epsilon and seconds");
    check(cost);
    const std::vector<int> ends = targets(start, goals);
    Found found;
    {
      nb::gil_scoped_release release;
      found = graph_.front(cost.data(), start, ends, epsilon, seconds);
    }
    nb::list paths;
    double* data;
    auto costs = make<double>({found.paths.size(), 2}, data);
    for (const FoundPath& path : found.paths) {
      paths.append(ids(path.edge));
      *data++ = path.first, *data++ = path.second;
    }
    return nb::make_tuple(paths, std::move(costs), found.complete);
  }

 private:
  static constexpr int kMaxNodes = 1 << 26;

  static int checked(int n, const Integers& tail, const Integers& head) {
    require(n >= 0 && n <= kMaxNodes, "number of nodes");
    require(tail.size() == head.size() && tail.size() <= size_t(std::numeric_limits<int>::max()), "edges");
    return n;
  }
  static std::vector<int> nodes(const Integers& of, int n) {
    for (size_t i = 0; i < of.size(); ++i) require(of.data()[i] >= 0 && of.data()[i] < n, "node of an edge");
    return {of.data(), of.data() + of.size()};
  }
  std::vector<int> targets(int start, const Integers& goals) const {
    require(start >= 0 && start < graph_.size(), "start");
    return nodes(goals, graph_.size());
  }
  static void check(const Reals& cost) {
    for (size_t i = 0; i < cost.size(); ++i) require(cost.data()[i] >= 0, "costs are numbers of at least 0");
  }
  static Array<int32_t> ids(const std::vector<int>& edges) {
    int32_t* data;
    auto array = make<int32_t>({edges.size()}, data);
    std::copy(edges.begin(), edges.end(), data);
    return array;
  }

  Digraph graph_;
};

}  // namespace gp

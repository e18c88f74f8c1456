// The lattice search; the lattice is in state_lattice.hpp.
#pragma once

#include "mobile/lattice/state_lattice.hpp"

namespace gp::lattice {

class StateLattice::Search {
 public:
  Search(const StateLattice& of, const Question& question)
      : of_(of), q_(question), bound_(costs(*of.bound_)), lead_(costs(*of.lead_)) {}

  Answer run() {
    if (!of_.free_at(q_.start, 0.0)) return ended(Outcome::start_blocked);
    if (!of_.free_at(q_.goal, 0.0)) return ended(Outcome::goal_blocked);
    if (q_.shots > 0) try_shot(q_.start, -1, 0.0);
    Outcome outcome = Outcome::no_path;
    if (q_.lead > 0.0) {
      if (!flooded(&lead_, 1.0)) return ended(late() ? Outcome::stopped : Outcome::no_path);
      ends();
      to_go_ = &lead_, estimates_ = true;
      // After an unsuccessful pass, the weight of the estimate is increased.
      double lead = q_.lead;
      for (int64_t most = kLost; (outcome = pass(lead, most)) == Outcome::no_path && given_up_; most *= 4) lead *= 2.0;
      estimates_ = false;
      answer_.first_cost = cost_, answer_.first_expansions = answer_.expansions;
      if (outcome == Outcome::no_path) return ended(outcome);
    }
    if (outcome != Outcome::stopped || cost_ < kInfinity) outcome = better(outcome);
    return ended(cost_ < kInfinity ? Outcome::solved : outcome);
  }

 private:
  CostToGo costs(const Guide& guide) const {
    return {guide, of_.floor_.impact ? q_.w : 0.0, of_.s_.steering.reverse ? of_.s_.steering.penalty : kInfinity};
  }
  bool flooded(CostToGo* costs, double share) {
    const auto out_of_time = [this] { return late(); };
    return costs->flood(cell(q_.start), cell(q_.goal), share, 10.0 * of_.s_.resolution, out_of_time);
  }
  // Searches guided by the lower bound, and the suboptimality bound of the result.
  Outcome better(Outcome outcome) {
    if (outcome == Outcome::stopped) return outcome;
    // Without further searches, only the cost to go at the start is needed.
    if (!flooded(&bound_, q_.inflations.empty() ? 1.0 : 1.1)) return late() ? Outcome::stopped : Outcome::no_path;
    if (q_.lead == 0.0) ends();
    to_go_ = &bound_;
    const double lower = std::max(bound_at(cell(q_.start), q_.start), 1e-9);
    for (const double inflation : q_.inflations) {
      if (cost_ <= lower * (1.0 + 1e-12)) break;
      outcome = pass(inflation);
      if (outcome == Outcome::stopped) break;
      if (cost_ == kInfinity) return Outcome::no_path;
      answer_.bound = std::max(1.0, std::min(answer_.bound, inflation));
      if (answer_.first_cost == kInfinity) {
        answer_.first_cost = cost_, answer_.first_expansions = answer_.expansions;
      }
      if (answer_.bound <= 1.0 + 1e-12) break;
    }
    if (cost_ < kInfinity) answer_.bound = std::max(1.0, std::min(answer_.bound, cost_ / lower));
    return outcome;
  }

  struct Node {
    double g;
    float h;
    uint32_t key;
    int parent, via;  // via: index of a move; for nodes without a parent, of a connection from the start
    bool closed;
  };
  struct Entry {
    double f, g;
    int node;
  };
  struct Way {  // connection between the start or the goal and a state
    uint32_t key;
    Curve curve;
    double cost, impact;
  };
  // Expansions between looks at the clock, and before the first restart with a larger lead.
  static constexpr int64_t kClockEvery = 2048, kLost = 2048;
  static constexpr double kSame = 1e-9;  // rounding tolerance [m]

  static bool later(const Entry& a, const Entry& b) {
    if (a.f != b.f) return a.f > b.f;
    return a.g != b.g ? a.g < b.g : a.node > b.node;
  }
  Answer ended(Outcome outcome) {
    answer_.outcome = outcome, answer_.cost = cost_;
    if (outcome == Outcome::solved) answer_.pieces = pieces_, answer_.impact = impact_;
    return answer_;
  }
  Cell cell(const Pose& pose) const { return of_.floor_.cell(pose.x, pose.y); }
  uint32_t key(const Cell& c, int heading) const {
    return uint32_t(of_.floor_.index(c) * size_t(of_.s_.headings) + size_t(heading));
  }
  std::pair<Cell, int> state(uint32_t key) const {
    const uint32_t c = key / uint32_t(of_.s_.headings), columns = uint32_t(of_.floor_.columns);
    return {{int(c % columns), int(c / columns)}, int(key % uint32_t(of_.s_.headings))};
  }
  // Lower bound on the cost to the goal; less a cell, for the distances of its centre and the goal's.
  double bound_at(const Cell& at, const Pose& pose) const {
    const double over_cells = estimates_ ? to_go_->at(at) : to_go_->at(at) / of_.chain_ - 1.5 * of_.s_.resolution;
    return std::max(over_cells, of_.s_.steering.bound(pose, q_.goal));
  }

  bool on_lattice(const Pose& pose, uint32_t k) const {
    const auto [c, heading] = state(k);
    const Pose at = of_.pose_of(c, heading);
    return std::hypot(at.x - pose.x, at.y - pose.y) < 1e-9 && std::abs(wrapped(at.yaw - pose.yaw)) < 1e-9;
  }
  // States near the start and the goal, ahead and behind, straight and on arcs, and the curves that connect them.
  void ends() {
    for (const bool from_start : {true, false}) {
      const Pose& end = from_start ? q_.start : q_.goal;
      std::vector<uint32_t> near;
      const auto add = [&](const Pose& pose) {
        const Cell c = cell(pose);
        if (of_.floor_.holds(c)) near.push_back(key(c, of_.moves_.nearest(pose.yaw)));
      };
      add(end);
      const double radius = of_.s_.steering.radius;
      // A pose on the lattice needs no connection.
      const bool on = on_lattice(end, near.front());
      for (const double far : {-2.0, -1.0, -0.5, 0.5, 1.0, 2.0}) {
        if (on) break;
        for (const double bend : {-0.8, -0.4, 0.0, 0.4, 0.8}) add(moved(end, {far * radius, bend / radius, 0.0}, 1.0));
      }
      std::sort(near.begin(), near.end());
      near.erase(std::unique(near.begin(), near.end()), near.end());
      for (const uint32_t k : near) {
        const auto [c, heading] = state(k);
        const Pose pose = of_.pose_of(c, heading);
        Way way{k, from_start ? of_.s_.steering.shortest(end, pose) : of_.s_.steering.shortest(pose, end), 0.0, 0.0};
        if (!of_.free_at(pose, 0.0) || !of_.curve_free(from_start ? end : pose, way.curve, &way.impact)) continue;
        way.cost = way.curve.cost + q_.w * way.impact;
        if (from_start) {
          from_start_.push_back(way);
        } else {
          goal_of_[k] = int(to_goal_.size());
          to_goal_.push_back(way);
        }
      }
    }
  }

  // Without inflation, states are reopened: the bound of the impact may decrease by more than the cost of a move.
  bool settled(const Node& node) const { return node.closed && (estimates_ || inflation_ > 1.0); }

  Outcome pass(double inflation, int64_t most = std::numeric_limits<int64_t>::max()) {
    nodes_.clear(), open_.clear();
    table_.assign(size_t(1) << 12, -1);
    inflation_ = inflation, given_up_ = false;
    const int64_t last = answer_.expansions + std::min(most, q_.max_expansions);
    int until = 1;
    for (size_t i = 0; i < from_start_.size(); ++i) reach(from_start_[i].key, from_start_[i].cost, -1, int(i));
    while (!open_.empty()) {
      const Entry top = open_.front();
      if (top.f >= cost_) return Outcome::solved;
      std::pop_heap(open_.begin(), open_.end(), later);
      open_.pop_back();
      Node& node = nodes_[size_t(top.node)];
      if (node.closed || top.g > node.g) continue;
      node.closed = true;
      if (answer_.expansions >= q_.max_expansions) return Outcome::stopped;
      if (answer_.expansions >= last && cost_ == kInfinity) {
        given_up_ = true;
        return Outcome::no_path;
      }
      if (++answer_.expansions % kClockEvery == 0 && late()) return Outcome::stopped;
      const auto [c, heading] = state(node.key);
      if (const auto found = goal_of_.find(node.key); found != goal_of_.end()) {
        const Way& way = to_goal_[size_t(found->second)];
        arrive(top.node, node.g + way.cost, way.curve, way.impact);
      }
      if (q_.shots > 0 && --until <= 0) {
        until = 1 + int(double(node.h) / of_.s_.steering.radius) * q_.shots;
        try_shot(of_.pose_of(c, heading), top.node, node.g);
      }
      expand(top.node, c, heading);
    }
    return cost_ < kInfinity ? Outcome::solved : Outcome::no_path;
  }
  bool late() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - began_).count() > q_.time_limit;
  }
  void expand(int from, const Cell& c, int heading) {
    const double g = nodes_[size_t(from)].g;
    for (int m = of_.first_[size_t(heading)]; m < of_.first_[size_t(heading) + 1]; ++m) {
      const Flat& move = of_.flat_[size_t(m)];
      const Cell next{c.x + move.dx, c.y + move.dy};
      if (!of_.floor_.holds(next)) continue;
      const uint32_t k = key(next, move.to);
      const int known = find(k);
      if (known >= 0 && (settled(nodes_[size_t(known)]) || nodes_[size_t(known)].g <= g + move.cost)) continue;
      if (known >= 0 && g + move.cost + double(nodes_[size_t(known)].h) >= cost_) continue;
      if (!of_.move_free(c, move)) continue;
      const double impact = q_.w > 0.0 && of_.floor_.impact ? q_.w * of_.move_impact(c, move) : 0.0;
      reach(k, g + move.cost + impact, from, m);
    }
  }
  void reach(uint32_t k, double g, int parent, int via) {
    int at = find(k);
    if (at >= 0) {
      Node& node = nodes_[size_t(at)];
      if (settled(node) || g >= node.g - kSame) return;
      node.g = g, node.parent = parent, node.via = via, node.closed = false;
    } else {
      const auto [c, heading] = state(k);
      const double h = bound_at(c, of_.pose_of(c, heading));
      if (!(g + h < cost_) || h == kInfinity) return;
      at = int(nodes_.size());
      // Rounded down, so that a lower bound stays one.
      nodes_.push_back({g, std::nextafter(float(h), -1.0F), k, parent, via, false});
      insert(k, at);
    }
    const double f = g + inflation_ * double(nodes_[size_t(at)].h);
    if (g + double(nodes_[size_t(at)].h) >= cost_) return;
    open_.push_back({f, g, at});
    std::push_heap(open_.begin(), open_.end(), later);
  }
  void try_shot(const Pose& from, int node, double g) {
    const Curve curve = of_.s_.steering.shortest(from, q_.goal);
    double impact;
    if (g + curve.cost >= cost_ || !of_.curve_free(from, curve, &impact)) return;
    arrive(node, g + curve.cost + q_.w * impact, curve, impact);
  }
  void arrive(int node, double cost, const Curve& last, double last_impact) {
    if (cost >= cost_) return;
    cost_ = cost, impact_ = last_impact;
    std::vector<const Node*> back;
    for (; node >= 0; node = nodes_[size_t(node)].parent) back.push_back(&nodes_[size_t(node)]);
    pieces_.clear();
    const auto append = [&](const auto& pieces, size_t n) {
      for (size_t i = 0; i < n; ++i) pieces_.push_back(pieces[i]);
    };
    for (auto it = back.rbegin(); it != back.rend(); ++it) {
      const Node& at = **it;
      if (at.parent < 0) {
        const Way& way = from_start_[size_t(at.via)];
        append(way.curve.pieces, size_t(way.curve.n)), impact_ += way.impact;
        continue;
      }
      const auto [c, heading] = state(nodes_[size_t(at.parent)].key);
      const auto& pieces = of_.moves_.from(heading)[size_t(at.via - of_.first_[size_t(heading)])].pieces;
      append(pieces, pieces.size());
      if (of_.floor_.impact) impact_ += of_.move_impact(c, of_.flat_[size_t(at.via)]);
    }
    append(last.pieces, size_t(last.n));
  }

  // Hash table with open addressing: key to node.
  int find(uint32_t k) const {
    for (size_t i = slot(k);; i = (i + 1) & (table_.size() - 1)) {
      if (table_[i] < 0 || nodes_[size_t(table_[i])].key == k) return table_[i];
    }
  }
  void insert(uint32_t k, int node) {
    if (2 * nodes_.size() > table_.size()) {
      table_.assign(4 * table_.size(), -1);
      for (int i = 0; i < int(nodes_.size()) - 1; ++i) place(nodes_[size_t(i)].key, i);
    }
    place(k, node);
  }
  void place(uint32_t k, int node) {
    size_t i = slot(k);
    while (table_[i] >= 0) i = (i + 1) & (table_.size() - 1);
    table_[i] = node;
  }
  size_t slot(uint32_t k) const { return (uint64_t(k) * 0x9E3779B97F4A7C15ULL >> 32) & (table_.size() - 1); }

  const StateLattice& of_;
  const Question& q_;
  std::chrono::steady_clock::time_point began_ = std::chrono::steady_clock::now();
  CostToGo bound_, lead_;
  CostToGo* to_go_ = nullptr;
  bool estimates_ = false, given_up_ = false;
  std::vector<Node> nodes_;
  std::vector<Entry> open_;
  std::vector<int> table_;
  std::vector<Way> from_start_, to_goal_;
  std::unordered_map<uint32_t, int> goal_of_;
  double inflation_ = 1.0, cost_ = kInfinity, impact_ = 0.0;
  std::vector<Piece> pieces_;
  Answer answer_;
};

inline Answer StateLattice::search(const Question& question) const { return Search(*this, question).run(); }

}  // namespace gp::lattice

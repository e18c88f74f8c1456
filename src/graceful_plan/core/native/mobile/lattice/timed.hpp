// A* over cells, headings and ticks of time among moving entities. A base waits, turns in place, or drives along its
// heading fast, slowly, or backwards; each move is checked against the positions of the entities at that time. The
// heuristic is the cost to go without moving entities, from a search backwards from the goal; it is a lower bound. Once
// all entities have come to rest, the exact cost to go with them is used, so that blocked routes are not tried (D.
// Silver, "Cooperative pathfinding", AIIDE 2005).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <queue>
#include <vector>

#include "mobile/coast/floor_shape.hpp"

namespace gp::lattice {

struct TimedMove {
  enum Kind { kWait, kTurn, kForward, kSlow, kBackward };
  int heading, dx, dy, turn, ticks;
  Kind kind;
  double price;  // price of the move without impact and moving entities
};

// Rows from below, in the frame of the cells: cell (column x, row y) has its centre at (x, y) width.
struct TimedFloor {
  int columns, rows, headings;
  double width;
  const uint8_t* open;  // [headings, rows, columns] 1: the base may be there; 2: it may drive forward from there
  const float* rate;    // [headings, rows, columns] price of a second of driving forward, for static entities, or null
  size_t cells() const { return size_t(columns) * size_t(rows) * size_t(headings); }
  size_t index(int x, int y, int h) const {
    return (size_t(h) * size_t(rows) + size_t(y)) * size_t(columns) + size_t(x);
  }
  bool holds(int x, int y) const { return x >= 0 && y >= 0 && x < columns && y < rows; }
};

// Moving entities at half ticks, and the price of a second of driving beside them.
struct TimedEntities {
  size_t n, halves, places, classes;
  const double* shape;      // [n, halves, 7] as in `FloorShape`, in the frame of the cells
  const int32_t* velocity;  // [n, halves] class of the velocity
  const float* rate;        // [classes, headings, places, places] by position relative to the entity, along x and y
  double apart;             // between places [m]
};

struct TimedRules {
  std::vector<double> outline;  // discs in the frame of the base: x, y, radius
  double driving, standing;     // clearance to moving entities below which nothing drives, or stands [m]
  double wanted, price;         // wanted clearance, and the price of a second at zero clearance
  double slow;                  // factor on the impact of slow and backward moves
  double tick;                  // [s]
  int ticks;                    // last tick
};
template <class Visit> void fields(TimedRules& of, Visit visit) {
  visit("driving", of.driving);
  visit("standing", of.standing);
  visit("wanted", of.wanted);
  visit("price", of.price);
  visit("slow", of.slow);
  visit("tick", of.tick);
}

struct TimedNode {
  int x, y, heading, tick;
};

struct TimedPath {
  bool found = false, stopped = false;
  double cost = 0;
  int64_t expansions = 0;
  std::vector<TimedNode> nodes;
};

class Timed {
 public:
  Timed(const TimedFloor& floor, const TimedEntities& walkers, const TimedRules& rules, std::vector<TimedMove> moves)
      : floor_(floor),
        walkers_(walkers),
        rules_(rules),
        moves_(std::move(moves)),
        from_(size_t(floor.headings)),
        to_(size_t(floor.headings)) {
    for (size_t k = 0; k < moves_.size(); ++k) {
      from_[size_t(moves_[k].heading)].push_back(k);
      to_[size_t(arrives(moves_[k]))].push_back(k);
    }
    for (int h = 0; h < floor.headings; ++h) {
      const double yaw = 6.283185307179586 * h / floor.headings;
      for (size_t k = 0; k < rules_.outline.size(); k += 3) {
        const double x = rules_.outline[k], y = rules_.outline[k + 1];
        disc_.push_back(
            {std::cos(yaw) * x - std::sin(yaw) * y, std::sin(yaw) * x + std::cos(yaw) * y, rules_.outline[k + 2]});
      }
    }
    for (size_t k = 0; k < rules_.outline.size(); k += 3) {
      reach_ = std::max(reach_, std::hypot(rules_.outline[k], rules_.outline[k + 1]) + rules_.outline[k + 2]);
    }
  }

  // Searches from a pose at tick 0 to a cell; `ending` is the price of each heading there.
  template <class Late> TimedPath path(const TimedNode& start, int x, int y, const double* ending, const Late& late) {
    TimedPath out;
    rests_ = rests();
    const bool soon = rests_ <= rules_.ticks;
    if (!flood(x, y, ending, false, &left_, late) || (soon && !flood(x, y, ending, true, &last_, late))) {
      out.stopped = true;
      return out;
    }
    const size_t n = floor_.cells(), first = floor_.index(start.x, start.y, start.heading);
    if (!(to_go(first, 0) < kNone)) return out;
    layers_.assign(size_t(rules_.ticks) + 1, {});
    layer(0)[first] = {0.0F, -1, false};
    std::priority_queue<Item> queue;
    queue.push({to_go(first, 0), first});
    double best = double(kNone);  // including the price of the final heading
    TimedNode end{};
    while (!queue.empty() && double(queue.top().total) < best) {
      const size_t state = queue.top().state;
      queue.pop();
      const int tick = int(state / n);
      const size_t at = state % n;
      Known& known = layers_[size_t(tick)][at];
      if (known.closed) continue;
      known.closed = true;
      if (++out.expansions >= kMost || (out.expansions % kClockEvery == 0 && late())) {
        out.stopped = true;
        return out;
      }
      const TimedNode node = node_of(at, tick);
      const float cost = known.cost;
      if (node.x == x && node.y == y && double(cost) + ending[node.heading] < best) {
        best = double(cost) + ending[node.heading], end = node;
      }
      for (const size_t k : from_[size_t(node.heading)]) relax(node, at, cost, k, n, &queue);
    }
    if (best < double(kNone)) {
      out.found = true, out.cost = best;
      trace(end, &out);
    }
    return out;
  }

 private:
  static constexpr float kNone = std::numeric_limits<float>::infinity();
  static constexpr int64_t kClockEvery = 1024;  // expansions between looks at the clock
  static constexpr int64_t kMost = 2'000'000;   // most expansions
  struct Known {
    float cost = kNone;
    int16_t came = -1;
    bool closed = false;
  };
  struct Item {
    float total;
    size_t state;
    // Among equal totals the later state comes first, because it is nearer to the goal.
    bool operator<(const Item& other) const { return total != other.total ? total > other.total : state < other.state; }
  };
  struct Disc {
    double x, y, r;
  };

  int arrives(const TimedMove& m) const { return (m.heading + m.turn + floor_.headings) % floor_.headings; }
  TimedNode node_of(size_t at, int tick) const {
    const size_t columns = size_t(floor_.columns), rows = size_t(floor_.rows);
    return {int(at % columns), int(at / columns % rows), int(at / columns / rows), tick};
  }
  std::vector<Known>& layer(int tick) {
    std::vector<Known>& of = layers_[size_t(tick)];
    if (of.empty()) of.resize(floor_.cells());
    return of;
  }
  // Whether a move from there is possible on the static floor.
  bool may(const TimedMove& m, int x, int y) const {
    const int tx = x + m.dx, ty = y + m.dy;
    if (!floor_.holds(tx, ty) || !floor_.holds(x, y)) return false;
    if (!(floor_.open[floor_.index(x, y, m.heading)] & 1) || !(floor_.open[floor_.index(tx, ty, arrives(m))] & 1)) {
      return false;
    }
    if (m.kind == TimedMove::kBackward) return floor_.open[floor_.index(tx, ty, m.heading)] & 2;
    if (m.kind == TimedMove::kForward || m.kind == TimedMove::kSlow) {
      return floor_.open[floor_.index(x, y, m.heading)] & 2;
    }
    return true;
  }
  double share(const TimedMove& m) const { return m.kind == TimedMove::kForward ? 1.0 : rules_.slow; }
  int faces(const TimedMove& m) const {  // the heading of travel
    return m.kind == TimedMove::kBackward ? (m.heading + floor_.headings / 2) % floor_.headings : m.heading;
  }
  bool drives(const TimedMove& m) const { return m.kind != TimedMove::kWait && m.kind != TimedMove::kTurn; }
  float still(const TimedMove& m, int x, int y) const {
    double price = m.price;
    if (floor_.rate && drives(m)) {
      price += share(m) * m.ticks * rules_.tick * double(floor_.rate[floor_.index(x, y, faces(m))]);
    }
    return float(price);
  }

  // First tick from which no entity moves.
  int rests() const {
    size_t half = 0;
    for (size_t w = 0; w < walkers_.n; ++w) {
      const double* row = walkers_.shape + 7 * w * walkers_.halves;
      const double* last = row + 7 * (walkers_.halves - 1);
      for (size_t k = walkers_.halves; k-- > half;) {
        if (!std::equal(last, last + 7, row + 7 * k)) {
          half = k + 1;
          break;
        }
      }
    }
    return int((half + 1) / 2);
  }
  // Lower bound on the cost to go; exact once no entity moves.
  float to_go(size_t at, int tick) const { return tick >= rests_ ? last_[at] : left_[at]; }

  // Cost to go of every cell and heading, without moving entities, or (`among`) with them at their final positions.
  template <class Late>
  bool flood(int x, int y, const double* ending, bool among, std::vector<float>* out, const Late& late) {
    std::vector<float>& left = *out;
    left.assign(floor_.cells(), kNone);
    std::priority_queue<Item> queue;
    for (int h = 0; h < floor_.headings; ++h) {
      const size_t at = floor_.index(x, y, h);
      if (!(floor_.open[at] & 1) || !(ending[h] < double(kNone))) continue;
      left[at] = float(ending[h]);
      queue.push({left[at], at});
    }
    int64_t expansions = 0;
    while (!queue.empty()) {
      const Item item = queue.top();
      queue.pop();
      if (item.total > left[item.state]) continue;
      if (++expansions % kClockEvery == 0 && late()) return false;
      const TimedNode node = node_of(item.state, 0);
      for (const size_t k : to_[size_t(node.heading)]) {
        const TimedMove& m = moves_[k];
        const int fx = node.x - m.dx, fy = node.y - m.dy;
        if (m.kind == TimedMove::kWait || !may(m, fx, fy)) continue;
        float total = item.total + still(m, fx, fy);
        if (among) total += float(others(m, {fx, fy, m.heading, rests_}));
        float& known = left[floor_.index(fx, fy, m.heading)];
        if (!(total < known)) continue;
        known = total;
        queue.push({total, floor_.index(fx, fy, m.heading)});
      }
    }
    return true;
  }
  void relax(const TimedNode& node, size_t at, float cost, size_t k, size_t n, std::priority_queue<Item>* queue) {
    const TimedMove& m = moves_[k];
    const int after = node.tick + m.ticks;
    if (after > rules_.ticks || !may(m, node.x, node.y)) return;
    const size_t to = m.kind == TimedMove::kWait ? at : floor_.index(node.x + m.dx, node.y + m.dy, arrives(m));
    const float go_on = to_go(to, after);
    if (!(go_on < kNone)) return;
    Known& known = layer(after)[to];
    const float least = cost + still(m, node.x, node.y);
    if (known.closed || !(least < known.cost)) return;
    const double more = others(m, node);
    const float total = least + float(more);
    if (!(total < known.cost)) return;
    known.cost = total, known.came = int16_t(k);
    queue->push({total + go_on, size_t(after) * n + to});
  }
  // Additional price of a move because of moving entities; infinite if the move is excluded.
  double others(const TimedMove& m, const TimedNode& node) const {
    const double seconds = m.ticks * rules_.tick, limit = drives(m) || m.turn ? rules_.driving : rules_.standing;
    const size_t middle = size_t(2 * node.tick + m.ticks), last = size_t(2 * (node.tick + m.ticks));
    const double mx = (node.x + 0.5 * m.dx) * floor_.width, my = (node.y + 0.5 * m.dy) * floor_.width;
    const double ex = (node.x + m.dx) * floor_.width, ey = (node.y + m.dy) * floor_.width;
    double price = 0, gap = std::numeric_limits<double>::infinity();
    for (size_t w = 0; w < walkers_.n; ++w) {
      gap = std::min({gap, clearance(w, middle, mx, my, m.heading), clearance(w, last, ex, ey, arrives(m))});
      if (gap < limit) return double(kNone);
      if (drives(m) && walkers_.classes) price += share(m) * seconds * looked_up(w, middle, mx, my, faces(m));
    }
    if (gap < rules_.wanted) price += rules_.price * seconds * (1.0 - std::max(gap, 0.0) / rules_.wanted);
    return price;
  }
  FloorShape shape(size_t w, size_t half) const {
    const double* s = walkers_.shape + 7 * (w * walkers_.halves + std::min(half, walkers_.halves - 1));
    return {0, s[0], s[1], s[2], s[3], s[4], s[5], s[6], 0, 0};
  }
  double clearance(size_t w, size_t half, double x, double y, int heading) const {
    const FloorShape who = shape(w, half);
    const double around = who.distance(x, y, 0.0) - reach_;
    if (around >= rules_.wanted) return around;
    const size_t n = disc_.size() / size_t(floor_.headings);
    double gap = std::numeric_limits<double>::infinity();
    for (size_t k = 0; k < n; ++k) {
      const Disc& d = disc_[size_t(heading) * n + k];
      gap = std::min(gap, who.distance(x + d.x, y + d.y, 0.0) - d.r);
    }
    return gap;
  }
  double looked_up(size_t w, size_t half, double x, double y, int heading) const {
    const size_t row = w * walkers_.halves + std::min(half, walkers_.halves - 1);
    const double* s = walkers_.shape + 7 * row;
    const int n = int(walkers_.places), middle = n / 2;
    const int i = int(std::lround((x - s[0]) / walkers_.apart)) + middle;
    const int j = int(std::lround((y - s[1]) / walkers_.apart)) + middle;
    if (i < 0 || j < 0 || i >= n || j >= n) return 0.0;
    const size_t of = (size_t(walkers_.velocity[row]) * size_t(floor_.headings) + size_t(heading)) * size_t(n);
    return double(walkers_.rate[(of + size_t(i)) * size_t(n) + size_t(j)]);
  }
  void trace(TimedNode node, TimedPath* out) const {
    while (true) {
      out->nodes.push_back(node);
      const int came = layers_[size_t(node.tick)][floor_.index(node.x, node.y, node.heading)].came;
      if (came < 0) break;
      const TimedMove& m = moves_[size_t(came)];
      node = {node.x - m.dx, node.y - m.dy, m.heading, node.tick - m.ticks};
    }
    std::reverse(out->nodes.begin(), out->nodes.end());
  }

  TimedFloor floor_;
  TimedEntities walkers_;
  TimedRules rules_;
  std::vector<TimedMove> moves_;
  std::vector<std::vector<size_t>> from_, to_;  // moves by the heading that they begin and end with
  std::vector<Disc> disc_;                      // for each heading
  double reach_ = 0;
  std::vector<float> left_, last_;
  int rests_ = 0;
  std::vector<std::vector<Known>> layers_;
};

}  // namespace gp::lattice

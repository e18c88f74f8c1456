// Moves between the states of a lattice over (x, y, heading). Each is the shortest curve of bounded curvature that ends
// exactly on a state (M. Pivtoraiko, R. A. Knepper, A. Kelly, "Differentially constrained mobile robot motion planning
// in state lattices", J. Field Robotics 26, 2009, with Dubins curves instead of polynomials).
#pragma once

#include <map>
#include <vector>

#include "mobile/lattice/reeds_shepp.hpp"

namespace gp::lattice {

struct Disc {
  double x, y, radius;  // [m], centre in the frame of the base
};

struct Cell {
  int x, y;  // column, row
  bool operator<(const Cell& o) const { return y != o.y ? y < o.y : x < o.x; }
  bool operator==(const Cell& o) const = default;
};

// A cell under the footprint during a move, and the required distance from its centre to the next obstacle [m].
struct Touch {
  Cell cell;
  double need;
};

// A cell and heading that the base passes, and the length driven in it [m].
struct Stay {
  Cell cell;
  int heading;
  double length;
  bool back;
};

struct Move {
  int to;                     // heading
  Cell by;                    // cells
  std::vector<Piece> pieces;  // starting at the centre of a cell
  double cost = 0.0;
  std::vector<Touch> touches = {};
  std::vector<Stay> stays = {};
  double chain = 1.0;  // length of the shortest chain of cells it passes, from centre to centre, over its cost
};

struct LatticeSettings {
  int headings;
  double resolution;  // [m]
  Steering steering;
  std::vector<Disc> discs;
  double margin;  // [m]
};

inline Cell cell_at(double x, double y, double resolution) {  // points are relative to the centre of cell (0, 0)
  return {int(std::floor(x / resolution + 0.5)), int(std::floor(y / resolution + 0.5))};
}

class Primitives {
 public:
  explicit Primitives(const LatticeSettings& settings) : s_(settings), of_(size_t(settings.headings)) {
    for (const Disc& disc : s_.discs) arm_ = std::max(arm_, std::hypot(disc.x, disc.y));
    const int quarter = s_.headings / 4;
    for (int i = 0; i < quarter; ++i) {
      for (const Move& move : forward(i)) {
        for (int k = 0; k < 4; ++k) add(i + k * quarter, move, k);
      }
    }
    for (int i = 0; i < s_.headings; ++i) {
      if (s_.steering.yaw_length < kInfinity) {
        for (const int side : {1, -1}) put(i, {turned(i + side), {0, 0}, {{0.0, 0.0, side * bin()}}});
      }
    }
  }
  const std::vector<Move>& from(int heading) const { return of_[size_t(heading)]; }
  double bin() const { return 2.0 * kPi / s_.headings; }
  double yaw(int heading) const { return bin() * heading; }
  int nearest(double yaw) const { return turned(int(std::lround(yaw / bin()))); }
  double chain() const {
    double most = 1.0;
    for (const auto& moves : of_) {
      for (const Move& move : moves) most = std::max(most, move.chain);
    }
    return most;
  }
  // Number of steps of a piece such that no point of the footprint moves by more than half a cell in one, and that
  // motion [m].
  std::pair<int, double> steps(const Piece& piece) const {
    const double bend = std::abs(piece.length * piece.curvature) + std::abs(piece.turn);
    const double way = std::abs(piece.length) + arm_ * bend;
    // An even number, so that the middle of a step is not between two headings when the piece turns by one.
    const int n = 2 * std::max(1, int(std::ceil(way / s_.resolution)));
    return {n, way / n};
  }

 private:
  int turned(int heading) const { return ((heading % s_.headings) + s_.headings) % s_.headings; }

  // Nominal arcs: straight ahead, short and long, and gentle and tight to both sides. Their curvature is at most 85 %
  // of the limit, which leaves a reserve for reaching a state. Their length allows an S-curve to shift the base by a
  // cell.
  std::vector<Move> forward(int heading) const {
    const double radius = s_.steering.radius, cell = s_.resolution;
    const double unit = std::max(4.0 * cell, std::sqrt(3.0 * radius * cell));
    std::map<std::pair<int, Cell>, Move> found;
    const auto aim = [&](double length, int side, double share) {
      const double bend = share / radius, whole = std::max(length, side ? bin() / bend : 0.0);
      if (const Move move = best(heading, whole, side * bend); !move.pieces.empty()) found[{move.to, move.by}] = move;
    };
    aim(unit, 0, 0.0), aim(3.0 * unit, 0, 0.0);
    for (const int side : {1, -1}) aim(unit, side, 0.85), aim(1.5 * unit, side, 0.4);
    std::vector<Move> moves;
    for (auto& [key, move] : found) moves.push_back(std::move(move));
    return moves;
  }
  // The move near a nominal arc with the least excess length and turning.
  Move best(int heading, double length, double curvature) const {
    const int turn = int(std::lround(curvature * length / bin()));
    const Pose start{0.0, 0.0, yaw(heading)}, tip = moved(start, {length, curvature, 0.0}, 1.0);
    const Cell near = cell_at(tip.x, tip.y, s_.resolution);
    Steering ahead = s_.steering;
    ahead.reverse = false, ahead.yaw_length = kInfinity;
    Move found;
    double least = 1.0;
    for (int dx = -2; dx <= 2; ++dx) {
      for (int dy = -2; dy <= 2; ++dy) {
        const Cell by{near.x + dx, near.y + dy};
        if (by == Cell{0, 0}) continue;
        const double angle = bin() * turn, half = 0.5 * std::abs(angle);
        const Pose end{by.x * s_.resolution, by.y * s_.resolution, yaw(heading) + angle};
        const Curve curve = ahead.shortest(start, end);
        const double arc = std::hypot(end.x, end.y) * (half > 0.0 ? half / std::sin(half) : 1.0);
        double bends = 0.0;
        for (int i = 0; i < curve.n; ++i) {
          bends += std::abs(curve.pieces[size_t(i)].length * curve.pieces[size_t(i)].curvature);
        }
        const double waste =
            curve.cost / arc - 1.0 + 0.1 * (bends - std::abs(angle)) + 0.05 * std::abs(curve.cost / length - 1.0);
        if (waste < least) {
          least = waste;
          found = {turned(heading + turn), by, {curve.pieces.begin(), curve.pieces.begin() + curve.n}};
        }
      }
    }
    return found;
  }
  // Adds a move rotated by quarter turns, and its reverse.
  void add(int heading, Move move, int quarters) {
    for (int k = 0; k < quarters; ++k) move.by = {-move.by.y, move.by.x}, move.to = turned(move.to + s_.headings / 4);
    put(heading, move);
    if (!s_.steering.reverse) return;
    Move back{heading, {-move.by.x, -move.by.y}, {move.pieces.rbegin(), move.pieces.rend()}};
    for (Piece& piece : back.pieces) piece.length = -piece.length;
    put(move.to, std::move(back));
  }
  void put(int heading, Move move) {
    Pose at{0.0, 0.0, yaw(heading)};
    std::map<Cell, double> needs;
    std::vector<Cell> passed{{0, 0}};
    for (const Piece& piece : move.pieces) {
      move.cost += s_.steering.cost(piece);
      const auto [n, step] = steps(piece);
      const double length = s_.steering.measure(piece) / n;
      for (int k = 0; k <= n; ++k) {
        const Pose pose = moved(at, piece, double(k) / n);
        touch(pose, 0.5 * step, &needs);
        if (const Cell cell = cell_at(pose.x, pose.y, s_.resolution); cell != passed.back()) passed.push_back(cell);
        if (k == n) break;
        const Pose middle = moved(at, piece, (k + 0.5) / n);
        stay({cell_at(middle.x, middle.y, s_.resolution), nearest(middle.yaw), length, piece.length < 0.0},
             &move.stays);
      }
      at = moved(at, piece, 1.0);
    }
    for (const auto& [cell, need] : needs) move.touches.push_back({cell, need});
    if (passed.back() != move.by) passed.push_back(move.by);
    move.chain = shortest_chain(passed) / move.cost;
    of_[size_t(heading)].push_back(std::move(move));
  }
  void touch(const Pose& pose, double slack, std::map<Cell, double>* needs) const {
    const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
    const auto need = [&](double x, double y, double distance) {
      const Cell cell = cell_at(x, y, s_.resolution);
      const double aside = std::hypot(x - cell.x * s_.resolution, y - cell.y * s_.resolution);
      double& most = needs->try_emplace(cell, 0.0).first->second;
      if (distance > 0.0) most = std::max(most, distance + aside + slack);
    };
    need(pose.x, pose.y, 0.0);  // the base itself stays on the map
    for (const Disc& disc : s_.discs) {
      need(pose.x + c * disc.x - s * disc.y, pose.y + s * disc.x + c * disc.y, disc.radius + s_.margin);
    }
  }
  static void stay(const Stay& next, std::vector<Stay>* stays) {
    if (!stays->empty() && stays->back().cell == next.cell && stays->back().heading == next.heading &&
        stays->back().back == next.back) {
      stays->back().length += next.length;
    } else {
      stays->push_back(next);
    }
  }
  // Length over eight neighbours [m].
  double shortest_chain(const std::vector<Cell>& passed) const {
    std::vector<double> least(passed.size(), kInfinity);
    least[0] = 0.0;
    for (size_t j = 1; j < passed.size(); ++j) {
      for (size_t i = 0; i < j; ++i) {
        const int dx = std::abs(passed[i].x - passed[j].x), dy = std::abs(passed[i].y - passed[j].y);
        if (dx <= 1 && dy <= 1) least[j] = std::min(least[j], least[i] + s_.resolution * std::sqrt(dx + dy));
      }
    }
    return least.back();
  }

  LatticeSettings s_;
  double arm_ = 0.0;
  std::vector<std::vector<Move>> of_;
};

}  // namespace gp::lattice

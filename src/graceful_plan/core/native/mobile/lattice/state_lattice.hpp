// A* over the lattice of (cell, heading), with direct curves to the goal from expanded states (D. Dolgov, S. Thrun, M.
// Montemerlo, J. Diebel, "Path planning for autonomous vehicles in unknown semi-structured environments", IJRR 29,
// 2010) and decreasing weights of the heuristic (S. Richter, J. Thayer, W. Ruml, "The joy of forgetting: faster anytime
// search via restarting", ICAPS 2010).
#pragma once

#include <chrono>
#include <memory>
#include <unordered_map>

#include "mobile/lattice/floor_field.hpp"

namespace gp::lattice {

enum class Outcome { solved, no_path, stopped, start_blocked, goal_blocked };

struct Question {
  Pose start, goal;  // in the frame of the map
  double w;
  double lead;                     // weight of an estimate, for an early first path; 0: no such search
  std::vector<double> inflations;  // weights of the lower bound, one search each; at least 1
  int shots;                       // curves to the goal: one every `shots` expansions per radius of distance; 0: none
  int64_t max_expansions;
  double time_limit;  // [s]
};

struct Answer {
  Outcome outcome = Outcome::no_path;
  std::vector<Piece> pieces;
  double cost = kInfinity, bound = kInfinity, impact = 0.0;
  int64_t expansions = 0;
  double first_cost = kInfinity;
  int64_t first_expansions = 0;
};

class StateLattice {
 public:
  StateLattice(const Floor& floor, const LatticeSettings& settings)
      : floor_(floor), s_(settings), moves_(settings), chain_(moves_.chain()) {
    close_in();
    pad();
    flatten();
    const double least = inner();
    bound_ = std::make_unique<Guide>(Guide::bound(floor_, least, s_.headings));
    lead_ = std::make_unique<Guide>(Guide::estimate(floor_, least, room(), s_.headings));
  }
  StateLattice(const StateLattice&) = delete;
  StateLattice& operator=(const StateLattice&) = delete;
  const Primitives& moves() const { return moves_; }
  double chain() const { return chain_; }

  Answer search(const Question& question) const;  // in lattice/search.hpp

 private:
  struct Flat {  // a move as indices into arrays
    int to, dx, dy, first_touch, n_touch, first_stay, n_stay, middle;
    float reach;  // distance at its middle cell that is enough for it to be free
    double cost;
  };

  // The outside of the map is an obstacle.
  void close_in() {
    within_.assign(floor_.distance, floor_.distance + size_t(floor_.rows) * size_t(floor_.columns));
    for (int y = 0; y < floor_.rows; ++y) {
      for (int x = 0; x < floor_.columns; ++x) {
        const int cells = std::min({x, y, floor_.columns - 1 - x, floor_.rows - 1 - y});
        float& distance = within_[floor_.index({x, y})];
        distance = std::min(distance, float((cells + 0.5) * s_.resolution));
      }
    }
    floor_.distance = within_.data();
  }
  void pad() {
    for (int i = 0; i < s_.headings; ++i) {
      for (const Move& move : moves_.from(i)) {
        for (const Touch& touch : move.touches) {
          pad_ = std::max({pad_, std::abs(touch.cell.x) + 1, std::abs(touch.cell.y) + 1});
        }
      }
    }
    stride_ = floor_.columns + 2 * pad_;
    padded_.assign(size_t(stride_) * size_t(floor_.rows + 2 * pad_), -1.0F);
    for (int y = 0; y < floor_.rows; ++y) {
      const float* row = floor_.distance + size_t(y) * size_t(floor_.columns);
      std::copy(row, row + floor_.columns, &padded_[size_t(padded({0, y}))]);
    }
  }
  int padded(const Cell& c) const { return (c.y + pad_) * stride_ + c.x + pad_; }
  void flatten() {
    for (int i = 0; i < s_.headings; ++i) {
      first_.push_back(int(flat_.size()));
      for (const Move& move : moves_.from(i)) {
        const Cell mid{move.by.x / 2, move.by.y / 2};
        Flat flat{move.to,
                  move.by.x,
                  move.by.y,
                  int(offset_.size()),
                  int(move.touches.size()),
                  int(stays_.size()),
                  int(move.stays.size()),
                  mid.y * stride_ + mid.x,
                  0.0F,
                  move.cost};
        for (const Touch& touch : move.touches) {
          offset_.push_back(touch.cell.y * stride_ + touch.cell.x);
          // Rounded up, so that moves that pass the check are free.
          need_.push_back(std::nextafter(float(touch.need), 1e9F));
          const double away = s_.resolution * std::hypot(touch.cell.x - mid.x, touch.cell.y - mid.y);
          flat.reach = std::max(flat.reach, float((touch.need + away) * 1.00001));
        }
        stays_.insert(stays_.end(), move.stays.begin(), move.stays.end());
        flat_.push_back(flat);
      }
    }
    first_.push_back(int(flat_.size()));
  }
  // Least distance from the centre of a free cell to the next obstacle. The footprint contains a disc around the base.
  // Its radius is the least over directions of the farthest reach of a disc of the cover.
  double inner() const {
    double least = kInfinity;
    constexpr int kDirections = 720;  // sampled directions of the outline's width
    for (int k = 0; k < kDirections; ++k) {
      const double c = std::cos(2.0 * kPi * k / kDirections), s = std::sin(2.0 * kPi * k / kDirections);
      double most = 0.0;
      for (const Disc& disc : s_.discs) {
        const double along = c * disc.x + s * disc.y, aside = c * disc.y - s * disc.x, r = disc.radius + s_.margin;
        // a disc that contains the base's origin, and so all points between
        if (std::hypot(disc.x, disc.y) < r) most = std::max(most, along + std::sqrt(r * r - aside * aside));
      }
      least = std::min(least, most);
    }
    // Between two sampled directions the border may be nearer; this is a bound.
    least *= std::cos(kPi / kDirections) * (1.0 - kPi / kDirections);
    // Distances of adjacent cells differ by at most a cell width. For fields that violate this, a laxer bound holds.
    return is_distance() ? least - 0.5 * std::sqrt(2.0) * s_.resolution - 1e-6 : lax();
  }
  // Clearance that the widest disc needs where it is checked, off the centre of its cell and between two checks.
  double room() const {
    double most = 0.0;
    for (const Disc& disc : s_.discs) most = std::max(most, disc.radius);
    return most + s_.margin + 0.75 * s_.resolution;
  }
  double lax() const {
    double inner = 0.0;
    for (const Disc& disc : s_.discs) inner = std::max(inner, disc.radius - std::hypot(disc.x, disc.y));
    return inner + s_.margin - std::sqrt(2.0) * s_.resolution;
  }
  bool is_distance() const {
    const float most = float(s_.resolution * 1.0001);
    for (int y = 0; y < floor_.rows; ++y) {
      for (int x = 0; x < floor_.columns; ++x) {
        const float here = floor_.distance[floor_.index({x, y})];
        if (x > 0 && std::abs(here - floor_.distance[floor_.index({x - 1, y})]) > most) return false;
        if (y > 0 && std::abs(here - floor_.distance[floor_.index({x, y - 1})]) > most) return false;
      }
    }
    return true;
  }

  bool free_at(const Pose& pose, double slack) const {
    const double c = std::cos(pose.yaw), s = std::sin(pose.yaw);
    if (!floor_.holds(floor_.cell(pose.x, pose.y))) return false;
    for (const Disc& disc : s_.discs) {
      const double x = pose.x + c * disc.x - s * disc.y, y = pose.y + s * disc.x + c * disc.y;
      if (floor_.clearance(x, y) < disc.radius + s_.margin + slack) return false;
    }
    return true;
  }
  bool move_free(const Cell& cell, const Flat& move) const {
    const float* at = &padded_[size_t(padded(cell))];
    if (at[move.middle] >= move.reach) return true;
    const int* offset = &offset_[size_t(move.first_touch)];
    const float* need = &need_[size_t(move.first_touch)];
    for (int k = 0; k < move.n_touch; ++k) {
      if (at[offset[k]] < need[k]) return false;
    }
    return true;
  }
  double move_impact(const Cell& cell, const Flat& move) const {
    double sum = 0.0;
    for (int k = move.first_stay; k < move.first_stay + move.n_stay; ++k) {
      const Stay& stay = stays_[size_t(k)];
      sum += stay.length * impact_at({cell.x + stay.cell.x, cell.y + stay.cell.y}, stay.heading, stay.back);
    }
    return sum;
  }
  double impact_at(const Cell& cell, int heading, bool back) const {
    return (back ? floor_.impact_back : floor_.impact)[floor_.index(cell) * size_t(s_.headings) + size_t(heading)];
  }
  // Whether a curve is free; and the integral of the impact along it.
  bool curve_free(Pose at, const Curve& curve, double* impact) const {
    *impact = 0.0;
    for (int i = 0; i < curve.n; ++i) {
      const Piece& piece = curve.pieces[size_t(i)];
      const auto [n, step] = moves_.steps(piece);
      const double length = s_.steering.measure(piece) / n;
      for (int k = 0; k < n; ++k) {
        const Pose pose = moved(at, piece, (k + 0.5) / n);  // all poses between two checks are within half a step
        if (!free_at(pose, 0.5 * step)) return false;
        if (floor_.impact)
          *impact += length * impact_at(floor_.cell(pose.x, pose.y), moves_.nearest(pose.yaw), piece.length < 0.0);
      }
      at = moved(at, piece, 1.0);
    }
    return true;
  }
  Pose pose_of(const Cell& cell, int heading) const {
    return {(cell.x + 0.5) * s_.resolution, (cell.y + 0.5) * s_.resolution, moves_.yaw(heading)};
  }

  class Search;

  Floor floor_;
  LatticeSettings s_;
  Primitives moves_;
  double chain_;
  std::unique_ptr<Guide> bound_, lead_;
  int pad_ = 1, stride_ = 0;
  std::vector<float> within_, padded_, need_;
  std::vector<Flat> flat_;
  std::vector<int> first_, offset_;
  std::vector<Stay> stays_;
};

}  // namespace gp::lattice

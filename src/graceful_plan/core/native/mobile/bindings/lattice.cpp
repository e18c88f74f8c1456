// Bindings of steering curves and the lattice over (x, y, heading).
#include "mobile/lattice/search.hpp"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "mobile/bindings/mobile.hpp"
#include "core.hpp"

using namespace nb::literals;

namespace gp {
namespace {

using lattice::Curve;
using lattice::Piece;
using lattice::Pose;
using lattice::Steering;
using Floats = Given<float>;

Pose pose_of(const double* at) { return {at[0], at[1], at[2]}; }

std::vector<double> flat(const std::vector<Piece>& pieces) {
  std::vector<double> out;
  for (const Piece& p : pieces) out.insert(out.end(), {p.length, p.curvature, p.turn});
  return out;
}

nb::tuple curves(const Steering& steering, Reals from, Reals to) {
  require(from.ndim() == 2 && from.shape(1) == 3 && to.ndim() == 2 && to.shape(0) == from.shape(0) && to.shape(1) == 3,
          "poses");
  require_numbers(from, "poses", kMaxExtent), require_numbers(to, "poses", kMaxExtent);
  const size_t n = from.shape(0);
  std::vector<double> cost(n), pieces(n * 15, 0.0);
  {
    nb::gil_scoped_release released;
    for (size_t i = 0; i < n; ++i) {
      const Curve curve = steering.shortest(pose_of(from.data() + 3 * i), pose_of(to.data() + 3 * i));
      cost[i] = curve.cost;
      for (int k = 0; k < curve.n; ++k) {
        const Piece& p = curve.pieces[size_t(k)];
        double* out = &pieces[i * 15 + size_t(k) * 3];
        out[0] = p.length, out[1] = p.curvature, out[2] = p.turn;
      }
    }
  }
  return nb::make_tuple(owned(std::move(cost), {n}), owned(std::move(pieces), {n, 5, 3}));
}

// Poses at measures s along curves (metres driven, plus yaw_length per radian turned in place).
Out<double> along(const Steering& steering, Reals from, Reals pieces, Reals s) {
  require(from.ndim() == 2 && from.shape(1) == 3 && pieces.ndim() == 3 && pieces.shape(0) == from.shape(0) &&
              pieces.shape(2) == 3 && s.ndim() == 2 && s.shape(0) == from.shape(0),
          "curves");
  require(from.ndim() == 2 && from.shape(1) == 3, "poses");
  require_numbers(from, "poses", kMaxExtent), require_numbers(pieces, "curves"), require_numbers(s, "measures");
  const size_t n = from.shape(0), n_piece = pieces.shape(1), m = s.shape(1);
  std::vector<double> out(n * m * 3);
  {
    nb::gil_scoped_release released;
    for (size_t i = 0; i < n; ++i) {
      for (size_t j = 0; j < m; ++j) {
        Pose at = pose_of(from.data() + 3 * i);
        double left = std::max(s.data()[i * m + j], 0.0);
        for (size_t k = 0; k < n_piece; ++k) {
          const double* p = pieces.data() + (i * n_piece + k) * 3;
          const Piece piece{p[0], p[1], p[2]};
          const double whole = steering.measure(piece);
          if (whole <= 0.0) continue;
          at = moved(at, piece, std::min(left / whole, 1.0));
          if (left <= whole) break;
          left -= whole;
        }
        double* to = &out[(i * m + j) * 3];
        to[0] = at.x, to[1] = at.y, to[2] = at.yaw;
      }
    }
  }
  return owned(std::move(out), {n, m, 3});
}

// A lattice together with the arrays it refers to.
class BoundLattice {
 public:
  BoundLattice(Floats distance, double resolution, Reals discs, int headings, const Steering& steering, double margin,
               std::optional<Floats> impact, std::optional<Floats> impact_back)
      : distance_(std::move(distance)),
        impact_(std::move(impact)),
        impact_back_(std::move(impact_back)),
        lattice_(floor(resolution, headings), settings(resolution, discs, headings, steering, margin)) {}

  nb::dict search(Reals start, Reals goal, double w, double lead, std::vector<double> inflations, int shots,
                  int64_t max_expansions, double time_limit) const {
    require_numbers(start, 3, "start", kMaxExtent), require_numbers(goal, 3, "goal", kMaxExtent);
    require(in_range(w, 0) && shots >= 0 && max_expansions > 0 && time_limit > 0, "settings of a search");
    require(lead == 0.0 || in_range(lead, 1), "lead");
    require(lead > 0.0 || !inflations.empty(), "inflations");
    for (double one : inflations) require(in_range(one, 1), "inflations");
    const lattice::Question question{
        pose_of(start.data()), pose_of(goal.data()), w, lead, std::move(inflations), shots, max_expansions, time_limit};
    lattice::Answer answer;
    {
      nb::gil_scoped_release released;
      answer = lattice_.search(question);
    }
    static constexpr const char* kOutcomes[] = {"SOLVED", "NO_PATH", "STOPPED", "START_BLOCKED", "GOAL_BLOCKED"};
    nb::dict out;
    out["status"] = kOutcomes[int(answer.outcome)];
    out["pieces"] = owned(flat(answer.pieces), {answer.pieces.size(), 3});
    out["cost"] = answer.cost, out["bound"] = answer.bound, out["impact"] = answer.impact;
    out["expansions"] = answer.expansions;
    out["first_cost"] = answer.first_cost, out["first_expansions"] = answer.first_expansions;
    return out;
  }
  // All moves: heading, heading after it, columns, rows, cost, and pieces.
  nb::list moves() const {
    nb::list out;
    for (int i = 0; i < headings_; ++i) {
      for (const lattice::Move& move : lattice_.moves().from(i)) {
        out.append(nb::make_tuple(i, move.to, move.by.x, move.by.y, move.cost,
                                  owned(flat(move.pieces), {move.pieces.size(), 3})));
      }
    }
    return out;
  }
  double chain() const { return lattice_.chain(); }

 private:
  lattice::Floor floor(double resolution, int headings) {
    require(distance_.ndim() == 2 && headings >= 4 && headings <= kMaxHeadings && headings % 4 == 0, "headings");
    headings_ = headings;
    const size_t rows = distance_.shape(0), columns = distance_.shape(1);
    require(rows > 0 && columns > 0 && rows * columns <= kMaxCells, "cells of a floor");
    require(in_range(resolution, 1e-3, 100), "resolution");
    for (size_t i = 0; i < distance_.size(); ++i) require(!std::isnan(distance_.data()[i]), "distance");
    for (const auto* impact : {&impact_, &impact_back_}) {
      if (!*impact) continue;
      const Floats& field = **impact;
      require(field.ndim() == 3 && field.shape(0) == rows && field.shape(1) == columns &&
                  field.shape(2) == size_t(headings),
              "impact");
      for (size_t i = 0; i < field.size(); ++i) require(in_range(field.data()[i], 0), "impact");
    }
    require(impact_ || !impact_back_, "impact");
    const float* ahead = impact_ ? impact_->data() : nullptr;
    return {int(columns), int(rows), resolution, distance_.data(), ahead, impact_back_ ? impact_back_->data() : ahead};
  }
  static lattice::LatticeSettings settings(double resolution, const Reals& discs, int headings,
                                           const Steering& steering, double margin) {
    require(discs.ndim() == 2 && discs.shape(1) == 3 && discs.shape(0) > 0, "discs");
    require_numbers(discs, "discs", kMaxReach * resolution);
    require(in_range(margin, 0, kMaxReach * resolution), "margin");
    require(steering.radius <= kMaxReach * resolution, "radius of a curve in cells");
    std::vector<lattice::Disc> all;
    for (size_t i = 0; i < discs.shape(0); ++i) {
      const double* d = discs.data() + 3 * i;
      all.push_back({d[0], d[1], d[2]});
    }
    return {headings, resolution, steering, all, margin};
  }

  static constexpr int kMaxHeadings = 720;
  static constexpr size_t kMaxCells = size_t(1) << 26;
  static constexpr double kMaxReach = 1000;  // largest size of a footprint or curve, in cells

  Floats distance_;
  std::optional<Floats> impact_, impact_back_;
  int headings_ = 0;
  lattice::StateLattice lattice_;
};

}  // namespace

void bind_lattice(nb::module_& m) {
  nb::class_<Steering>(m, "Steering")
      .def(
          "__init__",
          [](Steering* self, double radius, bool reverse, double yaw_length, double penalty) {
            require(in_range(radius, 1e-6, kMaxExtent) && yaw_length > 0 && in_range(penalty, 1), "steering");
            new (self) Steering{radius, reverse, yaw_length, penalty};
          },
          nb::kw_only(), "radius"_a, "reverse"_a, "yaw_length"_a, "penalty"_a)
      .def("curves", &curves, "start"_a, "goal"_a)
      .def("along", &along, "start"_a, "pieces"_a, "s"_a);
  nb::class_<BoundLattice>(m, "StateLattice")
      .def(
          nb::init<Floats, double, Reals, int, const Steering&, double, std::optional<Floats>, std::optional<Floats>>(),
          nb::kw_only(), "distance"_a, "resolution"_a, "discs"_a, "headings"_a, "steering"_a, "margin"_a,
          "impact"_a.none(), "impact_back"_a.none())
      .def("search", &BoundLattice::search, nb::kw_only(), "start"_a, "goal"_a, "w"_a, "lead"_a, "inflations"_a,
           "shots"_a, "max_expansions"_a, "time_limit"_a)
      .def("moves", &BoundLattice::moves)
      .def("chain", &BoundLattice::chain);
}

}  // namespace gp

// Failures that hit moving entities, with severities: their impact along a motion, and gaps to the entities.
#pragma once
#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>
#include <vector>

#include "impact/impact.hpp"

namespace gp {

constexpr double kMaxTime = 1e9;  // largest time on the clock of predictions [s]

// Rows by entity; *_start: first row of each entity, then the number of rows.
struct MovingArrays {
  Integers round;
  Reals half;  // [n, 3]
  Reals blur;  // [n, 2]: standard deviation of the initial place, and of the velocity
  Integers knot_start;
  Reals knot;  // [n, 5]: t, x, y, z, yaw
  Integers time_start;
  Reals time;  // times that represent a path if no time is known
};

// Predicted paths of moving entities.
class MovingTable {
 public:
  explicit MovingTable(const MovingArrays& of) {
    const size_t n = of.round.size();
    require_numbers(of.half, 3 * n, "sizes of moving entities", kMaxExtent);
    require_numbers(of.blur, 2 * n, "spreads of moving entities", kMaxExtent);
    const size_t knots = parts(of.knot_start, n), times = parts(of.time_start, n);
    require_numbers(of.knot, 5 * knots, "paths of moving entities", kMaxTime);
    require_numbers(of.time, times, "times of moving entities", kMaxTime);
    time_ = point(of.time);
    for (size_t k = 0; k < knots; ++k) {
      const double* row = of.knot.data() + 5 * k;
      knot_.push_back({row[0], {row[1], row[2], row[3], row[4]}, {}});
    }
    for (size_t e = 0; e < n; ++e) add(of, e);
    paths_ = {int32_t(n), entity_.data()};
  }
  MovingTable(const MovingTable&) = delete;

  const MovingPaths& paths() const { return paths_; }
  size_t size() const { return entity_.size(); }
  // Place, yaw and position uncertainty of an entity at a time.
  struct Place {
    double x, y, z, yaw, spread;
  };
  Place at(const MovingEntity& e, double t) const {
    const PathKnot *last = e.knot + e.n_knot - 1, *knot = e.knot;
    while (knot < last && knot[1].t <= t) ++knot;
    const double since = std::clamp(t, e.knot->t, last->t) - knot->t, grown = e.growth * std::max(t - e.knot->t, 0.0);
    double at[4];
    for (int i = 0; i < 4; ++i) at[i] = knot->at[i] + since * knot->rate[i];
    return {at[0], at[1], at[2], at[3], std::hypot(e.spread, grown)};
  }

 private:
  // Checks the first row of each entity; returns the number of rows.
  static size_t parts(const Integers& start, size_t n) {
    require(start.size() == n + 1 && start.data()[0] == 0, "parts of moving entities");
    for (size_t e = 0; e < n; ++e) require(start.data()[e] < start.data()[e + 1], "parts of moving entities");
    return size_t(start.data()[n]);
  }
  void add(const MovingArrays& of, size_t e) {
    const int first = of.knot_start.data()[e], last = of.knot_start.data()[e + 1] - 1;
    const int begin = of.time_start.data()[e];
    MovingEntity entity{of.round.data()[e],
                        last - first + 1,
                        of.time_start.data()[e + 1] - begin,
                        {},
                        of.blur.data()[2 * e],
                        of.blur.data()[2 * e + 1],
                        0,
                        0,
                        &knot_[size_t(first)],
                        &time_[size_t(begin)]};
    require(entity.n_time <= kMaxPairs, "number of times of a moving entity");
    require(entity.spread >= 0 && entity.growth >= 0, "spread of a moving entity");
    std::copy_n(of.half.data() + 3 * e, 3, entity.half);
    for (double half : entity.half) require(half > 0, "size of a moving entity");
    entity.lowest = knot_[size_t(first)].at[2] - entity.half[2];
    for (int k = first; k < last; ++k) {
      PathKnot &knot = knot_[size_t(k)], &next = knot_[size_t(k) + 1];
      require(next.t > knot.t, "times of a moving entity increase");
      for (int i = 0; i < 4; ++i) knot.rate[i] = (next.at[i] - knot.at[i]) / (next.t - knot.t);
      entity.lowest = std::min(entity.lowest, next.at[2] - entity.half[2]);
      entity.top_speed = std::max(entity.top_speed, std::hypot(knot.rate[0], knot.rate[1], knot.rate[2]));
    }
    entity_.push_back(entity);
  }

  std::vector<PathKnot> knot_;
  Point time_;
  std::vector<MovingEntity> entity_;
  MovingPaths paths_{};
};

// One failure mode, and P that it hits moving entities.
class MovingSource {
 public:
  virtual ~MovingSource() = default;
  // P [n, n_entity] at times or, if `t` is null, along the paths. If severities are given, P of entities without
  // severity is 0.
  virtual void probability(const States&, const double* t, const double* severity, double* out) const = 0;
  // Adds the sum of P S, with its derivatives.
  virtual void slopes(const States&, const double* t, const double* severity, const MovingSlopes&) const = 0;

  const Core& core() const { return core_; }
  const MovingTable& table() const { return table_; }

  auto probability_array(Reals q, Reals qd, std::optional<Reals> t) const {
    double* out;
    auto array = make<double>({core_.rows(q), table_.size()}, out);
    const States all = core_.states(q, qd);
    if (t) require_numbers(*t, all.n, "one time per state", kMaxTime);
    probability(all, t ? t->data() : nullptr, nullptr, out);
    return array;
  }

 protected:
  MovingSource(const Core& core, const MovingTable& table) : core_(core), table_(table) {}

  const Core& core_;
  const MovingTable& table_;
};

// The gripper drops the carried object.
class MovingDrop final : public MovingSource {
 public:
  MovingDrop(const MovingTable& table, const DropModel& model, Reals places, double cell, double protrusion)
      : MovingSource(model.core(), table), model_(model), place_(point(places)) {
    require_numbers(places, "places", kMaxNumber);
    require(places.size() >= 2 && places.size() % 2 == 0 && places.size() <= kMaxPairs, "number of places");
    require(in_range(cell, 0, 1) && in_range(protrusion, 0, kMaxExtent), "places");
    places_ = {int32_t(places.size() / 2), place_.data(), cell, protrusion};
  }
  void probability(const States& states, const double* t, const double* severity, double* out) const override {
    core_.kernels().moving_drop(core_.tables(), model_.tables(), table_.paths(), places_, severity, states, t, out);
  }
  void slopes(const States& states, const double* t, const double* severity, const MovingSlopes& out) const override {
    core_.kernels().moving_drop_gradient(core_.tables(), model_.tables(), table_.paths(), places_, severity, states, t,
                                         out);
  }

 private:
  const DropModel& model_;
  const Point place_;
  MovingPlaces places_;
};

// The arm collapses.
class MovingArm final : public MovingSource {
 public:
  MovingArm(const MovingTable& table, const Core& core) : MovingSource(core, table) {}
  void probability(const States& states, const double* t, const double* severity, double* out) const override {
    core_.kernels().moving_arm(core_.tables(), table_.paths(), severity, states, t, out);
  }
  void slopes(const States& states, const double* t, const double* severity, const MovingSlopes& out) const override {
    core_.kernels().moving_arm_gradient(core_.tables(), table_.paths(), severity, states, t, out);
  }
};

// All failure modes, with severities.
class MovingImpact {
 public:
  MovingImpact(const Core& core, const MovingTable& table) : core_(core), table_(table) {}

  void add(const MovingSource& source, Reals severity) {
    require(&source.core() == &core_ && &source.table() == &table_, "impacts of different scenes");
    require_numbers(severity, table_.size(), "severity of each moving entity");
    for (size_t e = 0; e < severity.size(); ++e) require(severity.data()[e] >= 0, "severity");
    source_.push_back(&source), severity_.push_back(point(severity));
  }
  const Core& core() const { return core_; }

  void slopes(const TimedStates& of, const TimedSlopes& out) const {
    std::fill_n(out.by_t, of.n, 0.0);
    for (size_t k = 0; k < source_.size(); ++k)
      source_[k]->slopes({of.q, of.qd, size_t(of.n)}, of.t, severity_[k].data(),
                         {out.impact, out.by_q, out.by_qd, out.by_t});
  }
  void gaps(const TimedProbes& of, const GapSlopes& out) const {
    core_.kernels().moving_gaps(core_.tables(), table_.paths(), {of.q, nullptr, size_t(of.n)}, of.t, of.wanted, out.gap,
                                out.by_q, out.by_t);
  }

  auto impact_array(Reals q, Reals qd, std::optional<Reals> t) const {
    double* out;
    auto array = make<double>({core_.rows(q)}, out);
    const States all = core_.states(q, qd);
    if (t) require_numbers(*t, all.n, "one time per state", kMaxTime);
    std::fill_n(out, all.n, 0.0);
    Point P(all.n * table_.size());
    for (size_t k = 0; k < source_.size(); ++k) {
      source_[k]->probability(all, t ? t->data() : nullptr, severity_[k].data(), P.data());
      for (size_t i = 0; i < P.size(); ++i) out[i / table_.size()] += P[i] * severity_[k][i % table_.size()];
    }
    return array;
  }
  auto slopes_array(Reals q, Reals qd, Reals t) const {
    TimedSlopes out;
    auto value = make<double>({core_.rows(q)}, out.impact), by_q = make<double>({q.shape(0), q.shape(1)}, out.by_q),
         by_qd = make<double>({q.shape(0), q.shape(1)}, out.by_qd), by_t = make<double>({q.shape(0)}, out.by_t);
    const States all = core_.states(q, qd);
    require_numbers(t, all.n, "one time per state", kMaxTime);
    std::fill_n(out.impact, all.n, 0.0), std::fill_n(out.by_q, q.size(), 0.0), std::fill_n(out.by_qd, q.size(), 0.0);
    slopes({all.q, all.qd, t.data(), int(all.n)}, out);
    return std::tuple(std::move(value), std::move(by_q), std::move(by_qd), std::move(by_t));
  }
  auto gaps_array(Reals q, Reals t, double wanted) const {
    GapSlopes out;
    auto gap = make<double>({core_.rows(q)}, out.gap), by_q = make<double>({q.shape(0), q.shape(1)}, out.by_q),
         by_t = make<double>({q.shape(0)}, out.by_t);
    require_numbers(t, q.shape(0), "one time per state", kMaxTime);
    require(!std::isnan(wanted), "wanted gap");
    gaps({q.data(), t.data(), int(q.shape(0)), wanted}, out);
    return std::tuple(std::move(gap), std::move(by_q), std::move(by_t));
  }

 private:
  const Core& core_;
  const MovingTable& table_;
  std::vector<const MovingSource*> source_;
  std::vector<Point> severity_;
};

}  // namespace gp

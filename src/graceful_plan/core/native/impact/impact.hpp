// Impact models with severities, from which native planners compute the cost of edges.
#pragma once
#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>
#include <vector>

#include "core.hpp"
#include "edge_states.hpp"
#include "named.hpp"

namespace gp {

// I of configurations at rest, and its integrals over straight edges; for one scene and fixed severities.
class Impact {
 public:
  virtual ~Impact() = default;
  virtual void states(const double* q, size_t n, double* impact) const = 0;
  // A coarser states(), for choosing which configurations to consider.
  virtual void rough_states(const double* q, size_t n, double* impact) const { states(q, n, impact); }
  virtual void edges(const Edges& edges, double* cost) const = 0;
  // A coarser, faster edges(), for searches: accurate enough to choose between paths.
  virtual void rough_edges(const Edges& edges, double* cost) const { this->edges(edges, cost); }
  // I of moving configurations; a model without velocities returns the value at rest.
  virtual void moving_states(const States& states, double* impact) const { this->states(states.q, states.n, impact); }
  virtual bool uses_velocity() const { return false; }
  // moving_states() with derivatives with respect to q and qd, by finite differences unless a model overrides it.
  // `rough`: the states follow each other along a motion; descent accuracy is enough.
  virtual void state_slopes(const States& states, bool rough, const Slopes& out) const {
    (void)rough;
    const size_t nq = size_t(core_.tables().n_joint), size = states.n * nq;
    Point moved(states.q, states.q + size), rates(states.qd, states.qd + size), impact(states.n);
    std::fill(out.d_qd, out.d_qd + size, 0.0);
    moving_states(states, out.value);
    const auto differ = [&](Point& of, size_t j, double step, double* slope) {
      for (size_t i = 0; i < states.n; ++i) of[i * nq + j] += step;
      moving_states({moved.data(), rates.data(), states.n}, impact.data());
      for (size_t i = 0; i < states.n; ++i) {
        of[i * nq + j] -= step;
        slope[i * nq + j] = (impact[i] - out.value[i]) / step;
      }
    };
    for (size_t j = 0; j < nq; ++j) differ(moved, j, kNudge, out.d_q);
    if (uses_velocity())
      for (size_t j = 0; j < nq; ++j) differ(rates, j, kNudge, out.d_qd);
  }
  // The measure that the impact of a motion is integrated over.
  virtual Measure measure() const { return Measure::kLength; }
  // Whether values come from Python, where one call for many states is much cheaper than many calls.
  virtual bool in_python() const { return false; }
  // Whether the cost V of edges() is their length. If not, motion_slopes() gives the density of V over length, at
  // states whose qd is a tangent.
  virtual bool motion_is_length() const { return true; }
  virtual void motion_slopes(const States&, const Slopes&) const {}
  // The measure of an edge that its impact is integrated over.
  virtual double exposure(const double* a, const double* b) const {
    double d2 = 0;
    for (int j = 0; j < core_.tables().n_joint; ++j) d2 += (b[j] - a[j]) * (b[j] - a[j]);
    return std::sqrt(d2);
  }
  // Whether edge_gradients() is implemented.
  virtual bool has_gradients() const { return false; }
  // edges() with the derivatives of S with respect to both ends.
  virtual void edge_gradients(const Edges&, Sampling, const EdgeSlopes&) const {}
  const Core& core() const { return core_; }

  auto states_array(Reals q) const {
    double* out;
    auto array = make<double>({core_.rows(q)}, out);
    states(q.data(), q.shape(0), out);
    return array;
  }
  auto moving_states_array(Reals q, Reals qd) const {
    double* out;
    auto array = make<double>({core_.rows(q)}, out);
    const States all = core_.states(q, qd);
    moving_states(all, out);
    return array;
  }
  // I of moving states, and its derivatives with respect to q and qd.
  auto state_slopes_array(Reals q, Reals qd, bool rough) const {
    Slopes out;
    auto values = make<double>({core_.rows(q)}, out.value);
    auto by_q = make<double>({q.shape(0), q.shape(1)}, out.d_q),
         by_qd = make<double>({q.shape(0), q.shape(1)}, out.d_qd);
    const States states = core_.states(q, qd);
    state_slopes(states, rough, out);
    return std::tuple(std::move(values), std::move(by_q), std::move(by_qd));
  }
  // V and S, and the derivatives of S with respect to q0 and q1; None if the model has none.
  std::optional<std::tuple<Array<double>, Array<double>, Array<double>>> edge_gradients_array(Reals q0, Reals q1,
                                                                                              double step) const {
    const Edges all = core_.edges(q0, q1, step);
    if (!has_gradients()) return std::nullopt;
    EdgeSlopes out;
    auto costs = make<double>({all.n, 2}, out.cost);
    auto by_q0 = make<double>({q0.shape(0), q0.shape(1)}, out.d_q0),
         by_q1 = make<double>({q0.shape(0), q0.shape(1)}, out.d_q1);
    const size_t nq = q0.shape(1);
    in_parts(all, [&](const Edges& part, size_t first) {
      edge_gradients(part, Sampling::kExact, {out.cost + 2 * first, out.d_q0 + first * nq, out.d_q1 + first * nq});
    });
    return std::tuple(std::move(costs), std::move(by_q0), std::move(by_q1));
  }
  auto edges_array(Reals q0, Reals q1, double step, bool rough) const {
    double* out;
    auto array = make<double>({core_.rows(q0), 2}, out);
    const Edges all = core_.edges(q0, q1, step);
    in_parts(all, [&](const Edges& part, size_t first) {
      rough ? rough_edges(part, out + 2 * first) : edges(part, out + 2 * first);
    });
    return array;
  }

 protected:
  static constexpr double kNudge = 1e-4;  // step of finite differences [rad or rad/s]

  explicit Impact(const Core& core) : core_(core) {}
  Impact(const Core& core, const Reals& severity) : core_(core), severity_(point(severity)) {
    require_numbers(severity, "severity");
    for (double s : severity_) require(s >= 0, "severity");
  }

  const Core& core_;
  const Point severity_;

 private:
  static constexpr double kPart = 65536;  // number of samples held at a time, unless one edge has more

  // Calls visit(edges, first) for parts of edges, which bounds the memory for samples.
  template <class Visit> void in_parts(const Edges& all, Visit visit) const {
    const size_t nq = size_t(core_.tables().n_joint);
    for (size_t first = 0, end = 0; first < all.n; first = end) {
      double samples = 0;
      for (; end < all.n && (end == first || samples < kPart); ++end) {
        double d2 = 0;
        for (size_t j = 0; j < nq; ++j) {
          const double d = all.q1[end * nq + j] - all.q0[end * nq + j];
          d2 += d * d;
        }
        samples += std::sqrt(d2) / all.step + double(core_.lanes());
      }
      visit({all.q0 + first * nq, all.q1 + first * nq, end - first, all.step}, first);
    }
  }
};

// Algorithm 1; severity is [component, entity].
class BoxOverlapImpact final : public Impact {
 public:
  BoxOverlapImpact(const Core& core, Reals severity) : Impact(core, severity) {
    require(severity.size() == size_t(core.tables().n_component * core.tables().n_entity),
            "severity is not [component, entity]");
  }
  void states(const double* q, size_t n, double* impact) const override {
    core_.kernels().impact(core_.tables(), severity_.data(), {q, nullptr, n}, impact);
  }
  void edges(const Edges& edges, double* cost) const override {
    core_.kernels().edge_costs(core_.tables(), severity_.data(), edges, cost);
  }
};

constexpr double kWide = 0.1;  // narrower half width of a top at which it stops half of the falls that one of no width
                               // would not (step 3 of the specification) [m]
// Names of constants; costs/models/drop and costs/models/spill explain them.
template <class Visit> void fields(DropConstants& of, Visit visit) {
  visit("delay", of.delay);
  visit("velocity_spread", of.velocity_spread);
  visit("height_spread", of.height_spread);
  visit("carry_spread", of.carry_spread);
  visit("side_spread", of.side_spread);
  visit("side_reach", of.side_reach);
  visit("side_height", of.side_height);
  visit("catch", of.catches);
  visit("leave_tilt", of.leave_tilt);
  visit("position_spread", of.position_spread);
  visit("size_spread", of.size_spread);
  visit("tumble_reach", of.tumble_reach);
  visit("catch_margin", of.catch_margin);
  visit("leave", of.leave);
  visit("leave_offset", of.leave_offset);
  visit("leave_narrow", of.leave_narrow);
  visit("leave_speed", of.leave_speed);
  visit("drift", of.drift);
  visit("carry", of.carry);
  visit("slide", of.slide);
  visit("topple_reach", of.topple_reach);
}
template <class Visit> void fields(SpillConstants& of, Visit visit) {
  visit("position_spread", of.position_spread);
  visit("rim_spread", of.rim_spread);
  visit("speed_spread", of.speed_spread);
  visit("height_spread", of.height_spread);
  visit("carry", of.carry);
  visit("margin", of.margin);
  visit("reach", of.reach);
  visit("run_off", of.run_off);
  visit("edge", of.edge);
  visit("slosh", of.slosh);
  visit("soft_speed", of.soft_speed);
  visit("soft_spread", of.soft_spread);
}
template <class Visit> void fields(SpillTables& of, Visit visit) {
  visit("rim", of.rim);
  visit("depth", of.depth);
  visit("full", of.full);
  visit("radius", of.radius);
  visit("power", of.power);
  visit("repose", of.repose);
}
template <class Visit> void fields(StopTables& of, Visit visit) {
  visit("amplification", of.amplification);
  visit("response", of.response);
  visit("spread", of.spread);
}

constexpr const char* kDropSeverities = "severities are not [row, entity] and one of the object itself";

// The tables of the carried object and of the surfaces it may fall on, as Python passes them.
struct DropArrays {
  int link;
  Reals centre;
  Integers part_shape;
  Reals part_offset, part_rotation, part_half;
  int main;
  double size;
  Integers target_entity;
  Reals target;  // centre (2), axis (2), half sizes (2), diagonal, half sizes that support (2), bottom, top
  Integers level_start;
  int n_entity;
  Reals speed;
  Named constants;
};

// The drop model of the carried object and, after `add_contents`, the spill model of its contents.
class DropModel {
 public:
  DropModel(const Core& core, const DropArrays& of)
      : core_(core),
        level_start_(of.level_start.data(), of.level_start.data() + of.level_start.size()),
        speed_(point(of.speed)) {
    require_numbers(of.centre, 3, "centre of the drop model", kMaxExtent);
    require_positive(of.speed, size_t(core.tables().n_joint), "speed of each joint");
    fill(tables_.constants, of.constants, "constants of the drop model");
    require(in_range(of.size, 0, kMaxExtent), "size of the carried object");
    std::copy(of.centre.data(), of.centre.data() + 3, tables_.centre);
    tables_.link = of.link, tables_.frame = core.frame(of.link), tables_.main = of.main, tables_.size = of.size;
    tables_.n_entity = of.n_entity;
    require(of.n_entity >= 0 && of.n_entity <= kMaxEntities, "number of entities");
    add_parts(of.part_shape, of.part_offset, of.part_rotation, of.part_half);
    require(of.main >= 0 && size_t(of.main) < part_.size(), "main part");
    add_surfaces(of.target_entity, of.target);
    check_levels();
    tables_.n_part = int(part_.size()), tables_.n_surface = int(surface_.size()),
    tables_.n_level = int(level_start_.size()) - 1;
    tables_.part = part_.data(), tables_.surface = surface_.data(), tables_.level_start = level_start_.data();
    tables_.speed = speed_.data();
  }
  DropModel(const DropModel&) = delete;

  // mouth, axis: in the axes of the link, see SpillTables; container: its other numbers; constants: of contents after a
  // drop, and of contents in the gripper.
  void add_contents(Reals mouth, Reals axis, const Named& container, Integers stands, Reals visible,
                    const std::vector<Named>& constants) {
    const size_t n = surface_.size();
    require(!tables_.spill.surface && spill_.empty() && stands.size() == 2 * n, "tables of the spill model");
    require_numbers(mouth, 3, "mouth of the container"), require_numbers(axis, 3, "axis of the container");
    require_numbers(visible, n, "visible shares of surfaces");
    require(constants.size() == kSpillUses, "constants of the spill model");
    SpillTables& spill = tables_.spill;
    fill(spill, container, "container");
    std::copy_n(mouth.data(), 3, spill.mouth), std::copy_n(axis.data(), 3, spill.axis);
    require(spill.rim > 0 && spill.depth > 0 && spill.full > 0 && spill.radius > 0, "container");
    for (size_t k = 0; k < n; ++k) {
      const SpillSurface s{stands.data()[2 * k], stands.data()[2 * k + 1], visible.data()[k]};
      require(s.first >= 0 && s.first <= s.end && s.end <= tables_.n_level, "levels that a surface stands on");
      spill_.push_back(s);
    }
    for (size_t use = 0; use < kSpillUses; ++use) fill(spill.use[use], constants[use], "constants of the spill model");
    spill.surface = spill_.data();  // null if there is nothing to land on
  }

  // deceleration: of each joint in a protective stop; places: for the places where thrown-out contents land
  void add_stop(Reals deceleration, const Named& constants, const Named& places) {
    const size_t nq = size_t(core_.tables().n_joint);
    require_positive(deceleration, nq, "deceleration of a joint");
    StopTables& stop = tables_.stop;
    fill(stop, constants, "constants of stops"), fill(stop.places, places, "spill constants of stops");
    require(stop.amplification >= 0 && stop.response > 0 && stop.spread > 0, "constants of stops");
    for (size_t j = 0; j < nq; ++j) stop.slowness[j] = 1.0 / deceleration.data()[j];
  }

  // strength: per surface; the others as in LossTables
  void add_loss(Reals strength, double sharpness, Reals shift, Reals weight) {
    require_numbers(strength, surface_.size(), "strength of surfaces");
    require_numbers(shift, 2, "own-loss constants of the carried object");
    require_numbers(weight, 2, "own-loss constants of the carried object");
    for (size_t k = 0; k < surface_.size(); ++k) surface_[k].strength = strength.data()[k];
    LossTables& loss = tables_.loss;
    loss.sharpness = sharpness;
    std::copy_n(shift.data(), 2, loss.shift), std::copy_n(weight.data(), 2, loss.weight);
    require(in_range(sharpness, 0) && sharpness > 0, "sharpness of damage");
  }

  // entity: rows of top, strength and sharpness
  void add_damage(Reals entity, double loss) {
    require_numbers(entity, 3 * size_t(tables_.n_entity), "fragilities of entities");
    require(fragility_.empty() && in_range(loss, 0) && loss > 0, "damage to entities");
    for (size_t e = 0; e < size_t(tables_.n_entity); ++e) {
      const double* row = entity.data() + 3 * e;
      fragility_.push_back({row[0], row[1], row[2]});
      require(fragility_.back().sharpness > 0, "sharpness of damage");
    }
    tables_.damage = {fragility_.data(), loss};
  }

  // weights: in the order of DropNetwork, biases of each surface last
  void add_network(int hidden, double bound, Reals weights) {
    require(hidden >= 1 && hidden <= kMaxHidden, "hidden units of a network");
    require(in_range(bound, 0, 30), "bound of a network");
    const size_t h = size_t(hidden), n = h * (kNetworkInputs + h + 2 + surface_.size()) + 1;
    require_numbers(weights, n, "weights of a network");
    weights_ = point(weights);
    rough_weights_.assign(weights_.begin(), weights_.end());
    tables_.network = {hidden, bound, weights_.data(), rough_weights_.data()};
  }

  const Core& core() const { return core_; }
  const DropTables& tables() const { return tables_; }

  // Inputs of the network for each surface, and the P it corrects; zero where severities are zero.
  auto sights(Reals q, Reals qd) const {
    double* out;
    const size_t row = surface_.size() * size_t(kNetworkInputs + 1);
    auto array = make<double>({core_.rows(q), surface_.size(), size_t(kNetworkInputs + 1)}, out);
    const States states = core_.states(q, qd);
    std::fill(out, out + states.n * row, 0.0);
    core_.kernels().drop_sights(core_.tables(), tables_, states, out);
    return array;
  }
  // P by row and entity, then P that the object itself is damaged.
  auto probability(Reals q, Reals qd) const {
    double* out;
    auto array = make<double>({core_.rows(q), size_t(kDropRows * tables_.n_entity + 1)}, out);
    const States states = core_.states(q, qd);
    core_.kernels().drop(core_.tables(), tables_, states, out);
    return array;
  }
  auto impact(Reals severity, Reals q, Reals qd) const {
    double* out;
    auto array = make<double>({core_.rows(q)}, out);
    require_numbers(severity, size_t(kDropRows * tables_.n_entity + 1), kDropSeverities);
    const States states = core_.states(q, qd);
    core_.kernels().drop_impact(core_.tables(), tables_, severity.data(), states, out);
    return array;
  }
  // The impact, and its derivatives with respect to q and qd.
  auto gradient(Reals severity, Reals q, Reals qd, bool rough) const {
    Slopes out;
    auto values = make<double>({core_.rows(q)}, out.value);
    auto by_q = make<double>({q.shape(0), q.shape(1)}, out.d_q),
         by_qd = make<double>({q.shape(0), q.shape(1)}, out.d_qd);
    require_numbers(severity, size_t(kDropRows * tables_.n_entity + 1), kDropSeverities);
    const States states = core_.states(q, qd);
    const auto compute = rough ? core_.kernels().rough_drop_gradient : core_.kernels().drop_gradient;
    compute(core_.tables(), tables_, severity.data(), states, out);
    return std::tuple(std::move(values), std::move(by_q), std::move(by_qd));
  }

 private:
  void add_parts(const Integers& shape, const Reals& offset, const Reals& rotation, const Reals& half) {
    const size_t n = shape.size();
    require(n >= 1 && n <= size_t(kMaxDropParts), "number of carried parts");
    require_numbers(offset, 3 * n, "offsets of carried parts", kMaxExtent);
    require_numbers(rotation, 9 * n, "rotations of carried parts", kMaxExtent);
    require_numbers(half, 3 * n, "half sizes of carried parts", kMaxExtent);
    for (size_t p = 0; p < n; ++p) {
      DropPart part{};
      part.shape = shape.data()[p];
      require(part.shape >= kFlat && part.shape <= kBall, "shape of a carried part");
      std::copy(rotation.data() + 9 * p, rotation.data() + 9 * p + 9, part.R);
      double offset2 = 0, half2 = 0;
      for (size_t i = 0; i < 3; ++i) {
        part.offset[i] = offset.data()[3 * p + i], part.half[i] = half.data()[3 * p + i];
        offset2 += part.offset[i] * part.offset[i], half2 += part.half[i] * part.half[i];
      }
      tables_.radius = std::max(tables_.radius, std::sqrt(offset2) + std::sqrt(half2));
      part_.push_back(part);
    }
  }
  void add_surfaces(const Integers& entity, const Reals& target) {
    const size_t n = entity.size();
    require(n <= size_t(kMaxSurfaces), "number of surfaces");
    require_numbers(target, 12 * n, "surfaces", 2 * kMaxExtent);
    for (size_t k = 0; k < n; ++k) {
      const double* t = target.data() + 12 * k;
      Surface s{};
      s.entity = entity.data()[k];
      require(s.entity >= -1 && s.entity < tables_.n_entity, "entity of a surface");
      s.diagonal = t[6], s.bottom = t[9], s.top = t[10], s.fixed = t[11] > 0;
      for (int i = 0; i < 2; ++i)
        s.centre[i] = t[i], s.axis[i] = t[2 + i], s.half[i] = t[4 + i], s.carries[i] = t[7 + i];
      s.turn = int(k);
      for (const Surface& other : surface_)
        if (other.axis[0] == s.axis[0] && other.axis[1] == s.axis[1]) s.turn = other.turn;
      for (int i = 0; i < 2; ++i) {
        const double margin = s.carries[i] + tables_.constants.catch_margin * tables_.size;
        s.bound[i] = std::abs(s.axis[i]) * s.half[0] + std::abs(s.axis[1 - i]) * s.half[1];
        s.reached[i] = s.half[i] + tables_.constants.tumble_reach * tables_.size;
        s.inside[i] = 0.5 * (margin + std::sqrt(margin * margin + 1e-4));
        s.near[i] = std::max(s.reached[i], s.inside[i]);
      }
      const double wide = std::min(s.carries[0], s.carries[1]), wide2 = wide * wide;
      s.catches = tables_.constants.catches;
      s.catches += (1.0 - s.catches) * wide2 / (wide2 + kWide * kWide);
      s.holds = std::min(s.carries[0], s.carries[1]) > tables_.size;
      require(surface_.empty() || s.top <= surface_.back().top, "surfaces ordered by height");
      surface_.push_back(s);
    }
  }
  void check_levels() const {
    require(!level_start_.empty() && level_start_.front() == 0 && size_t(level_start_.back()) == surface_.size(),
            "levels");
    for (size_t l = 0; l + 1 < level_start_.size(); ++l) require(level_start_[l] < level_start_[l + 1], "empty level");
  }

  const Core& core_;
  DropTables tables_{};
  std::vector<DropPart> part_;
  std::vector<Surface> surface_;
  std::vector<SpillSurface> spill_;
  std::vector<int32_t> level_start_;
  std::vector<Fragility> fragility_;
  Point speed_, weights_;
  std::vector<float> rough_weights_;
};

// The drop and spill models with a severity per row and entity; edges are travelled at their pace.
class DropImpact final : public Impact {
 public:
  DropImpact(const DropModel& model, Reals severity, double slow, double fast)
      : Impact(model.core(), severity), model_(model), pace_{slow, fast} {
    require(severity.size() == size_t(kDropRows * model.tables().n_entity + 1), kDropSeverities);
    require(slow >= 0 && fast >= slow && fast < 1e9, "pace");
  }
  void states(const double* q, size_t n, double* impact) const override {
    core_.kernels().drop_impact(core_.tables(), model_.tables(), severity_.data(), {q, nullptr, n}, impact);
  }
  void rough_states(const double* q, size_t n, double* impact) const override {
    core_.kernels().rough_drop_impact(core_.tables(), model_.tables(), severity_.data(), {q, nullptr, n}, impact);
  }
  void moving_states(const States& states, double* impact) const override {
    core_.kernels().drop_impact(core_.tables(), model_.tables(), severity_.data(), states, impact);
  }
  bool uses_velocity() const override { return true; }
  void state_slopes(const States& states, bool rough, const Slopes& out) const override {
    const auto gradient = rough ? core_.kernels().rough_drop_gradient : core_.kernels().drop_gradient;
    gradient(core_.tables(), model_.tables(), severity_.data(), states, out);
  }
  void edges(const Edges& edges, double* cost) const override {
    core_.kernels().drop_edge_costs(core_.tables(), model_.tables(), severity_.data(), pace_, edges, cost);
  }
  bool has_gradients() const override { return true; }
  void edge_gradients(const Edges& edges, Sampling sampling, const EdgeSlopes& out) const override {
    EdgeStates sampled(core_, model_.tables().speed, pace_, edges, sampling);
    const auto gradient =
        sampling == Sampling::kExact ? core_.kernels().drop_gradient : core_.kernels().rough_drop_gradient;
    gradient(core_.tables(), model_.tables(), severity_.data(), sampled.states(), sampled.slopes());
    sampled.integrate(out);
  }

 private:
  const DropModel& model_;
  const double pace_[2];  // shares of the joints' speeds
};

// The sum of two models.
class SumImpact final : public Impact {
 public:
  SumImpact(const Impact& first, const Impact& second) : Impact(first.core()), first_(first), second_(second) {
    require(&first.core() == &second.core(), "impacts of different scenes");
  }
  void states(const double* q, size_t n, double* impact) const override {
    Point other(n);
    first_.states(q, n, impact), second_.states(q, n, other.data());
    for (size_t i = 0; i < n; ++i) impact[i] += other[i];
  }
  void rough_states(const double* q, size_t n, double* impact) const override {
    Point other(n);
    first_.rough_states(q, n, impact), second_.rough_states(q, n, other.data());
    for (size_t i = 0; i < n; ++i) impact[i] += other[i];
  }
  void moving_states(const States& states, double* impact) const override {
    Point other(states.n);
    first_.moving_states(states, impact), second_.moving_states(states, other.data());
    for (size_t i = 0; i < states.n; ++i) impact[i] += other[i];
  }
  bool uses_velocity() const override { return first_.uses_velocity() || second_.uses_velocity(); }
  void state_slopes(const States& states, bool rough, const Slopes& out) const override {
    const size_t size = states.n * size_t(core_.tables().n_joint);
    Point other(states.n), other_q(size), other_qd(size);
    first_.state_slopes(states, rough, out),
        second_.state_slopes(states, rough, {other.data(), other_q.data(), other_qd.data()});
    for (size_t i = 0; i < states.n; ++i) out.value[i] += other[i];
    for (size_t i = 0; i < size; ++i) out.d_q[i] += other_q[i], out.d_qd[i] += other_qd[i];
  }
  void edges(const Edges& edges, double* cost) const override {
    Point other(2 * edges.n);
    first_.edges(edges, cost), second_.edges(edges, other.data());
    for (size_t i = 0; i < edges.n; ++i) cost[2 * i + 1] += other[2 * i + 1];  // the length is the same
  }
  void rough_edges(const Edges& edges, double* cost) const override {
    Point other(2 * edges.n);
    first_.rough_edges(edges, cost), second_.rough_edges(edges, other.data());
    for (size_t i = 0; i < edges.n; ++i) cost[2 * i + 1] += other[2 * i + 1];
  }
  bool has_gradients() const override { return first_.has_gradients() && second_.has_gradients(); }
  void edge_gradients(const Edges& edges, Sampling sampling, const EdgeSlopes& out) const override {
    const size_t size = edges.n * size_t(core_.tables().n_joint);
    Point other(2 * edges.n), other_q0(size), other_q1(size);
    first_.edge_gradients(edges, sampling, out);
    second_.edge_gradients(edges, sampling, {other.data(), other_q0.data(), other_q1.data()});
    for (size_t i = 0; i < edges.n; ++i) out.cost[2 * i + 1] += other[2 * i + 1];
    for (size_t i = 0; i < size; ++i) out.d_q0[i] += other_q0[i], out.d_q1[i] += other_q1[i];
  }

 private:
  const Impact &first_, &second_;
};

// A model whose edges are integrated over time instead of length: T = max_j |q1_j - q0_j| / speed_j, with the expected
// speeds of the joints.
class TimedImpact final : public Impact {
 public:
  TimedImpact(const Impact& model, const Reals& speed) : Impact(model.core()), model_(model), speed_(point(speed)) {
    require_positive(speed, size_t(core_.tables().n_joint), "speed");
  }
  Measure measure() const override { return Measure::kTime; }
  void states(const double* q, size_t n, double* impact) const override { model_.states(q, n, impact); }
  void rough_states(const double* q, size_t n, double* impact) const override { model_.rough_states(q, n, impact); }
  void moving_states(const States& states, double* impact) const override { model_.moving_states(states, impact); }
  bool uses_velocity() const override { return model_.uses_velocity(); }
  void state_slopes(const States& states, bool rough, const Slopes& out) const override {
    model_.state_slopes(states, rough, out);
  }
  double exposure(const double* a, const double* b) const override { return slowest(a, b).seconds; }
  void edges(const Edges& edges, double* cost) const override { model_.edges(edges, cost), time(edges, cost); }
  void rough_edges(const Edges& edges, double* cost) const override {
    model_.rough_edges(edges, cost), time(edges, cost);
  }
  bool has_gradients() const override { return model_.has_gradients(); }
  void edge_gradients(const Edges& edges, Sampling sampling, const EdgeSlopes& out) const override {
    const size_t nq = speed_.size();
    model_.edge_gradients(edges, sampling, out);
    for (size_t e = 0; e < edges.n; ++e) {
      const double *a = edges.q0 + e * nq, *b = edges.q1 + e * nq, length = out.cost[2 * e];
      if (!(length > 0)) continue;
      const Slowest by = slowest(a, b);
      const double ratio = by.seconds / length, sum = out.cost[2 * e + 1];
      for (size_t j = 0; j < nq; ++j) {
        double turn = -ratio / (length * length) * (b[j] - a[j]);
        if (j == by.joint) turn += (b[j] < a[j] ? -1.0 : 1.0) / (speed_[j] * length);
        out.d_q0[e * nq + j] = ratio * out.d_q0[e * nq + j] - sum * turn;
        out.d_q1[e * nq + j] = ratio * out.d_q1[e * nq + j] + sum * turn;
      }
      out.cost[2 * e + 1] *= ratio;
    }
  }

 private:
  struct Slowest {
    double seconds;
    size_t joint;
  };
  void time(const Edges& edges, double* cost) const {
    const size_t nq = speed_.size();
    for (size_t e = 0; e < edges.n; ++e)
      if (cost[2 * e] > 0) cost[2 * e + 1] *= exposure(edges.q0 + e * nq, edges.q1 + e * nq) / cost[2 * e];
  }
  Slowest slowest(const double* a, const double* b) const {
    Slowest by{0, 0};
    for (size_t j = 0; j < speed_.size(); ++j)
      if (const double seconds = std::abs(b[j] - a[j]) / speed_[j]; seconds > by.seconds) by = {seconds, j};
    return by;
  }

  const Impact& model_;
  const Point speed_;
};

}  // namespace gp

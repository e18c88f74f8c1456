// The tables of the body model from Python, and the impact model for native planners.
#pragma once
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "impact/impact.hpp"
#include "named.hpp"

namespace gp {

// Names of constants; costs/models/body explains them.
template <class Visit> void fields(BodyConstants& of, Visit visit) {
  constexpr const char* kModes[kGenerators] = {"collapse", "joint", "stuck", "stray"};
  constexpr const char* kRows[2] = {"body", "carried"};
  visit("brake_time", of.brake_time);
  visit("brake_stop", of.brake_stop);
  visit("step", of.step);
  visit("carry_on", of.carry_on);
  for (int g = 0; g < kGenerators; ++g) {
    const std::string mode = std::string(kModes[g]) + ".";
    visit(mode + "stop_gain", of.stop_gain[g]);
    visit(mode + "stop_tolerance", of.stop_tolerance[g]);
    for (int r = 0; r < 2; ++r) {
      visit(mode + kRows[r] + ".offset", of.offset[g][r]);
      visit(mode + kRows[r] + ".spread", of.spread[g][r]);
    }
  }
}

constexpr int kFallSteps = 5;  // steps of a collapse, see costs/models/body

// Shortcuts for searches and descents, where most states are evaluated. They take a tenth of the time and change sums
// along motions little (tests/costs/models/test_body_searches.py bounds the error).
constexpr double kRoughShare = 3e-4;   // hits below this share of the worst possible are neglected
constexpr double kLeastTail = 3.4e-4;  // 1/(1 + e^8): the tail at U = 8, see costs/models/body
constexpr double kRoughPiece = 0.2;    // length of the pieces of edges [rad], sampled at both paces: 10 samples per
                                       // radian
constexpr size_t kRoughLooks = 32;     // most states evaluated along a motion in a descent

// The tables of the body model, as Python passes them.
struct BodyArrays {
  Reals inertia;  // per frame: mass, centre (3), inertia about it (9)
  Reals drive;    // per joint: limits (2), armature, damping, friction, resistance, speed
  Integers row, entity;
  int n_row, n_entity, n_step;
  Named constants;
};

// Hits by links and the carried object.
class BodyModel {
 public:
  BodyModel(const Core& core, const BodyArrays& of)
      : core_(core), entity_(of.entity.data(), of.entity.data() + of.entity.size()) {
    const Tables& t = core.tables();
    const auto& [inertia, drive, row, entity, n_row, n_entity, n_step, constants] = of;
    fill(tables_.constants, constants, "constants of the body model");
    for (const auto& spreads : tables_.constants.spread)
      for (double spread : spreads) require(spread > 0, "spread");
    require(n_row >= 1 && n_row <= 2 && n_entity >= 0 && n_entity <= kMaxEntities, "rows and entities");
    require(t.n_obstacle <= kMaxObstacles, "obstacles of the body model");
    require(n_step >= 0 && n_step <= kMaxSteps && tables_.constants.step > 0, "steps");
    require(row.size() == size_t(t.n_group), "rows of groups");
    require(entity_.size() == size_t(t.n_obstacle), "entities of obstacles");
    for (int32_t e : entity_) require(e >= -1 && e < n_entity, "entity of an obstacle");
    add_inertia(inertia);
    add_drives(drive);
    tables_.n_frame = int(inertia_.size()), tables_.n_row = n_row, tables_.n_entity = n_entity, tables_.n_step = n_step,
    tables_.n_fall = kFallSteps;
    add_limbs(row.data());
    tables_.inertia = inertia_.data(), tables_.drive = drive_.data(), tables_.entity = entity_.data();
    tables_.limb = limb_.data(), tables_.n_limb = int(limb_.size());
    rough_ = tables_;
    rough_.looked_at = (n_step < 64 ? uint64_t(1) << n_step : 0) | uint64_t(1) << (3 * n_step + 4) / 5;
  }
  BodyModel(const BodyModel&) = delete;

  const Core& core() const { return core_; }
  const BodyTables& tables() const { return tables_; }
  // Tables that check falls only at three fifths and at their end.
  const BodyTables& rough_tables() const { return rough_; }
  const double* speed() const { return speed_.data(); }
  size_t modes() const { return 2 * drive_.size() + 2; }

  void check(const Reals& weight, const Reals& severity) const {
    require_numbers(weight, modes() * size_t(tables_.n_row), "weight is not [mode, row]");
    require_numbers(severity, size_t(tables_.n_row) * size_t(tables_.n_entity), "severity is not [row, entity]");
  }

  // Least distances in each failure mode. ahead: configurations after 1, 2, .. steps, or None if only the velocity is
  // known.
  auto distances(Reals q, Reals qd, std::optional<Reals> ahead) const {
    double* out;
    auto array = make<double>({core_.rows(q), modes(), size_t(tables_.n_row), size_t(tables_.n_entity)}, out);
    const States states = core_.states(q, qd);
    BodyTables tables = tables_;
    if (ahead) {
      require(ahead->ndim() == 3 && ahead->shape(0) == q.shape(0) && ahead->shape(2) == q.shape(1) &&
                  ahead->shape(1) <= kMaxSteps,
              "ahead is not [n, step, nq]");
      require_numbers(*ahead, "ahead", kMaxPosition);
      tables.n_reference = int(ahead->shape(1));
    }
    const double* known = ahead ? ahead->data() : nullptr;
    core_.kernels().body(core_.tables(), tables, states, known, out);
    return array;
  }
  auto impact(Reals weight, Reals severity, Reals q, Reals qd) const {
    double* out;
    auto array = make<double>({core_.rows(q)}, out);
    check(weight, severity);
    const States states = core_.states(q, qd);
    core_.kernels().body_impact(core_.tables(), tables_, {weight.data(), severity.data(), nullptr}, states, out);
    return array;
  }
  // Impact and its derivatives with respect to q and qd.
  auto gradient(Reals weight, Reals severity, Reals q, Reals qd) const {
    Slopes out;
    check(weight, severity);
    const States states = core_.states(q, qd);
    const size_t n = q.shape(0), nq = q.shape(1);
    auto values = make<double>({n}, out.value);
    auto by_q = make<double>({n, nq}, out.d_q), by_qd = make<double>({n, nq}, out.d_qd);
    core_.kernels().body_gradient(core_.tables(), tables_, {weight.data(), severity.data(), nullptr}, states, out);
    return std::tuple(std::move(values), std::move(by_q), std::move(by_qd));
  }
  // Tails that neglect hits worth less than a share of the worst possible.
  std::vector<Tail> tails(const Point& weight, const Point& severity, double share) const {
    const size_t nq = drive_.size(), n_row = size_t(tables_.n_row), n_entity = size_t(tables_.n_entity);
    std::vector<Tail> tails;
    std::vector<double> worth;
    for (size_t g = 0; g < kGenerators; ++g)
      for (size_t r = 0; r < n_row; ++r) {
        const size_t first = g == kCollapse ? 0 : g == kJoint ? 1 : g == kStuck ? 1 + nq : 1 + 2 * nq;
        double most = 0;
        for (size_t m = first; m < first + (g == kJoint || g == kStuck ? nq : 1); ++m)
          most = std::max(most, weight[m * n_row + r]);
        for (size_t e = 0; e < n_entity; ++e) worth.push_back(most * severity[r * n_entity + e]);
      }
    const double least = worth.empty() ? 0.0 : share * *std::max_element(worth.begin(), worth.end());
    for (const double w : worth) {
      const double p = std::max(w > 0 ? least / w : 1.0, kLeastTail);
      tails.push_back(p < 0.5 ? Tail{std::log(1 / p - 1), p} : Tail{-1, 0});
    }
    return tails;
  }
  // Mass matrix and gravity torques.
  auto dynamics(Reals q) const {
    double *mass_matrix, *gravity;
    auto first = make<double>({core_.rows(q), q.shape(1), q.shape(1)}, mass_matrix);
    auto second = make<double>({q.shape(0), q.shape(1)}, gravity);
    core_.kernels().body_dynamics(core_.tables(), tables_, core_.states(q), mass_matrix, gravity);
    return std::tuple(std::move(first), std::move(second));
  }

 private:
  void add_inertia(const Reals& rows) {
    require_numbers(rows, 13 * (size_t(core_.tables().n_joint) + 1), "inertia of frames");
    for (size_t l = 0; l < rows.size() / 13; ++l) {
      const double* row = rows.data() + 13 * l;
      Inertia rigid{};
      rigid.mass = row[0];
      std::copy(row + 1, row + 4, rigid.centre);
      std::copy(row + 4, row + 13, rigid.inertia);
      require(core_.frame(int(l)) == int(l), "links that own a frame are not first");
      inertia_.push_back(rigid);
    }
  }
  void add_drives(const Reals& rows) {
    const Tables& t = core_.tables();
    require_numbers(rows, 7 * size_t(t.n_joint), "drives");
    for (int j = 0; j < t.n_joint; ++j) {
      const double* row = rows.data() + 7 * j;
      JointDrive drive{-1, row[0], row[1], row[2], row[3], row[4], row[5], row[6]};
      for (int l = 0; l <= t.n_joint && l < t.n_link; ++l)
        if (t.link[l].joint == j) drive.link = l;
      require(drive.link >= 0 && drive.lower <= drive.upper && drive.speed > 0, "drive");
      drive_.push_back(drive), speed_.push_back(drive.speed);
    }
  }

  // Merges neighbouring groups of a row on one frame into a limb if they may touch the same obstacles.
  void add_limbs(const int32_t* row) {
    const Tables& t = core_.tables();
    const auto alike = [&t](int a, int b) {
      for (int j = 0; j < t.n_obstacle; ++j)
        if ((t.obstacle[j].ignores >> a ^ t.obstacle[j].ignores >> b) & 1) return false;
      return true;
    };
    for (int g = 0; g < t.n_group; ++g) {
      const Group& group = t.group[g];
      require(row[g] >= -1 && row[g] < tables_.n_row, "row of a group");
      if (row[g] < 0) continue;
      Limb* last = limb_.empty() ? nullptr : &limb_.back();
      if (last && last->frame == group.frame && last->row == row[g] && last->first + last->count == group.first &&
          alike(last->link, group.link))
        last->count += group.count, last->n_cluster += group.n_cluster;
      else
        limb_.push_back({group.frame,
                         row[g],
                         group.link,
                         group.first,
                         group.count,
                         group.first_cluster,
                         group.n_cluster,
                         {},
                         {},
                         0,
                         0});
    }
    for (Limb& limb : limb_) enclose(t.sphere, limb);
    std::stable_sort(limb_.begin(), limb_.end(), [](const Limb& a, const Limb& b) { return a.frame > b.frame; });
  }
  static void enclose(const float* sphere, Limb& limb) {
    for (int i = 0; i < 3; ++i) {
      float low = sphere[4 * limb.first + i], high = low;
      for (int k = limb.first; k < limb.first + limb.count; ++k)
        low = std::min(low, sphere[4 * k + i]), high = std::max(high, sphere[4 * k + i]);
      limb.centre[i] = 0.5f * (low + high), limb.half[i] = 0.5f * (high - low) + 1e-6f;
    }
    for (int k = limb.first; k < limb.first + limb.count; ++k) {
      const float* s = sphere + 4 * k;
      float d2 = 0;
      for (int i = 0; i < 3; ++i) d2 += (s[i] - limb.centre[i]) * (s[i] - limb.centre[i]);
      limb.radius = std::max(limb.radius, s[3]);
      limb.bound = std::max(limb.bound, std::sqrt(d2) * (1 + 1e-6f) + s[3]);
    }
  }

  const Core& core_;
  BodyTables tables_{}, rough_{};
  std::vector<Inertia> inertia_;
  std::vector<JointDrive> drive_;
  Point speed_;  // per joint
  std::vector<Limb> limb_;
  std::vector<int32_t> entity_;
};

// The body model with weights of its failure modes and severities; edges are travelled at their pace.
class BodyImpact final : public Impact {
 public:
  BodyImpact(const BodyModel& model, Reals weight, Reals severity, double slow, double fast)
      : Impact(model.core(), severity), model_(model), weight_(point(weight)), pace_{slow, fast} {
    model.check(weight, severity);
    require(slow >= 0 && fast >= slow && fast < 1e9, "pace");
    tail_ = model.tails(weight_, severity_, kRoughShare);
  }
  void states(const double* q, size_t n, double* impact) const override {
    core_.kernels().body_impact(core_.tables(), model_.tables(), harm(), {q, nullptr, n}, impact);
  }
  void rough_states(const double* q, size_t n, double* impact) const override {
    core_.kernels().body_impact(core_.tables(), model_.rough_tables(), rough_harm(), {q, nullptr, n}, impact);
  }
  void moving_states(const States& states, double* impact) const override {
    core_.kernels().body_impact(core_.tables(), model_.tables(), harm(), states, impact);
  }
  bool uses_velocity() const override { return true; }
  void state_slopes(const States& states, bool rough, const Slopes& out) const override {
    if (rough) return rough_slopes(states, out);
    core_.kernels().body_gradient(core_.tables(), model_.tables(), harm(), states, out);
  }
  void edges(const Edges& edges, double* cost) const override {
    EdgeStates sampled(core_, model_.speed(), pace_, edges, Sampling::kExact);
    core_.kernels().body_impact(core_.tables(), model_.tables(), harm(), sampled.states(), sampled.impact.data());
    Point slopes(2 * edges.n * size_t(core_.tables().n_joint));
    sampled.integrate({cost, slopes.data(), slopes.data() + slopes.size() / 2});
  }
  void rough_edges(const Edges& of, double* cost) const override {
    EdgeStates sampled(core_, model_.speed(), pace_, {of.q0, of.q1, of.n, kRoughPiece}, Sampling::kBoth);
    core_.kernels().body_impact(core_.tables(), model_.rough_tables(), rough_harm(), sampled.states(),
                                sampled.impact.data());
    Point slopes(2 * of.n * size_t(core_.tables().n_joint));
    sampled.integrate({cost, slopes.data(), slopes.data() + slopes.size() / 2});
  }
  bool has_gradients() const override { return true; }
  void edge_gradients(const Edges& edges, Sampling sampling, const EdgeSlopes& out) const override {
    EdgeStates sampled(core_, model_.speed(), pace_, edges, sampling);
    const bool exact = sampling == Sampling::kExact;
    core_.kernels().body_gradient(core_.tables(), exact ? model_.tables() : model_.rough_tables(),
                                  exact ? harm() : rough_harm(), sampled.states(), sampled.slopes());
    sampled.integrate(out);
  }

 private:
  BodyHarm harm() const { return {weight_.data(), severity_.data(), nullptr}; }
  BodyHarm rough_harm() const { return {weight_.data(), severity_.data(), tail_.data()}; }

  // For successive states of a motion. If there are many, a subset is evaluated, and the impact and its derivatives are
  // interpolated linearly in between.
  void rough_slopes(const States& states, const Slopes& out) const {
    const size_t nq = size_t(core_.tables().n_joint), looks = std::min(states.n, kRoughLooks);
    Point q, qd, value(looks), d_q(looks * nq), d_qd(looks * nq);
    std::vector<size_t> at(looks);
    for (size_t k = 0; k < looks; ++k) {
      at[k] = looks > 1 ? (k * (states.n - 1) + (looks - 1) / 2) / (looks - 1) : 0;
      q.insert(q.end(), states.q + at[k] * nq, states.q + (at[k] + 1) * nq);
      qd.insert(qd.end(), states.qd + at[k] * nq, states.qd + (at[k] + 1) * nq);
    }
    core_.kernels().body_gradient(core_.tables(), model_.rough_tables(), rough_harm(), {q.data(), qd.data(), looks},
                                  {value.data(), d_q.data(), d_qd.data()});
    for (size_t k = 0; k < looks; ++k) {
      const size_t next = k + 1 < looks ? k + 1 : k, end = k + 1 < looks ? at[k + 1] : states.n;
      for (size_t i = at[k]; i < end; ++i) {
        const double t = next > k ? double(i - at[k]) / double(at[next] - at[k]) : 0.0;
        const auto between = [t](double a, double b) { return a + t * (b - a); };
        out.value[i] = between(value[k], value[next]);
        for (size_t j = 0; j < nq; ++j) {
          out.d_q[i * nq + j] = between(d_q[k * nq + j], d_q[next * nq + j]);
          out.d_qd[i * nq + j] = between(d_qd[k * nq + j], d_qd[next * nq + j]);
        }
      }
    }
  }

  const BodyModel& model_;
  const Point weight_;
  const double pace_[2];  // shares of the joints' speeds
  std::vector<Tail> tail_;
};

}  // namespace gp

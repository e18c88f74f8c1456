// Bindings of the native planners, their spaces, and graph search.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include "bindings/bindings.hpp"
#include "bindings/graph_search.hpp"
#include "impact/impact.hpp"
#include "impact/moving/moving_impact.hpp"
#include "mobile/rolling_curve.hpp"
#include "search/anytime.hpp"
#include "search/connect.hpp"
#include "search/descent.hpp"
#include "search/drive.hpp"
#include "search/motion_descent.hpp"

using namespace nb::literals;

namespace gp {
namespace {

// Settings of a scene's space [rad or m].
struct SpaceSettings {
  Point low, high;
  double weight, check_step, fine_step, cost_step, margin;
  bool projects = true;  // project onto constraints; if false, trees only reject configurations
};

// Clearance that a straight edge between two projected configurations may lose [m].
constexpr double kProjectionReserve = 0.003;

// Constraints that only Python can check, for rows of configurations: holds(q) -> [n], clearance(q) -> [n] and
// gradients.
struct CustomConstraints {
  nb::object holds, clearance;
  bool any() const { return !holds.is_none(); }
};

template <class T, size_t Dims> using Answer = nb::ndarray<const T, nb::ndim<Dims>, nb::c_contig, nb::device::cpu>;

// Costs of states with moving entities: `moving` is evaluated at their times, `still` covers everything else.
struct TimedImpact {
  const Impact* still;
  const MovingImpact* moving;  // null without moving entities
  bool keeps_off;              // whether the intact robot keeps clear of moving entities, as mobile bases do
};

// Collision and cost from the kernels, further constraints from Python.
class SceneSpace final : public Space {
 public:
  SceneSpace(const Core& core, const Impact& impact, const SpaceSettings& settings, CustomConstraints custom,
             const TimedImpact& among)
      : Space(settings.low, settings.high, settings.weight),
        core_(core),
        impact_(impact),
        settings_(settings),
        custom_(std::move(custom)),
        among_(among) {
    margin = settings.margin;
    require(dim == core.tables().n_joint && impact.core().tables().n_joint == dim, "limits of a different robot");
    for (double step : {settings.check_step, settings.fine_step, settings.cost_step})
      require(in_range(step, kLeastStep) && extent() <= step * kMaxSamples, "step of an edge");
    require(in_range(margin, -kMaxExtent, kMaxExtent), "margin");
    require(custom_.holds.is_none() == custom_.clearance.is_none(), "holds and clearance come together");
    require(!among.moving == !among.still, "costs of moving entities and of the static scene come together");
    for (const Core* other : {among.moving ? &among.moving->core() : &core, among.still ? &among.still->core() : &core})
      require(other->tables().n_joint == dim, "limits of a different robot");
  }
  bool edge_free(const double* a, const double* b) override { return free_at(a, b, settings_.check_step); }
  bool edge_certain(const double* a, const double* b) override { return free_at(a, b, settings_.fine_step); }
  double impact(const double* a, const double* b) override {
    double cost[2];
    impact_.rough_edges({a, b, 1, settings_.cost_step}, cost);
    return cost[1];
  }
  bool keep_tool(const double* q, double* displacement) override {
    core_.keep_tool(q, displacement);
    return true;
  }
  bool move_tool(const double* q, const double* step, double* displacement) override {
    core_.move_tool(q, step, displacement);
    return true;
  }
  bool has_bounds() const override { return settings_.projects && core_.has_bounds(); }
  bool project(double* q) override { return core_.project(q, lower.data(), upper.data(), margin + kProjectionReserve); }
  void poses(const Chain& of, Point& out) override {
    const size_t n = size_t(of.n_edge) + 1;
    out.resize(16 * n * size_t(core_.tables().n_link));
    core_.kernels().link_poses(core_.tables(), {of.points, nullptr, n}, out.data());
  }
  Rider rider(int link, const Vector3& point) const override { return core_.rider(link, point); }
  void impacts(const double* points, int n, double* out) override { impact_.rough_states(points, size_t(n), out); }
  double exposure(const double* a, const double* b) const override { return impact_.exposure(a, b); }
  bool has_state_slopes() const override { return true; }
  void state_slopes(const MovingStates& of, const StateSlopes& out) override {
    const Impact& impact = has_moving() ? *among_.still : impact_;
    impact.state_slopes({of.q, of.qd, size_t(of.n)}, of.rough, {out.impact, out.by_q, out.by_qd});
  }
  bool has_moving() const override { return among_.moving != nullptr; }
  void moving_slopes(const TimedStates& of, const TimedSlopes& out) override { among_.moving->slopes(of, out); }
  void gaps(const TimedProbes& of, const GapSlopes& out) override {
    if (among_.keeps_off) return among_.moving->gaps(of, out);
    std::fill_n(out.gap, of.n, std::numeric_limits<double>::infinity());
  }
  Measure measure() const override { return impact_.measure(); }
  bool motion_is_length() const override { return impact_.motion_is_length(); }
  double motion(const double* a, const double* b) override {
    if (motion_is_length()) return distance(a, b);
    double cost[2];
    impact_.edges({a, b, 1, settings_.cost_step}, cost);
    return cost[0];
  }
  void motion_slopes(const MovingStates& of, const StateSlopes& out) override {
    impact_.motion_slopes({of.q, of.qd, size_t(of.n)}, {out.impact, out.by_q, out.by_qd});
  }
  void costs(const Chain& of, double* out) override {
    if (!impact_.in_python() || (w == 0 && motion_is_length())) return Space::costs(of, out);
    Point cost(2 * size_t(of.n_edge));
    impact_.rough_edges({of.points, of.points + dim, size_t(of.n_edge), settings_.cost_step}, cost.data());
    for (int e = 0; e < of.n_edge; ++e) out[e] = cost[2 * size_t(e)] + w * cost[2 * size_t(e) + 1];
  }
  bool has_slopes() const override { return impact_.has_gradients(); }
  void slopes(const Chain& chain, double step, bool rough, const ChainSlopes& out) override {
    const Edges edges{chain.points, chain.points + dim, size_t(chain.n_edge), step};
    impact_.edge_gradients(edges, rough ? Sampling::kMean : Sampling::kBoth, {out.cost, out.by_from, out.by_to});
  }
  void clearances(const Probes& probes, double* out, double* gradient) override {
    native_clearances(probes, out, gradient);
    if (custom_.any()) custom_clearances(probes, out, gradient);
  }

 private:
  static constexpr double kEverything = std::numeric_limits<double>::infinity();

  void native_clearances(const Probes& probes, double* out, double* gradient) const {
    const size_t n = size_t(probes.n), nq = size_t(dim);
    std::vector<uint8_t> free(n, 0);
    if (std::isfinite(probes.wanted))
      core_.kernels().free_states(core_.tables(), {probes.q, nullptr, n}, probes.wanted, free.data());
    std::fill(out, out + n, std::numeric_limits<double>::infinity()), std::fill(gradient, gradient + n * nq, 0.0);
    Point close;
    for (size_t k = 0; k < n; ++k)
      if (!free[k]) close.insert(close.end(), probes.q + k * nq, probes.q + (k + 1) * nq);
    if (close.empty()) return;
    Point value(close.size() / nq), slope(close.size());
    core_.kernels().clearance(core_.tables(), {close.data(), nullptr, value.size()}, kEverything, value.data(),
                              slope.data());
    for (size_t k = 0, i = 0; k < n; ++k) {
      if (free[k]) continue;
      out[k] = value[i];
      std::copy_n(slope.data() + i * nq, nq, gradient + k * nq);
      ++i;
    }
  }
  void custom_clearances(const Probes& probes, double* out, double* gradient) const {
    nb::gil_scoped_acquire gil;
    const size_t n = size_t(probes.n), nq = size_t(dim);
    const nb::tuple answer = nb::cast<nb::tuple>(custom_.clearance(rows_of(probes.q, n)));
    const auto value = nb::cast<Answer<double, 1>>(answer[0]);
    const auto slope = nb::cast<Answer<double, 2>>(answer[1]);
    require(value.size() == n && slope.size() == n * nq, "one clearance and gradient per configuration");
    for (size_t k = 0; k < n; ++k) {
      if (!(value.data()[k] < out[k])) continue;
      out[k] = value.data()[k];
      std::copy_n(slope.data() + k * nq, nq, gradient + k * nq);
    }
  }
  nb::object rows_of(const double* points, size_t n) const {
    double* data;
    auto array = make<double>({n, size_t(dim)}, data);
    std::copy_n(points, n * size_t(dim), data);
    return nb::cast(std::move(array));
  }

  bool free_at(const double* a, const double* b, double step) const {
    uint8_t free = 0;
    core_.kernels().free_edges(core_.tables(), {a, b, 1, step}, margin, &free);
    return free != 0 && (!custom_.any() || holds_along(a, b, step));
  }
  bool holds_along(const double* a, const double* b, double step) const {
    const size_t n = size_t(std::ceil(distance(a, b) / step)) + 1, nq = size_t(dim);
    Point points;
    for (size_t k = 0; k <= n; ++k)
      for (size_t j = 0; j < nq; ++j) points.push_back(a[j] + (b[j] - a[j]) * double(k) / double(n));
    nb::gil_scoped_acquire gil;
    const auto holds = nb::cast<Answer<bool, 1>>(custom_.holds(rows_of(points.data(), n + 1)));
    require(holds.size() == n + 1, "one answer per configuration");
    return std::all_of(holds.data(), holds.data() + n + 1, [](bool ok) { return ok; });
  }

  const Core& core_;
  const Impact& impact_;
  SpaceSettings settings_;
  CustomConstraints custom_;
  TimedImpact among_;
};

// Collision and cost from Python: edges_free(q0, q1) -> [1], edge_costs(q0, q1) -> [1, 2], state_costs(q) -> [n].
class CallbackSpace final : public Space {
 public:
  // The Python functions.
  struct Callbacks {
    nb::object edges_free, edge_costs, state_costs;
  };

  // If a core is given, configurations are projected onto its bounds.
  CallbackSpace(Callbacks ask, Reals low, Reals high, double weight, bool motion_is_length, const Core* core)
      : Space(point(low), point(high), weight), ask_(std::move(ask)), motion_is_length_(motion_is_length), core_(core) {
    require(!core || core->tables().n_joint == dim, "limits of a different robot");
  }
  bool has_bounds() const override { return core_ && core_->has_bounds(); }
  bool project(double* q) override {
    return !core_ || core_->project(q, lower.data(), upper.data(), margin + kProjectionReserve);
  }
  bool edge_free(const double* a, const double* b) override {
    nb::gil_scoped_acquire gil;
    auto free = nb::cast<Answer<bool, 1>>(ask_.edges_free(rows(a), rows(b)));
    require(free.size() == 1, "one answer per edge");
    return free.data()[0];
  }
  bool edge_certain(const double*, const double*) override { return true; }
  double impact(const double* a, const double* b) override { return costs(a, b).second; }
  void impacts(const double* points, int n, double* out) override {
    nb::gil_scoped_acquire gil;
    auto cost = nb::cast<Answer<double, 1>>(ask_.state_costs(rows(points, n)));
    require(cost.size() == size_t(n), "one cost per state");
    std::copy(cost.data(), cost.data() + n, out);
  }
  double motion(const double* a, const double* b) override {
    return motion_is_length_ ? distance(a, b) : costs(a, b).first;
  }
  bool motion_is_length() const override { return motion_is_length_; }

 private:
  Array<double> rows(const double* points, int n = 1) {
    double* data;
    auto array = make<double>({size_t(n), size_t(dim)}, data);
    std::copy(points, points + n * dim, data);
    return array;
  }
  std::pair<double, double> costs(const double* a, const double* b) {
    nb::gil_scoped_acquire gil;
    auto cost = nb::cast<Answer<double, 2>>(ask_.edge_costs(rows(a), rows(b)));
    require(cost.size() == 2, "V and S per edge");
    return {cost.data()[0], cost.data()[1]};
  }
  Callbacks ask_;
  bool motion_is_length_;
  const Core* core_;
};

Array<double> as_array(const std::vector<Point>& rows, int dim) {
  double* data;
  auto array = make<double>({rows.size(), size_t(dim)}, data);
  for (const Point& row : rows) data = std::copy(row.begin(), row.end(), data);
  return array;
}

// A path given by the caller, validated.
std::vector<Point> path_in(const Space& space, const Reals& path) {
  require_rows(path, space.dim, "a path is [n >= 2, nq], numbers of at most 1000 rad or m");
  require(path.shape(0) >= 2, "a path is [n >= 2, nq]");
  return points(path);
}

// Returns the space after checking that start and goals fit it.
Space& with_ends(Space& space, const Reals& start, const Reals& goals) {
  require_point(space, start, "a start is [nq], numbers of at most 1000 rad or m");
  require_points(space, goals, "goals are [n > 0, nq], numbers of at most 1000 rad or m");
  return space;
}

class ConnectPlanner {
 public:
  ConnectPlanner(Space& space, Reals start, Reals goals, double range, int max_nodes, uint64_t seed)
      : space_(with_ends(space, start, goals)),
        connect_(space, point(start), points(goals), {checked(range), max_nodes}, seed) {
    require(max_nodes > 0, "number of nodes");
  }
  nb::tuple run(int64_t iterations, double seconds) {
    require_slice(iterations, seconds);
    const Turn turn(taken_);
    Slice slice(iterations, seconds);
    {
      nb::gil_scoped_release release;
      while (!solved_ && slice.next()) solved_ = connect_.step();
    }
    return nb::make_tuple(solved_, slice.used());
  }
  Array<double> path() const { return as_array(connect_.path(), space_.dim); }

 private:
  static double checked(double range) {
    require(in_range(range, kLeastStep), "range");
    return range;
  }

  Space& space_;
  Connect connect_;
  bool solved_ = false;
  std::atomic_flag taken_;
};

class DriveRun {
 public:
  DriveRun(Space& space, Reals start, Reals goals, double cell, bool reverse, int max_nodes)
      : space_(checked(space, start, goals)),
        drive_(space, point(start), points(goals), {cell, reverse, 1, max_nodes}) {
    require(in_range(cell, 1e-3, kMaxExtent) && max_nodes > 0, "settings of a lattice");
  }
  void begin(double weight) {
    require(in_range(weight, 1), "weight of the heuristic");
    const Turn turn(taken_);
    drive_.begin(weight);
    solved_ = false;
  }
  nb::tuple run(int64_t iterations, double seconds) {
    require_slice(iterations, seconds);
    const Turn turn(taken_);
    Slice slice(iterations, seconds);
    {
      nb::gil_scoped_release release;
      while (!solved_ && !drive_.over() && slice.next()) solved_ = drive_.step();
    }
    return nb::make_tuple(solved_, slice.used());
  }
  bool over() const { return drive_.over(); }
  Array<double> path() const { return as_array(drive_.path(), space_.dim); }

 private:
  static Space& checked(Space& space, const Reals& start, const Reals& goals) {
    require(space.dim >= 3, "x, y and heading are the first joints");
    return with_ends(space, start, goals);
  }

  Space& space_;
  Drive drive_;
  bool solved_ = false;
  std::atomic_flag taken_;
};

class DescentRun {
 public:
  DescentRun(Space& space, Reals path, int pieces, double step)
      : space_(space), descent_(checked(space, pieces, step), path_in(space, path), pieces, {.step = step}) {}
  // Runs at most `steps` evaluations. Returns the number after which it had not yet converged.
  int run(int steps) {
    const Turn turn(taken_);
    nb::gil_scoped_release release;
    int done = 0;
    while (done < steps && descent_.step()) ++done;
    return done;
  }
  void harden() { descent_.harden(); }
  Array<double> path() const { return as_array(descent_.path(), space_.dim); }
  double value() const { return descent_.value(); }
  double energy() const { return descent_.energy(); }

 private:
  static Space& checked(Space& space, int pieces, double step) {
    require(space.has_slopes(), "the space has no edge gradients");
    require(pieces >= 1 && pieces <= kMaxPieces, "pieces of a descent");
    require(in_range(step, kLeastStep) && space.extent() <= step * kMaxSamples, "step of a descent");
    return space;
  }

  static constexpr int kMaxPieces = 10000;
  Space& space_;
  Descent descent_;
  std::atomic_flag taken_;
};

class MotionDescentRun {
 public:
  MotionDescentRun(Space& space, Reals path, const MotionSettings& settings, const RollingSettings* rolling)
      : space_(space),
        descent_(checked(space, settings), path_in(space, path), settings, curve(space, settings, rolling)) {}
  // Runs for at most `steps` evaluations or `seconds`. Returns the number after which it had not yet converged.
  int run(int steps, double seconds) {
    require_slice(steps, seconds);
    const Turn turn(taken_);
    nb::gil_scoped_release release;
    Slice slice(steps, seconds);
    int done = 0;
    while (slice.next() && descent_.step()) ++done;
    return done;
  }
  void harden() { descent_.harden(); }
  Array<double> controls() const { return as_array(descent_.controls(), space_.dim); }
  // The inner control points, in the order of energy().
  Array<double> inner() const { return as_array({descent_.inner()}, int(descent_.unknowns())); }
  double value() const { return descent_.value(); }
  double duration() const { return descent_.duration(); }
  double gap() const { return descent_.gap(); }
  double speed_room() const { return descent_.speed_room(); }
  nb::tuple energy(Reals controls) {
    require_numbers(controls, descent_.unknowns(), "inner controls of the descent", kMaxPosition);
    const Turn turn(taken_);
    std::vector<Point> rows(1);
    const double value = descent_.energy(point(controls), rows[0]);
    return nb::make_tuple(value, as_array(rows, int(rows[0].size())));
  }

 private:
  static std::unique_ptr<MotionCurve> curve(const Space& space, const MotionSettings& of,
                                            const RollingSettings* rolling) {
    if (!rolling) return nullptr;
    require(of.leaving.empty() && of.arriving.empty(), "a base that starts and ends at rest");
    require(space.dim >= 3, "a base has three joints");
    return std::make_unique<RollingCurve>(space, of.controls, of.density, *rolling);
  }
  static Space& checked(Space& space, const MotionSettings& settings) {
    require(space.has_state_slopes(), "the space has no state gradients");
    require(settings.controls >= 4 && settings.controls <= 200, "controls of a descent");
    require(settings.density >= 1 && settings.density <= 1000, "density of a descent");
    require(settings.velocity.size() == size_t(space.dim) && settings.acceleration.size() == size_t(space.dim),
            "limits of the joints");
    for (const Point& limits : {settings.velocity, settings.acceleration})
      for (double limit : limits) require(limit > 0 && limit <= kMaxNumber, "limits of the joints");
    for (double share : {settings.time_price, settings.push, settings.tolerance, settings.points})
      require(in_range(share, 0), "settings of a descent");
    for (double share : {settings.tight_start, settings.tight_end}) require(in_range(share, 0), "tight ends");
    require(in_range(settings.least_leg, 0) && in_range(settings.least_last_leg, 0), "lengths of outer legs");
    for (const Point& velocity : {settings.leaving, settings.arriving}) {
      if (velocity.empty()) continue;
      require(velocity.size() == size_t(space.dim), "a velocity at an end");
      for (double number : velocity) require(std::abs(number) <= kMaxNumber, "a velocity at an end");
      require(size_of(velocity) > 1e-9, "a velocity at an end");
    }
    return space;
  }

  Space& space_;
  MotionDescent descent_;
  std::atomic_flag taken_;
};

class AnytimePlanner {
 public:
  AnytimePlanner(Space& space, Reals start, Reals goals, const AnytimeSettings& settings, uint64_t seed)
      : space_(with_ends(space, start, goals)), anytime_(space, point(start), points(goals), checked(settings), seed) {}
  bool admits(Reals path) {
    const std::vector<Point> q = path_in(space_, path);
    const Turn turn(taken_);
    nb::gil_scoped_release release;
    return space_.path_free(q);
  }
  void adopt(Reals path) {
    const std::vector<Point> q = path_in(space_, path);
    const Turn turn(taken_);
    anytime_.adopt(q);
  }
  void suggest(Reals path) {
    const std::vector<Point> q = path_in(space_, path);
    const Turn turn(taken_);
    anytime_.suggest(q);
  }
  double total() const { return anytime_.best().total; }
  nb::tuple run(int64_t iterations, double seconds) {
    require_slice(iterations, seconds);
    const Turn turn(taken_);
    Slice slice(iterations, seconds);
    bool improved;
    {
      nb::gil_scoped_release release;
      improved = anytime_.run(slice);
    }
    return nb::make_tuple(improved, slice.used());
  }
  Array<double> path() const { return as_array(anytime_.best().q, space_.dim); }
  bool optimal() const { return anytime_.optimal(); }

 private:
  static const AnytimeSettings& checked(const AnytimeSettings& settings) {
    require(in_range(settings.connect.range, kLeastStep) && settings.connect.max_nodes > 0, "settings of trees");
    require(in_range(settings.spacing, 1e-4) && settings.challengers >= 0, "settings of a search");
    return settings;
  }

  Space& space_;
  Anytime anytime_;
  std::atomic_flag taken_;
};

}  // namespace

void bind_search(nb::module_& m) {
  nb::class_<GraphSearch>(m, "GraphSearch")
      .def(nb::init<int, Integers, Integers>(), "n"_a, "tail"_a, "head"_a)
      .def("cheapest", &GraphSearch::cheapest, "cost"_a, "start"_a, "goals"_a)
      .def("front", &GraphSearch::front, "cost"_a, "start"_a, "goals"_a, "epsilon"_a, "seconds"_a);
  nb::class_<Space>(m, "Space");
  nb::class_<SceneSpace, Space>(m, "SceneSpace")
      .def(
          "__init__",
          [](SceneSpace* self, const Core& core, const Impact& impact, Reals lower, Reals upper, double w,
             double check_step, double fine_step, double cost_step, double margin, nb::object holds,
             nb::object clearance, bool projects, const Impact* still, const MovingImpact* moving, bool keeps_off) {
            new (self) SceneSpace(core, impact,
                                  {point(lower), point(upper), w, check_step, fine_step, cost_step, margin, projects},
                                  {std::move(holds), std::move(clearance)}, {still, moving, keeps_off});
          },
          nb::kw_only(), "core"_a, "impact"_a, "lower"_a, "upper"_a, "w"_a, "check_step"_a, "fine_step"_a,
          "cost_step"_a, "margin"_a, "holds"_a = nb::none(), "clearance"_a = nb::none(), "projects"_a = true,
          "still"_a.none() = nb::none(), "moving"_a.none() = nb::none(), "keeps_off"_a = false, nb::keep_alive<1, 2>(),
          nb::keep_alive<1, 3>(), nb::keep_alive<1, 14>(), nb::keep_alive<1, 15>());
  nb::class_<CallbackSpace, Space>(m, "CallbackSpace")
      .def(
          "__init__",
          [](CallbackSpace* self, nb::object edges_free, nb::object edge_costs, nb::object state_costs, Reals lower,
             Reals upper, double w, bool motion_is_length, const Core* core, double margin) {
            new (self) CallbackSpace({edges_free, edge_costs, state_costs}, lower, upper, w, motion_is_length, core);
            self->margin = margin;
          },
          nb::kw_only(), "edges_free"_a, "edge_costs"_a, "state_costs"_a, "lower"_a, "upper"_a, "w"_a,
          "motion_is_length"_a, "core"_a.none() = nb::none(), "margin"_a = 0.0, nb::keep_alive<1, 9>());
  nb::class_<ConnectPlanner>(m, "Connect")
      .def(nb::init<Space&, Reals, Reals, double, int, uint64_t>(), "space"_a, nb::kw_only(), "start"_a, "goals"_a,
           "range"_a, "max_nodes"_a, "seed"_a, nb::keep_alive<1, 2>())
      .def("run", &ConnectPlanner::run, "iterations"_a, "seconds"_a)
      .def_prop_ro("path", &ConnectPlanner::path, nb::rv_policy::move);
  nb::class_<DriveRun>(m, "Drive")
      .def(nb::init<Space&, Reals, Reals, double, bool, int>(), "space"_a, nb::kw_only(), "start"_a, "goals"_a,
           "cell"_a, "reverse"_a, "max_nodes"_a, nb::keep_alive<1, 2>())
      .def("begin", &DriveRun::begin, "weight"_a)
      .def("run", &DriveRun::run, "iterations"_a, "seconds"_a)
      .def_prop_ro("over", &DriveRun::over)
      .def_prop_ro("path", &DriveRun::path, nb::rv_policy::move);
  nb::class_<DescentRun>(m, "Descent")
      .def(nb::init<Space&, Reals, int, double>(), "space"_a, "path"_a, "pieces"_a, "step"_a, nb::keep_alive<1, 2>())
      .def("run", &DescentRun::run, "steps"_a)
      .def("harden", &DescentRun::harden)
      .def_prop_ro("path", &DescentRun::path, nb::rv_policy::move)
      .def_prop_ro("value", &DescentRun::value)
      .def_prop_ro("energy", &DescentRun::energy);
  nb::class_<RollingSettings>(m, "Rolling")
      .def(
          "__init__",
          [](RollingSettings* self, double speed, double turning, double acceleration, double turning_acceleration,
             double across, double rim, double lever, bool forward, double before, double after, bool turns_before,
             bool turns_after, bool holds_arm) {
            for (double limit : {speed, turning, acceleration, turning_acceleration, across, rim, lever})
              require(limit > 0 && limit <= kMaxNumber, "limits of a base");
            for (double heading : {before, after})
              require(in_range(heading, -kMaxPosition, kMaxPosition), "heading of a base");
            new (self) RollingSettings{{speed, turning, acceleration, turning_acceleration, across, rim, lever},
                                       forward,
                                       before,
                                       after,
                                       turns_before,
                                       turns_after,
                                       holds_arm};
          },
          nb::kw_only(), "speed"_a, "turning"_a, "acceleration"_a, "turning_acceleration"_a, "across"_a, "rim"_a,
          "lever"_a, "forward"_a = true, "before"_a, "after"_a, "turns_before"_a = false, "turns_after"_a = false,
          "holds_arm"_a = false);
  nb::class_<MotionDescentRun>(m, "MotionDescent")
      .def(
          "__init__",
          [](MotionDescentRun* self, Space& space, Reals path, Reals velocity, Reals acceleration, size_t controls,
             size_t density, bool rough, double time_price, double push, double tolerance, double tight_start,
             double tight_end, const std::vector<SpecificForceLimit>& felt, bool fitted, bool slosh, double points,
             const RollingSettings* rolling, const std::optional<Reals>& leaving, double least_leg,
             const std::optional<Reals>& arriving, double least_last_leg) {
            new (self) MotionDescentRun(
                space, path,
                {point(velocity), point(acceleration), controls, density, rough, time_price, push, tolerance,
                 tight_start, tight_end, felt, fitted, slosh, points, leaving ? point(*leaving) : Point{}, least_leg,
                 arriving ? point(*arriving) : Point{}, least_last_leg},
                rolling);
          },
          "space"_a, nb::kw_only(), "path"_a, "velocity"_a, "acceleration"_a, "controls"_a, "density"_a,
          "rough"_a = false, "time_price"_a, "push"_a = 1.0, "tolerance"_a = 1e-4, "tight_start"_a = 0.0,
          "tight_end"_a = 0.0, "felt"_a = std::vector<SpecificForceLimit>{}, "fitted"_a = false, "slosh"_a = true,
          "points"_a = 1.0, "rolling"_a = nb::none(), "leaving"_a = nb::none(), "least_leg"_a = 0.0,
          "arriving"_a = nb::none(), "least_last_leg"_a = 0.0, nb::keep_alive<1, 2>())
      .def("run", &MotionDescentRun::run, "steps"_a, "seconds"_a)
      .def("harden", &MotionDescentRun::harden)
      .def_prop_ro("controls", &MotionDescentRun::controls, nb::rv_policy::move)
      .def_prop_ro("inner", &MotionDescentRun::inner, nb::rv_policy::move)
      .def("energy", &MotionDescentRun::energy, "controls"_a)
      .def_prop_ro("value", &MotionDescentRun::value)
      .def_prop_ro("duration", &MotionDescentRun::duration)
      .def_prop_ro("gap", &MotionDescentRun::gap)
      .def_prop_ro("speed_room", &MotionDescentRun::speed_room);
  nb::class_<AnytimePlanner>(m, "Anytime")
      .def(
          "__init__",
          [](AnytimePlanner* self, Space& space, Reals start, Reals goals, double range, int max_nodes, double spacing,
             int challengers, uint64_t seed, bool descents, bool scouts) {
            new (self)
                AnytimePlanner(space, start, goals, {{range, max_nodes}, spacing, challengers, descents, scouts}, seed);
          },
          "space"_a, nb::kw_only(), "start"_a, "goals"_a, "range"_a, "max_nodes"_a, "spacing"_a, "challengers"_a,
          "seed"_a, "descents"_a, "scouts"_a, nb::keep_alive<1, 2>())
      .def("admits", &AnytimePlanner::admits, "path"_a)
      .def("adopt", &AnytimePlanner::adopt, "path"_a)
      .def("suggest", &AnytimePlanner::suggest, "path"_a)
      .def_prop_ro("total", &AnytimePlanner::total)
      .def("run", &AnytimePlanner::run, "iterations"_a, "seconds"_a)
      .def_prop_ro("path", &AnytimePlanner::path, nb::rv_policy::move)
      .def_prop_ro("optimal", &AnytimePlanner::optimal);
}

}  // namespace gp

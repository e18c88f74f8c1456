// Python's door to the core: owns the tables, picks the instruction set, releases the GIL.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "search/anytime.hpp"
#include "impact/body_impact.hpp"
#include "search/connect.hpp"
#include "core.hpp"
#include "search/descent.hpp"
#include "search/graph_search.hpp"
#include "impact/impact.hpp"

using namespace nb::literals;

namespace gp {
namespace {

// Collision and cost from the kernels.
class SceneSpace final : public Space {
 public:
  SceneSpace(const Core& core, const Impact& impact, Reals low, Reals high, double weight, double check_step, double fine_step,
             double cost_step, double keep)
      : core_(core), impact_(impact), check_step_(check_step), fine_step_(fine_step), cost_step_(cost_step) {
    lower = point(low), upper = point(high), dim = int(lower.size()), w = weight, margin = keep;
    require(dim == core.tables().n_joint && upper.size() == lower.size(), "limits");
    has_slopes_ = impact_.edge_gradients(nullptr, nullptr, 0, 1.0, Sampling::kBoth, nullptr, nullptr, nullptr);
  }
  bool edge_free(const double* a, const double* b) override { return free_at(a, b, check_step_); }
  bool edge_certain(const double* a, const double* b) override { return free_at(a, b, fine_step_); }
  double impact(const double* a, const double* b) override {
    double cost[2];
    impact_.edges(a, b, 1, cost_step_, cost);
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
  void impacts(const double* points, int n, double* out) override {
    impact_.rough_states(points, size_t(n), out);
  }
  bool has_slopes() const override { return has_slopes_; }
  void slopes(const double* points, int n_edge, double step, bool rough, double* cost, double* by_from, double* by_to) override {
    impact_.edge_gradients(points, points + dim, size_t(n_edge), step, rough ? Sampling::kMean : Sampling::kBoth, cost, by_from, by_to);
  }
  void clearances(const double* points, int n, double* out, double* gradient) override {
    core_.kernels().clearance(core_.tables(), points, size_t(n), out, gradient);
  }

 private:
  bool free_at(const double* a, const double* b, double step) const {
    uint8_t free = 0;
    core_.kernels().free_edges(core_.tables(), a, b, 1, step, margin, &free);
    return free != 0;
  }

  const Core& core_;
  const Impact& impact_;
  double check_step_, fine_step_, cost_step_;
  bool has_slopes_;
};

// Collision and cost from Python: edges_free(q0, q1) -> [1], edge_costs(q0, q1) -> [1, 2], state_costs(q) -> [n].
class CallbackSpace final : public Space {
 public:
  CallbackSpace(nb::object edges_free, nb::object edge_costs, nb::object state_costs, Reals low, Reals high, double weight,
                bool motion_is_length)
      : edges_free_(std::move(edges_free)), edge_costs_(std::move(edge_costs)), state_costs_(std::move(state_costs)),
        motion_is_length_(motion_is_length) {
    lower = point(low), upper = point(high), dim = int(lower.size()), w = weight;
    require(upper.size() == lower.size(), "limits");
  }
  bool edge_free(const double* a, const double* b) override {
    nb::gil_scoped_acquire gil;
    auto free = nb::cast<nb::ndarray<const bool, nb::ndim<1>, nb::c_contig, nb::device::cpu>>(edges_free_(rows(a), rows(b)));
    require(free.size() == 1, "one answer per edge");
    return free.data()[0];
  }
  bool edge_certain(const double*, const double*) override { return true; }
  double impact(const double* a, const double* b) override { return costs(a, b).second; }
  void impacts(const double* points, int n, double* out) override {
    nb::gil_scoped_acquire gil;
    auto cost = nb::cast<nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>>(state_costs_(rows(points, n)));
    require(cost.size() == size_t(n), "one cost per state");
    std::copy(cost.data(), cost.data() + n, out);
  }
  double motion(const double* a, const double* b) override { return motion_is_length_ ? distance(a, b) : costs(a, b).first; }
  bool motion_is_length() const override { return motion_is_length_; }

 private:
  Out<double> rows(const double* points, int n = 1) {
    double* data;
    auto array = make<double>({size_t(n), size_t(dim)}, data);
    std::copy(points, points + n * dim, data);
    return array;
  }
  std::pair<double, double> costs(const double* a, const double* b) {
    nb::gil_scoped_acquire gil;
    auto cost = nb::cast<nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>>(edge_costs_(rows(a), rows(b)));
    require(cost.size() == 2, "V and S per edge");
    return {cost.data()[0], cost.data()[1]};
  }
  nb::object edges_free_, edge_costs_, state_costs_;
  bool motion_is_length_;
};

Out<double> as_array(const std::vector<Point>& rows, int dim) {
  double* data;
  auto array = make<double>({rows.size(), size_t(dim)}, data);
  for (const Point& row : rows) data = std::copy(row.begin(), row.end(), data);
  return array;
}

// A path of somebody else's.
std::vector<Point> path_in(const Space& space, const Reals& path) {
  require(path.ndim() == 2 && path.shape(0) >= 2 && path.shape(1) == size_t(space.dim), "a path is [n >= 2, nq]");
  return points(path);
}

class ConnectPlanner {
 public:
  ConnectPlanner(Space& space, Reals start, Reals goals, double range, int max_nodes, uint64_t seed)
      : space_(space), connect_(space, point(start), points(goals), {range, max_nodes}, seed) {}
  nb::tuple run(int64_t iterations, double seconds) {
    Slice slice(iterations, seconds);
    {
      nb::gil_scoped_release release;
      while (!solved_ && slice.next()) solved_ = connect_.step();
    }
    return nb::make_tuple(solved_, slice.used());
  }
  Out<double> path() const { return as_array(connect_.path(), space_.dim); }

 private:
  Space& space_;
  Connect connect_;
  bool solved_ = false;
};

class DescentRun {
 public:
  DescentRun(Space& space, Reals path, int pieces, double step)
      : space_(space), descent_(checked(space, pieces, step), path_in(space, path), pieces, {.step = step}) {}
  // At most so many evaluations; after how many of them there was still something to gain.
  int run(int steps) {
    nb::gil_scoped_release release;
    int done = 0;
    while (done < steps && descent_.step()) ++done;
    return done;
  }
  void harden() { descent_.harden(); }
  Out<double> path() const { return as_array(descent_.path(), space_.dim); }
  double value() const { return descent_.value(); }
  double energy() const { return descent_.energy(); }

 private:
  static Space& checked(Space& space, int pieces, double step) {
    require(space.has_slopes(), "the space has no slopes");
    require(pieces >= 1 && step > 0, "settings of a descent");
    return space;
  }

  Space& space_;
  Descent descent_;
};

class AnytimePlanner {
 public:
  AnytimePlanner(Space& space, Reals start, Reals goals, double range, int max_nodes, double spacing, int challengers, uint64_t seed,
                 bool descents, bool scouts)
      : space_(space), anytime_(space, point(start), points(goals), {{range, max_nodes}, spacing, challengers, descents, scouts}, seed) {}
  bool admits(Reals path) {
    const std::vector<Point> q = path_in(space_, path);
    nb::gil_scoped_release release;
    return space_.path_free(q);
  }
  void adopt(Reals path) { anytime_.adopt(path_in(space_, path)); }
  void suggest(Reals path) { anytime_.suggest(path_in(space_, path)); }
  double total() const { return anytime_.best().total; }
  nb::tuple run(int64_t iterations, double seconds) {
    Slice slice(iterations, seconds);
    bool improved;
    {
      nb::gil_scoped_release release;
      improved = anytime_.run(slice);
    }
    return nb::make_tuple(improved, slice.used());
  }
  Out<double> path() const { return as_array(anytime_.best().q, space_.dim); }
  bool optimal() const { return anytime_.optimal(); }

 private:
  Space& space_;
  Anytime anytime_;
};

}  // namespace
}  // namespace gp

NB_MODULE(_native, m) {
  using namespace gp;
  m.doc() = "Native core of graceful_plan; use graceful_plan.kernels.";
  m.def("instruction_sets", [] {
    std::vector<std::string> names;
    for (const Isa& isa : available()) names.emplace_back(isa.name);
    return names;
  });
  m.def("capacity", [] {
    nb::dict limits;
    limits["joints"] = kMaxJoints, limits["links"] = kMaxLinks, limits["spheres"] = kMaxSpheres;
    limits["parts"] = kMaxParts, limits["entities"] = kMaxEntities;
    limits["carried parts"] = kMaxDropParts, limits["surfaces"] = kMaxSurfaces, limits["steps ahead"] = kMaxSteps;
    return limits;
  });
  m.def("drop_constants", [] { return std::vector<std::string>(std::begin(kDropConstants), std::end(kDropConstants)); });
  m.def("spill_constants", [] { return std::vector<std::string>(std::begin(kSpillConstants), std::end(kSpillConstants)); });
  m.def("body_constants", [] { return std::vector<std::string>(std::begin(kBodyConstants), std::end(kBodyConstants)); });
  nb::class_<Core>(m, "Core")
      .def(nb::init<Integers, Integers, Integers, Reals, int, Integers, Reals, Reals, Integers, Integers, Reals, Reals, Reals,
                    nb::ndarray<const uint64_t, nb::c_contig, nb::device::cpu>, Integers, Reals, Integers, Integers, Reals, Integers, Reals,
                    int, int, int, Reals, const std::string&>(),
           "parent"_a, "joint"_a, "slide"_a, "X_PL"_a, "n_joint"_a, "sphere_link"_a, "sphere"_a, "bound"_a, "self_pair"_a,
           "obstacle_kind"_a, "obstacle_pose"_a, "obstacle_size"_a, "obstacle_bound"_a, "ignores"_a, "hull_start"_a, "triangles"_a,
           "part_component"_a, "part_link"_a, "part_box"_a, "target_entity"_a, "target_box"_a, "n_component"_a, "n_entity"_a, "tool_link"_a, "tool_position"_a, "isa"_a)
      .def_prop_ro("isa", &Core::isa)
      .def_prop_ro("lanes", &Core::lanes)
      .def("link_poses", &Core::link_poses, "q"_a)
      .def("free_states", &Core::free_states, "q"_a, "margin"_a)
      .def("free_edges", &Core::free_edges, "q0"_a, "q1"_a, "step"_a, "margin"_a)
      .def("clearance", &Core::clearance, "q"_a)
      .def("clearance_gradient", &Core::clearance_gradient, "q"_a)
      .def("interaction", &Core::interaction, "q"_a)
      .def("elementary", &Core::elementary, "x"_a);
  nb::class_<DropModel>(m, "DropModel")
      .def(nb::init<const Core&, int, Reals, Integers, Reals, Reals, Reals, int, double, Integers, Reals, Integers, int, Reals, Reals>(),
           "core"_a, "link"_a, "centre"_a, "part_shape"_a, "part_offset"_a, "part_rotation"_a, "part_half"_a, "main"_a, "size"_a,
           "target_entity"_a, "target"_a, "level_start"_a, "n_entity"_a, "speed"_a, "constants"_a, nb::keep_alive<1, 2>())
      .def("add_contents", &DropModel::add_contents, "container"_a, "stands"_a, "visible"_a, "constants"_a)
      .def("probability", &DropModel::probability, "q"_a, "qd"_a)
      .def("impact", &DropModel::impact, "severity"_a, "q"_a, "qd"_a)
      .def("gradient", &DropModel::gradient, "severity"_a, "q"_a, "qd"_a, "rough"_a = false);
  nb::class_<BodyModel>(m, "BodyModel")
      .def(nb::init<const Core&, Reals, Reals, Integers, Integers, int, int, int, Reals>(), "core"_a, "inertia"_a, "drive"_a, "row"_a,
           "entity"_a, "n_row"_a, "n_entity"_a, "n_step"_a, "constants"_a, nb::keep_alive<1, 2>())
      .def("distances", &BodyModel::distances, "q"_a, "qd"_a, "ahead"_a = nb::none())
      .def("impact", &BodyModel::impact, "weight"_a, "severity"_a, "q"_a, "qd"_a)
      .def("dynamics", &BodyModel::dynamics, "q"_a);
  nb::class_<Impact>(m, "Impact")
      .def("states", &Impact::states_array, "q"_a)
      .def("edges", &Impact::edges_array, "q0"_a, "q1"_a, "step"_a)
      .def("edge_gradients", &Impact::edge_gradients_array, "q0"_a, "q1"_a, "step"_a);
  nb::class_<OverlapImpact, Impact>(m, "OverlapImpact").def(nb::init<const Core&, Reals>(), "core"_a, "severity"_a, nb::keep_alive<1, 2>());
  nb::class_<DropImpact, Impact>(m, "DropImpact")
      .def(nb::init<const DropModel&, Reals, double, double>(), "model"_a, "severity"_a, "slow"_a, "fast"_a, nb::keep_alive<1, 2>());
  nb::class_<SumImpact, Impact>(m, "SumImpact")
      .def(nb::init<const Impact&, const Impact&>(), "first"_a, "second"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
  nb::class_<BodyImpact, Impact>(m, "BodyImpact")
      .def(nb::init<const BodyModel&, Reals, Reals, double, double>(), "model"_a, "weight"_a, "severity"_a, "slow"_a, "fast"_a,
           nb::keep_alive<1, 2>());
  nb::class_<GraphSearch>(m, "GraphSearch")
      .def(nb::init<int, Integers, Integers>(), "n"_a, "tail"_a, "head"_a)
      .def("cheapest", &GraphSearch::cheapest, "cost"_a, "start"_a, "goals"_a)
      .def("front", &GraphSearch::front, "cost"_a, "start"_a, "goals"_a, "epsilon"_a, "seconds"_a);
  nb::class_<Space>(m, "Space");
  nb::class_<SceneSpace, Space>(m, "SceneSpace")
      .def(nb::init<const Core&, const Impact&, Reals, Reals, double, double, double, double, double>(), "core"_a, "impact"_a, "lower"_a,
           "upper"_a, "w"_a, "check_step"_a, "fine_step"_a, "cost_step"_a, "margin"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
  nb::class_<CallbackSpace, Space>(m, "CallbackSpace")
      .def(nb::init<nb::object, nb::object, nb::object, Reals, Reals, double, bool>(), "edges_free"_a, "edge_costs"_a, "state_costs"_a, "lower"_a, "upper"_a, "w"_a,
           "motion_is_length"_a);
  nb::class_<ConnectPlanner>(m, "Connect")
      .def(nb::init<Space&, Reals, Reals, double, int, uint64_t>(), "space"_a, "start"_a, "goals"_a, "range"_a, "max_nodes"_a, "seed"_a,
           nb::keep_alive<1, 2>())
      .def("run", &ConnectPlanner::run, "iterations"_a, "seconds"_a)
      .def_prop_ro("path", &ConnectPlanner::path, nb::rv_policy::move);
  nb::class_<DescentRun>(m, "Descent")
      .def(nb::init<Space&, Reals, int, double>(), "space"_a, "path"_a, "pieces"_a, "step"_a, nb::keep_alive<1, 2>())
      .def("run", &DescentRun::run, "steps"_a)
      .def("harden", &DescentRun::harden)
      .def_prop_ro("path", &DescentRun::path, nb::rv_policy::move)
      .def_prop_ro("value", &DescentRun::value)
      .def_prop_ro("energy", &DescentRun::energy);
  nb::class_<AnytimePlanner>(m, "Anytime")
      .def(nb::init<Space&, Reals, Reals, double, int, double, int, uint64_t, bool, bool>(), "space"_a, "start"_a, "goals"_a, "range"_a,
           "max_nodes"_a, "spacing"_a, "challengers"_a, "seed"_a, "descents"_a, "scouts"_a, nb::keep_alive<1, 2>())
      .def("admits", &AnytimePlanner::admits, "path"_a)
      .def("adopt", &AnytimePlanner::adopt, "path"_a)
      .def("suggest", &AnytimePlanner::suggest, "path"_a)
      .def_prop_ro("total", &AnytimePlanner::total)
      .def("run", &AnytimePlanner::run, "iterations"_a, "seconds"_a)
      .def_prop_ro("path", &AnytimePlanner::path, nb::rv_policy::move)
      .def_prop_ro("optimal", &AnytimePlanner::optimal);
}

// Bindings of floor grids: distances to obstacles, and paths over cells.
#include "mobile/grid/any_angle.hpp"
#include "mobile/grid/distance_field.hpp"

#include <chrono>

#include <nanobind/stl/optional.h>

#include "mobile/bindings/mobile.hpp"
#include "core.hpp"

using namespace nb::literals;

namespace gp {
namespace {

using Bytes = Given<uint8_t>;
using Floats = Given<float>;

constexpr size_t kMaxCells = size_t(1) << 26;

void require_cells(const Bytes& cells) {
  require(cells.ndim() == 2 && cells.size() > 0 && cells.shape(0) <= kMaxCells && cells.shape(1) <= kMaxCells &&
              cells.size() <= kMaxCells,
          "cells of a floor");
}

Out<float> distance_field(Bytes blocked, double resolution, bool outside) {
  require_cells(blocked);
  require(in_range(resolution, 1e-6, 1e6), "resolution");
  std::vector<float> out(blocked.size());
  {
    nb::gil_scoped_release released;
    grid::DistanceField::compute(blocked.data(), int(blocked.shape(0)), int(blocked.shape(1)), outside, resolution,
                                 out.data());
  }
  return owned(std::move(out), {blocked.shape(0), blocked.shape(1)});
}

class BoundGrid {
 public:
  BoundGrid(Bytes closed, double resolution, std::optional<Floats> charge) : map_(made(closed, resolution, charge)) {}

  // Least costs from a cell to all others; infinite for unreachable cells.
  Out<double> costs(int column, int row) const {
    const size_t rows = size_t(map_.rows()), columns = size_t(map_.columns());
    std::vector<double> out(rows * columns, grid::kInfinity);
    {
      nb::gil_scoped_release released;
      const size_t from = at(column, row);
      if (map_.free(from)) {
        grid::GridSearch search(map_);
        search.flood(from, [] { return false; });
        for (size_t y = 0; y < rows; ++y) {
          const double* line = &search.costs()[map_.index(0, int(y))];
          for (size_t x = 0; x < columns; ++x) out[y * columns + x] = line[x] < 0.0 ? grid::kInfinity : line[x];
        }
      }
    }
    return owned(std::move(out), {rows, columns});
  }
  nb::dict path(Integers from, Integers to, const std::string& method, double time_limit) const {
    require(from.ndim() == 1 && from.size() == 2 && to.ndim() == 1 && to.size() == 2, "cells");
    require(method == "dijkstra" || method == "a_star" || method == "theta_star", "method");
    require(time_limit > 0, "time_limit");
    const size_t a = at(from.data()[0], from.data()[1]), b = at(to.data()[0], to.data()[1]);
    const auto began = std::chrono::steady_clock::now();
    const auto late = [&] {
      return std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count() > time_limit;
    };
    grid::GridPath found;
    {
      nb::gil_scoped_release released;
      found = method == "theta_star" ? grid::AnyAngle(map_).path(a, b, late)
                                     : grid::GridSearch(map_).path(a, b, method == "a_star", late);
    }
    std::vector<int32_t> cells;
    for (const uint32_t cell : found.cells) cells.insert(cells.end(), {map_.x(cell), map_.y(cell)});
    nb::dict out;
    out["found"] = found.found, out["stopped"] = found.stopped;
    out["cost"] = found.cost, out["expansions"] = found.expansions;
    out["cells"] = owned(std::move(cells), {found.cells.size(), 2});
    return out;
  }
  // Cost of the straight line between the centres of two cells; infinite if it is not free.
  double straight(Integers from, Integers to) const {
    require(from.ndim() == 1 && from.size() == 2 && to.ndim() == 1 && to.size() == 2, "cells");
    const size_t a = at(from.data()[0], from.data()[1]), b = at(to.data()[0], to.data()[1]);
    if (!map_.free(a) || !map_.free(b)) return grid::kInfinity;
    return grid::straight_cost(map_, a, b, grid::kInfinity);
  }

 private:
  static grid::GridMap made(const Bytes& closed, double resolution, const std::optional<Floats>& charge) {
    require_cells(closed);
    require(in_range(resolution, 1e-6, 1e6), "resolution");
    require(
        !charge || (charge->ndim() == 2 && charge->shape(0) == closed.shape(0) && charge->shape(1) == closed.shape(1)),
        "charge");
    for (size_t i = 0; charge && i < charge->size(); ++i) require(in_range(charge->data()[i], 0, 1e12), "charge");
    nb::gil_scoped_release released;
    return {closed.data(), charge ? charge->data() : nullptr, int(closed.shape(0)), int(closed.shape(1)), resolution};
  }
  size_t at(int column, int row) const {
    require(map_.holds(column, row), "a cell of the floor");
    return map_.index(column, row);
  }

  grid::GridMap map_;
};

}  // namespace

void bind_grid(nb::module_& m) {
  m.def("distance_field", &distance_field, nb::kw_only(), "blocked"_a, "resolution"_a, "outside"_a);
  nb::class_<BoundGrid>(m, "FloorGrid")
      .def(nb::init<Bytes, double, std::optional<Floats>>(), nb::kw_only(), "closed"_a, "resolution"_a,
           "charge"_a.none())
      .def("costs", &BoundGrid::costs, "column"_a, "row"_a)
      .def("path", &BoundGrid::path, nb::kw_only(), "start"_a, "goal"_a, "method"_a, "time_limit"_a)
      .def("straight", &BoundGrid::straight, "start"_a, "goal"_a);
}

}  // namespace gp

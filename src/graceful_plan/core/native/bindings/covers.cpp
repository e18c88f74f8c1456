// Bindings of covers by balls; see geometry/ball_cover.hpp.
#include <nanobind/stl/pair.h>

#include "bindings/bindings.hpp"
#include "checks.hpp"
#include "geometry/ball_cover.hpp"

using namespace nb::literals;

namespace gp {
namespace {

Array<int32_t> ball_cover(Reals points, Reals reach, Reals depth, Integers order, int first, int candidates) {
  const size_t n = reach.size();
  require_numbers(points, 3 * n, "points");
  require_numbers(reach, n, "reach");
  require(depth.size() == n && order.size() == n, "a depth and a place in the order for each point");
  require_within(order, 0, int(n), "order");
  require(first >= 0 && size_t(first) <= n && candidates > 0, "first points and candidates");
  std::vector<double> deep(depth.data(), depth.data() + n);  // -inf outside of all bodies
  for (double d : deep) require(!std::isnan(d), "depth");
  BallCover cover(points.data(), n, reach.data(), deep.data(), size_t(candidates));
  const std::vector<size_t> kept = cover.cover({order.data(), order.data() + n}, size_t(first));
  int32_t* out;
  auto array = make<int32_t>({kept.size()}, out);
  std::copy(kept.begin(), kept.end(), out);
  return array;
}

std::pair<Array<double>, Array<int32_t>> heights(Reals points, Reals planes) {
  require(points.size() % 3 == 0 && planes.size() % 4 == 0 && planes.size() > 0, "points and planes");
  require_numbers(points, points.size(), "points");
  require_numbers(planes, planes.size(), "planes");
  const size_t n = points.size() / 3;
  double* height;
  int32_t* face;
  auto first = make<double>({n}, height);
  auto second = make<int32_t>({n}, face);
  heights_over(points.data(), n, planes.data(), planes.size() / 4, height, face);
  return {std::move(first), std::move(second)};
}

}  // namespace

void bind_covers(nb::module_& m) {
  m.def("ball_cover", &ball_cover, nb::kw_only(), "points"_a, "reach"_a, "depth"_a, "order"_a, "first"_a,
        "candidates"_a, WithoutGil());
  m.def("heights", &heights, nb::kw_only(), "points"_a, "planes"_a, WithoutGil());
}

}  // namespace gp

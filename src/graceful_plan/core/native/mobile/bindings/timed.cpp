// Bindings of paths of a base over cells, headings and time.
#include "mobile/lattice/timed.hpp"

#include "mobile/bindings/mobile.hpp"
#include "checks.hpp"
#include "named.hpp"

using namespace nb::literals;

namespace gp {
namespace {

using lattice::TimedMove;
using Bytes = Given<uint8_t>;
using Floats = Given<float>;

constexpr size_t kMaxTimed = size_t(1) << 28;  // largest number of states: cells, headings and ticks
constexpr size_t kColumns = 6;                 // columns of moves: heading, columns, rows, turn, ticks, kind

void require_rates(const Floats& rate, const char* what) {
  for (size_t i = 0; i < rate.size(); ++i) require(in_range(double(rate.data()[i]), 0, 1e12), what);
}

std::vector<TimedMove> moves_of(const Integers& moves, const Reals& price, int headings) {
  require(moves.ndim() == 2 && moves.shape(1) == kColumns && moves.shape(0) > 0 && moves.shape(0) < 30000, "moves");
  require_numbers(price, moves.shape(0), "prices of moves", 1e9);
  std::vector<TimedMove> out;
  for (size_t k = 0; k < moves.shape(0); ++k) {
    const int32_t* m = moves.data() + kColumns * k;
    require(m[0] >= 0 && m[0] < headings && std::abs(m[3]) < headings && m[4] >= 1 && m[4] < 10000, "a move");
    require(std::abs(m[1]) < 100 && std::abs(m[2]) < 100 && m[5] >= 0 && m[5] <= TimedMove::kBackward, "a move");
    require(m[5] != TimedMove::kWait || (m[1] == 0 && m[2] == 0 && m[3] == 0), "a wait");
    require(price.data()[k] >= 0, "price of a move");
    out.push_back({m[0], m[1], m[2], m[3], m[4], TimedMove::Kind(m[5]), price.data()[k]});
  }
  return out;
}

lattice::TimedEntities walkers_of(const Reals& shape, const Integers& velocity, const Floats& rate, double apart,
                                  size_t headings) {
  require(shape.ndim() == 3 && shape.shape(2) == 7 && velocity.ndim() == 2, "shapes of moving entities");
  require(velocity.shape(0) == shape.shape(0) && velocity.shape(1) == shape.shape(1),
          "velocity classes of moving entities");
  require(shape.shape(0) == 0 || shape.shape(1) > 0, "times of moving entities");
  require_numbers(shape, "shapes of moving entities", 2 * kMaxExtent);
  require(rate.ndim() == 4 && in_range(apart, 1e-3, 1e3), "impact near moving entities");
  const size_t classes = rate.shape(0), places = rate.shape(2);
  require(classes == 0 || (rate.shape(1) == headings && places == rate.shape(3) && places % 2 == 1 && places < 10000),
          "impact near moving entities");
  require_rates(rate, "impact near moving entities");
  if (classes) require_within(velocity, 0, int(classes), "class of a velocity");
  return {shape.shape(0), shape.shape(1), places, classes, shape.data(), velocity.data(), rate.data(), apart};
}

lattice::TimedRules rules_of(const Reals& outline, const Named& given, int ticks) {
  require_numbers(outline, "outline of a base", kMaxExtent);
  require(outline.size() > 0 && outline.size() % 3 == 0, "outline of a base");
  for (size_t k = 2; k < outline.size(); k += 3) require(outline.data()[k] >= 0, "radius of a disc");
  lattice::TimedRules rules;
  fill(rules, given, "rules near moving entities");
  fields(rules,
         [](const std::string&, double& number) { require(std::fabs(number) <= 1e9, "rules near moving entities"); });
  require(rules.price >= 0 && rules.slow >= 0 && rules.tick > 0, "rules near moving entities");
  rules.outline.assign(outline.data(), outline.data() + outline.size()), rules.ticks = ticks;
  return rules;
}

nb::dict answer(const lattice::TimedPath& path) {
  std::vector<int32_t> nodes;
  for (const lattice::TimedNode& n : path.nodes) nodes.insert(nodes.end(), {n.x, n.y, n.heading, n.tick});
  nb::dict out;
  out["found"] = path.found, out["stopped"] = path.stopped, out["cost"] = path.cost;
  out["expansions"] = path.expansions;
  out["nodes"] = owned(std::move(nodes), {path.nodes.size(), 4});
  return out;
}

nb::dict timed_path(Bytes open, Floats rate, double width, Integers moves, Reals price, Reals shape, Integers velocity,
                    Floats beside, double apart, Reals outline, Named rules, int ticks, Integers start, Integers goal,
                    Reals ending, const nb::callable& late) {
  require(open.ndim() == 3 && open.size() > 0 && in_range(width, 1e-6, 1e6), "cells of a floor");
  require(ticks >= 0 && open.size() < kMaxTimed && (size_t(ticks) + 1) * open.size() < kMaxTimed, "cells and ticks");
  require(rate.size() == 0 || rate.size() == open.size(), "impact on a floor");
  require_rates(rate, "impact on a floor");
  const lattice::TimedFloor floor{int(open.shape(2)), int(open.shape(1)),
                                  int(open.shape(0)), width,
                                  open.data(),        rate.size() ? rate.data() : nullptr};
  require(floor.headings % 2 == 0, "headings");
  require(start.size() == 3 && goal.size() == 2, "start and goal");
  const int32_t *s = start.data(), *g = goal.data();
  require(floor.holds(s[0], s[1]) && floor.holds(g[0], g[1]) && s[2] >= 0 && s[2] < floor.headings, "start and goal");
  require(ending.size() == size_t(floor.headings), "prices of headings at the goal");
  for (size_t h = 0; h < ending.size(); ++h) require(ending.data()[h] >= 0, "price of a heading at the goal");
  lattice::Timed search(floor, walkers_of(shape, velocity, beside, apart, size_t(floor.headings)),
                        rules_of(outline, rules, ticks), moves_of(moves, price, floor.headings));
  lattice::TimedPath found;
  {
    nb::gil_scoped_release released;
    found = search.path({s[0], s[1], s[2], 0}, g[0], g[1], ending.data(), [&] {
      const nb::gil_scoped_acquire held;
      return nb::cast<bool>(late());
    });
  }
  return answer(found);
}

}  // namespace

void bind_timed(nb::module_& m) {
  m.def("timed_path", &timed_path, nb::kw_only(), "open"_a, "rate"_a, "width"_a, "moves"_a, "price"_a, "shape"_a,
        "velocity"_a, "beside"_a, "apart"_a, "outline"_a, "rules"_a, "ticks"_a, "start"_a, "goal"_a, "ending"_a,
        "late"_a);
}

}  // namespace gp

// Trajectories of a base that fails while driving, and the entities it hits. The equations are in
// mobile/coast/coast.py.
#pragma once
#include <string>

#include "core.hpp"
#include "mobile/coast/coast_tables.hpp"
#include "named.hpp"

namespace gp {

inline std::vector<FloorShape> floor_shapes(const Integers& entity, const Reals& shape, const Reals* velocity,
                                            int n_entity) {
  require_numbers(shape, 7 * entity.size(), "shapes around a base", 2 * kMaxExtent);
  if (velocity) require_numbers(*velocity, 2 * entity.size(), "velocities around a base", kMaxPosition);
  std::vector<FloorShape> out;
  for (size_t k = 0; k < entity.size(); ++k) {
    const double* s = shape.data() + 7 * k;
    const int of = entity.data()[k];
    require(of >= -1 && of < n_entity, "entity of a shape");
    const double vx = velocity ? velocity->data()[2 * k] : 0.0, vy = velocity ? velocity->data()[2 * k + 1] : 0.0;
    out.push_back({of, s[0], s[1], s[2], s[3], s[4], s[5], s[6], vx, vy});
  }
  return out;
}

// Reference speed of severities; spread of positions; drift; angle turned after a release by turning rate squared.
template <class Visit> void fields(CoastTables& of, Visit visit) {
  visit("reference_speed", of.unit);
  visit("position_spread", of.spread);
  visit("drift", of.drift);
  visit("straightens", of.turn);
}

struct CoastingArrays {
  Reals outline;    // parts of the base in its frame: rectangles, possibly rounded
  Reals stops;      // probability, deceleration, drag, delay, whether wheels are released, added curvature
  Named constants;  // see fields()
  Reals share;      // probability of each table of places
  Reals speeds;     // speeds along the heading of the tables, from 0 [m/s]
  Reals rates;      // turning rates of the tables [rad/s]
  Reals places;     // (speed, rate, table, sample, 5): x, y, angle turned in the frame of the base; speed; time
  Reals astray;     // drifting bases: duration [s] times probability, lateral offset [m],
                    // angle turned, standard deviation of the offset
  Reals weak;       // drives too weak to turn: probability per radian of turning, deceleration, delay
};

// Validates the arrays from Python and builds the tables.
class CheckedTables {
 public:
  explicit CheckedTables(const CoastingArrays& of) : made(Footprint2d(outline(of.outline))) {
    require_numbers(of.stops, "stopping modes of a base"), fill(made, of.constants, "constants of a base");
    require(made.unit > 0 && made.spread > 0 && made.drift >= 0 && made.turn >= 0, "constants of a base");
    stops(of.stops), weak(of.weak), families(), places(of), strays(of.astray);
  }
  CoastTables made;

 private:
  static constexpr size_t kStop = 6, kStrayed = 4, kWeak = 3, kPlace = CoastTables::kPlace;

  static std::vector<FloorShape> outline(const Reals& of) {
    require_numbers(of, "outline of a base", kMaxExtent);
    require(of.size() > 0 && of.size() % 7 == 0, "outline of a base");
    std::vector<FloorShape> parts;
    for (size_t k = 0; k < of.size(); k += 7) {
      const double* s = of.data() + k;
      require(s[4] >= 0 && s[5] >= 0 && s[6] >= 0, "size of a part of a base");
      parts.push_back({-1, s[0], s[1], s[2], s[3], s[4], s[5], s[6], 0, 0});
    }
    return parts;
  }
  void stops(const Reals& of) {
    require(of.size() % kStop == 0, "stopping modes of a base");
    for (size_t k = 0; k < of.size(); k += kStop) {
      const double* s = of.data() + k;
      require(s[0] >= 0 && s[1] > 0 && s[2] >= 0 && s[3] >= 0, "stopping mode of a base");
      made.stop.push_back({s[0], s[1], s[2], s[3], s[4] != 0, s[5]});
    }
  }
  void weak(const Reals& of) {
    require_numbers(of, "weak drives of a base");
    require(of.size() % kWeak == 0, "weak drives of a base");
    for (size_t k = 0; k < of.size(); k += kWeak) {
      const double* s = of.data() + k;
      require(s[0] >= 0 && s[1] > 0 && s[2] >= 0, "weak drive of a base");
      made.stop.push_back({s[0], s[1], 0, s[2], false, 0, true});
    }
  }
  void families() {
    for (const CoastTables::Stop& one : made.stop)
      if (const CoastTables::Family found{one.released, one.bend, one.weak}; !made.has(found))
        made.family.push_back(found);
    for (const CoastTables::Family& one : made.family) {
      made.own.emplace_back(), made.any.emplace_back();
      for (size_t i = 0; i < made.stop.size(); ++i) {
        if (made.stop[i].bend != one.bend || made.stop[i].weak != one.weak) continue;
        made.any.back().push_back(i);
        if (made.stop[i].released == one.released) made.own.back().push_back(i);
      }
    }
  }
  static std::vector<double> ascending(const Reals& values, const char* what) {
    require_numbers(values, what);
    require(values.size() >= 2, what);
    for (size_t k = 1; k < values.size(); ++k) require(values.data()[k] > values.data()[k - 1], what);
    return {values.data(), values.data() + values.size()};
  }
  void places(const CoastingArrays& of) {
    require_numbers(of.share, "probability of a table"), require_numbers(of.places, "places of a base");
    if (of.share.size() == 0) return;
    made.share.assign(of.share.data(), of.share.data() + of.share.size());
    for (double p : made.share) require(p >= 0, "probability of a table");
    made.speeds = ascending(of.speeds, "speeds of the tables");
    made.rates = ascending(of.rates, "rates of the tables");
    const size_t rows = made.speeds.size() * made.rates.size() * made.share.size();
    require(of.places.size() > 0 && of.places.size() % (rows * kPlace) == 0, "places of a base");
    const size_t n = made.samples = of.places.size() / (rows * kPlace);
    require(n > 1 && n <= CoastWork::kSamples, "places of a base");
    made.place.resize(of.places.size()), made.within.assign(rows, 0.0);
    for (size_t row = 0; row < rows; ++row)
      for (size_t k = 0; k < n; ++k) {
        const double* from = of.places.data() + (row * n + k) * kPlace;
        for (size_t m = 0; m < kPlace; ++m) made.place[(row * kPlace + m) * n + k] = from[m];
        made.within[row] = std::max(made.within[row], std::hypot(from[0], from[1]));
        made.farthest = std::max(made.farthest, made.within[row]), made.lasts = std::max(made.lasts, from[4]);
      }
  }
  void strays(const Reals& of) {
    require_numbers(of, "drifting bases");
    require(of.size() % kStrayed == 0, "drifting bases");
    for (size_t k = 0; k < of.size(); k += kStrayed) {
      const double* s = of.data() + k;
      require(s[0] >= 0 && s[3] > 0, "drifting base");
      made.stray.push_back({s[0], s[1], s[2], s[3], std::cos(s[2]), std::sin(s[2])});
      made.aside = std::max(made.aside, std::fabs(s[1]) + CoastTables::kNext + CoastTables::kFarOff * s[3]);
    }
  }
};

// The kernels of an instruction set that this machine supports.
inline const CoastKernels& coast_kernels(const std::string& isa) {
#if defined(__x86_64__) && !defined(GP_QUICK)
  if (isa == "x86-64-v4") return coast_kernels_v4;
  if (isa == "x86-64-v3") return coast_kernels_v3;
#endif
  (void)isa;
  return coast_kernels_baseline;
}

class Coasting {
 public:
  using Work = CoastWork;
  using State = CoastState<double>;

  Coasting(const CoastingArrays& of, const std::string& isa)
      : of_(CheckedTables(of).made), kernels_(coast_kernels(isa)) {}

  const Footprint2d& footprint() const { return of_.footprint; }
  Work work(size_t n_entity) const { return {of_, n_entity}; }

  // Whether an entity may be hit at all; a base never goes farther than at its initial speed.
  bool reaches(const State& at, const FloorShape& who) const {
    const double speed = std::fabs(at.v);
    if (speed <= CoastTables::kStandstill) return false;
    double far = std::max(of_.farthest, of_.aside), longest = of_.lasts;
    for (const CoastTables::Stop& stop : of_.stop) {
      far = std::max(far, speed * stop.delay + speed * speed / (2 * stop.a));
      longest = std::max(longest, stop.delay + speed / stop.a);
    }
    const double step = longest / kLooks, between = who.speed() * step;
    const double around =
        of_.footprint.reach() + CoastTables::kFarOff * std::hypot(of_.spread, of_.drift * far, who.spread);
    for (int k = 0; k < kLooks; ++k) {
      const double gone = std::min(far, speed * step * (k + 1));
      if (who.distance(at.x, at.y, step * k) < around + between + gone) return true;
    }
    return false;
  }
  bool hits(const State& at, const std::vector<FloorShape>& shape, const CoastQuery& query, Work& work) const {
    return kernels_.hits(of_, at, shape, query, work);
  }
  // As `hits`, with derivatives, in work.hit_slopes.
  bool hits(const CoastState<Dual>& at, const std::vector<FloorShape>& shape, const CoastQuery& query,
            Work& work) const {
    return kernels_.hits_slopes(of_, at, shape, query, work);
  }

 private:
  static constexpr int kLooks = 16;  // number of times at which `reaches` checks the distance

  const CoastTables of_;
  const CoastKernels& kernels_;
};

}  // namespace gp

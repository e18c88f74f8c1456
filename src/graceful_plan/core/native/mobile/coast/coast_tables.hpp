// Inputs and working memory of the coast kernels.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "mobile/coast/floor_shape.hpp"

namespace gp {

// Stopping modes of failed bases, and their tabulated trajectories.
struct CoastTables {
  struct Stop {
    double p, a, k, delay;  // p: of weak drives, probability per radian of turning
    bool released;
    double bend;
    bool weak = false;
  };
  struct Family {
    bool released;
    double bend;
    bool weak = false;  // too weak to turn: straight on, at the rate of turning
    bool operator==(const Family&) const = default;
  };
  struct Stray {
    double lasts, aside, turned, spread, cos, sin;  // sine and cosine belong to `turned`
  };
  static constexpr size_t kPlace = 5;

  explicit CoastTables(const Footprint2d& base) : footprint(base) {}
  bool has(const Family& one) const { return std::find(family.begin(), family.end(), one) != family.end(); }

  static constexpr double kFarOff = 6;         // number of standard deviations beyond which nothing is touched
  static constexpr double kStandstill = 1e-6;  // speed below which a base stands [m/s]
  static constexpr double kHarms = 0.05;       // speed from which on a carried object harms in full [m/s]
  static constexpr double kNext = 0.05;        // distance to the next state at which a drifting base is evaluated [m]

  const Footprint2d footprint;
  std::vector<Stop> stop;
  std::vector<Family> family;
  std::vector<std::vector<size_t>> own, any;  // stops of each family: with its wheel state, and with any wheel state
  std::vector<double> share, speeds, rates;
  std::vector<double> place;   // (speed, rate, table, 5, sample)
  std::vector<double> within;  // (speed, rate, table): largest distance of the places from the origin
  std::vector<Stray> stray;
  size_t samples = 0;
  double unit = 1, spread = 1, drift = 0, turn = 0;
  double farthest = 0, lasts = 0;  // of all tables: largest distance and duration
  double aside = 0;                // largest lateral offset of drifting bases, with the next state and kFarOff spreads
};

template <class T> struct CoastState {
  T x, y, yaw, v, omega;
  T time{0.0};  // time since the positions of moving entities were valid
  // Centre of the carried object in the frame of the base, if that object is examined instead of the base.
  T along{0.0}, across{0.0};
};

// Working memory for one state at a time; reused so that nothing is allocated per state.
struct CoastWork {
  // A shape that is near enough to be touched; the least distance the base covers, together with the shape's own
  // motion, before it can touch; and the speed of the shape.
  struct Near {
    const FloorShape* shape;
    double clear, moves;
  };
  // Place along a trajectory and shape in `whom` or `what` that decide a value.
  struct Pair {
    int place = -1, shape = -1;
    bool operator==(const Pair&) const = default;
  };
  // The touch that decides the worth of stops against an entity, and the obstacle or earlier entity that may have
  // stopped the base before. Summed over its stops: `whole`, the shares whose energy exceeds the reference of
  // severities; `energy`, the shares of the others times their energies; and `slope`, the derivative of `energy` with
  // respect to speed.
  struct Decided {
    Pair met, before;
    bool by_obstacle;
    double along;  // share of the energy along the normal
    double whole = 0, energy = 0, slope = 0;
  };
  struct Known {
    Pair pair;
    bool obstacle;
    Dual touches, along;
  };
  // Places of one trajectory in driving order. `gone` is the distance covered by the fastest point since the previous
  // place, `path` the distance covered by the origin from the start.
  struct Places {
    std::vector<double> x, y, cos, sin, time, spread, gone, path;
  };
  // Places of a spinning base, in its own frame.
  struct Spun {
    bool known = false;
    std::vector<double> x, y, turned, speed, time, spread, gone, path, cos, sin;
  };
  template <class T> struct Place {
    T x, y, cos, sin, time, spread, gone;
  };

  CoastWork(const CoastTables& of, size_t n_entity)
      : hit(n_entity),
        met(n_entity),
        met_at(n_entity),
        free(of.stop.size()),
        braked(of.stop.size()),
        met_slopes(n_entity),
        spun(of.share.size()) {
    for (auto* one : {&place.x, &place.y, &place.cos, &place.sin, &place.time, &place.spread, &place.gone, &place.path,
                      &later, &least, &stopped})
      one->resize(kSamples);
    for (Spun& one : spun)
      for (auto* values :
           {&one.x, &one.y, &one.turned, &one.speed, &one.time, &one.spread, &one.gone, &one.path, &one.cos, &one.sin})
        values->resize(kSamples);
    const size_t stops = padded(std::max<size_t>(of.stop.size(), 1));
    for (auto* one : {&share, &starts, &by_braked}) one->resize(stops);
    least_at.resize(kSamples), energy.resize(kSamples * stops);
    most_worth.resize(n_entity * stops), decided_by.resize(n_entity * stops);
    dual_place.resize(kSamples), dual_known.resize(kSamples);
  }
  // Rows are padded to the widest vectors of any instruction set.
  static constexpr size_t padded(size_t n) { return (n + 7) / 8 * 8; }
  static constexpr size_t kSamples = 64;  // largest number of places along a trajectory: one bit each

  std::vector<double> hit;       // P by entity
  std::vector<Dual> hit_slopes;  // P with derivatives, where requested

  std::vector<Near> whom, what;                  // entities, and obstacles
  size_t asked = 0;                              // number of requested entities; they come first in `whom`
  bool moving = false;                           // whether any shape moves
  std::vector<double> met;                       // by entity: probability that it has absorbed the energy
  std::vector<Pair> met_at;                      // the place and shape at which it did
  std::vector<double> free, braked;              // by stop: distance at full speed, and while slowing down
  std::vector<double> share, starts, by_braked;  // by stop: P, where it slows down, 1 / braking distance
  Places place;
  std::vector<double> later;                  // times at places at a slightly greater speed
  std::vector<double> apart, touched, along;  // by shape of `whom` and place: see Following::touches
  std::vector<uint64_t> touched_at;           // by shape of `whom`: places, as bits, at which it is touched
  uint64_t energy_at = 0;                     // places whose energies are known
  std::vector<double> energy;                 // by place and stop, relative to the reference energy of severities
  std::vector<double> least;    // by place: least distance of obstacles up to there, in standard deviations
  std::vector<double> stopped;  // probability that an obstacle has stopped the base
  std::vector<Pair> least_at;
  std::vector<double> most_worth;   // by entity and stop
  std::vector<double> decided_by;   // index in `decided` of the touch that decides it
  std::vector<int> seen, stopping;  // entities hit on this trajectory, and those that have absorbed energy
  std::vector<Decided> decided;
  std::vector<Known> known;
  std::vector<Dual> met_slopes;
  std::vector<Place<Dual>> dual_place;
  std::vector<char> dual_known;
  std::vector<Spun> spun;  // from the tables, at the speed and turning rate of the previous state
  double spun_speed = -1, spun_rate = 0;
};

// What to examine of one state, besides the shapes around it.
struct CoastQuery {
  const double* severity = nullptr;  // P is computed only for entities that have one; null: for all
  int only = -1;                     // if not negative, P is computed for this entity alone; the others are obstacles
  const Footprint2d* carried = nullptr;  // footprint of a carried object, about its centre; null: the base
};

// Kernels of one instruction set: P by entity of one state, in work.hit. Returns false if P is zero for all.
struct CoastKernels {
  bool (*hits)(const CoastTables&, const CoastState<double>&, const std::vector<FloorShape>&, const CoastQuery&,
               CoastWork&);
  bool (*hits_slopes)(const CoastTables&, const CoastState<Dual>&, const std::vector<FloorShape>&, const CoastQuery&,
                      CoastWork&);
};

extern const CoastKernels coast_kernels_baseline;
#if defined(__x86_64__)
extern const CoastKernels coast_kernels_v3;
extern const CoastKernels coast_kernels_v4;
#endif

}  // namespace gp

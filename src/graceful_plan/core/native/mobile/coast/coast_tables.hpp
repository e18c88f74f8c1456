// What the kernels of the coast model read and write.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "mobile/coast/floor_shape.hpp"

namespace gp {

// How bases fail and where they go then.
struct CoastTables {
  struct Stop {
    double p, a, k, delay;
    bool released;
    double bend;
  };
  struct Family {
    bool released;
    double bend;
    bool operator==(const Family&) const = default;
  };
  struct Stray {
    double lasts, aside, turned, spread, cos, sin;  // cosine and sine of the angle turned
  };
  static constexpr size_t kPlace = 5;

  explicit CoastTables(const Footprint2d& base) : footprint(base) {}
  bool has(const Family& one) const { return std::find(family.begin(), family.end(), one) != family.end(); }

  static constexpr double kFarOff = 6;   // spreads beyond which nothing is touched
  static constexpr double kNext = 0.05;  // how far the next moment of a base is that is astray [m]

  const Footprint2d footprint;
  std::vector<Stop> stop;
  std::vector<Family> family;
  std::vector<std::vector<size_t>> own, any;  // stops of each: its own, and those of both kinds of wheels
  std::vector<double> share, speeds, rates;
  std::vector<double> place;   // (speed, rate, table, 5, sample)
  std::vector<double> within;  // (speed, rate, table): how far off its places are
  std::vector<Stray> stray;
  size_t samples = 0;
  double unit = 1, spread = 1, drift = 0, turn = 0;
  double farthest = 0, lasts = 0;  // of all tables: how far, and for how long
  double aside = 0;                // how far beside their way bases are that are astray, blur and all
};

template <class T> struct CoastState {
  T x, y, yaw, v, omega;
  T time{0.0};  // since when those who move are where they are
};

// What is written to for each state; kept from one to the next, so that nothing is allocated.
struct CoastWork {
  // A shape that is near enough to be touched; how far the base goes at least before, with what the shape moves; and
  // how fast that is.
  struct Near {
    const FloorShape* shape;
    double clear, moves;
  };
  // Which place and shape decides something: a place along a way, and a shape of `whom` or `what`.
  struct Pair {
    int place = -1, shape = -1;
    bool operator==(const Pair&) const = default;
  };
  // What decides how much stops are worth against an entity, and what may have stopped the base before: an obstacle, or
  // whom it met. With it, over its stops: the sum of shares whose energy hits more than severities are for; of the
  // others, times their energies, and the derivative of that by the speed.
  struct Decided {
    Pair met, before;
    bool by_obstacle;
    double along;  // share of the energy that is along the normal
    double whole = 0, energy = 0, slope = 0;
  };
  struct Known {
    Pair pair;
    bool obstacle;
    Dual touches, along;
  };
  // Places of one way, in the order in which the base comes there; `gone` is how far what is fastest of it went since
  // the place before, `path` how far its middle has gone.
  struct Places {
    std::vector<double> x, y, cos, sin, time, spread, gone, path;
  };
  // The same of a base that spins, in its own frame.
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
  // Rows are as long as the widest vectors of any instruction set want them.
  static constexpr size_t padded(size_t n) { return (n + 7) / 8 * 8; }
  static constexpr size_t kSamples = 64;  // places along a way, at most: as many as bits

  std::vector<double> hit;       // P by entity
  std::vector<Dual> hit_slopes;  // with derivatives, where they are wanted

  std::vector<Near> whom, what;                  // entities, and obstacles
  size_t asked = 0;                              // how many of whom, which come first, are asked for
  bool moving = false;                           // whether any of them moves
  std::vector<double> met;                       // by entity: how likely it has taken the base's energy on this way
  std::vector<Pair> met_at;                      // where
  std::vector<double> free, braked;              // by stop: how far at full speed, and while the base slows down
  std::vector<double> share, starts, by_braked;  // of the stops of a way: P, where it slows down, 1 over how far then
  Places place;
  std::vector<double> later;                  // times at places at a slightly greater speed
  std::vector<double> apart, touched, along;  // by shape of `whom` and place: see Following::touches
  std::vector<uint64_t> touched_at;           // by shape of `whom`: places, as bits, at which it is touched
  uint64_t energy_at = 0;                     // places of which energies are known
  std::vector<double> energy;                 // by place and stop, over that at the speed that severities are for
  std::vector<double> least;    // by place: distance of obstacles up to there, as a multiple of its spread
  std::vector<double> stopped;  // how likely that has stopped the base
  std::vector<Pair> least_at;
  std::vector<double> most_worth;   // by entity and stop
  std::vector<double> decided_by;   // what of `decided` it is by
  std::vector<int> seen, stopping;  // entities that are met on this way, and those that took energy so far
  std::vector<Decided> decided;
  std::vector<Known> known;
  std::vector<Dual> met_slopes;
  std::vector<Place<Dual>> dual_place;
  std::vector<char> dual_known;
  std::vector<Spun> spun;  // of the tables, at the speed and rate of turning of the state before
  double spun_speed = -1, spun_rate = 0;
};

// One instruction set's kernels: P by entity of one state, in work.hit; with severities, of those that have one. False
// if it is zero for all. If one entity alone is asked for (`only` is not below 0), the others are there to stop the
// base before it, and P of them is not found.
struct CoastKernels {
  bool (*hits)(const CoastTables&, const CoastState<double>&, const std::vector<FloorShape>&, const double* severity,
               CoastWork&, int only);
  bool (*hits_slopes)(const CoastTables&, const CoastState<Dual>&, const std::vector<FloorShape>&,
                      const double* severity, CoastWork&, int only);
};

extern const CoastKernels coast_kernels_baseline;
#if defined(__x86_64__)
extern const CoastKernels coast_kernels_v3;
extern const CoastKernels coast_kernels_v4;
#endif

}  // namespace gp

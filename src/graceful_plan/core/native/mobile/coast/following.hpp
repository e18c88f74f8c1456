// Evaluates one state of a failing base: its trajectories and the entities it hits. Included once per instruction set,
// inside its own namespace.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "dual.hpp"
#include "lanes.hpp"
#include "mobile/coast/coast_tables.hpp"
#include "mobile/coast/floor_shape.hpp"
#include "mobile/coast/places_abreast.hpp"

namespace gp::GP_ISA {

constexpr int kLooks = 16;        // number of times at which distances to moving shapes are checked
constexpr double kSpacing = 0.1;  // between places along an arc [m]
constexpr double kFarOff = CoastTables::kFarOff, kNext = CoastTables::kNext, kStandstill = CoastTables::kStandstill;
constexpr double kNudge = 1e-6;          // speed step of a finite difference [m/s]
constexpr double kHardlyTouched = 1e-9;  // probability below which a touch is ignored
constexpr double kSlowest = 0.1;         // least share of the initial speed at which times are computed
constexpr double kUnknown = std::numeric_limits<double>::max();
constexpr double kLeast = 1e-12;  // least braking distance [m]

class Following {
  template <class T> using State = CoastState<T>;
  template <class T> using Place = CoastWork::Place<T>;
  using Near = CoastWork::Near;
  using Pair = CoastWork::Pair;
  using Decided = CoastWork::Decided;
  using Known = CoastWork::Known;

 public:
  // slopes: the same state with derivatives, if requested.
  Following(const CoastTables& of, const State<double>& at, const State<Dual>* slopes, const CoastQuery& query,
            CoastWork& work)
      : of_(of),
        at_(at),
        slopes_(slopes),
        query_(query),
        footprint_(query.carried ? *query.carried : of.footprint),
        reach_(footprint_.reach() + (query.carried ? length_of(at.along, at.across) : 0.0)),
        unit_(query.carried ? CoastTables::kHarms : of.unit),
        work_(work),
        speed_(std::fabs(at.v)),
        sign_(at.v < 0 ? -1 : 1),
        cos_(std::cos(at.yaw)),
        sin_(std::sin(at.yaw)) {}

  bool all(const std::vector<FloorShape>& shape) {
    std::fill(work_.hit.begin(), work_.hit.end(), 0.0);
    if (slopes_) work_.hit_slopes.assign(work_.hit.size(), Dual(0.0));
    // A base that turns in place harms nothing itself, but swings what it carries.
    const bool rolls = speed_ > kStandstill;
    if (!rolls && !(query_.carried && at_.omega != 0)) return false;
    double longest = 0;
    for (size_t i = 0; i < of_.stop.size(); ++i) {
      const CoastTables::Stop& stop = of_.stop[i];
      work_.free[i] = speed_ * stop.delay, work_.braked[i] = braked(stop, speed_);
      if (work_.free[i] + work_.braked[i] > far_) far_ = work_.free[i] + work_.braked[i], farthest_ = i;
      longest = std::max(longest, stop.delay + speed_ / stop.a);
    }
    look(shape, std::max(longest, of_.lasts));
    if (work_.asked == 0) return false;
    const size_t n = work_.whom.size(), values = n * (CoastWork::kSamples + 1) + 1;
    if (work_.apart.size() < values)
      work_.apart.resize(values), work_.touched.resize(values), work_.along.resize(values);
    if (work_.touched_at.size() < n) work_.touched_at.resize(n);
    // Released wheels follow the same arc as driven ones if no base would turn beyond the limit.
    const bool alike = std::fabs(at_.omega / at_.v) * far_ <= of_.turn * at_.omega * at_.omega;
    for (size_t f = 0; f < of_.family.size(); ++f) {
      const CoastTables::Family& family = of_.family[f];
      if (alike && family.released && of_.has({false, family.bend})) continue;
      // A base that cannot turn leaves its path where it should turn, at the rate of turning.
      rate_ = family.weak ? std::fabs(at_.omega) : 1.0;
      if (slopes_) rate_slopes_ = family.weak ? size_of(slopes_->omega) : Dual(1.0);
      if (rolls && rate_ > 0) along_arc(family, alike ? of_.any[f] : of_.own[f]);
    }
    rate_ = 1.0, rate_slopes_ = Dual(1.0);
    tabulated();
    // Drifting bases hold what they carry over their path; it is not swung.
    if (!query_.carried && !of_.stray.empty() && gap_ < of_.aside) {
      astray();
      if (slopes_) astray_slopes();
    }
    for (double& hit : work_.hit) hit = std::min(1.0, hit);
    if (slopes_)
      for (Dual& hit : work_.hit_slopes) hit = smaller(Dual(1.0), hit);
    return true;
  }

 private:
  // --- nearby shapes ------------------------------------------------------------------------------------------------

  static GP_INLINE double blur_of(double spread, const FloorShape& shape) {
    return shape.spread > 0 ? length_of(spread, shape.spread) : spread;
  }
  // Collects the shapes that may be touched, and a lower bound (gap_) on the distance to the nearest requested entity,
  // less kFarOff spreads.
  void look(const std::vector<FloorShape>& shape, double longest) {
    const double *severity = query_.severity, reach = reach_, far = std::max(far_, of_.farthest);
    const int only = query_.only;
    const double most = std::max(far, of_.aside) + reach + kFarOff * length_of(of_.spread, of_.drift * far_);
    work_.whom.clear(), work_.what.clear(), work_.moving = false, work_.asked = 0;
    for (const FloorShape& one : shape) {
      if (one.entity >= 0 && severity && !(severity[one.entity] > 0)) continue;
      const double moves = one.speed(), d = one.distance(at_.x, at_.y, 0.0);
      if (d >= most + moves * longest + kFarOff * one.spread) continue;
      work_.moving |= moves > 0;
      const Near near{&one, clear(d - reach - kFarOff * blur_of(of_.spread, one)), moves};
      if (one.entity < 0) {
        work_.what.push_back(near);
        continue;
      }
      work_.whom.push_back(near);
      if (only >= 0 && one.entity != only) continue;
      // Requested entities come first.
      std::swap(work_.whom.back(), work_.whom[work_.asked++]);
      double least = d;
      const double step = longest / kLooks;
      for (int k = 1; moves > 0 && k < kLooks; ++k) least = std::min(least, one.distance(at_.x, at_.y, step * k));
      const double spread = root(square(of_.spread) + square(of_.drift * far) + square(one.spread));
      gap_ = std::min(gap_, least - moves * step - reach - kFarOff * spread);
    }
  }
  // Least distance a base covers before it touches a shape at a clearance of `room` beyond reach and blur; the blur
  // grows on the way.
  GP_INLINE double clear(double room) const { return room / (1 + kFarOff * of_.drift); }
  static GP_INLINE double square(double x) { return x * x; }

  static Dual distance(const Footprint2d& base, const FloorShape& shape, const Place<Dual>& place) {
    Dual d;
    distance(base, shape, place, d);
    return d;
  }
  static __attribute__((noinline)) void distance(const Footprint2d& base, const FloorShape& shape,
                                                 const Place<Dual>& place, Dual& d) {
    d = base.distance(shape, place.x, place.y, place.cos, place.sin, place.time);
  }
  template <class T> static GP_INLINE T blur(const FloorShape& shape, const T& spread) {
    return shape.spread > 0 ? length_of(spread, T(shape.spread)) : spread;
  }
  // Probability that a shape at this distance is touched.
  template <class T> static GP_INLINE T touch(const T& apart, const T& blur) {
    if (value_of(apart) > kFarOff * value_of(blur)) return T(0.0);
    return 0.5 * complementary_error(T(apart / blur * 0.7071067811865476));
  }
  // Share of the energy along the contact normal; `closing` is the decrease of the distance per distance driven. For
  // entities that are small compared with the blur, the normal is unknown, and half of the energy counts.
  template <class T> static GP_INLINE T normal_share(const T& closing, const FloorShape& shape, const T& blur) {
    const T along = gp::between(closing, 0.0, 1.0);
    const double size = shape.around();
    const T unknown = blur * blur / (blur * blur + size * size);
    return (1 - unknown) * along * along + 0.5 * unknown;
  }

  // --- along an arc -------------------------------------------------------------------------------------------------

  // Trajectory of a failing base: its curvature, the largest angle it turns, its speed, and its length.
  template <class T> struct Way {
    T bend, most, speed, far;
  };
  template <class T> Way<T> way(const State<T>& at, const CoastTables::Family& family, const T& far) const {
    const T turns = family.released ? of_.turn * at.omega * at.omega : T(kUnknown);
    return {family.weak ? T(0.0) : T(at.omega / at.v * sign_ + family.bend), turns, size_of(at.v), far};
  }
  template <class T> static GP_INLINE T braked(const CoastTables::Stop& stop, const T& speed) {
    if (stop.k > 0) return speed / stop.k - stop.a / (stop.k * stop.k) * log_of_one_plus(T(stop.k * speed / stop.a));
    return speed * speed / (2 * stop.a);
  }
  // Derivative of `braked` with respect to speed.
  static double braked_slope(const CoastTables::Stop& stop, double speed) { return speed / (stop.a + stop.k * speed); }

  void along_arc(const CoastTables::Family& family, const std::vector<size_t>& stops) {
    double goes = 0;
    for (const size_t i : stops) goes = std::max(goes, work_.free[i] + work_.braked[i]);
    if (gap_ > goes) return;
    n_stop_ = stops.size(), row_ = CoastWork::padded(n_stop_);
    for (size_t s = 0; s < row_; ++s) {
      const size_t i = stops[std::min(s, n_stop_ - 1)];
      work_.share[s] = s < n_stop_ ? of_.stop[i].p : 0.0, work_.starts[s] = work_.free[i];
      work_.by_braked[s] = 1 / std::max(work_.braked[i], kLeast);
    }
    const Way<double> way = this->way(at_, family, far_);
    arc_places(way, goes);
    if (work_.moving) times(way);
    if (query_.carried) carry();
    meet();
    if (!slopes_ || work_.decided.empty()) return;
    const CoastTables::Stop& last = of_.stop[farthest_];
    const Dual v = size_of(slopes_->v);
    const double far_slope = last.delay + braked_slope(last, speed_);
    const Way<Dual> along = this->way(*slopes_, family, v.through(far_, far_slope));
    if (work_.moving) later(way, stops);
    arc_slopes(stops, far_slope);
    pull([&](int k, Place<Dual>& out) { arc_place(along, k, out), carry(out); },
         [&](const Decided& one, Dual& out) { out = v.through(one.energy, one.slope); });
  }
  template <class T> static GP_INLINE T done(const T& far, int k) { return smaller(far, T(kSpacing * k)); }
  // A shape touched at a place may have been hit anywhere since the previous place; the midpoint is used.
  static GP_INLINE double half_done(double far, int k) {
    return k == 0 ? 0.0 : 0.5 * (done(far, k) + kSpacing * (k - 1));
  }
  // Places along an arc and the straight part after it, up to the farthest of its stops. At least two places are
  // computed, because they give the direction of travel. Rotation by a constant angle per step avoids sines.
  void arc_places(const Way<double>& way, double goes) {
    const double arc = std::fabs(way.bend) > 0 ? way.most / std::fabs(way.bend) : kUnknown;
    const double step = 0.5 * way.bend * kSpacing, c1 = std::cos(step), s1 = std::sin(step);
    double c = 1, s = 0, regular_c = 1, regular_s = 0, turned_for = 0;
    CoastWork::Places& at = work_.place;
    size_t n = 0;
    for (int k = 0; k < int(CoastWork::kSamples) && kSpacing * (k - 1) < way.far; ++k, ++n) {
      if (k > 1 && half_done(way.far, k) >= goes) break;
      const double all = done(way.far, k), curved = std::min(all, arc), straight = all - curved;
      const double half = 0.5 * way.bend * curved;
      if (curved == kSpacing * k) {
        c = regular_c, s = regular_s;
        regular_c = c * c1 - s * s1, regular_s = s * c1 + c * s1;
      } else if (curved != turned_for) {
        c = std::cos(half), s = std::sin(half);
      }
      turned_for = curved;
      const double chord = sign_ * curved * (std::fabs(half) > 1e-9 ? s / half : 1.0), along = sign_ * straight;
      const double c2 = c * c - s * s, s2 = 2 * s * c;
      at.cos[n] = cos_ * c2 - sin_ * s2, at.sin[n] = sin_ * c2 + cos_ * s2;
      at.x[n] = at_.x + chord * (cos_ * c - sin_ * s) + along * at.cos[n];
      at.y[n] = at_.y + chord * (sin_ * c + cos_ * s) + along * at.sin[n];
      at.time[n] = at_.time, at.spread[n] = length_of(of_.spread, of_.drift * all);
      at.gone[n] = k > 0 ? all - done(way.far, k - 1) : all;
      at.path[n] = all;
    }
    n_place_ = n;
    work_.energy_at = 0;
    whole_ = speed_ * speed_ / (unit_ * unit_), arc_far_ = way.far;
  }
  // Remaining share of the energy of a base in one stop.
  GP_INLINE double left(double met, size_t s) const {
    return std::min(1.0, std::max(0.0, 1 - (met - work_.starts[s]) * work_.by_braked[s]));
  }
  // Times at the places, from the mean remaining energy of the stops that still move. Needed for moving entities only.
  void times(const Way<double>& way) {
    double time = at_.time;
    for (size_t k = 0; k < n_place_; ++k) {
      double moving = 0, left_of = 0;
      for (size_t s = 0; s < n_stop_; ++s) {
        const double part = left(half_done(way.far, int(k)), s);
        moving += part > 0 ? work_.share[s] : 0, left_of += work_.share[s] * part;
      }
      const double slower = moving > 0 ? std::sqrt(left_of / moving) : 0.0;
      work_.place.time[k] = time += work_.place.gone[k] / (way.speed * std::max(slower, kSlowest));
    }
  }
  // Times at the same places at a slightly greater speed, for the derivative of times with respect to speed.
  void later(const Way<double>& way, const std::vector<size_t>& stops) {
    const double faster = way.speed + kNudge;
    double time = 0;
    for (size_t k = 0; k < n_place_; ++k) {
      double moving = 0, left_of = 0;
      for (size_t s = 0; s < n_stop_; ++s) {
        const double free = work_.starts[s] * faster / way.speed;
        const CoastTables::Stop& stop = of_.stop[stops[s]];
        const double part =
            gp::between(1 - (half_done(way.far, int(k)) - free) / std::max(braked(stop, faster), kLeast), 0.0, 1.0);
        if (part > 0) moving += work_.share[s], left_of += work_.share[s] * part;
      }
      const double slower = moving > 0 ? std::sqrt(left_of / moving) : 0.0;
      work_.later[k] = time += work_.place.gone[k] / (faster * std::max(slower, kSlowest));
    }
  }
  const double* energy(size_t k) {
    double* row = work_.energy.data() + k * row_;
    if (work_.energy_at >> k & 1) return row;
    work_.energy_at |= uint64_t(1) << k;
    const double met = half_done(arc_far_, int(k));
    for (size_t s = 0; s < row_; s += kAbreastPlaces) {
      const D part = 1 - (met - load_row(&work_.starts[s])) * load_row(&work_.by_braked[s]);
      store_row(minimum(relu(part), D{} + 1.0) * whole_, row + s);
    }
    return row;
  }
  // Derivatives of the deciding energies with respect to speed.
  void arc_slopes(const std::vector<size_t>& stops, double far_slope) {
    for (const int e : work_.seen)
      for (size_t s = 0; s < n_stop_; ++s) {
        const int by = int(work_.decided_by[size_t(e) * row_ + s]);
        if (by < 0) continue;
        Decided& one = work_.decided[size_t(by)];
        const int k = one.met.place;
        const double value = energy(size_t(k))[s], p = work_.share[s];
        if (value * one.along >= 1) {
          one.whole += p;
          continue;
        }
        one.energy += p * value;
        const double half = k > 0 && arc_far_ <= kSpacing * k ? 0.5 * far_slope : 0.0;
        const double met = half_done(arc_far_, k) - work_.starts[s], by_braked = work_.by_braked[s];
        const double part = 1 - met * by_braked;
        if (part < 0) continue;
        const CoastTables::Stop& stop = of_.stop[stops[s]];
        const double slope =
            part > 1 ? 0.0 : (met * by_braked * braked_slope(stop, speed_) - (half - stop.delay)) * by_braked;
        one.slope += p * (slope * whole_ + 2 * value / speed_);
      }
  }
  void arc_place(const Way<Dual>& way, int k, Place<Dual>& out) const {
    const State<Dual>& q = *slopes_;
    const bool bends = std::fabs(value_of(way.bend)) > 0;
    const Dual arc = bends ? way.most / size_of(way.bend) : Dual(kUnknown);
    const Dual before = done(way.far, k - 1), all = done(way.far, k);
    const Dual curved = smaller(all, arc), straight = all - curved;
    const Dual turned = way.bend * curved, half = 0.5 * turned;
    // Reuses the sines and cosines from `arc_places`.
    const double ch = work_.place.cos[size_t(k)], sh = work_.place.sin[size_t(k)], h = half.value();
    const double c = std::cos(h), s = std::sin(h), cm = cos_ * c - sin_ * s, sm = sin_ * c + cos_ * s;
    const Dual ratio = std::fabs(h) > 1e-9 ? half.through(s / h, (c - s / h) / h) : Dual(1.0);
    const Dual chord = sign_ * curved * ratio, heading = q.yaw + turned, middle = q.yaw + half;
    out.cos = heading.through(ch, -sh), out.sin = heading.through(sh, ch);
    out.x = q.x + chord * middle.through(cm, -sm) + sign_ * straight * out.cos;
    out.y = q.y + chord * middle.through(sm, cm) + sign_ * straight * out.sin;
    out.time = q.time;
    if (work_.moving) {
      const double time = work_.place.time[size_t(k)] - at_.time;
      out.time += size_of(q.v).through(time, (work_.later[size_t(k)] - time) / kNudge);
    }
    out.spread = length_of(Dual(of_.spread), Dual(of_.drift * all));
    out.gone = k > 0 ? all - before : all;
  }

  // --- carried objects ----------------------------------------------------------------------------------------------

  // Moves the places of the base to those of the object that it carries, and replaces the distances by those which the
  // object covers: more than the base where that turns.
  void carry() {
    CoastWork::Places& at = work_.place;
    double path = 0, x = 0, y = 0;
    for (size_t k = 0; k < n_place_; ++k) {
      at.x[k] += at.cos[k] * at_.along - at.sin[k] * at_.across;
      at.y[k] += at.sin[k] * at_.along + at.cos[k] * at_.across;
      if (k > 0) at.gone[k] = length_of(at.x[k] - x, at.y[k] - y);
      at.path[k] = path += k > 0 ? at.gone[k] : 0.0;
      x = at.x[k], y = at.y[k];
    }
  }
  void carry(Place<Dual>& out) const {
    if (!query_.carried) return;
    const State<Dual>& q = *slopes_;
    out.x += out.cos * q.along - out.sin * q.across;
    out.y += out.sin * q.along + out.cos * q.across;
  }

  // --- hits along a trajectory --------------------------------------------------------------------------------------

  // The places from k on, one per lane.
  GP_INLINE PlaceLanes places_from(size_t k) const {
    const CoastWork::Places& at = work_.place;
    return {load_row(&at.x[k]), load_row(&at.y[k]), load_row(&at.cos[k]), load_row(&at.sin[k]), load_row(&at.time[k])};
  }
  // Repeats the last place until rows are full.
  void pad() {
    CoastWork::Places& at = work_.place;
    for (size_t k = n_place_; k % kAbreastPlaces > 0; ++k)
      for (auto* one : {&at.x, &at.y, &at.cos, &at.sin, &at.time, &at.spread, &at.gone, &at.path})
        (*one)[k] = (*one)[n_place_ - 1];
  }
  GP_INLINE bool stays_clear(double clear, double moves, size_t places) const {
    return work_.place.path[places - 1] + moves * work_.place.time[places - 1] < clear;
  }
  // Path length up to which a shape stays untouched, given its clearance at the last of the places from k on.
  GP_INLINE double clear_after(size_t k, double moves, const D& room) const {
    const size_t lane = kAbreastPlaces - 1;
    return work_.place.path[k + lane] + moves * work_.place.time[k + lane] + clear(room[lane]);
  }
  // Distances from the centre of the base to a shape, less the reach of the base.
  GP_INLINE D beyond(const FloorShape& shape, const PlaceLanes& at) const {
    const D dx = at.x - shape.x - shape.vx * at.time, dy = at.y - shape.y - shape.vy * at.time;
    const D along = shape.ux * dx + shape.uy * dy, across = shape.ux * dy - shape.uy * dx;
    return from_rectangle(shape.a, shape.b, along, across) - (shape.round + footprint_.reach());
  }
  GP_INLINE D blurs(const FloorShape& shape, size_t k) const {
    const D spread = load_row(&work_.place.spread[k]);
    return shape.spread > 0 ? hypotenuse(spread, D{} + shape.spread) : spread;
  }
  // Computes, for the entities from first to before end, the probability of a touch at the first `places` places and
  // the share of the energy along the normal there, from how fast the distance closes per distance driven. Returns, as
  // bits, the places at which any entity is touched.
  uint64_t touches(size_t first, size_t end, size_t places) {
    const size_t all = CoastWork::kSamples + 1;
    uint64_t at_all = 0;
    for (size_t j = first; j < end; ++j) {
      const FloorShape& who = *work_.whom[j].shape;
      const double moves = work_.whom[j].moves;
      double clear = work_.whom[j].clear;
      work_.touched_at[j] = 0;
      if (stays_clear(clear, moves, places)) continue;
      double* apart = &work_.apart[j * all + 1];  // the element before the first place is extrapolated
      uint64_t near = 0, known = 0;
      // Distances are exact up to this cut. Beyond it a shape cannot be touched even one place later, so it closes in
      // head on.
      const auto measure = [&](size_t k, const PlaceLanes& at) {
        if (known >> k & 1) return;
        known |= uint64_t(1) << k;
        store_row(apart_abreast(footprint_, who, at, D{} + (kFarOff * blur_of(widest_, who) + strides_)), apart + k);
      };
      for (size_t k = 0; k < places; k += kAbreastPlaces) {
        if (stays_clear(clear, moves, std::min(k + kAbreastPlaces, places))) continue;
        const PlaceLanes at = places_from(k);
        const D room = beyond(who, at) - kFarOff * blurs(who, k);
        const int lanes = lanes_below(room, D{});
        if (lanes == 0) {
          clear = clear_after(k, moves, room);
          continue;
        }
        near |= uint64_t(lanes) << k;
        if (k > 0 && lanes & 1) measure(k - kAbreastPlaces, places_from(k - kAbreastPlaces));
        measure(k, at);
      }
      if (places < CoastWork::kSamples) near &= (uint64_t(1) << places) - 1;
      if (near == 0) continue;
      apart[-1] = n_place_ > 1 ? 2 * apart[0] - apart[1] : apart[0];
      const double size = who.around();
      for (size_t k = 0; k < places; k += kAbreastPlaces) {
        const uint64_t lanes = near >> k & ((uint64_t(1) << kAbreastPlaces) - 1);
        if (lanes == 0) continue;
        const D d = load_row(apart + k), blur = blurs(who, k), ratio = d / blur;
        const D likely = ratio <= kFarOff ? upper_tail(ratio) : D{};
        D gone = load_row(&work_.place.gone[k]);
        if (k == 0 && n_place_ > 1) gone[0] = gone[1];
        const D closing = (load_row(apart + k - 1) - d) / maximum(gone, D{} + kHardlyTouched);
        const D straight = minimum(relu(closing), D{} + 1.0), unknown = blur * blur / (blur * blur + size * size);
        store_row(likely, &work_.touched[j * all + k]);
        store_row((1.0 - unknown) * straight * straight + 0.5 * unknown, &work_.along[j * all + k]);
        work_.touched_at[j] |= (uint64_t(lanes_below(D{} + kHardlyTouched, likely)) & lanes) << k;
      }
      at_all |= work_.touched_at[j];
    }
    return at_all;
  }
  // Computes, at each of the first places, the least distance of any obstacle up to there, in standard deviations, and
  // the probability that an obstacle has stopped the base.
  void obstacles(size_t last) {
    std::fill_n(work_.least.begin(), (last + kAbreastPlaces - 1) / kAbreastPlaces * kAbreastPlaces, kFarOff);
    std::fill_n(work_.least_at.begin(), last, Pair{});
    for (size_t j = 0; j < work_.what.size(); ++j) {
      const FloorShape& what = *work_.what[j].shape;
      const double moves = work_.what[j].moves;
      double clear = work_.what[j].clear;
      if (stays_clear(clear, moves, last)) continue;
      for (size_t k = 0; k < last; k += kAbreastPlaces) {
        if (stays_clear(clear, moves, std::min(k + kAbreastPlaces, last))) continue;
        const PlaceLanes at = places_from(k);
        const D blur = blurs(what, k), away = beyond(what, at), most = load_row(&work_.least[k]) * blur;
        if (!any_below(away, most)) {
          if (any_below(away, kFarOff * blur)) continue;
          clear = clear_after(k, moves, away - kFarOff * blur);
          continue;
        }
        const D apart = apart_abreast(footprint_, what, at, most), ratio = apart / blur;
        int nearer = lanes_below(apart, most);
        for (; nearer; nearer &= nearer - 1) {
          const size_t lane = size_t(__builtin_ctz(unsigned(nearer)));
          for (size_t m = k + lane; m < last && ratio[lane] < work_.least[m]; ++m)
            work_.least[m] = ratio[lane], work_.least_at[m] = {int(k + lane), int(j)};
        }
      }
    }
    for (size_t k = 0; k < last; k += kAbreastPlaces) {
      const D least = load_row(&work_.least[k]);
      store_row(least < kFarOff ? upper_tail(least) : D{}, &work_.stopped[k]);
    }
  }
  // Adds to work.hit the expected severity shares of hits along a trajectory before an obstacle stops the base. Each
  // stop counts with its worst touch, because one goes farther than another. Obstacles are evaluated only up to the
  // last touched entity.
  void meet() {
    work_.decided.clear(), work_.seen.clear();
    if (n_place_ == 0) return;
    pad();
    D widest{}, strides{};
    for (size_t k = 0; k < n_place_; k += kAbreastPlaces)
      widest = maximum(widest, load_row(&work_.place.spread[k])),
      strides = maximum(strides, load_row(&work_.place.gone[k]));
    widest_ = greatest_lane(widest), strides_ = greatest_lane(strides);
    const size_t n = work_.whom.size(), all = CoastWork::kSamples + 1;
    uint64_t touched = touches(0, work_.asked, n_place_);
    if (touched == 0) return;
    const size_t last = 64 - size_t(__builtin_clzll(touched));
    touched |= touches(work_.asked, n, last);
    obstacles(last);
    std::fill(work_.met.begin(), work_.met.end(), 0.0), std::fill(work_.met_at.begin(), work_.met_at.end(), Pair{});
    for (; touched; touched &= touched - 1) {
      const size_t k = size_t(__builtin_ctzll(touched));
      const uint64_t here = uint64_t(1) << k;
      const double stopped = work_.stopped[k];
      if (stopped >= 1 - kHardlyTouched) break;
      for (size_t j = 0; j < n; ++j) {
        if (!(work_.touched_at[j] & here) || j >= work_.asked) continue;
        const FloorShape& who = *work_.whom[j].shape;
        double before = stopped;  // entities hit earlier stop the base as well
        Decided decided{{int(k), int(j)}, work_.least_at[k], true, work_.along[j * all + k]};
        for (const int other : work_.stopping) {
          if (other == who.entity || work_.met[size_t(other)] <= before) continue;
          before = work_.met[size_t(other)];
          decided.before = work_.met_at[size_t(other)], decided.by_obstacle = false;
        }
        raise(decided, size_t(who.entity), k, (1 - before) * work_.touched[j * all + k]);
      }
      for (size_t j = 0; j < n; ++j) {
        if (!(work_.touched_at[j] & here)) continue;
        const size_t own = size_t(work_.whom[j].shape->entity);
        const double stops = work_.touched[j * all + k] * work_.along[j * all + k];
        if (stops <= work_.met[own]) continue;
        if (work_.met[own] == 0) work_.stopping.push_back(int(own));
        work_.met[own] = stops, work_.met_at[own] = {int(k), int(j)};
      }
    }
    work_.stopping.clear();
    for (const int e : work_.seen) {
      const double* worth = work_.most_worth.data() + size_t(e) * row_;
      double sum = 0;
      for (size_t s = 0; s < n_stop_; ++s) sum += work_.share[s] * worth[s];
      work_.hit[size_t(e)] += rate_ * sum;
    }
  }
  // Raises the worth of stops against an entity to that of this touch, where it is greater.
  void raise(const Decided& decided, size_t entity, size_t k, double reaches) {
    double *most = work_.most_worth.data() + entity * row_, *by = work_.decided_by.data() + entity * row_;
    if (std::find(work_.seen.begin(), work_.seen.end(), int(entity)) == work_.seen.end()) {
      work_.seen.push_back(int(entity));
      std::fill_n(most, row_, 0.0), std::fill_n(by, row_, -1.0);
    }
    const double* energy = this->energy(k);
    const double number = double(work_.decided.size());
    int more = 0;
    for (size_t s = 0; s < row_; s += kAbreastPlaces) {
      const D worth = minimum(D{} + 1.0, load_row(energy + s) * decided.along) * reaches, known = load_row(most + s);
      const int lanes = lanes_below(known, worth);
      if (lanes == 0) continue;
      more |= lanes;
      store_row(maximum(known, worth), most + s);
      store_row(known < worth ? D{} + number : load_row(by + s), by + s);
    }
    if (more && slopes_) work_.decided.push_back(decided);
  }
  // Adds to work.hit_slopes the derivatives of the result of meet(), from the deciding touches alone. Places and
  // energies with derivatives are provided by place(k, out) and energy(decided, out).
  template <class PlaceOf, class Energy> void pull(const PlaceOf& place, const Energy& energy) {
    work_.known.clear();
    std::fill_n(work_.dual_known.begin(), n_place_, 0);
    const auto at = [&](int k) -> const Place<Dual>& {
      Place<Dual>& out = work_.dual_place[size_t(k)];
      if (!work_.dual_known[size_t(k)]) work_.dual_known[size_t(k)] = 1, place(k, out);
      return out;
    };
    const auto known = [&](const Pair& pair, bool obstacle) -> size_t {
      for (size_t i = 0; i < work_.known.size(); ++i)
        if (work_.known[i].pair == pair && work_.known[i].obstacle == obstacle) return i;
      const FloorShape& who = *(obstacle ? work_.what : work_.whom)[size_t(pair.shape)].shape;
      const int to = std::max(pair.place, 1);
      const Place<Dual>& here = at(pair.place);
      const Dual apart = distance(footprint_, who, here), spread = blur(who, here.spread);
      Known one{pair, obstacle, touch(apart, spread), Dual(0.0)};
      if (!obstacle && n_place_ > 1) {
        const Dual from = pair.place > 0 ? distance(footprint_, who, at(to - 1)) : apart;
        const Dual there = pair.place > 0 ? apart : distance(footprint_, who, at(to));
        Dual gone = at(to).gone;
        if (query_.carried) gone = length_of(at(to).x - at(to - 1).x, at(to).y - at(to - 1).y);
        one.along = normal_share(Dual((from - there) / larger(gone, Dual(kHardlyTouched))), who, spread);
      } else if (!obstacle) {
        one.along = normal_share(Dual(0.0), who, spread);
      }
      work_.known.push_back(one);
      return work_.known.size() - 1;
    };
    for (const Decided& decided : work_.decided) {
      if (decided.whole == 0 && decided.energy == 0 && decided.slope == 0) continue;
      const size_t met = known(decided.met, false);
      Dual reaches = work_.known[met].touches;
      if (decided.before.place >= 0) {
        const Known& before = work_.known[known(decided.before, decided.by_obstacle)];
        reaches = reaches * (1 - (decided.by_obstacle ? before.touches : before.touches * before.along));
      }
      Dual worth;
      energy(decided, worth);
      const size_t entity = size_t(work_.whom[size_t(decided.met.shape)].shape->entity);
      work_.hit_slopes[entity] += rate_slopes_ * ((worth * work_.known[met].along + decided.whole) * reaches);
    }
  }

  // --- spinning bases -----------------------------------------------------------------------------------------------

  // Places interpolated from tables by speed and turning rate; driving backwards is driving forwards, rotated by pi.
  void tabulated() {
    if (of_.share.empty() || gap_ > of_.farthest) return;
    const Node<double> v = node(of_.speeds, speed_), w = node(of_.rates, at_.omega);
    // States of a batch often differ only in place and time.
    if (work_.spun_speed != speed_ || work_.spun_rate != at_.omega)
      for (CoastWork::Spun& one : work_.spun) one.known = false;
    work_.spun_speed = speed_, work_.spun_rate = at_.omega;
    CoastWork::Places& at = work_.place;
    for (size_t f = 0; f < of_.share.size(); ++f) {
      double within = 0;
      for (size_t corner = 0; corner < 4; ++corner) within = std::max(within, of_.within[row_of(v, w, corner, f)]);
      if (gap_ > within) continue;
      CoastWork::Spun& spun = work_.spun[f];
      if (!spun.known) spin(v, w, f, spun);
      const double c = sign_ * cos_, s = sign_ * sin_;
      n_place_ = of_.samples, n_stop_ = 1, row_ = CoastWork::padded(1);
      for (size_t k = 0; k < n_place_; ++k) {
        at.x[k] = at_.x + c * spun.x[k] - s * spun.y[k], at.y[k] = at_.y + s * spun.x[k] + c * spun.y[k];
        at.time[k] = at_.time + spun.time[k], at.spread[k] = spun.spread[k], at.gone[k] = spun.gone[k];
      }
      for (size_t k = 0; k < n_place_; ++k) {
        at.cos[k] = cos_ * spun.cos[k] - sin_ * spun.sin[k], at.sin[k] = sin_ * spun.cos[k] + cos_ * spun.sin[k];
        at.path[k] = spun.path[k], work_.energy[k * row_] = square(spun.speed[k] / unit_);
      }
      if (query_.carried) carry();
      work_.energy_at = ~uint64_t(0);
      std::fill_n(work_.share.begin(), row_, 0.0);
      work_.share[0] = of_.share[f];
      meet();
      if (!slopes_ || work_.decided.empty()) continue;
      spun_slopes(f);
    }
  }
  void spun_slopes(size_t f) {
    for (const int e : work_.seen) {
      const int by = int(work_.decided_by[size_t(e) * row_]);
      if (by < 0) continue;
      Decided& one = work_.decided[size_t(by)];
      const bool whole = work_.energy[size_t(one.met.place) * row_] * one.along >= 1;
      (whole ? one.whole : one.energy) += work_.share[0];
    }
    const Dual speed = size_of(slopes_->v);
    const Node<Dual> v = node(of_.speeds, speed), w = node(of_.rates, slopes_->omega);
    pull([&](int k, Place<Dual>& out) { spun_place(v, w, f, size_t(k), out), carry(out); },
         [&](const Decided& one, Dual& out) {
           if (one.energy == 0) return;
           const Dual fast = interpolated(v, w, f, 3, size_t(one.met.place));
           out = one.energy / (unit_ * unit_) * (fast * fast);
         });
  }
  template <class T> struct Node {
    size_t low;
    T part;
  };
  template <class T> static Node<T> node(const std::vector<double>& grid, const T& value) {
    const size_t last = grid.size() - 1;
    const size_t above = size_t(std::upper_bound(grid.begin(), grid.end(), value_of(value)) - grid.begin());
    const size_t low = std::min(above > 0 ? above - 1 : 0, last - 1);
    return {low, gp::between(T((value - grid[low]) / (grid[low + 1] - grid[low])), 0.0, 1.0)};
  }
  template <class T> size_t row_of(const Node<T>& v, const Node<T>& w, size_t corner, size_t table) const {
    const size_t cell = (v.low + corner / 2) * of_.rates.size() + w.low + corner % 2;
    return cell * of_.share.size() + table;
  }
  template <class T> static GP_INLINE T weight(const Node<T>& v, const Node<T>& w, size_t corner) {
    return (corner / 2 ? v.part : 1 - v.part) * (corner % 2 ? w.part : 1 - w.part);
  }
  void spin(const Node<double>& v, const Node<double>& w, size_t f, CoastWork::Spun& out) const {
    const size_t n = of_.samples;
    double* to[] = {out.x.data(), out.y.data(), out.turned.data(), out.speed.data(), out.time.data()};
    const double* from[4];
    double part[4];
    for (size_t corner = 0; corner < 4; ++corner) {
      from[corner] = of_.place.data() + row_of(v, w, corner, f) * CoastTables::kPlace * n;
      part[corner] = weight(v, w, corner);
    }
    for (size_t m = 0; m < CoastTables::kPlace; ++m)
      for (size_t k = 0; k < n; ++k)
        to[m][k] = part[0] * from[0][m * n + k] + part[1] * from[1][m * n + k] + part[2] * from[2][m * n + k] +
                   part[3] * from[3][m * n + k];
    for (size_t k = 0; k < n; ++k)
      out.spread[k] = root(square(of_.spread) + square(of_.drift) * (square(out.x[k]) + square(out.y[k])));
    for (size_t k = 0; k < n; k += kAbreastPlaces) {
      D sine, cosine;
      sine_cosine(load_row(&out.turned[k]), sine, cosine);
      store_row(cosine, &out.cos[k]), store_row(sine, &out.sin[k]);
    }
    double* chord = out.gone.data();  // temporarily; replaced by the distances of the fastest point below
    for (size_t k = 1; k < n; ++k) chord[k] = length_of(out.x[k] - out.x[k - 1], out.y[k] - out.y[k - 1]);
    out.path[0] = length_of(out.x[0], out.y[0]);
    for (size_t k = 1; k < n; ++k) out.path[k] = out.path[k - 1] + chord[k];
    out.gone[0] = 0;
    for (size_t k = 1; k < n; ++k) out.gone[k] = out.speed[k] * (out.time[k] - out.time[k - 1]);
    out.known = true;
  }
  Dual interpolated(const Node<Dual>& v, const Node<Dual>& w, size_t f, size_t column, size_t k) const {
    const double a = v.part.value(), b = w.part.value();
    double from[4];
    for (size_t corner = 0; corner < 4; ++corner)
      from[corner] = of_.place[(row_of(v, w, corner, f) * CoastTables::kPlace + column) * of_.samples + k];
    const double low = from[0] + b * (from[1] - from[0]), high = from[2] + b * (from[3] - from[2]);
    const double by_w = (1 - a) * (from[1] - from[0]) + a * (from[3] - from[2]);
    Dual y(v.part.a * (high - low) + w.part.a * by_w);
    y.a[0] = low + a * (high - low);
    return y;
  }
  void spun_place(const Node<Dual>& v, const Node<Dual>& w, size_t f, size_t k, Place<Dual>& out) const {
    const State<Dual>& q = *slopes_;
    const auto column = [&](size_t m) { return interpolated(v, w, f, m, k); };
    const Dual x = column(0), y = column(1), time = column(4), far = length_of(x, y);
    const Dual c = sign_ * q.yaw.through(cos_, -sin_), s = sign_ * q.yaw.through(sin_, cos_);
    const Dual heading = q.yaw + column(2);
    const double ch = work_.place.cos[k], sh = work_.place.sin[k];
    out.x = q.x + c * x - s * y, out.y = q.y + s * x + c * y;
    out.cos = heading.through(ch, -sh), out.sin = heading.through(sh, ch);
    out.time = q.time + time, out.spread = length_of(Dual(of_.spread), Dual(of_.drift * far));
    out.gone = k == 0 ? Dual(0.0) : column(3) * (time - interpolated(v, w, f, 4, k - 1));
  }

  // --- drifting bases -----------------------------------------------------------------------------------------------

  // Bases that began to drift earlier and are now beside their path: probability of touching an entity within the next
  // step and not yet, times the rate of such bases. Integrated along a path, this is the total probability of a hit.
  void astray() {
    const double step = sign_ * kNext, half = 0.5 * at_.omega / speed_ * kNext, ch = std::cos(half),
                 sh = std::sin(half);
    const double whole = speed_ * speed_ / (of_.unit * of_.unit);
    const size_t n = of_.stray.size();
    for (size_t first = 0; first < n; first += kAbreastPlaces) {
      double row[5][kAbreastPlaces];
      double nearest = std::numeric_limits<double>::infinity();
      for (size_t i = 0; i < kAbreastPlaces; ++i) {
        const CoastTables::Stray& one = of_.stray[std::min(first + i, n - 1)];
        row[0][i] = one.aside, row[1][i] = one.cos, row[2][i] = sign_ * one.sin, row[3][i] = one.spread;
        row[4][i] = first + i < n ? one.lasts * speed_ / kNext : 0.0;
        nearest = std::min(nearest, gap_ - std::fabs(one.aside) - kNext - kFarOff * one.spread);
      }
      if (nearest > 0) continue;
      const D aside = load_row(row[0]), turned_c = load_row(row[1]), turned_s = load_row(row[2]);
      const D spread = load_row(row[3]), time = D{} + at_.time;
      const D c = cos_ * turned_c - sin_ * turned_s, s = sin_ * turned_c + cos_ * turned_s;
      const PlaceLanes now{at_.x - aside * sin_, at_.y + aside * cos_, c, s, time};
      const PlaceLanes between{at_.x - 0.5 * aside * sin_, at_.y + 0.5 * aside * cos_, D{} + cos_, D{} + sin_, time};
      // Rotates by half of the turn until the next step, twice.
      const D middle_c = c * ch - s * sh, middle_s = s * ch + c * sh;
      const PlaceLanes next{now.x + step * middle_c, now.y + step * middle_s, middle_c * ch - middle_s * sh,
                            middle_s * ch + middle_c * sh, time};
      const auto blurred = [&](const FloorShape& shape) {
        return shape.spread > 0 ? hypotenuse(spread, D{} + shape.spread) : spread;
      };
      work_.seen.clear();
      for (size_t j = 0; j < work_.asked; ++j) {
        const FloorShape& who = *work_.whom[j].shape;
        const D blur = blurred(who);
        if (!any_below(beyond(who, next), kFarOff * blur)) continue;
        const D cut = kFarOff * blur + 2 * kNext * (1 + of_.footprint.reach());
        const D then = apart_abreast(of_.footprint, who, next, cut),
                before = apart_abreast(of_.footprint, who, now, cut);
        const D more = likely(then / blur) - likely(before / blur);
        if (!any_below(D{} + kHardlyTouched, more)) continue;
        const D straight = minimum(relu((before - then) / kNext), D{} + 1.0);
        const double size = who.around();
        const D unknown = blur * blur / (blur * blur + size * size);
        const D along = (1.0 - unknown) * straight * straight + 0.5 * unknown;
        const D worth = more > kHardlyTouched ? more * minimum(D{} + 1.0, along * whole) : D{};
        const size_t e = size_t(who.entity);
        double* most = work_.most_worth.data() + e * CoastWork::padded(1);
        if (std::find(work_.seen.begin(), work_.seen.end(), int(e)) == work_.seen.end()) {
          work_.seen.push_back(int(e));
          store_row(D{}, most);
        }
        store_row(maximum(load_row(most), worth), most);
      }
      if (work_.seen.empty()) continue;
      D stopped{};
      for (const Near& near : work_.what) {
        const FloorShape& what = *near.shape;
        const D blur = blurred(what);
        for (const PlaceLanes& place : {between, now})
          if (any_below(beyond(what, place), kFarOff * blur))
            stopped = maximum(stopped, likely(apart_abreast(of_.footprint, what, place, 1.01 * kFarOff * blur) / blur));
      }
      for (const int e : work_.seen) {
        const D met =
            load_row(row[4]) * (1.0 - stopped) * load_row(work_.most_worth.data() + size_t(e) * CoastWork::padded(1));
        for (size_t i = 0; i < kAbreastPlaces; ++i)
          work_.hit[size_t(e)] = std::min(1.0, work_.hit[size_t(e)] + met[int(i)]);
      }
    }
  }
  // Probability that a shape is touched at this distance in standard deviations.
  static GP_INLINE D likely(D ratio) { return ratio <= kFarOff ? upper_tail(ratio) : D{}; }

  bool is_near(const FloorShape& shape, const Place<Dual>& place) const {
    return shape.distance(place.x.value(), place.y.value(), place.time.value()) <=
           of_.footprint.reach() + kFarOff * blur_of(place.spread.value(), shape);
  }
  // As `astray`, with derivatives.
  void astray_slopes() {
    const State<Dual>& q = *slopes_;
    const double step = sign_ * kNext;
    const Dual speed = size_of(q.v), whole = speed * speed / (of_.unit * of_.unit),
               half = 0.5 * q.omega / speed * kNext;
    const double h = half.value(), ch = std::cos(h), sh = std::sin(h);
    const Dual c = q.yaw.through(cos_, -sin_), s = q.yaw.through(sin_, cos_);
    // Rotates by half of the turn until the next step, twice.
    const Dual half_c = half.through(ch, -sh), half_s = half.through(sh, ch);
    for (const CoastTables::Stray& stray : of_.stray) {
      if (gap_ > std::fabs(stray.aside) + kNext + kFarOff * stray.spread) continue;
      const double turned_c = stray.cos, turned_s = sign_ * stray.sin;
      const Dual spread(stray.spread), none(0.0);
      const Dual x = q.x - stray.aside * s, y = q.y + stray.aside * c;
      const Place<Dual> now{x, y, c * turned_c - s * turned_s, s * turned_c + c * turned_s, q.time, spread, none};
      const Place<Dual> between{q.x - 0.5 * stray.aside * s, q.y + 0.5 * stray.aside * c, c, s, q.time, spread, none};
      const Dual middle_c = now.cos * half_c - now.sin * half_s, middle_s = now.sin * half_c + now.cos * half_s;
      const Place<Dual> next{x + step * middle_c,
                             y + step * middle_s,
                             middle_c * half_c - middle_s * half_s,
                             middle_s * half_c + middle_c * half_s,
                             q.time,
                             spread,
                             Dual(kNext)};
      work_.seen.clear();
      for (size_t j = 0; j < work_.asked; ++j) {
        const FloorShape& who = *work_.whom[j].shape;
        if (!is_near(who, next)) continue;
        const Dual before = distance(of_.footprint, who, now), then = distance(of_.footprint, who, next);
        const Dual blurred = blur(who, spread), more = touch(then, blurred) - touch(before, blurred);
        if (more.value() <= kHardlyTouched) continue;
        const Dual along = normal_share(Dual((before - then) / kNext), who, blurred);
        Dual& most = work_.met_slopes[size_t(who.entity)];
        if (std::find(work_.seen.begin(), work_.seen.end(), who.entity) == work_.seen.end()) {
          work_.seen.push_back(who.entity);
          most = Dual(0.0);
        }
        most = larger(most, Dual(more * smaller(Dual(1.0), Dual(along * whole))));
      }
      if (work_.seen.empty()) continue;
      Dual stopped(0.0);
      for (const Near& near : work_.what)
        for (const Place<Dual>& place : {between, now})
          if (is_near(*near.shape, place))
            stopped = larger(stopped, touch(distance(of_.footprint, *near.shape, place), blur(*near.shape, spread)));
      for (const int e : work_.seen) {
        Dual& hit = work_.hit_slopes[size_t(e)];
        hit = smaller(Dual(1.0), Dual(hit + stray.lasts * speed / kNext * (1 - stopped) * work_.met_slopes[size_t(e)]));
      }
    }
  }
  const CoastTables& of_;
  const State<double>& at_;
  const State<Dual>* slopes_;
  const CoastQuery& query_;
  const Footprint2d& footprint_;
  const double reach_, unit_;  // from the origin of the base; speed at which severities hold
  CoastWork& work_;
  const double speed_, sign_, cos_, sin_;
  double far_ = 0;                                        // largest distance of a base
  size_t farthest_ = 0;                                   // index of that stop
  double gap_ = std::numeric_limits<double>::infinity();  // see look()
  // Of the current trajectory.
  double rate_ = 1;  // factor of all probabilities
  Dual rate_slopes_{1.0};
  size_t n_place_ = 0, n_stop_ = 0, row_ = 0;  // row_: padded row length of stops
  double whole_ = 0, arc_far_ = 0;
  double widest_ = 0, strides_ = 0;  // greatest spread of a place, and greatest distance between consecutive places
};

}  // namespace gp::GP_ISA

// The body model: obstacles that the arm and its carried object hit if the drives fail in this state. costs/models/body
// specifies the model and its letters. W states side by side, in double or single precision. Three shortcuts save time
// and change results only by rounding, unless the tables request fewer steps or shorter tails:
//
// - Tangent planes below the distances at the failure rule out most obstacles that a falling limb might hit.
// - A joint that fails alone moves all links beyond it as one rigid body, relative to the expected motion.
// - The other links follow the expected motion; their hits are the same for all joints and evaluated once.
#pragma once
#include <initializer_list>
#include <cstddef>
#include <cstdint>

#include "cutoffs.hpp"
#include "geometry/kinematics.hpp"
#include "geometry/tangent.hpp"
#include "impact/body_distance.hpp"
#include "impact/body_dynamics.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

constexpr double kPlaneGap = 0.4;  // smallest gap for which no tangent plane is stored [m]
template <class T> constexpr T kStillByRounding = sizeof(T) == 4 ? 1e-6 : 1e-12;  // motion of the arm by rounding [m]

// Least distances in one failure mode for each row and entity, and the depth of the arm in obstacles that stop it.
template <class V, bool kNamed> struct WayToFail {
  using T = Scalar<V>;
  V *best[2], blocked;  // best: [entity]; blocked: largest depth
  T* worst[2];          // [entity] largest lane of best
  T* limit[2];          // [obstacle] distances above do not count
  double gain = 0.0, tolerance = 0.0;
  Mask<T>*who[2], deepest;  // who: the Meeting of each best distance; deepest: that of `blocked`
};

// A lower bound of the distance of a limb to an obstacle, for any centre c of the limb and any rotation: max(n . c +
// max(low, close - bound turned), known - |c - c_0| - bound turned); bound: the limb's radius about c.
template <class V> struct Floor {
  Vec<V> n;
  V low, close, known;
};

// A sphere, an obstacle and a place (step): own is set if the configuration belongs to one failure mode, clear for the
// expected motion.
struct Meeting {
  int sphere, obstacle, place;
  bool own;

  explicit Meeting(int id) : sphere(id & 2047), obstacle(id >> 11 & 4095), place(id >> 23 & 127), own(id >> 30 & 1) {}
  static int id(int obstacle, int place, bool own) { return obstacle << 11 | place << 23 | int(own) << 30; }
};
static_assert(kMaxSpheres <= 2048 && kMaxObstacles <= 4096 && kMaxSteps < 128);

// A limb and an obstacle that may be nearer at a place than the best distance, with a lower bound of their distance.
template <class V> struct Prospect {
  V least;
  int16_t limb, place;
  int32_t obstacle;
};

template <class V> struct FallingJoint {
  JointMotion<V> motion;
  V rests;  // 1 where the joint rests on an obstacle
};

// An array that leaves its numbers uninitialised.
template <class T> class Buffer {
 public:
  explicit Buffer(size_t n) : data_(new T[n + 1]) {}
  Buffer(const Buffer&) = delete;
  ~Buffer() { delete[] data_; }
  T* at(size_t k) const { return data_ + k; }
  T& operator[](size_t k) const { return data_[k]; }
  T& operator[](int k) const { return data_[k]; }

 private:
  T* data_;
};

template <class V> class BodySlopes;

// kNamed: whether failure modes also record the nearest spheres, for derivatives.
template <class V, bool kNamed = false> class Arm {
  using T = Scalar<V>;
  using Id = Mask<T>;
  using Way = WayToFail<V, kNamed>;
  static constexpr int W = kAbreast<V>;
  static constexpr int kPending = 512;  // capacity for prospects, which are evaluated when it is full

 public:
  Way way;  // the most recent failure mode

  // Without weights and severities, all hits are computed.
  Arm(const Tables& t, const BodyTables& b, const BodyHarm& harm)
      : tables_(t),
        body_(b),
        severity_(harm.severity),
        weight_(harm.weight),
        n_obstacle_(t.n_obstacle),
        n_frame_(b.n_frame),
        padded_((t.n_obstacle + W - 1) / W * W),
        n_expected_((b.n_step > b.n_reference ? b.n_step : b.n_reference) + 1),
        n_place_(n_expected_ > b.n_fall + 1 ? n_expected_ : b.n_fall + 1),
        frames_(size_t((n_expected_ + b.n_fall + 1 + n_place_) * n_frame_)),
        centres_(size_t((n_expected_ + b.n_fall + 1) * b.n_limb)),
        turned_(size_t((n_expected_ + b.n_fall + 1) * n_frame_)),
        stances_(size_t(n_expected_ + b.n_fall + 1)),
        places_(size_t(n_place_)),
        reference_(size_t(n_expected_ * t.n_joint)),
        load_(size_t(n_expected_ * t.n_joint)),
        share_(size_t(n_expected_)),
        depth_(size_t(n_expected_)),
        trace_(size_t(n_expected_)),
        penalty_(size_t(n_place_)),
        stopper_(size_t(n_place_)),
        floors_(size_t(b.n_limb * padded_)),
        planes_(size_t(b.n_limb * padded_)),
        gaps_(size_t((2 * b.n_limb + 8) * padded_ / W)),
        hits_(size_t(2 * padded_)),
        best_(size_t(8 * b.n_entity)),
        worst_(size_t(8 * b.n_entity)),
        who_(size_t(kNamed ? 8 * b.n_entity : 0)),
        ends_(size_t(kGenerators * 2 * b.n_entity)),
        pending_(size_t(kPending)) {
    share_room();
    end_tails(harm.tail);
    for (int r = 0; r < 2; ++r)
      for (int j = 0; j < n_obstacle_; ++j)
        hit(r, j) = r < b.n_row && reach(r, b.entity[j]) > -kAnywhere ? b.entity[j] : -1;
    int n = 0;
    for (int l = 0; l < n_frame_; ++l) {
      const int joint = t.link[l].joint;
      if (joint >= 0) order_[n++] = joint, hanging_[joint] = 0;
      for (int f = l; f > 0; f = t.link[f].parent) hanging_[t.link[f].joint] |= uint64_t(1) << l;
    }
  }

  // Sets the state: the expected motion of the arm, and its distances at the failure.
  void start(const V* q, const V* qd, const double* ahead, size_t first, size_t n) {
    const int nq = tables_.n_joint;
    known_ahead_ = ahead != nullptr;
    steps_ = ahead ? body_.n_reference : body_.n_step;
    for (int j = 0; j < nq; ++j) reference(0, j) = q[j];
    share_[0] = V{};
    for (int s = 1; s <= steps_; ++s) {
      const double on = body_.constants.carry_on, t = s * body_.constants.step;
      share_[s] = V{} + T(on > 0 ? on * (1.0 - scalar_exponential(-t / on)) : 0.0);
      for (int j = 0; j < nq; ++j)
        if (!ahead) reference(s, j) = within(body_.drive[j], q[j] + share_[s] * qd[j]);
      for (int i = 0; ahead && i < W; ++i) {
        const size_t state = first + size_t(i) < n ? first + size_t(i) : n - 1;
        for (int j = 0; j < nq; ++j)
          reference(s, j)[i] = T(ahead[(state * size_t(steps_) + size_t(s - 1)) * size_t(nq) + size_t(j)]);
      }
    }
    for (int s = 0; s <= steps_; ++s) assume(stances_[s], &reference(s, 0)), depth_[s] = V{};
    look();
    weigh();
  }

  // Calls visit(mode, generator) after every failure mode that has a weight.
  template <class Visit> void fail(const V* qd, Visit visit) {
    const int n = tables_.n_joint;
    if (counts(0)) collapse(qd), visit(0, kCollapse);
    const bool shared = !known_ahead_ && steps_ > 0 && body_.constants.stop_gain[kJoint] == 0.0;
    if (shared) begin(along_, kJoint), begin(end_, kJoint, 1u << kStuck | 1u << kStray);
    along_.gain = end_.gain = 0.0;
    int first = 0;
    for (int k = 0; k < n; ++k) {
      const int j = order_[k], link = body_.drive[j].link;
      if (shared) go_on(first, link), first = link;
      if (counts(1 + j)) loose(j, qd, shared), visit(1 + j, kJoint);
      if (counts(1 + n + j)) stuck(j, shared), visit(1 + n + j, kStuck);
    }
    if (shared) go_on(first, n_frame_);
    if (counts(1 + 2 * n)) stray(shared), visit(1 + 2 * n, kStray);
  }

  // Distance from which on a row does not hit an entity.
  T cut(int generator, int r, int e) const { return end_of(generator, r, e).cut; }
  // P of a hit at distance d, and its derivative with respect to d.
  V probability(int generator, int r, int e, V d, V* slope = nullptr) const {
    const BodyConstants& k = body_.constants;
    const T least = end_of(generator, r, e).least, inverse = T(1.0 / k.spread[generator][r]);
    const V u = maximum((d - T(k.offset[generator][r])) * inverse, V{} - 60), s = reciprocal(1 + exponential(u));
    if (slope) *slope = s > least ? s * (s - 1) * (inverse / (1 - least)) : V{};
    return relu(s - least) * (1 / (1 - least));
  }
  // Calls visit(row, entity, weighted severity, distance) for every entity that may be hit.
  template <class Visit> void for_each_hit(int mode, int generator, Visit visit) const {
    for (int r = 0; r < body_.n_row; ++r)
      for (int e = 0; e < body_.n_entity; ++e) {
        const T S = T(weight_[mode * body_.n_row + r] * severity_[r * body_.n_entity + e]);
        if (S != 0 && any_below(way.best[r][e], V{} + cut(generator, r, e))) visit(r, e, S, way.best[r][e]);
      }
  }

 private:
  friend class BodySlopes<V>;

  // --- distances to obstacles ---------------------------------------------------------------------------------------

  void improve(Way& way, int r, int e, V d, Id who) const {
    if constexpr (kNamed) way.who[r][e] = d < way.best[r][e] ? who : way.who[r][e];
    way.best[r][e] = minimum(way.best[r][e], d);
  }
  void block(Way& way, V d, Id who) const {
    if constexpr (kNamed) way.deepest = -d > way.blocked ? who : way.deepest;
    way.blocked = maximum(way.blocked, -d);
  }
  // Largest distance that would still improve a result.
  V needed(const Way& way, int r, int obstacle, V penalty, bool stops) const {
    const int e = hit(r, obstacle);
    const V need = e < 0 ? V{} - T(kAnywhere) : way.best[r][e] - penalty;
    return stops ? maximum(need, -way.blocked) : need;
  }

  void examine(Way& way, const Prospect<V>& at, bool stops) {
    const Obstacle& o = tables_.obstacle[at.obstacle];
    const Limb& limb = body_.limb[at.limb];
    Place<V>& place = places_[at.place];
    const int r = limb.row, e = hit(r, at.obstacle);
    const V penalty = penalty_[at.place], need = needed(way, r, at.obstacle, penalty, stops);
    if (!any_below(at.least, need)) return;
    const Tangent<V> t = tangent(tables_, o, place.centre(at.limb, limb.frame));
    const Frame<V>& X = place.frame(limb.frame);
    const Plane<V> plane(X, t, limb.centre);
    if (!any_below(t.d - reach_of(limb, plane.n) - T(kSlack), need)) return;
    Least<V, kNamed> least{need, {}};
    look_at_limb(tables_, o, limb, X, plane, least);
    const Id who = least.sphere | Meeting::id(at.obstacle, at.place, &way == &this->way);
    if (stops) block(way, least.d, who);
    if (e < 0) return;
    improve(way, r, e, least.d < way.best[r][e] - penalty ? least.d + penalty : V{} + T(kAnywhere), who);
    way.worst[r][e] = greatest_lane(way.best[r][e]);
    const T limit = way.worst[r][e];
    way.limit[r][at.obstacle] = limit > 0 ? limit : 0;
  }
  void settle(Way& way) {
    while (n_pending_ > 0) examine(way, pending_[--n_pending_], false);
  }

  // Distances of limbs on frames [first, last) at a place. If `stops`, those to obstacles that stop the arm are
  // computed now. The others wait for settle(), which begins with the last places, since falling links come nearer.
  void meet(int at, int first, int last, bool stops, Way& way) {
    Place<V>& place = places_[at];
    const V penalty = T(way.gain) * relu(way.blocked - T(way.tolerance));
    penalty_[at] = penalty;
    if constexpr (kNamed) stopper_[at] = way.deepest;
    for (int i = 0; i < body_.n_limb; ++i) {
      const Limb& limb = body_.limb[i];
      const int frame = limb.frame, r = limb.row;
      if (frame < first || frame >= last) continue;
      const Vec<V> c = place.centre(i, frame);
      const V turn = place.turned(frame) * limb.bound, away = root(squared_distance(c, stances_[0].centre[i]));
      const V shift = away + T(kSlack), motion = away + turn > kStillByRounding<T> ? shift + turn : V{};
      const T farthest = greatest_lane(shift), most = greatest_lane(motion);
      for (int o = 0; o < padded_; o += W) {
        const V gap = maximum(loose_gap(i, o) - farthest, tight_gap(i, o) - most);
        const V& limit = *reinterpret_cast<const V*>(way.limit[r] + o);
        for (unsigned left = unsigned(lanes_below(gap, limit)); left; left &= left - 1) {
          const int lane = __builtin_ctz(left), j = o + lane;
          const Floor<V>& floor = floors_[i * padded_ + j];
          const V least = planes_[i * padded_ + j]
                              ? maximum(dot(floor.n, c) + maximum(floor.low, floor.close - turn), floor.known - motion)
                              : V{} + gap[lane];
          if (!any_below(least, needed(way, r, j, penalty, stops))) continue;
          pending_[n_pending_] = {least, int16_t(i), int16_t(at), j};
          if (stops && any_below(least, -way.blocked))
            examine(way, pending_[n_pending_], true);
          else if (++n_pending_ == kPending)
            settle(way);
        }
      }
    }
  }

  // Computes distances and tangent planes at the failure.
  void look() {
    home_.blocked = V{}, home_.deepest = Id{};
    for (int r = 0; r < body_.n_row; ++r)
      for (int e = 0; e < body_.n_entity; ++e) home_.best[r][e] = V{} + reach(r, e);
    for (int i = 0; i < body_.n_limb; ++i)
      for (int j = 0; j < n_obstacle_; ++j) look_at(i, j);
    for (int r = 0; r < body_.n_row; ++r)
      for (int e = 0; e < body_.n_entity; ++e) home_.worst[r][e] = greatest_lane(home_.best[r][e]);
  }
  void look_at(int i, int j) {
    const Limb& limb = body_.limb[i];
    const Obstacle& o = tables_.obstacle[j];
    const Frame<V>& X = stances_[0].X_W[limb.frame];
    const Vec<V> c = stances_[0].centre[i];
    const int at = i * padded_ + j, r = limb.row, e = hit(r, j);
    T &loose = reinterpret_cast<T*>(&loose_gap(i, 0))[j], &gap = reinterpret_cast<T*>(&tight_gap(i, 0))[j];
    planes_[at] = 0, loose = gap = T(kAnywhere);
    if (o.ignores >> limb.link & 1) return;
    if (o.bound[3] >= 0.f) {
      const Vec<V> middle = {V{} + o.bound[0], V{} + o.bound[1], V{} + o.bound[2]};
      const T away = T(__builtin_sqrt(double(least_lane(squared_distance(c, middle))))) - (o.bound[3] + limb.bound);
      loose = gap = away - T(kSlack);
      if (away > T(kPlaneGap)) return;
    }
    const Tangent<V> t = tangent(tables_, o, c);
    const Plane<V> plane(X, t, limb.centre);
    const V close = t.d - reach_of(limb, plane.n) - T(kSlack), on = dot(t.n, c);
    Floor<V>& floor = floors_[at];
    planes_[at] = 1, floor = {t.n, t.d - on - limb.bound - T(kSlack), close - on, close};
    loose = least_lane(t.d) - limb.bound - T(kSlack);
    const V need = maximum(e >= 0 ? home_.best[r][e] : V{} - T(kAnywhere), -home_.blocked);
    if (any_below(close, need)) {
      Least<V, kNamed> least{need, {}};
      look_at_limb(tables_, o, limb, X, plane, least);
      const Id who = least.sphere | Meeting::id(j, 0, false);
      floor.known = maximum(least.d, close);
      block(home_, least.d, who);
      if (e >= 0) improve(home_, r, e, least.d, who);
    }
    gap = least_lane(floor.known);
  }

  // Starts a failure mode from the distances at the failure, as far as they count for the given generators.
  void begin(Way& way, int generator, unsigned others = 0) {
    way.gain = body_.constants.stop_gain[generator], way.tolerance = body_.constants.stop_tolerance[generator];
    for (int r = 0; r < body_.n_row; ++r) {
      for (int e = 0; e < body_.n_entity; ++e) {
        const T far = reach(r, e, others | 1u << generator);
        way.best[r][e] = minimum(V{} + far, home_.best[r][e]);
        if constexpr (kNamed) way.who[r][e] = home_.who[r][e];
        way.worst[r][e] = home_.worst[r][e] < far ? home_.worst[r][e] : far;
      }
      for (int j = 0; j < n_obstacle_; ++j) {
        const T limit = hit(r, j) >= 0 ? way.worst[r][hit(r, j)] : 0;
        way.limit[r][j] = limit > 0 ? limit : 0;
      }
    }
    way.blocked = home_.blocked, way.deepest = home_.deepest;
  }
  void join(Way& way, const Way& other, V penalty) {
    for (int r = 0; r < body_.n_row; ++r)
      for (int e = 0; e < body_.n_entity; ++e)
        improve(way, r, e, other.best[r][e] + penalty, kNamed ? other.who[r][e] : Id{});
  }

  // --- motion -------------------------------------------------------------------------------------------------------

  void assume(Stance<V>& at, const V* x) const {
    forward_kinematics(tables_, x, at.X_W);
    for (int i = 0; i < body_.n_limb; ++i) at.centre[i] = transform(at.X_W[body_.limb[i].frame], body_.limb[i].centre);
    at.turned[0] = V{};
    for (int l = 1; l < n_frame_; ++l) {
      const Link& link = tables_.link[l];
      at.turned[l] = at.turned[link.parent];
      if (!link.slide) at.turned[l] += absolute(x[link.joint] - reference(0, link.joint));
    }
  }
  // Inertia of single joints, and their gravity load at each step.
  void weigh() {
    Composite<V> all[kMaxJoints + 1];
    for (int s = 0; s < (steps_ ? steps_ : 1); ++s) {
      gather(tables_, body_, stances_[s].X_W, all);
      for (int j = 0; j < tables_.n_joint; ++j) {
        const int link = body_.drive[j].link;
        const Frame<V>& X = stances_[s].X_W[link];
        load(s, j) = load_on(tables_.link[link], all[link], X);
        if (s) continue;
        const Twist<V> t = twist_of(tables_.link[link], X);
        inertia_[j] = power(t, momentum(all[link], t)) + T(body_.drive[j].armature);
      }
    }
  }
  // Places the links beyond a joint that is at x instead of its expected position.
  void displace(int s, int joint, V x, V& sine, V& cosine) {
    const Link& link = tables_.link[body_.drive[joint].link];
    const V expected = reference(s, joint), by = x - expected, q = reference(0, joint);
    sine_cosine(by, sine, cosine);
    if (link.slide) sine = V{}, cosine = V{} + 1;
    const V more = link.slide ? V{} : absolute(x - q) - absolute(expected - q);
    places_[s].set(stances_[s], hanging_[joint],
                   joint_motion(link, stances_[s].X_W[body_.drive[joint].link], by, sine, cosine), more);
  }

  // --- failure modes ------------------------------------------------------------------------------------------------

  void collapse(const V* qd) {
    const int n = body_.n_fall;
    const double h = body_.constants.brake_time / n;
    V x[kMaxJoints], v[kMaxJoints];
    for (int j = 0; j < tables_.n_joint; ++j) x[j] = reference(0, j), v[j] = qd[j];
    begin(way, kCollapse);
    for (int s = 0; s <= n; ++s) {
      if (s < n)
        fall_together(tables_, body_, s ? fallen(s - 1).X_W : stances_[0].X_W, h, x, v);
      else
        for (int j = 0; j < tables_.n_joint; ++j)
          x[j] = within(body_.drive[j], x[j] + T(body_.constants.brake_stop) * v[j]);
      assume(fallen(s), x);
      places_[s].set(fallen(s));
      meet(s, 0, n_frame_, s < n, way);
    }
    settle(way);
  }
  void loose(int joint, const V* qd, bool shared) {
    const JointDrive& drive = body_.drive[joint];
    JointMotion<V> motion{reference(0, joint), qd[joint]};
    V sine = {}, cosine = V{} + 1;
    begin(way, kJoint);
    if (shared) join(way, along_, V{}), join(way, end_, V{});
    for (int s = 1; s <= steps_; ++s) {
      const V was = motion.x, before = way.blocked, torque = load(s - 1, joint).torque(sine, cosine);
      fall_alone(drive, body_.constants.step, inertia_[joint], torque, motion);
      displace(s, joint, motion.x, sine, cosine);
      if constexpr (kNamed) trace_[s] = {motion, V{}};
      if (!body_.looks(s)) continue;
      if (shared) way.blocked = maximum(way.blocked, depth_[s]);
      meet(s, shared ? drive.link : 0, n_frame_, s < steps_, way);
      const auto rests = way.blocked > before + T(way.tolerance);
      if constexpr (kNamed) trace_[s] = {motion, rests ? V{} + 1 : V{}};
      motion = {rests ? was : motion.x, rests ? V{} : motion.v};
      way.blocked = rests ? before : way.blocked;
    }
    settle(way);
  }
  void stuck(int joint, bool shared) {
    V sine, cosine;
    begin(way, kStuck);
    if (shared) join(way, end_, T(way.gain) * relu(way.blocked - T(way.tolerance)));
    for (int s = known_ahead_ ? 1 : steps_; s <= steps_ && s; ++s) {
      displace(s, joint, reference(0, joint), sine, cosine);
      meet(s, shared ? body_.drive[joint].link : 0, n_frame_, s < steps_, way);
    }
    settle(way);
  }
  void stray(bool shared) {
    begin(way, kStray);
    if (shared) return join(way, end_, T(way.gain) * relu(way.blocked - T(way.tolerance)));
    for (int s = known_ahead_ ? 1 : steps_; s <= steps_ && s; ++s) {
      places_[s].set(stances_[s]);
      meet(s, 0, n_frame_, s < steps_, way);
    }
    settle(way);
  }
  // Frames [first, last) follow the expected motion.
  void go_on(int first, int last) {
    for (int s = steps_; s > 0; --s) {
      if (!body_.looks(s)) continue;
      Way& met = s < steps_ ? along_ : end_;
      met.blocked = depth_[s];
      places_[s].set(stances_[s]);
      meet(s, first, last, s < steps_, met);
      depth_[s] = met.blocked;
      settle(met);
    }
  }

  // --- tables -------------------------------------------------------------------------------------------------------

  // For hits by a generator: the distance from which on they do not count, and P there.
  struct End {
    T cut, least;
  };
  const End& end_of(int generator, int r, int e) const { return ends_[(generator * 2 + r) * body_.n_entity + e]; }
  void end_tails(const Tail* tail) {
    const double usual = 1.0 / (1.0 + scalar_exponential(kFarSpreads));
    for (int g = 0; g < kGenerators; ++g)
      for (int r = 0; r < 2; ++r)
        for (int e = 0; e < body_.n_entity; ++e) {
          const int at = (g * 2 + r) * body_.n_entity + e;
          const bool none = r >= body_.n_row || (severity_ && severity_[r * body_.n_entity + e] == 0.0);
          const Tail its = none   ? Tail{-1.0, 0.0}
                           : tail ? tail[(g * body_.n_row + r) * body_.n_entity + e]
                                  : Tail{kFarSpreads, usual};
          const double cut = body_.constants.offset[g][r] + its.far * body_.constants.spread[g][r];
          ends_[at] = {its.far < 0 ? T(-kAnywhere) : T(cut), T(its.least)};
        }
  }
  // Distance beyond which none of the generators hits an entity; -kAnywhere if they never do.
  T reach(int r, int e, unsigned generators = ~0u) const {
    T far = T(-kAnywhere);
    for (int g = 0; e >= 0 && g < kGenerators; ++g)
      if (generators >> g & 1 && cut(g, r, e) > far) far = cut(g, r, e);
    return far;
  }

  bool counts(int mode) const {
    bool found = !weight_;
    for (int r = 0; weight_ && r < body_.n_row; ++r) found |= weight_[mode * body_.n_row + r] != 0.0;
    return found;
  }
  static double scalar_exponential(double x) { return exponential(D{} + x)[0]; }

  void share_room() {
    const int n_stance = n_expected_ + body_.n_fall + 1, n_entity = body_.n_entity;
    for (int s = 0; s < n_stance; ++s)
      stances_[s] = {&frames_[s * n_frame_], &centres_[s * body_.n_limb], &turned_[s * n_frame_]};
    for (int s = 0; s < n_place_; ++s) places_[s].moved_frames = &frames_[(n_stance + s) * n_frame_];
    T* limit = reinterpret_cast<T*>(&gaps_[2 * body_.n_limb * padded_ / W]);
    const int n_gap = 2 * body_.n_limb * padded_ / W;
    for (int k = 0; k < n_gap + 8 * padded_ / W; ++k)
      gaps_[k] = V{} + T(k < n_gap ? kAnywhere : 0);  // padding included
    for (int k = 0; kNamed && k < 8 * n_entity; ++k) who_[k] = Id{};
    int k = 0;
    for (Way* one : {&home_, &along_, &end_, &way})
      for (int r = 0; r < 2; ++r, ++k) {
        one->limit[r] = limit + k * padded_;
        one->best[r] = &best_[k * n_entity], one->worst[r] = &worst_[k * n_entity];
        one->who[r] = &who_[kNamed ? k * n_entity : 0];
      }
  }
  V& reference(int s, int j) const { return reference_[s * tables_.n_joint + j]; }
  Load<V>& load(int s, int j) const { return load_[s * tables_.n_joint + j]; }
  Stance<V>& fallen(int s) const { return stances_[n_expected_ + s]; }
  // Lower bounds of the distance of a limb to a block of obstacles, over all lanes. The tight one assumes that only the
  // centre moves, the loose one allows any rotation.
  V& tight_gap(int limb, int o) const { return gaps_[(limb * padded_ + o) / W]; }
  V& loose_gap(int limb, int o) const { return gaps_[((body_.n_limb + limb) * padded_ + o) / W]; }
  // The entity that counts if a row hits an obstacle; -1 for none.
  int32_t& hit(int r, int obstacle) const { return hits_[r * padded_ + obstacle]; }

  const Tables& tables_;
  const BodyTables& body_;
  const double *severity_, *weight_;
  const int n_obstacle_, n_frame_, padded_, n_expected_, n_place_;
  int steps_ = 0, order_[kMaxJoints];  // order: joints from the base outwards
  bool known_ahead_ = false;
  uint64_t hanging_[kMaxJoints];  // links moved by each joint (bits)
  Way home_, along_, end_;        // home: at the failure; along: on the expected motion; end: at its last step
  V inertia_[kMaxJoints];         // M_jj at the failure

  Buffer<Frame<V>> frames_;
  Buffer<Vec<V>> centres_;
  Buffer<V> turned_;
  Buffer<Stance<V>> stances_;  // of the expected motion, then of a collapse
  Buffer<Place<V>> places_;
  Buffer<V> reference_;      // [step, joint]
  Buffer<Load<V>> load_;     // [step, joint]
  Buffer<V> share_, depth_;  // [step] share: d r/d qd inside the joint's range; depth: depth of the frames that follow
                             // the expected motion
  Buffer<FallingJoint<V>> trace_;  // [step] of the joint that fell last
  Buffer<V> penalty_;              // [place]
  Buffer<Id> stopper_;             // [place] the Meeting that determines the depth
  Buffer<Floor<V>> floors_;        // [limb, obstacle]
  Buffer<uint8_t> planes_;         // [limb, obstacle] whether there is a floor
  Buffer<V> gaps_;
  Buffer<int32_t> hits_;
  Buffer<V> best_;
  Buffer<T> worst_;
  Buffer<Id> who_;
  Buffer<End> ends_;  // [generator, row, entity]
  Buffer<Prospect<V>> pending_;
  int n_pending_ = 0;
};

template <class V> static inline V body_impact_of(Arm<V>& arm, const V* q, const V* qd) {
  V impact = {};
  arm.start(q, qd, nullptr, 0, 1);
  arm.fail(qd, [&](int mode, int generator) {
    arm.for_each_hit(mode, generator,
                     [&](int r, int e, Scalar<V> S, V d) { impact += S * arm.probability(generator, r, e, d); });
  });
  return impact;
}

}  // namespace gp::GP_ISA

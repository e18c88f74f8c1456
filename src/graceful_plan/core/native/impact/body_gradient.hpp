// Derivatives of the body model's impact with respect to q and qd, in reverse mode. Each nearest sphere receives a
// force along the obstacle's normal, the derivative with respect to its distance. Forces are summed at the frames of
// the expected motion, become joint torques there, and are mapped back through that motion to q and qd. Forces on links
// beyond a failed joint act where that joint has moved them; the joint itself is mapped back through its fall.
// Neglected: how inertia depends on q, the coupling of joints in a collapse, and contacts that stop a fall.
#pragma once
#include <cstddef>

#include "geometry/kinematics.hpp"
#include "impact/body.hpp"
#include "impact/body_distance.hpp"
#include "impact/body_dynamics.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

// Force on a frame, and moment about the origin of W.
template <class V> struct Wrench {
  Vec<V> force, moment;

  void add(const Vec<V>& f, const Vec<V>& at) {
    const Vec<V> m = cross(at, f);
    force = {force.x + f.x, force.y + f.y, force.z + f.z};
    moment = {moment.x + m.x, moment.y + m.y, moment.z + m.z};
  }
  void add(const Wrench& other) {
    const Vec<V>&f = other.force, &m = other.moment;
    force = {force.x + f.x, force.y + f.y, force.z + f.z};
    moment = {moment.x + m.x, moment.y + m.y, moment.z + m.z};
  }
  // Component along a joint's axis; X is the joint's frame.
  V torque(const Link& link, const Frame<V>& X) const {
    const Vec<V> a = {X.R[2], X.R[5], X.R[8]};
    if (link.slide) return dot(a, force);
    const Vec<V> lever = cross(X.p, force);
    return dot(a, Vec<V>{moment.x - lever.x, moment.y - lever.y, moment.z - lever.z});
  }
};

template <class V> class BodySlopes {
  using T = Scalar<V>;
  using Id = Mask<T>;

 public:
  V impact, d_q[kMaxJoints], d_qd[kMaxJoints];

  explicit BodySlopes(Arm<V, true>& arm)
      : arm_(arm),
        tables_(arm.tables_),
        body_(arm.body_),
        n_wrench_((body_.n_step + body_.n_fall + 2) * body_.n_frame),
        wrenches_(size_t(n_wrench_)),
        slots_(size_t(4 * body_.n_entity)) {}

  void run(const V* q, const V* qd) {
    begin();
    arm_.start(q, qd, nullptr, 0, 1);
    arm_.fail(qd, [&](int mode, int generator) { fail(mode, generator); });
    finish();
  }

 private:
  // Force on one Meeting, accumulated over failure modes that share it.
  struct Slot {
    Id id;
    V force;
  };

  void begin() {
    impact = V{};
    for (int j = 0; j < tables_.n_joint; ++j) d_q[j] = d_qd[j] = V{};
    const Vec<V> none = {V{}, V{}, V{}};
    for (int k = 0; k < n_wrench_; ++k) wrenches_[k] = {none, none};
    for (int k = 0; k < 4 * body_.n_entity; ++k) slots_[k] = {Id{}, V{}};
  }
  Wrench<V>* wrench(bool fallen, int place) {
    return &wrenches_[(fallen ? body_.n_step + 1 + place : place) * body_.n_frame];
  }

  void fail(int mode, int generator) {
    const int n = tables_.n_joint, joint = generator == kJoint ? mode - 1 : generator == kStuck ? mode - 1 - n : -1;
    for (int s = 0; s <= arm_.steps_; ++s) own_torque_[s] = V{};
    arm_.for_each_hit(mode, generator, [&](int r, int e, T S, V d) {
      V slope;
      impact += S * arm_.probability(generator, r, e, d, &slope);
      push(r, e, arm_.way.who[r][e], d < arm_.cut(generator, r, e) ? S * slope : V{}, generator, joint);
    });
    if (generator == kJoint) fall_back(joint);
    if (generator == kStuck) stay_back(joint);
  }

  // Adds a force to the slot of its Meeting; for a Meeting of the failure mode itself, applies it at once.
  void push(int r, int e, Id who, V force, int generator, int joint) {
    const auto own = (who >> 30 & 1) != 0, at_home = (who >> 23 & 255) == 0;
    if (any((force != V{}) & own)) push_spheres(who, own ? force : V{}, generator, joint);
    collect(slots_[2 * (r * body_.n_entity + e)], who, at_home ? force : V{});
    collect(slots_[2 * (r * body_.n_entity + e) + 1], who, own | at_home ? V{} : force);
  }
  void collect(Slot& slot, Id who, V force) {
    const auto pushed = force != V{}, taken = slot.force != V{};
    if (any(pushed & taken & (who != slot.id))) flush(slot);
    slot.id = pushed ? who : slot.id, slot.force += force;
  }
  void flush(Slot& slot) {
    push_spheres(slot.id, slot.force, kStray, -1);
    slot.force = V{};
  }

  // Handles equal Meetings together, since lanes often share one.
  void push_spheres(Id who, V force, int generator, int joint, bool stopped_too = true) {
    for (unsigned left = unsigned(lanes_set(force != V{})); left;) {
      const auto id = who[__builtin_ctz(left)];
      const auto these = who == id;
      left &= ~unsigned(lanes_set(these));
      const Meeting at{int(id)};
      push_sphere(at, these ? force : V{}, generator, joint);
      // Depth reached earlier adds to the distance.
      const V stopped = at.own && stopped_too ? (these & (arm_.penalty_[at.place] > 0) ? force : V{}) : V{};
      if (any(stopped != V{}))
        push_spheres(arm_.stopper_[at.place], T(-arm_.way.gain) * stopped, generator, joint, false);
    }
  }
  void push_sphere(const Meeting& at, V force, int generator, int joint) {
    const Limb* limb = body_.limb;
    while (at.sphere < limb->first || at.sphere >= limb->first + limb->count) ++limb;
    const int frame = limb->frame;
    const bool fallen = at.own && generator == kCollapse, displaced = at.own && joint >= 0 && hangs(frame, joint);
    const Stance<V>& stance = fallen ? arm_.fallen(at.place) : arm_.stances_[at.place];
    const float* s = tables_.sphere + 4 * at.sphere;
    const Frame<V>& X = displaced ? arm_.places_[at.place].frame(frame) : stance.X_W[frame];
    const Vec<V> p = transform(X, s), n = tangent(tables_, tables_.obstacle[at.obstacle], p).n;
    const Vec<V> f = {force * n.x, force * n.y, force * n.z};
    Wrench<V>* wrenches = wrench(fallen, at.place);
    if (!displaced) return wrenches[frame].add(f, p);
    // Joints beyond the failed one turn this sphere as if nothing had failed, joints before it as it is.
    const int link = body_.drive[joint].link;
    const Vec<V> before = seen_from(arm_.places_[at.place].T, f), at_first = transform(stance.X_W[frame], s);
    Wrench<V> real = {{V{}, V{}, V{}}, {V{}, V{}, V{}}};
    real.add(f, p);
    own_torque_[at.place] += real.torque(tables_.link[link], stance.X_W[link]);
    real.add({-before.x, -before.y, -before.z}, at_first);
    wrenches[frame].add(before, at_first);
    wrenches[link].add(real);
  }
  bool hangs(int frame, int joint) const { return arm_.hanging_[joint] >> frame & 1; }

  // 1 where the expected motion does not clamp a joint to its range.
  V within_range(int s, int j) const {
    const V x = arm_.reference(s, j);
    const JointDrive& drive = body_.drive[j];
    return s == 0 ? V{} + 1 : ((x > T(drive.lower)) & (x < T(drive.upper)) ? V{} + 1 : V{});
  }
  // The failed joint does not follow the expected motion.
  void take_back(int s, int joint) {
    const V torque = own_torque_[s] * within_range(s, joint);
    d_q[joint] -= torque, d_qd[joint] -= arm_.share_[s] * torque;
  }
  void stay_back(int joint) {
    for (int s = 1; s <= arm_.steps_; ++s) take_back(s, joint), d_q[joint] += own_torque_[s];
  }

  struct Sensitivity {  // Derivatives of a joint's position and velocity with respect to q and qd.
    V x_q[kMaxJoints], v_q[kMaxJoints], x_qd[kMaxJoints], v_qd[kMaxJoints];
  };
  // Maps torques back through the fall of a joint: fall_alone() with derivatives.
  void fall_back(int joint) {
    bool pushed = false;
    for (int s = 1; s <= arm_.steps_; ++s) pushed |= any(own_torque_[s] != V{});
    if (!pushed) return;
    const int n = tables_.n_joint;
    const JointDrive& drive = body_.drive[joint];
    const T h = T(body_.constants.step);
    const V M = arm_.inertia_[joint],
            ease = reciprocal(M + T(body_.constants.step * (drive.damping + drive.resistance)));
    Sensitivity now;
    for (int i = 0; i < n; ++i) now.x_q[i] = now.v_q[i] = now.x_qd[i] = now.v_qd[i] = V{};
    now.x_q[joint] = now.v_qd[joint] = V{} + 1;
    for (int s = 1; s <= arm_.steps_; ++s) {
      V d_load[kMaxJoints];
      load_slopes(s - 1, joint, s > 1 ? arm_.trace_[s - 1].motion.x : arm_.reference(0, joint), d_load);
      const FallingJoint<V>& step = arm_.trace_[s];
      const V free = step.motion.v != V{} ? V{} + 1 : V{};  // neither at a limit nor held by friction
      const auto rests = step.rests > 0;
      const V inside = (step.motion.x > T(drive.lower)) & (step.motion.x < T(drive.upper)) ? V{} + 1 : V{};
      take_back(s, joint);
      for (int i = 0; i < n; ++i) {
        const V expected = i == joint ? V{} : d_load[i] * within_range(s - 1, i);
        const V next_q = free * ease * (M * now.v_q[i] - h * (expected + d_load[joint] * now.x_q[i]));
        const V next_qd =
            free * ease * (M * now.v_qd[i] - h * (expected * arm_.share_[s - 1] + d_load[joint] * now.x_qd[i]));
        const V x_q = inside * (now.x_q[i] + T(0.5) * h * (now.v_q[i] + next_q));
        const V x_qd = inside * (now.x_qd[i] + T(0.5) * h * (now.v_qd[i] + next_qd));
        d_q[i] += own_torque_[s] * x_q, d_qd[i] += own_torque_[s] * x_qd;
        now.x_q[i] = rests ? now.x_q[i] : x_q, now.x_qd[i] = rests ? now.x_qd[i] : x_qd;
        now.v_q[i] = rests ? V{} : next_q, now.v_qd[i] = rests ? V{} : next_qd;
      }
    }
  }
  // Derivatives of a joint's gravity load at step s, with the joint at x.
  void load_slopes(int s, int joint, V x, V* d_load) const {
    for (int i = 0; i < tables_.n_joint; ++i) d_load[i] = V{};
    const Load<V>& load = arm_.load(s, joint);
    V sine, cosine;
    sine_cosine(x - arm_.reference(s, joint), sine, cosine);
    if (!tables_.link[body_.drive[joint].link].slide)
      d_load[joint] = T(kGravity) * (load.turned * cosine - load.still * sine);
  }

  void finish() {
    for (int k = 0; k < 4 * body_.n_entity; ++k) flush(slots_[k]);
    for (int s = 0; s <= arm_.steps_; ++s)
      gather(wrench(false, s), arm_.stances_[s], [&](int j, V torque) {
        const V push = torque * within_range(s, j);
        d_q[j] += push, d_qd[j] += arm_.share_[s] * push;
      });
    if (!arm_.counts(0)) return;
    V x_q[kMaxJoints], v_q[kMaxJoints], x_qd[kMaxJoints], v_qd[kMaxJoints];
    for (int j = 0; j < tables_.n_joint; ++j) x_q[j] = v_qd[j] = V{} + 1, v_q[j] = x_qd[j] = V{};
    const T h = T(body_.constants.brake_time / body_.n_fall), brake = T(body_.constants.brake_stop);
    for (int s = 0; s <= body_.n_fall; ++s) {
      for (int j = 0; j < tables_.n_joint; ++j) {
        if (s == body_.n_fall) {
          x_q[j] += brake * v_q[j], x_qd[j] += brake * v_qd[j];
          continue;
        }
        const V M = arm_.inertia_[j], ease = reciprocal(M + h * T(body_.drive[j].damping));
        const V next_q = ease * (M * v_q[j] - h * T(kGravity) * arm_.load(0, j).turned * x_q[j]);
        const V next_qd = ease * (M * v_qd[j] - h * T(kGravity) * arm_.load(0, j).turned * x_qd[j]);
        x_q[j] += T(0.5) * h * (v_q[j] + next_q), x_qd[j] += T(0.5) * h * (v_qd[j] + next_qd);
        v_q[j] = next_q, v_qd[j] = next_qd;
      }
      gather(wrench(true, s), arm_.fallen(s),
             [&](int j, V torque) { d_q[j] += torque * x_q[j], d_qd[j] += torque * x_qd[j]; });
    }
  }
  // Visits the torques of all joints; wrenches become sums over all frames beyond.
  template <class Visit> void gather(Wrench<V>* wrenches, const Stance<V>& at, Visit visit) {
    for (int l = body_.n_frame - 1; l > 0; --l) {
      const Link& link = tables_.link[l];
      visit(link.joint, wrenches[l].torque(link, at.X_W[l]));
      wrenches[link.parent].add(wrenches[l]);
    }
  }

  Arm<V, true>& arm_;
  const Tables& tables_;
  const BodyTables& body_;
  const int n_wrench_;
  Buffer<Wrench<V>> wrenches_;   // [configuration, frame]
  V own_torque_[kMaxSteps + 1];  // of the failed joint
  Buffer<Slot> slots_;           // [row, entity, at the failure or later]
};

}  // namespace gp::GP_ISA

// The gradient of own_loss.hpp; it adds to the derivatives, see drop_gradient.hpp.
#pragma once
#include "cutoffs.hpp"
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/flight/flight.hpp"
#include "impact/own_loss.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

template <class V> struct OwnLossSlope {
  double severity;
  V damaged[kMaxSurfaces];  // per level: first_damage()
  V lift_at[kMaxSurfaces], borne_at[kMaxSurfaces];
  V lift = {}, borne = {};      // derivatives with respect to A and K (lift, borne) after the present level
  V d_damaged[kMaxSurfaces];    // with respect to first_damage()
  V ends_below, height, known;  // of the present level

  explicit OwnLossSlope(double of) : severity(of) {}
  void keep(int level, const OwnLoss<V>& loss) { lift_at[level] = loss.lift, borne_at[level] = loss.borne; }

  // Maps derivatives with respect to A and K after a level to those of the shares that left it; returns the derivative
  // with respect to `falls`.
  V back_leave(Backward<V>& back, int level, V falls) {
    const V d_leaving = lift * back.drop.surface[back.drop.level_start[level]].top, d_leaves = borne * damaged[level];
    back.d_landing.leaving[level] += falls * d_leaving, back.d_landing.leaves[level] += falls * d_leaves;
    d_damaged[level] = severity + borne * falls * back.landing.leaves[level];
    return d_leaving * back.landing.leaving[level] + d_leaves * back.landing.leaves[level];
  }
  // Moves to the state before the level; returns the derivative with respect to `keep`.
  V back_keep(int level, V keep) {
    const V d_keep = lift * lift_at[level] + borne * borne_at[level];
    lift *= keep, borne *= keep;
    ends_below = height = known = V{};
    return d_keep;
  }
  // One surface, in reverse order; returns the derivative with respect to the share of the arriving mass that it stops.
  V back_end(const DropTables& drop, const Surface& s, OwnLoss<V>& loss, V arrives, V ends) {
    const V d_passes = -severity * arrives * ends_below;
    ends_below *= 1.0 - ends;
    if (!s.holds) return d_passes;
    const Damage<V> damage = loss.fall(drop, s);
    const V more = relu(damage.value - loss.known);
    ends_below += ends * more;
    const V counts = where(damage.value > loss.known, severity * arrives * ends, V{}), h = loss.height - s.top;
    height += counts * damage.slope * inverse_root(h * h + 1e-4);
    known -= counts;
    return d_passes + severity * arrives * more;
  }
  // Call it after the first surface; returns the derivative with respect to B.
  V back_enter(const OwnLoss<V>& loss) {
    lift += height * loss.share, borne += known * loss.share;
    return severity * ends_below - (height * loss.height + known * loss.known) * loss.share;
  }
};

template <class V> static inline void back_first_damage(Backward<V>& back, int level, V d_damaged) {
  auto& [tables, drop, X_W, flight, landing, d_flight, d_landing] = back;
  if (!any(landing.first[level] > kRare<V>)) return;
  for (int k = drop.level_start[level]; k < drop.level_start[level + 1]; ++k) {
    const V lands = landing.share[level] * landing.overlap[k];
    if (!any(lands > kRare<V>)) continue;
    const V speed = arrival_speed(drop, flight, landing.time[k]);
    const Damage<V> damage(drop.loss, drop.surface[k], log_arrival(speed));
    d_landing.lands[k] += d_damaged * damage.value;
    const V d_log = d_damaged * lands * damage.slope;
    const V d_speed = where(0.5 * speed * speed > 1e-9, 2.0 * d_log * reciprocal(maximum(speed, V{} + 1e-5)), V{});
    d_landing.time[k] += kGravity * d_speed;
    d_flight.v.z -= d_speed;
  }
}

}  // namespace gp::GP_ISA

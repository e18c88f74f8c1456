"""Edits of the native core that tests should detect: signs, comparisons, loop bounds, terms, minima for maxima.

In each pattern, the part between the marks is the expression that the second string replaces. Each pattern must occur
exactly once in its file, so patterns that a change of the core makes stale are reported.
"""

from __future__ import annotations

GEOMETRY = (
    "tests/core/test_kernels.py",
    "tests/core/test_many_spheres.py",
    "tests/core/test_cells.py",
    "tests/core/test_ball_among_shapes.py",
)
DROPS = ("tests/costs/models/test_drop_kernel.py", "tests/costs/models/test_drop.py")
SPILLS = ("tests/costs/models/test_spill_model.py", "tests/costs/models/test_stop_spill.py")
BODIES = ("tests/costs/models/test_body.py",)
PROFILES = ("tests/planners/test_motion_descent.py", "tests/timing/test_retiming.py")

EDITS = {
    "geometry/clearance.hpp": (
        GEOMETRY,
        (
            ("return root(ox * ox + oy * oy + oz * oz) + «minimum(inside, V{})»", "maximum(inside, V{})"),
            ("V inside = «maximum(x, maximum(y, z))»", "minimum(x, maximum(y, z))"),
            ("+ minimum(«maximum(r, z)», V{})", "minimum(r, z)"),
            ("V z = p.z - «minimum(maximum(p.z, V{} - half), V{} + half)»", "maximum(p.z, V{} - half)"),
            ("return k > 1.f ? «maximum(root(d2) - 1e-6f, lower_bound)»", "root(d2) + 1e-3f"),
            ("const V s = «minimum(maximum(dot(d, e) * e[3], V{}), V{} + 1.f)»", "maximum(dot(d, e) * e[3], V{})"),
            ("«squared(from_edge(p, t, 2))»)", "squared(from_edge(p, t, 1))"),
            ("highest = «maximum(highest, height)»", "height"),
            ("return «highest > 0.f ? root(nearest) : highest»", "highest"),
            ("V r = «reach + o.bound[3]»", "V(reach)"),
            ("if (!any(«deepest < radius»))", "(deepest < -radius)"),
            ("return «x * x + y * y + z * z» < radius * radius", "x * x + y * y"),
            ("if (!«any(x * x + y * y + z * z < r * r)»)", "all(x * x + y * y + z * z < r * r)"),
            ("reach = relu(«ga.bound[3] + gb.bound[3] + kept»)", "(ga.bound[3] + kept)"),
            ("const float r = relu(«ra + tables.sphere[4 * m + 3]»)", "ra"),
            ("const float kept = «margin + o.keep»", "margin"),
            ("return F{} + («group.bound[3] + margin + keep»)", "(group.bound[3] + keep)"),
            ("hit |= touches(tables, o, sphere[k], «tables.sphere[4 * k + 3] + kept»)", "tables.sphere[4 * k + 3]"),
        ),
    ),
    "geometry/nearest.hpp": (
        (*GEOMETRY, "tests/core/test_slack.py"),
        (
            ("const float reach = «tables.group[a].bound[3] + tables.group[b].bound[3]»", "tables.group[a].bound[3]"),
            ("sphere[k]) - («tables.sphere[4 * k + 3] + o.keep»)", "tables.sphere[4 * k + 3]"),
            ("relu(«best.distance + (group.bound[3] + keep)»)", "F(best.distance + keep)"),
            ("best.update(square_root(d2) - («two.radius[v] + r»)", "two.radius[v]"),
        ),
    ),
    "geometry/gradient.hpp": (
        GEOMETRY,
        (
            ("if («d > deepest») deepest = d, axis = k;", "d < deepest"),
            ("along_r = «r > z», along_z", "r < z"),
            ("if (k2 > 1) t = «(__builtin_sqrt(k2) - 1) * r_min * r_min»", "1e3"),
            ("double s = «clamp(along / length, 0, 1)»", "along / length"),
        ),
    ),
    "geometry/reach.hpp": (
        ("tests/core/test_tool_motion.py", "tests/query/endpoints/test_pose_sets.py"),
        (
            ("J[m][i] = «link.slide» ? a[i]", "false"),
            ("link.slide ? D{} : «a[i] - along * z[i]»", "a[i]"),
            ("«0.5 * (lk - kl)»", "(lk - kl)"),
            ("else if («cosine[i] < 0»)", "false"),
            ("if («any(any_blocked)») step", "false"),
            ("q[j] = where(going, «end», q[j])", "q[j] + moved[m]"),
            ("over |= «!(now.norm[i] < kProgress * past[i])»", "false"),
        ),
    ),
    "geometry/bounds.hpp": (
        ("tests/constraints/test_scene_constraints.py", "tests/constraints/test_planning.py"),
        (
            ("«float(room.upper[i]) - at»", "(at - float(room.lower[i]))"),
            ("tables.cone[k].angle «- double(margin) / kLever»", "+ double(margin) / kLever"),
            ("out |= room_clearance(tables.room[k], X_W) < «margin»", "-margin"),
            ("c[i] < -1 ? «-1» : double(c[i])", "1"),
        ),
    ),
    "kernels.cpp": (
        (*GEOMETRY, "tests/core/test_native_fuzz.py", "tests/costs/test_costs.py"),
        (
            ("free[first + i] = !hit[int(i)] && «is_number(states.q + (first + i) * nq, nq)»", "true"),
            ("if («!(pieces <= kMostPieces)») return false", "(pieces > kMostPieces)"),
            ("const int n_block = «int((pieces + 1.0) / W) + 1»;\n  const float", "int((pieces + 1.0) / (2 * W)) + 1"),
            ("1.f / float(«W * n_block - 1»)", "W * n_block"),
            ("const float limit = «far < 1e9» ?", "far > 1e9"),
            ("if (block == 0) sum -= «0.5 * value[0]»", "0.0"),
            ("duration = «seconds > duration» ? seconds", "seconds < duration"),
        ),
    ),
    "checks.hpp": (
        ("tests/core/test_native_fuzz.py", "tests/core/test_kernels.py"),
        (
            ("ok &= «std::fabs(values[i]) <= most»", "!(std::fabs(values[i]) > most)"),
            ("return «value >= low && value <= high»", "!(value < low || value > high)"),
            ("require(«q.ndim() == 2 && q.shape(1) == size_t(width)», what)", "q.ndim() == 2"),
        ),
    ),
    "edge_states.hpp": (
        ("tests/costs/test_edge_gradients.py", "tests/core/test_descent.py"),
        (
            ("by_a[j] = edge.length * by_a[j] «- along»", "+ along"),
            ("(«rate[j] < 0 ? -1.0 : 1.0»)", "1.0"),
            ("const double middle = («k + 0.5») / pieces", "k + 1.0"),
        ),
    ),
    "core.hpp": (
        ("tests/core/test_tool_motion.py", "tests/constraints/test_scene_constraints.py"),
        (
            ("if («d > 0» ? q[j] >= upper[j]", "d < 0"),
            ("motion.J[i][link.joint] = «link.slide» ? z[i]", "false"),
            ("out.turn[at] = «joint.slide» ? 0.0", "false"),
        ),
    ),
    "impact/interaction.hpp": (
        ("tests/core/test_kernels.py", "tests/costs/models/test_box_overlap.py", "tests/costs/test_costs.py"),
        (
            ("return «highest > whole.lower[2]» && overlaps", "highest > whole.upper[2]"),
            ("const auto above = «bottom > D{} + whole.upper[2]»", "(bottom > D{} + whole.lower[2])"),
            ("const D area = «minimum(boxes.area[component], D{} + entity.area)»", "boxes.area[component]"),
            ("«minimum(overlap / area, D{} + 1.0)»", "overlap / area"),
            ("«boxes.bottom[r] = minimum(boxes.bottom[r], c[2] - half[2])»", "boxes.bottom[r] = c[2] - half[2]"),
        ),
    ),
    "impact/flight/flight.hpp": (
        DROPS,
        (
            ("return («vz + square_root(vz * vz + 2.0 * kGravity * k)»)", "square_root(2.0 * kGravity * k)"),
            ("over *= «1.0 - f * h»", "V{} + 1.0"),
            ("if («!joint.slide») {", "true"),
            ("part.bottom = «z - up»", "z + up"),
        ),
    ),
    "impact/drop.hpp": (
        DROPS,
        (
            ("near = where(«flight.highest_bottom - top > kAbove<V>»", "(flight.highest_bottom - top > -kAbove<V>)"),
            ("best = «maximum(best, value)»", "best + value"),
            ("maximum(o.x - r.x, «-s.carries[0] - at.x»)", "-s.carries[0] + at.x"),
            ("«2.0 * k.leave_tilt * flight.tilt»", "0.0 * flight.tilt"),
            ("arrives *= «missed»", "(1.0 - missed)"),
            ("keep -= «caught»", "V{}"),
            ("minimum(«mass * keep + M», V{} + 1.0)", "mass * keep + 0.5 * M"),
            ("const V M = «leaving * falls»", "leaving"),
            ("top = «landing.height + flight.high - flight.low»", "landing.height + flight.high"),
        ),
    ),
    "impact/contents/spill.hpp": (
        SPILLS,
        (
            ("hard.below((«at.u - k.soft_speed»)", "at.u + k.soft_speed"),
            ("const V stays = at.flows * («1.0 - at.past»)", "at.past"),
            ("const V U = «sum[stands.end] - sum[stands.first]»", "sum[stands.end]"),
            ("mouth.vx = «flight.v.x + swing.x»", "flight.v.x"),
        ),
    ),
    "impact/contents/stop.hpp": (
        SPILLS,
        (
            ("«kGravity - rate * mouth.vz»", "kGravity + rate * mouth.vz"),
            ("longest = «maximum(longest, absolute(qd[j]) * stop.slowness[j])»", "absolute(qd[j]) * stop.slowness[j]"),
            ("lost = relu(«before.kept - braked.kept»)", "1.0 - braked.kept"),
        ),
    ),
    "impact/body_dynamics.hpp": (
        BODIES,
        (
            ("«R[3] - m * c.x * c.y»", "R[3] + m * c.x * c.y"),
            ("«t.w.x * c.h[1] - t.w.y * c.h[0] + c.mass * t.v.z»", "t.w.x * c.h[1] - t.w.y * c.h[0]"),
            ("M[j][j] += «Scalar<V>(body.drive[j].armature)»", "Scalar<V>(0)"),
            ("v = «(to < T(drive.lower)) | (to > T(drive.upper))» ?", "(to < T(drive.lower))"),
        ),
    ),
    "impact/body.hpp": (
        BODIES,
        (
            ("return stops ? «maximum(need, -way.blocked)» : need", "minimum(need, -way.blocked)"),
            ("loose = gap = «away - T(kSlack)»", "away + T(0.05)"),
            ("V u = maximum((«d - T(k.offset[generator][r])»)", "d + T(k.offset[generator][r])"),
            ("V gap = «maximum(loose_gap(i, o) - farthest, tight_gap(i, o) - most)»", "V(tight_gap(i, o))"),
        ),
    ),
    "timing/speed_profile.hpp": (
        PROFILES,
        (
            ("if («gain < 0 && S * row.reach < beta_[i] * -gain») limit", "false"),
            ("if («below > floor») floor", "below < floor"),
            ("if («gain > 0» && most < beta_[i] * gain)", "gain > 0.5"),
            ("set_row(2 * dim * i + dim + j, «slope[dim + j] + S * bend[dim + j]»", "slope[dim + j]"),
            ("if (fast * fast < «cap_[i + side]»", "cap_[i]"),
            ("if («next < best» && row.row", "next > best"),
        ),
    ),
    "timing/felt.hpp": (
        ("tests/constraints/test_specific_force.py",),
        (
            ("add3(velocity, «S», at.bend)", "0.0"),
            (
                "limit.room[f] «- limit.gravity * dot3(limit.facets[f], up)»",
                "+ limit.gravity * dot3(limit.facets[f], up)",
            ),
            ("room = «rests[f] * per»", "rests[f]"),
        ),
    ),
    "timing/felt_samples.hpp": (
        ("tests/constraints/test_specific_force.py", "tests/constraints/test_grasp.py"),
        (
            ("d.b + («end ? 2 * h_ * d.a : 0.0»)", "0.0"),
            ("add3(about, 1, «cross3(by.bend, motion.bend)»)", "cross3(by.bend, by.bend)"),
            ("«cross3(drive_[l].axis[k], by.axis[k])»", "by.axis[k]"),
        ),
    ),
    "timing/rider.hpp": (
        ("tests/constraints/test_specific_force.py",),
        (("add3(second, s, cross3(«both», J))", "turning"), ("add3(about, 1, «d_turn»)", "d_p")),
    ),
    "timing/spill.hpp": (
        ("tests/constraints/test_specific_force.py",),
        (
            ("slower * «push»", "0.0"),
            ("«x[i + end]», vessel", "x[i]"),
            (
                "if (!liquid && «!below(vessel.axis[i + end], felt[end], std::sqrt(dot3(felt[end], felt[end])))»",
                "below(vessel.axis[i + end], felt[end], std::sqrt(dot3(felt[end], felt[end])))",
            ),
        ),
    ),
    "timing/travel.hpp": (
        ("tests/timing/test_retiming.py",),
        (
            ("const bool stays = «rests[i] || i == 0» || i + 1", "i == 0"),
            ("max({«std::abs(a0)», std::abs(a1)", "0.0"),
            ("crossing = «a0 * a1 < 0» ? a0", "false"),
        ),
    ),
    "timing/slosh.hpp": (
        ("tests/constraints/test_specific_force.py",),
        (("lack = («std::acos(cosine) - limit_.angle») / unit", "std::acos(cosine)"),),
    ),
    "timing/pendulum.hpp": (
        ("tests/constraints/test_specific_force.py",),
        (("add3(rate, «-dot3(rate, d)», d)", "0.0"), ("- «drag * rate[i]»)", "0 * drag")),
    ),
    "mobile/grid/distance_field.hpp": (
        ("tests/mobile/floor/test_floor_map.py",),
        (
            ("«last[x] == 0.0F ? 0.5F : last[x] + 1.0F»", "last[x] + 1.0F"),
            ("h = «std::min(before, after)»", "after"),
            ("if («begin > from_[size_t(top)]») break", "true"),
            ("* («1.0 - 1e-7»)", "1.0 + 1e-6"),
            ("«std::min(own * own, d * d + height_[size_t(k)])»", "d * d + height_[size_t(k)]"),
        ),
    ),
    "mobile/lattice/floor_field.hpp": (
        ("tests/mobile/floor/test_lattice.py", "tests/mobile/floor/test_reeds_shepp.py"),
        (
            (
                "return distance[index(c)] «- std::hypot(x - (c.x + 0.5) * resolution, y - (c.y + 0.5) * resolution)»",
                "+ std::hypot(x - (c.x + 0.5) * resolution, y - (c.y + 0.5) * resolution)",
            ),
            ("if (!holds(c)) return «-1.0»", "1.0"),
            ("std::max(dx, dy) + («grid::kDiagonal - 1.0») * std::min(dx, dy)", "grid::kDiagonal"),
        ),
    ),
    "mobile/control/dynamic_window.hpp": (
        ("tests/mobile/control/test_dwa.py", "tests/mobile/control/test_controllers.py"),
        (
            ("if («d <= touch») break", "d <= -1"),
            ("stops = std::fabs(one.v) <= «2 * limits_.a * left»", "20 * limits_.a * left"),
            ("const double left = std::max(0.0, «time - kStep - set_.period»)", "time"),
            ("std::fabs(v) «+ limits_.lever * std::fabs(omega)» > limits_.rim", "+ 0 * limits_.lever"),
        ),
    ),
    "search/graph.hpp": (
        ("tests/planners/roadmaps/test_graph.py",),
        (
            ("return «second >= least[size_t(node)]»", "second > 2 * least[size_t(node)]"),
            ("if (is_goal[size_t(i)]) return {way_back(from, i), «d», 0}", "d + 1"),
        ),
    ),
}
"""File -> its tests and its edits."""

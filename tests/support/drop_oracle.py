"""The oracle of `costs.models.drop`: one state at a time, scalar loops, straight from MuJoCo.

It reads the specification in `graceful_plan.costs.models.drop` and shares no code with it, neither tables,
kinematics nor velocities; only the constants.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

BETA = math.sqrt(3.0) / math.pi
G = 9.81


def S(u):
    return 1.0 / (1.0 + math.exp(max(-300.0, min(300.0, -u / BETA))))


def box(x, A, s):
    A = max(A, 1e-4)
    f = math.exp(max(-300.0, min(300.0, (x - A) / (s * BETA))))
    h = math.exp(max(-300.0, min(300.0, -(x + A) / (s * BETA))))
    return (1.0 - f * h) / ((1.0 + f) * (1.0 + h))


def fall(vz, h):
    return (vz + math.sqrt(vz * vz + 2.0 * G * 0.5 * (h + math.sqrt(h * h + 1e-4)))) / G


def smooth(x):
    t = max(0.0, min(1.0, 0.5 + 0.5 * x))
    return t * t * (3.0 - 2.0 * t)


def pos(x):
    return 0.5 * (x + math.sqrt(x * x + 1e-4))


def constants(settings, scene):
    """Return the constants for the carried object of a scene."""
    model = scene.model
    geoms = [g for g in scene.components["carried"].geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
    main = max(geoms, key=lambda g: np.prod(model.geom_aabb[g, 3:]))
    half = sorted(model.geom_aabb[main, 3:])
    kind = mujoco.mjtGeom(int(model.geom_type[main])).name
    if kind == "mjGEOM_SPHERE":
        return settings.ball
    if half[0] < 0.35 * half[1]:
        return settings.plate
    return settings.cylinder if kind in ("mjGEOM_CYLINDER", "mjGEOM_CAPSULE") else settings.box


def targets(scene, data):
    """Return all targets as dicts, by top, highest first."""
    model, found = scene.model, []
    held = model.body(scene.carried.body).id
    for g in range(model.ngeom):
        body = int(model.geom_bodyid[g])
        if not (model.geom_contype[g] or model.geom_conaffinity[g]) or body in scene.robot_bodies or body == held:
            continue
        kind = mujoco.mjtGeom(int(model.geom_type[g])).name[len("mjGEOM_") :]
        R, p, size = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g].copy(), model.geom_aabb[g, 3:].copy()
        if kind == "PLANE":
            size = np.array([*(w if w > 0.0 else 50.0 for w in model.geom_size[g, :2]), 0.0])
        else:
            p = p + R @ model.geom_aabb[g, :3]
        k = int(np.argmin(np.abs(R[2])))
        c, s = R[:2, k] / math.hypot(*R[:2, k])
        a = sum(abs(c * R[0, j] + s * R[1, j]) * size[j] for j in range(3))
        b = sum(abs(c * R[1, j] - s * R[0, j]) * size[j] for j in range(3))
        tall = sum(abs(R[2, j]) * size[j] for j in range(3))
        d, ca, cb = (a + b) / math.sqrt(2.0), a, b
        standing = abs(R[2, 2]) > 0.9
        if kind == "SPHERE" or (kind in ("CYLINDER", "CAPSULE") and standing):
            a = b = d = size[0]
            ca = cb = a * (0.9 if kind == "CYLINDER" else 0.2)
        elif kind == "ELLIPSOID":
            ca, cb = 0.2 * a, 0.2 * b
        elif kind in ("CYLINDER", "CAPSULE"):
            along = R[:2, 2] / math.hypot(*R[:2, 2])
            if abs(along[0] * c + along[1] * s) > math.sqrt(0.5):
                cb = 0.2 * b
            else:
                ca = 0.2 * a
        owner = next((e for e, entity in enumerate(scene.entities.values()) if g in entity.geoms), -1)
        found.append(dict(X=p[0], Y=p[1], c=c, s=s, a=a, b=b, d=d, ca=ca, cb=cb))
        found[-1] |= dict(Z=p[2] + tall, low=p[2] - tall, owner=owner, fixed=model.body_weldid[body] == 0)
    found.sort(key=lambda t: -t["Z"])
    level, top = -1, math.inf
    for t in found:
        if t["Z"] < top - 0.006 or level < 0:
            level, top = level + 1, t["Z"]
        t["level"] = level
    return found


def into(t, x, y):
    """Turn a vector from W into a target's axes."""
    return t["c"] * x + t["s"] * y, t["c"] * y - t["s"] * x


def reach(part, u):
    z = [sum(part["Q"][i, j] * u[i] for i in range(3)) for j in range(3)]
    if part["kind"] == "SPHERE":
        return part["half"][0]
    if part["kind"] in ("CYLINDER", "CAPSULE"):
        return abs(z[2]) * part["half"][2] + part["half"][0] * math.sqrt(max(1e-12, 1.0 - z[2] ** 2))
    return sum(abs(z[j]) * part["half"][j] for j in range(3))


def release(scene, q, qd):
    """Return centre of mass, its velocity and angular velocity by MuJoCo's Jacobians, and the data."""
    model, data = scene.model, scene.data_at(q)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    held = model.body(scene.carried.body).id
    c = data.xipos[held].copy()
    tool = int(model.site_bodyid[model.site(scene.tool).id])
    J, Jr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, J, Jr, c, tool)
    dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in scene.joints]
    return c, J[:, dofs] @ qd, Jr[:, dofs] @ qd, data


def slow_drop(scene, settings, q, qd):
    """Return first-impact probabilities by target, and the probability that each entity is hit."""
    return slow_details(scene, settings, q, qd)[:2]


def side_stop(T, parts, k, c, v, low, high):
    """Return the effect of the first side in the way: ts, p, E, target."""
    best = (0.0, 0.0, np.zeros(2), 0.0, None)  # effect first
    end = fall(v[2], low - min((t["Z"] for t in T), default=0.0)) + k.delay + 0.15
    for t in T:
        if not t["fixed"]:
            continue
        axes = np.array([[t["c"], t["s"]], [-t["s"], t["c"]]])
        half = (t["a"], t["b"])
        for i in (0, 1):
            lower, upper = [], []
            for axis in axes:
                middle = [float(axis @ part["o"][:2]) for part in parts]
                wide = [reach(part, (*axis, 0.0)) for part in parts]
                lower.append(min(m - w for m, w in zip(middle, wide, strict=True)))
                upper.append(max(m + w for m, w in zip(middle, wide, strict=True)))
            at, speed = axes @ (c[:2] - [t["X"], t["Y"]]), axes @ v[:2]
            gap = (at[i] + lower[i] if speed[i] < 0.0 else -(at[i] + upper[i])) - half[i]
            time = max(gap, 0.0) / max(abs(speed[i]), 1e-3)
            j = 1 - i
            across = abs(at[j] + speed[j] * time + 0.5 * (lower[j] + upper[j]))
            s = math.sqrt(k.position_spread**2 + (k.velocity_spread * time) ** 2)
            late = max(time - k.delay, 0.0)
            h = low + v[2] * late - 0.5 * G * late**2
            E = smooth(gap / 0.006 + 1.0) * smooth(
                (half[j] + 0.5 * (upper[j] - lower[j]) - across) / (math.sqrt(5.0) * s)
            )
            E *= smooth((t["Z"] - h) / 0.067) * smooth((h + high - low - t["low"]) / 0.067 - 1.0)
            E *= smooth(2.0 * abs(speed[i]) / 0.1 - 1.0)
            effect = E * abs(speed[i]) * max(end - time, 0.0)
            if effect > best[0]:
                best = (effect, time, -E * speed[i] * axes[i], E, t)
    return best[1:]


def slow_details(scene, settings, q, qd):
    """Return the same, and the other inputs of a spill."""
    k = constants(settings, scene)
    c, v, w, data = release(scene, q, qd)
    model, held = scene.model, scene.model.body(scene.carried.body).id
    parts, low_corner, high_corner = [], np.full(3, np.inf), np.full(3, -np.inf)
    R_WO, p_WO = data.xmat[held].reshape(3, 3), data.xpos[held]
    for g in scene.components["carried"].geoms:
        if not (model.geom_contype[g] or model.geom_conaffinity[g]):
            continue
        Q, half = data.geom_xmat[g].reshape(3, 3), model.geom_aabb[g, 3:]
        centre = data.geom_xpos[g] + Q @ model.geom_aabb[g, :3]
        kind = mujoco.mjtGeom(int(model.geom_type[g])).name[len("mjGEOM_") :]
        parts.append(dict(o=centre - c, Q=Q, half=half, kind=kind))
        around = np.abs(R_WO.T @ Q) @ half
        low_corner = np.minimum(low_corner, R_WO.T @ (centre - p_WO) - around)
        high_corner = np.maximum(high_corner, R_WO.T @ (centre - p_WO) + around)
    size = math.sqrt(np.mean((0.5 * (high_corner - low_corner)) ** 2))
    up = (0.0, 0.0, 1.0)
    for part in parts:
        part["bottom"] = c[2] + part["o"][2] - reach(part, up)
    low = min(part["bottom"] for part in parts)
    high = max(c[2] + part["o"][2] + reach(part, up) for part in parts)
    main = max(parts, key=lambda part: np.prod(part["half"]))
    m = [main["Q"][2, j] ** 2 for j in range(3)]
    if main["kind"] in ("CYLINDER", "CAPSULE"):
        m = [m[0] + m[1], m[2]]
    tilt = 0.0 if main["kind"] == "SPHERE" else 1.0 - sum(x * x for x in m)
    sp2 = v[0] ** 2 + v[1] ** 2

    T = targets(scene, data)
    ts, push, chance, side = side_stop(T, parts, k, c, v, low, high)

    def pushed(time):
        return push * max(time - ts, 0.0)

    for t in T:  # first contact
        t["D"] = 0.0
        ex, ey = (t["c"], t["s"], 0.0), (-t["s"], t["c"], 0.0)
        e1 = tuple((p + q_) / math.sqrt(2.0) for p, q_ in zip(ex, ey, strict=True))
        e2 = tuple((q_ - p) / math.sqrt(2.0) for p, q_ in zip(ex, ey, strict=True))
        for part in parts:
            h = part["bottom"] - t["Z"]
            time = fall(v[2], h)
            s = math.sqrt(k.position_spread**2 + (k.velocity_spread * time) ** 2)
            u = v + np.cross(w, part["o"])
            place = c[:2] + part["o"][:2] + u[:2] * (time + k.delay) + pushed(time + k.delay)
            x, y = into(t, *(place - [t["X"], t["Y"]]))
            D = box(x, t["a"] + reach(part, ex), s) * box(y, t["b"] + reach(part, ey), s) * S(h / 0.008 + 1.0)
            D *= box((x + y) / math.sqrt(2.0), t["d"] + reach(part, e1), s)
            D *= box((y - x) / math.sqrt(2.0), t["d"] + reach(part, e2), s)
            t["D"] = max(t["D"], D)
        t["time"] = fall(v[2], low - t["Z"]) + k.delay
        t["x0"] = into(t, *(c[:2] + v[:2] * t["time"] + pushed(t["time"]) - [t["X"], t["Y"]]))
    n_level = T[-1]["level"] + 1 if T else 0
    levels = [[t for t in T if t["level"] == level] for level in range(n_level)]
    arrives = 1.0
    for level in levels:
        missed = math.prod(1.0 - t["D"] for t in level)
        for t in level:
            t["C"] = arrives * t["D"]
            t["F"] = arrives * (1.0 - missed) * t["D"] / (sum(o["D"] for o in level) + 1e-6)
        arrives *= missed
    total = sum(t["F"] for t in T) + 1e-6
    zs = sum(t["F"] * t["Z"] for t in T) / total
    tl = sum(t["F"] * t["time"] for t in T) / total
    hs = sum(t["F"] * max(low - t["Z"], 0.0) for t in T) / total

    leaves, away, mass = [], [], []
    for level in levels:  # support
        sums = np.zeros(6)
        for t in level:
            for part in parts:
                ox, oy = into(t, part["o"][0], part["o"][1])
                rx, ry = reach(part, (t["c"], t["s"], 0.0)), reach(part, (-t["s"], t["c"], 0.0))
                x0, x1 = max(ox - rx, -t["ca"] - t["x0"][0]), min(ox + rx, t["ca"] - t["x0"][0])
                y0, y1 = max(oy - ry, -t["cb"] - t["x0"][1]), min(oy + ry, t["cb"] - t["x0"][1])
                wx, wy = max(0.0, x1 - x0), max(0.0, y1 - y0)
                area = math.exp(-(((part["bottom"] - low) / 0.012) ** 2)) * wx * wy
                turn = np.array([[t["c"], -t["s"]], [t["s"], t["c"]]])
                centre = turn @ [0.5 * (x0 + x1), 0.5 * (y0 + y1)]
                second = np.outer(centre, centre) + turn @ np.diag([wx**2 / 12.0, wy**2 / 12.0]) @ turn.T
                sums += area * np.array([1.0, *centre, second[0, 0], second[1, 1], second[0, 1]])
        E = sums[1:3] / (sums[0] + 1e-6)
        V = np.array([[sums[3], sums[5]], [sums[5], sums[4]]]) / (sums[0] + 1e-6) - np.outer(E, E) + 1e-5 * np.eye(2)
        det = max(V[0, 0] * V[1, 1] - V[0, 1] ** 2, 1e-11)
        d2 = (V[1, 1] * E[0] ** 2 - 2.0 * V[0, 1] * E[0] * E[1] + V[0, 0] * E[1] ** 2) / det
        off, narrow = d2 / (3.0 + d2), det / (V[0, 0] + V[1, 1])
        hh = c[2] - low
        leaves.append(S(k.leave + 2.0 * k.leave_offset * (off - 0.5)
                        + 0.5 * k.leave_narrow * math.log((hh * hh + 1e-6) / (3.0 * narrow))
                        + k.leave_speed * math.sqrt(sp2 + 1e-4) + 2.0 * k.leave_tilt * tilt))  # fmt: skip
        away.append(-off * E / math.sqrt(E @ E + 1e-6))
        mass.append(sum(t["F"] for t in level))
    leaving = [f * p for f, p in zip(mass, leaves, strict=True)]

    blur = k.position_spread**2 + (k.velocity_spread * tl) ** 2 + (k.height_spread * hs) ** 2
    sd = math.sqrt(blur + k.carry_spread**2 * sp2 + (k.size_spread * size) ** 2)
    carried = c[:2] + v[:2] * (tl + k.carry) + pushed(tl + k.carry)

    def missed(level, place):
        product = 1.0
        for t in level:
            x, y = into(t, *(place - [t["X"], t["Y"]]))
            inside = box(x, pos(t["ca"] + k.catch_margin * size), sd) * box(y, pos(t["cb"] + k.catch_margin * size), sd)
            wide2 = min(t["ca"], t["cb"]) ** 2
            product *= 1.0 - (k.catch + (1.0 - k.catch) * wide2 / (wide2 + 0.01)) * inside
        return product

    B, N = 0.0, np.zeros(2)
    for index, level in enumerate(levels):  # falls
        point = carried + k.drift * size * N / (B + 1e-6)
        for t in level:
            x, y = into(t, *(point - [t["X"], t["Y"]]))
            t["G"] = B * box(x, t["a"] + k.tumble_reach * size, sd) * box(y, t["b"] + k.tumble_reach * size, sd)
        keep, falls = missed(level, point), missed(level, carried + k.drift * size * away[index])
        B, N = B * keep + falls * leaving[index], N * keep + falls * leaving[index] * away[index]

    Tm = sum(leaving) / total
    drift = sum((m_ * n for m_, n in zip(leaving, away, strict=True)), np.zeros(2)) / total
    sl = math.sqrt(blur + (k.side_spread * size) ** 2 + (k.size_spread * size * Tm) ** 2)
    r = (k.side_reach + k.topple_reach * Tm) * size
    P = np.zeros(len(scene.entities))
    for t in T:  # side contacts
        slid = c[:2] + v[:2] * (tl + k.slide) + pushed(tl + k.slide)
        x1, y1 = into(t, *(slid - [t["X"], t["Y"]] + k.drift * size * drift))
        x0, y0 = t["x0"]
        below = max(0.0, sum(mass[t["level"] :]) - t["C"])
        H = below * S((zs + high - low - t["low"]) / k.side_height)
        H *= box(0.5 * (x0 + x1), t["a"] + 0.5 * math.sqrt((x1 - x0) ** 2 + 1e-6) + r, sl)
        H *= box(0.5 * (y0 + y1), t["b"] + 0.5 * math.sqrt((y1 - y0) ** 2 + 1e-6) + r, sl)
        if t is side:
            H = max(H, chance * (1.0 - sum(mass) * (1.0 - smooth((tl - ts) / 0.067))))
        if t["owner"] >= 0:
            P[t["owner"]] = max(P[t["owner"]], 1.0 - (1.0 - t["C"]) * (1.0 - t["G"]) * (1.0 - H))
    for e in range(len(P)):
        P[e] = max(P[e], sum(t["F"] for t in T if t["owner"] == e))
    details = dict(levels=levels, pushed=pushed, mass=mass, leaving=leaving, low=low, hs=hs, c=c, v=v, w=w, data=data)
    return np.array([t["F"] for t in T]), P, details

"""The oracle of `models.spill`: one state at a time, scalar loops, straight from MuJoCo.

It reads the specification in `graceful_plan.costs.models.spill` and shares no code with it; only the constants.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from drop_oracle import G, S, box, into, pos, slow_details

import graceful_plan as gp


def container(scene, data):
    """Return the middle of the contents' top, axis, radius and depth, in W."""
    model = scene.model
    (g,) = scene.components["contents"].geoms
    R, half = data.geom_xmat[g].reshape(3, 3), model.geom_aabb[g, 3:]
    body = model.body(scene.carried.body).id
    axis = R[:, 2] if R[:, 2] @ data.xmat[body].reshape(3, 3)[:, 2] > 0 else -R[:, 2]
    centre = data.geom_xpos[g] + R @ model.geom_aabb[g, :3]
    bottom, depth = centre - half[2] * axis, 2.0 * half[2]
    radius = max(half[0], half[1])
    if mujoco.mjtGeom(int(model.geom_type[g])).name == "mjGEOM_BOX":
        radius = math.sqrt(4.0 * half[0] * half[1] / math.pi)
    for other in scene.components["carried"].geoms:
        Q, h = data.geom_xmat[other].reshape(3, 3), model.geom_aabb[other, 3:]
        p = data.geom_xpos[other] + Q @ model.geom_aabb[other, :3] - bottom
        c = [abs(Q[:, i] @ axis) for i in range(3)]
        k = int(np.argmax(c))
        i, j = (x for x in range(3) if x != k)
        round_ = min(h[i], h[j]) >= 0.5 * max(h[i], h[j]) and c[k] >= 0.9
        if round_ and np.linalg.norm(p - (p @ axis) * axis) <= 0.25 * radius:
            depth = max(depth, p @ axis + sum(h[x] * c[x] for x in range(3)))
    return centre + half[2] * axis, axis, radius, depth


def visible(T, t):
    """Return the share of a target's points that no much higher target covers."""
    if "visible" not in t:
        t["visible"] = _visible(T, t)
    return t["visible"]


def _visible(T, t):
    seen = 0
    for i in range(7):
        for j in range(7):
            x, y = ((2 * i + 1) / 7 - 1) * t["a"], ((2 * j + 1) / 7 - 1) * t["b"]
            X, Y = t["X"] + t["c"] * x - t["s"] * y, t["Y"] + t["s"] * x + t["c"] * y
            for o in T:
                u, v = into(o, X - o["X"], Y - o["Y"])
                if o["Z"] > t["Z"] + 0.02 and abs(u) < o["a"] and abs(v) < o["b"]:
                    break
            else:
                seen += 1
    return seen / 49


def slow_spill(scene, settings, k, q, qd):
    """Return the probability that contents reach each entity, for constants k of one use."""
    _, P, d = slow_details(scene, settings, q, qd)
    levels, c, v, w, low = d["levels"], d["c"], d["v"], d["w"], d["low"]
    T = [t for level in levels for t in level]
    place, axis, r, depth = container(scene, d["data"])
    dry = isinstance(scene.contents, gp.Granular)
    volume, room = scene.contents.volume / 1000.0, math.pi * r * r * depth
    volume = min(volume, room)
    full = room / volume
    slope = math.tan(math.radians(33.0))
    R = (3.0 * volume / (math.pi * slope)) ** (1.0 / 3.0) if dry else math.sqrt(volume / (math.pi * 0.002))
    vm = v + np.cross(w, place - c)
    sm2 = vm[0] ** 2 + vm[1] ** 2
    p = 0.5 * (axis[2] + math.sqrt(axis[2] ** 2 + 0.01))
    lean = max(0.0, math.sqrt(1.0051 - p * p) / p - (slope if dry else 0.0)) + k.slosh * math.sqrt(sm2 + 1e-4)
    x = r * lean / depth
    fill = (1.0 + x + x * x + 1.7 * x**3) / full
    rho = R / (1.0 + fill**4) ** (0.25 / (3.0 if dry else 2.0))
    s = math.sqrt(
        k.position_spread**2 + (k.rim_spread * r) ** 2 + k.speed_spread**2 * sm2 + (k.height_spread * d["hs"]) ** 2
    )

    def within(t, X, Y, margin):
        a, b = into(t, place[0] + X - t["X"], place[1] + Y - t["Y"])
        return box(a, t["a"] + margin, s) * box(b, t["b"] + margin, s)

    O, o, landed = 0.0, np.zeros(2), []  # noqa: E741
    for level, F, M in zip(levels, d["mass"], d["leaving"], strict=True):
        u = math.sqrt(v[2] ** 2 + 2.0 * G * pos(low - level[0]["Z"]))
        hard = S((u - k.soft_speed) / k.soft_spread)
        a = F * hard + M * (1.0 - hard)
        L = vm[:2] * (level[0]["time"] + k.carry) + d["pushed"](level[0]["time"] + k.carry)
        at = o / (O + 1e-6)
        g = 1.0
        for t in level:
            t["A"] = a * within(t, *L, k.margin)
            onto = visible(T, t) * within(t, *at, k.run_off * rho)
            t["B"] = O * onto
            g *= 1.0 - onto
        U, W = a + O * (1.0 - g), a * L + O * (1.0 - g) * at
        h = 1.0
        for t in level:
            if min(t["a"], t["b"]) > k.edge * R:
                h *= 1.0 - within(t, *(W / (U + 1e-6)), -k.edge * R)
        landed.append((level[0]["Z"], U, W))
        O, o = O * g + U * h, o * g + W * h  # noqa: E741
    P = np.zeros(len(scene.entities))
    for t in T:
        on = [(U, W) for Z, U, W in landed if t["low"] - 0.01 < Z < t["Z"] - 0.001]
        U, W = sum(U for U, _ in on), sum((W for _, W in on), np.zeros(2))
        D = min(1.0, U) * within(t, *(W / (U + 1e-6)), k.reach * rho)
        if t["owner"] >= 0:
            P[t["owner"]] = max(P[t["owner"]], 1.0 - (1.0 - t["A"]) * (1.0 - t["B"]) * (1.0 - D))
    return P

"""Plan a hundred thousand motions on random scenes and judge each by means of its own.

python benchmarks/many_motions.py [--motions 100000] [--seed 0] [--log FILE]

Bundled and unseen scenes get up to eight random solids; start and goal are random, the planner and w as well. What
SOLVED motions have to be is worked out here from the samples t, q and qd and MuJoCo's own collision detection, without
the library's judge: the cubics between samples keep position, velocity and acceleration limits at their extremes, no
piece between two samples is shorter than ten microseconds, no contact of the robot or its object is deeper than a
micrometre every 4 ms, and the ends are those that were asked for. Budgets are iterations, so that a busy machine plans
the same motions as an idle one. The log has a line every hundred motions, and one for everything that is wrong; a run
goes on where its log ends.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import graceful_plan as gp  # noqa: E402
from graceful_plan.compare.runs import machine  # noqa: E402

Array = np.ndarray

SAME_SCENE = 50
"""Motions planned in one random scene."""
STEP = 0.004
"""Between configurations that are looked at [s]."""
DEPTH = 1e-6
"""Of a contact that counts [m]: what rounding makes of two faces that touch."""
SLACK = 1e-6
"""Relative, of limits."""
SHORTEST = 1e-5
"""Between two samples [s]."""
PATIENCE = 2.0
"""Seconds after which a search gives up: a quiet machine never takes so long."""
PLANNERS = ("rrt_connect", "anytime", "auto", "auto", "bitrrt", "prm")


def main() -> int:
    """Return how many motions were wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--log", type=Path, default=Path(__file__).with_name("many_motions.jsonl"))
    args = parser.parse_args()
    lines = [json.loads(line) for line in args.log.read_text().splitlines()] if args.log.exists() else []
    seen: Counter[str] = Counter(lines[-1]["so far"] if lines else {})
    block = lines[-1]["blocks"] if lines else 0
    bases = scenes()
    with args.log.open("a") as log:
        if not lines:
            log.write(json.dumps({"machine": machine.described(), "so far": {}, "blocks": 0}) + "\n")
        told, begun = seen["SOLVED"] // 100, time.perf_counter()
        while seen["SOLVED"] < args.motions:
            for said in judged(bases, np.random.default_rng((args.seed, block)), seen):
                log.write(json.dumps({**said, "block": block, "so far": dict(seen), "blocks": block}) + "\n")
                log.flush()
            block += 1
            if seen["SOLVED"] // 100 > told:
                told, took = seen["SOLVED"] // 100, time.perf_counter() - begun
                log.write(json.dumps({"so far": dict(seen), "blocks": block, "seconds": round(took)}) + "\n")
                log.flush()
    print(f"{dict(seen)} in {block} random scenes")
    return seen["wrong"]


def scenes() -> list[gp.Scene]:
    """Return what random solids are put into: with the hand empty, and with what tasks carry."""
    unseen = sorted((ROOT / "benchmarks" / "unseen").glob("*.yaml"))
    plain = [gp.load_scene(name) for name in (*gp.scenes(), *unseen)]
    return [scene for base in plain for scene in (base, *(task.scene for task in base.tasks.values()))]


def judged(bases: list[gp.Scene], rng: np.random.Generator, seen: Counter[str]) -> Iterator[dict[str, Any]]:
    """Plan in one random scene, count what came of it, and yield what is wrong."""
    scene = bases[rng.integers(len(bases))]
    scene = scene.edit(add=[solid(rng, i) for i in range(rng.integers(9))])
    checker = Checker(scene)
    lower, upper = scene.limits.position.T
    q = rng.uniform(lower, upper, (40 * SAME_SCENE, len(lower)))
    free = q[gp.clearance(q, scene) > 0.0]
    for i in range(min(SAME_SCENE, len(free) // 2)):
        start, goal = free[2 * i], free[2 * i + 1]
        planner, seed = str(rng.choice(PLANNERS)), int(rng.integers(2**31))
        first = rng.random() < 0.85
        given: dict[str, Any] = (
            {"w": 0.0, "callback": lambda _: True}
            if first
            else {"w": float(rng.choice([0.3, 3.0])), "iterations": int(rng.integers(20, 200))}
        )
        # Constraints are not what is judged here; free states seldom keep them.
        result = gp.plan(start, goal, scene, planner=planner, seed=seed, time_limit=PATIENCE, constraints=[], **given)
        seen[result.status.name] += 1
        if result.status is not gp.PlanStatus.SOLVED:
            continue
        problems = checker.problems(result.unwrap(), start, goal)
        seen["wrong"] += bool(problems)
        if problems:
            yield {"wrong": problems, "scene": scene.name, "planner": planner, "seed": seed, "index": i}


def solid(rng: np.random.Generator, i: int) -> gp.StaticBody:
    """Return something within the reach of an arm."""
    place = rng.uniform((-0.8, -0.8, 0.0), (0.8, 0.8, 1.2))
    kind = str(rng.choice(["box", "sphere", "cylinder", "capsule"]))
    size = rng.uniform(0.02, 0.15, {"box": 3, "sphere": 1}.get(kind, 2))
    if np.linalg.norm(place[:2]) < 0.3:
        place[0] += 0.5
    return gp.StaticBody(name=f"random{i}", kind=kind, size=size, pose=place)


class Checker:
    """What a motion in a scene has to be, by MuJoCo alone."""

    def __init__(self, scene: gp.Scene) -> None:
        self.scene, model = scene, scene.model
        self.data = scene.data_at(scene.home_qpos[scene.qpos_adr])
        held = set() if scene.carried is None else {model.body(scene.carried.body).id}
        whole = {body for body in range(model.nbody) if held & set(ancestors(model, body))} | set(scene.robot_bodies)
        self.mine = np.isin(model.geom_bodyid, list(whole))
        self.may_touch = {
            frozenset((a, b))
            for contact in scene.allowed_contacts
            if contact.when == "always"
            for a in scene.geoms_named(contact.first)
            for b in scene.geoms_named(contact.second)
        }

    def problems(self, motion: gp.Trajectory, start: Array, goal: Array) -> list[str]:
        """Say what is wrong with a motion."""
        ends = np.abs(motion.q[0] - start).max(), np.abs(motion.q[-1] - goal).max()
        found = [f"{name} is {off:.2g} away" for name, off in zip(("start", "goal"), ends, strict=True) if off > 1e-9]
        least = float(np.diff(motion.t).min(initial=np.inf))
        short = [f"a piece takes {least:.2g} s"] if least < SHORTEST else []
        return found + short + list(self.over(motion)) + list(self.touching(motion))

    def over(self, motion: gp.Trajectory) -> Iterator[str]:
        """Yield limits that the cubics do not keep."""
        limits, (h, a, va, c, d) = self.scene.limits, cubics(motion)
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = np.clip(np.nan_to_num(-c / (3.0 * d)), 0.0, 1.0)
            root = np.sqrt(np.maximum(c * c - 3.0 * d * va, 0.0))
            stops = [np.clip(np.nan_to_num(x), 0.0, 1.0) for x in ((-c - root) / (3.0 * d), (root - c) / (3.0 * d))]
        q = np.stack([a + s * (va + s * (c + s * d)) for s in (0.0, 1.0, *stops)])
        speed = np.stack([va + s * (2.0 * c + 3.0 * s * d) for s in (0.0, 1.0, turn)]) / h
        push = np.stack([2.0 * c, 2.0 * c + 6.0 * d]) / h**2
        for name, value, most in (
            ("position", q, None),
            ("velocity", speed, limits.velocity),
            ("acceleration", push, limits.acceleration),
        ):
            beyond = (
                np.maximum(limits.position[:, 0] - value, value - limits.position[:, 1]).max()
                if most is None
                else (np.abs(value) / most).max() - 1.0
            )
            if beyond > SLACK:
                yield f"{name} limit exceeded by {beyond:.3g}"

    def touching(self, motion: gp.Trajectory) -> Iterator[str]:
        """Yield the first contact that is too deep."""
        times = np.append(np.arange(motion.t[0], motion.t[-1], STEP), motion.t[-1])
        for t, q in zip(times, motion.at(times).q, strict=True):
            pairs, depth = self.contacts(q)
            for a, b in pairs[(depth < -DEPTH) & self.mine[pairs].any(axis=1)].tolist():
                if frozenset((a, b)) not in self.may_touch:
                    yield f"geoms {a} and {b} touch at {t:.3f} s"
                    return

    def contacts(self, q: Array) -> tuple[Array, Array]:
        """Return the geoms of all contacts and their distances [m], with the object where the tool holds it."""
        scene, model, data = self.scene, self.scene.model, self.data
        data.qpos[scene.qpos_adr] = q
        mujoco.mj_kinematics(model, data)
        if scene.carried is not None:
            site, X_TO = data.site(scene.tool), scene.carried.X_TO
            R_WT = site.xmat.reshape(3, 3)
            adr = model.jnt_qposadr[model.body_jntadr[model.body(scene.carried.body).id]]
            data.qpos[adr : adr + 3] = site.xpos + R_WT @ X_TO[:3, 3]
            mujoco.mju_mat2Quat(data.qpos[adr + 3 : adr + 7], (R_WT @ X_TO[:3, :3]).ravel())
            mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        return data.contact.geom, data.contact.dist


def cubics(motion: gp.Trajectory) -> tuple[Array, Array, Array, Array, Array]:
    """Return how long each piece takes [s], and a, b, c and d of its q(s) = a + b s + c s^2 + d s^3 on [0, 1]."""
    h = np.diff(motion.t)[:, None]
    a, b, va, vb = motion.q[:-1], motion.q[1:], motion.qd[:-1] * h, motion.qd[1:] * h
    return h, a, va, 3.0 * (b - a) - 2.0 * va - vb, 2.0 * (a - b) + va + vb


def ancestors(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """Yield a body and everything that it hangs on."""
    while body:
        yield body
        body = int(model.body_parentid[body])


if __name__ == "__main__":
    sys.exit(min(main(), 100))

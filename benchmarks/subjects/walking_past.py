"""Bases among those who walk: is regard for time worth anything, and is the law of time near the best there is?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite

Array = np.ndarray

TITLE = "Bases among those who walk past: with and without regard for time"
ROOMS, SECONDS, SEED = 30, 8.0, 16
SIZE = (10.0, 5.0)
"""Of a room [m]."""
WAIT = 3.0
"""Longest wait [s]."""
ROLLS = 300
"""Failures of each motion."""
MEASURED = f"""\
{ROOMS} rooms of {SIZE[0]:g} x {SIZE[1]:g} m made at random with three boxes. A Jackal crosses each from end to end,
planned in {SECONDS:g} s at the default weight, while two adults walk straight on at 0.6 to 1.2 m/s and pass the line
between start and goal about when a base would that drives at 1.5 m/s: from in front, from behind or from the side.
Where they are is known to 0.05 m and 0.05 m/s. Three plans for each: "nobody", as if nobody walked; "standing", with
both as entities where they are at the start; "in time", by `Scene.with_moving` and `max_wait={WAIT:g}`. All are judged
among those who walk: whether the sound robot drives into somebody (exact geometry, at the predicted places), and the
harm of failures per executed task, the exposure of severity to both adults where they then are, by the model's own
probabilities (`mobile/coast/moving_entities.py`). "By chance" does without its closed forms: {ROLLS} failures of each
motion are rolled step by step along the arc of the moment, with stops drawn from the model's ways in which both sides
do the same, and walkers off their prediction; harm counts the square of the speed at the first touch.
"""


@dataclass(frozen=True, kw_only=True)
class Walked:
    """What came of one plan in one room."""

    room: int
    plan: str
    status: str
    into: bool = True
    harm: float = np.nan
    rolled: float = np.nan
    duration: float = np.nan
    seconds: float = np.nan


def room(seed: int) -> tuple[gp.OccupancyGrid, Array, Array, list[gp.MovingEntity]]:
    """Return a floor, a start, a goal, and who walks."""
    rng = np.random.default_rng((SEED, 7, seed))
    cell = 0.05
    rows, columns = (round(extent / cell) for extent in SIZE[::-1])
    occupied = np.zeros((rows, columns), dtype=bool)
    for _ in range(3):
        half = rng.uniform(0.15, 0.4, 2)
        x, y = rng.uniform([2.0, 0.3], [SIZE[0] - 2.0, SIZE[1] - 0.3])
        low, high = ((np.array([x, y]) + sign * half) / cell for sign in (-1, 1))
        (a, b), (c, d) = np.maximum(low.astype(int), 0), high.astype(int)
        occupied[b:d, a:c] = True
    start, goal = (np.array([x, rng.uniform(1.2, SIZE[1] - 1.2), 0.0]) for x in (1.0, SIZE[0] - 1.0))
    return (
        gp.OccupancyGrid(occupancy=occupied, resolution=cell),
        start,
        goal,
        [_walker(k, start, goal, rng) for k in range(2)],
    )


def _walker(k: int, start: Array, goal: Array, rng: np.random.Generator) -> gp.MovingEntity:
    """Return somebody who passes the way of the base about when it does."""
    share, speed = rng.uniform(0.25, 0.85), rng.uniform(0.6, 1.2)
    place = start[:2] + share * (goal - start)[:2] + rng.normal(0.0, 0.3, 2)
    passes = share * float(np.linalg.norm((goal - start)[:2])) / 1.5 + 0.5 + rng.normal(0.0, 0.5)
    heading = rng.choice([0.0, 0.5, 1.0, 1.5]) * np.pi + rng.normal(0.0, 0.3)
    along = speed * np.array([np.cos(heading), np.sin(heading)])
    t = np.array([0.0, passes + 4.0])
    ends = [[*(place + (at - passes) * along), 0.85] for at in t]
    return gp.MovingEntity(f"walker_{k}", "adult", size=[0.25, 0.85], t=t, position=ends, spread=0.05, growth=0.05)


def crossed(seed: int) -> list[Walked]:
    """Plan in one room in each of the ways."""
    floor, start, goal, walkers = room(seed)
    there = floor.to_scene()
    real = there.with_moving(*walkers)
    solids = [
        gp.StaticBody(name=w.name, kind="cylinder", size=w.size, pose=w.position[0], entity=w.category) for w in walkers
    ]
    scenes: dict[str, tuple[Callable[[], gp.Scene], float]] = {
        "nobody": (lambda: there, 0.0),
        "standing": (lambda: floor.with_entities(*solids).to_scene(), 0.0),
        "in time": (lambda: real, WAIT),
    }
    return [_judged(seed, name, make(), wait, (start, goal), real) for name, (make, wait) in scenes.items()]


def _judged(seed: int, name: str, scene: gp.Scene, wait: float, ends: tuple[Array, Array], real: gp.Scene) -> Walked:
    start, goal = ends
    gp.plan(start, gp.BasePose(*goal[:2]), scene, iterations=1)  # compiled before the clock runs
    result = gp.plan(start, gp.BasePose(*goal[:2]), scene, time_limit=SECONDS, max_wait=wait)
    if result.trajectory is None:
        return Walked(room=seed, plan=name, status=result.status.name)
    cost = gp.evaluate(result.trajectory, real)
    return Walked(
        room=seed,
        plan=name,
        status=result.status.name,
        into=not gp.verify(result.trajectory, real).checks["passing_by"].passed,
        harm=sum(cost.impact_by_entity[who] for who in real.moving),
        rolled=rolled(result.trajectory, real, np.random.default_rng((SEED, seed))),
        duration=result.trajectory.duration,
        seconds=result.stats["total_time"],
    )


def rolled(trajectory: gp.Trajectory, scene: gp.Scene, rng: np.random.Generator, n: int = ROLLS) -> float:
    """Return the harm per executed task of failures at random moments, step by step: no closed form of the model."""
    from graceful_plan.mobile.coast.constants import CoastSettings

    settings, base = CoastSettings.shipped(), scene.base
    assert base is not None
    stops = np.asarray(settings.stops(base.load))
    way = stops[rng.choice(len(stops), n, p=stops[:, 0] / stops[:, 0].sum())]
    t0 = rng.uniform(trajectory.t[0], trajectory.t[-1], n)
    state = trajectory.at(t0)
    x, y, yaw = state.q[:, 0].copy(), state.q[:, 1].copy(), state.q[:, 2].copy()
    v = state.qd[:, 0] * np.cos(yaw) + state.qd[:, 1] * np.sin(yaw)
    bend, gear = state.qd[:, 2] / np.where(np.abs(v) > 1e-6, v, np.inf), np.sign(v)
    speed, dt, harm, met = np.abs(v), 0.02, np.zeros(n), np.zeros((n, len(scene.moving)), dtype=bool)
    off = rng.standard_normal((len(scene.moving), n, 2))
    for k in range(int(12.0 / dt)):
        t = t0 + k * dt
        braking = np.where(k * dt >= way[:, 3], way[:, 1] + way[:, 2] * speed, 0.0)
        for j, (name, entity) in enumerate(scene.moving.items()):
            at = entity.at(t)
            place = at.position[:, :2] + at.spread[:, None] * off[j]
            c, s = np.cos(yaw), np.sin(yaw)
            dx, dy = place[:, 0] - x, place[:, 1] - y
            ahead, aside = np.abs(c * dx + s * dy) - 0.229, np.abs(c * dy - s * dx) - 0.208
            near = np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0)) < entity.size[0]
            new = near & ~met[:, j] & (speed > 1e-3)
            worth = np.minimum(1.0, (speed / settings.reference_speed) ** 2)
            harm += np.where(new, scene.moving_severity[name]["body"] * worth, 0.0)
            met[:, j] |= near
        speed = np.where(met.any(axis=1), 0.0, np.maximum(speed - braking * dt, 0.0))
        if not (speed > 0.0).any():
            break
        x, y = x + gear * speed * dt * np.cos(yaw), y + gear * speed * dt * np.sin(yaw)
        yaw = yaw + bend * gear * speed * dt
    return float(harm.mean()) * trajectory.duration


def run(options: suite.Options) -> str:
    """Measure all."""
    jobs = list(range(options.pick(ROOMS, quick=3)))
    found = [one for part in suite.spread(crossed, jobs, options.processes, "walking past") for one in part]
    rows, means = [], {}
    for name in ("nobody", "standing", "in time"):
        mine = [one for one in found if one.plan == name]
        solved = [one for one in mine if one.status == "SOLVED"]
        harm, rolls, took = (
            np.array([getattr(one, what) for one in solved]) for what in ("harm", "rolled", "duration")
        )
        into = sum(one.into for one in solved)
        means[name] = float(harm.mean()), into, float(np.median(took))
        rows.append(
            [
                name,
                f"{len(solved)} of {len(mine)}",
                into,
                f"{harm.mean():.3f}",
                f"{np.median(harm):.3f}",
                f"{rolls.mean():.3f}",
                f"{np.median(took):.2f}",
                f"{max((one.seconds for one in solved), default=np.nan):.1f}",
            ]
        )
    timely = {one.room: one.harm for one in found if one.plan == "in time" and one.status == "SOLVED"}
    same = [(one.harm, timely[one.room]) for one in found if one.plan == "nobody" and one.room in timely]
    before, after = np.array(same).reshape(-1, 2).sum(axis=0)
    less = float(before) / max(float(after), 1e-9)
    targets = [
        report.Target(
            what="rooms crossed in time", wanted="100 %", measured=f"{len(timely)} of {len(jobs)}",
            met=len(timely) == len(jobs),
        ),
        report.Target(
            what="motions in time that drive into somebody", wanted="0", measured=str(means["in time"][1]),
            met=means["in time"][1] == 0,
        ),
        report.Target(
            what="harm, as if nobody walked over in time, same rooms", wanted=">= 3", measured=f"{less:.1f}",
            met=less >= 3.0,
        ),
    ]  # fmt: skip
    columns = ("harm per task, mean", "median", "by chance, mean", "duration s", "slowest plan s")
    header = ("plan", "solved", "drive into somebody", *columns)
    return f"{MEASURED}\n{report.targets(targets)}\n{report.table(header, rows)}"

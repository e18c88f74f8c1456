"""Tasks of mobile robots: first verified motion, time limits, duration at w = 0, and the effect of w."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.mobile.planners.drive_lattice import DriveLattice

Array = np.ndarray

TITLE = "Robots that drive: bundled tasks, first motions, durations and what w changes"
QUESTION = "How fast are motions of mobile robots planned, how long are they, and how much does w reduce impact?"
HEADLINE = "predicted impact"
DEPENDS_ON = (*suite.PLANNING, "src/graceful_plan/mobile")
LIMITS = (0.5, 1.0, 2.0, 5.0)
"""Time limits to keep [s]."""
LONG = 5.0
"""Time limit of the calls whose motions are compared [s]."""
SEEDS, LONG_SEEDS = 1, 3
CORRIDORS, LONG_CORRIDORS = 8, 10
_DRAWN = 2016
"""Seed of the corridors."""
MEASURED = f"""\
Every task of the mobile scenes ({", ".join(gp.mobile_scenes())}), with its carried object and pedestrians. Scenes are
compiled and warm; one call at a time. "First" is `plan(stop="first")` at the default weight. "Bound" is a lower bound
of the duration: the straight line between both ends at top speed, with accelerations and the turn between the headings;
walls and pedestrians make motions longer. Impact is that of the default model; "others" leaves out the loss of the
carried object. Motions at w = 0 and at the default weight come from calls of {LONG:g} s.

Corridors: the hallway without its furniture and pedestrian, in which the Fetch carries the bottle past the person. The
place of the person and both ends are drawn at random. "Arm fixed" is `DriveLattice(moves_arm=False)`, which keeps the
arm's posture. The quicker of two motions is slowed down evenly to the duration of the other. `--tasks "corridor*"` runs
these alone.
"""


@dataclass(frozen=True, kw_only=True)
class Task:
    """Result for one task; medians over seeds."""

    name: str
    first: float
    """Time to the first verified motion [s]."""
    late: tuple[float, ...]
    """Overrun of each call of each limit [s]."""
    unsolved: int
    bound: float
    """Lower bound of the duration [s]."""
    duration: tuple[float, float]
    """At w = 0, and at the default weight [s]."""
    impact: tuple[float, float]
    others: tuple[float, float]
    worse: float
    """Relative excess of J of the default motion over J of the motion for w = 0."""


@dataclass(frozen=True, kw_only=True)
class Corridor:
    """Result for one corridor; the first figure is that of the whole body, the second with the arm fixed."""

    name: str
    duration: tuple[float, float]
    """As planned [s]."""
    impact: tuple[float, float]
    """At equal duration."""
    others: tuple[float, float]
    """The same without the loss of the carried object."""


def run(options: suite.Options) -> str:
    """Measure all tasks, and corridors."""
    names = [f"{scene}/{task}" for scene in gp.mobile_scenes() for task in gp.load_scene(scene).tasks]
    names = list(suite.chosen(names[:2] if options.quick else names, options.tasks))
    found = [_examined(name, options) for name in names]
    drawn = [f"corridor {k}" for k in range(options.pick(CORRIDORS, quick=1, long=LONG_CORRIDORS))]
    passed = [_passed(name, options) for name in suite.chosen(drawn, options.tasks)]
    parts = [MEASURED, report.targets([*_targets(found), *_corridor_targets(passed)])]
    parts += [report.table(HEADER, [_row(one) for one in found])] if found else []
    parts += [report.table(CORRIDOR_HEADER, [_corridor_row(one) for one in passed])] if passed else []
    return "\n".join(parts)


HEADER = ("task", "first [ms]", "bound [s]", "w = 0 [s]", "default [s]", "impact, w = 0", "default", "x less",
          "others, x less")  # fmt: skip


CORRIDOR_HEADER = ("corridor", "duration [s], whole body", "arm fixed", "impact at equal duration, whole body",
                   "arm fixed", "x less", "others, whole body", "arm fixed", "x less")  # fmt: skip


def _passed(name: str, options: suite.Options) -> Corridor:
    """Plan past the person in a random corridor with the whole body, and with the arm fixed."""
    rng = np.random.default_rng([_DRAWN, int(name.split()[1])])
    task = gp.load_scene("hallway").tasks["carry_bottle"]
    x, y = rng.uniform(3.5, 6.5), rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 0.8)
    scene = task.scene.without_moving().edit(
        remove=("plant", "console", "vase", "sideboard", "cup", "pan"),
        move={"person": [x, y, 0.0], "person_head": [x, y, 1.63]},
    )
    start, goal = task.start.copy(), task.goal[0].copy()
    start[1], goal[1] = rng.uniform(-0.2, 0.2, 2)
    seconds = options.seconds or options.pick(LONG, quick=1.0)
    motions = []
    for moves_arm in (True, False):
        result = gp.plan(start, goal, scene, planner=DriveLattice(moves_arm=moves_arm), time_limit=seconds)
        motions.append(result.unwrap())
    longest = max(motion.duration for motion in motions)
    costs = [gp.evaluate(_slowed(motion, longest / motion.duration), scene) for motion in motions]
    return Corridor(
        name=name,
        duration=_pair([motion.duration for motion in motions]),
        impact=_pair([cost.impact for cost in costs]),
        others=_pair([_of_others(cost, scene) for cost in costs]),
    )


def _pair(values: list[float]) -> tuple[float, float]:
    whole, fixed = values
    return whole, fixed


def _slowed(motion: gp.Trajectory, factor: float) -> gp.Trajectory:
    """Return a motion whose time is stretched evenly."""
    return gp.Trajectory(factor * motion.t, motion.q, motion.qd / factor, motion.qdd / factor**2, motion.joints)


def _corridor_row(one: Corridor) -> list[str]:
    figures = (*one.duration, *one.impact, _less(one.impact), *one.others, _less(one.others))
    return [one.name, *(f"{figure:.2f}" for figure in figures)]


def _less(impact: tuple[float, float]) -> float:
    whole, fixed = impact
    return fixed / max(whole, 1e-9)


def _corridor_targets(passed: list[Corridor]) -> Iterator[report.Target]:
    if passed:
        less, whole = (float(np.median([_less(of) for of in pairs])) for pairs in (
            [one.others for one in passed], [one.impact for one in passed],
        ))  # fmt: skip
        yield report.Target(
            what="predicted impact past a standing person, without the loss of the carried object, arm fixed over "
            "whole body at equal duration, median",
            wanted="2 x less", measured=f"{less:.2f} x less ({whole:.2f} with that loss)", met=less >= 2.0,
        )  # fmt: skip


def _examined(name: str, options: suite.Options) -> Task:
    scene_name, task_name = name.split("/")
    task = gp.load_scene(scene_name).tasks[task_name]
    scene, seeds = task.scene, range(options.pick(SEEDS, quick=1, long=LONG_SEEDS))
    gp.plan(task.start, task.goal, scene, stop="first", time_limit=30.0)
    first, late, unsolved = [], [], 0
    known: dict[tuple[float, int], gp.PlanResult] = {}
    for seed in seeds:
        began = time.perf_counter()
        result = gp.plan(task.start, task.goal, scene, stop="first", time_limit=10.0, seed=seed)
        first.append(time.perf_counter() - began)
        unsolved += result.trajectory is None
        for limit in options.pick(LIMITS, quick=LIMITS[:1]):
            began = time.perf_counter()
            result = gp.plan(task.start, task.goal, scene, time_limit=limit, seed=seed)
            late.append(time.perf_counter() - began - limit)
            unsolved += result.trajectory is None
            known[limit, seed] = result
    seconds = options.seconds or options.pick(LONG, quick=1.0)
    plain = [_planned(task, 0.0, seed, seconds) for seed in seeds]
    ours = [known.get((seconds, seed)) or _planned(task, None, seed, seconds) for seed in seeds]
    motions = {w: [result.unwrap() for result in results] for w, results in ((0.0, plain), (None, ours))}
    objective = gp.Objective()
    costs = {w: [gp.evaluate(one, scene, objective) for one in of] for w, of in motions.items()}
    total = _medians({w: [cost.total for cost in of] for w, of in costs.items()})
    return Task(
        name=name,
        first=float(np.median(first)),
        late=tuple(late),
        unsolved=unsolved,
        bound=_bound(motions[0.0][0], scene),
        duration=_medians({w: [one.duration for one in of] for w, of in motions.items()}),
        impact=_medians({w: [cost.impact for cost in of] for w, of in costs.items()}),
        others=_medians({w: [_of_others(cost, scene) for cost in of] for w, of in costs.items()}),
        worse=total[1] / total[0] - 1.0,
    )


def _planned(task: gp.Task, w: float | None, seed: int, seconds: float) -> gp.PlanResult:
    return gp.plan(task.start, task.goal, task.scene, w=w, time_limit=seconds, seed=seed)


def _medians(of: dict[float | None, list[float]]) -> tuple[float, float]:
    return float(np.median(of[0.0])), float(np.median(of[None]))


def _of_others(cost: gp.CostBreakdown, scene: gp.Scene) -> float:
    own = scene.carried.body if scene.carried is not None else None
    return sum(value for name, value in cost.impact_by_entity.items() if name != own)


def _bound(motion: gp.Trajectory, scene: gp.Scene) -> float:
    """Return a lower bound of the duration of motions between the same ends [s]."""
    base = scene.base
    assert base is not None
    (x0, y0, yaw0), (x1, y1, yaw1) = motion.q[0, :3], motion.q[-1, :3]
    length = float(np.hypot(x1 - x0, y1 - y0))
    reach = base.v_max**2 / base.a_max
    drives = length / base.v_max + base.v_max / base.a_max if length > reach else 2.0 * np.sqrt(length / base.a_max)
    turn = abs(float(np.remainder(yaw1 - yaw0 + np.pi, 2.0 * np.pi) - np.pi))
    arm = np.abs(motion.q[-1, 3:] - motion.q[0, 3:]) / scene.limits.velocity[3:]
    return max(drives, turn / base.omega_max, float(arm.max(initial=0.0)))


def _row(one: Task) -> list[str]:
    ratios = [of[0] / max(of[1], 1e-9) for of in (one.impact, one.others)]
    return [
        one.name,
        f"{1e3 * one.first:.0f}",
        f"{one.bound:.1f}",
        f"{one.duration[0]:.1f}",
        f"{one.duration[1]:.1f}",
        f"{one.impact[0]:.2f}",
        f"{one.impact[1]:.2f}",
        f"{ratios[0]:.2f}",
        f"{ratios[1]:.2f}",
    ]


def _targets(found: list[Task]) -> Iterator[report.Target]:
    if not found:
        return
    first = np.array([one.first for one in found])
    median, most = float(np.median(first)), float(np.quantile(first, 0.95))
    yield report.Target(
        what="first verified motion at the default weight, median and 95 % of tasks",
        wanted="<= 0.5 s, <= 1 s",
        measured=f"{median:.2f} s, {most:.2f} s",
        met=median <= 0.5 and most <= 1.0,
    )
    late = float(np.quantile(np.concatenate([one.late for one in found]), 0.99))
    yield report.Target(
        what="calls that end after their limit, 99 %", wanted="<= 50 ms", measured=f"{1e3 * late:.0f} ms",
        met=late <= 0.05,
    )  # fmt: skip
    yield report.none_of("calls without a motion", sum(one.unsolved for one in found), "none")
    longer = np.array([one.duration[0] / one.bound - 1.0 for one in found])
    yield report.Target(
        what="duration at w = 0 above the lower bound, median", wanted="<= 20 %",
        measured=f"{100 * np.median(longer):.0f} %, at most {100 * longer.max():.0f} %",
        met=bool(np.median(longer) <= 0.2),
    )  # fmt: skip
    less = np.median([one.impact[0] / max(one.impact[1], 1e-9) for one in found])
    slower = np.median([one.duration[1] / one.duration[0] for one in found])
    yield report.Target(
        what="predicted impact at the default weight against w = 0, median", wanted="2 x less, <= 15 % longer",
        measured=f"{less:.2f} x less, {100 * (slower - 1.0):+.0f} %", met=bool(less >= 2.0 and slower <= 1.15),
    )  # fmt: skip
    yield report.none_of(
        "tasks whose J is above that of the motion for w = 0", sum(one.worse > 1e-9 for one in found), "none"
    )

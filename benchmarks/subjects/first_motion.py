"""Time to a verified first motion, time to import and to change a scene, and overruns of time limits."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import import_times, mesh_arm, report, suite
from benchmarks.motion_problems import KINDS, make
from graceful_plan.compare.problems.problem_files import ProblemFile
from graceful_plan.core import covers
from graceful_plan.core.compile import compile_scene
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.scene.edit import StaticBody

Array = np.ndarray

TITLE = "First motion: plan(w=0) from the call to a verified motion, changes of a scene, limits of time"
QUESTION = "How long do import, the first verified motion and a change of the scene take, and are time limits kept?"
HEADLINE = "plan(w=0) to a verified first motion, CPU, median"
DEPENDS_ON = (
    *suite.PLANNING,
    "src/graceful_plan/__init__.py",
    "src/graceful_plan/tools/cli.py",
    "benchmarks/import_times.py",
    "benchmarks/mesh_arm.py",
    "benchmarks/motion_problems.py",
)
SEED = 7
LIMITS = (0.02, 0.05, 0.3, 1.0)
"""Time limits to keep [s]."""
CALLS, LONG_CALLS = 400, 1000
"""Calls per time limit without `--calls`; a quarter of them at 0.3 s, a tenth at 1 s."""
MEASURED = """\
One process with compiled scenes, unless a row says otherwise. "Call" is `plan(w=0)` on generated problems of the
MotionBenchMaker kinds; a callback ends the search at the first path. A call checks both ends by exact geometry,
searches, times the motion and verifies it. "Search" is RRT-Connect alone to its first path, on the same problem with
the same margin. "Verified" is the verification of the motion as the call does it, and with exact geometry everywhere.
CPU times are those of the process. "Mesh" is an arm whose links have two hulls each (`benchmarks/mesh_arm.py`),
compared with the same arm of capsules. Overruns are wall-clock times of calls with only a time limit; a call that ends
early has a negative overrun. "Moving entity" are table tasks with a pedestrian passing by.
"""


@dataclass(frozen=True, kw_only=True)
class CallFigures:
    """Times of one problem [s], and the samples of its verification."""

    group: str
    status: str
    cpu: float
    wall: float
    search: float
    verify: float
    exact: float
    samples: int
    looked_at: int
    """Samples that a lower bound of the clearance did not settle."""


def run(options: suite.Options) -> str:
    """Measure calls, changes, overruns and new processes."""
    made = suite.spread(_make, [(kind, options.pick(10, quick=1)) for kind in KINDS], options.processes, "problems")
    problems = [problem for group in made for problem in group]
    repeats = options.pick(5, quick=2)
    calls = [_call(problem, repeats) for problem in problems]
    among = _among_entities(repeats)
    changes = _changes(problems[0].scene, options.pick(15, quick=3))
    fresh = list(import_times.targets(options))
    overruns = list(_overruns(problems, options.calls, options.pick(CALLS, quick=24, long=LONG_CALLS)))
    return "\n".join(
        [
            MEASURED,
            report.targets([*_targets(calls), among, *_change_targets(changes), *_overrun_targets(overruns), *fresh]),
            _call_table(calls),
            report.table(("scene, ms", *changes["own Panda"]), [
                (name, *(f"{1e3 * seconds:.2f}" for seconds in row.values())) for name, row in changes.items()
            ]),
            report.table(
                ("calls", "limit [ms]", "n", "median over [ms]", "99 %", "most", "solved", "timeout", "other"),
                [one.row() for one in overruns],
            ),
            import_times.MEASURED,
        ]
    )  # fmt: skip


def _make(job: tuple[str, int]) -> list[ProblemFile]:
    found = make(*job, SEED)
    return [ProblemFile(**{name: getattr(one, name) for name in one.__dataclass_fields__}) for one in found]


# --- calls ------------------------------------------------------------------------------------------------------------


def _call(problem: ProblemFile, repeats: int) -> CallFigures:
    def call(seed: int) -> gp.PlanResult:
        return gp.plan(problem.start, problem.goal, problem.scene, w=0.0, seed=seed, time_limit=5.0, callback=_stop)

    call(0)
    cpu, wall = [], []
    for seed in range(repeats):
        at, began = time.process_time(), time.perf_counter()
        result = call(seed)
        cpu.append(time.process_time() - at)
        wall.append(time.perf_counter() - began)
    result = call(0)
    verify = exact = np.nan
    samples = proved = 0
    if result.status is gp.PlanStatus.SOLVED:
        trajectory, scene = result.unwrap(), problem.scene
        clearance = compile_scene(scene).kernels.clearance
        verify = _median(lambda: gp.verify(trajectory, scene, clearance=clearance), repeats)
        exact = _median(lambda: gp.verify(trajectory, scene), repeats)
        words = result.verdict.checks["collision"].detail.split()
        samples, proved = int(words[0]), int(words[2]) if "proved" in words else 0
    return CallFigures(
        group=problem.group,
        status=result.status.name,
        cpu=float(np.median(cpu)),
        wall=float(np.median(wall)),
        search=float(np.median([_search(problem, seed) for seed in range(repeats)])),
        verify=verify,
        exact=exact,
        samples=samples,
        looked_at=samples - proved,
    )


def _among_entities(repeats: int) -> report.Target:
    """Measure the processor time of first verified motions on table tasks at the default weight."""
    seconds = []
    for task in (suite.task(name) for name in suite.task_names() if suite.is_tabletop(name)):
        spent = []
        for seed in range(1 + repeats):
            began = time.process_time()
            gp.plan(task.start, task.goal, task.scene, seed=seed, time_limit=5.0, callback=_stop).unwrap()
            spent.append(time.process_time() - began)
        seconds.append(np.median(spent[1:]))
    return _at_most("the same on table tasks, w = 0.3, CPU, median", 1e3 * float(np.median(seconds)), 15.0, "ms")


def _stop(_: object) -> bool:
    return True


def _search(problem: ProblemFile, seed: int) -> float:
    goals = np.atleast_2d(np.asarray(problem.goal))
    asked = SceneProblem(
        kernels=compile_scene(problem.scene).kernels, start=np.asarray(problem.start), goals=goals, margin=0.0015
    )
    objective = gp.Objective(w=0.0).bind(problem.scene)
    planner, rng = gp.RRTConnect(shortcut=None), np.random.default_rng(seed)
    began = time.process_time()
    next(iter(planner.solve(asked, objective, Budget(5.0), rng)), None)
    return time.process_time() - began


def _median(do: Callable[[], object], repeats: int) -> float:
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        do()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def _call_table(calls: list[CallFigures]) -> str:
    groups = [*dict.fromkeys(call.group for call in calls), "all"]
    rows = []
    for group in groups:
        mine = [call for call in calls if group in (call.group, "all")]
        middle = {name: float(np.nanmedian([getattr(c, name) for c in mine])) for name in _TIMES}
        rows.append(
            (
                group,
                f"{sum(call.status == 'SOLVED' for call in mine)}/{len(mine)}",
                *(f"{1e3 * middle[name]:.2f}" for name in _TIMES),
                f"{middle['cpu'] / middle['search']:.1f}",
                f"{middle['exact'] / middle['verify']:.1f}",
                f"{np.median([call.samples for call in mine]):.0f}",
                f"{sum(c.looked_at for c in mine) / max(1, sum(c.samples for c in mine)):.1%}",
            )
        )
    names = ("call, CPU", "call", "search, CPU", "verified", "exactly everywhere")
    ratios = ("call / search", "exactly / verified", "samples", "of them not proved")
    return report.table(("problems, ms", "solved", *names, *ratios), rows)


_TIMES = ("cpu", "wall", "search", "verify", "exact")


def _targets(calls: list[CallFigures]) -> Iterator[report.Target]:
    solved = sum(call.status == "SOLVED" for call in calls)
    share = f"{report.percent(solved / len(calls))} ({solved} of {len(calls)})"
    yield report.Target(what="calls that are SOLVED", wanted="100 %", measured=share, met=solved == len(calls))
    cpu = 1e3 * np.array([call.cpu for call in calls])
    for what, value, most in (("median", np.median(cpu), 5.0), ("95 %", np.percentile(cpu, 95), 12.0)):
        yield _at_most(f"plan(w=0) to a verified first motion, CPU, {what}", float(value), most, "ms")
    ratio = float(np.median([call.cpu for call in calls]) / np.median([call.search for call in calls]))
    yield _at_most("whole call divided by its search, CPU", ratio, 10.0, "")


# --- changes of a scene -----------------------------------------------------------------------------------------------


def _changes(panda: gp.Scene, repeats: int) -> dict[str, dict[str, float]]:
    """Return times by scene and kind of change [s]."""
    ends = {
        "own Panda": (panda, mesh_free(panda)),
        "mesh": (mesh_arm.mesh_arm(), (mesh_arm.START, mesh_arm.GOAL)),
        "its twin of capsules": (mesh_arm.mesh_arm(capsules=True), (mesh_arm.START, mesh_arm.GOAL)),
    }
    return {name: _changed(scene, *both, repeats) for name, (scene, both) in ends.items()}


def mesh_free(panda: gp.Scene) -> tuple[Array, Array]:
    """Return two free configurations of the Panda, close to each other."""
    q = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
    around = q + np.random.default_rng(0).uniform(-0.4, 0.4, (200, 7))
    free = around[compile_scene(panda).kernels.free(around, 0.01)]
    return free[0], free[1]


def _changed(scene: gp.Scene, start: object, goal: object, repeats: int) -> dict[str, float]:
    found: dict[str, float] = {}
    spare = StaticBody(name="spare", kind="box", size=[0.03] * 3, pose=[0.0, 2.0, 1.0])
    with tempfile.TemporaryDirectory() as folder:
        before = os.environ.get("XDG_CACHE_HOME")
        os.environ["XDG_CACHE_HOME"] = folder
        try:
            for name in ("first plan", "from the folder"):
                covers.forget()
                anew = scene.edit(add=[spare])
                found[name] = _median(lambda anew=anew: _plan(anew, start, goal), 1)
        finally:
            os.environ.pop("XDG_CACHE_HOME") if before is None else os.environ.update(XDG_CACHE_HOME=before)
    scene = scene.edit(add=[spare])
    found["same scene"] = _median(lambda: _plan(scene, start, goal), repeats)
    places = iter(np.linspace(2.0, 3.0, 1 + 2 * repeats))
    found["compile after a move"] = _median(
        lambda: compile_scene(scene.edit(move={"spare": [0.0, next(places), 1.0]})), repeats
    )
    found["move and plan"] = _median(
        lambda: _plan(scene.edit(move={"spare": [0.0, next(places), 1.0]}), start, goal), repeats
    )
    rng = np.random.default_rng(0)
    places200 = rng.uniform(-1.0, 1.0, (200, 3)) + [0.0, 0.0, 2.5]
    many = [StaticBody(name=f"s{k}", kind="box", size=[0.02] * 3, pose=p) for k, p in enumerate(places200)]
    found["add 200"] = _median(lambda: scene.edit(add=many), max(1, repeats // 3))
    found["add 200 and compile"] = _median(lambda: compile_scene(scene.edit(add=many)), max(1, repeats // 3))
    lower, upper = scene.limits.position.T
    q = rng.uniform(lower, upper, (4000, len(scene.joints)))
    kernels = compile_scene(scene).kernels
    found["clearance of 1000"] = _median(lambda: kernels.clearance(q), repeats) / 4.0
    found["free of 1000"] = _median(lambda: kernels.free(q), repeats) / 4.0
    return found


def _plan(scene: gp.Scene, start: object, goal: object) -> gp.PlanResult:
    result = gp.plan(np.asarray(start), np.asarray(goal), scene, w=0.0, time_limit=30.0, callback=_stop)
    result.unwrap()
    return result


def _change_targets(changes: dict[str, dict[str, float]]) -> Iterator[report.Target]:
    mesh, panda, twin = changes["mesh"], changes["own Panda"], changes["its twin of capsules"]
    yield _at_most("mesh arm, first plan of a process", 1e3 * mesh["first plan"], 1500.0, "ms")
    yield _at_most("mesh arm, the same with covers from the folder", 1e3 * mesh["from the folder"], 300.0, "ms")
    yield _at_most("one obstacle moved and planned again", 1e3 * panda["move and plan"], 8.0, "ms")
    yield _at_most("200 obstacles added and compiled", 1e3 * panda["add 200 and compile"], 40.0, "ms")
    ratio = mesh["clearance of 1000"] / twin["clearance of 1000"]
    yield _at_most("clearance of the mesh arm divided by that of capsules", ratio, 3.0, "")


# --- time limits ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Overruns:
    """Overruns of calls of one kind with one time limit."""

    name: str
    limit: float
    over: Array
    statuses: list[str]

    def row(self) -> tuple[str, ...]:
        """Return the row of a table."""
        median, most = np.median(self.over), self.over.max()
        solved, timeout = self.statuses.count("SOLVED"), self.statuses.count("TIMEOUT")
        overruns = [f"{1e3 * x:.1f}" for x in (median, np.percentile(self.over, 99), most)]
        other = len(self.statuses) - solved - timeout
        return (
            self.name,
            f"{1e3 * self.limit:g}",
            str(len(self.over)),
            *overruns,
            str(solved),
            str(timeout),
            str(other),
        )


def _overruns(problems: list[ProblemFile], calls: int | None, most: int = CALLS) -> Iterator[Overruns]:
    tasks = [suite.task(name) for name in suite.task_names() if suite.is_tabletop(name)]
    walked_by = {one.scene: one.scene.with_moving(_walker()) for one in tasks}
    away = gp.PoseGoal.at([3.0, 0.0, 0.5])

    def files(k: int, limit: float) -> gp.PlanResult:
        one = problems[k % len(problems)]
        return gp.plan(one.start, one.goal, one.scene, w=0.0, time_limit=limit, seed=k)

    def household(k: int, limit: float) -> gp.PlanResult:
        one = tasks[k % len(tasks)]
        return gp.plan(one.start, one.goal, one.scene, time_limit=limit, seed=k)

    def unreachable(k: int, limit: float) -> gp.PlanResult:
        one = problems[k % len(problems)]
        return gp.plan(one.start, away, one.scene, w=0.0, time_limit=limit, seed=k)

    def walked(k: int, limit: float) -> gp.PlanResult:
        one = tasks[k % len(tasks)]
        return gp.plan(one.start, one.goal, walked_by[one.scene], time_limit=limit, seed=k)

    kinds = {
        "files, w = 0": files,
        "table tasks": household,
        "unreachable pose": unreachable,
        "moving entity": walked,
    }
    for name, call in kinds.items():
        for k in range(min(most, 25)):
            call(k, LIMITS[0])  # compiles the scene, which does not count
        for limit in LIMITS:
            over, statuses = [], []
            share = 1.0 if limit < 0.1 else 0.25 if limit < 1.0 else 0.1
            count = round(share * most) if calls is None else calls
            for k in range(max(3, count // len(kinds))):
                began = time.perf_counter()
                result = call(k, limit)
                over.append(time.perf_counter() - began - limit)
                statuses.append(result.status.name)
            yield Overruns(name=name, limit=limit, over=np.array(over), statuses=statuses)


def _walker() -> gp.MovingEntity:
    """Return a pedestrian who passes the table."""
    position = [[-0.5, -2.0, 0.85], [-0.5, 2.2, 0.85]]
    return gp.MovingEntity("person", "adult", size=[0.2, 0.85], t=[0.0, 3.0], position=position, spread=0.03)


def _overrun_targets(overruns: list[Overruns]) -> Iterator[report.Target]:
    for limit in LIMITS:
        over = 1e3 * np.concatenate([one.over for one in overruns if one.limit == limit])
        yield _at_most(f"overrun of {1e3 * limit:g} ms, 99 %", float(np.percentile(over, 99)), 10.0, "ms")
        yield _at_most(f"overrun of {1e3 * limit:g} ms, most", float(over.max()), 50.0, "ms")


def _at_most(what: str, value: float, most: float, unit: str) -> report.Target:
    words = f" {unit}" if unit else ""
    return report.Target(what=what, wanted=f"<= {most:g}{words}", measured=f"{value:.2f}{words}", met=value <= most)

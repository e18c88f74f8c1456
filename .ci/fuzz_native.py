"""Call the native core with broken arguments; it must refuse them with an error or return in a short time.

python .ci/fuzz_native.py [--calls N] [--seed S] [--isa NAME ...]

Records the calls of the core while the library plans, then repeats each with one or two broken arguments. If a
constructor accepts them, the methods of the object are called as well. A crash ends the process; run this with
sanitizers (see .ci/run) to detect out-of-bounds reads.
"""

from __future__ import annotations

import argparse
import faulthandler
import math
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.core.kernels import instruction_sets
from graceful_plan.judge import _pendulum
from graceful_plan.mobile.floor.lattice import LatticeSettings, StateLattice
from graceful_plan.mobile.floor.reeds_shepp import Steering
from graceful_plan.mobile.floor.timed_paths import HEADINGS, LEAVES, STANDS, DynamicObstacles, TimedLattice
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.timing.retiming import slowdown
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.topp import travelled

MODULES = (_native, _pendulum)
REFUSALS = (ValueError, TypeError, RuntimeError, MemoryError, OverflowError, IndexError)
SLOW = 10.0
"""Time after which a call counts as hanging [s]."""
MAY_BE_INFINITE = {
    ("ball_cover", "depth"),
    ("Core", "room"),
    ("PoseCost", "distance"),
    ("PoseCost", "angle"),
    ("Steering", "yaw_length"),
    ("StateLattice", "distance"),
    ("StateLattice.search", "time_limit"),
    ("FloorGrid.path", "time_limit"),
    ("GraphSearch.cheapest", "cost"),
    ("GraphSearch.front", "cost"),
    ("GraphSearch.front", "seconds"),
    ("Connect.run", "seconds"),
    ("Drive.run", "seconds"),
    ("Anytime.run", "seconds"),
    ("MotionDescent.run", "seconds"),
    ("fastest", "limit"),
    ("fastest", "velocity"),
    ("travelled", "velocity"),
    ("excess", "velocity"),
}
"""Arguments that may be infinite; none may be NaN."""


@dataclass
class Call:
    """A recorded call of a class, a bound method or a function."""

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Any]


def recorder(name: str, behind: Any, calls: list[Call], isa: str) -> Any:
    """Wrap a native class or function so that its calls are recorded."""
    parameters = parameters_of(behind)

    def named(args: tuple[Any, ...], kwargs: dict[str, Any]) -> dict[str, Any]:
        arguments = dict(zip(parameters, args, strict=False)) | kwargs
        return arguments | {"isa": isa} if name == "Core" else arguments

    def function(*args: Any, **kwargs: Any) -> Any:
        arguments = named(args, kwargs)
        calls.append(Call(name, behind, arguments))
        return behind(**arguments)

    def initialise(self: Any, *args: Any, **kwargs: Any) -> None:
        arguments = named(args, kwargs)
        behind.__init__(self, **arguments)
        WIDTHS[id(self)] = width(self, arguments)
        KEPT.append(self)
        calls.append(Call(name, behind, arguments))
        calls.extend(methods_of(name, self, arguments))

    return type(name, (behind,), {"__init__": initialise}) if isinstance(behind, type) else function


def parameters_of(behind: Any) -> list[str]:
    """Return the parameter names of a native function, without self."""
    target = behind.__init__ if isinstance(behind, type) else behind
    signature = target.__nb_signature__[0][0]
    inside = signature[signature.index("(") + 1 : signature.rindex(") ->")]
    names, depth, word = [], 0, ""
    for sign in inside + ",":
        depth += (sign in "[(") - (sign in "])")
        if sign == "," and depth == 0:
            names.append(word.split(":")[0].split("=")[0].strip())
            word = ""
        else:
            word += sign
    return [name for name in names if name not in ("self", "*", "/", "")]


def methods_of(name: str, made: Any, arguments: dict[str, Any]) -> Iterator[Call]:
    """Yield calls of all methods of an object, with suitable arguments."""
    for method in dir(type(made)):
        if method.startswith("_") or isinstance(getattr(type(made), method), property):
            continue
        bound = getattr(made, method)
        given = {p: fitting(p, f"{name}.{method}", made, arguments) for p in parameters_of(bound)}
        yield Call(f"{name}.{method}", bound, {p: v for p, v in given.items() if v is not None})


def fitting(parameter: str, method: str, made: Any, arguments: dict[str, Any]) -> Any:
    """Return an argument of a method by name; None to omit it."""
    nq = width(made, arguments)
    rng = np.random.default_rng(len(method))
    goals, controls = arguments.get("goals"), arguments.get("controls", 8)
    weights = {
        "DropModel": (4 * arguments.get("n_entity", 0) + 1,),
        "BodyModel": (arguments.get("n_row", 1), arguments.get("n_entity", 0)),
    }
    shapes: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(("q", "qd", "q0", "q1"), (9, nq)),
        "t": (9,),
        "severity": weights.get(method.split(".")[0], (1,)),
        "weight": ((2 * nq + 2) * arguments.get("n_row", 1),),
        "controls": (int(controls) - 2, nq) if isinstance(controls, int) else (8, nq),
        "x": (70,),
    }
    if parameter in shapes:
        return 0.3 * rng.random(shapes[parameter])
    around = DYNAMIC_WINDOW if method == "DynamicWindow.choose" else CELLS if method.startswith("FloorGrid") else {}
    if parameter in around:
        return around[parameter]
    if parameter in ("start", "goal") and method.startswith(("StateLattice", "Steering")):
        return np.array([1.0, 1.0, 0.0]) if method.startswith("State") else rng.random((4, 3))
    if parameter == "path" and goals is not None:
        return np.stack([np.ravel(arguments["start"]), np.asarray(goals)[0]])
    plain: dict[str, Any] = {
        "lower": np.full(nq, -3.0),
        "upper": np.full(nq, 3.0),
        "step": 0.05,
        "margin": 0.0,
        "clearance": 0.01,
        "iterations": 40,
        "steps": 4,
        "seconds": 0.2,
        "weight": 2.0,
        "w": 0.0,
        "inflations": [2.0],
        "shots": 1,
        "max_expansions": 2000,
        "time_limit": 0.2,
        "epsilon": 0.1,
        "pieces": rng.random((4, 5, 3)),
        "s": rng.random((4, 6)),
        "goals": np.array([0], dtype=np.int32),
        "rough": True,
        "wanted": 0.2,
    }
    if method.startswith("GraphSearch"):
        edges = len(arguments["tail"])
        plain |= {"start": 0, "cost": rng.random(edges if method.endswith("cheapest") else (edges, 2))}
    if method.startswith("DropModel.add"):
        return None
    return plain.get(parameter)


def width(made: Any, arguments: dict[str, Any]) -> int:
    """Return the number of joints of an object."""
    known = arguments.get("n_joint") or WIDTHS.get(id(made)) or WIDTHS.get(id(arguments.get("core")))
    if isinstance(known, int) and 0 < known < 1000:
        return known
    for name in ("speed", "lower", "start", "velocity", "centre"):
        if isinstance(arguments.get(name), np.ndarray):
            return int(arguments[name].size)
    return next((WIDTHS[id(x)] for x in arguments.values() if id(x) in WIDTHS), 1)


WIDTHS: dict[int, int] = {}
"""Number of joints of each object, by id; `KEPT` keeps the objects alive."""
KEPT: list[Any] = []
ABSTRACT = ("Space", "Impact", "Measure", "TimedCurve", "MovingSource")


def record(isa: str) -> list[Call]:
    """Plan in many situations and record the calls of the core."""
    calls: list[Call] = []
    behind = list(offered())
    for module, name, thing in behind:
        if not isinstance(thing, type) or ("__init__" in vars(thing) and name not in ABSTRACT):
            setattr(module, name, recorder(name, thing, calls, isa))
    try:
        situations()
    finally:
        for module, name, thing in behind:
            setattr(module, name, thing)
    return calls


def offered() -> Iterator[tuple[ModuleType, str, Any]]:
    """Yield the exports of the native modules: module, name and object."""
    for module in MODULES:
        yield from ((module, name, thing) for name, thing in vars(module).items() if not name.startswith("_"))


def exported() -> Iterator[str]:
    """Yield the names of all exports, in the form of call names."""
    for _, name, thing in offered():
        if name in (*ABSTRACT, "lever", "instruction_sets", "capacity"):
            continue
        if not isinstance(thing, type):
            yield from [name] if parameters_of(thing) else []
            continue
        yield name
        for member, value in vars(thing).items():
            if not member.startswith("_") and not isinstance(value, property):
                yield f"{name}.{member}"


DYNAMIC_WINDOW = {
    "state": np.array([-2.0, 0.0, 0.1, 0.5, 0.2]),
    "path": np.array([[-2.0, 0.0], [2.0, 0.0], [3.0, 1.0]]),
    "entity": np.array([0, 1], dtype=np.int32),
    "shape": np.array([[1.0, 0.3, 1.0, 0.0, 0.2, 0.1, 0.0], [2.0, -0.4, 1.0, 0.0, 0.0, 0.0, 0.3]]),
    "velocity": np.array([[0.0, 0.0], [0.3, -0.2]]),
    "severity": np.array([2.0, 5.0]),
}
CELLS = {
    "column": 1,
    "row": 2,
    "start": np.array([1, 1], dtype=np.int32),
    "goal": np.array([30, 20], dtype=np.int32),
    "method": "a_star",
    "time_limit": 0.2,
}
"""Arguments of methods of floor grids, by name."""


def situations() -> None:
    """Plan with every model, planner and kind of bound that has a native kernel."""
    # Directly, because covers of meshes may be cached on disk.
    points = np.random.default_rng(0).random((9, 3))
    _native.heights(points=points, planes=np.array([[0.0, 0.0, 1.0, -0.5], [1.0, 0.0, 0.0, -1.0]]))
    order = np.arange(9, dtype=np.int32)
    _native.ball_cover(points=points, reach=np.full(9, 0.1), depth=np.zeros(9), order=order, first=9, candidates=4)
    for name, faults in (("dining_table", "drop_only"), ("tabletop", "service_robot")):
        task = next(iter(gp.load_scene(name).tasks.values()))
        impact = gp.ImpactCost(gp.FailureMixture(faults=faults))
        given = {"objective": gp.Objective(impact=impact), "iterations": 40}
        for planner in ("anytime", "rrt_connect", "prm"):  # the descents of one are those of all
            gp.plan(task.start, task.goal, task.scene, planner=planner, refine=planner == "anytime", **given)
    task = next(iter(gp.load_scene("tabletop").tasks.values()))
    blocks = (
        gp.ClearanceCost(distance=0.1),
        gp.costs.JointCost(),
        gp.costs.EnergyCost(),
        gp.costs.ManipulabilityCost(),
        gp.costs.PoseCost(gp.PoseGoal.from_tool(task.start, task.scene)),
    )
    for block in blocks:
        gp.plan(task.start, task.goal, task.scene, objective=gp.Objective(impact=0.5 * block), iterations=20)
    gp.plan(task.start, task.goal, task.scene, objective=gp.Objective(impact=Low()), iterations=20)
    gp.plan(task.start, task.goal, task.scene, constraints=[gp.ToolSpeed(0.5)], iterations=20)
    person = gp.MovingEntity(
        "ann", "adult", size=[0.2, 0.8], t=[0.0, 4.0], position=[[1.0, -1.0, 0.8], [1.0, 1.0, 0.8]]
    )
    fear = gp.ImpactCost(gp.FailureMixture(faults="service_robot"), components=("body", "carried"))
    among = gp.Objective(impact=fear)
    gp.plan(task.start, task.goal, task.scene.with_moving(person), objective=among, iterations=20, stop="first")
    plan_outside_of_scenes(task)
    time_outside_of_plans(task)
    ends = np.array([0, 1, 2], dtype=np.int32), np.array([1, 2, 3], dtype=np.int32)
    _native.GraphSearch(4, *ends).cheapest(np.ones(3), 0, ends[1])
    drive = next(iter(gp.load_scene("hallway").tasks.values()))
    gp.plan(drive.start, drive.goal, drive.scene, iterations=60)
    walker = DynamicObstacles(shape=np.full((1, 4, 7), 0.5), velocity=np.zeros((1, 4), dtype=np.int32))
    open_floor = np.full((HEADINGS, 6, 9), STANDS | LEAVES, dtype=np.uint8)
    lattice = TimedLattice(open=open_floor, width=1.0, tick=0.5, ticks=40, outline=np.array([[0.1, 0.0, 0.3]]))
    lattice.cheapest((0, 5, 0), (8, 3), others=walker)
    steering = Steering(radius=0.4)
    native = steering.native()
    native.along(np.zeros((4, 3)), native.curves(np.zeros((4, 3)), np.ones((4, 3)))[1], np.ones((4, 6)))
    floor = np.full((40, 40), 1.0, dtype=np.float32)
    settings = LatticeSettings(steering=steering, headings=16)
    StateLattice(distance=floor, resolution=0.1, discs=np.array([[0.0, 0.0, 0.2]]), settings=settings)
    gp.DWA().bind(drive.scene)
    closed = np.zeros((40, 40), dtype=np.uint8)
    _native.distance_field(blocked=closed, resolution=0.1, outside=True)
    _native.FloorGrid(closed=closed, resolution=0.1, charge=floor)


class Low(gp.Cost):
    """A custom cost in Python."""

    def state(self, batch: gp.StateBatch) -> np.ndarray:
        """Return the squared norm of each configuration."""
        return np.sum(batch.q**2, axis=-1)


def time_outside_of_plans(task: gp.Task) -> None:
    """Time a curve with given speeds, as with torque limits."""
    limits, grid = task.scene.limits, Spline(np.asarray(task.start) + np.linspace(0.0, 0.3, 8)[:, None]).grid(1)
    speeds = np.sin(np.linspace(0.0, np.pi, len(grid.s)))
    found = travelled(grid, speeds, limits.velocity, limits.acceleration)
    slowdown(gp.Trajectory(found.t, found.q, found.qd, found.qdd, task.scene.joints), limits)


def plan_outside_of_scenes(task: gp.Task) -> None:
    """Run a descent, and create a search space with Python callbacks."""
    objective = gp.Objective().bind(task.scene)
    path = np.stack([np.asarray(task.start), np.asarray(task.start) + 0.1])
    problem = SceneProblem(kernels=objective.kernels, start=path[0], goals=path[1:])
    _native.Descent(native_space(problem, objective), path, 4, 0.1).run(3)
    _native.CallbackSpace(
        edges_free=lambda q0, q1: np.ones(len(q0), dtype=bool),
        edge_costs=lambda q0, q1: np.ones((len(q0), 2)),
        state_costs=lambda q: np.ones(len(q)),
        lower=np.zeros(2),
        upper=np.ones(2),
        w=1.0,
        motion_is_length=True,
    )


def broken(value: Any, rng: random.Random, others: list[Any]) -> Any:
    """Return an invalid variant of a valid argument."""
    if isinstance(value, np.ndarray):
        return broken_array(value, rng)
    if isinstance(value, bool):
        return rng.choice([not value, None, 7])
    if isinstance(value, int):
        return rng.choice([0, -1, 1, value + 1, value - 1, 2**31 - 1, -(2**31), 2**40, math.nan, None])
    if isinstance(value, float):
        return rng.choice([math.nan, math.inf, -math.inf, 0.0, -1.0, 1e308, -1e308, 5e-324, 1e-9, 1e9, "1"])
    if isinstance(value, str):
        return rng.choice(["", "x" * 10000, "\0", None])
    if isinstance(value, dict):
        name = rng.choice(list(value))
        others_of = {key: number for key, number in value.items() if key != name}
        return rng.choice([{**value, name: broken(value[name], rng, others)}, others_of, {**value, "other": 1.0}, None])
    if isinstance(value, list):
        return rng.choice([[], [math.nan], value * 3, None])
    return rng.choice([None, *others])


def broken_array(value: np.ndarray, rng: random.Random) -> Any:
    """Return an array with another shape, other values or another type."""
    kind = rng.randrange(9)
    out = value.copy()
    if kind <= 3 and out.size:
        flat = out.reshape(-1)
        at = rng.randrange(flat.size)
        if np.issubdtype(out.dtype, np.floating):
            flat[at] = rng.choice([math.nan, math.nan, math.inf, -math.inf, 1e300, -1e300, 1e30, -1.0, 0.0, 1e-300])
        elif out.dtype != bool:
            low, high = (0, 2**63) if out.dtype == np.uint64 else (-(2**31), 2**31 - 1)
            drawn = rng.choice([low, high, max(low, -1), 0, 1, flat.size, 1000])
            flat[at] = drawn % 256 if out.dtype == np.uint8 else drawn
        return out
    if kind == 4:
        return out[: rng.randrange(len(out) + 1)] if out.ndim else out
    if kind == 5:
        return np.concatenate([out, out]) if out.ndim else out
    if kind == 6:
        return out.reshape(-1) if rng.random() < 0.5 else out[None]
    if kind == 7:
        return rng.choice(
            [out[..., :-1].copy() if out.ndim else out, np.zeros((0,), out.dtype), np.zeros((), out.dtype)]
        )
    return rng.choice([out.astype(np.float32), out.astype(object), out.tolist(), None])


def poisoned(value: Any, infinite: bool) -> bool:
    """Return whether a value contains NaN, or infinity where that is invalid."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return False
    return bool(np.isnan(array).any() or (not infinite and np.isinf(array).any())) and value is not None


def attack(
    call: Call, rng: random.Random, pool: dict[str, list[Any]], seen: Counter[str], *, trace: bool
) -> str | None:
    """Repeat a call with broken arguments; return a description of a wrong reaction, or None."""
    arguments = dict(call.arguments)
    names = [n for n, x in arguments.items() if not callable(x) or id(x) in WIDTHS]
    for name in rng.sample(names, min(len(names), rng.choice([1, 1, 2]))):
        arguments[name] = broken(arguments[name], rng, pool.get(type(arguments[name]).__name__, []))
    if arguments.get("seconds") in (math.inf, 1e308, 1e9) or arguments.get("iterations", 0) in (2**31 - 1, 2**40):
        arguments["seconds" if "seconds" in arguments else "iterations"] = 1
        if "iterations" in arguments:
            arguments["iterations"] = 5
    if trace:
        print(call.name, brief(arguments), flush=True)
    begun = time.perf_counter()
    try:
        made = call.function(**arguments)
        if isinstance(call.function, type):
            for use in methods_of(call.name, made, arguments):
                try:
                    use.function(**use.arguments)
                except REFUSALS:
                    seen["refused later"] += 1
        seen["taken"] += 1
    except REFUSALS:
        seen["refused"] += 1
        return None
    finally:
        took = time.perf_counter() - begun
        if took > SLOW:
            print(f"{call.name} took {took:.0f} s with {brief(arguments)}", flush=True)
            seen["slow"] += 1
    for name, value in arguments.items():
        if poisoned(value, (call.name, name) in MAY_BE_INFINITE):
            return f"{call.name} took {name} = {brief({name: value})}"
    return None


def brief(arguments: dict[str, Any]) -> str:
    """Format arguments on one line."""
    return ", ".join(f"{n}={np.array2string(np.asarray(x), threshold=8)}"[:200] for n, x in arguments.items())


def main() -> int:
    """Return the number of failed calls."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--isa", nargs="*", default=list(instruction_sets()))
    parser.add_argument("--trace", action="store_true", help="print each call before it is made")
    args = parser.parse_args()
    faulthandler.enable()
    wrong = 0
    for isa in args.isa:
        calls = record(isa)
        groups: dict[str, list[Call]] = {}
        pool: dict[str, list[Any]] = {}
        for call in calls:
            groups.setdefault(call.name, []).append(call)
        for thing in KEPT:
            pool.setdefault(type(thing).__name__, []).append(thing)
        left_out = sorted(set(exported()) - set(groups))
        if left_out:
            wrong += len(left_out)
            print(f"nothing calls {', '.join(left_out)}", flush=True)
        rng = random.Random(args.seed)
        seen: Counter[str] = Counter()
        for _ in range(args.calls):
            name = rng.choice(sorted(groups))
            call = rng.choice(groups[name])
            problem = attack(call, rng, pool, seen, trace=args.trace)
            if problem:
                wrong += 1
                print(problem, flush=True)
        wrong += seen["slow"]
        print(f"{isa}: {args.calls} calls of {len(groups)} kinds: {dict(seen)}; {wrong} wrong", flush=True)
    return wrong


if __name__ == "__main__":
    status = min(main(), 100)
    sys.stdout.flush()
    os._exit(status)  # skips cleanup: calls and objects form cycles, which nanobind would report as leaks

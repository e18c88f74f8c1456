"""Speed of the impact models in every bundled scene on one thread: drops, contents, mixture of all failures."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.core.kernels import COST_STEP
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, drop_kernel
from graceful_plan.costs.objective import search_paces

Array = np.ndarray
Rates = dict[str, float]

MEASURED = f"""\
**Impact models in every scene**, for the task whose object is slowest to evaluate, in millions of pairs of a
configuration and an entity per second of processor time. "Drop": hits of the carried object, at random configurations
and velocities. "Gradient": its derivatives with respect to q and the joint velocity. "Contents": drop plus spilled
contents. "Mixture": all failures of the prior `service_robot`, along edges of 1 rad sampled at {COST_STEP:g} rad.
"Times": duration of an edge with the mixture over the duration with drops alone, as searches evaluate them, on random
edges and on edges near the straight line of the task. "Descents": the same ratio for states with derivatives along a
motion of the task.
"""
COLUMNS = ("drop", "gradient", "contents", "mixture", "times", "times, task", "times, descents")
TIMES = 5.0
"""Target: the largest of "times"."""
_LEAST = {"drop": 20.0, "gradient": 8.0}
"""Targets: the least of million pairs per second."""
_STATES = 127  # of a motion as the fine stage of a descent samples it


def measure(options: suite.Options) -> dict[str, Rates]:
    """Return the rates in every scene."""
    found = {}
    for name in gp.scenes():
        tasks = [task for task in suite.scene(name).tasks.values() if task.object_name is not None]
        tasks = tasks[: options.pick(len(tasks), quick=1)]
        rates = [_rates(task, options.pick(2000, quick=200)) for task in tasks]
        found[name] = min(rates, key=lambda one: one["drop"])
    return found


def targets(found: Mapping[str, Rates]) -> Iterator[report.Target]:
    """Yield the targets, each for the worst scene."""
    limits = [(f"{name}, slowest scene", name, ">=", least, " M pairs/s") for name, least in _LEAST.items()]
    limits += [(f"mixture over drop, {name}", name, "<=", TIMES, "") for name in COLUMNS[4:]]
    for what, column, relation, limit, unit in limits:
        worst = min if relation == ">=" else max
        value, scene = worst((rates[column], scene) for scene, rates in found.items())
        yield report.Target(
            what=f"impact models, {what}",
            wanted=f"{relation} {limit:g}{unit}",
            measured=f"{report.quantity(value)}{unit} ({scene})",
            met=value >= limit if relation == ">=" else value <= limit,
        )


def table(found: Mapping[str, Rates]) -> str:
    """Return the table of all scenes."""
    rows = [(name, *(report.quantity(rates[column]) for column in COLUMNS)) for name, rates in found.items()]
    return report.table(("scene", *COLUMNS), rows)


def _rates(task: gp.Task, n: int) -> Rates:
    scene, rng = task.scene, np.random.default_rng(0)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    qd = rng.uniform(-1.0, 1.0, size=q.shape) * scene.limits.velocity
    ahead = q + _unit(rng.normal(size=q.shape))
    few, every = max(1, n // 40), len(scene.entities)
    severity = np.ones((len(scene.components), every))
    falls = np.array([name == "carried" for name in scene.components])[:, None]
    drop = drop_kernel(scene, DropSettings.shipped())
    both = np.ones((len(ROWS), every))
    only = both * (np.arange(len(ROWS)) == 0)[:, None]
    alone = gp.FailureMixture().kernel(scene, severity * falls, search_paces())
    mixture = gp.FailureMixture(faults="service_robot").kernel(scene, severity, search_paces())
    assert alone is not None and mixture is not None
    samples = np.ceil(1.0 / COST_STEP) + 1.0
    along = n * samples * every / _seconds(lambda: alone.edges(q, ahead))
    mixed = few * samples * every / _seconds(lambda: mixture.edges(q[:few], ahead[:few], rough=True))
    rates = {
        "drop": n * every / _seconds(lambda: drop.impact(q, only, qd)),
        "gradient": n * every / _seconds(lambda: drop.gradient(q, only, qd)),
        "contents": n * every / _seconds(lambda: drop.impact(q, both, qd)),
        "mixture": mixed,
    }
    millions = {name: 1e-6 * rate for name, rate in rates.items()}
    return millions | {"times": along / mixed, **_times_of_task(task, rng)}


def _times_of_task(task: gp.Task, rng: np.random.Generator) -> Rates:
    """Return the two ratios near the straight line of a task, with the severities of its scene."""
    names, entities = task.scene.components, task.scene.entities.values()
    severity = np.array([[entity.severity[name] for entity in entities] for name in names])
    drop, mixture = (
        gp.FailureMixture(faults=faults).kernel(task.scene, severity, search_paces())
        for faults in ("drop_only", "service_robot")
    )
    limits, straight = task.scene.limits, task.goal[0] - task.start
    first = task.start + rng.uniform(size=(60, 1)) * straight + rng.normal(scale=0.15, size=(60, len(straight)))
    last = first + _unit(0.7 * _unit(straight[None]) + rng.normal(scale=0.25, size=first.shape))
    u = np.linspace(0.0, 1.0, _STATES)[:, None]
    q = np.clip(
        task.start + u * straight + np.sin(np.pi * u) * rng.normal(scale=0.3, size=len(straight)), *limits.position.T
    )
    qd = np.gradient(q, axis=0)
    qd *= 0.7 / np.abs(qd / limits.velocity).max(axis=1)[:, None]

    def ratio(ask: Callable[..., object]) -> float:
        return _seconds(partial(ask, mixture)) / _seconds(partial(ask, drop))

    return {
        "times, task": ratio(lambda kernel: kernel.edges(first, last, rough=True)),
        "times, descents": ratio(lambda kernel: kernel.state_slopes(q, qd, rough=True)),
    }


def _unit(steps: Array) -> Array:
    return steps / np.linalg.norm(steps, axis=1)[:, None]


def _seconds(do: Callable[[], object], repetitions: int = 4) -> float:
    """Return the shortest processor time of several repetitions [s]."""
    times = []
    for _ in range(repetitions):
        started = time.process_time()
        do()
        times.append(time.process_time() - started)
    return min(times)

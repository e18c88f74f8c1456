"""How fast the impact models are in every scene, on one thread: drops, contents, and the mixture of all failures."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.core.kernels import COST_STEP
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, drop_kernel
from graceful_plan.costs.objective import search_paces

Array = np.ndarray

TITLE = "Impact models: configuration and entity pairs per second on one thread"
MEASURED = f"""\
For the task of each scene whose object is slowest. "Drop": sums of P S of the carried object; "contents": with those of
its contents, after a drop and from a held container; "gradient": derivatives of the first with respect to q and its
velocity; "mixture": all generators of the prior `service_robot`. At random configurations and velocities,
and along edges of 1 rad sampled at {COST_STEP:g} rad. Best of several repetitions; millions of pairs of a configuration
and an entity per second.

"Times": how many times longer an edge takes with the mixture than with drops alone, as searches are charged, for which
the body model looks at fewer states and steps; "in full": the same with every state and step, as motions are charged
that a call returns. "Of the task": edges near the way from start to goal, where more is near than at random.
"Descents": states along a motion of the task with their derivatives, as descents evaluate them. For both, severities
are those of the scene; for the rest they are all 1.
"""
PAIRS, GRADIENT, TIMES = 20.0, 8.0, 5.0
COLUMNS = (
    "drop",
    "drop, edges",
    "contents",
    "gradient",
    "mixture, edges",
    "times",
    "in full",
    "of the task",
    "descents",
)
_COMPARED = ("service_robot", "drop_only")
_STATES = 127
"""Of a motion that descends finely."""


def run(options: suite.Options) -> str:
    """Time all models in all scenes."""
    rows = []
    for name in gp.scenes():
        tasks = [task for task in suite.scene(name).tasks.values() if task.object_name is not None]
        found = [_rates(task, 200 if options.quick else 4000) for task in (tasks[:1] if options.quick else tasks)]
        rows.append((name, min(found, key=lambda rates: rates["drop"])))
    cells = [(name, *(report.quantity(rates[column]) for column in COLUMNS)) for name, rates in rows]
    return "\n".join([MEASURED, report.targets(_targets(rows)), report.table(("scene", *COLUMNS), cells)])


def _targets(rows: Sequence[tuple[str, dict[str, float]]]) -> list[report.Target]:
    def told(column: str, worst: Callable[..., tuple[str, dict[str, float]]]) -> str:
        name, rates = worst(rows, key=lambda row: row[1][column])
        return (
            f"{report.quantity(dict(rows)['tabletop'][column])} on tabletop, {report.quantity(rates[column])} on {name}"
        )

    least = {column: min(rates[column] for _, rates in rows) for column in ("drop", "gradient")}
    return [
        report.Target(
            what="drop model, million pairs/s",
            wanted=f">= {PAIRS:g}",
            measured=told("drop", min),
            met=least["drop"] >= PAIRS,
        ),
        report.Target(
            what="with gradient, million pairs/s",
            wanted=f">= {GRADIENT:g}",
            measured=told("gradient", min),
            met=least["gradient"] >= GRADIENT,
        ),
        *(
            report.Target(
                what=f"full mixture, times the drop model, {what}",
                wanted=f"<= {TIMES:g}",
                measured=told(column, max),
                met=max(rates[column] for _, rates in rows) <= TIMES,
            )
            for column, what in (
                ("times", "edges at random as searches are charged"),
                ("of the task", "edges of the task as searches are charged"),
                ("descents", "motions that descend"),
                ("in full", "edges at random in full"),
            )
        ),
    ]


def _rates(task: gp.Task, n: int) -> dict[str, float]:
    scene, rng = task.scene, np.random.default_rng(0)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    qd = rng.uniform(-1.0, 1.0, size=q.shape) * scene.limits.velocity
    step = rng.normal(size=q.shape)
    ahead = q + _unit(step)
    few = max(1, n // 40)
    every = len(scene.entities)
    severity = np.ones((len(scene.components), every))
    falls = np.array([name == "carried" for name in scene.components])[:, None]
    drop = drop_kernel(scene, DropSettings.shipped())
    only = np.ones((len(ROWS), every)) * (np.arange(len(ROWS)) == 0)[:, None]
    paces = search_paces()
    alone = gp.FailureMixture().kernel(scene, severity * falls, paces)
    mixture = gp.FailureMixture(faults="service_robot").kernel(scene, severity, paces)
    assert alone is not None and mixture is not None
    samples = np.ceil(1.0 / COST_STEP) + 1.0
    rates = {
        "drop": n * every / _best(lambda: drop.impact(q, only, qd)),
        "drop, edges": n * samples * every / _best(lambda: alone.edges(q, ahead)),
        "contents": n * every / _best(lambda: drop.impact(q, np.ones((len(ROWS), every)), qd)),
        "gradient": n * every / _best(lambda: drop.gradient(q, only, qd)),
        "mixture, edges": few * samples * every / _best(lambda: mixture.edges(q[:few], ahead[:few], rough=True)),
    }
    in_full = few * samples * every / _best(lambda: mixture.edges(q[:few], ahead[:few]))
    return {name: 1e-6 * rate for name, rate in rates.items()} | {
        "times": rates["drop, edges"] / rates["mixture, edges"],
        "in full": rates["drop, edges"] / in_full,
        **_times_of_task(task, rng),
    }


def _times_of_task(task: gp.Task, rng: np.random.Generator) -> dict[str, float]:
    """Return how many times longer the mixture takes where motions of a task go, with the severities of its scene."""
    names, entities = task.scene.components, task.scene.entities.values()
    severity = np.array([[entity.severity[name] for entity in entities] for name in names])
    kernels = [gp.FailureMixture(faults=faults).kernel(task.scene, severity, search_paces()) for faults in _COMPARED]
    limits, way = task.scene.limits, task.goal[0] - task.start
    first = task.start + rng.uniform(size=(60, 1)) * way + rng.normal(scale=0.15, size=(60, len(way)))
    last = first + _unit(0.7 * _unit(way[None]) + rng.normal(scale=0.25, size=first.shape))
    u = np.linspace(0.0, 1.0, _STATES)[:, None]
    q = np.clip(task.start + u * way + np.sin(np.pi * u) * rng.normal(scale=0.3, size=len(way)), *limits.position.T)
    qd = np.gradient(q, axis=0)
    qd *= 0.7 / np.abs(qd / limits.velocity).max(axis=1)[:, None]
    edges, states = (
        [_best(partial(ask, kernel)) for kernel in kernels]
        for ask in (
            lambda kernel: kernel.edges(first, last, rough=True),
            lambda kernel: kernel.state_slopes(q, qd, rough=True),
        )
    )
    return {"of the task": edges[0] / edges[1], "descents": states[0] / states[1]}


def _unit(steps: Array) -> Array:
    return steps / np.linalg.norm(steps, axis=1)[:, None]


def _best(run: Callable[[], object], repetitions: int = 4) -> float:
    """Return the shortest time of one processor [s]."""
    times = []
    for _ in range(repetitions):
        started = time.process_time()
        run()
        times.append(time.process_time() - started)
    return min(times)

"""How fast the impact models are in every scene, on one thread: drops, contents, and the mixture of all failures."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

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
and an entity per second, and how many times longer the mixture takes than drops.
"""
PAIRS, GRADIENT, TIMES = 20.0, 8.0, 5.0
COLUMNS = ("drop", "drop, edges", "contents", "gradient", "mixture, edges", "times")


def run(options: suite.Options) -> str:
    """Time all models in all scenes."""
    rows = []
    for name in gp.scenes():
        tasks = [task for task in suite.scene(name).tasks.values() if task.object_name is not None]
        found = [_rates(task.scene, 200 if options.quick else 4000) for task in (tasks[:1] if options.quick else tasks)]
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
    most = max(rates["times"] for _, rates in rows)
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
        report.Target(
            what="full mixture, times the drop model",
            wanted=f"<= {TIMES:g}",
            measured=told("times", max),
            met=most <= TIMES,
        ),
    ]


def _rates(scene: gp.Scene, n: int) -> dict[str, float]:
    rng = np.random.default_rng(0)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    qd = rng.uniform(-1.0, 1.0, size=q.shape) * scene.limits.velocity
    step = rng.normal(size=q.shape)
    ahead = q + step / np.linalg.norm(step, axis=1)[:, None]
    few = max(1, n // 40)
    every = len(scene.entities)
    severity = np.ones((len(scene.components), every))
    falls = np.array([name == "carried" for name in scene.components])[:, None]
    drop = drop_kernel(scene, DropSettings.shipped())
    only = np.ones((len(ROWS), every)) * (np.arange(len(ROWS)) == 0)[:, None]
    paces = search_paces()
    alone = gp.Footprint().kernel(scene, severity * falls, paces)
    mixture = gp.Footprint(faults="service_robot").kernel(scene, severity, paces)
    assert alone is not None and mixture is not None
    samples = np.ceil(1.0 / COST_STEP) + 1.0
    rates = {
        "drop": n * every / _best(lambda: drop.impact(q, only, qd)),
        "drop, edges": n * samples * every / _best(lambda: alone.edges(q, ahead)),
        "contents": n * every / _best(lambda: drop.impact(q, np.ones((len(ROWS), every)), qd)),
        "gradient": n * every / _best(lambda: drop.gradient(q, only, qd)),
        "mixture, edges": few * samples * every / _best(lambda: mixture.edges(q[:few], ahead[:few])),
    }
    return {name: 1e-6 * rate for name, rate in rates.items()} | {
        "times": rates["drop, edges"] / rates["mixture, edges"]
    }


def _best(run: Callable[[], object], repetitions: int = 4) -> float:
    """Return the shortest time [s]."""
    times = []
    for _ in range(repetitions):
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return min(times)

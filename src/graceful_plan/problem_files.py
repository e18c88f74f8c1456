"""Read problem files of other planners: `load_problems`.

Three formats of problems for the Panda among primitives are known; lengths are in m, angles in rad, and the robot's base
is at the origin:

* robometrics (the YAML sets of MotionBenchMaker and MPiNets problems): by kind of problem, a list of
  {start: [7], goal_ik: [[7]...], goal_pose: {frame, position_xyz, quaternion_wxyz}, world_frame, obstacles: {cuboid:
  {name: {dims: [3], pose: [x y z qw qx qy qz]}}, cylinder: {name: {radius, height, pose}}, sphere: {name: {radius,
  position or pose}}}};
* MotionBenchMaker's own folders: `scene0001.yaml` (a MoveIt planning scene) beside `request0001.yaml` (a MoveIt motion
  plan request);
* VAMP's JSON: {robot, joints, problems: {kind: [{start, goals, box, cylinder, sphere}]}}.

Pickled files are never loaded: unpickling runs whatever their author wrote.

References:
    Chamzas et al., "MotionBenchMaker: a tool to generate and benchmark motion planning datasets", RA-L 2022.
    Fishman et al., "Motion policy networks", CoRL 2022 (robometrics).
    Thomason, Kingston and Kavraki, "Motions in microseconds via vectorized sampling-based planning", ICRA 2024 (VAMP).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from graceful_plan.motion_problem import Obstacle, ProblemFile

__all__ = ["Obstacle", "ProblemFile", "load_problems"]


def load_problems(
    path: str | Path, *, groups: Sequence[str] | None = None, fingers: float = 0.0
) -> tuple[ProblemFile, ...]:
    """Read every problem of a file or folder, in the file's order.

    Args:
        path: A robometrics file (.yaml), a file in VAMP's JSON (.json), or a folder of MotionBenchMaker's, whose name is
            then the group; a folder of such folders is read as a whole.
        groups: The kinds of problems to keep; all by default.
        fingers: Position of both finger joints [m], closed by default; what the files say about them is ignored.

    Raises:
        FormatError: If a file is not what it should be, with file and key.
        UnknownNameError: If there is no such group.
        SettingError: If `fingers` is not in [0, 0.04].
    """
    raise NotImplementedError

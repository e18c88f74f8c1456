"""Robots from public packages, each loaded as a new user would load it; none is part of the repository."""

from __future__ import annotations

import os
import sysconfig
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import mujoco

import graceful_plan as gp

FOLDER = "ROBOT_DATA"
"""Variable that names the folder with the models: `share` of the package example-robot-data. By default, that of this
Python's packages, where `make test-robots` puts it."""
OTHERS = "ROBOT_WHEELS"
"""Variable that names a folder with the content of the other packages; by default, that of this Python's packages."""
ACCELERATION, VELOCITY = 5.0, 2.0
"""Limits of joints without limits [rad/s2 and rad/s, or m/s2 and m/s]."""

_IIWA = "rtbdata/xacro/kuka_description/kuka_lbr_iiwa"
_SUITE = "robosuite/models/assets/robots"
_FETCH = "gymnasium_robotics/envs/assets"


@dataclass(frozen=True, kw_only=True)
class PackageRobot:
    """Location of a robot model, and settings to load it."""

    name: str
    file: str
    tool: str
    joints: int = 0
    """Planned joints of an MJCF model, which need velocity limits; 0 for a URDF."""
    fingers: float | None = None
    packages: Mapping[str, str] = field(default_factory=dict)
    """Folders by package."""
    of_issue: bool = False
    """Whether the targets include this robot."""

    def load(self, folder: Path) -> gp.Scene:
        """Load it from the folder with the content of its package."""
        path = folder / self.file
        if self.joints:
            return gp.Scene.from_mjcf(
                path,
                robot="base",
                tool=self.tool,
                self_collision="links",
                velocity=[VELOCITY] * self.joints,
                acceleration=[ACCELERATION] * self.joints,
            )
        packages = {name: folder / place for name, place in self.packages.items()} or [folder]
        return gp.Scene.from_urdf(
            path, tool=self.tool, acceleration=ACCELERATION, packages=packages, fingers=self.fingers
        )


_DATA = "example-robot-data/robots"
DATA_ROBOTS = (
    PackageRobot(name="Panda", file=f"{_DATA}/panda_description/urdf/panda.urdf", tool="panda_hand_tcp",
                 fingers=0.03, of_issue=True),
    PackageRobot(name="UR5", file=f"{_DATA}/ur_description/urdf/ur5_robot.urdf", tool="tool0", of_issue=True),
    PackageRobot(name="UR3", file=f"{_DATA}/ur_description/urdf/ur3_robot.urdf", tool="tool0"),
    PackageRobot(name="xArm 7", file=f"{_DATA}/xarm_description/urdf/xarm7.urdf", tool="link_eef"),
    PackageRobot(name="SO-101", file=f"{_DATA}/so_arm_description/urdf/so101.urdf", tool="gripper_frame_link",
                 of_issue=True),
    PackageRobot(name="Z1", file=f"{_DATA}/z1_description/urdf/z1.urdf", tool="gripperStator"),
    PackageRobot(name="Jaco 2", file=f"{_DATA}/kinova_description/robots/kinova.urdf", tool="j2s6s200_end_effector"),
    PackageRobot(name="TIAGo", file=f"{_DATA}/tiago_description/robots/tiago_no_hand.urdf", tool="arm_tool_link",
                 of_issue=True),
)  # fmt: skip
"""Of example-robot-data 6.0.0."""
WHEEL_ROBOTS = (
    PackageRobot(name="UR5e", file="airo_models/arms/ur5e/ur5e.urdf", tool="tool0", of_issue=True),
    PackageRobot(name="iiwa 14", file=f"{_IIWA}/urdf/lbr_iiwa_14_r820.urdf", tool="tool0",
                 packages={"kuka_lbr_iiwa_support": _IIWA}, of_issue=True),
    PackageRobot(name="Kinova3, MJCF", file=f"{_SUITE}/kinova3/robot.xml", tool="right_hand", joints=7, of_issue=True),
    PackageRobot(name="iiwa 7, MJCF", file=f"{_SUITE}/iiwa/robot.xml", tool="right_hand", joints=7),
    PackageRobot(name="UR5e, MJCF", file=f"{_SUITE}/ur5e/robot.xml", tool="right_hand", joints=6),
    PackageRobot(name="TIAGo, two arms, MJCF", file=f"{_SUITE}/tiago/robot.xml", tool="right_hand", joints=7),
)  # fmt: skip
"""Of airo-models 0.0.12, rtb-data 2.0.0 and robosuite 1.5.2."""


def loads() -> list[tuple[PackageRobot, Callable[[], gp.Scene]]]:
    """Return the installed robots, each with its load function."""
    installed = Path(sysconfig.get_path("purelib"))
    data = Path(os.environ.get(FOLDER) or installed / "cmeel.prefix" / "share")
    others = Path(os.environ.get(OTHERS) or installed)
    both = [(robot, data) for robot in DATA_ROBOTS] + [(robot, others) for robot in WHEEL_ROBOTS]
    found: list[tuple[PackageRobot, Callable[[], gp.Scene]]] = [
        (robot, partial(robot.load, folder)) for robot, folder in both if (folder / robot.file).is_file()
    ]
    fetch = others / _FETCH / "fetch" / "reach.xml"
    if fetch.is_file():
        robot = PackageRobot(name="Fetch, MJCF", file=str(fetch), tool="robot0:grip", joints=8, of_issue=True)
        found.append((robot, partial(fetch_at_a_table, fetch)))
    return found


def fetch_at_a_table(file: Path) -> gp.Scene:
    """Return the Fetch of gymnasium-robotics 1.4.2, with a fixed base: lift and arm are planned."""
    spec = mujoco.MjSpec.from_file(str(file))
    for k in range(3):
        spec.delete(spec.joint(f"robot0:slide{k}"))
    return gp.Scene.from_mjcf(
        spec,
        robot="robot0:",
        tool="robot0:grip",
        velocity=[0.1] + [VELOCITY] * 7,
        acceleration=[0.5] + [ACCELERATION] * 7,
    )

"""Pass broken files to every reader; each must read them or raise a GracefulPlanError, in a short time.

python .ci/fuzz_readers.py [--files N] [--seed S] [--reader NAME ...]

Files written by the library are broken in one or more places, as text and as bytes. A reader fails if it raises any
error other than a GracefulPlanError with the name of a file, returns a number that is not finite, takes more than 10 s,
or makes the process grow by a gigabyte. A crash ends the process; the file that was being read is in the folder that is
printed first.
"""

from __future__ import annotations

import argparse
import dataclasses
import faulthandler
import json
import logging
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import mujoco
import numpy as np
from PIL import Image

import failbench
import graceful_plan as gp
from failbench import scenario
from failbench.calibrations.failures import Failures, read_failures, write_failures
from failbench.policies.adapters import REACH
from failbench.policies.mlp import Mlp
from failbench.sweeps import dataset
from failbench.sweeps.card import write_card
from failbench.sweeps.dataset import read_manifest
from failbench.sweeps.definition import Sweep, SweepMotion
from failbench.sweeps.sweep import read_sweep
from failbench.traces.folder import chosen
from graceful_plan import disk_cache, documents
from graceful_plan.annotation.annotations import Annotation, Annotations
from graceful_plan.compare import summarise
from graceful_plan.compare.problems.suite import load_suite
from graceful_plan.compare.reports.report import page
from graceful_plan.compare.runs.best_motions import BestMotions
from graceful_plan.compare.runs.comparison import compare, load_comparison
from graceful_plan.compare.runs.known import read_known, write_known
from graceful_plan.costs.models.body.constants import BodySettings
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.network import DropNetwork
from graceful_plan.costs.models.spill.constants import SpillSettings
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.floor.files.moving_ai import read_scenarios
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.urdf.srdf import read_srdf
from graceful_plan.viewer.opening import asked
from graceful_plan.viewer.recorded import RecordedRollouts
from graceful_plan.viz.front_page import write_front_page

SLOW = 10
"""Time after which a reader counts as hanging [s]."""
GREEDY = 1e6
"""Growth of the process that counts as a failure [KiB]."""
PACKAGE = Path(gp.__file__).parent
URDF = """<robot name="arm">
  <link name="base"><collision><geometry><box size=".1 .1 .1"/></geometry></collision></link>
  <link name="upper">
    <inertial>
      <mass value="1.5"/><origin xyz="0 0 .1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision>
      <origin xyz="0 0 .2" rpy="0 .1 0"/><geometry><mesh filename="part.FORMAT" scale="1 1 1"/></geometry>
    </collision>
  </link>
  <link name="lower"><collision><geometry><cylinder radius=".03" length=".3"/></geometry></collision></link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 .1" rpy="0 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="2" effort="80"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="lower"/><origin xyz="0 0 .5"/><axis xyz="0 0 1"/>
    <limit velocity="2" effort="40"/>
  </joint>
</robot>
"""
SRDF = """<robot name="arm">
  <group_state name="home" group="all"><joint name="shoulder" value=".5"/><joint name="elbow" value="0"/></group_state>
  <disable_collisions link1="base" link2="upper" reason="Adjacent"/>
</robot>
"""
MJCF = """<mujoco model="two">
  <compiler angle="radian" autolimits="true"/>
  <option timestep=".002"/>
  <custom>
    <numeric name="arm/velocity_limit" data="2 2"/><numeric name="arm/acceleration_limit" data="8 8"/>
    <text name="entity/vase" data="glass"/>
  </custom>
  <default><geom density="500"/><default class="link"><geom type="capsule" size=".03"/></default></default>
  <asset>
    <mesh name="part" file="part.obj" scale="1 1 1"/>
    <texture name="grid" type="2d" builtin="checker" width="64" height="64" rgb1="1 1 1" rgb2="0 0 0"/>
    <material name="grid" texture="grid"/>
    <hfield name="ground" nrow="2" ncol="2" size="1 1 .1 .1" elevation="0 0 0 .5"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .01" pos="0 0 -.2" material="grid"/>
    <geom name="hill" type="hfield" hfield="ground" pos="5 5 -.2" contype="0" conaffinity="0"/>
    <body name="vase" pos=".6 .2 0"><freejoint/><geom type="cylinder" size=".04 .1" mass=".4"/></body>
    <replicate count="3" offset="0 .3 0"><geom type="box" size=".05 .05 .1" pos="-.8 0 0" euler="0 0 .3"/></replicate>
    <body name="arm/base" pos="0 0 .1">
      <geom type="mesh" mesh="part"/>
      <body name="arm/upper" pos="0 0 .4">
        <joint name="arm/shoulder" axis="0 1 0" range="-2 2" armature=".1"/>
        <geom class="link" fromto="0 0 .05 0 0 .3"/>
        <body name="arm/lower" pos="0 0 .35">
          <joint name="arm/elbow" axis="0 1 0" range="-2 2" armature=".1"/>
          <geom class="link" fromto="0 0 .05 0 0 .25"/>
          <site name="arm/tool" pos="0 0 .3" quat="1 0 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="a" joint="arm/shoulder" kp="100" forcerange="-40 40"/>
    <position name="b" joint="arm/elbow" kp="100" forcerange="-40 40"/>
  </actuator>
  <keyframe><key name="home" qpos=".6 .2 0 1 0 0 0 .5 .5"/></keyframe>
</mujoco>
"""
PRIOR = """version: 1
presets:
  mine:
    gripper_slip: 2.0e-4
effects:
  severe:
    gripper_slip: {drop: .9}
"""


@dataclass(frozen=True)
class Reader:
    """A function that reads a file or folder.

    | field | meaning                                      |
    |-------|----------------------------------------------|
    | files | files to break, relative to the valid folder |
    | read  | function that reads from a folder            |
    """

    files: tuple[str, ...]
    read: Callable[[Path], Any]


def text(file: Path, first: str) -> str:
    """Return the text of a file, with a first character that prevents its use as a file name."""
    content = file.read_bytes() if file.is_file() else b""
    return first + content.decode("utf-8", errors="surrogateescape").lstrip()[1:]


def urdf(file: Path) -> gp.Scene:
    """Load a scene that contains only a robot."""
    return gp.Scene.from_urdf(file, tool="lower", acceleration=8.0, srdf=file.with_name("arm.srdf"))


def kept_array(folder: Path) -> Any:
    """Read from the cache, which treats a broken file as a missing one."""
    before, disk_cache.folder = disk_cache.folder, lambda: folder
    try:
        return disk_cache.read("0" * 64)
    finally:
        disk_cache.folder = before


def scene_of(scene: gp.Scene) -> dict[str, Any]:
    """Return the numbers of a scene."""
    model: mujoco.MjModel = scene.model
    names = ("body_pos", "body_quat", "body_mass", "body_inertia", "geom_pos", "geom_size", "qpos0", "jnt_axis")
    return {name: getattr(model, name) for name in names} | {"tasks": dict(scene.tasks)}


def floor_of(file: Path) -> Any:
    """Return the numbers of a map of map_server."""
    floor = gp.OccupancyGrid.from_map_server(file)
    return floor.occupancy, floor.resolution, floor.origin, floor.distance


def front_of(front: gp.ParetoFront) -> list[Any]:
    """Return the numbers of a front, without the weights, which may be infinite."""
    return [(point.path, point.trajectory, point.cost) for point in front.points]


def sealed(folder: Path) -> Path:
    """Give a manifest a valid checksum, as an attacker would."""
    file = folder / "manifest.json"
    try:
        manifest = json.loads(file.read_bytes())
        file.write_text(json.dumps({**manifest, "sha256": dataset._self_checksum(manifest)}))
    except (OSError, ValueError, TypeError, RecursionError, AttributeError):
        pass
    return folder


def card_of(folder: Path) -> str:
    """Write the card of a dataset, and check that a README.md of another origin is disk_cache."""
    manifest, file = read_manifest(sealed(folder)), folder / "README.md"
    before = file.read_bytes() if file.is_file() else b""
    write_card(folder, Sweep.from_document(manifest["sweep"], "manifest.json"), manifest)
    if before and b"made by failbench generate" not in before and file.read_bytes() != before:
        raise AssertionError("the card took the place of a file of somebody else")
    return file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""


def page_of_front(file: Path) -> str:
    """Write the page of a front, and check that no text of the front ends or adds a script."""
    front, out = gp.ParetoFront.load(file), file.with_suffix(".html")
    write_front_page(front, gp.load_scene("tabletop").tasks["right_to_left"].scene, out, title=front.scene)
    written = out.read_text(encoding="utf-8")
    if written.lower().count("<script") != 1 or written.lower().count("</script") != 1:
        raise AssertionError("a text in the front became part of the page")
    return written


def report_of(folder: Path) -> str:
    """Return the report page of a comparison."""
    return page(summarise(load_comparison(folder)))


READERS: Mapping[str, Reader] = {
    "trajectory JSON": Reader(("m.json",), lambda f: gp.Trajectory.from_json(f / "m.json")),
    "trajectory JSON text": Reader(("m.json",), lambda f: gp.Trajectory.from_json(text(f / "m.json", "{"))),
    "trajectory CSV": Reader(("m.csv",), lambda f: gp.Trajectory.from_csv(f / "m.csv")),
    "trajectory Parquet": Reader(("m.parquet",), lambda f: gp.Trajectory.from_parquet(f / "m.parquet")),
    "trajectory ROS": Reader(("m.yaml",), lambda f: gp.Trajectory.from_ros(f / "m.yaml")),
    "result": Reader(("result.json",), lambda f: documents.read_motion(f / "result.json")),
    "path": Reader(("path.json",), lambda f: documents.read_motion(f / "path.json")),
    "motion CSV": Reader(("m.csv",), lambda f: documents.read_motion(f / "m.csv")),
    "motion ROS": Reader(("m.yaml",), lambda f: documents.read_motion(f / "m.yaml")),
    "motion Parquet": Reader(("m.parquet",), lambda f: documents.read_motion(f / "m.parquet")),
    "front": Reader(("front.json",), lambda f: front_of(gp.ParetoFront.load(f / "front.json"))),
    "scene": Reader(("desk.yaml", "desk.xml"), lambda f: scene_of(gp.load_scene(f / "desk.yaml"))),
    "driven scene": Reader(("hallway.yaml", "hallway.xml"), lambda f: scene_of(gp.load_scene(f / "hallway.yaml"))),
    "MJCF": Reader(
        ("two.xml", "part.obj"), lambda f: scene_of(gp.Scene.from_mjcf(f / "two.xml", robot="arm/", tool="arm/tool"))
    ),
    "MJCF text": Reader(
        ("plain.xml",),
        lambda f: scene_of(gp.Scene.from_mjcf(text(f / "plain.xml", "<"), robot="arm/", tool="arm/tool")),
    ),
    "URDF": Reader(("obj.urdf", "part.obj"), lambda f: scene_of(urdf(f / "obj.urdf"))),
    "URDF with STL": Reader(("stl.urdf", "part.stl"), lambda f: scene_of(urdf(f / "stl.urdf"))),
    "URDF with packages": Reader(
        ("packed/robot/arm.urdf", "packed/parts/part.obj"),
        lambda f: scene_of(
            gp.Scene.from_urdf(
                f / "packed/robot/arm.urdf", tool="lower", acceleration=8.0, packages=[f / "packed/parts"]
            )
        ),
    ),
    "SRDF": Reader(("arm.srdf",), lambda f: read_srdf(f / "arm.srdf")),
    "severity": Reader(("severity.yaml",), lambda f: gp.SeverityTable.load(f / "severity.yaml")),
    "fragility": Reader(("fragility.yaml",), lambda f: FragilityTable.load(f / "fragility.yaml")),
    "drop model": Reader(("drop.yaml",), lambda f: DropSettings.load(f / "drop.yaml")),
    "body model": Reader(("body.yaml",), lambda f: BodySettings.load(f / "body.yaml")),
    "spill model": Reader(("spill.yaml",), lambda f: SpillSettings.load(f / "spill.yaml")),
    "coast model": Reader(("coast.yaml",), lambda f: CoastSettings.load(f / "coast.yaml")),
    "annotations": Reader(("annotations.yaml",), lambda f: dict(Annotations.load(f / "annotations.yaml").rows)),
    "drop network": Reader(("drops.npz",), lambda f: DropNetwork.read(f / "drops.npz")),
    "fault prior": Reader(("prior.yaml",), lambda f: gp.FaultPrior.load(f / "prior.yaml")),
    "scenarios": Reader(("scenarios.yaml",), lambda f: scenario.read_file(f / "scenarios.yaml")),
    "suite": Reader(("suite.yaml",), lambda f: load_suite(f / "suite.yaml")),
    "problems of VAMP": Reader(("vamp.json",), lambda f: gp.load_problems(f / "vamp.json")),
    "problems of robometrics": Reader(("metrics.yaml",), lambda f: gp.load_problems(f / "metrics.yaml")),
    "problems of MoveIt": Reader(
        ("cage/scene0001.yaml", "cage/request0001.yaml"), lambda f: gp.load_problems(f / "cage")
    ),
    "best known": Reader(("bench/best_known.yaml",), lambda f: read_known(f / "bench" / "best_known.yaml")),
    "best motions": Reader(("best/t.json",), lambda f: BestMotions.in_folder(f / "best").read(f / "best" / "t.json")),
    "comparison": Reader(("bench/journal.jsonl",), lambda f: load_comparison(f / "bench")),
    "dataset": Reader(
        ("sweep/manifest.json", "sweep/rollouts/part-00000.parquet"), lambda f: failbench.read_dataset(f / "sweep")
    ),
    "dataset that was sealed anew": Reader(
        ("sweep/manifest.json",), lambda f: failbench.read_dataset(sealed(f / "sweep")).sweep
    ),
    "card of a dataset": Reader(("sweep/manifest.json", "sweep/README.md"), lambda f: card_of(f / "sweep")),
    "page of a front": Reader(("front.json",), lambda f: page_of_front(f / "front.json")),
    "page of a comparison": Reader(("bench/journal.jsonl",), lambda f: report_of(f / "bench")),
    "sweep": Reader(("sweep/journal.sqlite",), lambda f: read_sweep(f / "sweep")),
    "sweep JSON": Reader(("sweep.json",), lambda f: Sweep.from_json(f / "sweep.json")),
    "failures": Reader(("failures.npz",), lambda f: read_failures(f / "failures.npz")),
    "network": Reader(("net.npz",), lambda f: (lambda net: (net.weights, net.biases))(Mlp.load(f / "net.npz"))),
    "rollouts to look at": Reader(
        ("sweep/manifest.json", "sweep/rollouts/part-00000.parquet"),
        lambda f: RecordedRollouts(f / "sweep", 1.0).worst_first(),
    ),
    "rollouts to trace": Reader(
        ("sweep/manifest.json",),
        lambda f: chosen(Sweep.from_document(read_manifest(f / "sweep")["sweep"], "manifest.json"), None),
    ),
    "scene to look at": Reader(("desk.yaml", "desk.xml"), lambda f: asked(f / "desk.yaml")[0].start),
    "map of map_server": Reader(("floor.yaml", "floor.pgm"), lambda f: floor_of(f / "floor.yaml")),
    "map of shares": Reader(("scale.yaml", "scale.pgm"), lambda f: floor_of(f / "scale.yaml")),
    "map as PNG": Reader(("grey.yaml", "grey.png"), lambda f: floor_of(f / "grey.yaml")),
    "map of MovingAI": Reader(("floor.map",), lambda f: gp.OccupancyGrid.from_moving_ai(f / "floor.map").distance),
    "scenarios of MovingAI": Reader(("floor.scen",), lambda f: read_scenarios(f / "floor.scen")),
    "kept array": Reader((f"{'0' * 64}.npz",), kept_array),
}
ANY_NUMBER = frozenset({"kept array", "failures", "comparison"})
"""Readers whose numbers may be NaN."""


# --- valid files -----------------------------------------------------------------------------------------------------


def write_valid(folder: Path) -> None:
    """Write a valid file for every reader."""
    task = gp.load_scene("tabletop").tasks["right_to_left"]
    result = gp.plan(task.start, task.goal, task.scene, iterations=50)
    motion = result.unwrap()
    motion.to_json(folder / "m.json")
    motion.to_csv(folder / "m.csv")
    motion.to_parquet(folder / "m.parquet")
    motion.to_ros_yaml(folder / "m.yaml")
    (folder / "result.json").write_text(documents.to_json(documents.result_document(result)))
    (folder / "path.json").write_text(documents.to_json(documents.path_document(result.path)))
    gp.pareto(task.start, task.goal, task.scene, points=3, iterations=400).save(folder / "front.json")
    scenes = PACKAGE / "scene" / "scenes"
    for name in ("desk.xml", "desk.yaml", "mobile/hallway.xml", "mobile/hallway.yaml"):
        shutil.copy(scenes / name, folder)
    write_meshes(folder)
    for kind in ("obj", "stl"):
        (folder / f"{kind}.urdf").write_text(URDF.replace("FORMAT", kind))
    (folder / "packed" / "robot").mkdir(parents=True)
    (folder / "packed" / "robot" / "arm.urdf").write_text(URDF.replace("part.FORMAT", "package://parts/part.obj"))
    (folder / "packed" / "parts").mkdir()
    shutil.copy(folder / "part.obj", folder / "packed" / "parts")
    (folder / "arm.srdf").write_text(SRDF)
    DropNetwork.shipped().write(folder / "drops.npz")
    row = {name: 0.5 for name in gp.SeverityTable.shipped().components}
    mug = Annotation(category="robust", fragility=2.0, significance=0.3, severity=row, reason="of glass")
    Annotations(scene="a", model="b", endpoint="c", pictures=False, rows={"mug": mug}).save(folder / "annotations.yaml")
    (folder / "two.xml").write_text(MJCF)
    (folder / "plain.xml").write_text(re.sub("<mesh .*?/>|<geom type=.mesh.*?/>", "", MJCF))
    (folder / "prior.yaml").write_text(PRIOR)
    tables = {"severity": gp.SeverityTable, "fragility": FragilityTable, "drop": DropSettings, "body": BodySettings}
    for name, table in {**tables, "spill": SpillSettings, "coast": CoastSettings}.items():
        shutil.copy(table.shipped_file, folder / f"{name}.yaml")
    shutil.copy(Path(scenario.__file__).with_name("scenarios.yaml"), folder)
    shutil.copy(PACKAGE / "compare" / "problems" / "suites" / "quick.yaml", folder / "suite.yaml")
    write_problems(folder)
    compare("quick", planners=["rrt_connect"], seeds=1, seconds=0.05, out=folder / "bench", processes=0)
    write_known({"desk/lift_coffee": 3.5}, 1.0, folder / "bench")
    (folder / "best").mkdir()
    best = next((Path(__file__).parents[1] / "benchmarks" / "best_known").glob("*.json"))
    shutil.copy(best, folder / "best" / "t.json")
    sweep = Sweep(
        motions=(SweepMotion(name="a", scene="tabletop", task="right_to_left", trajectory=motion),),
        faults=({"fault": "gripper_failure"},),
        rollouts=2,
        horizon=0.2,
    )
    (folder / "sweep.json").write_text(json.dumps(sweep.to_document()))
    failbench.generate_dataset(sweep, folder / "sweep")
    write_some_failures(folder / "failures.npz")
    write_maps(folder)
    shutil.copy(REACH, folder / "net.npz")
    np.savez(folder / f"{'0' * 64}.npz", values=np.arange(6.0))


def write_maps(folder: Path) -> None:
    """Write a floor in the formats of map_server (binary PGM, plain PGM, PNG) and MovingAI."""
    occupancy = np.where(np.random.default_rng(0).random((9, 12)) < 0.3, 100, 0)
    floor = gp.OccupancyGrid(occupancy=occupancy, resolution=0.1, origin=(1.0, -1.0, 0.3))
    floor.save(folder / "floor.yaml")
    floor.save_moving_ai(folder / "floor.map")
    (folder / "floor.scen").write_text("version 1\n" + "3\tfloor.map\t12\t9\t0\t8\t11\t0\t15.5\n" * 9)
    text = (folder / "floor.yaml").read_text()
    (folder / "scale.yaml").write_text(text.replace("floor.pgm", "scale.pgm").replace("trinary", "scale"))
    (folder / "scale.pgm").write_text("P2\n# plain\n12 9\n1000\n" + "\n".join(map(str, range(0, 972, 9))) + "\n")
    (folder / "grey.yaml").write_text(text.replace("floor.pgm", "grey.png"))
    Image.fromarray(np.dstack([np.where(occupancy, 0, 254), np.full((9, 12), 255)]).astype(np.uint8)).save(
        folder / "grey.png"
    )


def write_meshes(folder: Path) -> None:
    """Write a tetrahedron as OBJ and as STL."""
    corners = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.4]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    lines = ["v {} {} {}".format(*corner) for corner in corners] + ["f {} {} {}".format(*face) for face in faces + 1]
    (folder / "part.obj").write_text("\n".join(lines) + "\n")
    triangles = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles["corners"] = corners[faces]
    (folder / "part.stl").write_bytes(bytes(80) + len(faces).to_bytes(4, "little") + triangles.tobytes())


def write_problems(folder: Path) -> None:
    """Write a problem in each format that `load_problems` knows."""
    start, goal = [0.0, -0.7, 0.0, -2.2, 0.0, 1.6, 0.8], [0.6, -0.5, 0.1, -2.0, 0.1, 1.5, 0.8]
    pose = [0.5, 0.1, 0.3, 1.0, 0.0, 0.0, 0.0]
    cuboid = {"dims": [0.1, 0.2, 0.3], "pose": pose}
    metrics = {
        "start": start,
        "goal_ik": [goal],
        "world_frame": "panda_link0",
        "obstacles": {"cuboid": {"box": cuboid}},
    }
    (folder / "metrics.yaml").write_text(json.dumps({"shelf": [metrics]}))
    box = {"name": "b", "position": pose[:3], "orientation_quat_xyzw": [0, 0, 0, 1], "half_extents": [0.1, 0.1, 0.1]}
    vamp = {
        "start": start,
        "goals": [goal],
        "box": [box],
        "sphere": [{"name": "s", "position": pose[:3], "radius": 0.1}],
    }
    (folder / "vamp.json").write_text(json.dumps({"robot": "panda", "problems": {"shelf": [vamp]}}))
    joints = [f"panda_joint{i}" for i in range(1, 8)]
    turned = {"position": pose[:3], "orientation": [0.0, 0.0, 0.0, 1.0]}
    solid = {"id": "b", "primitives": [{"type": "box", "dimensions": [0.1, 0.2, 0.3]}], "primitive_poses": [turned]}
    wanted = [{"joint_name": name, "position": x} for name, x in zip(joints, goal, strict=True)]
    request = {
        "start_state": {"joint_state": {"name": joints, "position": start}},
        "goal_constraints": [{"joint_constraints": wanted}],
    }
    (folder / "cage").mkdir()
    (folder / "cage" / "scene0001.yaml").write_text(json.dumps({"world": {"collision_objects": [solid]}}))
    (folder / "cage" / "request0001.yaml").write_text(json.dumps(request))


def write_some_failures(file: Path) -> None:
    """Write failures along a motion of two joints with one entity."""
    rng = np.random.default_rng(0)
    write_failures(
        file,
        [
            Failures(
                scene="tabletop", task="a", motion="b", grasp="weld", components=("carried",), entities=("cup",),
                categories=("glass",), faults=("object_dropped",), counted=np.ones((1, 1), dtype=bool),
                fault=np.zeros(4, dtype=int), q=rng.random((4, 2)), qd=rng.random((4, 2)), ahead=rng.random((4, 3, 2)),
                hit=np.zeros((4, 1, 1), dtype=bool), dropped=np.ones(4, dtype=bool), spilled=np.zeros(4),
            )
        ],
    )  # fmt: skip


# --- breaking --------------------------------------------------------------------------------------------------------

NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]*")
NUMBERS = (
    b"1" + b"0" * 400, b"-1" + b"0" * 400, b"1e400", b"1e308", b"-1e308", b"NaN", b".nan", b"Infinity", b"-.inf",
    b"nan", b"inf", b"-1", b"0", b"-0.0", b"1e-320", b"4294967296", b"9223372036854775808", b"1e9", b"null",
    b"true", b"\"1\"", b"[]", b"{}", b"0x10", b"1_000", b"1:30", b"2020-01-01", b"[[1]]", b"",
)  # fmt: skip
WORDS = (
    b"", b"null", b"\\ud800", b"\\u0000", b"..", b"/etc/passwd", b"../../secret", b"file:///etc/passwd", b"x" * 10_000,
    b"\xff\xfe", b"\xed\xa0\x80", b"%s%n", b"<", b"&lol;", b"*a", b"&a", b"!!python/object:os.system", b"NaN",
    b"true", b"1",
)  # fmt: skip
NESTED = (b"[" * 480 + b"]" * 480, b"[" * 100_000, b'{"a":' * 480 + b"1" + b"}" * 480, b"<a>" * 480, b"- " * 480)


def broken(content: bytes, rng: random.Random) -> bytes:
    """Break a file in one to three places."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        content = rng.choice(BREAKS)(content, rng)
    return content


def _replaced(pattern: re.Pattern[bytes], others: tuple[bytes, ...]) -> Callable[[bytes, random.Random], bytes]:
    def replace(content: bytes, rng: random.Random) -> bytes:
        found = list(pattern.finditer(content[:2_000_000]))
        if not found:
            return content
        at = rng.choice(found)
        return content[: at.start()] + rng.choice(others) + content[at.end() :]

    return replace


def _bytes(content: bytes, rng: random.Random) -> bytes:
    out = bytearray(content)
    for _ in range(rng.choice((1, 2, 8, 64)) if out else 0):
        out[rng.randrange(len(out))] = rng.choice((0, 255, 10, 34, 44, 45, 91, 123, rng.randrange(256)))
    return bytes(out)


def _line(content: bytes, rng: random.Random) -> bytes:
    """Drop, double, move or indent a line, or in a file of one line a part between commas."""
    end = b"\n" if content.count(b"\n") > 2 else b","
    lines = content.split(end)
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(4)
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines.insert(j, lines[i])
    elif kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i] = b"  " + lines[i]
    return end.join(lines)


def _cut(content: bytes, rng: random.Random) -> bytes:
    a, b = sorted((rng.randrange(len(content) + 1), rng.randrange(len(content) + 1)))
    return rng.choice((content[:a], content[:a] + content[b:], content[a:], content[:b] + content[a:]))


BREAKS: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    *(3 * [_replaced(NUMBER, NUMBERS)]),
    *(2 * [_replaced(WORD, WORDS)]),
    _replaced(NUMBER, NESTED),
    _bytes,
    *(2 * [_line]),
    _cut,
)


def place(valid: Path, names: tuple[str, ...], folder: Path, rng: random.Random) -> None:
    """Copy the valid files and break one file of a reader; sometimes delete it, empty it or make it a folder."""
    shutil.copytree(valid, folder)
    victim = folder / rng.choice(names)
    kind = rng.randrange(60)
    if kind <= 1:
        victim.unlink()
    if kind == 1:
        victim.mkdir()
    elif kind == 2:
        victim.write_bytes(b"")
    elif kind > 2:
        victim.write_bytes(broken(victim.read_bytes(), rng))


# --- judging ---------------------------------------------------------------------------------------------------------


MESSAGES: dict[str, Counter[str]] = {name: Counter() for name in READERS}
"""Messages of each reader, without numbers."""


class TooSlow(BaseException):
    """A reader took too long."""


def _alarm(number: int, frame: FrameType | None) -> None:
    raise TooSlow


def not_finite(value: Any, name: str = "") -> Iterator[str]:
    """Yield the names of values that are not finite."""
    if isinstance(value, float):
        if not np.isfinite(value):
            yield name
    elif isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            yield name
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from not_finite(item, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            yield from not_finite(item, f"{name}[{i}]")
    elif dataclasses.is_dataclass(value) and not isinstance(value, gp.Scene | gp.Verdict):
        for field in dataclasses.fields(value):
            yield from not_finite(getattr(value, field.name, None), f"{name}.{field.name}")


def judge(name: str, reader: Reader, folder: Path, seen: Counter[str]) -> str | None:
    """Run a reader and return a description of a wrong reaction, or None."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.alarm(SLOW)
    try:
        found = reader.read(folder)
        signal.alarm(0)
    except gp.GracefulPlanError as error:
        seen["refused"] += 1
        MESSAGES[name].update([re.sub(r"\d+", "#", str(error))[-90:]])
        named = name.endswith("text") or any(Path(file).name in str(error) for file in reader.files)
        return None if named else f"names no file: {type(error).__name__}: {error}"
    except TooSlow:
        return f"took more than {SLOW} s"
    except Exception:
        return traceback.format_exc(limit=-3)[-2000:]
    finally:
        signal.alarm(0)
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        if grown > GREEDY:
            seen["greedy"] += 1
            print(f"{name} made the process grow by {grown / 1e6:.1f} GB", flush=True)
    seen["read"] += 1
    bad = [] if name in ANY_NUMBER else list(not_finite(found))
    return f"read what is not finite: {', '.join(bad[:5])}" if bad else None


def main() -> int:
    """Return the number of failures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", nargs="*", default=list(READERS), choices=list(READERS), metavar="NAME")
    parser.add_argument("--verbose", action="store_true", help="print the most frequent messages")
    args = parser.parse_args()
    faulthandler.enable()
    logging.disable()
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGALRM, _alarm)
    rng, wrong = random.Random(args.seed), Counter[str]()
    with tempfile.TemporaryDirectory() as scratch:
        valid, folder = Path(scratch) / "valid", Path(scratch) / "broken"
        print(f"files in {folder}", flush=True)
        valid.mkdir()
        write_valid(valid)
        for name in args.reader:
            counts: Counter[str] = Counter()
            if (found := judge(name, READERS[name], valid, counts)) or not counts["read"]:
                raise SystemExit(f"{name} does not read its valid file: {found or list(MESSAGES[name])}")
        seen: dict[str, Counter[str]] = {name: Counter() for name in args.reader}
        for i in range(args.files):
            name = args.reader[i % len(args.reader)]
            shutil.rmtree(folder, ignore_errors=True)
            place(valid, READERS[name].files, folder, rng)
            found = judge(name, READERS[name], folder, seen[name])
            if found:
                wrong[name] += 1
                if wrong[name] <= 6:
                    print(f"--- {name}, file {i}\n{found}", flush=True)
        for name, counts in seen.items():
            print(f"{name}: {counts['read']} read, {counts['refused']} refused, {wrong[name]} wrong", flush=True)
            if args.verbose:
                print(
                    *(f"    {count} x {message}" for message, count in MESSAGES[name].most_common(8)),
                    sep="\n",
                    flush=True,
                )
        greedy = sum(counts["greedy"] for counts in seen.values())
        print(f"{args.files} files, {wrong.total() + greedy} wrong", flush=True)
        return wrong.total() + greedy


if __name__ == "__main__":
    sys.exit(min(main(), 100))

"""Conversion of parsed problem files to problems. Unknown kinds of obstacles are refused.

* robometrics (the YAML sets of MotionBenchMaker and MPiNets problems): for each kind of problem, a list of
  {start: [7], goal_ik: [[7]...], goal_pose: {frame: panda_hand, position_xyz, quaternion_wxyz},
  world_frame: panda_link0, obstacles: {cuboid: {name: {dims: [3], pose}}, cylinder: {name: {radius, height, pose}},
  sphere: {name: {radius, pose or position}}}} with pose = [x y z qw qx qy qz]. Other keys of a problem are ignored.
* VAMP's JSON: {robot: panda, joints: [...], problems: {kind: [{start, goals, sphere: [{name, position, radius}], box:
  [{name, position, orientation_quat_xyzw, half_extents}], cylinder: [{..., radius, length}]}]}}.
* MotionBenchMaker's pairs: a MoveIt planning scene (world.collision_objects of primitives: box of three lengths, sphere
  of a radius, cylinder of height and radius; orientations xyzw) and a MoveIt motion plan request
  (start_state.joint_state and goal_constraints[].joint_constraints).

References:
    Chamzas et al., "MotionBenchMaker: a tool to generate and benchmark motion planning datasets", RA-L 2022.
    Fishman et al., "Motion policy networks", CoRL 2022 (robometrics).
    Thomason, Kingston and Kavraki, "Motions in microseconds via vectorized sampling-based planning", ICRA 2024 (VAMP).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.compare.problems.motion_problem import Obstacle, ProblemFile
from graceful_plan.compare.problems.plain_values import Value
from graceful_plan.scene.pose_goal import PoseGoal

NQ = 7
MAX_OBSTACLES = 2000
_BASE_FRAMES = ("panda_link0", "base_link", "world", "")
"""Names of the robot's base frame in the files; it coincides with W."""
_FRAMES = {"panda_hand": 0.0, "panda_link8": -np.pi / 4.0}
"""Frames of goal poses, with the rotation of the hand about z in them [rad]; the origins coincide."""
_TOOL = 0.1034
"""Distance of the tool from the hand's origin, along z [m]."""
_PRIMITIVES = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone"}
"""Numbers of MoveIt's primitives."""


# --- robometrics ------------------------------------------------------------------------------------------------------


def robometrics_problems(document: Value, fingers: float) -> list[ProblemFile]:
    """Read a set of robometrics.

    Raises:
        FormatError: If something is missing, of the wrong type, or unknown.
    """
    return [
        _robometrics(problem, f"{group}/{i}", group, fingers)
        for group, problems in document.items()
        for i, problem in enumerate(problems.entries())
    ]


def _robometrics(problem: Value, name: str, group: str, fingers: float) -> ProblemFile:
    _at_the_base(problem.get("world_frame"))
    goal_ik, goal_pose = problem.get("goal_ik"), problem.get("goal_pose")
    goals = [q.numbers(NQ) for q in goal_ik.entries()] if goal_ik else []
    if not goals and goal_pose is None:
        raise problem.error("needs goal_ik or goal_pose")
    return ProblemFile(
        name=name,
        group=group,
        start=np.array(problem["start"].numbers(NQ)),
        goals=np.array(goals).reshape(-1, NQ),
        pose=None if goal_pose is None else _goal_pose(goal_pose, needed=not goals),
        obstacles=_all_different(problem, _robometrics_obstacles(problem["obstacles"])),
        fingers=fingers,
    )


def _robometrics_obstacles(obstacles: Value) -> Iterator[Obstacle]:
    for kind, group in obstacles.items():
        if kind not in ("cuboid", "cylinder", "sphere"):
            raise group.error("is an unknown kind of obstacle; known: cuboid, cylinder, sphere")
        for name, given in group.items() if group.plain else ():
            if kind == "cuboid":
                size = tuple(0.5 * d for d in given["dims"].numbers(3, above=0.0))
                yield Obstacle(name=name, kind="box", size=size, X_WO=_pose(given["pose"]))
            elif kind == "sphere":
                pose, position = given.get("pose"), given.get("position")
                X_WO = _pose(pose) if pose else _rigid((position or given["position"]).numbers(3), (1.0, 0.0, 0.0, 0.0))
                yield Obstacle(name=name, kind="sphere", size=(given["radius"].number(above=0.0),), X_WO=X_WO)
            else:
                size = (given["radius"].number(above=0.0), 0.5 * given["height"].number(above=0.0))
                yield Obstacle(name=name, kind=kind, size=size, X_WO=_pose(given["pose"]))


def _goal_pose(given: Value, *, needed: bool) -> PoseGoal | None:
    """Convert a pose of the hand into one of the tool; None if its frame is unknown and the pose is not needed."""
    if given.is_list:  # older files: a plain pose of the hand
        X_WH, angle = _pose(given), 0.0
    else:
        frame = given["frame"]
        if frame.text() not in _FRAMES:
            if not needed:
                return None
            raise frame.error(f"= {frame.plain!r} is an unknown frame; known: {', '.join(_FRAMES)}")
        angle = _FRAMES[frame.text()]
        X_WH = _rigid(given["position_xyz"].numbers(3), _unit(given["quaternion_wxyz"], wxyz=True))
    X_HT = _rigid((0.0, 0.0, _TOOL), (np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)))
    return PoseGoal(X_WH @ X_HT)


# --- VAMP -------------------------------------------------------------------------------------------------------------


def vamp_problems(document: Value, fingers: float) -> list[ProblemFile]:
    """Read problems in VAMP's JSON.

    Raises:
        FormatError: If something is missing, of the wrong type, or unknown, or if they are for another robot.
    """
    robot = document.get("robot")
    if robot is not None and robot.text() != "panda":
        raise robot.error(f"= {robot.plain!r}; only problems for 'panda' are read")
    joints = document.get("joints")
    order = _joint_order([joint.text() for joint in joints.entries()], joints) if joints else list(range(NQ))
    return [
        _vamp(problem, f"{group}/{i}", group, order, fingers)
        for group, problems in document["problems"].items()
        for i, problem in enumerate(problems.entries())
    ]


def _vamp(problem: Value, name: str, group: str, order: list[int], fingers: float) -> ProblemFile:
    goals = np.array([q.numbers(NQ) for q in problem["goals"].entries()]).reshape(-1, NQ)
    if not len(goals):
        raise problem["goals"].error("has to hold at least one goal")
    for key, value in problem.items():
        if key not in _VAMP_KINDS and isinstance(value.plain, list) and any(isinstance(v, dict) for v in value.plain):
            raise value.error(f"is an unknown kind of obstacle; known: {', '.join(_VAMP_KINDS)}")
    obstacles = (obstacle for kind in _VAMP_KINDS for obstacle in _vamp_obstacles(problem.get(kind), kind))
    return ProblemFile(
        name=name,
        group=group,
        start=np.array(problem["start"].numbers(NQ))[order],
        goals=goals[:, order],
        pose=None,
        obstacles=_all_different(problem, obstacles),
        fingers=fingers,
    )


_VAMP_KINDS = ("box", "cylinder", "sphere")


def _vamp_obstacles(given: Value | None, kind: str) -> Iterator[Obstacle]:
    for i, item in enumerate(given.entries() if given else ()):
        name = item.get("name")
        turned = item.get("orientation_quat_xyzw")
        quaternion = _unit(turned, wxyz=False) if turned else (1.0, 0.0, 0.0, 0.0)
        if turned is None and kind != "sphere":
            raise item.error("needs the key 'orientation_quat_xyzw'")
        if kind == "box":
            size = item["half_extents"].numbers(3, above=0.0)
        elif kind == "sphere":
            size = (item["radius"].number(above=0.0),)
        else:
            size = (item["radius"].number(above=0.0), 0.5 * item["length"].number(above=0.0))
        yield Obstacle(
            name=name.text() if name else f"{kind}{i}",
            kind=kind,
            size=size,
            X_WO=_rigid(item["position"].numbers(3), quaternion),
        )


# --- MoveIt -----------------------------------------------------------------------------------------------------------


def moveit_problem(scene: Value, request: Value, name: str, group: str, fingers: float) -> ProblemFile:
    """Read a planning scene and a motion plan request.

    Raises:
        FormatError: If something is missing, of the wrong type, or unknown, or if the goal is not one of joints.
    """
    state = request["start_state"]["joint_state"]
    positions = [value.number() for value in state["position"].entries()]
    names = [joint.text() for joint in state["name"].entries()]
    if len(names) != len(positions):
        raise state.error(f"has {len(names)} names and {len(positions)} positions")
    alternatives = request["goal_constraints"].entries()
    if not alternatives:
        raise request["goal_constraints"].error("has to hold at least one goal")
    goals = []
    for alternative in alternatives:
        constraints = alternative["joint_constraints"].entries()
        wanted = [constraint["joint_name"].text() for constraint in constraints]
        at = [constraint["position"].number() for constraint in constraints]
        goals.append([at[i] for i in _joint_order(wanted, alternative["joint_constraints"])])
    for place in (request["start_state"], scene.get("robot_state")):
        attached = None if place is None else place.get("attached_collision_objects")
        if attached is not None and attached.plain:
            raise attached.error("are not read; only an empty gripper is")
    world = scene["world"]
    octomap = world.get("octomap")
    if octomap is not None and octomap.plain and _has_data(octomap):
        raise octomap.error("is not read; use the scenes of primitives")
    return ProblemFile(
        name=name,
        group=group,
        start=np.array([positions[i] for i in _joint_order(names, state["name"])]),
        goals=np.array(goals),
        pose=None,
        obstacles=_all_different(scene, _moveit_obstacles(world["collision_objects"])),
        fingers=fingers,
    )


def _has_data(octomap: Value) -> bool:
    inner = octomap.get("octomap")
    data = (inner or octomap).get("data")
    return data is not None and bool(data.plain)


def _moveit_obstacles(objects: Value) -> Iterator[Obstacle]:
    for given in objects.entries():
        header = given.get("header")
        _at_the_base(header.get("frame_id") if header else None)
        for refused in ("meshes", "planes"):
            value = given.get(refused)
            if value is not None and value.plain:
                raise value.error("are not read; only primitives are")
        base = given.get("pose")
        X_WB = _moveit_pose(base) if base else np.eye(4)
        primitives, poses = given["primitives"].entries(), given["primitive_poses"].entries()
        if len(primitives) != len(poses):
            raise given.error(f"has {len(primitives)} primitives and {len(poses)} poses for them")
        name = given["id"].text()
        for i, (primitive, pose) in enumerate(zip(primitives, poses, strict=True)):
            kind, size = _moveit_primitive(primitive)
            own = name if len(primitives) == 1 else f"{name}_{i}"
            yield Obstacle(name=own, kind=kind, size=size, X_WO=X_WB @ _moveit_pose(pose))


def _moveit_primitive(given: Value) -> tuple[str, tuple[float, ...]]:
    word, dimensions = given["type"], given["dimensions"]
    kind = _PRIMITIVES.get(word.plain, "") if isinstance(word.plain, int) else word.text()
    if kind == "box":
        return kind, tuple(0.5 * d for d in dimensions.numbers(3, above=0.0))
    if kind == "sphere":
        return kind, dimensions.numbers(1, above=0.0)
    if kind == "cylinder":
        height, radius = dimensions.numbers(2, above=0.0)
        return kind, (radius, 0.5 * height)
    raise word.error(f"= {word.plain!r} is an unknown primitive; known: box, sphere, cylinder")


def _moveit_pose(given: Value) -> Float[Array, "4 4"]:
    return _rigid(given["position"].numbers(3), _unit(given["orientation"], wxyz=False))


# --- shared -----------------------------------------------------------------------------------------------------------


def _joint_order(names: list[str], place: Value) -> list[int]:
    """Return the index of each arm joint among names such as "panda_joint1"; fingers are ignored."""
    order = []
    for joint in range(1, NQ + 1):
        known = (f"panda_joint{joint}", f"joint{joint}")
        found = [i for i, name in enumerate(names) if name in known]
        if len(found) != 1:
            raise place.error(f"has to name {known[0]!r} once; it names {', '.join(names) or 'nothing'}")
        order.append(found[0])
    return order


def _at_the_base(frame: Value | None) -> None:
    if frame is not None and frame.text() not in _BASE_FRAMES:
        raise frame.error(f"= {frame.plain!r}; poses have to be in the frame of the base, 'panda_link0'")


def _all_different(problem: Value, obstacles: Iterator[Obstacle]) -> tuple[Obstacle, ...]:
    found: dict[str, Obstacle] = {}
    for obstacle in obstacles:
        if obstacle.name in found:
            raise problem.error(f"has two obstacles with the name {obstacle.name!r}")
        if obstacle.name.startswith("panda/"):
            raise problem.error(f"has an obstacle with the name {obstacle.name!r}, which is the robot's")
        found[obstacle.name] = obstacle
        if len(found) > MAX_OBSTACLES:
            raise problem.error(f"has more than {MAX_OBSTACLES} obstacles")
    return tuple(found.values())


def _pose(given: Value) -> Float[Array, "4 4"]:
    """Read [x y z qw qx qy qz]."""
    numbers = given.numbers(7)
    return _rigid(numbers[:3], _unit(given, numbers[3:], wxyz=True))


def _unit(given: Value, quaternion: tuple[float, ...] | None = None, *, wxyz: bool) -> tuple[float, ...]:
    """Return a unit quaternion wxyz; files round to three digits."""
    q = np.array(given.numbers(4) if quaternion is None else quaternion)
    norm = float(np.linalg.norm(q))
    if not 0.99 < norm < 1.01:
        raise given.error(f"holds a quaternion of length {norm:.4g}, expected 1")
    q /= norm
    return tuple(q if wxyz else np.roll(q, 1))


def _rigid(position: tuple[float, ...], wxyz: tuple[float, ...]) -> Float[Array, "4 4"]:
    return PoseGoal.at(np.array(position), np.array(wxyz)).X_WT

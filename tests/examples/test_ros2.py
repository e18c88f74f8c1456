"""The ROS 2 nodes against stubs of its messages: sent messages, and refusals."""

import importlib
import sys

import numpy as np
import pytest
from places import ROOT
from ros import stubs as ros

import graceful_plan as gp


@pytest.fixture
def robot():
    return ros.Robot()


@pytest.fixture
def example(robot, monkeypatch):
    """Import an example as if ROS were installed."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "ros2"))
    for name, module in ros.modules(robot).items():
        monkeypatch.setitem(sys.modules, name, module)

    def example(name):
        for known in ("follow_trajectory", "moveit_scene"):
            monkeypatch.delitem(sys.modules, known, raising=False)
        return importlib.import_module(name)

    yield example
    for known in ("follow_trajectory", "moveit_scene"):
        sys.modules.pop(known, None)


@pytest.fixture
def trajectory():
    q = np.linspace([0.0, 1.0], [0.5, -1.0], 4)
    return gp.Trajectory(np.arange(4) * 0.75, q, np.zeros_like(q), np.zeros_like(q), ("panda/joint1", "panda/joint2"))


def state(*position):
    return ros.JointState(name=[f"panda_joint{i + 1}" for i in range(len(position))], position=list(position))


# --- follow_trajectory ------------------------------------------------------------------------------------------------


def test_the_controller_gets_the_trajectory(example, robot, trajectory, tmp_path, capsys):
    robot.state = state(0.0, 1.005, 7.0)
    trajectory.to_json(tmp_path / "motion.json")
    assert example("follow_trajectory").main([str(tmp_path / "motion.json"), "/arm/follow"]) == 0
    ((action, goal),) = robot.goals
    assert (action, capsys.readouterr().out) == ("/arm/follow", "done\n")
    assert goal.trajectory.joint_names == ["panda_joint1", "panda_joint2"]
    assert goal.trajectory.points[1].time_from_start == ros.Duration(sec=0, nanosec=750_000_000)
    sent = gp.Trajectory.from_ros(goal.trajectory, trajectory.joints, lambda name: name.replace("/", "_"))
    np.testing.assert_array_equal(sent.q, trajectory.q)
    np.testing.assert_array_equal(sent.t, trajectory.t)


@pytest.mark.parametrize(
    ("change", "said", "sent"),
    [
        ({"state": state(0.0, 1.1)}, "not at the start of the motion: {'panda_joint2'", 0),
        ({"state": state(0.0)}, "not at the start of the motion: {'panda_joint2': inf}", 0),
        ({"there": False}, "the action server of the controller is not available", 0),
        ({"accepts": False}, "refused", 1),
        ({"result": ros.FollowJointTrajectory.Result(error_code=-4, error_string="late")}, "code -4: late", 1),
    ],
)
def test_errors_are_reported(example, robot, trajectory, tmp_path, capsys, change, said, sent):
    robot.state = state(0.0, 1.0)
    vars(robot).update(change)
    trajectory.to_json(tmp_path / "motion.json")
    assert example("follow_trajectory").main([str(tmp_path / "motion.json"), "/arm/follow"]) == 1
    assert said in capsys.readouterr().out
    assert len(robot.goals) == sent


# --- moveit_scene -----------------------------------------------------------------------------------------------------


def thing(name, kind, *dimensions, at=(0.0, 0.0, 0.0), frame="world", **others):
    pose = ros.Pose(position=ros.Point(x=at[0], y=at[1], z=at[2]))
    shape = ros.SolidPrimitive(type=kind, dimensions=list(dimensions))
    given = {"header": ros.Header(frame_id=frame), "id": name, "primitives": [shape], "primitive_poses": [pose]}
    return ros.CollisionObject(**(given | others))


def seen_by_a_camera():
    return ros.OctomapWithPose(octomap=ros.Octomap(data=[1, 2]))


def scene_with(*things):
    return ros.PlanningScene(world=ros.PlanningSceneWorld(collision_objects=list(things)))


def test_primitives_become_solids_of_the_same_size(example):
    seen = scene_with(
        thing("shelf", 1, 0.2, 0.4, 0.6, at=(1.0, 2.0, 3.0)), thing("mug", 3, 0.1, 0.04), thing("ball", 2, 0.05)
    )
    shelf, mug, ball = example("moveit_scene").solids(seen)
    assert (shelf.kind, list(shelf.size), shelf.entity) == ("box", [0.1, 0.2, 0.3], None)
    np.testing.assert_array_equal(shelf.pose[:3, 3], [1.0, 2.0, 3.0])
    assert (mug.kind, list(mug.size), mug.entity) == ("cylinder", [0.04, 0.05], "glass")
    assert (ball.kind, list(ball.size)) == ("sphere", [0.05])


def test_shapes_stand_in_the_pose_of_their_object(example):
    turned = ros.Pose(position=ros.Point(z=1.0), orientation=ros.Quaternion(z=np.sqrt(0.5), w=np.sqrt(0.5)))
    (solid,) = example("moveit_scene").solids(scene_with(thing("shelf", 1, 1.0, 1.0, 1.0, at=(1.0, 0, 0), pose=turned)))
    np.testing.assert_allclose(solid.pose[:3, 3], [0.0, 1.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(solid.pose[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)


def test_meshes_become_solids_with_names_of_their_own(example):
    corners = [ros.Point(x=x, y=y, z=z) for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]
    both = thing("lamp", 2, 0.1, meshes=[ros.Mesh(vertices=corners)], mesh_poses=[ros.Pose()])
    ball, hull = example("moveit_scene").solids(scene_with(both))
    assert (ball.name, hull.name, hull.kind) == ("lamp", "lamp.1", "mesh")
    scene = gp.load_scene("tabletop").edit(add=[hull])
    assert scene.model.body("lamp.1").id > 0


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (scene_with(thing("shelf", 1, 1.0, 1.0, 1.0, frame="camera")), "'shelf' is in 'camera'"),
        (scene_with(thing("shelf", 5, 1.0)), "type 5"),
        (ros.PlanningScene(world=ros.PlanningSceneWorld(octomap=seen_by_a_camera())), "octomaps are not supported"),
        (scene_with(thing("floor", 1, 1.0, 1.0, 1.0, planes=[object()])), "plane"),
        (
            ros.PlanningScene(robot_state=ros.RobotState(attached_collision_objects=[ros.AttachedCollisionObject()])),
            "in the gripper",
        ),
    ],
)
def test_objects_without_counterpart_are_refused(example, seen, said):
    with pytest.raises(ValueError, match=said):
        list(example("moveit_scene").solids(seen))


def test_a_motion_in_a_moveit_scene_is_shown_and_saved(example, robot, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    plan = gp.plan
    monkeypatch.setattr(gp, "plan", lambda *args, **settings: plan(*args, iterations=300, **settings))
    scene = gp.load_scene("tabletop")
    start, goal = list(scene.keyframes)[:2]
    names = [joint.replace("/", "_") for joint in scene.joints]
    position = [*scene.keyframes[start].tolist(), 0.0]
    robot.scene = scene_with(thing("post", 3, 0.4, 0.03, at=(0.5, 0.6, 0.6)))
    robot.scene.robot_state.joint_state = ros.JointState(name=[*names, "panda_finger"], position=position)
    assert example("moveit_scene").main(["tabletop", goal]) == 0
    assert capsys.readouterr().out.startswith("SOLVED")
    ((name, request),) = robot.asked
    assert (name, request.components.components) == ("/get_planning_scene", 2 | 4 | 8 | 16 | 32)
    (shown,) = robot.published["/display_planned_path"]
    assert shown.trajectory[0].joint_trajectory.joint_names == names
    motion = gp.Trajectory.from_json(tmp_path / "motion.json")
    np.testing.assert_allclose(motion.q[-1], scene.keyframes[goal], atol=1e-6)


def test_without_moveit_nothing_is_planned(example, robot):
    robot.there = False
    with pytest.raises(RuntimeError, match="is move_group running"):
        example("moveit_scene").main(["tabletop", "ready"])

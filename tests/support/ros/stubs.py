"""Stubs of the parts of ROS 2 that the examples use: messages with exactly the same fields."""

from __future__ import annotations

from dataclasses import dataclass, field, make_dataclass
from types import ModuleType, SimpleNamespace
from typing import Any


def message(kind: str, /, **defaults: Any) -> type:
    """Make a message class: fields with defaults, and a TypeError for any other, as with rclpy's messages."""
    fields = [
        (key, Any, field(default_factory=value if callable(value) else lambda value=value: value))
        for key, value in defaults.items()
    ]
    return make_dataclass(kind, fields, kw_only=True)


Duration = message("Duration", sec=0, nanosec=0)
Time = message("Time", sec=0, nanosec=0)
Header = message("Header", stamp=Time, frame_id="")
Point = message("Point", x=0.0, y=0.0, z=0.0)
Quaternion = message("Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
Pose = message("Pose", position=Point, orientation=Quaternion)
SolidPrimitive = message("SolidPrimitive", type=0, dimensions=list, polygon=None)
Mesh = message("Mesh", triangles=list, vertices=list)
JointState = message("JointState", header=Header, name=list, position=list, velocity=list, effort=list)
JointTrajectoryPoint = message(
    "JointTrajectoryPoint", positions=list, velocities=list, accelerations=list, effort=list, time_from_start=Duration
)
JointTrajectory = message("JointTrajectory", header=Header, joint_names=list, points=list)
CollisionObject = message(
    "CollisionObject", header=Header, pose=Pose, id="", type=None, primitives=list, primitive_poses=list, meshes=list,
    mesh_poses=list, planes=list, plane_poses=list, subframe_names=list, subframe_poses=list, operation=0,
)  # fmt: skip
AttachedCollisionObject = message("AttachedCollisionObject", link_name="", object=CollisionObject, touch_links=list)
RobotState = message("RobotState", joint_state=JointState, attached_collision_objects=list, is_diff=False)
Octomap = message("Octomap", data=list)
OctomapWithPose = message("OctomapWithPose", octomap=Octomap)
PlanningSceneWorld = message("PlanningSceneWorld", collision_objects=list, octomap=OctomapWithPose)
PlanningScene = message("PlanningScene", name="", robot_state=RobotState, world=PlanningSceneWorld, is_diff=False)
RobotTrajectory = message("RobotTrajectory", joint_trajectory=JointTrajectory, multi_dof_joint_trajectory=None)
DisplayTrajectory = message("DisplayTrajectory", model_id="", trajectory=list, trajectory_start=RobotState)
PlanningSceneComponents = message("PlanningSceneComponents", components=0)
for bit, name in enumerate(("SCENE_SETTINGS", "ROBOT_STATE", "ROBOT_STATE_ATTACHED_OBJECTS", "WORLD_OBJECT_NAMES",
                            "WORLD_OBJECT_GEOMETRY", "OCTOMAP")):  # fmt: skip
    setattr(PlanningSceneComponents, name, 1 << bit)


class FollowJointTrajectory:
    """The action."""

    Goal = message("Goal", trajectory=JointTrajectory, path_tolerance=list, goal_tolerance=list,
                   goal_time_tolerance=Duration)  # fmt: skip
    Result = message("Result", error_code=0, error_string="")
    Result.SUCCESSFUL = 0
    Result.PATH_TOLERANCE_VIOLATED = -4


class GetPlanningScene:
    """The service."""

    Request = message("Request", components=PlanningSceneComponents)
    Response = message("Response", scene=PlanningScene)


@dataclass
class Robot:
    """The remote side: joint states, a controller, and MoveIt."""

    state: Any = None
    there: bool = True
    accepts: bool = True
    result: Any = field(default_factory=FollowJointTrajectory.Result)
    scene: Any = field(default_factory=PlanningScene)
    goals: list[Any] = field(default_factory=list)
    asked: list[Any] = field(default_factory=list)
    published: dict[str, list[Any]] = field(default_factory=dict)


def done(value: Any) -> Any:
    """Return a finished future."""
    return SimpleNamespace(result=lambda: value)


def modules(robot: Robot) -> dict[str, ModuleType]:
    """Return the modules that the examples import, by name."""

    class Node:
        def __init__(self, name: str) -> None:
            self.name, self.subscribed = name, {}

        def create_subscription(self, kind: type, topic: str, callback: Any, depth: int) -> None:
            self.subscribed[topic] = callback

        def create_publisher(self, kind: type, topic: str, depth: int) -> Any:
            return SimpleNamespace(publish=robot.published.setdefault(topic, []).append)

        def create_client(self, kind: type, name: str) -> Any:
            def call(request: Any) -> Any:
                robot.asked.append((name, request))
                return done(GetPlanningScene.Response(scene=robot.scene))

            return SimpleNamespace(wait_for_service=lambda timeout_sec: robot.there, call_async=call)

    class ActionClient:
        def __init__(self, node: Node, kind: type, name: str) -> None:
            self.name = name

        def wait_for_server(self, timeout_sec: float) -> bool:
            return robot.there

        def send_goal_async(self, goal: Any) -> Any:
            robot.goals.append((self.name, goal))
            answer = done(SimpleNamespace(result=robot.result))
            return done(SimpleNamespace(accepted=robot.accepts, get_result_async=lambda: answer))

    def spin_once(node: Node, timeout_sec: float) -> None:
        node.subscribed["/joint_states"](robot.state)

    rclpy = {
        "init": lambda: None, "shutdown": lambda: None, "spin_once": spin_once, "create_node": Node,
        "spin_until_future_complete": lambda node, future: None,
    }  # fmt: skip
    contents = {
        "rclpy": rclpy,
        "rclpy.action": {"ActionClient": ActionClient},
        "rclpy.node": {"Node": Node},
        "builtin_interfaces.msg": {"Duration": Duration},
        "control_msgs.action": {"FollowJointTrajectory": FollowJointTrajectory},
        "sensor_msgs.msg": {"JointState": JointState},
        "trajectory_msgs.msg": {"JointTrajectory": JointTrajectory, "JointTrajectoryPoint": JointTrajectoryPoint},
        "moveit_msgs.srv": {"GetPlanningScene": GetPlanningScene},
        "moveit_msgs.msg": {
            "DisplayTrajectory": DisplayTrajectory,
            "PlanningScene": PlanningScene,
            "PlanningSceneComponents": PlanningSceneComponents,
            "RobotTrajectory": RobotTrajectory,
        },
    }
    made = {package: ModuleType(package) for name in contents for package in (name.split(".")[0], name)}
    for name, members in contents.items():
        vars(made[name]).update(members)
    return made

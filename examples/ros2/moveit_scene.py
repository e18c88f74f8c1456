"""Plan in MoveIt 2's planning scene: read its obstacles and the robot's state, and publish a trajectory.

    python moveit_scene.py my_robot.yaml grasp_pose

The scene file describes the robot (see docs/robots.md); the surroundings come from MoveIt's service
/get_planning_scene. The motion is published on /display_planned_path, for RViz, and written to motion.json, for
follow_trajectory.py. Needs a sourced ROS 2 with moveit_msgs.
"""

import sys
from collections.abc import Iterator, Mapping

import mujoco
import numpy as np
import rclpy
from follow_trajectory import robot_name, to_message
from moveit_msgs.msg import DisplayTrajectory, PlanningScene, PlanningSceneComponents, RobotTrajectory
from moveit_msgs.srv import GetPlanningScene

import graceful_plan as gp

ENTITIES = {"mug": "glass", "laptop": "electronics"}
"""MoveIt objects that are entities, with their classes; all others are obstacles only."""
FRAME = "world"
BOX, SPHERE, CYLINDER, CONE = 1, 2, 3, 4  # of shape_msgs/SolidPrimitive


def solids(scene: PlanningScene, entities: Mapping[str, str] = ENTITIES) -> Iterator[gp.StaticBody]:
    """Convert the collision objects of a planning scene to solids; meshes become their convex hulls."""
    if scene.robot_state.attached_collision_objects:
        names = [attached.object.id for attached in scene.robot_state.attached_collision_objects]
        raise ValueError(f"{names} are in the gripper: describe them in the scene file and use scene.attach(..)")
    if len(scene.world.octomap.octomap.data):
        raise ValueError(
            "octomaps are not supported: pass the original point cloud to gp.PointCloud, see docs/perception.md"
        )
    for thing in scene.world.collision_objects:
        if thing.header.frame_id != FRAME or thing.planes:
            raise ValueError(
                f"{thing.id!r} is in {thing.header.frame_id!r}, or is a plane; only solids in {FRAME!r} work here"
            )
        X_WT = matrix(thing.pose)
        shapes = [(*primitive(p), pose) for p, pose in zip(thing.primitives, thing.primitive_poses, strict=True)]
        shapes += [("mesh", points(mesh), pose) for mesh, pose in zip(thing.meshes, thing.mesh_poses, strict=True)]
        for i, (kind, size, pose) in enumerate(shapes):
            name = thing.id if i == 0 else f"{thing.id}.{i}"
            yield gp.StaticBody(
                name=name, kind=kind, size=size, pose=X_WT @ matrix(pose), entity=entities.get(thing.id)
            )


def primitive(shape) -> tuple[str, list[float]]:
    """Return kind and size of a shape_msgs/SolidPrimitive; sizes of `StaticBody` are half lengths [m]."""
    if shape.type == BOX:
        return "box", [0.5 * side for side in shape.dimensions]
    if shape.type == SPHERE:
        return "sphere", [shape.dimensions[0]]
    if shape.type in (CYLINDER, CONE):  # a cone becomes the cylinder around it
        height, radius = shape.dimensions
        return "cylinder", [radius, 0.5 * height]
    raise ValueError(f"primitives of type {shape.type} are not supported")


def points(mesh) -> np.ndarray:
    """Return the vertices of a shape_msgs/Mesh [m]."""
    return np.array([[vertex.x, vertex.y, vertex.z] for vertex in mesh.vertices])


def matrix(pose) -> np.ndarray:
    """Return a geometry_msgs/Pose as a 4 x 4 matrix."""
    o, p = pose.orientation, pose.position
    R, X = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(R, np.array([o.w, o.x, o.y, o.z]))
    X[:3, :3], X[:3, 3] = R.reshape(3, 3), [p.x, p.y, p.z]
    return X


def configuration(scene: PlanningScene, joints: tuple[str, ...]) -> np.ndarray:
    """Return the robot's configuration in the order of `joints` [rad or m]."""
    state = scene.robot_state.joint_state
    there = dict(zip(state.name, state.position, strict=True))
    return np.array([there[robot_name(joint)] for joint in joints])


def plan_there(seen: PlanningScene, robot: gp.Scene, goal: str, w: float = 0.3) -> gp.PlanResult:
    """Plan from the current configuration to a keyframe of the scene file, among MoveIt's obstacles."""
    scene = robot.edit(add=solids(seen))
    return gp.plan(configuration(seen, scene.joints), goal, scene, w=w)


def ask(node) -> PlanningScene:
    """Request MoveIt's planning scene.

    Raises:
        RuntimeError: If the service is not available within 5 s.
    """
    client = node.create_client(GetPlanningScene, "/get_planning_scene")
    if not client.wait_for_service(timeout_sec=5.0):
        raise RuntimeError("the service /get_planning_scene is not available: is move_group running?")
    wanted = PlanningSceneComponents(
        components=PlanningSceneComponents.ROBOT_STATE
        | PlanningSceneComponents.ROBOT_STATE_ATTACHED_OBJECTS
        | PlanningSceneComponents.WORLD_OBJECT_NAMES
        | PlanningSceneComponents.WORLD_OBJECT_GEOMETRY
        | PlanningSceneComponents.OCTOMAP
    )
    answer = client.call_async(GetPlanningScene.Request(components=wanted))
    rclpy.spin_until_future_complete(node, answer)
    return answer.result().scene


def main(argv: list[str]) -> int:
    """Plan once, publish and save the motion; return the exit code."""
    file, goal = argv
    rclpy.init()
    try:
        node = rclpy.create_node("graceful_plan")
        publisher = node.create_publisher(DisplayTrajectory, "/display_planned_path", 1)
        seen = ask(node)
        result = plan_there(seen, gp.load_scene(file), goal)
        print(f"{result.status.name}: {result.status.value} {result.detail}")
        if result.status is not gp.PlanStatus.SOLVED:
            return 1
        trajectory = result.unwrap()
        shown = RobotTrajectory(joint_trajectory=to_message(trajectory))
        publisher.publish(DisplayTrajectory(trajectory_start=seen.robot_state, trajectory=[shown]))
        trajectory.to_json("motion.json")
        return 0
    finally:
        rclpy.shutdown()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

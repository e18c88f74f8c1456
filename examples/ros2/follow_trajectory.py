"""Send a trajectory to a ROS 2 controller: a client of the action control_msgs/FollowJointTrajectory.

    graceful-plan plan --scene tabletop --output motion.json
    python follow_trajectory.py motion.json /panda_arm_controller/follow_joint_trajectory

Needs a sourced ROS 2 with control_msgs. Before sending, the script checks on /joint_states that the robot is at the
start of the motion.
"""

import sys

import numpy as np
import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from graceful_plan import Trajectory, documents

NEAR = 0.01
"""Largest accepted distance of each joint from the start of the motion [rad or m]."""


def robot_name(joint: str) -> str:
    """Return the robot's name of a joint: "panda/joint1" becomes "panda_joint1"."""
    return joint.replace("/", "_")


def to_message(trajectory: Trajectory) -> JointTrajectory:
    """Convert a trajectory to a message."""
    plain = trajectory.to_ros(robot_name)
    points = [
        JointTrajectoryPoint(**{**point, "time_from_start": Duration(**point["time_from_start"])})
        for point in plain["points"]
    ]
    return JointTrajectory(joint_names=plain["joint_names"], points=points)


def off_start(trajectory: Trajectory, state: JointState) -> dict[str, float]:
    """Return the distances from the start [rad or m] of the joints that exceed `NEAR`, by name."""
    there = dict(zip(state.name, state.position, strict=True))
    wanted = {robot_name(joint): float(q) for joint, q in zip(trajectory.joints, trajectory.q[0], strict=True)}
    off = {name: abs(there.get(name, np.inf) - q) for name, q in wanted.items()}
    return {name: value for name, value in off.items() if value > NEAR}


class Follower(Node):
    """Sends trajectories to one controller."""

    def __init__(self, action: str) -> None:
        super().__init__("graceful_plan_follower")
        self.state: JointState | None = None
        self.create_subscription(JointState, "/joint_states", self._see, 10)
        self.client = ActionClient(self, FollowJointTrajectory, action)

    def _see(self, state: JointState) -> None:
        self.state = state

    def follow(self, trajectory: Trajectory) -> str:
        """Execute a trajectory; return an error message, empty on success."""
        while self.state is None:
            rclpy.spin_once(self, timeout_sec=1.0)
        if off := off_start(trajectory, self.state):
            return f"the robot is not at the start of the motion: {off}"
        if not self.client.wait_for_server(timeout_sec=5.0):
            return "the action server of the controller is not available"
        sent = self.client.send_goal_async(FollowJointTrajectory.Goal(trajectory=to_message(trajectory)))
        rclpy.spin_until_future_complete(self, sent)
        if not sent.result().accepted:
            return "the controller refused the trajectory"
        done = sent.result().get_result_async()
        rclpy.spin_until_future_complete(self, done)
        result = done.result().result
        if result.error_code == FollowJointTrajectory.Result.SUCCESSFUL:
            return ""
        return f"the controller aborted with code {result.error_code}: {result.error_string}"


def main(argv: list[str]) -> int:
    """Send the trajectory of a file; return the exit code."""
    file, action = argv
    trajectory = documents.read_motion(file)
    assert isinstance(trajectory, Trajectory), "a path has no timing: see graceful_plan.retime"
    rclpy.init()
    try:
        problem = Follower(action).follow(trajectory)
    finally:
        rclpy.shutdown()
    print(problem or "done")
    return 1 if problem else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

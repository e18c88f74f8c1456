"""A controller of ros2_control that interpolates a message executes the planned motion."""

import numpy as np
import pytest

import graceful_plan as gp


def interpolated(message, per_piece=20):
    """Interpolate as joint_trajectory_controller does: by cubics, and by quintics between points with accelerations.

    Returns positions, velocities and accelerations at `per_piece` times within every piece, and these times.
    """
    points = message["points"]
    t = [p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] * 1e-9 for p in points]
    states, times = [], []
    for i in range(len(points) - 1):
        h = t[i + 1] - t[i]
        keys = ["positions", "velocities"] + (["accelerations"] if points[i]["accelerations"] else [])
        # Coefficients c of sum c_k u^k in u = time / h whose derivatives at u = 0 and u = 1 are those of the points.
        order = 2 * len(keys)
        k = np.arange(order)
        rows, values = [], []
        for end in (0, 1):
            for d, key in enumerate(keys):
                falling = np.prod([k - j for j in range(d)], axis=0) if d else np.ones(order)
                rows.append(falling * (k == d if end == 0 else 1.0))
                values.append(np.array(points[i + end][key]) * h**d)
        c = np.linalg.solve(np.array(rows, float), np.array(values))
        u = np.linspace(0.0, 1.0, per_piece, endpoint=False)
        powers = [
            np.polynomial.polynomial.polyval(u, np.polynomial.polynomial.polyder(c, d)).T / h**d for d in range(3)
        ]
        states.append(np.stack(powers))
        times.append(t[i] + u * h)
    return np.concatenate(states, axis=1), np.concatenate(times)


@pytest.fixture(scope="module")
def planned():
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    trajectory = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50).unwrap()
    return trajectory, task.scene.limits.acceleration


def test_the_controller_executes_the_planned_motion_within_its_limits(planned):
    trajectory, limit = planned
    (q, qd, qdd), t = interpolated(trajectory.to_ros())
    expected = trajectory.at(trajectory.t[0] + t)
    np.testing.assert_allclose(q, expected.q, atol=1e-7)
    np.testing.assert_allclose(qd, expected.qd, atol=1e-6)
    assert np.max(np.abs(qdd) / limit) < 1.0 + 1e-3


def test_with_accelerations_quintics_exceed_the_limits(planned):
    trajectory, limit = planned
    (_, _, qdd), _ = interpolated(trajectory.to_ros(accelerations=True))
    assert 1.2 < np.max(np.abs(qdd) / limit) <= 1.76

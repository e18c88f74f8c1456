from dataclasses import replace

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.drive_checks import SIDEWAYS
from hall import BASE, hall

SCENE = hall()


def motion(velocity, *, heading=0.0, turning=0.0, duration=2.0, start=(-4.0, 0.0)):
    """Return a motion from rest to rest whose greatest speed is 1.5 times this mean velocity."""
    t = np.linspace(0.0, duration, 101)
    s, ds, dds = 3 * (t / duration) ** 2 - 2 * (t / duration) ** 3, 6 * t * (duration - t) / duration**3, None
    dds = (6 * duration - 12 * t) / duration**3
    way = duration * np.array([velocity[0], velocity[1], turning])
    first = np.array([*start, heading])
    parts = (first + s[:, None] * way, ds[:, None] * way, dds[:, None] * way)
    return gp.Trajectory(t, *parts, SCENE.joints)


def failures(trajectory, scene=SCENE):
    return set(gp.verify(trajectory, scene).failures)


def test_straight_on_is_fine():
    assert failures(motion((0.5, 0.0))) == set()
    assert failures(motion((0.5, 0.0), heading=np.pi)) == set()  # backwards


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_sideways_speed_is_seen_to_the_millimetre(share):
    found = failures(motion((0.0, share * SIDEWAYS / 1.5), start=(-4.0, 0.5)))
    assert ("rolling" in found) == (share > 1.0)


def test_a_base_without_reverse_does_not_drive_backwards():
    forward_only = hall(replace(BASE, reverse=False))
    assert failures(motion((0.5, 0.0), heading=np.pi), forward_only) == {"drive_limits"}


def test_wheels_bound_driving_and_turning_together():
    slow = hall(replace(BASE, wheel_max=1.0 / BASE.radius))  # rims at 1 m/s
    assert failures(motion((0.6, 0.0)), slow) == set()
    assert "drive_limits" in failures(motion((0.7, 0.0)), slow)
    assert "drive_limits" in failures(motion((0.0, 0.0), turning=1.5 / BASE.lever, duration=4.0), slow)


def test_acceleration_across_is_seen():
    calm = hall(replace(BASE, lateral_max=0.1))
    t = np.linspace(0.0, 4.0, 400)
    s = 3 * (t / 4) ** 2 - 2 * (t / 4) ** 3
    angle, ds, dds = 1.2 * s, 1.2 * 6 * t * (4 - t) / 64, 1.2 * (24 - 12 * t) / 64
    q = np.column_stack([-4 + np.sin(angle), 1 - np.cos(angle), angle])
    tangent, normal = np.column_stack([np.cos(angle), np.sin(angle)]), np.column_stack([-np.sin(angle), np.cos(angle)])
    qd = np.column_stack([ds[:, None] * tangent, ds])
    qdd = np.column_stack([dds[:, None] * tangent + (ds**2)[:, None] * normal, dds])
    arc = gp.Trajectory(t, q, qd, qdd, SCENE.joints)
    assert failures(arc) == set()
    assert failures(arc, calm) == {"drive_limits"}


def test_paths_roll_or_turn_in_place():
    west = np.array([-4.0, 0.0, 0.0])
    assert gp.verify(gp.Path(west + np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1]])), SCENE).passed
    assert "rolling" in gp.verify(gp.Path(west + np.array([[0, 0, 0], [0, 0.5, 0]])), SCENE).failures
    assert "rolling" in gp.verify(gp.Path(west + np.array([[0, 0, 0], [1, 0, 1]])), SCENE).failures


def test_holonomic_bases_are_not_checked():
    free = hall(None)
    assert "rolling" not in gp.verify(motion((0.0, 0.2), start=(-4.0, 0.5)), free).checks

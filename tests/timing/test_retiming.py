"""Retiming: closed-form durations, scaling laws, limits at every time, agreement with toppra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from graceful_plan.core import _native
from graceful_plan.exceptions import RetimingError, SettingError, ShapeError
from graceful_plan.path import Path
from graceful_plan.scene.elements import Limits
from graceful_plan.timing.blend import CurveGrid, Polyline, rounded, sampled
from graceful_plan.timing.retiming import (
    ACCEPTED_SLOWDOWN,
    retime,
    slowdown,
    slowed,
    timed,
)
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.topp import fastest, fastest_with_toppra, travelled
from graceful_plan.timing.trajectory import Trajectory

_TOLERANCE = 1e-6
"""Relative excess over limits that the library allows."""
_SHORTEST_PIECE = 1e-5
"""Minimum duration of a piece of a motion [s]."""


def _limits(velocity: ArrayLike, acceleration: ArrayLike, torque: float = np.inf) -> Limits:
    velocity, acceleration = np.array(velocity), np.array(acceleration)
    position = np.stack([np.full(len(velocity), -np.inf), np.full(len(velocity), np.inf)], axis=1)
    torques = np.full(len(velocity), torque)
    return Limits(position=position, velocity=velocity, acceleration=acceleration, torque=torques)


_PANDA = _limits([2.175] * 4 + [2.61] * 3, [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])


def _path(q: list[list[float]]) -> Path:
    return Path(np.array(q))


def _zigzag(seed: int, n: int, size: float) -> Path:
    return Path(np.cumsum(np.random.default_rng(seed).normal(size=(n, 7)) * size, axis=0))


def _assert_within_limits(trajectory: Trajectory, limits: Limits) -> None:
    times = np.linspace(trajectory.t[0], trajectory.t[-1], 5000)
    for t in (times, trajectory.t, trajectory.t - 1e-9, trajectory.t + 1e-9):
        state = trajectory.at(t)
        assert (np.abs(state.qd) / limits.velocity).max() <= 1.0 + _TOLERANCE
        assert (np.abs(state.qdd) / limits.acceleration).max() <= 1.0 + _TOLERANCE
    assert (np.abs(trajectory.qdd) / limits.acceleration).max() <= 1.0 + _TOLERANCE


@given(st.floats(1e-4, 6.0), st.floats(0.1, 5.0), st.floats(0.1, 20.0))
def test_straight_line_takes_the_closed_form_time(length: float, v: float, a: float) -> None:
    trajectory = retime(_path([[0.0], [length]]), _limits([v], [a]))
    exact = length / v + v / a if length > v * v / a else 2.0 * np.sqrt(length / a)
    # The profile switches at grid points; there are about a hundred.
    assert exact * (1 - 1e-7) <= trajectory.duration <= exact * 1.005
    _assert_within_limits(trajectory, _limits([v], [a]))


@given(st.integers(0, 10**6), st.integers(2, 12), st.floats(0.01, 1.0), st.sampled_from([0.0, 0.003, 0.05, 0.3]))
def test_zigzags_keep_the_limits_and_start_and_end_at_rest(seed: int, n: int, size: float, deviation: float) -> None:
    path = _zigzag(seed, n, size)
    trajectory = retime(path, _PANDA, deviation=deviation)
    _assert_within_limits(trajectory, _PANDA)
    np.testing.assert_array_equal(trajectory.q[[0, -1]], path.q[[0, -1]])
    assert not trajectory.qd[[0, -1]].any()
    assert (np.diff(trajectory.t) > 0.0).all()


@given(st.integers(0, 10**6), st.integers(3, 12), st.sampled_from([0.0, 0.003, 0.05]))
def test_the_motion_stays_within_the_deviation(seed: int, n: int, deviation: float) -> None:
    path = _zigzag(seed, n, 0.3)
    q = retime(path, _PANDA, deviation=deviation).at(np.linspace(0.0, 30.0, 600)).q
    a, ab = path.q[:-1], np.diff(path.q, axis=0)
    along = np.clip(np.einsum("tsj,sj->ts", q[:, None] - a, ab) / (ab**2).sum(1), 0.0, 1.0)
    distance = np.linalg.norm(q[:, None] - a - along[..., None] * ab, axis=2).min(axis=1)
    assert distance.max() <= deviation + 1e-5


@given(st.integers(0, 10**6), st.integers(2, 10))
@settings(max_examples=25, deadline=None)
def test_backwards_takes_as_long(seed: int, n: int) -> None:
    path = _zigzag(seed, n, 0.4)
    # The grid depends on the direction; it is refined until the remaining slowdown is below this.
    tolerance = ACCEPTED_SLOWDOWN - 1.0
    assert retime(path.reversed(), _PANDA).duration == pytest.approx(retime(path, _PANDA).duration, rel=tolerance)


@given(st.integers(0, 10**6), st.floats(0.2, 5.0))
@settings(max_examples=25, deadline=None)
def test_scaled_limits_scale_time(seed: int, k: float) -> None:
    path = _zigzag(seed, 5, 0.4)
    scaled = _limits(k * _PANDA.velocity, k * k * _PANDA.acceleration)
    assert retime(path, scaled).duration == pytest.approx(retime(path, _PANDA).duration / k, rel=1e-6)


def test_speed_scales_time() -> None:
    path = _zigzag(0, 5, 0.4)
    full, half = retime(path, _PANDA), retime(path, _PANDA, speed=0.5)
    assert half.duration == pytest.approx(2.0 * full.duration)
    _assert_within_limits(half, _limits(0.5 * _PANDA.velocity, 0.25 * _PANDA.acceleration))


@given(st.integers(0, 10**6), st.integers(2, 8))
@settings(max_examples=15, deadline=None)
def test_more_deviation_is_never_slower_than_stopping(seed: int, n: int) -> None:
    path = _zigzag(seed, n, 0.4)
    assert retime(path, _PANDA, deviation=0.05).duration <= 1.02 * retime(path, _PANDA, deviation=0.0).duration


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("deviation", [0.0, 0.05])
def test_toppra_is_no_faster_and_hardly_slower(seed: int, deviation: float) -> None:
    path = _zigzag(seed, 6, 0.5)
    grid = sampled(rounded(path, deviation), path.q[-1], path.length / 400.0, 2)

    def duration(speeds: np.ndarray) -> float:
        return float((2.0 * np.diff(grid.s) / (speeds[1:] + speeds[:-1])).sum())

    own = duration(fastest(grid, _PANDA.velocity, _PANDA.acceleration).speeds)
    theirs = duration(fastest_with_toppra(grid, _PANDA.velocity, _PANDA.acceleration))
    # toppra uses one second derivative per grid point, so it brakes slightly early where the derivative jumps.
    assert own * 0.999 <= theirs <= own * (1.001 if deviation == 0.0 else 1.15)


def test_torque_limits_slow_a_falling_arm_down() -> None:
    """A pendulum of inertia 1 and gravity torque 4 cos q against a limit of 6 N m."""
    limits = _limits([10.0], [50.0], 6.0)

    def torque(q, qd, qdd):
        return qdd + 4.0 * np.cos(q)

    trajectory = retime(_path([[-1.0], [1.0]]), limits, inverse_dynamics=torque)
    state = trajectory.at(np.linspace(0.0, trajectory.duration, 4000))
    needed = np.abs(torque(state.q, state.qd, state.qdd))
    assert needed.max() <= 6.0 * (1.0 + 1e-3)
    assert needed.max() >= 5.9
    assert trajectory.duration > 1.5 * retime(_path([[-1.0], [1.0]]), limits).duration


def test_a_pose_that_cannot_be_held_has_a_name() -> None:
    limits = _limits([1.0], [1.0], 3.0)
    with pytest.raises(RetimingError, match=r"'shoulder'.* 4 N m"):
        retime(_path([[-1.0], [1.0]]), limits, ("shoulder",), inverse_dynamics=lambda q, qd, qdd: qdd + 4.0)


def test_a_path_without_length_gives_one_sample_at_rest() -> None:
    for n in (1, 3):
        trajectory = retime(_path([[0.3, 0.1]] * n), _limits([1.0, 1.0], [1.0, 1.0]))
        assert len(trajectory) == 1 and trajectory.duration == 0.0 and not trajectory.qd.any()


def test_duplicate_vertices_do_not_matter() -> None:
    path = _zigzag(5, 4, 0.5)
    doubled = Path(np.repeat(path.q, 3, axis=0))
    assert retime(doubled, _PANDA).duration == retime(path, _PANDA).duration


def test_a_path_back_along_itself() -> None:
    path = _path([[0.0, 0.0], [1.0, 0.5], [0.0, 0.0]])
    limits = _limits([1.0, 1.0], [4.0, 4.0])
    _assert_within_limits(retime(path, limits), limits)
    there = retime(Path(path.q[:2]), limits)
    assert retime(path, limits, deviation=0.0).duration == pytest.approx(2.0 * there.duration, rel=0.01)


def test_a_joint_that_never_moves_does_not_limit() -> None:
    alone = retime(_path([[0.0], [1.0]]), _limits([1.0], [2.0]))
    beside = retime(_path([[0.0, 3.0], [1.0, 3.0]]), _limits([1.0, 1e-3], [2.0, 1e-3]))
    assert beside.duration == pytest.approx(alone.duration)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_bad_acceleration_limits_have_a_name(bad: float) -> None:
    with pytest.raises(RetimingError, match=r"acceleration.*'b'"):
        retime(_path([[0.0, 0.0], [1.0, 1.0]]), _limits([1.0, 1.0], [1.0, bad]), ("a", "b"))


def test_misuse_raises() -> None:
    path, limits = _path([[0.0], [1.0]]), _limits([1.0], [1.0])
    for speed in (0.0, 1.1, np.nan):
        with pytest.raises(SettingError, match="speed"):
            retime(path, limits, speed=speed)
    with pytest.raises(SettingError, match="deviation"):
        retime(path, limits, deviation=-0.1)
    with pytest.raises(ShapeError, match="path has shape"):
        retime(path, limits, ("a", "b"))
    with pytest.raises(ShapeError, match=r"limits\.velocity"):
        retime(path, _limits([1.0, 1.0], [1.0, 1.0]))


@pytest.mark.parametrize("vertices", [2, 3, 4, 5])
def test_a_deviation_of_each_corner_or_one_of_all(vertices: int) -> None:
    path = _zigzag(1, vertices, 0.4)
    corners = vertices - 2
    same = retime(path, _PANDA, deviation=0.03)
    assert retime(path, _PANDA, deviation=np.full(corners, 0.03)).duration == pytest.approx(same.duration, rel=1e-12)
    for wrong in {corners - 1, corners + 1, vertices, 2 * corners} - {corners, -1}:
        with pytest.raises(ShapeError, match=rf"\({corners},\)"):
            retime(path, _PANDA, deviation=np.full(wrong, 0.03))


def test_full_speed_by_default() -> None:
    path = _zigzag(1, 4, 0.4)
    curve = Polyline(rounded(path, 0.05), path.q[-1])
    joints = tuple("abcdefg"[: path.q.shape[1]])
    assert timed(curve, _PANDA, joints).duration == retime(path, _PANDA, joints).duration
    assert retime(path, _PANDA, speed=1.0).duration == retime(path, _PANDA).duration


def test_slowed_keeps_the_geometry() -> None:
    trajectory = retime(_zigzag(1, 4, 0.4), _PANDA)
    slower = slowed(trajectory, 2.0)
    times = np.linspace(0.0, trajectory.duration, 100)
    np.testing.assert_allclose(slower.at(2.0 * times).q, trajectory.at(times).q, atol=1e-9)


@pytest.mark.parametrize("n", [4, 5, 9, 40])
def test_a_spline_goes_through_its_points_and_is_exact_for_cubics(n):
    u = np.arange(n, dtype=float)
    rng = np.random.default_rng(n)
    points = rng.normal(size=(n, 3))
    np.testing.assert_allclose(Spline.through(points).at(u), points, atol=1e-9)
    cubic = np.stack([np.polyval(rng.normal(size=4), u / n) for _ in range(3)], axis=1)
    fine = np.linspace(0.0, n - 1.0, 50)
    expected = np.stack([np.polyval(np.polyfit(u, column, 3), fine) for column in cubic.T], axis=1)
    np.testing.assert_allclose(Spline.through(cubic).at(fine), expected, atol=1e-8)


@pytest.mark.parametrize("gap", [1e-4, 2e-5])
@pytest.mark.parametrize("deviation", [0.0, 0.05])
def test_very_short_pieces_are_merged(gap: float, deviation: float) -> None:
    """Nearly coincident vertices on a straight line used to give pieces of a microsecond or less."""
    unit = np.array([0.6, 0.8])
    path = Path(np.outer([0.0, 1.0, 1.0 + gap, 1.0 + 2.0 * gap, 2.0], unit))
    limits = _limits([10.0] * 2, [50.0] * 2)
    motion, plain = retime(path, limits, deviation=deviation), retime(Path(path.q[[0, -1]]), limits)
    assert np.diff(motion.t).min() >= _SHORTEST_PIECE
    assert motion.duration == pytest.approx(plain.duration, rel=1e-6)
    assert slowdown(motion, limits) == 1.0
    off = motion.at(np.linspace(0.0, motion.duration, 999)).q @ [0.8, -0.6]
    np.testing.assert_allclose(off, 0.0, atol=1e-9)
    _assert_within_limits(motion, limits)


def test_merging_keeps_both_ends_and_rests() -> None:
    t = np.array([0.0, 4e-6, 8e-6, 0.1, 0.1 + 2e-6, 0.1 + 4e-6, 0.2, 0.2 + 1e-6])
    speeds = np.ones(8)
    speeds[[0, 4, 7]] = 0.0

    def motion(times: np.ndarray) -> _native.TimedCurve:
        s = np.append(0.0, np.cumsum(0.5 * (speeds[:-1] + speeds[1:]) * np.diff(times)))
        slope = np.ones((7, 2, 1))
        return travelled(CurveGrid(s, s[:, None], slope, 0.0 * slope, speeds == 0.0), speeds, np.ones(1), np.ones(1))

    merged = motion(t)
    np.testing.assert_allclose(merged.t, t[[0, 4, 7]], rtol=1e-12)
    np.testing.assert_array_equal(merged.qd[:, 0], speeds[[0, 4, 7]])
    assert len(motion(1e-4 * np.arange(8)).t) == 8


def test_a_restraint_holds_at_the_final_speed() -> None:
    """At half the speed, accelerations are a quarter; the restraint must use the final speed."""
    line = Spline.through(np.linspace([0.0], [2.0], 9))
    limits = _limits([10.0], [100.0])

    def gentle(grid: CurveGrid) -> np.ndarray:
        push = grid.slope[:, 0, 0]  # straight line: zero curvature
        return np.stack([np.stack([way * push, 0.0 * push, 0.0 * push + 1.5], axis=1) for way in (1.0, -1.0)], axis=1)

    for speed in (1.0, 0.5):
        motion = timed(line, limits, ("a",), speed=speed, restraint=gentle)
        assert np.abs(motion.qdd).max() == pytest.approx(1.5, rel=0.01)
        assert motion.duration == pytest.approx(2.0 * np.sqrt(2.0 / 1.5), rel=0.01)


def test_given_accelerations_of_samples_are_used() -> None:
    t = np.linspace(0.0, 1.0, 5)
    said = np.array([[0.0], [0.0], [8.0], [0.0], [0.0]])
    motion = Trajectory(t, np.zeros((5, 1)), np.zeros((5, 1)), said, ("a",))
    assert slowdown(motion, _limits([1.0], [2.0])) == pytest.approx(2.0)


def test_the_last_acceleration_is_that_of_the_last_piece() -> None:
    """Also at an end with curvature: the motion rests there, so curvature adds no acceleration."""
    u = np.linspace(0.0, 1.0, 9)
    points = np.stack([np.cos(3.0 * u), np.sin(3.0 * u)], axis=1)
    motion = timed(Spline.through(points), _limits([2.0] * 2, [5.0] * 2), ("a", "b"))
    assert np.abs(motion.qdd[-1]).max() > 1.0
    np.testing.assert_allclose(motion.qdd[-1], motion.piece_accelerations[1][-1], rtol=0.02, atol=0.05)


@given(share=st.floats(0.0, 1.0), joint=st.integers(0, 2))
def test_a_moving_start_keeps_its_speed_within_limits(share: float, joint: int) -> None:
    limits = _limits([2.0] * 3, [5.0] * 3)
    path = Path(np.array([[0.0] * 3, np.eye(3)[joint], np.eye(3)[joint] + 0.3]))
    speed = 2.0 * share
    trajectory = retime(path, limits, start_speed=speed)
    np.testing.assert_allclose(trajectory.qd[0], speed * np.eye(3)[joint], atol=1e-9)
    state = trajectory.at(np.linspace(0.0, trajectory.duration, 500))
    assert np.abs(state.qd).max() <= 2.0 + 1e-6 and np.abs(state.qdd).max() <= 5.0 + 1e-6
    from_rest = retime(path, limits)
    assert trajectory.duration <= from_rest.duration + 1e-9


def test_too_fast_for_the_path_is_an_error() -> None:
    limits = _limits([2.0] * 2, [5.0] * 2)
    line = Path(np.array([[0.0, 0.0], [0.3, 0.0]]))  # braking from 2 rad/s takes 0.4 rad
    with pytest.raises(RetimingError):
        retime(line, limits, start_speed=2.0)
    assert retime(line, limits, start_speed=1.7).duration == pytest.approx(1.7 / 5.0, rel=0.1)
    with pytest.raises(SettingError, match="start_speed"):
        retime(line, limits, start_speed=-1.0)


@given(first=st.floats(0.0, 1.0), last=st.floats(0.0, 1.0), deviation=st.sampled_from([0.0, 0.1]))
def test_timing_backwards_is_the_mirror_image(first: float, last: float, deviation: float) -> None:
    limits = _limits([2.0] * 3, [5.0] * 3)
    path = Path(np.array([[0.0] * 3, [1.0, 0.2, 0.0], [1.3, 1.4, 0.3], [1.0, 2.4, 0.3]]))
    forward = retime(path, limits, deviation=deviation, start_speed=2.0 * first, end_speed=2.0 * last)
    back = retime(path.reversed(), limits, deviation=deviation, start_speed=2.0 * last, end_speed=2.0 * first)
    np.testing.assert_allclose(np.linalg.norm(forward.qd[[0, -1]], axis=1), [2.0 * first, 2.0 * last], atol=1e-9)
    assert forward.duration == pytest.approx(back.duration, rel=1e-3)
    mirrored = back.reversed()
    t = np.linspace(0.0, forward.duration, 200)
    np.testing.assert_allclose(mirrored.at(np.minimum(t, mirrored.t[-1])).q, forward.at(t).q, atol=2e-3)
    for motion in (forward, mirrored):
        state = motion.at(t * motion.duration / forward.duration)
        assert np.abs(state.qd).max() <= 2.0 + 1e-6 and np.abs(state.qdd).max() <= 5.0 + 1e-6


def test_an_end_speed_needs_a_run_in() -> None:
    limits = _limits([2.0] * 2, [5.0] * 2)
    line = Path(np.array([[0.0, 0.0], [0.3, 0.0]]))  # reaching 2 rad/s takes 0.4 rad
    with pytest.raises(RetimingError, match="at its end"):
        retime(line, limits, end_speed=2.0)
    assert retime(line, limits, end_speed=1.7).duration == pytest.approx(1.7 / 5.0, rel=0.1)
    with pytest.raises(SettingError, match="end_speed"):
        retime(line, limits, end_speed=np.inf)

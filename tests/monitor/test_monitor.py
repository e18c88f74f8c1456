"""The monitor: false alarms at no more than the stated rate, faults noticed and named, missing and late samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planned_tasks import planned

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, ShapeError, UnsupportedError
from graceful_plan.timing.dynamics import RobotDynamics

_DT = 0.01
_SPEED, _TORQUE = 0.01, 0.3  # noise of healthy readings [rad/s, N m]


@pytest.fixture(scope="module")
def motion() -> tuple[gp.Scene, gp.Trajectory]:
    task, trajectory = planned("tabletop_l1", "green_to_blue", iterations=50, speed=0.5)
    return task.scene, trajectory


@pytest.fixture(scope="module")
def torque(motion: tuple[gp.Scene, gp.Trajectory]) -> np.ndarray:
    scene, trajectory = motion
    dynamics, state = RobotDynamics(scene), trajectory.at(times(trajectory))
    return np.array([dynamics(*row) for row in zip(*state, strict=True)])


@pytest.fixture(scope="module")
def limits(motion: tuple[gp.Scene, gp.Trajectory], torque: np.ndarray) -> gp.MonitorLimits:
    return gp.MonitorLimits.fit([healthy(motion, torque, seed) for seed in range(25)])


def times(trajectory: gp.Trajectory) -> np.ndarray:
    return np.arange(float(trajectory.t[0]), float(trajectory.t[-1]), _DT)


def healthy(motion: tuple[gp.Scene, gp.Trajectory], torque: np.ndarray, seed: int) -> gp.MonitorRecord:
    """Readings with noise, of a robot with other masses than its model."""
    scene, trajectory = motion
    rng, t = np.random.default_rng(seed), times(trajectory)
    state = trajectory.at(t)
    return gp.MonitorRecord(
        trajectory=trajectory,
        scene=scene,
        t=t,
        q=state.q + 1e-3 * rng.standard_normal(state.q.shape),
        qd=state.qd + _SPEED * rng.standard_normal(state.q.shape),
        torque=torque * rng.uniform(0.8, 1.2) + _TORQUE * rng.standard_normal(state.q.shape),
        opening=0.03 + 2e-4 * rng.standard_normal(len(t)),
    )


def watched(record: gp.MonitorRecord, limits: gp.MonitorLimits) -> gp.Notice | None:
    """Return the notice of a monitor after all samples of a run."""
    monitor, found = gp.Monitor(record.trajectory, record.scene, limits), None
    columns = (np.asarray(part) for part in (record.q, record.qd, record.torque, record.opening))
    for t, q, qd, force, opening in zip(np.asarray(record.t).tolist(), *columns, strict=True):
        found = monitor.update(t, q, qd, force, float(opening))
    return found


def test_healthy_runs_raise_alarms_at_no_more_than_the_stated_rate(motion, torque, limits):
    assert limits.false_alarms == 1.0
    assert limits.hours == pytest.approx(25 * motion[1].duration / 3600.0, rel=0.05)
    new = [watched(healthy(motion, torque, seed), limits) for seed in range(100, 120)]
    assert [notice for notice in new if notice is not None] == []  # 0.01 expected


def test_more_false_alarms_mean_tighter_limits(motion, torque, limits):
    few, many = limits, gp.MonitorLimits.fit([healthy(motion, torque, seed) for seed in range(25)], false_alarms=100.0)
    for name, limit in few.limit.items():
        assert (limit >= many.limit[name]).all() and (limit >= few.usual[name]).all()
    assert any((limit > many.limit[name]).any() for name, limit in few.limit.items())


def fault(name: str, record: gp.MonitorRecord, onset: float) -> gp.MonitorRecord:
    """Break a healthy run from the onset on; joint 4 if it is a joint."""
    t = np.asarray(record.t)
    parts = {part: np.array(getattr(record, part)) for part in ("q", "qd", "torque", "opening")}
    after, since = t >= onset, np.maximum(t - onset, 0.0)
    first = int(after.argmax())
    if name == "drift":
        parts["q"][:, 3] += 0.2 * since
    elif name == "noise":
        parts["q"][after, 3] += 0.05 * np.random.default_rng(0).standard_normal(int(after.sum()))
    elif name == "stuck":
        parts["q"][after, 3], parts["qd"][after, 3] = parts["q"][first, 3], 0.0
    elif name == "no torque":
        parts["torque"][after, 3] = 0.0
    elif name == "gripper opens":
        parts["opening"] += 0.1 * since
    elif name == "late":  # commands arrive 0.1 s late
        state = record.trajectory.at(np.maximum(t - 0.1, t[0]))
        parts["q"][after], parts["qd"][after] = state.q[after], state.qd[after]
    return replace(record, **parts)


@pytest.mark.parametrize("onset", [0.2, 0.45])
@pytest.mark.parametrize("name", ["drift", "noise", "stuck", "no torque", "gripper opens", "late"])
def test_faults_are_noticed_where_and_when_they_are(motion, torque, limits, name, onset):
    notice = watched(fault(name, healthy(motion, torque, 7), onset), limits)
    assert notice is not None
    assert onset - 0.05 <= notice.since <= notice.time <= onset + 0.25
    assert notice.value > notice.limit
    if name != "late":
        assert notice.where == ("gripper" if name == "gripper opens" else motion[1].joints[3])


def test_the_same_samples_give_the_same_notice(motion, torque, limits):
    record = fault("drift", healthy(motion, torque, 3), 0.3)
    assert watched(record, limits) == watched(record, limits)


def test_a_notice_stays(motion, torque, limits):
    scene, trajectory = motion
    record, monitor = healthy(motion, torque, 3), gp.Monitor(trajectory, scene, limits)
    q, qd, force = (np.asarray(part) for part in (record.q, record.qd, record.torque))
    first = monitor.update(0.0, q[0] + 1.0, qd[0], force[0], 0.03)
    assert first is not None and first is monitor.notice
    assert monitor.update(0.01, q[1], qd[1], force[1], 0.03) is first


@pytest.mark.parametrize("how", ["no sample", "position", "speed", "torque", "opening", "old", "silence"])
def test_missing_and_late_samples_are_noticed_after_the_gap(motion, torque, limits, how):
    scene, trajectory = motion
    record, monitor = healthy(motion, torque, 3), gp.Monitor(trajectory, scene, limits)
    assert _DT < limits.gap < 0.1
    nan, notice, begins, noticed = np.full(7, np.nan), None, 0.2, None
    columns = (np.asarray(part) for part in (record.t, record.q, record.qd, record.torque, record.opening))
    for t, q, qd, force, opening in zip(*columns, strict=True):
        gone = t > begins
        if gone and how == "silence" and t < begins + 0.2:
            continue
        late = gone and how == "old"
        notice = (
            monitor.update(
                float(t),
                None if gone and how == "no sample" else nan if gone and how == "position" else q,
                None if gone and how == "speed" else qd,
                nan if gone and how == "torque" else force,
                float("nan") if gone and how == "opening" else float(opening),
            )
            if not late
            else monitor.update(begins - 0.1, q, qd, force, float(opening)) or monitor.update(float(t), None)
        )
        if notice is not None:
            noticed = t if noticed is None else noticed
    assert notice is not None and (notice.kind, notice.where) == ("missing", "samples")
    assert notice.since == pytest.approx(begins, abs=_DT)
    assert noticed - begins <= (0.25 if how == "silence" else limits.gap + 1.5 * _DT)


def test_single_lost_samples_are_no_alarm(motion, torque, limits):
    scene, trajectory = motion
    record, monitor = healthy(motion, torque, 4), gp.Monitor(trajectory, scene, limits)
    columns = (np.asarray(part) for part in (record.t, record.q, record.qd, record.torque, record.opening))
    for i, (t, q, qd, force, opening) in enumerate(zip(*columns, strict=True)):
        assert monitor.update(float(t), None if i % 10 == 5 else q, qd, force, float(opening)) is None


def test_robots_without_speeds_torques_and_gripper_are_watched_by_positions(motion, torque):
    scene, trajectory = motion
    records = [replace(healthy(motion, torque, i), qd=None, torque=None, opening=None) for i in range(25)]
    limits = gp.MonitorLimits.fit(records)
    assert limits.readings == () and set(limits.limit) == {"position"}
    monitor = gp.Monitor(trajectory, scene, limits)
    assert monitor.update(0.0, trajectory.q[0]) is None
    assert monitor.update(0.01, trajectory.q[0] + 0.2) is not None


def test_misuse_is_refused(motion, torque, limits):
    scene, trajectory = motion
    monitor, q = gp.Monitor(trajectory, scene, limits), trajectory.q[0]
    for bad in ({"q": q[:3]}, {"qd": q[None]}, {"torque": [0.0]}):
        with pytest.raises(ShapeError):
            monitor.update(0.0, **({"q": q} | bad))
    for time in (np.nan, np.inf):
        with pytest.raises(SettingError):
            monitor.update(time, q)
    record = healthy(motion, torque, 0)
    for records in ([], [record], [record] * 20 + [replace(record, torque=None)]):
        with pytest.raises(SettingError):
            gp.MonitorLimits.fit(records)
    for rate in (0.0, -1.0, np.nan):
        with pytest.raises(SettingError):
            gp.MonitorLimits.fit([record] * 25, false_alarms=rate)
    with pytest.raises(ShapeError):
        gp.MonitorLimits.fit([replace(record, q=np.asarray(record.q)[:, :5])] * 25)
    with pytest.raises(SettingError):
        gp.MonitorLimits.fit([replace(record, t=np.asarray(record.t)[::-1])] * 25)
    renamed = gp.Trajectory(trajectory.t, trajectory.q, trajectory.qd, trajectory.qdd, tuple(f"a{i}" for i in range(7)))
    with pytest.raises(SettingError):
        gp.Monitor(renamed, scene, limits)


def test_driving_robots_are_refused(limits):
    scene = gp.load_scene(next(iter(gp.mobile_scenes())))
    still = np.zeros((2, len(scene.joints)))
    trajectory = gp.Trajectory(np.array([0.0, 1.0]), still, still, still, scene.joints)
    with pytest.raises(UnsupportedError):
        gp.Monitor(trajectory, scene, limits)

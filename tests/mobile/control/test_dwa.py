import math
import subprocess
import sys

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.mobile.control.drive_state import DriveState, Surroundings
from graceful_plan.mobile.control.dwa import DWA, seen
from hall import BASE, hall

SCENE = hall()
PATH = np.array([[-4.0, 0.0], [6.0, 0.0]])
NOTHING = Surroundings(np.zeros((0, 7)))


def driven(window, path, around, *, seconds=10.0, start=(-4.0, 0.0, 0.0)):
    """Return the states of a base that follows commands exactly, until it stands."""
    state, period = DriveState(*start, 0.0, 0.0), window.settings.period
    found = [state]
    for k in range(int(seconds / period)):
        seen_now = around(k * period) if callable(around) else around
        v, omega = window.choose(state, path, seen_now).command
        middle = state.yaw + 0.5 * omega * period
        x, y = state.x + v * period * math.cos(middle), state.y + v * period * math.sin(middle)
        state = DriveState(x, y, state.yaw + omega * period, v, omega)
        found.append(state)
    return np.array(found)


def test_on_free_floor_it_is_as_fast_as_it_may_be_and_stops_at_the_end():
    states = driven(DWA().bind(SCENE), PATH, NOTHING)
    assert states[:, 3].max() == pytest.approx(BASE.v_max, rel=0.01)
    np.testing.assert_allclose(states[-1, :2], PATH[-1], atol=0.06)
    assert abs(states[-1, 3]) < 0.02 and np.abs(states[:, 1]).max() < 1e-3


def test_commands_keep_the_limits_of_the_base():
    rng = np.random.default_rng(0)
    window, around = DWA().bind(SCENE), seen(SCENE)
    for _ in range(200):
        v, omega = rng.uniform(-1.0, 2.0), rng.uniform(-2.0, 2.0)
        state = DriveState(rng.uniform(-4, 4), rng.uniform(-1.4, 1.4), rng.uniform(-3, 3), v, omega)
        told = window.choose(state, PATH, around).command
        period = window.settings.period
        assert abs(told.v - v) <= BASE.a_max * period + 1e-9
        if window.choose(state, PATH, around).admissible:
            assert abs(told.omega - omega) <= BASE.alpha_max * period + 1e-9
            lateral = max(BASE.lateral_max, abs(v * omega))
            assert abs(told.v * told.omega) <= lateral + 1e-9
            rims = max(BASE.rim_max, abs(v) + BASE.lever * abs(omega))  # it may exceed the limit initially
            assert abs(told.v) + BASE.lever * abs(told.omega) <= rims * (1 + 1e-6)


def test_best_first_equals_exhaustive_evaluation():
    rng, fewer = np.random.default_rng(1), []
    window, around = DWA(impact=0.1).bind(SCENE), seen(SCENE)
    for _ in range(60):
        state = DriveState(
            rng.uniform(-3, 3), rng.uniform(-1, 1), rng.normal(0, 0.5), rng.uniform(0, 2), rng.normal(0, 0.5)
        )
        one, every = window.choose(state, PATH, around), window.choose(state, PATH, around, every=True)
        assert one.score == pytest.approx(every.score, abs=1e-12) and one.admissible == every.admissible
        fewer.append(one.evaluated / max(every.evaluated, 1))
    assert np.median(fewer) < 0.8


def test_the_base_drives_around_obstacles():
    post = Surroundings.discs([[0.0, 0.05]], 0.1)
    states = driven(DWA().bind(SCENE), PATH, post)
    gap = np.hypot(states[:, 0], states[:, 1] - 0.05) - 0.1
    assert gap.min() > 0.2  # half of the base's width
    np.testing.assert_allclose(states[-1, :2], PATH[-1], atol=0.06)


def test_the_base_stops_before_a_wall_and_reports_it():
    wall = Surroundings([[0.0, 0.0, 1.0, 0.0, 0.1, 30.0, 0.0]])
    states = driven(DWA(horizon=1.5).bind(SCENE), PATH, wall)
    assert states[:, 0].max() < -0.1 - 0.2 and abs(states[-1, 3]) < 0.3
    choice = DWA().bind(SCENE).choose(DriveState(-0.45, 0.0, 0.0, 2.0, 0.0), PATH, wall)
    assert not choice.admissible and choice.command.v == pytest.approx(2.0 - BASE.a_max * 0.05)


def test_the_base_waits_for_a_crossing_pedestrian():
    def walker(t):
        return Surroundings.discs([[0.0, -2.4 + 1.0 * t]], 0.25, velocity=[[0.0, 1.0]])

    states = driven(DWA(impact=0.0).bind(SCENE), PATH, walker, seconds=8.0)
    t = 0.05 * np.arange(len(states))
    gap = np.hypot(states[:, 0], states[:, 1] - (-2.4 + t)) - 0.25
    assert gap.min() > 0.15
    np.testing.assert_allclose(states[-1, :2], PATH[-1], atol=0.1)


def test_only_severe_entities_slow_the_base_down():
    def harm(w):
        person = Surroundings.discs([[0.0, 0.6]], 0.25, severity=[60.0])
        window = DWA(impact=w).bind(SCENE)
        states = driven(window, PATH, person, seconds=14.0)
        chosen = [window.choose(DriveState(*state), PATH, person).impact for state in states]
        return sum(chosen) * window.settings.period, states

    careless, fast = harm(0.0)
    careful, slow = harm(2.0)
    assert np.abs(fast[:, 1]).max() < 0.02 and fast[:, 3].max() > 1.9
    assert careful < 0.5 * careless and slow[-1, 0] > 1.0


def test_no_more_impact_than_is_allowed_where_that_is_possible():
    person = Surroundings.discs([[0.0, 0.75]], 0.25, severity=[60.0])
    window = DWA(impact=0.0, most_impact=1.0).bind(SCENE)
    state = DriveState(-2.5, 0.0, 0.0, 0.5, 0.0)
    for _ in range(120):
        choice = window.choose(state, PATH, person)
        assert choice.impact <= 1.0 + 1e-9 or state.v > choice.command.v
        v, omega = choice.command
        x, y = state.x + 0.05 * v * math.cos(state.yaw), state.y + 0.05 * v * math.sin(state.yaw)
        state = DriveState(x, y, state.yaw + 0.05 * omega, v, omega)


def test_obstacles_and_pedestrians_come_from_the_scene():
    walker = gp.MovingEntity("dog", "pet", size=[0.15, 0.3], t=[0, 4], position=[[0, -1, 0.3], [4, -1, 0.3]])
    scene = SCENE.with_moving(walker)
    around = seen(scene, 1.0)
    np.testing.assert_allclose(around.shape[-1, :2], [1.0, -1.0])
    np.testing.assert_allclose(around.velocity[-1], [1.0, 0.0], atol=1e-9)
    assert around.severity[-1] > 0 and around.entity[-1] == 1 and not around.velocity[:-1].any()
    assert len(seen(scene, static=False).shape) == 1


@pytest.mark.parametrize(
    "change",
    [{"heading": -1.0}, {"horizon": 0.0}, {"period": 2.0}, {"near": 0.0}, {"speeds": 1}, {"most_impact": -1.0}],
)
def test_settings_are_checked(change):
    with pytest.raises(SettingError, match=next(iter(change))):
        DWA(**change)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(SettingError, match="DiffDrive"):
        DWA().bind(hall(None))
    with pytest.raises(ShapeError):
        Surroundings(np.zeros((2, 7)), [0])
    with pytest.raises(SettingError, match="severities"):
        Surroundings(np.zeros((1, 7)), [3], severity=[1.0])


def test_control_needs_no_simulation():
    code = "import sys, graceful_plan.mobile.control.dwa; assert 'failbench' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)

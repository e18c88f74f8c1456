import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError
from graceful_plan.mobile.control.diff_drive_controller import Pivot, Tracking, limited
from graceful_plan.mobile.control.drive_state import DriveCommand, DriveState, Surroundings
from graceful_plan.mobile.control.pure_pursuit import PurePursuit, foot
from hall import BASE

SPEEDS = st.floats(-2, 2), st.floats(-4, 4)


@given(*SPEEDS, *SPEEDS, st.floats(0.01, 0.2))
def test_limiting_clamps_only_values_beyond_the_limits(v, omega, v0, omega0, dt):
    before = limited(DriveCommand(v0, omega0), DriveCommand(v0, omega0), BASE, 10.0)
    told = limited(DriveCommand(v, omega), before, BASE, dt)
    assert abs(told.omega - before.omega) <= BASE.alpha_max * dt + 1e-9
    assert abs(told.v) + BASE.lever * abs(told.omega) <= BASE.rim_max + 1e-9
    again = limited(told, before, BASE, dt)
    np.testing.assert_allclose(again, told, atol=1e-9)


def test_a_rate_that_wheels_cannot_keep_up_with_slows_the_base():
    told = limited(DriveCommand(2.0, 4.0), DriveCommand(2.0, 4.0), BASE, 1.0)
    assert told.omega == 4.0 and told.v == pytest.approx(BASE.rim_max - 4.0 * BASE.lever)


def rolled(controller, wanted, sideways, *, seconds, start, dt=0.02):
    """Drive a base that slips sideways in turns; return its error each second."""
    state, off = start, []
    for k in range(int(seconds / dt)):
        aim = wanted(k * dt)
        v, omega = controller.command(state, aim)
        side = -sideways * omega
        c, s = math.cos(state.yaw), math.sin(state.yaw)
        x, y = state.x + dt * (v * c - side * s), state.y + dt * (v * s + side * c)
        state = DriveState(x, y, state.yaw + dt * omega, v, omega)
        off.append(math.hypot(state.x - wanted(k * dt + dt).x, state.y - wanted(k * dt + dt).y))
    return np.array(off)


def circle(t, v=1.0, omega=1.5):
    yaw = omega * t
    return DriveState(v / omega * math.sin(yaw), v / omega * (1 - math.cos(yaw)), yaw, v, omega)


def test_tracking_converges_to_the_motion():
    # The rest is the error of Euler steps: half of it with half the step.
    begins = DriveState(0.05, -0.1, 0.2, 1.0, 1.5)
    off = rolled(Tracking(), circle, 0.0, seconds=4.0, start=begins, dt=0.01)
    assert off[0] > 0.05 and off[-1] < 5e-3


def test_a_base_with_known_slip_stays_on_its_path():
    start = circle(0.0)
    blind = rolled(Tracking(), circle, 0.12, seconds=4.0, start=start)
    aware = rolled(Tracking(pivot=Pivot(still=0.12)), circle, 0.12, seconds=4.0, start=start)
    assert blind[-1] > 0.03 and aware[-1] < 0.3 * blind[-1]


@pytest.mark.parametrize("turns", [-1.0, 1.0])
def test_the_angle_of_a_base_to_its_path_is_limited(turns):
    tracking = Tracking(pivot=Pivot(still=0.04, bend=0.2))
    wanted = DriveState(0.0, 0.0, 0.3, 0.8, 2.5 * turns)  # where its pivot asks for 0.3 rad
    held = DriveState(0.0, 0.0, 0.3 + turns * tracking.slant, 0.8, 2.5 * turns)
    assert tracking.command(held, wanted).omega == pytest.approx(wanted.omega, abs=1e-9)


def test_turning_in_place_about_another_point_is_off_by_less():
    def turn(t):
        return DriveState(0.0, 0.0, 2.0 * t, 0.0, 2.0)

    blind = rolled(Tracking(share=0.0, pivot=Pivot(still=0.04)), turn, 0.04, seconds=1.5, start=turn(0.0))
    aware = rolled(Tracking(pivot=Pivot(still=0.04)), turn, 0.04, seconds=1.5, start=turn(0.0))
    assert aware.max() < 0.85 * blind.max()


def test_pivots_move_ahead_in_bends():
    pivot = Pivot(still=0.04, bend=0.12, acceleration=0.5)
    assert pivot.ahead(0.0, 2.0) == 0.04 and pivot.ahead(1.0, 0.5) == pytest.approx(0.1)
    assert pivot.ahead(-1.0, 0.5) == pytest.approx(-0.02)
    other = Pivot(still=0.04, bend=0.12, acceleration=0.5, back_bend=0.5, back_acceleration=2.0)
    assert other.ahead(1.0, 0.5) == pivot.ahead(1.0, 0.5) and other.ahead(-1.0, 0.5) == pytest.approx(0.04 - 0.1)


def test_pure_pursuit_follows_an_s_and_stops():
    s = np.linspace(0, 8, 200)
    path = np.column_stack([s, 0.6 * np.sin(0.8 * s)])
    state, before, off = DriveState(0.0, 0.0, math.atan(0.48), 0.0, 0.0), DriveCommand(0.0, 0.0), []
    pursuit = PurePursuit(speed=1.0)
    for _ in range(700):
        before = limited(pursuit.command(state, path, BASE), before, BASE, 0.02)
        v, omega = before
        x, y = state.x + 0.02 * v * math.cos(state.yaw), state.y + 0.02 * v * math.sin(state.yaw)
        state = DriveState(x, y, state.yaw + 0.02 * omega, v, omega)
        off.append(foot(path, state)[1])
    assert max(off) < 0.06 and math.hypot(state.x - path[-1, 0], state.y - path[-1, 1]) < 0.05 and abs(state.v) < 0.05


def test_pure_pursuit_turns_round_first():
    command = PurePursuit().command(DriveState(0.0, 0.0, math.pi, 0.0, 0.0), np.array([[0.0, 0.0], [3.0, 0.0]]), BASE)
    assert command.v == 0.0 and abs(command.omega) > 1.0


@pytest.mark.parametrize("make", [lambda: Tracking(k_x=-1.0), lambda: PurePursuit(seconds=0.0)])
def test_settings_are_checked(make):
    with pytest.raises(SettingError):
        make()
    with pytest.raises(SettingError, match="dt"):
        limited(DriveCommand(0, 0), DriveCommand(0, 0), BASE, 0.0)


NAN = float("nan")
HERE, PATH = DriveState(0.0, 0.0, 0.0, 0.0, 0.0), np.array([[0.0, 0.0], [1.0, 0.0]])


@pytest.mark.parametrize(
    ("state", "path"),
    [
        (HERE._replace(x=NAN), PATH), (HERE._replace(omega=math.inf), PATH), (HERE._replace(v=1e200), PATH),
        (HERE, PATH * NAN), (HERE, PATH * 1e300), (HERE, np.zeros((0, 2))),
        (HERE, np.zeros((200_000, 2))),
    ],
)  # fmt: skip
def test_invalid_states_get_no_command(state, path):
    """An error stops the base; comparisons with NaN are false, and the base would drive on."""
    window = gp.DWA().bind(gp.load_scene("hallway"))
    with pytest.raises((ShapeError, NonFiniteError, SettingError), match=r"state|path"):
        PurePursuit().command(state, path, BASE)
    with pytest.raises((ShapeError, NonFiniteError, SettingError), match=r"state|path"):
        window.choose(state, path, Surroundings(np.zeros((0, 7))))


def test_commands_that_are_no_numbers_are_not_limited_to_some():
    for wanted, before in (((NAN, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.0, NAN))):
        with pytest.raises(NonFiniteError, match="wanted and before"):
            limited(DriveCommand(*wanted), DriveCommand(*before), BASE, 0.1)
    with pytest.raises(NonFiniteError, match="state and wanted"):
        Tracking().command(HERE._replace(yaw=NAN), HERE)
    with pytest.raises(SettingError, match=r"Pivot\.acceleration"):
        Pivot(acceleration=0.0)
    with pytest.raises(SettingError, match=r"Pivot\.back_acceleration"):
        Pivot(back_acceleration=-1.0)
    with pytest.raises(SettingError, match=r"Pivot\.bend"):
        Pivot(bend=NAN)


@pytest.mark.parametrize(
    "wrong",
    [
        {"shape": np.zeros((1, 6))}, {"shape": [[1e9, 0, 1, 0, 0.1, 0.1, 0]]}, {"shape": [[1, 0, 5, 0, 0.1, 0.1, 0]]},
        {"shape": [[1, 0, 0, 0, 0.1, 0.1, 0]]}, {"entity": [0.5], "severity": [1.0]}, {"entity": [NAN]},
        {"velocity": [[1e9, 0.0]]}, {"velocity": [[NAN, 0.0]]}, {"entity": [0], "severity": [1e308]},
        {"entity": [0], "severity": [NAN]},
    ],
)  # fmt: skip
def test_surroundings_that_mean_nothing_are_refused(wrong):
    with pytest.raises((ShapeError, NonFiniteError, SettingError)):
        Surroundings(**({"shape": [[1.0, 0.0, 1.0, 0.0, 0.1, 0.1, 0.0]]} | wrong))


def test_discs_that_mean_nothing_are_refused():
    """In particular, an unknown severity must not count as zero."""
    for centre, radius, severity in (
        ([[1.0, 0.0]], 0.2, NAN),
        ([[1.0, 0.0]], [0.1, 0.2], None),
        ([1.0, 0.0, 2.0], 0.1, None),
    ):
        with pytest.raises((ShapeError, NonFiniteError)):
            Surroundings.discs(centre, radius, severity=severity)

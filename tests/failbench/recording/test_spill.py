"""The contents proxy: containers against integrals, losses against statics, flight against ballistics."""

from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motions import Drop, Weaken, execution

from failbench import RolloutRequest, run_rollouts
from failbench.recording.contact_query import ContactQuery
from failbench.recording.puddle import DEPTH, Parcel, Puddles
from failbench.recording.recorder import Recorder
from failbench.recording.spill import VesselMotion, healthy_loss, kept_volume, remaining
from failbench.simulated.world import SimSettings, World, build_world
from graceful_plan import Granular, Liquid, Scene
from graceful_plan.scene.roles import FROM_ABOVE
from graceful_plan.scene.rules.vessel import REPOSE, Vessel, find_vessel

_G = 9.81
_UP = np.array([0.0, 0.0, 1.0])

_WORLD = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm/base" pos="0 -1 .8">
      <geom type="cylinder" size=".05 .05" mass="1"/>
      <body name="arm/upper" pos="0 0 .1">
        <joint name="arm/lift" axis="0 1 0" range="-3 3" armature=".1"/>
        <geom type="capsule" fromto="0 0 0 .5 0 0" size=".03" mass="2"/>
        <site name="arm/tool" pos=".6 0 0"/>
      </body>
    </body>
    <body name="floor"><geom type="plane" size="3 3 .1"/></body>
    <body name="table" pos="0 0 .4"><geom type="box" size=".5 .5 .4"/></body>
    <body name="cat" pos="0.62 0 .1"><geom type="sphere" size=".1"/></body>
    <body name="phone" pos="0.1 0 .805"><freejoint/><geom type="box" size=".04 .08 .005" mass=".2"/></body>
    <body name="lamp" pos="-.35 0 .85"><freejoint/><geom type="cylinder" size=".03 .05" mass=".2"/></body>
    <body name="shelf" pos="-.1 0 .95"><geom type="box" size=".02 .3 .01"/></body>
    <body name="mug" pos="2 2 0">
      <freejoint/>
      <geom name="mug_wall" type="cylinder" size=".045 .05" pos="0 0 .05" mass=".3"/>
      <geom name="mug_ear" type="capsule" size=".007" fromto=".06 0 .02 .06 0 .08" mass=".02"/>
      <geom name="mug_contents" type="cylinder" size=".04 .04" pos="0 0 .05" contype="0" conaffinity="0" mass="0"/>
    </body>
  </worldbody>
  <actuator><position joint="arm/lift" kp="500" kv="50"/></actuator>
</mujoco>
"""

_ENTITIES = {"floor": "floor", "table": "table", "cat": "pet", "phone": "phone", "lamp": "mains", "shelf": "robust"}


def _world(contents: Liquid | Granular | None) -> World:
    scene = Scene.from_mjcf(
        _WORLD,
        robot="arm/",
        tool="arm/tool",
        velocity=[2.0],
        acceleration=[10.0],
        carried="mug",
        X_TO=FROM_ABOVE,
        contents=contents,
        entities=_ENTITIES,
    )
    return build_world(scene, SimSettings(grasp="weld"))


@pytest.fixture(scope="module")
def world() -> World:
    return _world(Liquid(0.3))


def _vessel(radius: float = 0.04, height: float = 0.09, volume: float = 3e-4, repose: float = 0.0) -> Vessel:
    return Vessel(radius=radius, height=height, volume=volume, axis=_UP, p_BR=height * _UP, repose=repose)


# --- containers -------------------------------------------------------------------------------------------------------


@given(st.floats(0.01, 0.2), st.floats(0.01, 0.3), st.floats(0.0, 1.55))
def test_capacity_is_the_volume_below_the_surface(radius: float, height: float, tilt: float) -> None:
    x = np.linspace(-radius, radius, 20001)
    level = np.clip(height - (radius - x) * np.tan(tilt), 0.0, height)
    expected = np.trapezoid(level * 2.0 * np.sqrt(radius**2 - x**2), x)
    full = np.pi * radius**2 * height
    assert _vessel(radius, height).capacity(np.array(tilt)) == pytest.approx(expected, abs=1e-5 * full)


def test_capacity_at_the_ends() -> None:
    tilts = np.linspace(0.0, np.pi, 200)
    kept = _vessel().capacity(tilts)
    assert kept[0] == pytest.approx(np.pi * 0.04**2 * 0.09)
    assert (np.diff(kept) <= 1e-15).all()
    assert (kept[tilts >= np.pi / 2] == 0.0).all()
    dry = _vessel(repose=float(REPOSE)).capacity(tilts)
    assert (dry >= kept).all() and (dry[tilts > np.pi / 2 + REPOSE] == 0.0).all()


def test_the_container_is_found(world: World) -> None:
    vessel = find_vessel(world.scene)
    assert vessel is not None
    assert (vessel.radius, vessel.volume) == pytest.approx((0.04, 3e-4))
    assert vessel.height == pytest.approx(0.09)  # from the bottom of the contents to the wall's top, not the ear's
    np.testing.assert_allclose(vessel.p_BR, [0.0, 0.0, 0.1], atol=1e-12)
    assert find_vessel(_world(None).scene) is None
    dry = find_vessel(_world(Granular(5.0)).scene)
    assert dry is not None and dry.repose == REPOSE
    assert dry.volume == pytest.approx(np.pi * 0.04**2 * 0.09)  # the capacity, less than the given mass


# --- losses -----------------------------------------------------------------------------------------------------------


def _motion(axis: np.ndarray, velocity: np.ndarray, felt: np.ndarray, dt: float = 0.01) -> VesselMotion:
    n = len(velocity)
    return VesselMotion(
        np.arange(n) * dt, np.broadcast_to(axis, (1, n, 3)), np.zeros((1, n, 3)), velocity[None], felt[None]
    )


def _left(vessel: Vessel, motion: VesselMotion, kept: float) -> np.ndarray:
    return remaining(vessel, motion, np.array([kept]), _G)[0]


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_an_accelerated_container_spills_at_the_static_limit(factor: float) -> None:
    """An upright container spills once the slope a/g exceeds freeboard over radius."""
    vessel = _vessel()
    freeboard = vessel.height - vessel.volume / (np.pi * vessel.radius**2)
    a = factor * _G * freeboard / vessel.radius
    felt = np.tile([a, 0.0, _G], (50, 1))
    left = _left(vessel, _motion(_UP, np.zeros((50, 3)), felt), vessel.volume)[-1]
    if factor < 1.0:
        assert left == 1.0
    else:
        middle = vessel.height - vessel.radius * a / _G
        assert left == pytest.approx(middle * np.pi * vessel.radius**2 / vessel.volume)


def test_free_fall_keeps_and_landing_throws_out() -> None:
    vessel = _vessel()
    fall, dt = 30, 0.01
    t = np.arange(60) * dt
    velocity = np.zeros((60, 3))
    velocity[:fall, 2] = -_G * t[:fall]
    felt = np.tile([0.0, 0.0, _G], (60, 1))
    felt[:fall] = 0.0
    left = _left(vessel, _motion(-_UP, velocity, felt), vessel.volume)
    assert (left[: fall - 3] == 1.0).all()  # upside down in free fall: nothing leaves
    upright = _left(vessel, _motion(_UP, velocity, felt), vessel.volume)
    assert upright[-1] == pytest.approx(0.1)
    slow = _left(vessel, _motion(_UP, 0.4 * velocity, np.tile([0.0, 0.0, _G], (60, 1))), vessel.volume)
    assert slow[-1] == pytest.approx(0.7)


@pytest.mark.parametrize("dt", [0.01, 0.002, 0.0005])
def test_a_jolt_throws_out_the_same_at_any_time_step(dt: float) -> None:
    """Stop from 0.8 m/s within 20 ms."""
    t = np.arange(0.0, 0.4, dt)
    velocity = np.outer(np.clip((0.22 - t) / 0.02, 0.0, 1.0), [0.8, 0.0, 0.0])
    felt = np.tile([0.0, 0.0, _G], (len(t), 1))
    left = _left(_vessel(), _motion(_UP, velocity, felt, dt), 3e-4)
    assert left[0] == 1.0
    assert left[-1] == pytest.approx(0.7)


# --- destinations -----------------------------------------------------------------------------------------------------


def _spill(world: World, parcel: Parcel, phone: float = 0.1) -> dict[str, Any]:
    closeup = ContactQuery(world)
    qpos = world.model.qpos0.copy()
    qpos[world.model.jnt_qposadr[world.model.body_jntadr[world.movable["phone"]]]] = phone
    return {event.entity: event for event in Puddles(world, closeup).events(qpos, [parcel])}


def _parcel(position: list[float], velocity: tuple[float, ...] = (0.0, 0.0, 0.0), volume: float = 1e-4) -> Parcel:
    return Parcel(time=0.2, volume=volume, position=np.array(position), velocity=np.array(velocity))


@pytest.mark.long
@given(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.05, 0.6), st.floats(-0.5, 1.0))
def test_contents_land_on_the_ballistic_path(world: World, vx: float, vy: float, height: float, vz: float) -> None:
    flight = (vz + np.sqrt(vz**2 + 2 * _G * height)) / _G
    start = np.array([0.0, 0.35, 0.8]) - [vx * flight, vy * flight, -height]
    events = _spill(world, _parcel(start.tolist(), (vx, vy, vz), 1e-6))
    event = events["table"]
    assert event.time == pytest.approx(0.2 + flight, abs=0.002)
    np.testing.assert_allclose(event.position, [0.0, 0.35, 0.8], atol=0.003)
    assert event.speed == pytest.approx(np.sqrt(vx**2 + vy**2 + vz**2 + 2 * _G * height), rel=0.02)
    assert event.energy == pytest.approx(0.5 * 1e-3 * event.speed**2)
    assert not event.secondary and event.striker == "contents"


def test_a_puddle_reaches_entities_within_its_radius(world: World) -> None:
    start = [0.1, -0.3, 1.0]
    gap = 0.3 - 0.08  # to the edge of the phone
    for volume, reached in ((np.pi * DEPTH * (0.9 * gap) ** 2, False), (np.pi * DEPTH * (1.1 * gap) ** 2, True)):
        events = _spill(world, _parcel(start, volume=volume))
        assert ("phone" in events) == reached
        assert "table" in events and "lamp" not in events and "shelf" not in events
    assert events["phone"].energy == 0.0 and events["phone"].time == events["table"].time


def test_contents_run_over_edges(world: World) -> None:
    """Liquid that runs over the table's edge falls on the cat, and from there on the floor."""
    inside = _spill(world, _parcel([0.3, 0.0, 1.0], volume=np.pi * DEPTH * 0.1**2), phone=-0.3)
    assert set(inside) == {"table"}
    beyond = _spill(world, _parcel([0.45, 0.0, 1.0], volume=np.pi * DEPTH * 0.2**2), phone=-0.3)
    assert set(beyond) == {"table", "cat", "floor"}
    assert beyond["cat"].time > beyond["table"].time
    assert beyond["cat"].speed == pytest.approx(np.sqrt(2 * _G * 0.6), rel=0.05)


def test_dry_contents_lie_in_a_heap() -> None:
    world = _world(Granular(0.3))
    volume = np.pi * np.tan(REPOSE) * 0.2**3 / 3.0  # a cone of 0.2 m
    assert "phone" not in _spill(world, _parcel([0.1, -0.30, 1.0], volume=volume))
    assert "phone" in _spill(world, _parcel([0.1, -0.26, 1.0], volume=volume))


def test_robot_and_container_do_not_stop_contents(world: World) -> None:
    closeup = ContactQuery(world)
    qpos = world.model.qpos0.copy()
    adr = int(world.model.jnt_qposadr[world.model.body_jntadr[world.carried_body]])
    qpos[adr : adr + 3] = [0.3, 0.0, 0.8]
    events = Puddles(world, closeup).events(qpos, [_parcel([0.3, 0.0, 1.2], volume=1e-6)])
    assert [event.entity for event in events] == ["table"]
    assert not Puddles(world, closeup).events(qpos, [_parcel([9.0, 0.0, -1.0])])


# --- a bundled task ---------------------------------------------------------------------------------------------------


def test_coffee_is_lost_by_failures_only() -> None:
    done = execution("desk", "bring_coffee")
    nothing, drop = Weaken(degree="minor", duration=0.002), Drop()
    jobs = [
        RolloutRequest(fault=fault, onset=part * done.duration, seed=0)
        for fault in (nothing, drop)
        for part in (0.2, 0.5, 0.8)
    ]
    rollouts = run_rollouts(done, jobs, horizon=0.6)
    assert [rollout.spilled for rollout in rollouts[:3]] == [0.0] * 3
    assert all(rollout.spilled > 0.8 for rollout in rollouts[3:])
    wet = [[event for event in rollout.events if event.striker == "contents"] for rollout in rollouts]
    assert not any(wet[:3]) and all(wet[3:])
    for rollout, alone in zip(rollouts, (run_rollouts(done, [job], horizon=0.6)[0] for job in jobs), strict=True):
        assert (alone.spilled, alone.events) == (rollout.spilled, rollout.events)


# --- the whole proxy --------------------------------------------------------------------------------------------------


def _fly(
    world: World,
    pose: list[float],
    twist: tuple[float, ...] = (0,) * 6,
    steps: int = 300,
    kept: float | None = None,
) -> dict[str, Any]:
    model = world.model
    data = mujoco.MjData(model)
    data.eq_active[:] = 0
    joint = int(model.body_jntadr[world.carried_body])
    qpos, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    data.qpos[qpos : qpos + 7] = pose
    data.qvel[dof : dof + 6] = twist
    mujoco.mj_forward(model, data)
    there = None if kept is None else np.array([kept])
    recorder = Recorder(world, frozenset(), data.qpos[None].copy(), data.qvel[None].copy(), there)
    rows: list[list[np.ndarray]] = [[], [], []]
    for _ in range(steps):
        mujoco.mj_step(model, data)
        for row, value in zip(rows, (data.sensordata, data.qpos, data.qvel), strict=True):
            row.append(value.copy())
    recorder.observe(*(np.array(row)[None] for row in rows))
    return recorder.finish(0)


def test_a_mug_that_stands_keeps_all_and_a_dropped_one_does_not(world: World) -> None:
    standing = _fly(world, [0.3, 0.2, 0.8, 1, 0, 0, 0])
    assert standing["spilled"] == 0.0
    assert not [event for event in standing["events"] if event.striker == "contents"]
    dropped = _fly(world, [0.3, 0.2, 1.2, 1, 0, 0, 0])
    assert dropped["spilled"] == pytest.approx(0.9, abs=0.1)
    wet = [event for event in dropped["events"] if event.striker == "contents"]
    assert "table" in {event.entity for event in wet}
    assert all(event.time > 0.2 for event in wet)
    tumbling = _fly(world, [0.3, 0.2, 1.2, 1, 0, 0, 0], (0, 0, 0, 6, 0, 0))
    assert tumbling["spilled"] == pytest.approx(1.0)


def test_nothing_spills_without_contents() -> None:
    assert _fly(_world(None), [0.3, 0.2, 1.2, 0, 1, 0, 0], steps=20)["spilled"] == 0.0


def test_a_healthy_run_loses_contents_beyond_the_capacity_of_a_cylinder(world: World) -> None:
    """A healthy robot that tilts by 45 degrees leaves a cylinder's capacity; less tilt loses nothing more."""
    vessel = find_vessel(world.scene)
    assert vessel is not None
    model = world.model
    states = np.zeros((40, 1 + model.nq + model.nv))
    states[:, 1 : 1 + model.nq] = model.qpos0
    adr = 1 + int(model.jnt_qposadr[model.body_jntadr[world.carried_body]])
    angles = np.concatenate([np.linspace(0, np.pi / 4, 20), np.linspace(np.pi / 4, 0, 20)])
    states[:, adr + 3], states[:, adr + 4] = np.cos(angles / 2), np.sin(angles / 2)
    kept = kept_volume(world, states)
    assert kept == pytest.approx(float(vessel.capacity(np.array(np.pi / 4))))
    axis = np.stack([np.zeros(40), -np.sin(angles), np.cos(angles)], axis=1)
    motion = _motion(axis, np.zeros((40, 3)), np.tile([0.0, 0.0, _G], (40, 1)))
    assert _left(vessel, motion, kept)[-1] == pytest.approx(1.0)
    assert _left(vessel, motion, vessel.volume)[-1] == pytest.approx(kept / vessel.volume)
    assert kept_volume(_world(None), states) == 0.0
    assert healthy_loss(_world(None), states) is None
    loss = healthy_loss(world, states)
    assert loss is not None and loss.there == vessel.volume and loss.end == pytest.approx(kept)
    assert loss.kept.shape == (40,) and (np.diff(loss.kept) <= 0.0).all()
    assert loss.part == pytest.approx(1.0 - kept / vessel.volume)
    assert sum(parcel.volume for parcel in loss.parcels) == pytest.approx(vessel.volume - kept)
    times = [parcel.time for parcel in loss.parcels]
    assert times == sorted(times) and 0.0 < times[0] and times[-1] < 0.2  # nothing is lost after the greatest tilt


def test_contents_beyond_the_initial_capacity_do_not_exist(world: World) -> None:
    vessel = find_vessel(world.scene)
    assert vessel is not None
    model = world.model
    states = np.zeros((40, 1 + model.nq + model.nv))
    states[:, 1 : 1 + model.nq] = model.qpos0
    adr = 1 + int(model.jnt_qposadr[model.body_jntadr[world.carried_body]])
    states[:, adr + 3], states[:, adr + 4] = np.cos(np.pi / 8), np.sin(np.pi / 8)
    loss = healthy_loss(world, states)
    assert loss is not None and loss.part == 0.0 and not loss.parcels
    assert loss.there == pytest.approx(float(vessel.capacity(np.array(np.pi / 4)))) == pytest.approx(loss.end)


def test_only_the_contents_at_the_onset_can_be_lost(world: World) -> None:
    """Two mugs fall alike, one of them almost empty."""
    vessel = find_vessel(world.scene)
    assert vessel is not None
    pose = [0.3, 0.2, 1.2, 1.0, 0.0, 0.0, 0.0]
    full, rest, empty = (_fly(world, pose, kept=part * vessel.volume) for part in (1.0, 0.1, 0.0))
    assert full["spilled"] > 0.8 and rest["spilled"] > 0.8 and empty["spilled"] == 0.0
    wet = [[event for event in x["events"] if event.striker == "contents"] for x in (full, rest, empty)]
    assert wet[0] and wet[1] and not wet[2]

"""Recorder against closed forms and a plain loop over MuJoCo's contacts."""

import dataclasses
from collections import defaultdict
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motions import Drop, Weaken, execution

from failbench import RolloutRequest, rollout_steps, run_rollouts
from failbench.recording.final_state import _tilt
from failbench.recording.recorder import Recorder
from failbench.recording.records import ContactEvent
from failbench.recording.secondary import STRIDE
from failbench.simulated.world import SimSettings, World, build_world
from graceful_plan import Scene
from graceful_plan.scene.roles import FROM_ABOVE

_G = 9.81

_WORLD = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="arm/base" pos="0 0 1.6">
      <geom type="cylinder" size=".05 .05" mass="1"/>
      <body name="arm/upper" pos="0 0 .1">
        <joint name="arm/lift" axis="0 1 0" range="-3 3" armature=".1"/>
        <geom type="capsule" fromto="0 0 0 .5 0 0" size=".03" mass="2"/>
        <site name="arm/tool" pos=".6 0 0"/>
      </body>
    </body>
    <body name="shelf" pos=".6 0 .2"><geom type="box" size=".3 .3 .2"/></body>
    <body name="floor"><geom type="plane" size="3 3 .1"/></body>
    <body name="vase" pos=".82 0 .5">
      <freejoint/>
      <geom type="cylinder" size=".03 .1" mass=".4"/>
    </body>
    <body name="cup" pos=".6 .25 .44">
      <freejoint/>
      <geom type="cylinder" size=".03 .04" mass=".2"/>
    </body>
    <body name="ball" pos="2 2 .05">
      <freejoint/>
      <geom name="ball" {shape} mass=".3"/>
    </body>
  </worldbody>
  <actuator><position joint="arm/lift" kp="500" kv="50"/></actuator>
</mujoco>
"""

_ENTITIES = {"shelf": "table", "floor": "floor", "vase": "glass", "cup": "glass"}


def _world(shape: str = 'type="sphere" size=".05"', unnamed: tuple[str, ...] = ()) -> World:
    scene = Scene.from_mjcf(
        _WORLD.format(shape=shape),
        robot="arm/",
        tool="arm/tool",
        velocity=[2.0],
        acceleration=[10.0],
        carried="ball",
        X_TO=FROM_ABOVE,
        entities={name: kind for name, kind in _ENTITIES.items() if name not in unnamed},
    )
    return build_world(scene, SimSettings(grasp="weld"))


@pytest.fixture(scope="module")
def world() -> World:
    return _world()


class _Run(NamedTuple):
    recorder: Recorder
    contacts: dict[tuple[str, str], list[tuple[int, float, np.ndarray]]]
    """By names of the pair: steps, normal forces and force vectors, each summed over contacts."""
    qpos: np.ndarray
    qvel: np.ndarray


def _simulate(
    world: World,
    place: list[float] | None = None,
    velocity: tuple[float, ...] = (0,) * 6,
    *,
    pose: dict[str, list[float]] | None = None,
    steps: int = 400,
    speed: float = 0.0,
    segments: tuple[int, ...] = (400,),
    baseline: frozenset[tuple[str, str]] = frozenset(),
) -> _Run:
    """Let the carried object fly from a place, with recorder and contact loop."""
    model = world.model
    data = mujoco.MjData(model)
    data.eq_active[:] = 0
    for name, at in ({"ball": place or [0.6, 0.0, 3.0]} | (pose or {})).items():
        data.joint(int(model.body_jntadr[model.body(name).id])).qpos[: len(at)] = at
    data.joint("arm/lift").qvel[0] = speed
    dof = int(model.body_dofadr[model.body("ball").id])
    data.qvel[dof : dof + 6] = velocity
    mujoco.mj_forward(model, data)
    recorder = Recorder(world, baseline, data.qpos[None].copy(), data.qvel[None].copy())
    contacts: dict[tuple[str, str], list[tuple[int, float, np.ndarray]]] = defaultdict(list)
    rows: list[list[np.ndarray]] = [[], [], []]
    for step in range(steps):
        mujoco.mj_step(model, data)
        rows[0].append(data.sensordata.copy())
        rows[1].append(data.qpos.copy())
        rows[2].append(data.qvel.copy())
        _read(world.scene, model, data, step, contacts)
    sensordata, qpos, qvel = (np.array(r)[None] for r in rows)
    at = 0
    while at < steps:
        for count in segments:
            part = slice(at, min(at + count, steps))
            recorder.observe(sensordata[:, part], qpos[:, part], qvel[:, part])
            at = part.stop
            if at == steps:
                break
    return _Run(recorder, dict(contacts), qpos[0], qvel[0])


def _read(scene: Scene, model: mujoco.MjModel, data: mujoco.MjData, step: int, contacts: Any) -> None:
    """Read contacts one by one. Pairs of entities are in alphabetical order."""
    owner = {g: name for name in ("body", "carried") for g in scene.components[name].geoms}
    owner |= {g: name for name, entity in scene.entities.items() for g in entity.geoms}
    sums: dict[tuple[str, str], list[np.ndarray]] = defaultdict(list)
    for i in range(data.ncon):
        contact = data.contact[i]
        names = [owner.get(int(g), "") for g in contact.geom]
        local = np.zeros(6)
        mujoco.mj_contactForce(model, data, i, local)
        force = contact.frame.reshape(3, 3).T @ local[:3]
        if names[1] in ("body", "carried") or (names[0] in scene.entities and names[1] < names[0]):
            names, force = names[::-1], -force
        if names[0] != names[1] and names[1] in scene.entities and names[0]:
            sums[names[0], names[1]].append(np.array([local[0], *force]))
    for pair, found in sums.items():
        total = np.sum(found, axis=0)
        contacts[pair].append((step, float(total[0]), total[1:]))


def _events(run: _Run) -> dict[tuple[str, str], ContactEvent]:
    return {(e.striker, e.entity): e for e in run.recorder.finish(0)["events"]}


@pytest.mark.parametrize("height", [0.05, 0.3, 0.8])
def test_a_dropped_ball_against_free_fall(world: World, height: float) -> None:
    run = _simulate(world, [0.6, 0.0, 0.45 + height])
    event = _events(run)["carried", "shelf"]
    dt = world.model.opt.timestep
    assert event.time == pytest.approx(np.sqrt(2 * height / _G), abs=1.5 * dt)
    assert event.speed == pytest.approx(_G * event.time, rel=1e-9)  # semi-implicit: exact
    assert event.speed == pytest.approx(np.sqrt(2 * _G * height), abs=1.5 * dt * _G)
    assert event.energy == pytest.approx(0.5 * 0.3 * event.speed**2, rel=1e-6)
    assert event.position == pytest.approx((0.6, 0.0, 0.4), abs=0.01)
    assert not event.secondary


def test_impulse_is_the_change_of_momentum(world: World) -> None:
    run = _simulate(world, [0.6, 0.0, 0.75])
    event = _events(run)["carried", "shelf"]
    left = 400 * world.model.opt.timestep * _G * 0.3  # impulse of gravity on a ball that ends at rest
    assert event.impulse == pytest.approx(left, rel=0.02)


def test_events_equal_those_of_a_plain_loop() -> None:
    world = _world('type="box" size=".05 .04 .03"')
    run = _simulate(world, [0.66, 0.05, 0.7, 0.9, 0.3, 0.2, 0.1], (0.6, 0.0, -0.5, 1.0, 2.0, 0.5), segments=(1, 7, 50))
    events = _events(run)
    assert {("carried", "shelf"), ("carried", "vase")} <= set(events)
    _check_against(run.contacts, events, world.model.opt.timestep)


def _check_against(contacts: Any, events: Any, dt: float) -> None:
    """Compare primary events with the plain loop's."""
    primary = {pair: event for pair, event in events.items() if not event.secondary}
    assert set(primary) == {pair for pair in contacts if pair[0] in ("body", "carried")}
    for pair, event in primary.items():
        steps, normal, force = zip(*contacts[pair], strict=True)
        size = np.linalg.norm(force, axis=1)
        assert event.time == pytest.approx(steps[0] * dt)
        assert event.impulse == pytest.approx(size.sum() * dt, rel=1e-9)
        # The recorder has one normal per pair: a mean, which is inaccurate for a box in a corner.
        assert event.peak_force == pytest.approx(normal[int(np.argmax(size))], rel=0.1, abs=0.05)


def test_segments_do_not_matter(world: World) -> None:
    runs = [_simulate(world, [0.75, 0.0, 0.9], (0.4, 0, 0, 0, 0, 0), segments=s) for s in ((400,), (1,), (13, 1, 40))]
    fields = [run.recorder.finish(0) for run in runs]
    assert len(fields[0]["events"]) >= 2
    for other in fields[1:]:
        assert other["events"] == fields[0]["events"]


def test_baseline_is_left_out(world: World) -> None:
    run = _simulate(world, [0.6, 0.0, 0.75], baseline=frozenset({("carried", "shelf")}))
    assert ("carried", "shelf") not in _events(run)
    # The hit harms only the object itself.
    counted = _simulate(world, [0.6, 0.0, 0.75])
    assert run.recorder.finish(0)["landings"] == (_events(counted)["carried", "shelf"],)
    assert counted.recorder.finish(0)["landings"] == ()


@pytest.mark.parametrize("unnamed", ["shelf", "floor"])
def test_landings_on_other_bodies_are_recorded(world: World, unnamed: str) -> None:
    place = [0.6, 0.0, 0.75] if unnamed == "shelf" else [1.5, 1.5, 0.4]
    named, without = _simulate(world, place), _simulate(_world(unnamed=(unnamed,)), place)
    expected = dataclasses.replace(_events(named)["carried", unnamed], entity="")
    assert without.recorder.finish(0)["landings"] == (expected,)
    assert {pair for pair in _events(without) if pair[0] == "carried"}.isdisjoint({("carried", unnamed)})
    fallen = place[2] - (0.4 if unnamed == "shelf" else 0.0) - 0.05
    assert expected.energy == pytest.approx(0.3 * _G * fallen, rel=0.1)


def test_an_arm_strikes_with_its_inertia(world: World) -> None:
    """With one joint, the effective mass at the contact is the inertia over the squared lever arm."""
    run = _simulate(world, [2.0, 2.0, 0.05], pose={"cup": [0.45, 0.0, 1.628]}, speed=1.5, steps=30)
    event = _events(run)["body", "cup"]
    before = run.qvel[round(event.time / world.model.opt.timestep) - 1]
    lift, cup = (int(world.model.body(name).dofadr[0]) for name in ("arm/upper", "cup"))
    lever = event.position[0]
    speed = lever * before[lift] - -before[cup + 2]
    assert event.speed == pytest.approx(speed, rel=0.01)
    length, mass = 0.5, 2.0
    data = mujoco.MjData(world.model)
    mujoco.mj_forward(world.model, data)
    M = np.zeros((world.model.nv, world.model.nv))
    mujoco.mj_fullM(world.model, data, M)
    assert M[lift, lift] == pytest.approx(mass * length**2 / 3 + 0.1, rel=0.05)
    assert event.energy == pytest.approx(0.5 * M[lift, lift] / lever**2 * speed**2, rel=0.01)


# --- secondary hits ---------------------------------------------------------------------------------------------------


_DOMINO = {"vase": [0.6, 0.0, 0.5], "cup": [0.72, 0.0, 0.44]}


def test_a_knocked_over_vase_hits_the_cup(world: World) -> None:
    run = _simulate(world, [0.5, 0.0, 0.58], (1.5, 0, 0, 0, 0, 0), pose=_DOMINO)
    event = next(e for e in run.recorder.finish(0)["events"] if e.secondary and e.entity == "cup")
    assert event.striker == "vase"
    step = run.contacts["cup", "vase"][0][0]
    assert event.time == pytest.approx(step * world.model.opt.timestep)
    assert event.time > _events(run)["carried", "vase"].time
    # The vase turns about the far edge of its foot, which slides slightly.
    before = run.qvel[step - 1, int(world.model.body_dofadr[world.movable["vase"]]) :][:6]
    assert event.speed == pytest.approx(np.linalg.norm(before[:3]), rel=0.6)
    assert 0.0 < event.energy < 0.5 * 0.4 * float(before[:3] @ before[:3]) + 0.5 * 2e-3 * float(before[3:] @ before[3:])
    assert (event.peak_force, event.impulse) == (0.0, 0.0)


def test_secondary_hits_equal_those_of_a_plain_loop(world: World) -> None:
    for sideways in (-0.3, 0.0, 0.3):
        run = _simulate(world, [0.5, 0.0, 0.56], (1.2, sideways, 0, 0, 0, 0), pose=_DOMINO, steps=500)
        first = {frozenset(pair) for pair, rows in run.contacts.items() if rows[0][0] == 0}
        expected = {
            frozenset(pair)
            for pair, rows in run.contacts.items()
            if pair[0] not in ("body", "carried") and len(rows) >= 2 * STRIDE
        }
        found = {frozenset((e.striker, e.entity)) for e in run.recorder.finish(0)["events"] if e.secondary}
        assert found >= expected - first
        assert found <= {frozenset(pair) for pair in run.contacts} - first


def test_standing_still_is_no_event(world: World) -> None:
    run = _simulate(world, [2.0, 2.0, 0.05], steps=100)
    fields = run.recorder.finish(0)
    assert [(e.striker, e.entity) for e in fields["events"]] == [("carried", "floor")]
    assert fields["fell"] == fields["tipped"] == fields["left_support"] == ()
    assert fields["spilled"] == 0.0
    np.testing.assert_allclose(fields["poses"]["vase"], [1, 0, 0, 0, 0.82, 0, 0.5], atol=1e-3)


# --- aftermath --------------------------------------------------------------------------------------------------------


def test_fell_tipped_and_left_support(world: World) -> None:
    """Knocked over, the vase stays on the shelf though its centre sinks; knocked off, it ends on the floor."""
    fields = _simulate(world, [0.5, 0.0, 0.58], (1.5, 0, 0, 0, 0, 0), pose=_DOMINO, steps=500).recorder.finish(0)
    assert "vase" in fields["tipped"] and "vase" not in fields["fell"]
    assert fields["left_support"] == ()
    over = _simulate(world, [0.6, 0.0, 0.55], (3.0, 0, 0, 0, 0, 0), pose={"vase": [0.88, 0.0, 0.4999]}, steps=500)
    fields = over.recorder.finish(0)
    assert fields["fell"] == fields["left_support"] == ("vase",)
    assert set(fields["poses"]) == {"vase", "cup", "carried"}


@given(st.tuples(*[st.floats(-1, 1)] * 4), st.floats(-3, 3), st.floats(0, 3))
def test_tilt_is_the_angle_of_the_axis(q: tuple[float, ...], yaw: float, tilt: float) -> None:
    start = np.array(q) / np.linalg.norm(q) if np.linalg.norm(q) > 0.1 else np.array([1.0, 0, 0, 0])
    turned, half = np.zeros(4), tilt / 2
    axis = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    mujoco.mju_mulQuat(turned, np.array([np.cos(half), *(np.sin(half) * axis)]), start)
    spun = np.zeros(4)
    mujoco.mju_mulQuat(spun, np.array([np.cos(yaw), 0, 0, np.sin(yaw)]), turned)
    poses = [np.array([[*quat, 0.0, 0.0, 0.0]]) for quat in (start, spun)]
    assert _tilt(*poses)[0] == pytest.approx(tilt, abs=1e-6)


def test_dropped_is_away_from_the_tool_and_out_of_the_fingers(world: World) -> None:
    assert _simulate(world, [0.6, 0.0, 1.7], steps=100).recorder.finish(0)["dropped"]
    assert not _simulate(world, [0.6, 0.0, 1.7], steps=10).recorder.finish(0)["dropped"]


# --- a bundled task ---------------------------------------------------------------------------------------------------


def test_rollouts_on_the_tabletop_equal_a_plain_loop() -> None:
    # A short horizon: sleeping bodies lose their contacts, but sensors keep their values.
    done = execution()
    jobs = [RolloutRequest(fault=Drop(), onset=part * done.duration, seed=0) for part in (0.3, 0.6, 0.9)]
    jobs.append(RolloutRequest(fault=Weaken(degree="critical"), onset=0.5 * done.duration, seed=1))
    touched = 0
    for job, rollout in zip(jobs, run_rollouts(done, jobs, horizon=0.25), strict=True):
        contacts: dict[tuple[str, str], list[tuple[int, float, np.ndarray]]] = defaultdict(list)
        for step, (model, data) in enumerate(rollout_steps(done, job, horizon=0.25)):
            _read(done.world.scene, model, data, step, contacts)
        events = {(e.striker, e.entity): e for e in rollout.events}
        _check_against({pair: rows for pair, rows in contacts.items() if pair not in done.baseline}, events, done.dt)
        touched += len(events)
    assert touched >= 4

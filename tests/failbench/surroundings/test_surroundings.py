"""Signatures of the faults of the surroundings, each against theory or the healthy run."""

from functools import cache

import mujoco
import numpy as np
import pytest
from breaking import healthy_run
from motions import execution

import failbench as fb
import graceful_plan as gp
from failbench.fault.registry import faults, from_document, to_document
from failbench.surroundings.registry import (
    AddedObject,
    BumpedTable,
    DoorOpens,
    HeavierObject,
    PersonWalksIn,
    PushedObject,
    WetFloor,
    disturbances,
    scene_with_intruder,
)
from failbench.testing import check_fault
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError

G, WELD = 9.81, fb.SimSettings(grasp="weld")
ALL = ["pushed_object", "added_object", "bumped_table", "wet_floor", "heavier_object", "person_walks_in", "door_opens"]


@cache
def staged(fault):
    """Execute the usual motion in a scene with the entity that the fault needs."""
    usual = healthy_run()
    return fb.execute(
        usual.trajectory,
        fb.build_world(scene_with_intruder(fault, gp.load_scene("tabletop").tasks["green_to_blue"].scene)),
    )


class Watched:
    """The states of one rollout, a row per step."""

    def __init__(self, fault, done, *, onset=0.5, seed=0, horizon=0.4, prepare=None):
        rows = {"qpos": [], "qvel": [], "mocap": [], "quat": [], "xfrc": []}
        rollout = fb.rollout_steps(done, fb.RolloutRequest(fault=fault, onset=onset, seed=seed), horizon=horizon)
        for step, (model, data) in enumerate(rollout):
            self.model, self.data = model, data
            for name, value in zip(
                rows, (data.qpos, data.qvel, data.mocap_pos, data.mocap_quat, data.xfrc_applied), strict=True
            ):
                rows[name].append(value.copy())
            if prepare is not None and step == 0:
                prepare(model, data)
        self.qpos, self.qvel, self.mocap, self.quat, self.xfrc = (np.array(values) for values in rows.values())
        self.t = done.dt * np.arange(len(self.qpos))  # before each step, like the poses of moving entities
        self.done = done

    def velocity(self, entity):
        body = self.done.world.movable[entity]
        adr = self.model.jnt_dofadr[self.model.body_jntadr[body]]
        return self.qvel[:, adr : adr + 3]


def test_there_are_seven_faults_of_surroundings():
    assert list(disturbances()) == ALL
    assert not set(disturbances()) & set(faults())
    assert {cls.CATEGORY for cls in disturbances().values()} == {"surroundings"}
    with pytest.raises(TypeError):
        disturbances()["mine"] = WetFloor


def test_patterns_exclude_surroundings_unless_named():
    for pattern in ("*", "*/*", "*/*/*", "*/*/*/severe", "tabletop/*"):
        assert {scenario.fault.NAME for scenario in fb.scenarios(pattern)} == set(faults())
    around = fb.scenarios("surroundings/*")
    assert {scenario.fault.NAME for scenario in around} == set(ALL)
    assert {s.fault.NAME for s in fb.scenarios("surroundings/door_opens/*")} == {"door_opens"}
    assert fb.scenarios("tabletop/green_to_blue/wet_floor/minor")[0].fault == WetFloor(degree="minor")
    with pytest.raises(UnknownNameError, match=r"surroundings/\*"):
        fb.scenarios("weather/*")


@pytest.mark.parametrize("name", ALL)
def test_faults_of_surroundings_keep_the_contract(name):
    fault = disturbances()[name]()
    check_fault(fault, staged(fault) if fault.visitor() else healthy_run())
    assert from_document(to_document(fault), disturbances()) == fault
    with pytest.raises(SettingError, match="targets"):
        disturbances()[name](targets=("all",))


@pytest.mark.parametrize("name", ALL)
def test_native_rollouts_are_the_plain_loop(name):
    fault = disturbances()[name](degree="critical")
    done = staged(fault) if fault.visitor() else healthy_run()
    (rollout,) = fb.run_rollouts(done, [fb.RolloutRequest(fault=fault, onset=0.3, seed=2)], horizon=0.3)
    data = Watched(fault, done, onset=0.3, seed=2, horizon=0.3).data
    for entity, body in done.world.movable.items():
        adr = done.world.model.jnt_qposadr[done.world.model.body_jntadr[body]]
        assert np.array_equal(rollout.poses[entity][4:], data.qpos[adr : adr + 3]), entity


@pytest.mark.parametrize("name", ALL)
def test_a_finished_fault_has_no_effect(name):
    fault = disturbances()[name](duration=0.04)
    seen = Watched(fault, staged(fault) if fault.visitor() else healthy_run(), horizon=0.1)
    assert not seen.xfrc[20:].any()
    for field in fault.FIELDS:
        assert np.array_equal(getattr(seen.model, field), getattr(seen.done.world.model, field)), field
    if fault.visitor():
        assert (seen.mocap[:20, 0, 2] > -5.0).all() and (seen.mocap[20:, 0, 2] == -30.0).all()


# --- things ---------------------------------------------------------------------------------------------------------


def test_a_push_gives_its_speed_to_one_thing():
    seen = Watched(PushedObject(degree="moderate", entity="red1"), healthy_run(), horizon=0.1)
    model, body = seen.model, seen.done.world.movable["red1"]
    assert np.linalg.norm(seen.xfrc[0, body]) == pytest.approx(model.body_mass[body] * 1.0 / 0.05)
    assert not seen.xfrc[25:].any()
    # The push acts at the centre of mass; friction takes at most mu g.
    speed = np.linalg.norm(seen.velocity("red1")[24, :2])
    assert 1.0 - 2.0 * G * 0.05 < speed <= 1.05
    others = [np.abs(seen.velocity(name)[:25]).max() for name in seen.done.world.movable if name != "red1"]
    assert sorted(others)[len(others) // 2] < 1e-3  # it may hit a neighbour


def test_pushes_have_random_targets_and_directions():
    bodies, ways = set(), []
    for seed in range(8):
        force = Watched(PushedObject(), healthy_run(), seed=seed, horizon=0.004).xfrc[0]
        (body,) = np.flatnonzero(force.any(axis=1))
        bodies.add(int(body))
        ways.append(np.arctan2(force[body, 1], force[body, 0]))
    assert len(bodies) > 3 and np.ptp(ways) > 2.0
    with pytest.raises(UnknownNameError, match="'ghost'"):
        Watched(PushedObject(entity="ghost"), healthy_run(), horizon=0.004)


def test_a_bump_throws_everything_back_and_then_forth():
    seen = Watched(BumpedTable(degree="severe"), healthy_run(), horizon=0.3)
    for name, body in seen.done.world.movable.items():
        mass = seen.model.body_mass[body]
        assert np.linalg.norm(seen.xfrc[0, body]) == pytest.approx(mass * 1.2 / 0.05), name
        assert seen.xfrc[30, body] == pytest.approx(-seen.xfrc[0, body]), name
        assert not seen.xfrc[50:, body].any()
    speeds = [np.linalg.norm(seen.velocity(name)[:, :2], axis=1) for name in seen.done.world.movable]
    assert np.median([s[24] for s in speeds]) > 0.5  # of 1.2, minus friction and collisions
    assert np.median([s[-1] for s in speeds]) < 0.2


def sliding(fault):
    """Return the deceleration of a sliding object [m/s^2]."""
    done = healthy_run()
    adr = done.world.model.jnt_dofadr[done.world.model.body_jntadr[done.world.movable["red1"]]]

    def push(_, data):
        data.qvel[adr] = 0.3

    seen = Watched(fault, done, horizon=0.05, prepare=push)
    speed = seen.qvel[5:15, adr]
    return -np.polyfit(seen.done.dt * np.arange(len(speed)), speed, 1)[0]


def test_on_a_wet_floor_objects_decelerate_by_the_remaining_friction():
    dry, wet = sliding(PushedObject(entity="white1", degree="minor")), sliding(WetFloor(degree="severe"))
    assert wet == pytest.approx(0.2 * dry, rel=0.15)


def test_fingers_hold_on_a_wet_floor():
    (rollout,) = fb.run_rollouts(
        healthy_run(), [fb.RolloutRequest(fault=WetFloor(degree="critical"), onset=0.2, seed=0)], horizon=0.5
    )
    assert not rollout.dropped


@pytest.mark.parametrize("degree", ["minor", "moderate"])
def test_a_heavier_object_pulls_the_arm_down_by_its_weight_over_the_stiffness(degree):
    done = execution("tabletop", "green_to_blue", WELD)
    late = {"onset": done.duration, "horizon": 2.0}
    heavy = Watched(HeavierObject(degree=degree, when=fb.AtFraction(1.0)), done, **late)
    light = Watched(WetFloor(degree="minor"), done, **late)
    robot, model, data = done.world.robot, heavy.model, heavy.data
    carried = done.world.carried_body
    more = model.body_mass[carried] - done.world.model.body_mass[carried]
    assert more == pytest.approx((HeavierObject(degree=degree).amount - 1.0) * done.world.model.body_mass[carried])
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    tool = int(model.site_bodyid[model.site(done.world.scene.tool).id])
    mujoco.mj_jac(model, data, jacobian, None, data.xipos[carried], tool)
    sag = (light.qpos[-1] - heavy.qpos[-1])[robot.qpos]
    assert robot.kp * sag == pytest.approx(G * more * jacobian[2, robot.dofs], abs=0.03 * G * more)


def test_fingers_lose_a_heavy_object():
    done = execution("tabletop", "green_to_blue", WELD)
    held, lost = (
        fb.run_rollouts(done, [fb.RolloutRequest(fault=HeavierObject(degree=degree), onset=0.3, seed=0)])[0].dropped
        for degree in ("minor", "critical")
    )
    weight = done.world.model.body_mass[done.world.carried_body] * G
    grip = done.world.model.geom_friction[done.world.robot.pads[0], 0] * 70.0
    assert (held, lost) == (grip < 1.5 * weight, grip < 8.0 * weight)
    assert HeavierObject().when == fb.AtFraction(0.0)


def test_an_obstacle_put_in_the_path_is_hit():
    fault = AddedObject(degree="critical", category="glass")
    done = staged(fault)
    rollouts = fb.run_rollouts(done, [fb.RolloutRequest(fault=fault, onset=0.2, seed=0)], horizon=1.0)
    hit = {event.entity for event in rollouts[0].events if not event.secondary}
    assert fault.NAME in hit
    assert done.world.scene.entities[fault.NAME].category == "glass"
    seen = Watched(fault, done, onset=0.2, horizon=1.0)
    place = seen.mocap[0, 0]
    tool = done.world.model.site(done.world.scene.tool).id
    ways = [done.world.scene.data_at(q).site_xpos[tool] for q in done.planned(np.linspace(0.0, done.duration, 200))]
    assert np.linalg.norm(np.array(ways) - place, axis=1).min() < 0.02  # on the tool's path
    assert np.linalg.norm(done.states_tool(5 * done.checkpoint(0.2)) - place) > 0.16  # and still ahead of the tool
    assert np.array_equal(seen.mocap, np.tile(place, (len(seen.mocap), 1, 1)))


def test_no_obstacle_appears_after_the_motion():
    fault = AddedObject()
    assert (Watched(fault, staged(fault), onset=99.0, horizon=0.02).mocap[:, 0, 2] == -30.0).all()


# --- intruders ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", ["minor", "critical"])
def test_a_person_walks_by_at_their_speed(degree):
    fault = PersonWalksIn(degree=degree)
    done = staged(fault)
    seen = Watched(fault, done, horizon=0.4, seed=5)
    way = seen.mocap[:, 0, :2]
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / done.dt
    assert speed == pytest.approx(fault.amount)
    along = (way[-1] - way[0]) / np.linalg.norm(way[-1] - way[0])
    from_tool = way[0] - done.states_tool(5 * done.checkpoint(0.5))[:2]
    assert from_tool @ along == pytest.approx(-1.2, abs=2e-3)
    assert abs(from_tool @ [-along[1], along[0]]) <= 0.402
    assert (seen.mocap[:, 0, 2] == 0.85).all()


def test_a_person_may_set_off_slowly():
    fault = PersonWalksIn(ramp=0.2)
    way = Watched(fault, staged(fault), horizon=0.4).mocap[:, 0, :2]
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / 0.002
    assert speed == pytest.approx(1.5 * np.minimum(1.0, np.arange(1, len(speed) + 1) / 100), abs=1.5 * 5 / 100)


def test_a_person_walking_into_the_robot_is_hit():
    fault = PersonWalksIn(degree="critical", passing=0.0, distance=0.5)
    rollouts = fb.run_rollouts(
        staged(fault), [fb.RolloutRequest(fault=fault, onset=0.2, seed=s) for s in range(4)], horizon=0.6
    )
    touched = [{e.striker for e in r.events if e.entity == fault.NAME and not e.secondary} for r in rollouts]
    assert all(touched)
    speeds = [e.speed for r in rollouts for e in r.events if e.entity == fault.NAME and e.striker == "body"]
    assert max(speeds) > 1.0  # they walk at 2.5 m/s, which adds to the impact speed


def test_a_door_turns_about_its_hinge_through_the_tool():
    fault = DoorOpens(degree="severe")
    done = staged(fault)
    seen = Watched(fault, done, horizon=1.0)
    yaw = np.unwrap(2.0 * np.arctan2(seen.quat[:, 0, 3], seen.quat[:, 0, 0]))
    turned = yaw - yaw[0]
    assert turned == pytest.approx(np.minimum(3.0 * seen.t, 0.75 * np.pi), abs=1e-6)
    hinge = seen.mocap[:, 0, :2] - 0.4 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    assert np.ptp(hinge, axis=0) == pytest.approx(0.0, abs=1e-9)
    across = done.states_tool(5 * done.checkpoint(0.5))[:2] - hinge[0]
    assert np.linalg.norm(across) == pytest.approx(0.65, abs=2e-3)
    # After a right angle it is where the tool was.
    later = yaw[0] + np.pi / 2.0
    assert across / np.linalg.norm(across) == pytest.approx([np.cos(later), np.sin(later)], abs=5e-3)


def test_intruders_must_be_in_the_scene():
    with pytest.raises(UnsupportedError, match="failbench"):
        Watched(PersonWalksIn(), healthy_run(), horizon=0.01)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PersonWalksIn(distance=0.0), "distance = 0.0, expected a finite length above 0"),
        (lambda: PersonWalksIn(passing=-0.1), "passing = -0.1, expected a finite length of at least 0"),
        (lambda: DoorOpens(reach=0.9), "0 < reach < width"),
        (lambda: AddedObject(size=float("nan")), "size = nan"),
    ],
)
def test_invalid_settings_are_refused(make, message):
    with pytest.raises(SettingError, match=message):
        make()


@pytest.mark.long
def test_validate_stages_and_scores_them():
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    report = fb.validate(
        healthy_run().trajectory, task.scene, ["surroundings/person_walks_in/critical"], n=8, threads=1
    )
    assert report.by_entity["person_walks_in"].predicted == pytest.approx(0.0, abs=1e-9)  # not predicted
    assert report.observed.mean > 0.0

"""Moving entities as bodies: their poses, their contacts, and people's reactions to a failure."""

from functools import cache

import mujoco
import numpy as np
import pytest
from motions import execution

import failbench as fb
import graceful_plan as gp
from failbench.recording.contact_query import CARRIED, ROBOT, ContactQuery
from failbench.rollouts.healthy_touches import HealthyTouches
from failbench.simulated.moving_entities import EntityPoses, append_entity_states
from graceful_plan.exceptions import SettingError


def walker(name="walker", category="adult", *, x=-0.9, **given):
    settings = {"size": [0.2, 0.85], "t": [0.0, 2.0], "position": [[x, -1.0, 0.85], [x, 1.0, 0.85]]} | given
    return gp.MovingEntity(name, category, **settings)


CAT = walker(
    "cat", "pet", x=-1.2, size=[0.2, 0.1, 0.12], position=[[-1.2, -1.0, 0.12], [-1.2, 1.0, 0.12]], yaw=[0.0, 1.0]
)


@cache
def done(people="walk", spread=0.0, x=-0.9):
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    scene = task.scene.with_moving(walker(spread=spread, growth=spread, x=x), CAT)
    return fb.execute(execution().trajectory, fb.build_world(scene, fb.SimSettings(people=people)))


def job(onset=0.3, seed=0):
    return fb.RolloutRequest(fault=fb.faults()["gripper_failure"](degree="critical"), onset=onset, seed=seed)


def watched(execution, job, horizon=0.4):
    """Return the positions and headings of both in each step."""
    steps = fb.rollout_steps(execution, job, horizon=horizon)
    return np.array([np.hstack([data.mocap_pos, data.mocap_quat]) for _, data in steps])


def test_pedestrians_become_entities_and_other_indices_stay():
    world, still = done().world, execution().world
    assert list(world.scene.entities) == [*still.scene.entities, "walker", "cat"]
    assert world.scene.entities["cat"].category == "pet" and not world.scene.moving
    assert (
        world.scene.entities["walker"].severity
        == gp.load_scene("tabletop").tasks["green_to_blue"].scene.with_moving(walker()).moving_severity["walker"]
    )
    for kind in ("body", "geom", "joint", "actuator"):
        for i in range(
            getattr(still.model, f"n{kind}" if kind != "joint" else "njnt") if kind != "actuator" else still.model.nu
        ):
            assert getattr(still.model, kind)(i).name == getattr(world.model, kind)(i).name
    assert [w.name for w in world.walkers] == ["walker", "cat"] and set(world.movable) == set(still.movable)


def test_pedestrians_follow_their_paths_before_and_after_the_failure():
    onset = 0.3
    seen = watched(done(), job(onset))
    first = done().checkpoint(onset) * 5 * 0.002
    where = walker().at(first + 0.002 * np.arange(len(seen)))
    assert seen[:, 0, :3] == pytest.approx(where.position)
    turned = 2.0 * np.arctan2(seen[:, 1, 6], seen[:, 1, 3])
    assert turned == pytest.approx(CAT.at(first + 0.002 * np.arange(len(seen))).yaw)
    # The healthy run had them at the same place at that time.
    data = mujoco.MjData(done().world.model)
    mujoco.mj_setState(
        done().world.model, data, done().states[done().checkpoint(onset)], mujoco.mjtState.mjSTATE_INTEGRATION
    )
    assert data.mocap_pos[0] == pytest.approx(walker().at(first - 0.002).position, abs=1e-9)


def test_native_rollouts_are_the_plain_loop():
    rollouts = fb.run_rollouts(done(spread=0.1), [job(0.1 * i, seed=i) for i in range(4)], horizon=0.3)
    for rollout in rollouts:
        *_, (model, data) = fb.rollout_steps(done(spread=0.1), rollout.job, horizon=0.3)
        adr = model.jnt_qposadr[model.body_jntadr[done().world.carried_body]]
        assert np.array_equal(rollout.poses["carried"][4:], data.qpos[adr : adr + 3])


def test_deviations_from_the_prediction_have_the_stated_spread():
    walk = [
        EntityPoses(done().world.model, (walker(spread=0.2, growth=0.5), CAT), np.random.default_rng(i))
        for i in range(400)
    ]
    off = np.array([w.rows(np.array([0.0, 1.0]))[:, :2] for w in walk]) - walker().at([0.0, 1.0]).position[:, :2]
    assert off[:, 0].std(axis=0) == pytest.approx(0.2, rel=0.15)
    assert off[:, 1].std(axis=0) == pytest.approx(np.hypot(0.2, 0.5), rel=0.15)
    assert np.array_equal(walk[0].rows(np.array([1.0]))[0, 3:6], CAT.at(1.0).position)  # has no uncertainty


def test_the_same_seed_gives_the_same_walk_and_another_one_another():
    first, same, other = (watched(done(spread=0.1), job(seed=s), 0.02) for s in (1, 1, 2))
    assert np.array_equal(first, same) and not np.array_equal(first, other)


def test_pedestrians_who_would_touch_the_healthy_robot_are_drawn_again():
    """A child with an uncertain place beside the arm: its contacts at the onset are no consequence of a failure."""
    here = execution().trajectory.at(np.array(0.5)).q
    scene = execution().world.scene
    tool = scene.data_at(here).site_xpos[scene.model.site(scene.tool).id]
    near = walker(category="child", size=[0.1, 0.6], t=[0.0], position=[[tool[0], tool[1] - 0.35, 0.6]], spread=0.3)
    moved = gp.load_scene("tabletop").tasks["green_to_blue"].scene.with_moving(near)
    beside = fb.execute(execution().trajectory, fb.build_world(moved))
    assert "walker" not in {entity for _, entity in beside.baseline}
    touched, places = 0, []
    for seed in range(20):
        onset = beside.checkpoint(0.5) * 5
        rows = beside.walk(onset, 50, seed)
        places.append(rows[0, :2])
        plain = EntityPoses(beside.world.model, (near,), np.random.default_rng([seed, 1]))
        touched += not np.array_equal(plain.rows(np.array([0.0]))[0, :2], rows[0, :2])
        query = ContactQuery(beside.world)
        query.place(np.concatenate([beside.states[onset // 5][1 : 1 + beside.world.model.nq], rows[0]]))
        child, owners = list(beside.world.scene.entities).index("walker"), query.owners()
        assert not ((owners == child).any(axis=1) & np.isin(owners, (ROBOT, CARRIED)).any(axis=1)).any()
    assert 0 < touched < 20 and np.std(places, axis=0).min() > 0.1  # the others keep their first draw


def test_touches_are_those_of_all_checkpoints():
    beside = done(spread=0.1, x=-0.7)
    touches, query = HealthyTouches(beside.world, beside.states, frozenset()), ContactQuery(beside.world)
    ids = [list(beside.world.scene.entities).index(name) for name in ("walker", "cat")]
    rng, nq, found = np.random.default_rng(0), beside.world.model.nq, []
    for step in range(0, 60 * 5, 7):
        rows = np.tile(EntityPoses(beside.world.model, beside.world.walkers).rows(np.array([0.5])), (23, 1))
        rows[:, :2], rows[:, 3:5] = rng.uniform(-0.8, 0.8, 2), rng.uniform(-0.8, 0.8, 2)
        meets = False
        for k in range(0, len(rows), 5):
            state = beside.states[min((step + k) // 5, len(beside.states) - 1)]
            query.place(np.concatenate([state[1 : 1 + nq], rows[k]]))
            owners = query.owners()
            meets |= bool((np.isin(owners, ids).any(axis=1) & np.isin(owners, (ROBOT, CARRIED)).any(axis=1)).any())
        assert touches.any(rows, step) == meets
        found.append(meets)
    assert 0 < sum(found) < len(found)


@pytest.mark.parametrize("people", ["stop", "aside"])
def test_people_react_and_cats_do_not(people):
    seen, walks = watched(done(people), job(), 1.2), watched(done("walk"), job(), 1.2)
    assert np.array_equal(seen[:, 1], walks[:, 1])
    assert seen[:200, 0] == pytest.approx(walks[:200, 0], abs=1e-9)  # reaction time 0.4 s
    speed = np.linalg.norm(np.diff(seen[:, 0, :2], axis=0), axis=1) / 0.002
    assert speed[:190] == pytest.approx(1.0)
    tool = done(people).states_tool(150)[:2]
    if people == "stop":
        assert speed[405:] == pytest.approx(0.0, abs=1e-9)  # they stand one step later
        assert seen[-1, 0, 1] - seen[199, 0, 1] == pytest.approx(0.2, abs=0.01)
        assert np.all(np.diff(speed[200:400]) < 1e-9)
    else:
        gone = np.linalg.norm(seen[-1, 0, :2] - tool) - np.linalg.norm(seen[199, 0, :2] - tool)
        assert 0.4 < gone < 0.8 and speed[-20:] == pytest.approx(0.0, abs=1e-9)


def test_reactions_of_people_are_one_of_three():
    with pytest.raises(SettingError, match=r"people = 'fly'.*walk, stop, aside"):
        fb.SimSettings(people="fly")


def test_a_healthy_robot_that_touches_a_pedestrian_is_reported():
    here = execution().trajectory.at(np.array(0.5)).q
    tool = (
        execution().world.scene.data_at(here).site_xpos[execution().world.model.site(execution().world.scene.tool).id]
    )
    # A tiny entity that flies past, which does not stop the arm.
    fly = gp.MovingEntity(
        "fly", "pet", size=[0.01, 0.01, 0.01], t=[0.4, 0.6], position=[tool - [0, 0.3, 0], tool + [0, 0.3, 0]]
    )
    scene = gp.load_scene("tabletop").tasks["green_to_blue"].scene.with_moving(fly)
    touching = fb.execute(execution().trajectory, fb.build_world(scene), tolerance=0.5)
    assert {entity for _, entity in touching.baseline} >= {"fly"}
    assert "fly" in {event.entity for event in touching.healthy.events}
    assert touching.healthy.by_entity["fly"] > 0.0


def test_the_speed_of_pedestrians_adds_to_the_impact_speed():
    qpos, qvel = np.zeros((3, 2)), np.zeros((3, 1))
    rows = np.zeros((4, 7))
    rows[:, 1] = [0.0, 0.002, 0.004, 0.006]
    places, speeds = append_entity_states(qpos, qvel, rows, 0.002)
    assert places.shape == (3, 9) and speeds.shape == (3, 4)
    assert speeds[:, 2] == pytest.approx(1.0) and not speeds[:, [0, 1, 3]].any()


@pytest.mark.long
def test_contents_fall_on_pedestrians():
    task = next(t for t in gp.load_scene("desk").tasks.values() if t.scene.contents is not None)
    motion = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50)
    execution = fb.execute(motion, fb.build_world(task.scene.with_moving(walker(x=-3.0))))
    (rollout,) = fb.run_rollouts(execution, [job(0.5 * execution.duration)], horizon=0.6)
    assert rollout.status == "completed" and rollout.dropped and rollout.spilled > 0.0


def test_validation_predicts_and_observes_them():
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    scene = task.scene.with_moving(walker(x=-0.9))
    report = fb.validate(execution().trajectory, scene, n=8, threads=1)
    assert {"walker"} <= set(report.by_entity)
    expected = gp.evaluate(execution().trajectory, scene, gp.Objective(impact=gp.ImpactCost(model="mixture")))
    assert report.by_entity["walker"].predicted == pytest.approx(
        expected.impact_by_entity["walker"] / report.duration, rel=0.05, abs=1e-6
    )

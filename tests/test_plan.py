"""plan() from the outside: statuses, contracts, unhappy paths."""

import sys
import time
from dataclasses import dataclass

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError, UnknownNameError
from graceful_plan.judge.exact import Judge, first_collision
from graceful_plan.judge.reference_cost import reference_cost
from graceful_plan.query import preparation
from graceful_plan.query.arguments import (
    checked_objective,
    checked_planner,
    checked_seed,
    checked_speed,
    checked_time_limit,
)
from graceful_plan.result import PlanningFailed

_NAMES = sorted(gp.PLANNERS)


def _quick(task, **settings):
    settings = {"iterations": 300, **settings}
    return gp.plan(task.start, task.goal, task.scene, **settings)


# --- results ----------------------------------------------------------------------------------------------------------


def test_a_solved_plan_keeps_its_promises(task):
    result = _quick(task, w=1.0)
    assert result.status is gp.PlanStatus.SOLVED
    trajectory = result.unwrap()
    assert first_collision(trajectory, task.scene) is None
    np.testing.assert_array_equal(trajectory.q[0], task.start)
    np.testing.assert_array_equal(trajectory.q[-1], task.goal[result.goal_index])
    assert result.verdict.passed and {"collision", "goal", "rest"} <= set(result.verdict.checks)
    assert result.cost == gp.evaluate(trajectory, task.scene, gp.Objective(w=1.0))
    assert trajectory.joints == task.scene.joints


def test_long_compile_times_are_reported(task, monkeypatch):
    # The bundled scenes compile within milliseconds.
    monkeypatch.setattr(preparation, "_COMPILED_SOON", 0.0)
    told = gp.plan(task.start, task.goal, task.scene.edit(move={}), time_limit=1e-6)
    assert told.status is gp.PlanStatus.TIMEOUT
    assert told.detail.startswith("compiled for ")
    assert "compiled" not in _quick(task).detail


def test_compiling_counts_against_a_given_time_limit_only(task, monkeypatch):
    monkeypatch.setattr(sys.modules["graceful_plan.query.arguments"], "DEFAULT_TIME_LIMIT", 0.4)
    compiled = preparation.compile_scene
    monkeypatch.setattr(preparation, "compile_scene", lambda scene: time.sleep(0.5) or compiled(scene))
    by_default = gp.plan(task.start, task.goal, task.scene)
    assert by_default.status is gp.PlanStatus.SOLVED
    assert by_default.stats["total_time"] > by_default.stats["compile_time"] >= 0.5
    assert "robot" in by_default.detail
    assert gp.plan(task.start, task.goal, task.scene, time_limit=0.4).status is gp.PlanStatus.TIMEOUT


def test_calls_that_end_before_the_search_have_times_as_well(task):
    for ended in (
        gp.plan(task.start, task.goal, task.scene, cancelled=lambda: True),
        gp.plan(task.start, task.scene.limits.position[:, 1] + 1.0, task.scene),
    ):
        assert ended.status is not gp.PlanStatus.SOLVED or ended.stats["first_motion_time"] > 0.0
        assert ended.stats["total_time"] >= ended.stats["compile_time"] >= 0.0


def test_a_prepared_scene_compiles_nothing_more(task, monkeypatch):
    scene = task.scene.edit(add=[gp.StaticBody(name="crate", kind="box", size=[0.01] * 3, pose=[0.0, 3.0, 1.0])])
    assert set(gp.prepare(scene)) == {"robot", "impact", "constraints", "judge"}

    def refuse(*_):
        raise AssertionError("compiled again")

    monkeypatch.setattr(sys.modules["graceful_plan.core.compile"], "_compiled", refuse)
    assert gp.plan(task.start, task.goal, scene, iterations=300).status is gp.PlanStatus.SOLVED


def test_a_verdict_recomputes_the_cost_of_the_published_model_only(task):
    result = _quick(task, w=1.0, objective=gp.Objective(impact=gp.ImpactCost(model="box_overlap")))
    assert result.verdict.passed and "cost" in result.verdict.checks
    slow = reference_cost(result.trajectory, task.scene)
    assert result.cost.total == pytest.approx(slow.total, rel=0.01)
    assert "cost" not in _quick(task, w=1.0).verdict.checks


def test_the_trace_improves_up_to_the_result(task):
    seen = []
    result = _quick(task, callback=seen.append)
    totals = [point.total for point in result.trace]
    assert totals == sorted(totals, reverse=True) and len(totals) > 1
    assert set(result.trace) <= set(seen) and result.trace[-1] == seen[-1]
    assert result.trace[-1].total == result.cost.total


def test_w_trades_motion_for_impact(task):
    short, safe = _quick(task, w=0.0), _quick(task, w=1.0)
    assert safe.cost.impact < 0.5 * short.cost.impact
    assert safe.cost.motion > short.cost.motion
    assert short.cost.motion == pytest.approx(np.linalg.norm(task.goal - task.start, axis=1).min(), rel=0.2)


@pytest.mark.parametrize("name", _NAMES)
def test_every_planner_solves_a_task(task, name):
    # A T-RRT climbs slowly where the impact has slopes everywhere; by the box model most of the space is flat.
    model = "box_overlap" if name == "trrt" else "mixture"
    objective = gp.Objective(impact=gp.ImpactCost(model=model), w=1.0)
    result = _quick(task, planner=name, objective=objective, iterations=100_000, callback=lambda point: True)
    assert result.status is gp.PlanStatus.SOLVED, result.detail


@pytest.mark.parametrize("name", ["anytime", "rrt_connect", "prm_star"])
def test_iterations_make_it_reproducible(task, name):
    a, b = (_quick(task, planner=name, iterations=60, seed=3) for _ in range(2))
    assert a.status is gp.PlanStatus.SOLVED
    np.testing.assert_array_equal(a.trajectory.q, b.trajectory.q)
    assert a.cost.total == b.cost.total
    assert [point.total for point in a.trace] == [point.total for point in b.trace]
    assert name == "rrt_connect" or len(a.trace) > 1


def test_a_time_limit_besides_iterations_only_ends_them_early(task):
    alone = _quick(task, w=0.3, iterations=40, seed=3)
    limited = _quick(task, w=0.3, iterations=40, seed=3, time_limit=1e300)
    np.testing.assert_array_equal(limited.unwrap().q, alone.unwrap().q)
    ended = gp.plan(task.start, task.goal, task.scene, iterations=10**9, time_limit=0.0)
    assert ended.status is not gp.PlanStatus.SOLVED or ended.stats["iterations"] < 10**9


def test_settings_objects_and_weights_of_objectives(task):
    objective = gp.Objective(w=0.0)
    a = gp.plan(
        task.start, task.goal, task.scene, objective=objective, planner=gp.Anytime(challengers=2), iterations=100
    )
    assert a.cost.w == 0.0
    b = gp.plan(task.start, task.goal, task.scene, 2.0, objective=objective, iterations=100)
    assert b.cost.w == 2.0


@pytest.mark.parametrize("exposure", ["length", "time", pytest.param("waypoints", marks=pytest.mark.long)])
def test_every_exposure_plans(task, exposure):
    result = _quick(task, objective=gp.Objective(exposure=exposure))
    assert result.status is gp.PlanStatus.SOLVED, result.detail


def test_speed_slows_down(task):
    fast, slow = (_quick(task, w=0.0, speed=speed) for speed in (1.0, 0.5))
    assert slow.trajectory.duration == pytest.approx(2.0 * fast.trajectory.duration, rel=0.02)


# --- goals ------------------------------------------------------------------------------------------------------------


def test_keyframes_and_poses(task):
    scene = gp.load_scene("tabletop")
    by_name = gp.plan("lift", "t1_goal", scene, w=0.0, iterations=100)
    assert by_name.status is gp.PlanStatus.SOLVED
    X_WT = scene.data_at(scene.keyframes["t1_goal"]).site(scene.tool)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = X_WT.xmat.reshape(3, 3), X_WT.xpos
    result = gp.plan("lift", gp.PoseGoal(pose), scene, w=0.0, iterations=100)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert result.verdict.checks["goal"].passed


def test_the_cheapest_of_several_goals(task):
    far, near = task.start + [1.0, 0, 0, 0, 0, 0, 0], task.start + [0.02, 0, 0, 0, 0, 0, 0]
    result = gp.plan(task.start, [far, near], task.scene, w=0.0, iterations=100)
    assert result.goal_index == 1


def test_start_is_goal(task):
    result = gp.plan(task.start, task.start, task.scene)
    assert result.status is gp.PlanStatus.SOLVED
    assert result.trajectory.duration == 0.0 and result.cost.total == 0.0


def test_an_object_on_its_support_is_lifted_first():
    task = gp.load_scene("dining_table").tasks["move_bottle"]
    assert gp.clearance(task.start, task.scene) <= 0.0, "the fast checker sees the bottle touch the table"
    result = _quick(task, iterations=60)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    np.testing.assert_array_equal(result.path.q[0], task.start)


# --- unhappy paths ----------------------------------------------------------------------------------------------------


def test_start_in_collision_names_the_pair(task):
    touches = Judge(task.scene).touches(np.random.default_rng(0).uniform(*task.scene.limits.position.T, (200, 7)))
    below = np.random.default_rng(0).uniform(*task.scene.limits.position.T, (200, 7))[next(iter(touches)).sample]
    result = gp.plan(below, task.goal, task.scene)
    assert result.status is gp.PlanStatus.INVALID_START
    assert "mm in" in result.detail
    assert gp.plan(task.start, below, task.scene).status is gp.PlanStatus.INVALID_GOAL


def test_limits_are_clamped_or_refused(task):
    start = task.start.copy()
    start[1] = task.scene.limits.position[1, 1] + 1e-3
    result = gp.plan(start, task.goal, task.scene)
    assert result.status is gp.PlanStatus.INVALID_START and "panda/joint2" in result.detail
    ready = task.scene.keyframes["ready"].copy()
    ready[6] = task.scene.limits.position[6, 0] - 5e-7
    result = gp.plan(ready, task.goal, task.scene, w=0.0, iterations=300)
    assert result.status is gp.PlanStatus.SOLVED and "'panda/joint7'" in result.detail


def test_an_unreachable_pose_says_how_far_it_is(task):
    result = gp.plan(task.start, gp.PoseGoal.at([2.0, 0.0, 0.5], [0, 1, 0, 0]), task.scene, iterations=20)
    assert result.status is gp.PlanStatus.INVALID_GOAL and "pose" in result.detail


_CORRIDOR = """<mujoco><compiler autolimits="true"/>
<custom><numeric name="r/velocity_limit" data="1 1"/><numeric name="r/acceleration_limit" data="1 1"/></custom>
<worldbody><body name="wall" pos="0.5 0 0"><geom type="box" size="0.02 2 1"/></body>
  <body name="r/x"><joint name="x" type="slide" axis="1 0 0" range="-1 2"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body name="r/y"><joint name="y" type="slide" axis="0 1 0" range="-1 1"/><geom size="0.1"/><site name="t"/>
      </body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("name", _NAMES)
def test_an_unreachable_goal_ends_on_time(name):
    scene = gp.Scene.from_mjcf(_CORRIDOR, robot="r/", tool="t")
    started = time.perf_counter()
    result = gp.plan([0.0, 0.0], [1.0, 0.0], scene, planner=name, time_limit=0.05)
    assert result.status is gp.PlanStatus.TIMEOUT and result.trajectory is None
    with pytest.raises(PlanningFailed, match="TIMEOUT"):
        result.unwrap()
    assert time.perf_counter() - started < 10.0, "returns"


@pytest.mark.parametrize("name", _NAMES)
def test_no_budget_is_a_timeout_or_a_verified_path(task, name):
    for settings in ({"time_limit": 0.0}, {"time_limit": None, "iterations": 0}):
        result = _quick(task, planner=name, **settings)
        assert result.status in (gp.PlanStatus.TIMEOUT, gp.PlanStatus.SOLVED)
        assert (result.trajectory is None) == (result.status is gp.PlanStatus.TIMEOUT)


def test_a_cost_that_is_not_finite_is_a_status(task):
    class Nan(gp.Cost):
        def state(self, batch):
            return np.full(len(batch), np.nan)

    result = _quick(task, objective=gp.Objective(impact=Nan()))
    assert result.status is gp.PlanStatus.NONFINITE and "Nan" in result.detail


def test_an_exception_in_a_cost_or_a_callback_reaches_the_caller(task):
    class Broken(gp.Cost):
        def state(self, batch):
            raise RuntimeError("flat battery")

    with pytest.raises(RuntimeError, match="flat battery"):
        _quick(task, objective=gp.Objective(impact=Broken()))

    def interrupt(point):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _quick(task, callback=interrupt)
    assert _quick(task, w=0.0).status is gp.PlanStatus.SOLVED, "nothing is left behind"


def test_a_callback_can_stop_the_search(task):
    calls = []
    result = _quick(task, iterations=10**9, callback=lambda point: calls.append(point) or len(calls) >= 2)
    assert result.status is gp.PlanStatus.SOLVED
    assert len(calls) == 2 and result.stats["iterations"] < 10**6
    assert set(calls) >= set(result.trace[:-1]) and result.trace[-1].total == result.cost.total


def test_two_plans_at_once_are_those_of_their_seeds(task):
    import threading

    results = {}

    def work(seed):
        results[seed] = _quick(task, iterations=60, seed=seed)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed, result in results.items():
        again = _quick(task, iterations=60, seed=seed)
        np.testing.assert_array_equal(result.path.q, again.path.q)
    assert not np.array_equal(results[1].path.q, results[2].path.q)


def test_misuse_names_the_culprit(task):
    q, goal, scene = task.start, task.goal, task.scene
    with pytest.raises(ShapeError, match="start"):
        gp.plan(q[:6], goal, scene)
    with pytest.raises(NonFiniteError, match="start"):
        gp.plan(np.full(7, np.nan), goal, scene)
    with pytest.raises(ShapeError, match="goal"):
        gp.plan(q, np.zeros((2, 3)), scene)
    with pytest.raises(UnknownNameError, match=r"'liftt'.*lift"):
        gp.plan("liftt", goal, scene)
    with pytest.raises(UnknownNameError, match=r"'rrtx'.*rrt_connect"):
        gp.plan(q, goal, scene, planner="rrtx")
    speeds = [("speed", value) for value in (0.0, 1.5, np.nan)]
    for name, value in (("time_limit", -1.0), *speeds, ("iterations", -1)):
        with pytest.raises(SettingError, match=name):
            gp.plan(q, goal, scene, **{name: value})
    with pytest.raises(SettingError, match="speed = 'fast'"):
        checked_speed("fast")
    with pytest.raises(SettingError, match="w = "):
        gp.plan(q, goal, scene, -1.0)


@dataclass(frozen=True)
class Trapped(gp.Cost):
    """A cost that is NaN in a region so small that only dense samples find it."""

    place: float

    def state(self, batch: gp.StateBatch) -> np.ndarray:
        return np.where(np.abs(batch.q[:, 0] - self.place) < 0.003, np.nan, 0.0)


def test_a_cost_that_is_not_finite_somewhere_is_a_status(task):
    scene = task.scene
    start, goal = scene.keyframes["right"], scene.keyframes["near"]
    seen = set()
    for share in np.linspace(0.3, 0.7, 12):
        place = float(start[0] + share * (goal[0] - start[0]))
        objective = gp.Objective(w=0.0, impact=Trapped(place))
        seen.add(gp.plan(start, goal, scene, objective=objective, iterations=50).status)
    assert seen <= {gp.PlanStatus.NONFINITE, gp.PlanStatus.SOLVED} and gp.PlanStatus.NONFINITE in seen


def test_without_an_object_there_is_no_impact():
    scene = gp.load_scene("tabletop")
    result = gp.plan("ready", "lift", scene, w=1.0, iterations=100)
    assert result.status is gp.PlanStatus.SOLVED
    assert result.cost.impact == 0.0
    body = gp.Objective(impact=gp.ImpactCost(model="box_overlap", components=("body",)))
    with_body = gp.plan("ready", "lift", scene, objective=body, iterations=100)
    assert with_body.cost.impact > 0.0


# --- fixed bugs -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", [0.05, 1.5])
def test_a_planner_that_ends_elsewhere_is_not_believed(task, end):
    class Liar(gp.Planner):
        name = "liar"
        anytime = False

        def solve(self, problem, objective, budget, rng):
            budget.spend()
            yield gp.Path(np.stack([problem.start, problem.start + end * (problem.goals[0] - problem.start)]))

    result = _quick(task, planner=Liar(), w=0.0)
    assert result.status is not gp.PlanStatus.SOLVED and result.trajectory is None


def test_a_stopped_search_is_not_taken_up_again(task):
    searches = []

    class Once(gp.Planner):
        name = "once"
        anytime = True

        def solve(self, problem, objective, budget, rng):
            searches.append(problem.margin)
            yield from gp.Anytime().solve(problem, objective, budget, rng)

    _quick(task, planner=Once(), callback=lambda point: True)
    assert len(searches) == 1


@pytest.mark.parametrize("iterations", [10.5, True, "9", -1])
def test_iterations_that_would_never_end_are_refused(iterations):
    with pytest.raises(SettingError, match="iterations"):
        checked_time_limit(None, iterations)


@pytest.mark.parametrize("time_limit", ["1", float("nan"), -1.0, True])
def test_time_limits_that_puzzle_are_refused(time_limit):
    with pytest.raises(SettingError, match="time_limit"):
        checked_time_limit(time_limit, None)


def test_other_arguments_that_puzzle_are_refused():
    for w in ("1", 1e300, float("inf")):
        with pytest.raises(SettingError, match="w = "):
            checked_objective(None, w)
    for seed in (-1, "a", 1.5):
        with pytest.raises(SettingError, match="seed"):
            checked_seed(seed)
    with pytest.raises(SettingError, match="objective"):
        checked_objective(gp.JointLength(), None)
    with pytest.raises(SettingError, match=r"an instance: RRTStar\(\)"):
        checked_planner(gp.RRTStar)


def test_a_planner_class_and_steps_of_zero_are_refused():
    for settings in ({"range": 0.0}, {"spacing": 0.0}, {"range": float("nan")}):
        with pytest.raises(SettingError, match=next(iter(settings))):
            gp.Anytime(**settings)
    with pytest.raises(SettingError, match="range"):
        gp.RRTConnect(range=0.0)


def test_impact_by_entity_survives_in_sums_of_costs(task):
    alone = gp.ImpactCost()
    both = alone + 20.0 * gp.ClearanceCost(distance=0.1)
    motion = _quick(task, w=0.5).trajectory
    plain, summed, scaled = (
        gp.evaluate(motion, task.scene, gp.Objective(impact=impact, w=0.5)) for impact in (alone, both, 3.0 * alone)
    )
    for name, value in plain.impact_by_entity.items():
        assert summed.impact_by_entity[name] == pytest.approx(value)
        assert scaled.impact_by_entity[name] == pytest.approx(3.0 * value)
    assert sum(summed.impact_by_entity.values()) == pytest.approx(summed.impact)
    assert sum(scaled.impact_by_component.values()) == pytest.approx(scaled.impact)
    assert summed.impact_by_entity["ClearanceCost"] == pytest.approx(summed.impact - plain.impact)


def test_printed_results_have_units_and_checks_say_that_they_passed(task):
    result = _quick(task, w=0.5)
    assert result.cost.w == 0.5 and "rad" in str(result) and "severity s" in str(result)
    assert all(str(check).startswith("passed") for check in result.verdict.checks.values())
    assert "inside" in result.verdict.checks["position_limits"].detail
    by_length = gp.evaluate(result.trajectory, task.scene, gp.Objective(exposure="length"))
    assert by_length.impact_unit == "severity rad"


def test_printed_results_are_short_and_name_what_is_harmed_most():
    task = gp.load_scene("desk").tasks["bring_coffee"]
    solved = gp.plan(task.start, task.goal, task.scene, iterations=20)
    worst = max(solved.cost.impact_by_entity, key=lambda name: solved.cost.impact_by_entity[name])
    failed = gp.plan(np.full(7, 9.0), task.goal, task.scene, iterations=1)
    for result, facts in ((solved, (f"{solved.trajectory.duration:.3g} s", worst)), (failed, (failed.detail,))):
        text = str(result)
        assert result.status.name in text and len(text.splitlines()) <= 10 and all(fact in text for fact in facts)
    assert len(repr(solved.trajectory)) < 200 and len(repr(solved.path)) < 100

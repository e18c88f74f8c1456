import dataclasses
import math
import os
import signal
import time
from functools import partial

import numpy as np
import pytest
from bench_cases import own_planner, solved, suite_file

import graceful_plan as gp
from graceful_plan import compare as bench
from graceful_plan.compare.runs import runner, workers
from graceful_plan.compare.runs.comparison import settle
from graceful_plan.compare.runs.measures import FARTHEST, JERK_STEP, exact_clearance, jerk
from graceful_plan.compare.runs.records import EARLY
from graceful_plan.compare.runs.runner import run
from graceful_plan.judge.exact import state_contacts
from sizes import first_quick

# --- jerk and clearance ----------------------------------------------------------------------------------------------


def cubic(duration: float, jerk: float, nq: int = 2) -> gp.Trajectory:
    """Return a motion of the first joint from rest with constant jerk."""
    t = np.linspace(0.0, duration, 2)
    q, qd, qdd = (np.zeros((2, nq)) for _ in range(3))
    q[:, 0], qd[:, 0], qdd[:, 0] = jerk * t**3 / 6.0, jerk * t**2 / 2.0, jerk * t
    return gp.Trajectory(t, q, qd, qdd, tuple(f"joint{i}" for i in range(nq)))


def test_jerk_by_hand():
    steps, value = 50, 3.0
    trajectory = cubic(steps * JERK_STEP, value)
    q = np.concatenate([np.zeros(3), value / 6.0 * (JERK_STEP * np.arange(steps + 1)) ** 3])
    q = np.concatenate([q, np.full(3, q[-1])])
    expected = np.abs(np.diff(q, n=3)) / JERK_STEP**3
    assert jerk(trajectory) == pytest.approx((expected.max(), math.sqrt(np.mean(expected**2))), rel=1e-6)
    # The abrupt stop at the end causes the jerk.
    assert expected.max() > 100.0 * value


def test_jerk_scales_with_the_cube_of_the_pace():
    slow, fast = cubic(4.0, 1.0), cubic(2.0, 8.0)
    inside = [jerk(motion)[0] for motion in (slow, fast)]
    assert inside[1] > inside[0]


def test_rest_has_no_jerk():
    still = gp.Trajectory(np.zeros(1), np.ones((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), ("a", "b", "c"))
    assert jerk(still) == (0.0, 0.0)


def test_clearance_of_a_ball_beside_the_tool():
    scene = gp.load_scene("tabletop_l1")
    q = scene.keyframes["ready"]
    tool = scene.data_at(q).site(scene.tool).xpos
    at = tool + np.array([0.0, 0.0, -0.09])
    with_ball = scene.add_sphere("ball", 0.05, at)
    bigger = scene.add_sphere("ball", 0.06, at)
    path = gp.Path(q[None])
    (near, own), (nearer, _), (without, _) = (exact_clearance(path, s) for s in (with_ball, bigger, scene))
    assert 0.0 < near < without <= FARTHEST
    assert near - nearer == pytest.approx(0.01, abs=1e-4)
    assert own == exact_clearance(path, scene)[1]
    # The covering spheres exceed the robot by less than 1 cm.
    assert -1e-6 <= min(near, own) - gp.clearance(q, with_ball) <= 0.011


def test_clearance_is_negative_in_collision_and_only_then():
    scene = gp.load_scene("desk")
    lower, upper = scene.limits.position.T
    signs = []
    for q in np.random.default_rng(0).uniform(lower, upper, (40, len(lower))):
        touching = bool(state_contacts(q, scene, at_end=False))
        assert (min(exact_clearance(gp.Path(q[None]), scene)) < 0.0) == touching
        signs.append(touching)
    assert 5 < sum(signs) < 35


def test_clearance_of_a_motion_is_the_least_of_its_configurations():
    task = next(iter(gp.load_scene("tabletop").tasks.values()))
    result = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=30)
    trajectory = result.unwrap()
    whole = exact_clearance(trajectory, task.scene)
    some = np.array([exact_clearance(gp.Path(q[None]), task.scene) for q in trajectory.q[::5]])
    assert np.all(np.array(whole) <= some.min(axis=0) + 1e-9)
    assert min(whole) > 0.0


# --- traces ----------------------------------------------------------------------------------------------------------


def test_totals_over_time():
    found = solved("a", "b", 0, 2.0, first=0.01)
    assert found.totals_at([0.0, 0.01, 0.05, 0.1, 9.0]).tolist() == [math.inf, 4.0, 4.0, 2.0, 2.0]
    lost = dataclasses.replace(found, status="TIMEOUT")
    assert lost.totals_at([9.0]).tolist() == [math.inf]


# --- runs ------------------------------------------------------------------------------------------------------------


def jobs(tmp_path, *planners, suite="free_space", **kwargs):
    source = suite if suite in bench.suites() else suite_file(tmp_path, suite)
    return settle(source, planners=planners, seeds=1, **kwargs).jobs


def test_a_task_is_planned_and_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "plan", partial(gp.plan, iterations=300))  # iterations end the search, never the time
    job = jobs(tmp_path, "rrt_connect", suite="tabletop", seconds=60.0)[0]
    found = run(job)
    assert found.status == "SOLVED"
    task = gp.load_scene("tabletop").tasks[job.problem.item]
    trajectory = found.trajectory(task.scene.joints)
    assert trajectory is not None and gp.verify(trajectory, task.scene, start=task.start, goal=task.goal).passed
    assert found.total == pytest.approx(gp.evaluate(trajectory, task.scene, gp.Objective(w=job.w)).total)
    assert found.total == found.trace[-1].total < min((point.total for point in found.trace[:-1]), default=math.inf)
    assert (found.length, found.duration) == (pytest.approx(trajectory.path.length), trajectory.duration)
    assert 0.0 < found.first <= found.trace[0].time <= found.seconds
    assert 0.0 < found.jerk_rms < found.jerk_peak
    assert 0.0 < found.clearance < 1.0
    assert found.certified <= min(found.clearance, found.self_clearance) + 1e-6
    assert found.duration > 0.0 and found.iterations > 0
    assert found.motion_wall > 0.0 and found.motion_cpu > 0.0
    # No path exists before the first path.
    assert [early < math.inf for early in found.early] == [found.first <= at for at in EARLY]


def test_the_straight_line_is_optimal_where_nothing_is_in_the_way(here):
    found = [run(job) for job in jobs(here, own_planner(here), suite="free_space, disc")]
    assert [x.status for x in found] == ["SOLVED", "INFEASIBLE"]
    assert found[0].total == pytest.approx(1.5 * math.sqrt(2.0))
    assert math.isnan(found[0].clearance) and math.isnan(found[0].jerk_peak)
    assert found[0].trajectory(("x", "y")) is None


def test_paths_that_miss_the_goal_do_not_count(here):
    act = "yield Path(np.array([problem.start, problem.start])); return"
    (found,) = [run(job) for job in jobs(here, own_planner(here, act, "liar"))]
    assert (found.status, found.detail, found.total, found.path) == ("INFEASIBLE", "", math.inf, ())


def test_exceptions_are_outcomes(here):
    word = own_planner(here, "raise ZeroDivisionError('oops')", "broken")
    (plane,) = [run(job) for job in jobs(here, word)]
    scene = run(jobs(here, word, suite="tabletop", seconds=0.2)[0])
    for found in (plane, scene):
        assert (found.status, found.detail, found.total) == ("RAISED", "ZeroDivisionError: oops", math.inf)


ADAPTER = """
import numpy as np

def asks(problem):
    assert len(problem.joints) in (0, len(problem.start))
    assert (len(problem.mjcf) > 0) == (len(problem.joints) > 0) and 0.0 < problem.seconds <= 2.0
    s = np.linspace(0.0, 1.0, 50)[:, None]
    q = problem.start + s * (problem.goals[0] - problem.start)
    assert problem.states_free(q).shape == (50,)
    ACT
    return q
"""


@pytest.mark.parametrize(
    ("act", "status", "detail"),
    [
        ("pass", "SOLVED", ""),
        ("return None", "INFEASIBLE", ""),
        ("raise KeyError('cuda')", "RAISED", "KeyError: 'cuda'"),
        ("return q[:, :1]", "RAISED", "ShapeError: the result of asks"),
        ("return q * np.nan", "RAISED", "the result of asks"),
        ("return 'up'", "RAISED", "the result of asks"),
    ],
)
def test_a_function_is_a_planner(here, act, status, detail):
    (here / "library.py").write_text(ADAPTER.replace("ACT", act))
    found = [run(job) for job in jobs(here, "library:asks", suite="free_space")]
    assert {one.status for one in found} == {status}, found[0].detail
    assert all(detail in one.detail for one in found)


def test_paths_of_functions_are_judged(here):
    """A straight line through the boxes between start and goal."""
    (here / "library.py").write_text(ADAPTER.replace("ACT", "pass"))
    (job,) = jobs(here, "library:asks", suite="free_space")
    task = gp.load_scene("tabletop_l3").tasks["green_to_blue"]
    through = np.linspace(task.start, np.atleast_2d(task.goal)[0], 50)
    assert not gp.verify(gp.Path(through), task.scene).passed
    note = dataclasses.replace(job.problem, name="green", kind="task", source="tabletop_l3", item="green_to_blue")
    found = run(dataclasses.replace(job, problem=note))
    assert found.status != "SOLVED" and not math.isfinite(found.total)


def test_any_message_can_be_written(here):
    word = own_planner(here, "raise ValueError('\\udcff' + 'x' * 10_000)", "babbles")
    (found,) = [run(job) for job in jobs(here, word)]
    assert found.detail.encode().startswith(b"ValueError: ?xxx")
    assert len(found.detail) == 1000


def test_planners_take_turns_at_being_first(tmp_path):
    given = jobs(tmp_path, "anytime", "rrt_connect", suite="free_space, disc")
    assert [job.planner.label for job in given] == ["anytime", "rrt_connect", "rrt_connect", "anytime"]
    assert len({job.key for job in given}) == 4


def test_importing_is_not_in_the_time_of_a_run(here):
    # The first call fails; it must not be the recorded one.
    mark = here / "called"
    act = (
        f"import pathlib; mark = pathlib.Path({str(mark)!r}); first = not mark.exists(); mark.touch(); assert not first"
    )
    (found,) = [run(job) for job in jobs(here, own_planner(here, act, "lazy"))]
    assert (found.status, found.detail) == ("SOLVED", "")


# --- workers ---------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_workers_survive_crashing_planners(here):
    died = own_planner(here, "import os; os._exit(3)", "exits")
    crashed = own_planner(here, f"import os; os.kill(os.getpid(), {int(signal.SIGSEGV)})", "crashes")
    good = own_planner(here, name="good")
    found = list(workers.done(jobs(here, died, crashed, good), 1))
    assert [(x.planner, x.status) for x in found] == [(died, "CRASHED"), (crashed, "CRASHED"), (good, "SOLVED")]
    assert found[0].detail == "the process ended with exit code 3"
    assert found[1].detail == "the process ended with SIGSEGV"


def test_output_of_planners_does_not_mix_with_results(here, capfd):
    word = own_planner(here, "print('chatter', flush=True)", "chats")
    (found,) = workers.done(jobs(here, word), 1)
    assert found.status == "SOLVED"
    out, err = capfd.readouterr()
    assert out == "" and "chatter" in err


def test_a_planner_that_never_returns_is_stopped(here, monkeypatch):
    word = own_planner(here, "import time; time.sleep(100)", "hangs")
    monkeypatch.setattr(workers, "TIMES", 0.0)
    (found,) = workers.done(jobs(here, word), 1, patience=1.0)
    assert (found.status, found.detail) == ("HUNG", "was still running long after its time limit of 0.3 s")


def test_loading_a_problem_is_not_in_the_time_of_a_run(tmp_path, monkeypatch):
    (job,) = jobs(tmp_path, "rrt_connect")
    asked = []
    monkeypatch.setattr(runner, "loaded_problem", asked.append)
    runner.load(job)
    assert asked == [job.problem]


def slowly(seconds):
    time.sleep(seconds)


@pytest.mark.long
def test_preparation_has_no_deadline_and_planning_has_one():
    work = workers.Work(do=str, prepare=slowly, allowed=lambda job: 1.0, lost=lambda job, status, detail: status)
    assert list(workers.spread(work, [1.3], 1)) == ["1.3"]
    assert list(workers.spread(dataclasses.replace(work, do=slowly, prepare=abs), [30.0], 1)) == ["HUNG"]


def test_no_jobs_no_workers():
    assert list(workers.done([], 2)) == []


def inverse(x):
    if x == -1:
        os._exit(4)
    return 1.0 / x


@pytest.mark.parametrize("processes", first_quick([0, 2]))
def test_anything_can_be_spread(processes):
    assert sorted(workers.spread(workers.Work(do=inverse), [1, 2, 4], processes)) == [0.25, 0.5, 1.0]
    with pytest.raises(ZeroDivisionError):
        list(workers.spread(workers.Work(do=inverse), [1, 0], processes))
    assert list(workers.spread(workers.Work(do=slowly), [0.0, 0.0], processes)) == [None, None]


@pytest.mark.long
def test_a_lost_job_is_an_error_unless_it_is_an_outcome():
    with pytest.raises(workers.WorkerLostError, match=r"CRASHED: .*exit code 4.* -1"):
        list(workers.spread(workers.Work(do=inverse), [-1], 1))
    work = workers.Work(do=inverse, lost=lambda job, status, detail: (job, status))
    assert sorted(map(str, workers.spread(work, [-1, 2], 1))) == ["(-1, 'CRASHED')", "0.5"]

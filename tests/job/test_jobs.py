"""Whole tasks: laws of the steps, exhaustive search, crossovers in w and in counts, and jobs that are impossible."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from itertools import islice, pairwise

import numpy as np
import pytest
from order_jobs import job_scene, order_job, ordered

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError
from graceful_plan.job.actions import Deed, Hauling, Loading, Transport
from graceful_plan.job.bounds import sequence_bound
from graceful_plan.job.job_planning import JobSession
from graceful_plan.job.job_result import JobFailed, JobStatus
from graceful_plan.job.job_state import JobState, PoseKey, pose_key, pose_of
from graceful_plan.job.motions import JobMotion, Motions, Refusal
from graceful_plan.job.placing import overlapping
from graceful_plan.job.reasons import conflict
from graceful_plan.job.search import Node, SequenceSearch

_GLASS = 0.048
"""Diameter of the glasses of the job with a tray [m]."""
_CAREFUL = 3.0
"""A weight at which the fragile object comes last."""


def _cheapest(search: SequenceSearch, node: Node) -> float:
    """Return the cost of the cheapest sequence by trying all of them, without bounds."""
    if search.is_complete(node.state):
        return node.cost
    children = (search.child(edge) for edge in search.edges(node))
    return min((_cheapest(search, child) for child in children if child is not None), default=np.inf)


def _lid_job() -> gp.Job:
    return gp.Job(job_scene("lid")).place("kettle", at=[0.5, 0.3, 0.4]).allow(gp.CloseLid("kettle", "lid"))


def _clear_job(count: int) -> gp.Job:
    job = gp.Job(job_scene("clear_once")).allow(gp.Clear(name="laptop", on="side_table", n=1))
    for i in range(count):
        job.place(f"mug{i + 1}", at=[0.5, 0.25 + 0.11 * i, 0.4])
    return job


@pytest.mark.parametrize("w", [0.0, _CAREFUL])
def test_every_motion_is_verified_and_begins_where_the_last_one_ended(w: float) -> None:
    result = ordered(w)
    assert result.status is JobStatus.SOLVED and result.exhaustive
    pieces = [piece for step in result.unwrap() for piece in step.pieces]
    np.testing.assert_allclose(pieces[0].trajectory.q[0], job_scene("order").keyframes["ready"])
    for piece, following in pairwise(pieces):
        np.testing.assert_allclose(piece.trajectory.q[-1], following.trajectory.q[0], atol=1e-9)
    for piece in pieces:
        assert gp.verify(piece.trajectory, piece.scene).passed, piece.label
    total = sum(gp.evaluate(p.trajectory, p.scene, gp.Objective(w=w)).total for p in pieces)
    assert result.cost.total == pytest.approx(total, rel=1e-6)
    assert 0.0 < result.lower_bound <= result.cost.total


def test_objects_are_where_they_shall_be_in_what_follows() -> None:
    steps = ordered(_CAREFUL).unwrap()
    for step, goal in zip(steps[1::2], ([0.5, 0.48, 0.4], [0.5, 0.12, 0.4]), strict=True):
        lower = next(piece for piece in step.pieces if piece.label == "lower")
        placed = lower.scene.data_at(lower.trajectory.q[-1]).body(step.name).xpos
        np.testing.assert_allclose(placed, goal, atol=2e-3)
        after = step.pieces[-1].scene
        np.testing.assert_allclose(after.data_at(step.pieces[-1].trajectory.q[-1]).body(step.name).xpos, goal)
        assert step.name in after.entities and after.carried is None


def test_the_fragile_object_comes_last_if_harm_counts() -> None:
    assert ordered(0.0).order == ("dome", "crate")
    careful = ordered(_CAREFUL)
    assert careful.order == ("crate", "dome")
    other = careful.why(order=["dome", "crate"], iterations=20)
    assert other.difference > 0.0 and other.other.order == ("dome", "crate")
    assert other.other.cost.impact_by_entity["dome"] > careful.cost.impact_by_entity["dome"]


@pytest.mark.parametrize("w", [0.0, _CAREFUL])
def test_exhaustive_search_finds_no_cheaper_order(w: float) -> None:
    session = JobSession(order_job(), gp.Objective(w=w), grasps=1)
    search = session.search()
    search.run(lambda _: False)
    assert search.exhausted and search.best is not None
    assert search.best.cost == pytest.approx(_cheapest(search, Node(state=search.start)))
    assert search.lower_bound == pytest.approx(search.best.cost)
    bound = sequence_bound(session.search(), lambda _: False)
    straight = min(search.least(edge) for edge in search.edges(Node(state=search.start)))
    assert straight < bound <= search.best.cost
    assert sequence_bound(session.search(), lambda looked: looked > 1) <= bound


@pytest.mark.long
@pytest.mark.parametrize("job", [_lid_job, lambda: _clear_job(1), lambda: _clear_job(2)], ids=["lid", "one", "two"])
def test_exhaustive_search_finds_nothing_cheaper(job: Callable[[], gp.Job]) -> None:
    search = JobSession(job(), gp.Objective(w=1.0), grasps=2).search()
    search.run(lambda _: False)
    assert search.best is not None
    cheapest = _cheapest(search, Node(state=search.start))
    assert search.best.cost == pytest.approx(cheapest)
    assert sequence_bound(search, lambda _: False) <= cheapest


@pytest.mark.long
def test_the_lid_pays_from_some_weight_on() -> None:
    kinds = [[step.kind for step in gp.plan_job(_lid_job(), w, grasps=3, iterations=60).unwrap()] for w in (0.1, 3.0)]
    assert "close_lid" not in kinds[0] and "close_lid" in kinds[1]


@pytest.mark.long
def test_clearing_once_pays_from_some_count_on() -> None:
    kinds = [[s.kind for s in gp.plan_job(_clear_job(n), 0.3, grasps=1, iterations=24).unwrap()] for n in (1, 3)]
    assert "clear" not in kinds[0] and "clear" in kinds[1]


def test_the_gap_and_the_use_of_time_are_told() -> None:
    result = ordered(_CAREFUL)
    assert 0.0 < result.gap == pytest.approx(1.0 - result.lower_bound / result.cost.total)
    assert gp.plan_job(order_job(), 0.0, grasps=1, iterations=1).gap == np.inf
    names = ("grasps", "stances", "checks", "plan", "search")
    parts = [result.stats[part] for part in names]
    assert min(parts) > 0.0 and sum(parts) == pytest.approx(result.stats["total_time"])
    again = result.why(order=["dome", "crate"], iterations=20).other.stats
    assert min(again[part] for part in names) >= 0.0
    assert sum(again[part] for part in names) == pytest.approx(again["total_time"])


def test_the_bound_of_own_actions_counts_their_own_bound_only() -> None:
    job = order_job().allow(_Cover("dome", job_scene("order").keyframes["ready"] + 0.01))
    search = JobSession(job, gp.Objective(w=_CAREFUL), grasps=1).search()
    straight = min(search.least(edge) for edge in search.edges(Node(state=search.start)))
    assert sequence_bound(search, lambda _: False) <= straight


def test_harm_to_moving_entities_is_not_part_of_the_bound() -> None:
    job = gp.Job(job_scene("person")).place("crate", at=[0.4, 0.4, 0.4])
    search = JobSession(job, gp.Objective(w=30.0), grasps=1).search()
    straight = min(search.least(edge) for edge in search.edges(Node(state=search.start)))
    assert 0.0 < sequence_bound(search, lambda _: False) == pytest.approx(straight)


def _close_glasses(*, apart: float) -> gp.Scene:
    return job_scene("tray").edit(move={"glass1": [0.4, -0.47, 0.4], "glass2": [0.4 + apart, -0.47, 0.4]})


def test_more_grasps_are_drawn_if_a_neighbour_is_in_the_way_of_the_first() -> None:
    job = gp.Job(_close_glasses(apart=0.065)).place("glass1", at=[0.42, 0.35, 0.4])
    search = JobSession(job, gp.Objective(w=0.0), grasps=1).search()
    (first,) = search.edges(Node(state=search.start))
    assert search.child(first) is None and "glass2" in search.refusals["glass1"].why
    result = gp.plan_job(job, 0.0, grasps=1, iterations=4)
    assert result.order == ("glass1",) and result.lower_bound <= result.cost.total


def test_grasps_reach_an_object_and_its_place() -> None:
    search = JobSession(order_job(), gp.Objective(w=0.0), grasps=2).search()
    for goal in search.goals:
        to = goal.poses(search.start)
        found = list(islice(search.motions.grasps(search.start, goal.name, to), 2))
        assert len(found) == 2
        for grasp in found:
            for X in (pose_key(search.start.pose(goal.name)), *to):
                q = search.motions.configuration(search.start, goal.name, grasp, X)
                assert q is not None
                held = search.start.holding(goal.name, grasp)
                np.testing.assert_allclose(held.data_at(q).body(goal.name).xpos, pose_of(X)[:3, 3], atol=2e-3)


def test_the_choices_of_one_grasp_need_no_look_at_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    search = JobSession(order_job(), gp.Objective(w=0.0), grasps=2).search()
    looked_at, configuration = set(), Motions.configuration

    def noted(self: Motions, state: JobState, name: str, grasp: gp.Grasp, X_WO: PoseKey) -> object:
        looked_at.add(id(grasp))
        return configuration(self, state, name, grasp, X_WO)

    monkeypatch.setattr(Motions, "configuration", noted)
    goal = search.goals[0]
    groups = goal.groups(search.start, search.motions)
    (choice,) = next(groups)
    sampled = [id(grasp) for grasp in islice(search.motions.sampled(search.start, goal.name), 8)]
    assert looked_at == set(sampled[: sampled.index(id(choice.grasp)) + 1])
    assert [choice, *next(groups)] == list(islice(goal.candidates(search.start, search.motions), 2))


def test_a_hand_that_collides_is_refused_before_straight_motions_are_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    job = gp.Job(_close_glasses(apart=0.065)).place("glass1", at=[0.42, 0.35, 0.4])
    search = JobSession(job, gp.Objective(w=0.0), grasps=1).search()
    monkeypatch.setattr(Motions, "stance", lambda *_: pytest.fail("a straight motion was planned"))
    (first,) = search.edges(Node(state=search.start))
    assert search.child(first) is None
    assert "in glass2" in search.refusals["glass1"].why


def test_an_object_that_overlaps_another_is_told() -> None:
    job = gp.Job(_close_glasses(apart=0.02)).place("glass1", at=[0.42, 0.35, 0.4])
    result = gp.plan_job(job, 0.0, grasps=1, iterations=4)
    assert (
        result.status is JobStatus.INFEASIBLE and "'glass1'" in result.detail and "overlaps 'glass2'" in result.detail
    )


def test_same_seed_same_result() -> None:
    one, other = ordered(0.0), gp.plan_job(order_job(), 0.0, grasps=1, iterations=40)
    for a, b in zip(one.unwrap(), other.unwrap(), strict=True):
        for first, second in zip(a.pieces, b.pieces, strict=True):
            np.testing.assert_array_equal(first.trajectory.q, second.trajectory.q)


# --- impossible jobs --------------------------------------------------------------------------------------------------


def test_an_object_without_a_grasp_is_named() -> None:
    scene = job_scene("order").add_box("trunk", [0.1, 0.1, 0.1], [0.5, 0.1, 0.5])
    result = gp.plan_job(gp.Job(scene).place("trunk", at=[0.5, 0.3, 0.5]), iterations=20)
    assert result.status is JobStatus.INFEASIBLE and not result.steps and result.cost.total == np.inf
    assert "'trunk'" in result.detail and "grasp" in result.detail
    with pytest.raises(JobFailed, match="trunk"):
        result.unwrap()


def test_what_blocks_a_goal_is_named_with_the_remedy() -> None:
    job = gp.Job(job_scene("order")).place("crate", at=[0.5, -0.45, 0.4])
    result = gp.plan_job(job, 0.0, grasps=1, iterations=20)
    assert result.status is JobStatus.INFEASIBLE and not result.steps
    assert "'crate'" in result.detail and "Clear('dome')" in result.detail


def test_goals_that_block_each_other_are_named_and_clearing_helps() -> None:
    job = gp.Job(job_scene("order")).place("crate", at=[0.5, -0.45, 0.4]).place("dome", at=[0.5, -0.2, 0.4])
    result = gp.plan_job(job, 0.0, grasps=1, iterations=20)
    assert result.status is JobStatus.INFEASIBLE
    assert "'crate' and 'dome' block each other" in result.detail
    solved = gp.plan_job(job.allow(gp.Clear(name="crate", n=4)), 0.0, grasps=1, iterations=20)
    assert [step.kind for step in solved.unwrap()][:2] == ["pick", "clear"] and len(solved.steps) == 6


def test_places_that_overlap_are_told_before_anything_is_planned() -> None:
    job = gp.Job(job_scene("order")).place("crate", at=[0.5, 0.3, 0.4]).place("dome", at=[0.5, 0.36, 0.4])
    result = gp.plan_job(job.allow(gp.Clear("dome")), 0.0, grasps=1, iterations=1)
    assert result.status is JobStatus.INFEASIBLE and result.stats["actions"] == 0
    assert "'crate'" in result.detail and "'dome'" in result.detail


def test_objects_that_touch_at_the_start_may_touch_at_their_places() -> None:
    job = gp.Job(_close_glasses(apart=_GLASS - 0.001))
    job.place("glass1", at=[0.4, 0.3, 0.4]).place("glass2", at=[0.4 + _GLASS - 0.001, 0.3, 0.4])
    search = JobSession(job, gp.Objective(w=0.0), grasps=1).search()
    assert conflict(search) == ""


def test_places_of_objects_that_may_touch_may_overlap() -> None:
    scene = job_scene("order")
    apart = scene.edit(move={"crate": [0.5, 0.3, 0.4], "dome": [0.5, 0.36, 0.4]})
    assert overlapping(apart, ["crate", "dome"]) == ("crate", "dome")
    for when in ("always", "ends"):
        assert (
            overlapping(apart.with_allowed_contacts(gp.AllowedContact("crate", "dome", when)), ["crate", "dome"])
            is None
        )


@pytest.mark.parametrize("gap", [-0.001, 0.0])
def test_objects_that_touch_at_the_start_are_taken_apart(gap: float) -> None:
    job = gp.Job(_close_glasses(apart=_GLASS + gap)).place("glass1", at=[0.42, 0.35, 0.4])
    result = gp.plan_job(job, 0.0, grasps=2, iterations=8)
    assert result.order == ("glass1",), result.detail


def test_a_place_out_of_reach_is_told() -> None:
    result = gp.plan_job(gp.Job(job_scene("order")).place("crate", at=[1.5, 0.0, 0.4]), iterations=20)
    assert result.status is JobStatus.INFEASIBLE and "'crate'" in result.detail and "reach" in result.detail


def test_partial_sequences_are_not_returned() -> None:
    result = gp.plan_job(order_job(), 0.0, grasps=1, iterations=1)
    assert result.status is JobStatus.TIMEOUT and not result.steps
    cancelled = gp.plan_job(order_job(), 0.0, grasps=1, iterations=9, cancelled=lambda: True)
    assert cancelled.status is JobStatus.CANCELLED and not cancelled.steps


def test_misuse_is_named() -> None:
    job = gp.Job(job_scene("order"))
    with pytest.raises(UnknownNameError, match="kettle"):
        job.place("kettle", at=[0.5, 0.0, 0.4])
    with pytest.raises(SettingError, match="either"):
        job.place("crate")
    with pytest.raises(SettingError, match="goal"):
        gp.plan_job(job)
    with pytest.raises(SettingError, match="without a goal"):
        order_job().place("crate", at=[0.5, 0.0, 0.4])
    with pytest.raises(SettingError, match="empty gripper"):
        gp.Job(job_scene("order").attach("crate", X_TO=gp.FROM_ABOVE))


# --- own actions, states ----------------------------------------------------------------------------------------------


class _Cover(gp.Action):
    """Have the arm at a keyframe, where a person covers an entity: it can no longer be harmed."""

    def __init__(self, name: str, at: np.ndarray) -> None:
        self.name, self.at = name, at

    def candidates(self, state: JobState, motions: Motions) -> Iterator[Hashable]:
        if ("covered", self.name) not in state.facts:
            yield "here"

    def motion(self, state: JobState, choice: Hashable, motions: Motions) -> Deed | Refusal:
        piece = motions.planned("transit", self.name, state.scene(), state.q, self.at)
        if isinstance(piece, Refusal):
            return piece
        covered = state.in_world(state.world.with_severity({self.name: 0.0})).knowing("covered", self.name)
        then = covered.after(self.at, piece.trajectory.duration)
        return Deed(steps=[("cover", self.name, [piece])], state=then)


@pytest.mark.long
def test_an_own_action_is_used_if_it_pays() -> None:
    start = job_scene("order").keyframes["ready"]
    job = order_job().allow(_Cover("dome", start + 0.01))
    assert [step.kind for step in gp.plan_job(job, 30.0, grasps=1, iterations=30).unwrap()].count("cover") == 1
    assert [step.kind for step in gp.plan_job(job, 0.0, grasps=1, iterations=30).unwrap()].count("cover") == 0


def test_a_closed_lid_is_part_of_the_vessel_and_keeps_the_contents() -> None:
    scene = job_scene("lid")
    state = JobState(world=scene, q=scene.keyframes["ready"])
    on_top = state.pose("kettle").copy()
    on_top[2, 3] += 0.12
    closed = state.moved("lid", on_top).joined("kettle", "lid").with_contents("kettle", None)
    model = closed.world.model
    assert model.body_subtreemass[model.body("kettle").id] == pytest.approx(0.93)
    assert "lid" not in closed.world.entities and "kettle" in closed.world.entities
    (grasp, *_) = gp.grasps(closed.world, "kettle", n=1)
    assert state.holding("kettle", grasp).contents is not None
    held = closed.holding("kettle", grasp)
    assert held.contents is None
    data = held.data_at(scene.keyframes["ready"])
    X_VL = np.linalg.inv(state.pose("kettle")) @ on_top
    lid, kettle = data.body("lid@joined"), data.body("kettle")
    np.testing.assert_allclose(lid.xpos, kettle.xpos + kettle.xmat.reshape(3, 3) @ X_VL[:3, 3], atol=1e-9)


def test_states_with_equal_surroundings_have_equal_keys() -> None:
    scene = job_scene("order")
    state = JobState(world=scene, q=scene.keyframes["ready"])
    elsewhere = state.moved("crate", np.eye(4))
    assert elsewhere.surroundings != state.surroundings
    assert elsewhere.surroundings == state.moved("crate", np.eye(4)).surroundings
    np.testing.assert_array_equal(elsewhere.pose("crate"), np.eye(4))
    np.testing.assert_allclose(state.pose("crate")[:3, 3], [0.5, -0.2, 0.4])


@pytest.mark.long
def test_the_arm_waits_until_a_person_has_passed() -> None:
    job = gp.Job(job_scene("person")).place("mug", at=[0.6, 0.3, 0.4]).allow(gp.Wait(max_seconds=8.0))
    kinds = [[step.kind for step in gp.plan_job(job, w, grasps=1, iterations=8).unwrap()] for w in (0.0, 3.0)]
    assert kinds[0] == ["pick", "place"] and "wait" in kinds[1]


@pytest.mark.long
@pytest.mark.parametrize("allowed", [(), (gp.Wait(max_seconds=8.0),)], ids=["no wait", "wait"])
def test_other_objects_come_first_while_a_person_stands_at_a_goal(allowed: tuple[gp.Wait, ...]) -> None:
    job = gp.Job(job_scene("person")).place("mug", at=[0.6, 0.3, 0.4])
    job.place("crate", at=[0.4, 0.4, 0.4]).place("box", at=[0.4, 0.2, 0.4]).allow(*allowed)
    careful = gp.plan_job(job, 1.0, grasps=1, iterations=16)
    assert careful.order[0] != "mug" and careful.cost.impact_by_entity["guest"] < 0.01
    if not allowed:
        assert careful.order[-1] == "mug" and len(careful.steps) == 6
        assert gp.plan_job(job, 0.0, grasps=1, iterations=16).order[-1] != "mug"


def _is_at_its_time(piece: JobMotion, scene: gp.Scene, clock: float) -> bool:
    """Tell whether the guest is, in the scene of a piece, where he is some time after the start of the job."""
    times = np.linspace(0.0, piece.trajectory.duration, 5)
    here, there = piece.scene.moving["guest"].at(times), scene.moving["guest"].at(clock + times)
    return np.allclose(here.position, there.position, atol=1e-6)


def test_moving_entities_are_where_they_are_at_the_start_of_each_piece() -> None:
    scene, objective = job_scene("person"), gp.Objective(w=0.0)
    job = gp.Job(scene).place("mug", at=[0.6, 0.3, 0.4])
    search = JobSession(job, objective, grasps=1, speed=0.5).search()
    node = search.child(next(search.edges(Node(state=search.start.after(search.start.q, 2.0)))))
    assert node is not None
    clock = 2.0
    for piece in (piece for _, _, pieces in node.deeds[0].steps for piece in pieces):
        assert _is_at_its_time(piece, scene, clock), piece.label
        again = gp.evaluate(piece.trajectory, piece.scene, objective)
        assert piece.cost.impact == pytest.approx(again.impact)
        clock += piece.trajectory.duration
    assert node.state.clock == pytest.approx(clock) and clock > scene.moving["guest"].t[1]


@pytest.mark.long
def test_moving_entities_keep_to_the_clock_when_motions_are_improved() -> None:
    scene = job_scene("person")
    job = gp.Job(scene).place("mug", at=[0.6, 0.3, 0.4]).place("crate", at=[0.4, 0.4, 0.4])
    result, clock = gp.plan_job(job, 1.0, grasps=1, iterations=4, speed=0.5), 0.0
    for piece in (piece for step in result.unwrap() for piece in step.pieces):
        assert _is_at_its_time(piece, scene, clock), piece.label
        clock += piece.trajectory.duration


def test_nothing_waits_for_moving_entities_that_have_arrived() -> None:
    scene = job_scene("person")
    state, search = JobState(world=scene, q=scene.keyframes["ready"]), JobSession(order_job(), gp.Objective(), grasps=1)
    wait, motions = gp.Wait(max_seconds=4.0), search.search().motions
    assert list(wait.candidates(state, motions)) == [1.0, 2.0, 3.0, 4.0]
    late, later = (state.after(state.q, seconds) for seconds in (8.0, 9.0))
    assert not list(wait.candidates(late, motions))
    assert late.key == later.key and late.key != state.key and late.scene() is later.scene()


def test_a_lid_on_a_vessel_has_not_arrived_elsewhere() -> None:
    scene = job_scene("lid")
    state = JobState(world=scene, q=scene.keyframes["ready"])
    goal = Transport("lid", (pose_key(state.pose("lid")),))
    assert goal.is_done(state)
    assert not goal.is_done(state.joined("kettle", "lid").knowing("joined", "lid"))


# --- trays ------------------------------------------------------------------------------------------------------------


def _on_tray(scene: gp.Scene) -> tuple[JobState, dict[str, PoseKey]]:
    """Return the state with a glass in its slot on the tray, and the slots."""
    state, slot = JobState(world=scene, q=scene.keyframes["ready"]), np.eye(4)
    slot[:3, 3] = [0.0, 0.08, 0.012]
    return state.moved("glass1", state.pose("tray") @ slot), {"glass1": pose_key(slot), "glass2": pose_key(slot)}


def test_a_loaded_tray_is_as_precious_as_all_its_parts() -> None:
    scene = job_scene("tray")
    state, slots = _on_tray(scene)
    assert state.on("tray", slots) == ("glass1",)
    loaded = state.loaded("tray", slots)
    hit = [scene.entities[name].severity["body"] for name in ("tray", "glass1")]
    assert loaded.world.entities["tray"].severity["body"] == sum(hit) and "glass1" not in loaded.world.entities
    grasp = gp.Grasp(X_TO=gp.FROM_ABOVE)
    held = loaded.holding("tray", grasp)
    lost = [state.holding(name, grasp).own_severity for name in ("tray", "glass1")]
    assert held.own_severity == sum(lost) > max(lost)
    mass = [scene.model.body_subtreemass[scene.model.body(name).id] for name in ("tray", "glass1")]
    assert held.model.body_subtreemass[held.model.body("tray").id] == pytest.approx(sum(mass))


def test_an_empty_tray_is_as_it_was() -> None:
    scene = job_scene("tray")
    state = JobState(world=scene, q=scene.keyframes["ready"])
    assert state.loaded("tray", _on_tray(scene)[1]) is state


def test_objects_with_contents_are_not_loaded() -> None:
    job = gp.Job(job_scene("clear_once")).place("mug1", on="laptop").allow(gp.Load("laptop", on="table"))
    with pytest.raises(UnsupportedError, match="contents"):
        gp.plan_job(job, iterations=1)


@pytest.mark.long
def test_a_tray_takes_along_what_stands_on_it() -> None:
    scene = job_scene("tray")
    job = gp.Job(scene).place("tray", at=[0.48, 0.3, 0.4]).place("glass1", on="tray").allow(gp.Load("tray"))
    found = gp.plan_job(job, 0.3, grasps=2, iterations=8)
    result = found.why(order=["glass1", "tray"], iterations=8).other
    assert result.order == ("glass1", "tray")
    carry = next(piece for piece in result.steps[-1].pieces if piece.label == "carry")
    assert {carry.scene.model.body(b).name for b in carry.scene.held_bodies} == {"tray", "glass1@joined"}
    last = result.steps[-1].pieces[-1]
    assert all(gp.verify(piece.trajectory, piece.scene).passed for step in result.steps for piece in step.pieces)
    after = last.scene.data_at(last.trajectory.q[-1])
    np.testing.assert_allclose(after.body("tray").xpos, [0.48, 0.3, 0.4])


@pytest.mark.long
def test_few_actions_compare_a_trip_with_the_tray_and_one_for_each_glass() -> None:
    job = gp.Job(job_scene("tray")).place("tray", at=[0.48, 0.3, 0.4]).allow(gp.Load("tray"))
    job.place("glass1", on="tray").place("glass2", on="tray")
    search = JobSession(job, gp.Objective(w=1.0), grasps=3, speed=0.5).search()
    search.run(lambda planned: planned >= 14)
    names = [node.deeds[0].steps[-1][1] for node in search.complete]
    assert "tray" in names and set(names) - {"tray"}


@pytest.mark.long
def test_a_tray_is_unloaded_if_the_goal_needs_it() -> None:
    scene = job_scene("tray")
    far = gp.Load("tray", in_region=[[0.35, 0.15, 0.35], [0.7, 0.55, 0.45]], n=3)
    job = gp.Job(scene).place("glass1", at=[0.36, 0.1, 0.4]).allow(far)
    search = JobSession(job, gp.Objective(w=0.3), grasps=2).search()
    node = Node(state=search.start)
    for kind in (Loading, Hauling, Transport):
        edges = (edge for edge in search.edges(node) if type(edge.action) is kind)
        node = next(child for edge in edges if (child := search.child(edge)) is not None)
    assert search.is_complete(node.state)
    assert [deed.steps[-1][0] for deed in node.deeds] == ["load", "carry", "place"]
    assert node.state.on("tray", {"glass1": pose_key(np.eye(4))}) == ()

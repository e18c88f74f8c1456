"""Parts of `prevention`: simple costs, harm curves, stored lines, tables."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from benchmarks.prevention import common_sense, figures, runs, tables, work
from benchmarks.prevention.harm_curves import Offer, floored, harm_at, lower_envelope, typical
from benchmarks.prevention.runs import NONE, OURS, PUBLISHED, Curve, CurveJob, Harm, Headline, HeadlineJob, Motion
from benchmarks.subjects import prevention
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from benchmarks import store, suite
from graceful_plan.testing import check_cost
from sizes import first_quick

_EXACT = 1e-9
"""Relative; closed forms agree up to rounding."""

# --- curves ----------------------------------------------------------------------------------------------------------

_OFFERS = st.lists(st.tuples(st.floats(0.5, 3.0), st.floats(1e-3, 1e3)), min_size=1, max_size=12).map(
    lambda pairs: [Offer(*pair) for pair in pairs]
)


def test_the_logarithm_of_harm_is_interpolated_between_offers():
    curve = [Offer(1.0, 8.0), Offer(1.2, 2.0), Offer(1.5, 0.5)]
    assert harm_at(curve, 1.0) == pytest.approx(8.0)
    assert harm_at(curve, 1.1) == pytest.approx(4.0)
    assert harm_at(curve, 1.35) == pytest.approx(1.0)
    assert harm_at(curve, 9.0) == pytest.approx(0.5)
    assert math.isnan(harm_at(curve, 0.9))


def test_dominated_offers_do_not_count():
    curve = [Offer(1.0, 8.0), Offer(1.1, 9.0), Offer(1.2, 2.0), Offer(1.2, 3.0), Offer(1.4, 2.0)]
    assert lower_envelope(curve) == [Offer(1.0, 8.0), Offer(1.2, 2.0)]
    assert harm_at(curve, 1.1) == harm_at([Offer(1.0, 8.0), Offer(1.2, 2.0)], 1.1)


@given(_OFFERS, st.floats(0.5, 3.5), st.floats(0.0, 1.0))
def test_more_extent_and_more_offers_never_do_more_harm(offers, extent, more):
    here, further = harm_at(offers, extent), harm_at(offers, extent + more)
    assert math.isnan(here) or further <= here * (1.0 + _EXACT)
    envelope = lower_envelope(offers)
    assert all(a.extent < b.extent and a.harm > b.harm for a, b in pairwise(envelope))
    assert all(harm_at(offers, offer.extent) <= offer.harm * (1.0 + _EXACT) for offer in offers)


@given(_OFFERS, st.floats(0.5, 3.0), st.floats(0.1, 10.0))
def test_the_unit_of_harm_does_not_matter(offers, extent, factor):
    scaled = [Offer(offer.extent, factor * offer.harm) for offer in offers]
    found = harm_at(scaled, extent)
    assert (
        math.isnan(found)
        if math.isnan(harm_at(offers, extent))
        else found == pytest.approx(factor * harm_at(offers, extent))
    )


def test_no_harm_has_no_logarithm():
    with pytest.raises(ValueError, match="harm has to be > 0"):
        harm_at([Offer(1.0, 0.0)], 1.0)
    assert floored(0.0, 200, 0.5) == pytest.approx(0.0025)
    assert floored(1.0, 200, 0.5) == 1.0


def test_typical_ratios():
    found = typical([2.0, 8.0, math.nan, 4.0])
    assert (found.median, found.geometric.n) == (4.0, 3)
    assert found.geometric.mean == pytest.approx(4.0)
    assert 2.0 <= found.geometric.low <= 4.0 <= found.geometric.high <= 8.0
    assert math.isnan(typical([math.nan]).median) and typical([]).geometric.n == 0


# --- common sense ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def task():
    return suite.task("workbench/shelve_spray")


@pytest.mark.long
@pytest.mark.parametrize("name", first_quick(common_sense.COSTS))
def test_costs_of_common_sense_are_costs(name, task):
    cost = common_sense.COSTS[name](task.scene)
    check_cost(cost, task.scene)
    result = gp.plan(
        task.start, task.goal, task.scene, objective=gp.Objective(impact=cost, w=1.0), iterations=30, seed=1
    )
    assert result.cost is not None and result.cost.impact > 0.0


def test_severity_includes_object_and_contents():
    scene = suite.task("breakfast_bar/serve_tea").scene
    entity = scene.entities["laptop"]
    found = dict(zip(scene.entities, common_sense.severities(scene), strict=True))
    assert found["laptop"] == entity.severity["carried"] + entity.severity["contents"]


def test_the_simple_costs_measure_distance_overlap_and_height(task):
    scene = task.scene
    board = np.array([0.49, 0.06, 0.892])  # the top of the chip on the open board
    far, above, lower = board + [-0.3, 0.4, 0.0], board + [0.0, 0.0, 0.4], board + [0.0, 0.0, 0.1]
    p = np.stack([far, above, lower])
    boxes, severity = common_sense.entity_boxes(scene), common_sense.severities(scene)
    i = list(scene.entities).index("circuit_board")
    np.testing.assert_allclose(boxes.distance(p)[1:, i], [0.4, 0.1], atol=1e-6)
    assert boxes.distance(p)[0, i] > 0.3
    np.testing.assert_array_equal(boxes.above(p)[:, i], [0.0, 1.0, 1.0])
    away, over, low = (make(scene) for make in common_sense.COSTS.values())
    assert away.density(p)[2] > away.density(p)[1]
    floor = severity[list(scene.entities).index("floor")]
    assert over.density(p)[1] == pytest.approx(severity[i] + severity[list(scene.entities).index("bench")] + floor)
    assert low.density(p)[1] == pytest.approx(board[2] + 0.4 - 0.86)  # over the bench: the board itself can move
    beside = np.array([0.47 + 0.075 + 0.4 * common_sense.MARGIN, 0.03, 1.2])  # the board is 0.15 m wide
    assert boxes.above(beside[None])[0, i] == pytest.approx(0.6)


def test_weights_of_own_costs_are_relative_to_the_straight_path(task):
    cost = common_sense.keep_away(task.scene)
    w = runs.weight_of(3.0, task, cost)
    straight = gp.evaluate(np.stack([task.start, task.goal[0]]), task.scene, gp.Objective(impact=cost, w=w))
    assert straight.total == pytest.approx(4.0 * straight.motion, rel=1e-6)


# --- records ---------------------------------------------------------------------------------------------------------


def motion(w: float, duration: float, drops: float, **more: object) -> Motion:
    of = {"a/severe": 0.2 * drops, "b/severe": 0.8 * drops}
    harm = {
        "drops": Harm(mean=drops, n=100, predicted=drops, own=min(1.0, drops), energy=0.5 * drops),
        "mixed": Harm(mean=0.5 * drops, n=95, predicted=0.0, by_fault=of),
    }
    return Motion(w=w, length=duration, duration=duration, harm=harm, **more)  # type: ignore[arg-type]


def head(task: str = "desk/bring_coffee", **changed: Motion) -> Headline:
    rise = {"rise": (-1.0, -2.0, -0.5), "less_per_task": (4.0, 3.0, 5.0), "less_per_failure": (5.0, 4.0, 6.0)}
    ours = motion(1.0, 2.5, 2.0)
    ours = replace(ours, harm={kind: replace(harm, **rise) for kind, harm in ours.harm.items()})
    motions = {NONE: motion(0.0, 2.0, 10.0), OURS: ours, PUBLISHED: motion(1.0, 2.0, 5.0)}
    motions[runs.ENERGY] = motion(1.0, 2.5, 4.0)
    motions[runs.ALL_FAULTS] = Motion(w=1.0, refused="the object 'mug' at 1 s: slips")
    return Headline(task=task, grasp="weld", least=0.2, rate=1e-3, motions=motions | changed)


def curve(cost: str, *points: tuple[float, float], task: str = "desk/bring_coffee") -> Curve:
    motions = {f"{w:g}": motion(w, d, drops) for w, (d, drops) in zip((0.1, 1.0, 10.0), points, strict=False)}
    return Curve(task=task, cost=cost, points=motions)


def found(*heads: Headline, curves: tuple[Curve, ...] = ()) -> figures.Found:
    group = figures.Group("bundled", frozenset(done.task for done in heads))
    return figures.Found(list(heads), {(x.task, x.cost): x for x in curves}, [group])


def test_records_survive_writing_and_reading(tmp_path):
    file = tmp_path / "lines.jsonl"
    file.write_text(store.line(head()) + store.line(head("desk/water_plant")) + store.line(head())[:40])
    (first, second) = runs.read_headlines(file)
    assert (first, second.task) == (replace(head(), motions=first.motions), "desk/water_plant")
    assert first.motions[OURS] == head().motions[OURS] and first.motions[NONE] == head().motions[NONE]
    assert first.motions[runs.ALL_FAULTS].refused and math.isnan(first.motions[runs.ALL_FAULTS].duration)


def test_points_of_a_curve_may_come_in_parts(tmp_path):
    file = tmp_path / "lines.jsonl"
    later, sooner = curve(OURS, (2.2, 4.0)), curve(OURS, (2.4, 3.0), (3.0, 1.0))
    part = Curve(task=sooner.task, cost=OURS, points={"1": sooner.points["1"]})
    file.write_text(store.line(part) + store.line(later))
    (whole,) = runs.read_curves(file)
    assert list(whole.points) == ["0.1", "1"]
    assert whole.points == {"0.1": later.points["0.1"], "1": sooner.points["1"]}


def test_only_missing_jobs_are_done(tmp_path):
    job, sizes = HeadlineJob(drops=10, mixed=19), tables.Sizes(drops=5, weights=(0.1, 1.0), relative=(3.0,))
    names = {"bundled": ["desk/bring_coffee", "desk/water_plant", "desk/put_book_away"]}
    heads, curves = tmp_path / "heads.jsonl", tmp_path / "curves.jsonl"
    assert len(work.headline_jobs(names, heads, job)) == 3
    assert work.curve_jobs(names, heads, curves, sizes) == []  # grasps are known only from the headline runs
    lost = head("desk/water_plant", **{NONE: Motion(w=0.0, refused="slips")})
    heads.write_text(store.line(head()) + store.line(lost))
    assert [job.task for job in work.headline_jobs(names, heads, job)] == ["desk/put_book_away"]
    curves.write_text(store.line(curve(OURS, (2.2, 4.0))))
    jobs = work.curve_jobs(names, heads, curves, sizes)
    assert {job.cost for job in jobs} == set(runs.CURVES) and {job.task for job in jobs} == {"desk/bring_coffee"}
    weights = {job.cost: job.weights for job in jobs}
    assert weights[OURS] == (1.0,) and weights[PUBLISHED] == (0.1, 1.0) and weights["carry low"] == (3.0,)
    assert {job.grasp for job in jobs} == {"weld"}


# --- figures and tables ----------------------------------------------------------------------------------------------


def test_harm_per_task_counts_the_duration():
    done = head()
    assert figures.less(done, OURS, "drops", per="failure") == pytest.approx(5.0)
    assert figures.less(done, OURS, "drops", per="task") == pytest.approx(5.0 * 2.0 / 2.5)
    assert math.isnan(figures.less(done, runs.ALL_FAULTS, "drops", per="task"))
    assert figures.longer([done], OURS, "duration") == pytest.approx(0.25)
    assert figures.beyond([done], OURS, "drops", -1.0) == [done.task] and not figures.beyond([done], OURS, "drops", 1.0)
    spilling = replace(done, motions={**done.motions, OURS: replace(done.motions[OURS], healthy=8.0)})
    before, after = (done.motions[label] for label in (NONE, OURS))
    per_second = done.rate / 3600.0
    failing = [x.harm["drops"].mean * x.duration * per_second for x in (before, after)]
    assert figures.less(spilling, OURS, "drops", per="task") == pytest.approx(failing[0] / (failing[1] + 8.0))
    others = figures.less(done, OURS, "drops", per="failure", own_loss=False)
    assert others == pytest.approx((10.0 - 1.0) / (2.0 - 1.0))
    nothing = head(**{OURS: motion(1.0, 2.0, 0.0)})
    assert figures.less(nothing, OURS, "drops", per="failure") == pytest.approx(10.0 / (0.2 / 100))


def test_planners_are_compared_at_equal_duration():
    ours, other = curve(OURS, (2.2, 4.0), (2.4, 1.0)), curve("carry low", (2.4, 6.0))
    all_of = found(head(**{OURS: motion(1.0, 9.0, 9.0)}), curves=(ours, other))
    (group,) = all_of.groups
    (ratio,) = figures.against_ours(all_of, group, "carry low", "duration", 1.2)
    assert ratio == pytest.approx(6.0 * 2.4 / (1.0 * 2.4))
    assert figures.against_ours(all_of, group, "keep away", "duration", 1.2) == []
    duration, _, less = figures.at_weight(all_of, group, 1.0)
    assert (duration, less.median) == (pytest.approx(1.2), pytest.approx(10.0 * 2.0 / (1.0 * 2.4)))


def test_the_report_loses_nothing(tmp_path):
    sizes = tables.Sizes(drops=200, weights=(0.1, 1.0), relative=(3.0,))
    all_of = found(head(), curves=(curve(OURS, (2.2, 4.0)), curve(PUBLISHED, (2.2, 4.0))))
    asked = ["desk/bring_coffee", "desk/water_plant"]
    curves = "\n".join(tables.curve_sections(all_of, asked, sizes))
    assert "1 of 2 tasks" in curves and "2 of 10 curves" in curves
    assert "| bundled | 0.1 | +10 % | +10 % | 2.27 | 2.27 [2.27, 2.27] |" in curves
    assert "know in advance: x less, median (geometric mean): bundled 2.27 (2.27 [2.27, 2.27])." in curves
    text = "\n".join(tables.headline_sections(all_of, asked, HeadlineJob(drops=1000, mixed=500)))
    assert "1 of 2 tasks" in text
    assert "Not done: desk/water_plant." in text
    assert "Held by a weld: desk/bring_coffee." in text
    assert "desk/bring_coffee (service robot): the object 'mug' at 1 s: slips" in text
    assert "1.39 *" in text  # 2 per failure, 2.5 s, one failure in 1000 h, a million tasks
    less = "5.00 | 5.00 | 4.00 | 4.00 [4.00, 4.00] | 7.20 | 7.20 [7.20, 7.20] | 4.00 | 4.00 [4.00, 4.00]"
    assert f"| bundled | default | 1 | +25 % | +25 % | {less} | 0 | 1 |" in text
    assert (
        "| b/severe | bundled | 80.0 % | 2.00 | 4.00 | - | 2.00 |" in text
    )  # Algorithm 1, default, refused, by energy
    assert "**no**" in text  # some tasks are missing
    figures.draw(all_of, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 1000


def test_sizes_and_tasks_follow_the_options():
    options = suite.Options(drops=5, weights=(0.5,), tasks=("desk/*", "bedside/bring_*"))
    job, sizes = prevention.asked_job(options), prevention.sizes_of(options)
    assert (job.drops, job.mixed) == (5, tables.MIXED)
    assert (sizes.drops, sizes.weights, sizes.relative) == (5, (0.5,), prevention.RELATIVE)
    names = work.task_names(options)
    assert len(names["bundled"]) == 5 and names["unseen"] == ["bedside/bring_pills", "bedside/bring_water"]
    quick = work.task_names(suite.Options(quick=True))
    assert {suite.is_tabletop(name) for name in quick["unseen"]} == {True, False} and len(quick["unseen"]) == 2


# --- with simulation -------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_both_kinds_of_jobs_run(monkeypatch):
    monkeypatch.setattr(runs, "SECONDS", 0.4)
    monkeypatch.setattr(runs, "OWN_SECONDS", 0.4)
    name = "play_table/crown_tower"
    done = runs.do_headline(HeadlineJob(task=name, drops=3, mixed=19))
    assert done.grasp in ("fingers", "weld") and set(done.motions) == {NONE, *runs.MODELS}
    none, ours = done.motions[NONE], done.motions[OURS]
    assert none.harm["drops"].less_per_task is None and none.harm["drops"].n == 3
    assert none.duration > 0.0 and none.length > 1.0
    if not ours.refused:
        assert ours.harm["mixed"].rise is not None and ours.harm["mixed"].n == 19
    line = runs.do_curve(CurveJob(task=name, cost="carry low", weights=(3.0,), grasp=done.grasp, drops=2))
    assert set(line.points) == {"3"} and (line.points["3"].refused or line.points["3"].harm["drops"].n == 2)


def test_objects_that_slip_from_fingers_are_held_by_a_weld(monkeypatch, task):
    result = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=20)
    asked = []

    def refusal(task, result, grasp):
        asked.append(grasp)
        return "slips" if grasp == "fingers" else ""

    monkeypatch.setattr(runs, "_refusal", refusal)
    assert runs._held("workbench/shelve_spray", {NONE: result}) == ("weld", {NONE: ""})
    assert asked == ["fingers", "weld"]
    none = gp.PlanResult(status=gp.PlanStatus.TIMEOUT, detail="no path")
    assert runs._refusal is refusal
    monkeypatch.undo()
    assert runs._refusal(task, none, "fingers") == "TIMEOUT: no path"

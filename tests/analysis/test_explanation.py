"""Explanations: sums equal the breakdown, stretches hold the stated share and are the shortest, unhappy paths."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from places import ROOT

import graceful_plan as gp
from graceful_plan.analysis.explanation import STRETCH, shortest_stretch
from graceful_plan.exceptions import CostError, SettingError, ShapeError
from graceful_plan.viz.explanation import draw_explanation
from sizes import first_quick

_ROUNDING = 1e-12
_OBJECTIVES = {
    f"{model}-{exposure}": gp.Objective(impact=gp.ImpactCost(model=model), exposure=exposure)
    for model in ("box_overlap", "mixture")
    for exposure in ("length", "time", "waypoints")
}


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("desk").tasks["bring_coffee"]


@pytest.fixture(scope="module")
def result(task):
    return gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50)


class TwoFaults(gp.InteractionModel):
    """The carried object hits everything: 3 times in 10 by a drop, else by a spill; two faults drop it."""

    def probability(self, batch):
        return sum(self.sources(batch).values())

    def sources(self, batch):
        P = np.zeros((len(batch), len(batch.scene.components), len(batch.scene.entities)))
        P[:, 1] = 1.0
        return {"drop": 0.3 * P, "spill": 0.7 * P}

    def fault_shares(self):
        return {"drop": {"slip": 0.1, "opened": 0.2, "never": 0.0}}


class HalfTold(TwoFaults):
    """A model whose sources account for only half of its probability."""

    def probability(self, batch):
        return np.minimum(1.0, 2.0 * super().probability(batch))

    def sources(self, batch):
        return {"drop": 0.25 * np.ones((len(batch), len(batch.scene.components), len(batch.scene.entities)))}


@dataclasses.dataclass(frozen=True)
class Own(gp.Cost):
    def state(self, batch):
        return np.ones(len(batch))


# --- sums -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", _OBJECTIVES)
@pytest.mark.parametrize("kind", ["path", "trajectory"])
def test_parts_add_up_to_the_breakdown(task, result, name, kind):
    objective, motion = _OBJECTIVES[name], getattr(result, kind)
    found, cost = gp.explain(motion, task.scene, objective), gp.evaluate(motion, task.scene, objective)
    assert cost.impact > 0.0
    assert found.cost == cost
    assert sum(row.impact for row in found.contributions) == pytest.approx(cost.impact, rel=_ROUNDING)
    assert sum(row.share for row in found.contributions) == pytest.approx(1.0, rel=_ROUNDING)
    assert found.weight @ found.density == pytest.approx(cost.impact, rel=_ROUNDING)
    for key, parts in (("entity", cost.impact_by_entity), ("component", cost.impact_by_component)):
        for part, impact in parts.items():
            mine = sum(row.impact for row in found.contributions if getattr(row, key) == part)
            assert mine == pytest.approx(impact, rel=_ROUNDING, abs=1e-15)
    along = dict(zip(found.entities, found.weight @ found.by_entity, strict=True))
    assert along == pytest.approx(dict(cost.impact_by_entity), rel=_ROUNDING)


@pytest.mark.parametrize("name", _OBJECTIVES)
def test_an_explanation_has_the_cost_of_the_result(task, result, name):
    objective = _OBJECTIVES[name]
    found = gp.explain(result, task.scene, objective)
    assert found.cost == gp.evaluate(result.trajectory, task.scene, objective)
    assert found.time is not None


def test_the_largest_comes_first(task, result):
    impact = [row.impact for row in gp.explain(result, task.scene).contributions]
    assert impact == sorted(impact, reverse=True)
    assert impact[-1] > 0.0


# --- along the motion -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", _OBJECTIVES)
def test_a_stretch_holds_its_share(task, result, name):
    objective, scene = _OBJECTIVES[name], task.scene
    found = gp.explain(result.trajectory, scene, objective)
    charged = objective.bind(scene).cost_samples(result.trajectory)
    P, S = objective.impact.probability(charged.batch), objective.impact.severity_table(scene)
    assert found.contributions
    for row in found.contributions:
        index = list(scene.components).index(row.component), found.entities.index(row.entity)
        severity = S[index]
        mass = charged.weight * P[:, *index] * severity
        inside = (found.place >= row.begin) & (found.place <= row.end)
        assert mass[inside].sum() >= STRETCH * row.impact * (1.0 - 1e-9)
        assert row.probability == P[:, *index].max()
        assert row.severity == severity
        assert row.begin_time <= row.end_time
        assert result.trajectory.t[0] <= row.worst_time <= result.trajectory.t[-1]


@given(
    hnp.arrays(float, st.integers(1, 12), elements=st.integers(0, 5)),
    st.lists(st.integers(0, 3), min_size=12, max_size=12),
    st.sampled_from([0.1, 0.5, 0.9, 1.0]),
)
def test_no_stretch_is_shorter(mass, steps, share):
    mass[-1] += not mass.any()
    place = np.cumsum(steps[: len(mass)]).astype(float)
    first, last = shortest_stretch(place, mass, share)
    needed = share * mass.sum() * (1.0 - 1e-9)
    assert mass[first : last + 1].sum() >= needed
    pairs = [(i, j) for i in range(len(mass)) for j in range(i, len(mass)) if mass[i : j + 1].sum() >= needed]
    assert place[last] - place[first] == min(place[j] - place[i] for i, j in pairs)


def test_the_worst_place_has_the_stated_probability(task, result):
    path = result.path
    length = np.concatenate([[0.0], np.cumsum(path.segment_lengths)])
    entities, components = list(task.scene.entities), list(task.scene.components)
    for row in gp.explain(path, task.scene, _OBJECTIVES["box_overlap-length"]).contributions[:5]:
        q = np.array([np.interp(row.worst, length, joint) for joint in path.q.T])
        P = gp.interaction_probability(q, task.scene, "box_overlap")[
            components.index(row.component), entities.index(row.entity)
        ]
        assert row.probability == pytest.approx(P, abs=1e-9)
        np.testing.assert_allclose(row.position, task.scene.data_at(q).body("mug").xpos, atol=1e-9)


def test_times_are_on_the_clock_of_the_trajectory(task, result):
    found = gp.explain(result.trajectory, task.scene, _OBJECTIVES["mixture-length"])
    length = np.concatenate([[0.0], np.cumsum(result.trajectory.path.segment_lengths)])
    np.testing.assert_allclose(np.interp(found.place, length, result.trajectory.t), found.time, atol=1e-6)
    assert gp.explain(result.path, task.scene).contributions[0].worst_time is None


def test_the_reversed_path_has_the_mirrored_explanation(task, result):
    objective = _OBJECTIVES["box_overlap-length"]  # the box model ignores velocities
    there, back = (gp.explain(path, task.scene, objective) for path in (result.path, result.path.reversed()))
    assert back.cost.impact == pytest.approx(there.cost.impact, rel=1e-9)
    first, mirrored = there.contributions[0], back.contributions[0]
    assert mirrored.event == first.event
    assert mirrored.end - mirrored.begin == pytest.approx(first.end - first.begin, abs=1e-9)
    assert there.place[-1] - back.place[-1] == pytest.approx(0.0, abs=1e-12)


# --- sources and faults ---------------------------------------------------------------------------------------------


def test_sources_and_their_faults_are_separate(task, result):
    found = gp.explain(result, task.scene, gp.Objective(impact=gp.ImpactCost(model=TwoFaults())))
    share = {source: sum(r.share for r in found.contributions if r.source == source) for source in ("drop", "spill")}
    assert share == pytest.approx({"drop": 0.3, "spill": 0.7})
    for row in found.contributions:
        expected = {"opened": 2 / 3, "slip": 1 / 3} if row.source == "drop" else {}
        assert row.faults == pytest.approx(expected)
        assert list(row.faults) == list(expected)
    dropped = next(row for row in found.contributions if row.source == "drop")
    assert dropped.event == f"dropped mug onto {dropped.entity}"
    assert "opened 67%, slip 33%" in str(found)


def test_hidden_rows_are_counted(task, result):
    found = gp.explain(result, task.scene, gp.Objective(impact=gp.ImpactCost(model=TwoFaults())))
    *_, last = str(found).splitlines()
    left = sum(row.share for row in found.contributions[12:])
    assert last == f"and {len(found.contributions) - 12} others: {left:.1%}"


def test_moving_entities_are_hit_at_their_place_at_that_time(task, result):
    # The cat sits beside the mug's path until half a second, then it is gone.
    q, trajectory = result.trajectory.at([0.3]).q[0], result.trajectory
    below = task.scene.data_at(q).body("mug").xpos - [0.0, 0.0, 0.3]
    away = below + [9.0, 0.0, 0.0]
    cat = gp.MovingEntity("tom", "pet", size=[0.1, 0.1], t=[0.0, 0.5, 0.51], position=[below, below, away])
    scene = task.scene.with_moving(cat)
    found = gp.explain(trajectory, scene, _OBJECTIVES["mixture-time"])
    assert sum(row.impact for row in found.contributions) == pytest.approx(found.cost.impact, rel=_ROUNDING)
    mine = [row for row in found.contributions if row.entity == "tom"]
    assert sum(row.impact for row in mine) == pytest.approx(found.cost.impact_by_entity["tom"], rel=_ROUNDING)
    assert {row.component for row in mine} == {"carried", "contents"}
    assert max(row.end_time for row in mine) < 0.6
    later = gp.explain(trajectory, scene, _OBJECTIVES["mixture-time"], start_time=1.0)
    assert later.cost.impact_by_entity["tom"] < 1e-3 * found.cost.impact_by_entity["tom"]
    with pytest.raises(SettingError, match="start_time = nan"):
        gp.explain(trajectory, scene, start_time=np.nan)


# --- documents and pictures -----------------------------------------------------------------------------------------


def test_the_document_has_the_same_values(task, result):
    found = gp.explain(result, task.scene)
    document = json.loads(found.to_json())
    assert document["cost"]["impact"] == found.cost.impact
    assert [row["impact"] for row in document["contributions"]] == [row.impact for row in found.contributions]
    along = document["along"]
    total = {name: np.dot(along["weight"], density) for name, density in along["by_entity"].items()}
    assert total == pytest.approx(dict(found.cost.impact_by_entity), rel=_ROUNDING)
    assert along["time"][-1] == pytest.approx(result.trajectory.duration)


@pytest.mark.long
@pytest.mark.parametrize("name", first_quick([*_OBJECTIVES, "nothing"]))
def test_a_picture_is_drawn(task, result, name, tmp_path):
    nothing = gp.Objective(impact=gp.ImpactCost(components=()))
    draw_explanation(gp.explain(result, task.scene, _OBJECTIVES.get(name, nothing)), tmp_path / "picture.png")
    from matplotlib.image import imread

    assert np.ptp(imread(tmp_path / "picture.png")[..., :3], axis=(0, 1)).max() > 0.5


@pytest.mark.parametrize("section", first_quick(["A motion, explained", "A scene, mapped"]))
def test_the_guide_runs(section, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "explain.md").read_text().partition(f"## {section}")[2]
    exec(compile(text.partition("```python\n")[2].partition("```")[0], "explain.md", "exec"), {})


# --- unhappy paths --------------------------------------------------------------------------------------------------


def test_nothing_to_explain(task, result):
    found = gp.explain(result, task.scene, gp.Objective(impact=gp.ImpactCost(components=())))
    assert found.contributions == ()
    assert str(found) == "impact 0: whatever fails, nothing is hit that matters"


def test_standing_still_costs_nothing_but_a_waypoint_does(task):
    q = gp.Path(task.start[None])
    assert gp.explain(q, task.scene).contributions == ()
    point = gp.explain(q, task.scene, _OBJECTIVES["box_overlap-waypoints"])
    assert point.cost.impact == pytest.approx(sum(row.impact for row in point.contributions))
    assert point.cost.impact > 0.0
    assert {row.begin for row in point.contributions} | {row.end for row in point.contributions} == {0.0}


def test_other_costs_have_no_entities(task, result):
    with pytest.raises(SettingError, match=r"Own\(\)"):
        gp.explain(result, task.scene, gp.Objective(impact=Own()))


def test_sources_must_add_up(task, result):
    with pytest.raises(CostError, match=r"HalfTold: sources\(\).*probability\(\)"):
        gp.explain(result, task.scene, gp.Objective(impact=gp.ImpactCost(model=HalfTold())))


def test_no_path_no_explanation(task):
    failed = gp.plan(task.start + 9.0, task.goal, task.scene, iterations=1)
    with pytest.raises(gp.PlanningFailed, match="INVALID_START"):
        gp.explain(failed, task.scene)


def test_a_path_of_another_robot(task):
    with pytest.raises(ShapeError, match=r"path.*\(2, 3\).*7"):
        gp.explain(gp.Path(np.zeros((2, 3))), task.scene)

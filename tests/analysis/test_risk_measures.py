"""Risk of a motion: closed forms by hand, an oracle by enumeration, laws of the measures, misuse."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT

import graceful_plan as gp
from graceful_plan.analysis import harm_law
from graceful_plan.analysis.harm_law import HarmLaw
from graceful_plan.analysis.risk_measures import RiskMeasure, conditional_value_at_risk, risk
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.objective import moving_batch
from graceful_plan.exceptions import CostError, NonFiniteError, SettingError, ShapeError, UnknownNameError
from graceful_plan.scene.scene import Scene

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Given(InteractionModel):
    """Hits with the same probabilities at every configuration, by generator."""

    shares: tuple[Array, ...]
    weights: tuple[float, ...] = ()

    def probability(self, batch: StateBatch) -> Array:
        return sum(self.sources(batch).values())  # type: ignore[return-value]

    def sources(self, batch: StateBatch) -> Mapping[str, Array]:
        return {str(i): np.broadcast_to(P, (len(batch), *P.shape)).copy() for i, P in enumerate(self.shares)}

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        return {str(i): {"one": 0.25 * w, "other": 0.75 * w} for i, w in enumerate(self.weights)}


@dataclass(frozen=True)
class Later(InteractionModel):
    """The first entity is hit while the first joint is between 0.5 and 1, and never before."""

    def probability(self, batch: StateBatch) -> Array:
        P = np.zeros((len(batch), len(batch.scene.components), len(batch.scene.entities)))
        P[:, list(batch.scene.components).index("carried"), 0] = batch.q[:, 0] > 0.5
        return P


@pytest.fixture(scope="module")
def scene() -> Scene:
    return gp.load_scene("tabletop_l1").tasks["green_to_blue"].scene


def cost(
    scene: Scene, carried: Mapping[int, float], *others: Mapping[int, float], weights: tuple[float, ...] = ()
) -> gp.ImpactCost:
    """Let the carried object hit entities, by index, with these probabilities; each mapping is one generator."""
    shares = []
    for hits in (carried, *others):
        P = np.zeros((len(scene.components), len(scene.entities)))
        for entity, p in hits.items():
            P[list(scene.components).index("carried"), entity] = p
        shares.append(P)
    return gp.ImpactCost(model=Given(tuple(shares), weights))


def severities(scene: Scene) -> list[float]:
    return [entity.severity["carried"] for entity in scene.entities.values()]


def still(scene: Scene) -> Array:
    return np.zeros((1, len(scene.joints)))


def test_one_entity_has_a_two_point_distribution(scene: Scene) -> None:
    S = severities(scene)[0]
    assert S > 0.0
    found = risk(still(scene), scene, cost(scene, {0: 0.04}), level=0.9)
    np.testing.assert_allclose(found.value, [0.0, S])
    np.testing.assert_allclose(found.probability, [0.96, 0.04])
    assert found.expected == pytest.approx(0.04 * S)
    assert found.var == 0.0
    assert found.cvar == pytest.approx(0.4 * S)  # 4 in 10 of the worst tenth
    assert found.worst == S == found.conceivable
    assert found.no_harm == pytest.approx(0.96)
    assert risk(still(scene), scene, cost(scene, {0: 0.2}), level=0.9).cvar == pytest.approx(S)
    assert risk(still(scene), scene, cost(scene, {0: 0.2}), level=0.9).var == S
    assert risk(still(scene), scene, cost(scene, {0: 5e-4}), level=0.9).worst == 0.0


def test_two_entities_are_two_coins(scene: Scene) -> None:
    a, b = sorted({s for s in severities(scene) if s > 0.0})[-2:]
    first, second = severities(scene).index(a), severities(scene).index(b)
    found = risk(still(scene), scene, cost(scene, {first: 0.5, second: 0.1}), level=0.8)
    np.testing.assert_allclose(found.value, [0.0, a, b, a + b])
    np.testing.assert_allclose(found.probability, [0.45, 0.45, 0.05, 0.05])
    assert found.expected == pytest.approx(0.5 * a + 0.1 * b)
    # The worst fifth: 0.05 of a + b, 0.05 of b, and 0.1 of a.
    assert found.cvar == pytest.approx((0.05 * (a + b) + 0.05 * b + 0.1 * a) / 0.2)
    np.testing.assert_allclose(found.exceeding([-1.0, 0.0, a, b, a + b]), [1.0, 0.55, 0.1, 0.05, 0.0], atol=1e-12)


def test_causes_exclude_each_other(scene: Scene) -> None:
    found = risk(still(scene), scene, cost(scene, {0: 0.3}, {0: 0.2}))
    assert found.no_harm == pytest.approx(0.5)


def test_entities_are_independent_given_the_kind_of_failure(scene: Scene) -> None:
    """Kind 1, one failure in ten, always hits both; kind 2, one in two, hits entity b half of the time."""
    a, b = severities(scene)[:2]
    kinds = {0: 0.1, 1: 0.1}, {1: 0.25}
    found = risk(still(scene), scene, cost(scene, *kinds, weights=(0.1, 0.5)))
    assert found.no_harm == pytest.approx(0.4 + 0.25)
    assert found.exceeding(a + b - 1e-3) == pytest.approx(0.1)
    assert found.expected == pytest.approx(0.1 * (a + b) + 0.25 * b)
    unweighted = risk(still(scene), scene, cost(scene, *kinds))
    assert unweighted.expected == pytest.approx(found.expected)
    assert unweighted.exceeding(a + b - 1e-3) == pytest.approx(0.1 * 0.35)
    assert unweighted.cvar < found.cvar
    states = HarmLaw(cost(scene, *kinds, weights=(0.1, 0.5)), scene).states(StateBatch(scene, still(scene)))
    np.testing.assert_allclose(states.sum(axis=1), 1.0)


def test_components_add_up_and_strike_together() -> None:
    scene = gp.load_scene("desk").tasks["bring_coffee"].scene
    components = list(scene.components)
    name, entity = next(
        (i, e) for i, e in enumerate(scene.entities.values()) if e.severity["contents"] > e.severity["carried"] > 0.0
    )
    P = np.zeros((len(components), len(scene.entities)))
    P[components.index("carried"), name], P[components.index("contents"), name] = 0.5, 0.2
    found = risk(np.zeros((1, len(scene.joints))), scene, gp.ImpactCost(model=Given((P,))))
    carried, contents = entity.severity["carried"], entity.severity["contents"]
    np.testing.assert_allclose(found.value, [0.0, carried, carried + contents])
    np.testing.assert_allclose(found.probability, [0.5, 0.3, 0.2])
    assert found.expected == pytest.approx(0.5 * carried + 0.2 * contents)
    assert found.conceivable == carried + contents


@pytest.mark.parametrize(("name", "task"), [("desk", "bring_coffee"), ("tabletop", "green_to_blue")])
def test_the_mean_is_the_impact_of_the_planner(name: str, task: str) -> None:
    found = gp.load_scene(name).tasks[task]
    impact, scene = gp.ImpactCost(), found.scene
    q = np.linspace(found.start, np.atleast_2d(found.goal)[0], 20)
    law = HarmLaw(impact, scene)
    means = law.states(StateBatch(scene, q)) @ law.value
    np.testing.assert_allclose(means, impact.state(StateBatch(scene, q)), rtol=1e-6)
    without = HarmLaw(gp.ImpactCost(own_loss=False), scene).states(StateBatch(scene, q))
    assert (law.states(StateBatch(scene, q))[:, 0] <= without[:, 0] + 1e-12).all()


@given(st.integers(0, 10**6), st.floats(0.0, 0.99))
@settings(max_examples=30, deadline=None)
def test_the_distribution_equals_the_enumeration_of_combinations(scene: Scene, seed: int, level: float) -> None:
    p = np.random.default_rng(seed).uniform(size=len(scene.entities))
    S = severities(scene)
    outcomes = list(itertools.product((0, 1), repeat=len(p)))
    harm = np.array([np.dot(hits, S) for hits in outcomes])
    chance = np.array([np.prod(np.where(hits, p, 1.0 - p)) for hits in outcomes])
    found = risk(still(scene), scene, cost(scene, dict(enumerate(p))), level=level)
    for value, probability in zip(found.value, found.probability, strict=True):
        assert probability == pytest.approx(chance[np.isclose(harm, value)].sum(), abs=1e-12)
    order = np.argsort(-harm)
    left = np.clip(1.0 - level - np.concatenate([[0.0], np.cumsum(chance[order])[:-1]]), 0.0, chance[order])
    assert found.cvar == pytest.approx(left @ harm[order] / (1.0 - level), rel=1e-9, abs=1e-9)


probabilities = st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5)


@given(probabilities, st.floats(0.0, 0.99), st.floats(0.0, 0.99))
@settings(max_examples=50, deadline=None)
def test_measures_keep_their_order(scene: Scene, p: list[float], first: float, second: float) -> None:
    low, high = (risk(still(scene), scene, cost(scene, dict(enumerate(p))), level=x) for x in sorted((first, second)))
    assert low.probability.sum() == pytest.approx(1.0)
    assert low.expected - 1e-9 <= low.cvar <= high.cvar + 1e-9
    assert high.var <= high.cvar + 1e-9 <= high.conceivable + 2e-9
    # Outcomes beyond the worst case have a total probability of at most 1e-3.
    assert high.cvar <= high.worst + 1e-3 / (1.0 - high.level) * high.conceivable + 1e-9
    assert risk(still(scene), scene, cost(scene, dict(enumerate(p))), level=0.0).cvar == pytest.approx(low.expected)


@given(probabilities, st.integers(0, 4), st.floats(1.0, 5.0), st.sampled_from([0.0, 0.5, 0.9, 0.99]))
@settings(max_examples=8, deadline=None)
def test_more_severity_or_probability_is_never_less_risk(
    scene: Scene, p: list[float], which: int, factor: float, level: float
) -> None:
    before = risk(still(scene), scene, cost(scene, dict(enumerate(p))), level=level)
    more = dict(enumerate(p)) | {which: 0.5 + 0.5 * p[which]}
    name = list(scene.entities)[which]
    worse = scene.with_severity({name: {"carried": factor * severities(scene)[which]}})
    after = risk(still(worse), worse, cost(worse, more), level=level)
    for measure in ("expected", "cvar", "var", "worst", "conceivable"):
        assert getattr(after, measure) >= getattr(before, measure) - 1e-9
    assert after.no_harm <= before.no_harm + 1e-12


def test_a_failure_may_come_at_any_time(scene: Scene) -> None:
    S = severities(scene)[0]
    impact = gp.ImpactCost(model=Later())
    n = len(scene.joints)
    path = gp.Path(np.array([np.zeros(n), np.eye(n)[0]]))
    by_length = risk(path, scene, impact, level=0.75)
    assert by_length.expected == pytest.approx(0.5 * S, rel=0.02)
    assert by_length.cvar == pytest.approx(S)
    # The second half takes twice as long as the first.
    t, q = np.array([0.0, 1.0, 3.0]), np.outer([0.0, 0.5, 1.0], np.eye(n)[0])
    rates = np.outer([0.5, 0.5, 0.25], np.eye(n)[0])
    slow = gp.Trajectory(t, q, rates, np.zeros_like(q), tuple(scene.joints))
    assert risk(slow, scene, impact).expected == pytest.approx(2.0 / 3.0 * S, rel=0.02)


def test_a_failure_starts_with_the_velocity_of_the_trajectory() -> None:
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    impact = gp.ImpactCost(model="mixture")
    motion = gp.plan(task.start, task.goal, task.scene, 0.0, iterations=500).unwrap()
    found = risk(motion, task.scene, impact)
    state = motion.at(motion.t[0] + (np.arange(2000) + 0.5) / 2000 * motion.duration)
    expected = impact.state(moving_batch(task.scene, state.q, state.qd)).mean()
    assert found.expected == pytest.approx(expected, rel=0.01)
    slower = gp.Trajectory(10 * motion.t, motion.q, motion.qd / 10, motion.qdd / 100, motion.joints)
    assert risk(slower, task.scene, impact).expected != pytest.approx(found.expected, rel=0.02)


def test_entities_that_move_count_at_the_times_of_a_trajectory() -> None:
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    impact = gp.ImpactCost(model="mixture")
    motion = gp.plan(task.start, task.goal, task.scene, 0.0, iterations=500).unwrap()
    below = gp.StateBatch(task.scene, motion.q).object_poses[:, :3, 3].mean(axis=0) - [0.0, 0.0, 0.2]
    away = np.array([5.0, 5.0, 0.1])
    passing = gp.MovingEntity(
        "cat", "pet", size=[0.2, 0.2, 0.1], t=[0.0, 9.0, 10.0, 20.0], position=np.stack([away, away, below, below])
    )
    scene = task.scene.with_moving(passing)
    now, later = (risk(motion, scene, impact, start_time=start) for start in (0.0, 15.0))
    assert now.expected == pytest.approx(risk(motion, task.scene, impact).expected)
    assert later.expected > 1.1 * now.expected


def test_many_different_severities_go_on_a_grid(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    P = np.random.default_rng(0).uniform(size=len(scene.entities))
    exact = risk(still(scene), scene, cost(scene, dict(enumerate(P))))
    assert exact.exact
    monkeypatch.setattr(harm_law, "_MOST_SUMS", 7)
    coarse = risk(still(scene), scene, cost(scene, dict(enumerate(P))))
    assert not coarse.exact and len(coarse.value) <= 7 + len(scene.entities)
    assert coarse.expected == pytest.approx(exact.expected)
    assert exact.cvar - 1e-9 <= coarse.cvar <= exact.cvar * 1.25
    assert coarse.conceivable == exact.conceivable


def test_nothing_can_be_harmed(scene: Scene) -> None:
    found = risk(still(scene), scene, gp.ImpactCost(components=()))
    assert (found.expected, found.cvar, found.worst, found.conceivable, found.no_harm) == (0.0, 0.0, 0.0, 0.0, 1.0)
    assert risk(np.zeros((3, len(scene.joints))), scene, cost(scene, {})).no_harm == 1.0


def test_cvar_is_vectorised() -> None:
    value = np.array([0.0, 1.0, 4.0])
    p = np.random.default_rng(0).dirichlet(np.ones(3), size=(2, 3))
    for kind in ("expectation", "cvar", "worst"):
        measure = RiskMeasure(kind, 0.7)
        each = [[measure.of(value, row) for row in block] for block in p]
        np.testing.assert_allclose(measure.of(value, p), each)
    assert conditional_value_at_risk(value, p, 0.0) == pytest.approx(p @ value)


def test_text_and_document(scene: Scene) -> None:
    found = risk(still(scene), scene, cost(scene, {0: 0.04}))
    assert "CVaR 0.9" in str(found)
    document = json.loads(json.dumps(found.to_document(), allow_nan=False))
    assert document["schema"] == "graceful_plan.risk"
    assert document["cvar"] == pytest.approx(found.cvar)
    assert document["distribution"]["probability"] == pytest.approx([0.96, 0.04])


@pytest.mark.parametrize("level", [-0.1, 1.0, 1.5, np.nan, np.inf])
def test_levels_outside_of_the_range_are_refused(scene: Scene, level: float) -> None:
    with pytest.raises(SettingError, match="level"):
        risk(still(scene), scene, level=level)
    with pytest.raises(SettingError, match="level"):
        RiskMeasure("cvar", level)


def test_misuse_is_refused(scene: Scene) -> None:
    with pytest.raises(UnknownNameError, match=r"'var'.*cvar, expectation, worst"):
        RiskMeasure("var")
    with pytest.raises(ShapeError, match="path"):
        risk(np.zeros((2, 3)), scene)
    with pytest.raises(NonFiniteError):
        risk(still(scene) + np.nan, scene)
    with pytest.raises(SettingError, match="an ImpactCost"):
        HarmLaw(gp.JointLength(), scene)
    with pytest.raises(SettingError, match="start_time"):
        risk(still(scene), scene, start_time=np.inf)
    with pytest.raises(SettingError, match="impact"):
        risk(still(scene), scene, cost(scene, {0: 0.1})).exceeding(np.nan)
    broken = cost(scene, {0: np.nan})
    with pytest.raises(CostError, match="NaN"):
        risk(still(scene), scene, broken)


@pytest.mark.long
def test_the_guide_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROOT / "docs" / "risk.md").read_text()
    snippets = re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    assert len(snippets) == 2
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(snippets), "risk.md", "exec"), {})
    assert "CVaR 0.9" in capsys.readouterr().out

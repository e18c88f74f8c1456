"""Sensitivity to severities: no change without spread, ties, closed forms for two paths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from scipy.stats import kendalltau, rankdata

import graceful_plan as gp
from graceful_plan.analysis.sensitivity import sensitivity_to, severity_sensitivity
from graceful_plan.exceptions import SettingError, ShapeError


@pytest.fixture(scope="module")
def paths(task: gp.Task) -> dict[str, gp.Path]:
    rng = np.random.default_rng(0)
    middle = 0.5 * (task.start + task.goal[0]) + rng.normal(0.0, 0.4, (6, 7))
    return {f"via {i}": gp.Path(np.stack([task.start, q, task.goal[0]])) for i, q in enumerate(middle)}


OBJECTIVE = gp.Objective(impact=gp.ImpactCost(model="mixture"), w=2.0)


def test_without_spread_nothing_changes(task: gp.Task, paths: dict[str, gp.Path]) -> None:
    report = severity_sensitivity(paths, task.scene, OBJECTIVE, spread=0.0, n=20)
    costs = [gp.evaluate(path, task.scene, OBJECTIVE) for path in paths.values()]
    assert report.names == tuple(paths)
    np.testing.assert_allclose(report.motion, [cost.motion for cost in costs])
    np.testing.assert_allclose(report.impact, [cost.impact for cost in costs])
    np.testing.assert_allclose(report.total, [cost.total for cost in costs])
    for ends in (0, 1):
        np.testing.assert_allclose(report.impact_interval[:, ends], report.impact)
        np.testing.assert_allclose(report.total_interval[:, ends], report.total)
        np.testing.assert_array_equal(report.rank_interval[:, ends], report.rank)
    np.testing.assert_array_equal(report.rank, rankdata(report.total))
    assert (report.tau == 1.0).all() and (report.tau_impact == 1.0).all()
    assert report.best.tolist() == [float(rank == 1.0) for rank in report.rank]
    assert report.least_impact[np.argmin(report.impact)] == 1.0


def test_spread_widens_and_seeds_decide(task: gp.Task, paths: dict[str, gp.Path]) -> None:
    little, much, again, other = (
        severity_sensitivity(paths, task.scene, OBJECTIVE, spread=spread, n=300, seed=seed)
        for spread, seed in ((0.1, 0), (1.0, 0), (1.0, 0), (1.0, 1))
    )
    width = [np.ptp(report.impact_interval, axis=1) for report in (little, much)]
    assert (width[1] > 3.0 * width[0]).all() and (width[0] > 0.0).all()
    assert (little.impact_interval[:, 0] < little.impact).all() and (little.impact < little.impact_interval[:, 1]).all()
    assert much.tau.mean() <= little.tau.mean()
    np.testing.assert_array_equal(much.tau, again.tau)
    np.testing.assert_array_equal(much.impact_interval, again.impact_interval)
    assert (much.impact_interval != other.impact_interval).any()
    for report in (little, much):
        assert report.best.sum() == pytest.approx(1.0) and report.least_impact.sum() == pytest.approx(1.0)
        assert ((report.rank_interval >= 1.0) & (report.rank_interval <= len(paths))).all()


def test_identical_paths_share_everything(task: gp.Task, paths: dict[str, gp.Path]) -> None:
    path = paths["via 0"]
    report = severity_sensitivity([path, gp.Path(path.q.copy())], task.scene, OBJECTIVE, spread=1.0, n=200)
    assert report.names == ("path 0", "path 1")
    assert report.best.tolist() == [0.5, 0.5] and report.least_impact.tolist() == [0.5, 0.5]
    assert report.rank.tolist() == [1.5, 1.5] and report.rank_interval.tolist() == [[1.5, 1.5]] * 2
    assert (report.tau == 1.0).all()


def test_no_severity_no_sensitivity(task: gp.Task, paths: dict[str, gp.Path]) -> None:
    harmless = task.scene.with_severity(dict.fromkeys([*task.scene.entities, "carried"], 0.0))
    report = severity_sensitivity(paths, harmless, OBJECTIVE, spread=2.0, n=50)
    assert not report.impact.any() and not report.impact_interval.any()
    assert report.best[np.argmin(report.motion)] == 1.0 and (report.tau == 1.0).all()
    assert report.least_impact.tolist() == pytest.approx([1.0 / len(paths)] * len(paths))


def test_an_entity_without_severity_changes_nothing_else() -> None:
    factors = np.exp(np.random.default_rng(0).normal(size=(500, 3)))
    motion, by_entity = np.array([1.0, 2.0]), np.array([[1.0, 2.0, 0.0], [0.5, 1.0, 0.0]])
    three = sensitivity_to(("a", "b"), 1.0, motion, 1.0, by_entity, factors)
    two = sensitivity_to(("a", "b"), 1.0, motion, 1.0, by_entity[:, :2], factors[:, :2])
    np.testing.assert_allclose(three.total_interval, two.total_interval)
    np.testing.assert_array_equal(three.tau, two.tau)


def test_closed_form_of_two_paths() -> None:
    """Each path threatens another entity: the ratio of their impacts is log-normal."""
    spread, n = 0.5, 40_000
    factors = np.exp(spread * np.random.default_rng(1).normal(size=(n, 2)))
    report = sensitivity_to(("a", "b"), spread, np.zeros(2), 3.0, np.array([[1.0, 0.0], [0.0, 1.5]]), factors)
    expected = NormalDist().cdf(math.log(1.5) / (spread * math.sqrt(2.0)))
    assert report.best[0] == pytest.approx(expected, abs=0.01)
    assert report.tau.mean() == pytest.approx(2.0 * expected - 1.0, abs=0.02)
    low, high = (math.exp(spread * NormalDist().inv_cdf(p)) for p in (0.025, 0.975))
    assert report.impact_interval[0].tolist() == pytest.approx([low, high], rel=0.03)


def test_tau_and_ranks_equal_those_of_scipy() -> None:
    rng = np.random.default_rng(2)
    factors, by_entity, motion = np.exp(rng.normal(size=(40, 5))), rng.random((7, 5)), rng.random(7)
    report = sensitivity_to(tuple("abcdefg"), 1.0, motion, 0.7, by_entity, factors)
    totals = motion + 0.7 * factors @ by_entity.T
    expected = [kendalltau(report.total, row)[0] for row in totals]
    np.testing.assert_allclose(report.tau, expected, atol=1e-12)
    ranks = np.array([rankdata(row) for row in totals])
    np.testing.assert_allclose(report.rank_interval, np.quantile(ranks, (0.025, 0.975), axis=0).T)
    np.testing.assert_allclose(report.best, (ranks == 1.0).mean(axis=0))


def test_motions_of_every_kind(task: gp.Task, paths: dict[str, gp.Path]) -> None:
    path = paths["via 1"]
    motions = [path, path.q, gp.retime(path, task.scene.limits)]
    report = severity_sensitivity(motions, task.scene, OBJECTIVE, n=10)
    assert report.impact[0] == report.impact[1] > 0.0


def test_table(task: gp.Task, paths: dict[str, gp.Path]) -> None:
    text = str(severity_sensitivity(paths, task.scene, OBJECTIVE, n=10))
    lines = text.splitlines()
    assert lines[0].split()[:3] == ["path", "motion", "impact"]
    assert [line[:5] for line in lines[2:-1]] == list(paths)
    assert "10 draws" in lines[-1] and "Kendall" in lines[-1]


@dataclass(frozen=True)
class Own(gp.Cost):
    """A cost of unknown structure."""

    def state(self, batch: gp.StateBatch) -> np.ndarray:
        return np.ones(len(batch))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"spread": -0.1}, "spread = -0.1"),
        ({"spread": math.nan}, "spread = nan"),
        ({"n": 0}, "n = 0"),
        ({"n": 10**9}, "n = 1000000000"),
        ({"seed": -1}, "seed = -1"),
        ({"paths": []}, "at least one path"),
        ({"objective": gp.Objective(impact=Own())}, "an ImpactCost, a sum over severities"),
    ],
)
def test_misuse(task: gp.Task, paths: dict[str, gp.Path], change: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"paths": paths, "scene": task.scene} | change
    with pytest.raises(SettingError, match=message):
        severity_sensitivity(**given)


def test_a_path_of_another_robot(task: gp.Task) -> None:
    with pytest.raises(ShapeError):
        severity_sensitivity([np.zeros((2, 3))], task.scene)

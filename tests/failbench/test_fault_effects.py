"""The library's table of fault effects names the faults that FailBench has, without importing it; fits of effects."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from failbench.effects_fit import FaultEvents, fault_events, fit_effects, most_likely, predicted, write
from failbench.failures import Failures
from failbench.faults import DEGREES, faults
from graceful_plan import SettingError, fault_prior, load_scene
from graceful_plan.exceptions import ShapeError
from graceful_plan.fault_prior import GENERATORS, FaultPrior, presets, shipped_effects


def test_the_shipped_effects_are_those_of_the_faults_that_there_are():
    assert list(shipped_effects()) == list(faults())
    assert tuple(DEGREES) == fault_prior.DEGREES


@pytest.mark.parametrize("name", presets())
def test_presets_name_faults_that_there_are(name):
    assert set(FaultPrior.preset(name).rates) <= set(faults())


# --- the fit ----------------------------------------------------------------------------------------------------------


def draw(shares, n=40_000, motions=50, seed=0, concentration=(0.2, 1.0)):
    """Events of a fault that acts like each generator with some probability."""
    rng = np.random.default_rng(seed)
    probability = rng.beta(*concentration, size=(n, len(GENERATORS)))
    kind = rng.choice(len(GENERATORS) + 1, size=n, p=[*shares, 1.0 - sum(shares)])
    chance = np.column_stack([probability, np.zeros(n)])[np.arange(n), kind]
    motion = rng.integers(motions, size=n)
    return FaultEvents(
        probability=probability,
        happened=rng.random(n) < chance,
        motion=motion,
        scene=np.where(motion % 2 == 0, "desk", "kitchen"),
    )


def likelihood(events, shares):
    P = predicted(events.probability, np.asarray(shares))
    return np.where(events.happened, np.log(P), np.log1p(-P)).sum()


TRUE = (0.5, 0.1, 0.0, 0.25, 0.0, 0.05)


def test_the_truth_is_found_and_lies_in_the_intervals():
    effect = fit_effects({"weak_grip": draw(TRUE, n=10_000)}, resamples=40, seed=1)["weak_grip"]
    for name, true in zip(GENERATORS, TRUE, strict=True):
        share = effect.shares[name]
        assert share.value == pytest.approx(true, abs=0.06)
        # 99.7 % intervals, so that luck decides seldom
        half = 0.5 * (share.high - share.low)
        assert share.low - 0.5 * half - 0.01 <= true <= share.high + 0.5 * half + 0.01
        assert half < 0.08
    assert effect.motions == 50
    assert effect.fitted.ratio == pytest.approx(1.0, abs=0.02)
    assert effect.held_out is not None and effect.held_out.events == effect.fitted.events
    assert effect.held_out.log_loss >= effect.fitted.log_loss - 1e-9


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6))
def test_no_other_shares_are_likelier(seed, other):
    rng = np.random.default_rng(seed)
    true = rng.dirichlet(np.full(7, 0.3))[:6]
    events = draw(true, n=400, seed=seed)
    shares, gap = most_likely(events.probability, events.happened)
    assert (shares >= 0.0).all() and shares.sum() <= 1.0 + 1e-9
    assert gap <= 1e-4
    assert likelihood(events, shares) >= likelihood(events, np.array(other) / max(1.0, sum(other))) - gap - 1e-9
    assert likelihood(events, shares) >= likelihood(events, true) - gap - 1e-9


def test_weights_count_like_repetitions():
    events = draw(TRUE, n=500)
    weight = np.random.default_rng(2).integers(0, 4, size=500)
    rows = np.repeat(np.arange(500), weight)
    weighted, _ = most_likely(events.probability, events.happened, weight.astype(float))
    repeated, _ = most_likely(events.probability[rows], events.happened[rows])
    np.testing.assert_allclose(weighted, repeated, atol=1e-5)


def test_ends_of_the_range():
    events = draw(TRUE, n=300)
    never, always = np.zeros(300, bool), np.ones(300, bool)
    assert most_likely(events.probability, never)[0].sum() == pytest.approx(0.0, abs=1e-6)
    assert most_likely(events.probability, always)[0].sum() == pytest.approx(1.0)
    # One generator that is always right, and others that say nothing.
    probability = np.zeros((300, 6))
    probability[:, 3] = events.happened
    np.testing.assert_allclose(most_likely(probability, events.happened)[0], [0, 0, 0, 1, 0, 0], atol=1e-3)
    assert not most_likely(np.zeros((300, 6)), events.happened)[0].any()


def test_generators_that_say_the_same_share():
    events = draw((0.6, 0.0, 0.0, 0.0, 0.0, 0.0))
    probability = events.probability.copy()
    probability[:, 4] = probability[:, 0]
    shares, gap = most_likely(probability, events.happened)
    assert gap <= 1e-4 and shares[0] + shares[4] == pytest.approx(0.6, abs=0.03)


def test_one_scene_cannot_be_held_out():
    events = draw(TRUE, n=200).rows(np.arange(200) < 50)
    alone = events.rows(events.scene == "desk")
    assert fit_effects({"noise": alone}, resamples=2)["noise"].held_out is None


def test_what_is_written_is_read(tmp_path, monkeypatch):
    effects = fit_effects({"noise": draw(TRUE, n=2000), "dropout": draw((0.0,) * 6, n=2000)}, resamples=5)
    file = tmp_path / "fault_effects.yaml"
    write(file, effects, degree="moderate", seed=0, about={"scenes": ["desk"], "failures": 12})
    table = yaml.safe_dump({"effects": yaml.safe_load(file.read_text())["effects"]})
    (tmp_path / "faults.yaml").write_text("version: 1\npresets: {mine: {noise: 1, dropout: 1}}\n" + table)
    prior = FaultPrior.load(tmp_path / "faults.yaml", degree="moderate")
    for name in GENERATORS:
        assert prior.effects["noise"].get(name, 0.0) == pytest.approx(effects["noise"].shares[name].value, abs=1e-4)
    assert sum(prior.effects["dropout"].values()) == pytest.approx(0.0, abs=1e-3)
    about = yaml.safe_load(file.read_text())
    assert about["version"] == 1 and about["provenance"]["failures"] == 12 and about["provenance"]["seed"] == 0
    assert set(about["provenance"]["intervals"]["moderate"]["noise"]) <= set(GENERATORS)
    # It can stand in for the shipped file.
    monkeypatch.setattr(fault_prior, "_EFFECTS", file)
    fault_prior._shipped_effects.cache_clear()
    try:
        assert set(shipped_effects("moderate")) == {"noise", "dropout"}
    finally:
        fault_prior._shipped_effects.cache_clear()


def test_failures_become_events():
    hit = np.zeros((4, 2, 3), bool)
    hit[1, 0, 2] = hit[3, 1, 0] = True
    counted = np.array([[True, True, True], [True, True, False]])
    part = Failures(
        scene="desk",
        task="t",
        motion="",
        grasp="weld",
        components=("body", "carried"),
        entities=("a", "b", "c"),
        categories=("glass",) * 3,
        faults=("noise", "dropout"),
        counted=counted,
        fault=np.array([0, 1, 1, 0]),
        q=np.zeros((4, 7)),
        qd=np.zeros((4, 7)),
        ahead=np.zeros((4, 2, 7)),
        hit=hit,
        dropped=np.zeros(4, bool),
        spilled=np.zeros(4),
    )

    def model(scene, failures):
        assert failures is part
        return {"stray": np.arange(24.0).reshape(4, 2, 3) / 24.0}

    found = fault_events([part, part], {("desk", "t"): load_scene("desk")}, model)
    assert list(found) == ["noise", "dropout"]
    noise = found["noise"]
    assert len(noise) == 20 and list(noise.motion) == [0] * 10 + [1] * 10 and set(noise.scene) == {"desk"}
    column = list(GENERATORS).index("stray")
    np.testing.assert_array_equal(noise.probability[:5, column], np.arange(5.0) / 24.0)
    np.testing.assert_array_equal(noise.probability[5:10, column], np.arange(18.0, 23.0) / 24.0)
    assert not np.delete(noise.probability, column, axis=1).any()
    assert list(np.flatnonzero(noise.happened)) == [8, 18]
    assert list(np.flatnonzero(found["dropout"].happened)) == [2, 12]


def test_misuse_is_refused():
    events = draw(TRUE, n=20)
    with pytest.raises(ShapeError, match=r"happened has shape \(10,\), expected \(20,\)"):
        replace(events, happened=events.happened[:10])
    with pytest.raises(ShapeError, match="probability has shape"):
        replace(events, probability=events.probability[:, :3])
    with pytest.raises(SettingError, match=r"probability = .*numbers in \[0, 1\]"):
        replace(events, probability=events.probability + 1.0)
    with pytest.raises(SettingError, match="at least one of noise"):
        fit_effects({"noise": events.rows(np.zeros(20, bool))})

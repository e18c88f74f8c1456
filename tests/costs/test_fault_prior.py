"""Fault priors: weights by hand, the shipped tables, broken files."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.costs.fault_prior import ARM, DEGREES, GENERATORS, FaultPrior, presets, shipped_effects
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError

_EFFECTS = {"slip": {"drop": 0.5, "spill": 0.25}, "jam": {"stuck": 1.0}, "hum": {}}
_shares = st.lists(st.floats(0.0, 1.0), min_size=len(GENERATORS), max_size=len(GENERATORS)).map(
    lambda x: dict(zip(GENERATORS, [v / max(1.0, sum(x)) for v in x], strict=True))
)
_rates = st.dictionaries(st.sampled_from(sorted(shipped_effects())), st.floats(1e-6, 1e3), min_size=1)


def test_weights_by_hand() -> None:
    prior = FaultPrior({"slip": 3.0, "jam": 1.0}, _EFFECTS)
    assert prior.rate == 4.0
    assert dict(prior.probabilities()) == {"slip": 0.75, "jam": 0.25}
    assert dict(prior.weights()) == dict.fromkeys(GENERATORS, 0.0) | {"drop": 0.375, "spill": 0.09375, "stuck": 0.25}
    shares = prior.fault_shares()
    assert tuple(shares) == GENERATORS
    assert {g: dict(row) for g, row in shares.items() if row} == {
        "drop": {"slip": 0.375},
        "spill": {"slip": 0.09375},  # half of them are dropped already
        "stuck": {"jam": 0.25},
    }


def test_arm_and_gripper_may_fail_together() -> None:
    prior = FaultPrior({"blackout": 1.0}, {"blackout": {"drop": 0.75, "collapse": 1.0, "spill": 1.0}})
    assert prior.weights()["drop"] == 0.75 and prior.weights()["collapse"] == 1.0
    assert prior.weights()["spill"] == prior.held_weights()["collapse"] == 0.25


@given(_rates, _shares)
def test_weights_are_probabilities_and_shares_add_up_to_them(rates: dict[str, float], row: dict[str, float]) -> None:
    prior = FaultPrior(rates, {**shipped_effects(), "noise": row})
    weights, shares = prior.weights(), prior.fault_shares()
    assert all(w >= 0.0 for w in weights.values())
    assert weights["drop"] + weights["spill"] <= 1.0 + 1e-9
    assert sum(weights[generator] for generator in ARM) <= 1.0 + 1e-9
    held = prior.held_weights()
    assert tuple(held) == ARM and all(0.0 <= held[generator] <= weights[generator] + 1e-12 for generator in ARM)
    assert sum(prior.probabilities().values()) == pytest.approx(1.0)
    for generator in GENERATORS:
        assert sum(shares[generator].values()) == pytest.approx(weights[generator])
        assert set(shares[generator]) <= set(rates)


@given(_rates, st.floats(1e-3, 1e3))
def test_only_the_ratios_of_rates_matter(rates: dict[str, float], factor: float) -> None:
    scaled = FaultPrior({fault: factor * rate for fault, rate in rates.items()})
    assert dict(scaled.weights()) == pytest.approx(dict(FaultPrior(rates).weights()))
    assert scaled.rate == pytest.approx(factor * FaultPrior(rates).rate)


def test_presets_have_the_documented_rates() -> None:
    assert presets() == ("drop_only", "arm", "service_robot")
    drop = FaultPrior.preset("drop_only")
    assert drop.weights()["drop"] == 1.0 and sum(drop.weights().values()) == 1.0
    arm, service = FaultPrior.preset("arm"), FaultPrior.preset("service_robot")
    assert set(arm.rates) | {"battery_degradation"} == set(service.rates) == set(shipped_effects())
    failing = [prior.rate - prior.rates["protective_stop"] for prior in (arm, service)]
    gripper = ("weak_grip", "gripper_failure", "stuck_gripper")
    assert sum(arm.rates[fault] for fault in gripper) < 0.3 * failing[0]
    assert sum(service.rates[fault] for fault in gripper) == pytest.approx(0.75 * failing[1], rel=0.01)
    assert 1.0 / failing[1] == pytest.approx(5.0, rel=0.02)  # hours, as documented in the file
    assert 1.0 / failing[0] == pytest.approx(500.0, rel=0.05)


def test_a_stop_is_a_stop_at_any_degree() -> None:
    for degree in DEGREES:
        try:
            row = shipped_effects(degree)["protective_stop"]
        except UnknownNameError:  # no effects are fitted at this degree
            continue
        assert dict(row) == {"stop": 1.0}
    weights = FaultPrior({"protective_stop": 1.0}).weights()
    assert dict(weights) == dict.fromkeys(GENERATORS, 0.0) | {"stop": 1.0}
    assert FaultPrior.preset("service_robot").weights()["stop"] == pytest.approx(0.2, abs=0.01)


def test_a_preset_has_its_name() -> None:
    service = FaultPrior.preset("service_robot")
    assert service.name == "service_robot"


def test_instances_are_values() -> None:
    prior = FaultPrior.preset("service_robot")
    twin = pickle.loads(pickle.dumps(prior))
    assert twin == prior and hash(twin) == hash(prior) and twin is not prior
    other = FaultPrior({"slip": 1.0}, _EFFECTS)
    assert other != prior and other == FaultPrior({"slip": 1.0}, dict(_EFFECTS))
    with pytest.raises(TypeError):
        prior.rates["noise"] = 1.0  # type: ignore[index]


def test_unknown_names_list_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"'slip'.*battery_degradation, .*weak_grip"):
        FaultPrior({"slip": 1.0})
    with pytest.raises(UnknownNameError, match=r"'fall'.*collapse, drop"):
        FaultPrior({"slip": 1.0}, {"slip": {"fall": 1.0}})
    with pytest.raises(UnknownNameError, match=r"'car'.*arm, drop_only, service_robot"):
        FaultPrior.preset("car")
    with pytest.raises(UnknownNameError, match=r"effects 'mild'.*severe"):
        FaultPrior.preset("arm", degree="mild")


@pytest.mark.parametrize(
    "rates",
    [{}, {"slip": 0.0}, {"slip": -1.0}, {"slip": math.nan}, {"slip": math.inf}] + [{"slip": 1.7e308, "jam": 1.7e308}],
)
def test_invalid_rates_are_refused(rates: dict[str, float]) -> None:
    with pytest.raises(SettingError, match=r"\[1/h\]"):
        FaultPrior(rates, _EFFECTS)


@pytest.mark.parametrize("row", [{"drop": -0.1}, {"drop": 1.1}, {"drop": math.nan}, {"joint": 0.7, "stuck": 0.4}])
def test_invalid_effects_are_refused(row: dict[str, float]) -> None:
    with pytest.raises(SettingError, match="effect"):
        FaultPrior({"slip": 1.0}, {"slip": row})


# --- files ------------------------------------------------------------------------------------------------------------

_FILE = """version: 1
presets:
  mine: {weak_grip: 2, slip: 1}
effects:
  severe:
    slip: {drop: 0.5}
"""


def _file(folder: Path, text: str) -> Path:
    file = folder / "faults.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_a_file_may_add_faults(tmp_path: Path) -> None:
    prior = FaultPrior.load(_file(tmp_path, _FILE))
    assert prior.name == "mine" and dict(prior.rates) == {"weak_grip": 2.0, "slip": 1.0}
    assert prior.effects["weak_grip"] == shipped_effects()["weak_grip"]
    assert prior.fault_shares()["drop"]["slip"] == pytest.approx(0.5 / 3.0)


def test_one_of_several_presets_has_to_be_named(tmp_path: Path) -> None:
    file = _file(tmp_path, "version: 1\npresets: {a: {noise: 1}, b: {dropout: 1}}\n")
    assert dict(FaultPrior.load(file, "b").rates) == {"dropout": 1.0}
    with pytest.raises(SettingError, match=r"presets .*: a, b"):
        FaultPrior.load(file)
    with pytest.raises(UnknownNameError, match=r"'c'.*a, b"):
        FaultPrior.load(file, "c")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("version: 1", "version: 2", r":1: only version 1"),
        ("presets:", "rates:", r":2: unknown key 'rates'"),
        ("weak_grip: 2", "weakgrip: 2", r":3: unknown key 'weakgrip' in .*; valid: .*weak_grip"),
        ("weak_grip: 2", "weak_grip: -2", r":3: the rate of weak_grip is below 0"),
        ("weak_grip: 2", "weak_grip: .nan", r":3: .*weak_grip is not finite"),
        ("weak_grip: 2", "weak_grip: often", r":3: .*weak_grip has to be a number"),
        ("{weak_grip: 2, slip: 1}", "{weak_grip: 0, slip: 0}", r":3: .*needs a positive rate"),
        ("severe:", "awful:", r":5: unknown key 'awful' .*; valid: minor, moderate, severe, critical"),
        ("drop: 0.5", "fall: 0.5", r":6: unknown key 'fall' .*; valid: drop, spill"),
        ("drop: 0.5", "drop: 1.5", r":6: effect of slip like drop = 1.5"),
        ("slip: {drop: 0.5}", "slip: [", r"broken YAML"),
    ],
)
def test_broken_files_name_the_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in _FILE
    with pytest.raises(SceneError, match=message):
        FaultPrior.load(_file(tmp_path, _FILE.replace(old, new)))


def test_the_time_until_a_failure_is_noticed_belongs_to_the_prior() -> None:
    prior = FaultPrior({"slip": 1.0}, _EFFECTS, noticed_after=0.1)
    assert prior != FaultPrior({"slip": 1.0}, _EFFECTS) and hash(prior) != hash(FaultPrior({"slip": 1.0}, _EFFECTS))
    assert pickle.loads(pickle.dumps(prior)) == prior
    assert dict(prior.weights()) == dict(FaultPrior({"slip": 1.0}, _EFFECTS).weights())
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(SettingError):
            FaultPrior({"slip": 1.0}, _EFFECTS, noticed_after=wrong)

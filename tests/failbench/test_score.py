"""Scores by hand, and the table of fragilities."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from failbench.faults import faults
from failbench.records import ContactEvent, Job, Rollout
from failbench.score import Fragility, FragilityTable, energy_impact, observed_impact, secondary_impact
from graceful_plan import SceneError, SettingError, SeverityTable

_JOB = Job(fault=faults()["complete_shutdown"](), onset=0.0, seed=0)


def _event(striker: str, entity: str, energy: float = 1.0, *, secondary: bool = False) -> ContactEvent:
    return ContactEvent(
        striker=striker,
        entity=entity,
        time=0.1,
        position=(0.0, 0.0, 0.0),
        peak_force=1.0,
        impulse=0.1,
        speed=1.0,
        energy=energy,
        secondary=secondary,
    )


def _rollout(*events: ContactEvent) -> Rollout:
    return Rollout(job=_JOB, onset=0.0, events=events)


@pytest.fixture(scope="module")
def scene() -> gp.Scene:
    scene = gp.load_scene("desk").tasks["bring_coffee"].scene
    return scene.with_severity(
        {"laptop": {"body": 20.0, "carried": 10.0, "contents": 30.0}, "phone": {"body": 4.0, "carried": 5.0}}
    )


def test_each_entity_counts_once_with_its_worst_component(scene: gp.Scene) -> None:
    rollout = _rollout(
        _event("carried", "laptop"), _event("body", "laptop"), _event("carried", "phone"), _event("contents", "phone")
    )
    phone = max(5.0, scene.entities["phone"].severity["contents"])
    assert observed_impact(rollout, scene) == 20.0 + phone
    assert secondary_impact(rollout, scene) == 0.0
    assert observed_impact(_rollout(), scene) == energy_impact(_rollout(), scene) == 0.0


def test_entities_that_only_others_hit_are_kept_apart(scene: gp.Scene) -> None:
    rollout = _rollout(
        _event("carried", "phone"),
        _event("laptop", "phone", secondary=True),
        _event("phone", "laptop", secondary=True),
        _event("plant", "laptop", secondary=True),
    )
    assert observed_impact(rollout, scene) == 5.0
    assert secondary_impact(rollout, scene) == 10.0


def test_energy_weighs(scene: gp.Scene) -> None:
    median = FragilityTable.shipped().rows["laptop"].median
    assert energy_impact(_rollout(_event("body", "laptop", median)), scene) == pytest.approx(10.0)
    assert energy_impact(_rollout(_event("body", "laptop", 0.0)), scene) == 0.0
    # A hard blow of the carried object can be worse than a soft one of the heavier arm.
    both = _rollout(_event("body", "laptop", 1e-6), _event("carried", "laptop", 1e3))
    assert energy_impact(both, scene) == pytest.approx(10.0)
    assert energy_impact(_rollout(_event("contents", "laptop", 0.0)), scene) == pytest.approx(15.0)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["body", "carried", "contents"]), st.sampled_from(["laptop", "phone"]), st.floats(0, 99)
        ),
        max_size=6,
    )
)
def test_energy_weighted_never_exceeds_observed(scene: gp.Scene, events: list[tuple[str, str, float]]) -> None:
    rollout = _rollout(*(_event(*event) for event in events))
    assert 0.0 <= energy_impact(rollout, scene) <= observed_impact(rollout, scene) + 1e-9


@given(st.floats(1e-3, 1e3), st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_fragility_is_a_distribution(median: float, a: float, b: float) -> None:
    row = Fragility(median, 0.5, 0.7)
    low, high = sorted((a, b))
    assert 0.0 <= row.probability(low) <= row.probability(high) <= 1.0
    assert row.probability(median) == pytest.approx(0.5)
    assert row.probability(0.0) == 0.0
    assert row.probability(median * 2.718281828459045**0.7) == pytest.approx(0.8413447, abs=1e-6)


def test_every_shipped_class_has_a_fragility() -> None:
    assert set(FragilityTable.shipped().rows) == set(SeverityTable.shipped().classes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("median: 0.55", "median: -1"), "median = -1.0, expected finite and above 0"),
        (("wetted: 0.5", "wetted: 2"), r"wetted = 2.0, expected in \[0, 1\]"),
        (("version: 1", "version: 2"), "only version 1"),
        (("other: ", "others: "), "unknown key 'others'"),
        (("median: 0.25", "mean: 0.25"), "unknown key 'mean'"),
    ],
)
def test_broken_tables_are_refused(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    import failbench.score

    text = (Path(failbench.score.__file__).parent / "fragility.yaml").read_text(encoding="utf-8")
    file = tmp_path / "fragility.yaml"
    file.write_text(text.replace(*change), encoding="utf-8")
    with pytest.raises(SceneError, match=message):
        FragilityTable.load(file)


@pytest.mark.parametrize("values", [{"median": 0.0}, {"spread": float("inf")}, {"wetted": -0.1}])
def test_fragility_out_of_range(values: dict[str, Any]) -> None:
    with pytest.raises(SettingError, match=next(iter(values))):
        Fragility(**({"median": 1.0, "wetted": 1.0, "spread": 0.7} | values))

"""Scores by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from failbench.fault.registry import faults
from failbench.recording.records import ContactEvent, Job, Rollout
from failbench.recording.score import energy_impact, observed_impact, secondary_impact
from graceful_plan.scene.harm.fragility import FragilityTable

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

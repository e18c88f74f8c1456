"""Scores computed by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from failbench.fault.registry import faults
from failbench.recording.records import ContactEvent, Rollout, RolloutRequest
from failbench.recording.score import energy_impact, impact_by_entity, observed_impact, own_loss, secondary_impact
from graceful_plan.scene.harm.fragility import Fragility, FragilityTable

_JOB = RolloutRequest(fault=faults()["complete_shutdown"](), onset=0.0, seed=0)


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


def test_components_and_entities_add_up(scene: gp.Scene) -> None:
    rollout = _rollout(
        _event("carried", "laptop"), _event("body", "laptop"), _event("carried", "phone"), _event("contents", "phone")
    )
    phone = 5.0 + scene.entities["phone"].severity["contents"]
    assert observed_impact(rollout, scene, own=False) == 10.0 + 20.0 + phone
    assert impact_by_entity(rollout, scene, own=False) == {"laptop": 30.0, "phone": phone}
    assert secondary_impact(rollout, scene) == 0.0
    assert observed_impact(_rollout(), scene) == energy_impact(_rollout(), scene) == own_loss(_rollout(), scene) == 0.0


def test_the_carried_object_counts_as_an_entity(scene: gp.Scene) -> None:
    table = FragilityTable.shipped()
    median = table.carried["medium"].median
    assert scene.carried is not None and scene.own_severity == 2.0
    assert own_loss(_rollout(_event("carried", "desk", median)), scene) == pytest.approx(1.0)
    # The hardest hit counts; papers are softer than the desk; the arm does not damage a released object.
    softly = _event("carried", "papers", 1.5 * median)
    assert own_loss(_rollout(_event("carried", "desk", median), softly), scene) == pytest.approx(1.0)
    assert own_loss(_rollout(softly, _event("body", "desk", 99.0)), scene) < 0.9
    assert own_loss(_rollout(_event("cat", "desk", 99.0, secondary=True)), scene) == 0.0
    fallen = Rollout(job=_JOB, onset=0.0, landings=(_event("carried", "", median),))
    assert own_loss(fallen, scene) == observed_impact(fallen, scene) == energy_impact(fallen, scene)
    assert own_loss(fallen, scene) == pytest.approx(1.0)
    assert observed_impact(fallen, scene, own=False) == energy_impact(fallen, scene, own=False) == 0.0
    assert impact_by_entity(fallen, scene) == {scene.carried.body: own_loss(fallen, scene)}
    never = FragilityTable({}, table.other, {"medium": Fragility(1e9, 0.0, 0.1)})
    assert own_loss(fallen, scene, never) < 1e-9
    dearer = scene.with_severity({"carried": {"medium": 50.0}})
    assert own_loss(fallen, dearer) == pytest.approx(25.0)
    assert own_loss(_rollout(_event("body", "desk")), gp.load_scene("desk")) == 0.0


def test_secondary_hits_are_counted_separately(scene: gp.Scene) -> None:
    rollout = _rollout(
        _event("carried", "phone"),
        _event("laptop", "phone", secondary=True),
        _event("phone", "laptop", secondary=True),
        _event("plant", "laptop", secondary=True),
    )
    assert observed_impact(rollout, scene, own=False) == 5.0
    assert secondary_impact(rollout, scene) == 10.0


def test_energy_weighs(scene: gp.Scene) -> None:
    median = FragilityTable.shipped().rows["laptop"].median
    assert energy_impact(_rollout(_event("body", "laptop", median)), scene) == pytest.approx(10.0)
    assert energy_impact(_rollout(_event("body", "laptop", 0.0)), scene) == 0.0
    # A hard blow of the carried object can be worse than a soft one of the heavier arm.
    both = _rollout(_event("body", "laptop", 1e-6), _event("carried", "laptop", 1e3))
    assert energy_impact(both, scene, own=False) == pytest.approx(10.0)
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

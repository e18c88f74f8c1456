"""`check_fault` reports faults that break their contract, and accepts sound ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from breaking import WELD, healthy_run
from motions import EVERY_DEGREE

from failbench import Fault
from failbench.fault.registry import StuckGripper, faults
from failbench.testing import check_fault
from graceful_plan.testing import ContractError


@dataclass(frozen=True, kw_only=True)
class Sound(Fault):
    """A fault that loses half of the gain."""

    NAME: ClassVar[str] = "sound"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "lost gain"
    AMOUNTS: ClassVar[Any] = EVERY_DEGREE
    FIELDS: ClassVar[Any] = ("actuator_gainprm",)

    def apply(self, plant, level):
        plant["actuator_gainprm"][plant.robot.actuators[plant.joints]] *= 1.0 - level * self.amount


def variant(**changes):
    """Return a class like `Sound` with other class data or methods."""
    return dataclass(frozen=True, kw_only=True)(type("Sound", (Sound,), changes))


def findings(fault):
    with pytest.raises(ContractError) as caught:
        check_fault(fault)
    return caught.value.findings


@pytest.mark.parametrize("name", list(faults()))
def test_our_own_are_sound(name):
    check_fault(faults()[name]())


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if fault.CATEGORY == "end_effector" else [pytest.mark.long])
        for name, fault in faults().items()
    ],
)
def test_our_own_are_sound_where_a_weld_holds(name):
    check_fault(faults()[name](), healthy_run(WELD))


def test_a_sound_fault_passes():
    check_fault(Sound())


def test_an_object_that_is_no_fault():
    assert findings("rust") == ("is not a failbench.Fault",)


@pytest.mark.parametrize(
    ("changes", "finding"),
    [
        ({"NAME": ""}, "has no NAME (ClassVar[str])"),
        ({"NAME": "noise"}, "has the NAME 'noise' of another fault"),
        ({"PARAMETER": 3}, "has no PARAMETER (ClassVar[str])"),
        (
            {"CATEGORY": "mood"},
            "has no CATEGORY that is one of actuator, sensor, end_effector, power, reaction, surroundings",
        ),
        ({"AMOUNTS": None}, "has no AMOUNTS (ClassVar[Mapping[str, float]])"),
        ({"AMOUNTS": {"minor": 1.0}}, "AMOUNTS has the degrees minor, expected minor, moderate, severe, critical"),
        (
            {"AMOUNTS": EVERY_DEGREE | {"severe": 0.1}},
            "AMOUNTS are [0.25, 0.5, 0.1, 1.0] from minor to critical, expected strictly rising or falling values",
        ),
        (
            {"AMOUNTS": EVERY_DEGREE | {"critical": float("nan")}},
            "AMOUNTS are [0.25, 0.5, 0.75, nan], expected finite numbers",
        ),
        ({"PERIOD": -1.0}, "PERIOD is -1.0, expected a finite time >= 0 s, or None"),
    ],
)
def test_class_data(changes, finding):
    assert findings(variant(**changes)()) == (finding,)


@pytest.mark.parametrize("name", ["dof_rust", "opt.gravity"])
def test_unknown_fields(name):
    (finding,) = findings(variant(FIELDS=(name,))())
    assert finding.startswith(f"FIELDS names {name!r}, which is not a field")


def test_a_class_that_is_not_frozen():
    class Loose(Sound):
        pass

    assert findings(Loose()) == ("is not a frozen dataclass",)


def test_undeclared_fields():
    (finding,) = findings(variant(FIELDS=())())
    assert finding.startswith("unknown model field (the fault's FIELDS name those it may write) 'actuator_gainprm'")


def test_unknown_targets():
    (finding,) = findings(Sound(targets=("elbow",)))
    assert finding.startswith("unknown target 'elbow'; valid: all, any, gripper, panda/joint1")


def test_a_fault_without_effect():
    def apply(self, plant, level):
        pass

    assert findings(variant(apply=apply)()) == tuple(f"changes nothing in the degree {d!r}" for d in EVERY_DEGREE)
    assert "changes nothing in the degree 'minor'" in findings(StuckGripper(closed=True))


def test_randomness_without_the_seed():
    def apply(self, plant, level):
        plant["actuator_gainprm"][0, 0] *= np.random.default_rng().random()

    assert findings(variant(apply=apply)()) == ("did different things for the same seed",)


def test_use_of_the_global_generator():
    def apply(self, plant, level):
        plant["actuator_gainprm"][0, 0] *= 0.5 + 0.0 * np.random.random()  # noqa: NPY002 - what is to be found

    assert findings(variant(apply=apply)()) == ("drew from numpy's global random state instead of plant.rng",)


def test_an_effect_that_is_not_undone():
    def apply(self, plant, level):
        Sound.apply(self, plant, level)
        plant.eq_active[0] = 1 - plant.eq_active[0]

    assert findings(variant(apply=apply)()) == (
        "is not undone at the end of its duration: changed permanently: eq_active",
    )


def test_a_write_into_read_only_data():
    def push(self, plant, level):
        Sound.apply(self, plant, level)
        plant.qvel[plant.robot.dofs] += 1e-3

    def improve(self, plant, level):
        Sound.apply(self, plant, level)
        plant.robot.kp[0] += 1.0

    assert findings(variant(apply=push)()) == ("apply() wrote into plant.qvel, which is read only",)
    assert findings(variant(apply=improve)()) == ("raised ValueError: assignment destination is read-only",)


def test_a_write_into_the_healthy_commands():
    def apply(self, plant, level):
        plant.healthy[...] = 0.0

    assert findings(variant(apply=apply)()) == ("raised ValueError: assignment destination is read-only",)


def test_a_write_of_nan():
    def apply(self, plant, level):
        plant.ahead[:, 0] = np.nan

    assert findings(variant(apply=apply)()) == ("wrote a NaN into command",)


def test_settings_without_json_form():
    @dataclass(frozen=True, kw_only=True)
    class Odd(Sound):
        about: object = 1j

    (finding,) = findings(Odd())
    assert finding.startswith("cannot be written as JSON and read again: Object of type complex is not JSON")


def test_all_findings_come_at_once():
    assert len(findings(variant(NAME="", PARAMETER="", CATEGORY="", AMOUNTS={}, FIELDS=("rust",))())) == 5

"""Laws of all faults: names, degrees, restoration, JSON form, custom faults."""

import dataclasses
import json

import numpy as np
import pytest
from breaking import Nothing, Record, healthy_run
from hypothesis import given
from hypothesis import strategies as st
from motions import EVERY_DEGREE
from mujoco.batch import MODEL_FIELDS

import failbench
from failbench import AtFraction, AtTime, Fault, RolloutRequest, Uniform, rollout_steps, run_rollouts
from failbench.fault.registry import DEGREES, PowerLoss, StuckGripper, faults, from_document, load_class, to_document
from graceful_plan.exceptions import FormatError, SettingError, UnknownNameError

NAMES = {
    "actuator": "complete_shutdown loose_joint limited_range partial_degradation gradual_degradation stuck_position"
    " increased_friction",
    "sensor": "noise bias_drift control_delay dropout scale_error dead_zone",
    "end_effector": "gripper_failure weak_grip stuck_gripper",
    "power": "battery_degradation voltage_drop power_loss",
}
ALL = [name for names in NAMES.values() for name in names.split()]


def test_there_are_the_nineteen_in_order():
    assert list(faults()) == ALL
    assert len(ALL) == 19
    assert failbench.faults() is faults()
    for category, names in NAMES.items():
        assert {faults()[name].CATEGORY for name in names.split()} == {category}


def test_the_list_of_faults_is_read_only():
    with pytest.raises(TypeError):
        faults()["mine"] = Nothing


@pytest.mark.parametrize("name", ALL)
def test_class_data(name):
    fault = faults()[name]
    assert fault.NAME == name
    assert set(fault.AMOUNTS) == set(DEGREES)
    steps = np.diff([fault.AMOUNTS[degree] for degree in DEGREES])
    assert (steps > 0).all() or (steps < 0).all()
    assert set(fault.FIELDS) <= MODEL_FIELDS
    assert len(set(fault.FIELDS)) == len(fault.FIELDS)
    expected = {"end_effector": ("gripper",), "power": ("robot",)}.get(fault.CATEGORY, ("any",))
    assert fault.TARGETS == expected


# --- effects -------------------------------------------------------------------------------------


def consequence(record, well):
    """Return the tool's greatest deviation (after a power loss: its displacement) plus the object's slip [m]."""
    reference = record.tool[0] if isinstance(record.job.fault, PowerLoss) else well.tool
    return np.linalg.norm(record.tool - reference, axis=1).max() + record.slip.max()


@pytest.mark.long
@pytest.mark.parametrize("name", ALL)
def test_degree_scales_the_consequence(name):
    seeds = range(4)
    well = [Record(Nothing(), seed=seed) for seed in seeds]
    means = [
        np.mean([consequence(Record(faults()[name](degree=degree), seed=seed), well[seed]) for seed in seeds])
        for degree in DEGREES
    ]
    # A weaker grip that still holds may differ by less than a millimetre.
    assert (np.diff(means) > -1e-4).all(), means
    assert means[3] > 2.0 * means[0] or name == "power_loss"
    if faults()[name].CATEGORY in ("actuator", "sensor"):
        assert (np.diff(means) > 0.0).all(), means


def same_model(a, b):
    # A dropped object may fall asleep; faults do not set this field.
    arrays = [name for name in MODEL_FIELDS if "." not in name and name != "tree_sleep_policy"]
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in arrays)


@pytest.mark.parametrize("name", ALL)
def test_temporary_faults_leave_the_model_as_it_was_bit_by_bit(name):
    done = healthy_run()
    record = Record(faults()[name](degree="critical", duration=0.1), horizon=0.2)
    assert same_model(record.model, done.world.model)
    meant = done.commands(record.onset_step, len(record.command))
    assert np.array_equal(record.command[50:], meant[50:])
    assert not record.data.eq_active[done.world.robot.locks].any()


def test_a_fault_shorter_than_a_step_lasts_a_step():
    done = healthy_run()
    record = Record(faults()["noise"](duration=1e-4), horizon=0.02)
    differs = (record.command != done.commands(record.onset_step, len(record.command))).any(axis=1)
    assert differs.tolist() == [True] + [False] * (len(differs) - 1)


def test_faults_change_the_model_while_they_last():
    for name in ALL:
        record = Record(faults()[name](degree="critical"), horizon=0.02)
        same = same_model(record.model, healthy_run().world.model)
        meant = healthy_run().commands(record.onset_step, len(record.command))
        assert not (same and np.array_equal(record.command, meant)), name


@pytest.mark.parametrize("ramp", [0.0, 0.1])
def test_native_rollouts_are_the_plain_loop(ramp):
    done = healthy_run()
    jobs = [
        RolloutRequest(fault=dataclasses.replace(cls(), ramp=ramp), onset=0.05 * i * done.duration, seed=i)
        for i, cls in enumerate(faults().values())
    ]
    for job, rollout in zip(jobs, run_rollouts(done, jobs, horizon=0.2), strict=True):
        *_, (_, data) = rollout_steps(done, job, horizon=0.2)
        body = done.world.carried_body
        pose = np.concatenate([data.qpos[done.world.model.jnt_qposadr[done.world.model.body_jntadr[body]] :][:7]])
        assert any(np.array_equal(_wxyz_xyz(pose), seen) for seen in rollout.poses.values()), job.fault.NAME


def _wxyz_xyz(qpos):
    return np.concatenate([qpos[3:7], qpos[:3]])


@pytest.mark.parametrize("name", ALL)
def test_targets_that_cannot_have_the_fault_are_refused(name):
    cls = faults()[name]
    able = set(cls.STRIKES)
    for target, part in (("gripper", "gripper"), ("panda/joint1", "joints"), ("all", "joints"), ("any", "joints")):
        if part in able:
            assert cls(targets=(target,)).targets == (target,)
        else:
            with pytest.raises(SettingError, match=f"targets = .*{name}"):
                cls(targets=(target,))
    assert cls(targets=("robot",)).targets == ("robot",)


@pytest.mark.parametrize("name", ALL)
def test_the_seed_decides_everything(name):
    fault = faults()[name]()
    first, second = Record(fault, seed=3, horizon=0.1), Record(fault, seed=3, horizon=0.1)
    assert np.array_equal(first.all, second.all)


# --- JSON form -----------------------------------------------------------------------------------

SETTINGS = {
    "degree": st.sampled_from(DEGREES),
    "ramp": st.floats(0.0, 2.0),
    "duration": st.none() | st.floats(1e-3, 2.0),
    "targets": st.lists(st.sampled_from(["any", "all", "panda/joint3", "robot", "gripper"]), max_size=3).map(tuple),
    "when": st.one_of(
        st.tuples(st.just(AtTime), st.tuples(st.floats(0.0, 10.0))),
        st.tuples(st.just(AtFraction), st.tuples(st.floats(0.0, 1.0))),
        st.tuples(st.just(Uniform), st.tuples(st.floats(0.0, 0.5), st.floats(0.5, 1.0))),
    ),
}
OWN_SETTINGS = {
    StuckGripper: {"closed": st.booleans()},
    PowerLoss: {"brake": st.sampled_from(["none", "delayed", "immediate"]), "grip": st.sampled_from(["lost", "kept"])},
}
GIVEN = st.sampled_from(list(faults().values())).flatmap(
    lambda cls: st.tuples(st.just(cls), st.fixed_dictionaries({}, optional=SETTINGS | OWN_SETTINGS.get(cls, {})))
)


def made(chosen):
    cls, settings = chosen
    if "when" in settings:
        onset, arguments = settings["when"]
        settings = settings | {"when": onset(*arguments)}
    if "targets" in settings:  # at least one target must be able to have the fault
        settings = settings | {"targets": (*settings["targets"], "robot")}
    return cls(**settings)


@given(chosen=GIVEN, seed=st.integers(0, 2**31), when=st.floats(0.0, 1.0))
def test_any_fault_leaves_finite_numbers_and_ends_in_time(chosen, seed, when):
    fault, done = made(chosen), healthy_run()
    record = Record(fault, when=when, seed=seed, horizon=0.12)
    assert np.isfinite(record.all).all() and np.isfinite(record.command).all()
    if fault.duration is not None and fault.duration < 0.1:
        assert same_model(record.model, done.world.model)
        assert np.array_equal(record.command[-1], done.commands(record.onset_step, len(record.command))[-1])


@given(chosen=GIVEN)
def test_json_form_and_back(chosen):
    fault = made(chosen)
    assert from_document(json.loads(json.dumps(to_document(fault), allow_nan=False))) == fault


def test_json_form_is_readable():
    assert to_document(PowerLoss(degree="minor", when=AtTime(0.5))) == {
        "fault": "power_loss",
        "degree": "minor",
        "ramp": 0.0,
        "duration": None,
        "targets": [],
        "when": {"onset": "at_time", "time": 0.5},
        "rates": [],
        "brake": "delayed",
        "grip": "lost",
    }


def test_missing_fields_have_their_defaults():
    assert from_document({"fault": "gradual_degradation"}) == faults()["gradual_degradation"]()
    assert from_document({"fault": "voltage_drop", "duration": None}).duration is None


@pytest.mark.parametrize(
    ("document", "error", "message"),
    [
        ({}, UnknownNameError, "unknown fault 'None'; valid: battery_degradation"),
        ({"fault": "rust"}, UnknownNameError, "unknown fault 'rust'"),
        ({"fault": ["noise"]}, UnknownNameError, "unknown fault"),
        (
            {"fault": "noise", "degre": "minor"},
            UnknownNameError,
            "unknown setting of the fault 'noise' 'degre'; valid: deg",
        ),
        ({"fault": "noise", "degree": "huge"}, SettingError, "degree = 'huge', expected one of minor"),
        ({"fault": "noise", "degree": 3}, SettingError, "degree = 3, expected a text"),
        ({"fault": "noise", "ramp": "long"}, SettingError, "ramp = 'long', expected a number"),
        ({"fault": "noise", "ramp": True}, SettingError, "ramp = True, expected a number"),
        ({"fault": "noise", "ramp": float("nan")}, SettingError, "ramp = nan, expected a finite time"),
        ({"fault": "noise", "duration": []}, SettingError, "duration = .*, expected a number"),
        ({"fault": "noise", "targets": "any"}, SettingError, "targets = 'any', expected a list of names"),
        ({"fault": "noise", "targets": [1]}, SettingError, "targets = .*, expected a list of names"),
        ({"fault": "stuck_gripper", "closed": 1}, SettingError, "closed = 1, expected true or false"),
        ({"fault": "noise", "when": 0.5}, SettingError, "when = 0.5, expected a mapping"),
        (
            {"fault": "noise", "when": {"onset": "later"}},
            UnknownNameError,
            "unknown onset 'later'; valid: at_fraction, at_time",
        ),
        ({"fault": "noise", "when": {"onset": "at_time"}}, SettingError, "expected also time"),
        (
            {"fault": "noise", "when": {"onset": "at_time", "at": 1}},
            UnknownNameError,
            "setting of the onset 'at_time' 'at'",
        ),
        (
            {"fault": "noise", "when": {"onset": "at_time", "time": -1}},
            SettingError,
            "time = -1.0, expected a finite time",
        ),
    ],
)
def test_wrong_documents_are_refused_by_name(document, error, message):
    with pytest.raises(error, match=message):
        from_document(document)


# --- custom faults -------------------------------------------------------------------------------

OWN = """
from __future__ import annotations
from dataclasses import dataclass
from typing import ClassVar
from failbench import Fault

@dataclass(frozen=True, kw_only=True)
class Own(Fault):
    size: float = 1.0
    count: int = 1
    NAME: ClassVar[str] = "own"

    def apply(self, plant, level):
        pass
"""


def test_a_custom_fault_is_loaded_and_has_a_json_form(tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    cls = load_class(f"{tmp_path / 'mine.py'}:Own")
    assert issubclass(cls, Fault)
    fault = cls(size=2.0, count=3)
    again = from_document(to_document(fault), {"own": cls})
    assert again == fault and isinstance(again.count, int)
    with pytest.raises(SettingError, match=r"count = 2\.5"):
        from_document(to_document(fault) | {"count": 2.5}, {"own": cls})
    with pytest.raises(UnknownNameError, match="unknown fault 'own'"):
        from_document(to_document(fault))


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("mine.py", "expected a file and a class in it"),
        ("absent.py:Own", "absent.py: there is no such file"),
        ("mine.py:Other", "mine.py: has no fault 'Other'; it has Own"),
        ("mine.py:Fault", "has no fault 'Fault'; it has Own"),
        ("broken.py:Own", "broken.py: cannot be run: ZeroDivisionError: division by zero"),
        ("mine.txt:Own", "mine.txt: expected a file whose name ends in .py"),
    ],
)
def test_unloadable_faults_are_refused_with_the_reason(where, message, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(OWN)
    (tmp_path / "mine.txt").write_text(OWN)
    (tmp_path / "broken.py").write_text("1 / 0")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FormatError, match=message):
        load_class(where)


def test_every_degree_is_one_of_the_contract():
    assert tuple(EVERY_DEGREE) == DEGREES

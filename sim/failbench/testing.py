"""A check that reports mistakes in a user-defined fault to its author.

    from failbench.testing import check_fault
    check_fault(MyFault())

It applies the fault to a robot, and compares its effects with the interface. All findings are reported together.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS

from failbench.fault.fault import CATEGORIES, DEGREES, REACTION, SURROUNDINGS, Fault
from failbench.fault.registry import faults, from_document, reactions, to_document
from failbench.recording.records import RolloutRequest
from failbench.rollouts.execution import Execution, execute
from failbench.rollouts.injection import Injection
from failbench.simulated.moving_entities import set_entity_poses
from failbench.simulated.states import STATE
from failbench.simulated.world import build_world
from failbench.surroundings.registry import disturbances, scene_with_intruder
from graceful_plan import GracefulPlanError, load_scene
from graceful_plan.array_types import Array
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.path import is_real
from graceful_plan.testing import ContractError

Findings = Iterator[str]

_STEPS = 200
"""Simulated steps after the onset."""
_SEED = 7


def check_fault(fault: object, execution: Execution | None = None) -> None:
    """Apply a fault to a robot in every degree, and report all violations of the interface of `Fault`.

    Args:
        fault: The `Fault` to check.
        execution: The healthy run to break; a short one by default.

    Raises:
        ContractError: If there are findings; it holds all of them.
    """
    if not isinstance(fault, Fault):
        raise ContractError(fault, ("is not a failbench.Fault",))
    findings = list(_check_class(type(fault)))
    if not findings:  # a fault without class data cannot be applied
        trials = _Trials(_short_execution(fault) if execution is None else execution)
        for check in _CHECKS:
            findings += _tried(check, fault, trials)
    if findings:
        raise ContractError(fault, tuple(dict.fromkeys(findings)))


def _tried(check: _Check, fault: Fault, trials: _Trials) -> list[str]:
    findings: list[str] = []
    try:
        findings.extend(check(fault, trials))
    except UnknownNameError as error:
        findings.append(str(error))
    except Exception as error:
        findings.append(f"raised {type(error).__name__}: {error}")
    return findings


@cache
def _short_execution(fault: Fault) -> Execution:
    """Return a short execution in a scene that meets the fault's needs."""
    task = next(iter(load_scene("tabletop_l1").tasks.values()))
    scene = scene_with_intruder(fault, task.scene)
    if scene is task.scene and fault is not _NONE:
        return _short_execution(_NONE)
    return execute(np.stack([task.start, np.atleast_2d(task.goal)[0]]), build_world(scene))


_NONE = faults()["noise"]()
"""A fault without requirements on the scene."""


def _check_class(cls: type[Fault]) -> Findings:
    parameters = vars(cls).get("__dataclass_params__")
    if parameters is None or not parameters.frozen:
        yield "is not a frozen dataclass"
    for name in ("NAME", "PARAMETER"):
        if not isinstance(getattr(cls, name, None), str) or not getattr(cls, name):
            yield f"has no {name} (ClassVar[str])"
    if getattr(cls, "CATEGORY", None) not in (*CATEGORIES, REACTION, SURROUNDINGS):
        yield f"has no CATEGORY that is one of {', '.join((*CATEGORIES, REACTION, SURROUNDINGS))}"
    ours = {**faults(), **reactions(), **disturbances()}.get(getattr(cls, "NAME", ""), cls)
    if ours is not cls:
        yield f"has the NAME {cls.NAME!r} of another fault"
    yield from _check_amounts(getattr(cls, "AMOUNTS", None))
    valid = {name for name in MODEL_FIELDS if "." not in name}
    for name in cls.FIELDS:
        if name not in valid:
            yield f"FIELDS names {name!r}, which is not a field of the model that simulations can change separately"
    if cls.PERIOD is not None and not (math.isfinite(cls.PERIOD) and cls.PERIOD >= 0.0):
        yield f"PERIOD is {cls.PERIOD!r}, expected a finite time >= 0 s, or None"


def _check_amounts(amounts: object) -> Findings:
    if not isinstance(amounts, Mapping):
        yield "has no AMOUNTS (ClassVar[Mapping[str, float]])"
        return
    if set(amounts) != set(DEGREES):
        yield f"AMOUNTS has the degrees {', '.join(map(str, amounts))}, expected {', '.join(DEGREES)}"
        return
    values = [amounts[degree] for degree in DEGREES]
    if not all(is_real(value) and math.isfinite(value) for value in values):
        yield f"AMOUNTS are {values}, expected finite numbers"
        return
    steps = np.diff(values)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        yield f"AMOUNTS are {values} from minor to critical, expected strictly rising or falling values"


class _Effect(dict[str, Array]):
    """State after one call of a fault: model fields, commands and constraints."""

    def same(self, other: _Effect, *, but: Array | None = None) -> bool:
        """Return whether two effects are bit-identical, except for some constraints."""
        return all(np.array_equal(_without(n, v, but), _without(n, other[n], but)) for n, v in self.items())

    def not_numbers(self) -> list[str]:
        """Return the names of arrays that contain a NaN."""
        return [name for name, values in self.items() if np.isnan(values.astype(float)).any()]


def _without(name: str, values: Array, constraints: Array | None) -> Array:
    return values if constraints is None or name != "eq_active" else np.delete(values, constraints)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Trace:
    """One trial: the healthy state, the effect of every call, and the final state."""

    healthy: _Effect
    effects: tuple[_Effect, ...]
    state: Array
    improper: tuple[str, ...]


class _Trials:
    """Applies faults to one execution in a plain loop, and records their effects."""

    def __init__(self, execution: Execution) -> None:
        self.execution = execution
        self.robot = execution.world.robot

    def run(self, fault: Fault) -> _Trace:
        execution = self.execution
        model = copy.copy(execution.world.model)
        data = mujoco.MjData(model)
        onset = 0.5 * execution.duration
        mujoco.mj_setState(model, data, execution.states[execution.checkpoint(onset)], STATE)
        injection = Injection(
            execution,
            RolloutRequest(fault=fault, onset=onset, seed=_SEED),
            _STEPS,
            fields={name: getattr(model, name) for name in fault.FIELDS},
            qpos=data.qpos,
            qvel=data.qvel,
            eq_active=data.eq_active,
            xfrc=data.xfrc_applied,
        )
        healthy = _effect(injection, 0)
        effects, improper = [], []
        for step in range(_STEPS):
            if injection.next == step:
                before = _untouchable(data)
                injection.act()
                improper += _differences(before, _untouchable(data))
                effects.append(_effect(injection, step))
                if effects[-1].not_numbers():
                    break  # the simulation would only diverge
            data.ctrl[:] = injection.plant.command[step]
            set_entity_poses(model, data, injection.plant.walk[step])
            mujoco.mj_step(model, data)
        state = np.concatenate([data.qpos, data.qvel])
        return _Trace(healthy=healthy, effects=tuple(effects), state=state, improper=tuple(improper))


def _effect(injection: Injection, step: int) -> _Effect:
    plant = injection.plant
    changed = {name: values.copy() for name, values in plant.fields.items()}
    sent = plant.command - plant.healthy
    sent[:step] = 0.0  # past steps
    walk = plant.walk[step:][:1].copy()
    return _Effect(changed, command=sent, eq_active=plant.eq_active.copy(), xfrc=plant.xfrc.copy(), walk=walk)


def _untouchable(data: mujoco.MjData) -> dict[str, Array]:
    """Copy the arrays that a fault may only read."""
    return {"qpos": data.qpos.copy(), "qvel": data.qvel.copy()}


def _differences(before: Mapping[str, Array], after: Mapping[str, Array]) -> list[str]:
    return [
        f"apply() wrote into plant.{name}, which is read only"
        for name, values in before.items()
        if not np.array_equal(values, after[name])
    ]


def _check_degrees(fault: Fault, trials: _Trials) -> Findings:
    for degree in DEGREES:
        trace = trials.run(dataclasses.replace(fault, degree=degree))
        yield from trace.improper
        if all(effect.same(trace.healthy) for effect in trace.effects):
            yield f"changes nothing in the degree {degree!r}"
        yield from _check_numbers(trace)


def _check_numbers(trace: _Trace) -> Findings:
    for effect in trace.effects:
        yield from (f"wrote a NaN into {name}" for name in effect.not_numbers())


def _check_ramp(fault: Fault, trials: _Trials) -> Findings:
    trace = trials.run(dataclasses.replace(fault, ramp=0.1))
    yield from trace.improper
    yield from _check_numbers(trace)


def _check_determinism(fault: Fault, trials: _Trials) -> Findings:
    before = _global_random_state()
    first, second = trials.run(fault), trials.run(fault)
    if before != _global_random_state():
        yield "drew from numpy's global random state instead of plant.rng"
    if any(effect.not_numbers() for effect in first.effects):
        return
    alike = len(first.effects) == len(second.effects) and all(
        a.same(b) for a, b in zip(first.effects, second.effects, strict=True)
    )
    if not alike or not np.array_equal(first.state, second.state):
        yield "did different things for the same seed"


def _global_random_state() -> tuple[bytes, int]:
    _, keys, position, *_ = np.random.get_state()  # noqa: NPY002 - to detect its use
    return np.asarray(keys).tobytes(), int(position)


def _check_restoration(fault: Fault, trials: _Trials) -> Findings:
    trace = trials.run(dataclasses.replace(fault, duration=0.1))
    weld = np.array([trials.robot.weld] if trials.robot.weld >= 0 else [], dtype=int)  # a cut weld stays cut
    last = trace.effects[-1]
    if not last.not_numbers() and not last.same(trace.healthy, but=weld):
        names = [name for name, values in trace.healthy.items() if not np.array_equal(values, last[name])]
        yield f"is not undone at the end of its duration: changed permanently: {', '.join(names)}"


def _check_document(fault: Fault, trials: _Trials) -> Findings:
    del trials
    document: Any = to_document(fault)
    try:
        again = from_document(json.loads(json.dumps(document, allow_nan=False)), {fault.NAME: type(fault)})
    except (TypeError, ValueError, GracefulPlanError) as error:
        yield f"cannot be written as JSON and read again: {error}; settings are numbers, texts and tuples of texts"
        return
    if again != fault:
        yield f"is not the same after being written as JSON and read again: {again}"


_Check = Callable[[Fault, _Trials], Findings]

_CHECKS: tuple[_Check, ...] = (
    _check_degrees,
    _check_ramp,
    _check_determinism,
    _check_restoration,
    _check_document,
)

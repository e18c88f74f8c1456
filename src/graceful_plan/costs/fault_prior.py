r"""Fault priors: the rate of each fault, and the generators (kinds of failure) that it triggers.

A fault (a dead motor, a weak grip) has a rate. Interaction models know only a few *generators*, kinds of failure. A
table of effects holds the probability that a fault f acts like each generator: :math:`d_f` that the object is dropped;
:math:`s_f` that contents leave a container that is still held, or that the robot stops by itself, which may spill them;
:math:`a_{fg}` that the arm moves like generator g. Arm and gripper may fail together: when all power is lost, both the
arm and the object fall. With the probability :math:`p_f` of each fault,

.. math:: w_{drop} = \sum_f p_f d_f, \qquad w_{spill} = \sum_f p_f (1 - d_f) s_f, \qquad w_g = \sum_f p_f a_{fg}

are the probabilities of the generators, and :math:`h_g = \sum_f p_f (1 - d_f) a_{fg}` that of a failing arm that still
holds the carried object.

Rates of the presets are in `faults.yaml`, effects in `fault_effects.yaml`; both files state their sources. Faults have
the names that FailBench uses; a user-defined fault needs its own row of effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType
from typing import final

from graceful_plan.exceptions import SettingError, UnknownNameError, names_file
from graceful_plan.regular_file import path_of
from graceful_plan.setting_checks import fraction, not_negative, positive
from graceful_plan.yaml_file import Block, read_yaml

FAILURES = ("drop", "spill", "collapse", "joint", "stuck", "stray")
"""Kinds of failure: the gripper lets go; contents leave a container that is held; no joint is powered; one joint is not
powered; one joint is frozen while the others move on; the arm deviates from its path."""
GENERATORS = (*FAILURES, "stop")
"""Kinds of failure, and the robot's protective stop."""
REACTIONS: Mapping[str, Mapping[str, float]] = MappingProxyType({"protective_stop": MappingProxyType({"stop": 1.0})})
"""Effects of deliberate reactions of the robot, for every degree; they are known, not fitted."""
ARM = ("collapse", "joint", "stuck", "stray")
"""Generators of the arm; they are mutually exclusive."""
DEGREES = ("minor", "moderate", "severe", "critical")
"""Degrees of severity of a fault, as in FailBench."""

_RATES = Path(__file__).parent / "faults.yaml"
_EFFECTS = Path(__file__).parent / "fault_effects.yaml"
_ROUNDING = 1e-9
_IN_THE_HAND = ("spill", "stop")
"""Generators that affect the contents only if the object is not dropped."""

_Table = Mapping[str, Mapping[str, float]]


def shipped_effects(degree: str = "severe") -> _Table:
    """Return the shipped effects of faults of a degree: by fault, then by generator.

    Raises:
        UnknownNameError: If the table does not have this degree.
    """
    return _of_degree(_shipped_effects(), degree)


@final
@dataclass(frozen=True)
class FaultPrior:
    """Rates and effects of faults.

    Args:
        rates: Rate of each fault [1/h]; faults without a rate never happen. Probabilities given a failure depend only
            on the ratios of the rates.
        effects: Probability that a fault acts like a generator, by fault, then by generator. That of "spill" is given
            that the object is not dropped. Rates may only name faults of this table. Default: the shipped effects of
            severe faults.
        name: Name of the prior.
        noticed_after: Time after which a monitor notices a failure of the arm and the robot stops [s]. The arm's
            generators then last only so long; drops and spills do not change. None: nothing stops the robot.

    Raises:
        UnknownNameError: If a fault or a generator does not exist.
        SettingError: If a rate is negative or not finite, all rates are 0, an effect is not a probability, or
            `noticed_after` is not a finite time > 0.

    Example:
        >>> prior = FaultPrior({"weak_grip": 0.5, "power_loss": 0.05})
        >>> prior.weights()["drop"] > 0.5
        True
    """

    rates: Mapping[str, float]
    effects: _Table = field(default_factory=shipped_effects, repr=False)
    name: str = "own"
    noticed_after: float | None = None

    def __post_init__(self) -> None:
        if self.noticed_after is not None:
            positive("noticed_after", self.noticed_after, "a finite time > 0 s, or None")
            object.__setattr__(self, "noticed_after", float(self.noticed_after))
        for fault, row in self.effects.items():
            _check_effects(fault, row)
        for fault, rate in self.rates.items():
            if fault not in self.effects:
                raise UnknownNameError("fault", fault, self.effects)
            not_negative(f"rate of {fault}", rate, "a finite number of at least 0 [1/h]")
        if not 0.0 < sum(self.rates.values()) < math.inf:
            raise SettingError("rates", dict(self.rates), "a positive one at least, and a finite sum [1/h]")
        rates = {fault: float(self.rates[fault]) for fault in self.effects if fault in self.rates}
        effects = {
            fault: MappingProxyType({name: float(share) for name, share in row.items()})
            for fault, row in self.effects.items()
        }
        object.__setattr__(self, "rates", MappingProxyType(rates))
        object.__setattr__(self, "effects", MappingProxyType(effects))

    def __hash__(self) -> int:
        effects = tuple((fault, tuple(sorted(row.items()))) for fault, row in sorted(self.effects.items()))
        return hash((tuple(sorted(self.rates.items())), effects, self.name, self.noticed_after))

    def __reduce__(self) -> tuple[type[FaultPrior], tuple[object, ...]]:
        # Read-only mappings cannot be pickled.
        effects = {fault: dict(row) for fault, row in self.effects.items()}
        return FaultPrior, (dict(self.rates), effects, self.name, self.noticed_after)

    @classmethod
    def preset(cls, name: str, *, degree: str = "severe") -> FaultPrior:
        """Return a prior that comes with the library: "drop_only", "arm" or "service_robot".

        Args:
            name: Name of the preset.
            degree: Degree of the faults; see `DEGREES`.

        Raises:
            UnknownNameError: If there is no such preset, or no effects for the degree.
        """
        return _preset(name, degree)

    @classmethod
    @names_file
    def load(cls, file: str | Path, name: str | None = None, *, degree: str = "severe") -> FaultPrior:
        """Read a prior from a YAML file laid out like `faults.yaml`.

        The file may also have `effects`, as in `fault_effects.yaml`; its rows replace shipped ones or add to them.

        Args:
            file: The file.
            name: Name of the preset in the file; None if there is only one.
            degree: Degree of the faults; see `DEGREES`.

        Raises:
            SceneError: If the file is malformed or has an invalid value, with the line.
            UnknownNameError: If the file has no such preset, or no effects for the degree.
            SettingError: If the file has several presets and `name` is None.
        """
        root = _versioned(read_yaml(path_of(file)), "presets", "effects")
        own, shipped = root.get("effects"), _shipped_effects()
        tables = {} if own is None else _read_effects(own)
        known = {key: {**shipped.get(key, {}), **tables.get(key, {})} for key in {*shipped, *tables}}
        effects = _of_degree(known, degree)
        presets = {key: _read_rates(rates, effects) for key, rates in root["presets"].items()}
        if name is None:
            if len(presets) != 1:
                raise SettingError("name", name, f"one of the presets of {file}: {', '.join(presets)}")
            name = next(iter(presets))
        if name not in presets:
            raise UnknownNameError("fault prior", name, presets)
        return cls(presets[name], effects, name)

    @property
    def rate(self) -> float:
        """Rate of all faults together [1/h]."""
        return math.fsum(self.rates.values())

    def probabilities(self) -> Mapping[str, float]:
        """Return the probability of each fault, given that one happens; they sum to 1."""
        return self._probabilities

    def weights(self) -> Mapping[str, float]:
        """Return the probability of each generator, given that a fault happens. Some faults act like two at once."""
        return self._weights

    def held_weights(self) -> Mapping[str, float]:
        """Return the probability of each of `ARM` with the object still in the gripper, given that a fault happens."""
        return self._held_weights

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        """Return the contribution of each fault to the weight of each generator: by generator, then by fault.

        Faults that contribute nothing are left out.
        """
        return self._fault_shares

    # Cached, because every evaluation of a motion reads them several times.

    @cached_property
    def _probabilities(self) -> Mapping[str, float]:
        total = self.rate
        return MappingProxyType({fault: rate / total for fault, rate in self.rates.items()})

    @cached_property
    def _weights(self) -> Mapping[str, float]:
        return _sums(self._fault_shares)

    @cached_property
    def _held_weights(self) -> Mapping[str, float]:
        held = {fault: p * (1.0 - self._effect(fault, "drop")) for fault, p in self._probabilities.items()}
        return _sums({g: {fault: p * self._effect(fault, g) for fault, p in held.items()} for g in ARM})

    @cached_property
    def _fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        found: dict[str, Mapping[str, float]] = {}
        for generator in GENERATORS:
            parts = {fault: p * self._share(fault, generator) for fault, p in self._probabilities.items()}
            found[generator] = MappingProxyType({fault: part for fault, part in parts.items() if part > 0.0})
        return MappingProxyType(found)

    def _effect(self, fault: str, generator: str) -> float:
        return self.effects[fault].get(generator, 0.0)

    def _share(self, fault: str, generator: str) -> float:
        held = 1.0 - self._effect(fault, "drop") if generator in _IN_THE_HAND else 1.0
        return held * self._effect(fault, generator)


def _sums(shares: Mapping[str, Mapping[str, float]]) -> Mapping[str, float]:
    return MappingProxyType({generator: math.fsum(parts.values()) for generator, parts in shares.items()})


def presets() -> tuple[str, ...]:
    """Return the names of the priors that come with the library."""
    return tuple(_shipped_rates())


def _check_effects(fault: str, row: Mapping[str, float]) -> None:
    for generator, share in row.items():
        if generator not in GENERATORS:
            raise UnknownNameError("generator", generator, GENERATORS)
        fraction(f"effect of {fault} like {generator}", share, "a probability")
    if math.fsum(row.get(generator, 0.0) for generator in ARM) > 1.0 + _ROUNDING:
        raise SettingError(f"effects of {fault}", dict(row), f"a sum of at most 1 over {', '.join(ARM)}")


# --- files ------------------------------------------------------------------------------------------------------------


@cache
def _preset(name: str, degree: str) -> FaultPrior:
    presets = _shipped_rates()
    if name not in presets:
        raise UnknownNameError("fault prior", name, presets)
    return FaultPrior(presets[name], shipped_effects(degree), name)


@cache
def _shipped_rates() -> Mapping[str, Mapping[str, float]]:
    root = _versioned(read_yaml(_RATES), "presets")
    return {name: _read_rates(rates, shipped_effects()) for name, rates in root["presets"].items()}


@cache
def _shipped_effects() -> Mapping[str, _Table]:
    fitted = _read_effects(_versioned(read_yaml(_EFFECTS), "provenance", "effects")["effects"])
    return {degree: MappingProxyType({**table, **REACTIONS}) for degree, table in fitted.items()}


def _versioned(root: Block, *keys: str) -> Block:
    root.only("version", *keys)
    root.check_version("fault priors")
    return root


def _read_rates(block: Block, faults: Mapping[str, object]) -> Mapping[str, float]:
    block.only(*faults)
    rates = {fault: rate.number() for fault, rate in block.items()}
    for fault, rate in block.items():
        if rates[fault] < 0.0:
            raise rate.error(f"the rate of {fault} is below 0")
    if not sum(rates.values()) > 0.0:
        raise block.error(f"{block.name} needs a positive rate")
    return rates


def _read_effects(block: Block) -> Mapping[str, _Table]:
    block.only(*DEGREES)
    tables: dict[str, _Table] = {}
    for degree, table in block.items():
        found: dict[str, Mapping[str, float]] = {}
        for fault, row in table.items():
            row.only(*GENERATORS)
            shares = {generator: share.number() for generator, share in row.items()}
            try:
                _check_effects(fault, shares)
            except SettingError as error:
                raise row.error(str(error)) from None
            found[fault] = MappingProxyType(shares)
        tables[degree] = MappingProxyType(found)
    return tables


def _of_degree(tables: Mapping[str, _Table], degree: str) -> _Table:
    if degree not in tables:
        raise UnknownNameError("degree with effects", degree, tables)
    return tables[degree]

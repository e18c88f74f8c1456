"""The coast model in the core: what it is told of a base, its failures and what stands around."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import reals
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.four_wheel import one_sided_ways
from graceful_plan.mobile.coast.tables import coast_tables
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

Array = np.ndarray

SKIDS = 1.2
"""Effective track over track above which a base is a skid-steer."""


def _turns_on(scene: Scene, settings: CoastSettings) -> float:
    """How far a base turns on after its wheels were let go, by its rate of turning squared [s^2/rad]."""
    assert scene.base is not None
    return settings.straightens if scene.base.slip > SKIDS else 1e6


@per_scene(most=4)
def coast_model(scene: Scene, settings: CoastSettings) -> _native.CoastModel:
    """Return the model in the core, for a scene with a base."""
    tables = coast_tables(scene)
    return _native.CoastModel(
        compile_scene(scene).kernels.core,
        entity=np.ascontiguousarray(tables.entity, dtype=np.int32),
        shape=reals(tables.shape),
        n_entity=len(scene.entities),
        **coasting_arrays(scene, settings),
    )


def coasting_arrays(scene: Scene, settings: CoastSettings) -> dict[str, Float[Array, "..."]]:
    """Return what the core needs to know of a base and of how it fails, by the names that it has there."""
    assert scene.base is not None
    tables = coast_tables(scene)
    ways = one_sided_ways(tables.body, settings)
    return {
        "outline": reals(tables.outline),
        "stops": reals(settings.stops(scene.base.load)),
        "constants": reals(
            [settings.reference_speed, settings.position_spread, settings.drift, _turns_on(scene, settings)]
        ),
        **{name: reals(value) for name, value in ways._asdict().items()},
        "astray": reals(settings.beside(scene.base)),
    }

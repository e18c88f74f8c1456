"""Builds the coast model in the C++ core from a scene and the coast settings."""

from __future__ import annotations

from typing import Any

import numpy as np

from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import reals
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.four_wheel import one_sided_trajectories
from graceful_plan.mobile.coast.tables import coast_tables
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

SKIDS = 1.2
"""Ratio of effective track to track above which a base is a skid-steer."""


def _turns_on(scene: Scene, settings: CoastSettings) -> float:
    """Angle a base still turns after its wheels are released, over its turning rate squared [s^2/rad]."""
    assert scene.base is not None
    return settings.straightens if scene.base.slip > SKIDS else 1e6


@per_scene(most=4)
def coast_model(scene: Scene, settings: CoastSettings) -> _native.CoastModel:
    """Return the native coast model of a scene with a base."""
    return _native.CoastModel(
        compile_scene(scene).kernels.core, n_entity=len(scene.entities), **shape_arrays(scene),
        **coasting_arrays(scene, settings),
    )  # fmt: skip


def shape_arrays(scene: Scene) -> dict[str, Any]:
    """Return what base and carried object may hit, by parameter names in the core.

    Only an object on an arm is examined on its own; one on the deck is within the footprint of the base.
    """
    assert scene.base is not None
    tables, components = coast_tables(scene), list(scene.components)
    on_arm = "carried" in components and scene.joints != scene.base.joints
    return {
        "entity": np.ascontiguousarray(tables.entity, dtype=np.int32),
        "shape": reals(tables.shape),
        "carried": components.index("carried") if on_arm else -1,
        "high_entity": np.ascontiguousarray(tables.high_entity, dtype=np.int32),
        "high_shape": reals(tables.high_shape),
        "height": reals(tables.high_range),
    }


def coasting_arrays(scene: Scene, settings: CoastSettings) -> dict[str, Any]:
    """Return the arrays and constants that describe a base and its failures, by their parameter names in the core."""
    assert scene.base is not None
    tables = coast_tables(scene)
    ways = one_sided_trajectories(tables.body, settings)
    return {
        "outline": reals(tables.outline),
        "stops": reals(settings.stops(scene.base.load)),
        "constants": {
            "reference_speed": settings.reference_speed,
            "position_spread": settings.position_spread,
            "drift": settings.drift,
            "straightens": _turns_on(scene, settings),
        },
        **{name: reals(value) for name, value in ways._asdict().items()},
        "astray": reals(settings.beside(scene.base)),
        "weak": reals(settings.unable_to_turn() if scene.base.slip > SKIDS else np.zeros((0, 3))),
    }

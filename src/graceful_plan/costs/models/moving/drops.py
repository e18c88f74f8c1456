r"""Hits on moving entities if the gripper lets go of the carried object at this state and time.

This is the drop model (specified in the docstring of `costs.models.drop`), with its constants, applied to a moving
entity: an upright box or cylinder with half sizes a, b, top Z and bottom B. Its position in W is p(t). Its deviation
from the prediction, in standard deviations sigma(t), is constant. P is the mean over sample positions of equal weight
(`whereabouts.py`), without those at which robot or object would have touched it before the failure. Directions u_i in
top view represent its shape; A_i is its reach along each. A disc has four directions, rotated to the relative motion of
object and entity. A box has its own two and, as a bound, the one across the relative motion.

.. code-block:: text

    t            when the gripper lets go;  T1 = fall(bottom - Z) + delay, T2: when it lands on a static target
    W            P that it lands on something lower than Z, or on nothing
    sweep(x0, x1, A, s) = product over i of box(u_i . (x0 + x1)/2, A_i + |u_i . (x1 - x0)|/2, s)
                 P that the object is within A of the entity at some time while its relative position goes from x0 to x1
    sp           standard deviation within the cell of a sample position; all of sigma if there is but one

    1. Flight    D = max over parts of sweep(r(T1), r(T2), A + part, s) S((top of the part - B)/0.02)
                 r(T) = c + o + (v + w x o) T - p(t + T),  s^2 = s0^2 + (sv T)^2 + sp^2
    2. Falls     G = min(B_l sweep(L' - p(t + T2 + 0.15), L' - p(t + T2 + 0.45), A + kb size, (sd^2 + sp^2)^(1/2)),
                         M_l P(it lands on the entity, and not where a wide top above the entity is))
                 B_l, L': mass that left supports higher than B, and its landing point, caught by wide tops as in the
                 drop model; M_l: mass that left them, caught or not. An object reaches an entity below a table only
                 over the table's edge
    3. Sides     H = (W' - W D) S((zs + height - B)/sh) sweep(..., A + (kl + tk Tm) size, ...)
                 from the landing point to the resting place, 0.3 s later
    P(carried) = 1 - (1 - W D)(1 - G)(1 - H);  P(contents) = P(carried), as they fall together

While the object falls, the entity moves on. Static targets higher than the entity catch the object with the mass of
their level, without regard to their position: a shelf beside a person shields her as much as one above her. The model
neglects which of several entities is hit first, that pedestrians may step aside, and that they may step onto fallen
objects.

P(body) is a rule of thumb that was never fitted: the entity is within 0.15 m of a moving link, with a tolerance of
0.1 m, and not above it. It shows where a collapsing arm could reach an entity, not how likely that is.

Without a time, P is the mean over the predicted path, with equal weights in time. The sample positions then take turns
along the path, and none of them counts as touched before. The core computes all of it (native/impact/moving); with
times, it also has derivatives.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import DropKernel
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.moving.position_samples import cell_of, normal_places, path_times
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene


@per_scene
def moving_table(scene: Scene) -> _native.MovingTable:
    """Return the predicted paths of a scene's moving entities, as the core takes them."""
    entities = list(scene.moving.values())
    knots = [np.column_stack([e.t, e.position, e.yaw]) for e in entities]
    times = [path_times(e) for e in entities]
    return _native.MovingTable(
        round=np.array([e.is_round for e in entities], dtype=np.int32),
        half=np.array([e.half_size for e in entities], dtype=np.float64).reshape(-1, 3),
        blur=np.array([[e.spread, e.growth] for e in entities], dtype=np.float64).reshape(-1, 2),
        knot_start=_starts([len(rows) for rows in knots]),
        knot=np.concatenate([np.zeros((0, 5)), *knots]),
        time_start=_starts([len(rows) for rows in times]),
        time=np.concatenate([np.zeros(0), *times]),
    )


@per_scene(most=4)
def moving_drop(scene: Scene, settings: DropSettings, places: int) -> _native.MovingDrop:
    """Return the native model of drops on moving entities, for a scene with a carried object.

    Args:
        scene: The scene.
        settings: Constants of the drop model.
        places: Number of sample positions for the uncertain position of a moving entity.

    Raises:
        UnsupportedError: If the core cannot represent the object or the targets.
    """
    tables, compiled = drop_tables(scene), compile_scene(scene)
    constants, count = settings.of(tables.shape_class), len(scene.entities)
    model = DropKernel(tables, constants, compiled.kernels, scene.limits.velocity, count).native
    return _native.MovingDrop(
        moving_table(scene),
        model,
        places=np.ascontiguousarray(normal_places(places)),
        cell=cell_of(places),
        protrusion=compiled.robot.protrusion,
    )


@per_scene
def moving_arm(scene: Scene) -> _native.MovingArm:
    """Return the native model of a collapsing arm that reaches moving entities."""
    return _native.MovingArm(moving_table(scene), compile_scene(scene).kernels.core)


def _starts(lengths: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)

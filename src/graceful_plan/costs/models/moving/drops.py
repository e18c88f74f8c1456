r"""Whom of those that move the carried object hits if the gripper lets go here, at this velocity, at this time.

The drop model (the docstring of `costs.models.drop` specifies it), with its constants, applied to a moving entity: an
upright box or cylinder with half sizes a, b, top Z and bottom B. It is at p(t) in W, off its prediction by as many
standard deviations sigma(t) all the while: P is the mean over some places of equal weight (`whereabouts.py`), without
those where robot or object would have touched it before anything failed. Directions u_i, seen from above, stand for
its shape; A_i is how far it reaches in each. A disc has four, turned to how object and entity pass each
other; a box has those of its own and, as a bound, the one across that passage.

.. code-block:: text

    t            when the gripper lets go;  T1 = fall(bottom - Z) + delay, T2: when it comes down on what is static
    W            P that it comes down on something lower than Z, or on nothing
    sweep(x0, x1, A, s) = product over i of box(u_i . (x0 + x1)/2, A_i + |u_i . (x1 - x0)|/2, s)
                 the object is within A of the entity at some time while its place relative to it goes from x0 to x1
    sp           standard deviation of what one place stands for; all of sigma where there is but one place

    1. Flight    D = max over parts of sweep(r(T1), r(T2), A + part, s) S((top of the part - B)/0.02)
                 r(T) = c + o + (v + w x o) T - p(t + T),  s^2 = s0^2 + (sv T)^2 + sp^2
    2. Falls     G = min(B_l sweep(L' - p(t + T2 + 0.15), L' - p(t + T2 + 0.45), A + kb size, (sd^2 + sp^2)^(1/2)),
                         M_l P(it comes down on the entity, and not where a wide top above it is))
                 B_l, L': what left supports higher than B and whereto, caught by wide tops as in the drop model; M_l
                 what left them, caught or not: nothing falls through a table on whom it covers, only over its edge
    3. Sides     H = (W' - W D) S((zs + height - B)/sh) sweep(..., A + (kl + tk Tm) size, ...)
                 from where it comes down to where it comes to rest, 0.3 s later
    P(carried) = 1 - (1 - W D)(1 - G)(1 - H);  P(contents) = P(carried), as they fall together

While the object falls, the entity goes on. What is static and higher than the entity catches the object by the mass of
its level, wherever that stands: a shelf beside a person hides as much of her as one above her. Nothing is known of what
is hit first if several entities are in its way, nor of those that step aside, or onto what lies on the floor.

P(body) is a rule of thumb that was never fitted: near a moving link, within 0.15 m, give or take 0.1 m, and not above
it. It says where a collapsing arm could reach somebody, not how likely it does.

Without a time, P is the mean over the predicted path, with equal weights in time; the places take turns along it, and
none of them is taken for touched. The core computes all of it (native/impact/moving); at times, with derivatives.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import DropKernel
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.moving.whereabouts import cell_of, normal_places, path_times
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
    """Return P that what is dropped hits each moving entity, for a scene in which something is carried.

    Args:
        scene: The scene.
        settings: Constants of the drop model.
        places: How many stand for where somebody may be who is expected somewhere.

    Raises:
        UnsupportedError: If the core cannot represent the object or what it may fall on.
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
    """Return P that a collapsing arm reaches each moving entity."""
    return _native.MovingArm(moving_table(scene), compile_scene(scene).kernels.core)


def _starts(lengths: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)

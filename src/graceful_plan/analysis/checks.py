"""Clearance and interaction probabilities of single configurations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.exceptions import ShapeError
from graceful_plan.path import finite_array
from graceful_plan.scene.scene import Scene


def clearance(q: ArrayLike, scene: Scene) -> Float[Array, "*batch"]:
    """Compute the signed clearance of the fast checker [m], to the surroundings and to the robot itself.

    Positive is free; infinite where there is nothing to hit. Spheres cover the robot and the carried object, so a
    positive value is a lower bound of the true clearance, less than 1 cm below it. All pairs that `plan` and `verify`
    test are counted: where the value is positive, they find no collision. A pair on one link, such as the carried
    object and the link behind the gripper, keeps its distance in all configurations: it is ignored if it is apart, and
    makes every value negative if it overlaps.

    Raises:
        ShapeError: If the last axis of q is not the number of joints.
        NonFiniteError: If q holds a NaN or an infinity.
    """
    return compile_scene(scene).proof.clearance(q)


def interaction_probability(
    q: ArrayLike, scene: Scene, model: str | InteractionModel = "box_overlap", qd: ArrayLike | None = None
) -> Float[Array, "*batch component entity"]:
    """Compute the probability that each component hits each entity, given that the robot fails at q.

    Args:
        q: Configurations [rad or m].
        scene: The scene; components and entities are in its order.
        model: An interaction model or its name; by default "box_overlap", Algorithm 1 of the paper, while the default
            of `ImpactCost` is "mixture".
        qd: Joint velocities [rad/s or m/s], for models that use them; at rest if None.

    Raises:
        ShapeError: If q or qd do not fit the scene's joints or each other.
        UnknownNameError: If there is no such model.
    """
    nq = len(scene.joints)
    positions = finite_array("q", q, last=nq)
    velocities = np.zeros_like(positions) if qd is None else finite_array("qd", qd, last=nq)
    try:
        positions, velocities = np.broadcast_arrays(positions, velocities)
    except ValueError:
        raise ShapeError("qd", velocities.shape, f"to broadcast with q {positions.shape}") from None
    flat = velocities.reshape(-1, nq)
    speed = np.linalg.norm(flat, axis=1)
    direction = flat / np.where(speed > 0.0, speed, 1.0)[:, None]
    probability = ImpactCost(model=model).interaction.probability(
        StateBatch(scene, positions.reshape(-1, nq), direction, speed)
    )
    return probability.reshape(*positions.shape[:-1], len(scene.components), len(scene.entities))

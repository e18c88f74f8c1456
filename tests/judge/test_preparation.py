"""Collision masks keep every pair that must not touch."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.preparation import prepare
from graceful_plan.scene.edit import StaticBody
from graceful_plan.scene.scene import Scene


def _tested(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    filters = prepare(scene).filters
    meets = (filters.contype[:, None] & filters.conaffinity[None, :]) != 0
    return filters.checked, meets | meets.T


def test_masks_keep_forbidden_pairs_and_few_others(scene: Scene) -> None:
    checked, tested = _tested(scene)
    assert tested[checked].all()
    assert not tested[~checked].any()


@pytest.mark.long
def test_a_scene_with_thousands_of_boxes_is_planned_in(scene: Scene) -> None:
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 14)] * 3), axis=-1).reshape(-1, 3) + [0.0, 0.0, 3.0]
    boxes = [StaticBody(name=f"box{k}", kind="box", size=[0.1] * 3, pose=place) for k, place in enumerate(grid)]
    crowded = scene.edit(add=boxes)
    checked, tested = _tested(crowded)
    assert tested[checked].all() and not tested[~checked].any()
    result = gp.plan("ready", "left", crowded, w=0.0, iterations=300)
    assert result.status is gp.PlanStatus.SOLVED

"""Marks in the scene: paths coloured by risk, the footprint of a failure, the risk map."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.viewer.fall import Coasting, Fall
from graceful_plan.viewer.risk_layer import RiskLayer, scale_colours
from graceful_plan.viewer.shown import ShownMotion

RISK = ("#2166ac", "#67a9cf", "#fddb6d", "#ef6548", "#b30000")
"""Colours of a path from no to maximum impact, visible on white and on black."""
_LEAST = 0.05
"""Minimum impact of the last colour."""
_PIECES = 120
_FALL, _FAR, _COAST = (214, 39, 40), (240, 140, 60), (180, 60, 160)
_ROUND = np.linspace(0.0, 2.0 * np.pi, 49)


def greatest_risk(motions: tuple[ShownMotion, ...]) -> float:
    """Return the impact of the last colour."""
    return max([_LEAST, *(float(motion.risk.max()) for motion in motions)])


def add_path(server: Any, name: str, motion: ShownMotion, greatest: float, *, thickness: float) -> Any:
    """Draw the path of the tool, coloured by the impact of a failure."""
    t = np.linspace(0.0, motion.duration, _PIECES + 1)
    at = np.array([motion.tool[motion.frame(x)] for x in t.tolist()])
    colours = scale_colours(motion.risk_at(t) / greatest, RISK)
    return server.scene.add_line_segments(
        name,
        np.stack([at[:-1], at[1:]], axis=1),
        np.stack([colours[:-1], colours[1:]], axis=1),
        thickness=thickness,
    )


@final
class Footprints:
    """Footprint of a drop or of a coasting base at the present moment."""

    def __init__(self, server: Any) -> None:
        self._flight = self._lines(server, "/footprint/flight", 0.006, _FALL)
        self._near = self._lines(server, "/footprint/near", 0.008, _FALL)
        self._far = self._lines(server, "/footprint/far", 0.004, _FAR)
        self._coast = self._lines(server, "/footprint/coast", 0.02, _COAST)

    @staticmethod
    def _lines(server: Any, name: str, thickness: float, colour: tuple[int, int, int]) -> Any:
        return server.scene.add_line_segments(name, np.zeros((1, 2, 3)), colour, thickness=thickness, visible=False)

    def show(self, fall: Fall | None, going_on: Coasting | None) -> None:
        """Draw both footprints; None hides one."""
        for handle, points in (
            (self._flight, None if fall is None else fall.flight),
            (self._near, None if fall is None else _circle(fall.centre, fall.radius)),
            (self._far, None if fall is None else _circle(fall.centre, fall.far)),
            (self._coast, None if going_on is None else _ribbon(going_on)),
        ):
            handle.visible = points is not None
            if points is not None:
                segments = points if points.ndim == 3 else np.stack([points[:-1], points[1:]], axis=1)
                handle.points = segments.astype(np.float32)


def _circle(centre: Float[Array, " 3"], radius: float) -> Float[Array, "n 3"]:
    return centre + np.column_stack([radius * np.cos(_ROUND), radius * np.sin(_ROUND), np.full(len(_ROUND), 0.006)])


def _ribbon(going_on: Coasting) -> Float[Array, "n 2 3"]:
    """Return both edges of the coasting path, with bars where half and nearly all failing bases have stopped."""
    arc = going_on.arc + [0.0, 0.0, 0.02]
    along = np.gradient(arc[:, :2], axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    aside = going_on.width * np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(arc))])
    left, right = arc + aside, arc - aside
    done = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(arc, axis=0), axis=1)))
    half = int(np.argmin(np.abs(done - going_on.half)))
    edges = [np.stack([side[:-1], side[1:]], axis=1) for side in (left, right)]
    return np.concatenate([*edges, np.stack([left[[half, -1]], right[[half, -1]]], axis=1)])


def add_layer(server: Any, layer: RiskLayer) -> Any:
    """Draw the risk map in the scene."""
    middle = layer.low + np.array([*(0.5 * layer.size), 0.0])
    return server.scene.add_image(
        "/risk_map",
        layer.pixels[::-1],  # the first row of an image is its top
        float(layer.size[0]),
        float(layer.size[1]),
        format="png",
        cast_shadow=False,
        receive_shadow=False,
        wxyz=(0.0, 1.0, 0.0, 0.0),  # the y axis of an image points down
        position=middle,
    )

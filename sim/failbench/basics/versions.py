"""Versions of what decides about results."""

from __future__ import annotations

from importlib import metadata

import graceful_plan as gp


def versions() -> dict[str, str]:
    """Return the versions of what decides about results."""
    return {"graceful_plan": gp.__version__} | {name: metadata.version(name) for name in ("mujoco", "numpy")}

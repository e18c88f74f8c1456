"""Versions of the packages that determine results."""

from __future__ import annotations

from importlib import metadata

import graceful_plan as gp


def versions() -> dict[str, str]:
    """Return the versions of the packages that determine results."""
    return {"graceful_plan": gp.__version__} | {name: metadata.version(name) for name in ("mujoco", "numpy")}

"""Rollouts as rows of a dataset, in plain JSON values. For the meaning of each column see `tables.py`."""

from __future__ import annotations

import json
import math
from typing import Any

from failbench.fault.registry import to_document
from failbench.recording.healthy import HealthyHarm, whole_execution
from failbench.recording.records import Rollout
from failbench.recording.score import energy_impact, observed_impact, own_loss, secondary_impact
from failbench.rollouts.execution import Execution
from graceful_plan import Scene


def rollout_row(rollout: Rollout, execution: Execution) -> dict[str, Any]:
    """Return the columns that describe a rollout."""
    job, scene = rollout.job, execution.world.scene
    return {
        "fault": job.fault.NAME,
        "category": job.fault.CATEGORY,
        "degree": job.fault.degree,
        "fault_settings": json.dumps(to_document(job.fault), sort_keys=True),
        "onset": rollout.onset,
        "duration": execution.duration,
        "seed": job.seed,
        "weight": job.weight,
        "status": rollout.status,
        "healthy_harm": _number(execution.healthy.harm),
        "healthy_spilled": _number(execution.healthy.spilled),
        **_consequences(rollout, execution.healthy, scene),
        "contacts": len(rollout.events),
        "fell": list(rollout.fell),
        "tipped": list(rollout.tipped),
        "left_support": list(rollout.left_support),
        "poses": [
            {"name": name, "wxyz_xyz": [_number(x) for x in pose]} for name, pose in sorted(rollout.poses.items())
        ],
        "state": None if rollout.state is None else [float(x) for x in rollout.state],
    }


_AVERAGED = ("observed_impact", "whole_impact", "own_loss", "energy_impact", "secondary_impact", "dropped", "spilled")


def _consequences(rollout: Rollout, healthy: HealthyHarm, scene: Scene) -> dict[str, Any]:
    """Return the consequences, which can be averaged; all are null for a diverged rollout, whose harm is unknown."""
    if rollout.status == "diverged":
        return dict.fromkeys(_AVERAGED)
    return {
        "observed_impact": _number(observed_impact(rollout, scene)),
        "whole_impact": _number(observed_impact(whole_execution(rollout, healthy), scene)),
        "own_loss": _number(own_loss(rollout, scene)),
        "energy_impact": _number(energy_impact(rollout, scene)),
        "secondary_impact": _number(secondary_impact(rollout, scene)),
        "dropped": bool(rollout.dropped),
        "spilled": _number(rollout.spilled),
    }


def contact_rows(number: int, rollout: Rollout) -> list[dict[str, Any]]:
    """Return a row for each contact event of a rollout with this number."""
    return [
        {
            "rollout": number,
            "striker": event.striker,
            "entity": event.entity,
            "secondary": bool(event.secondary),
            "time": _number(event.time),
            **{axis: _number(x) for axis, x in zip("xyz", event.position, strict=True)},
            "peak_force": _number(event.peak_force),
            "impulse": _number(event.impulse),
            "speed": _number(event.speed),
            "energy": _number(event.energy),
        }
        for event in rollout.events
    ]


def _number(value: Any) -> float | None:
    """Return a number, or null if it is not finite, as after divergence."""
    number = float(value)
    return number if math.isfinite(number) else None

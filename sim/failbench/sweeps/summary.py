"""Summaries of scenarios and rollouts for the command line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from failbench.basics.chunks import Rows
from failbench.basics.statistics import estimate_mean, estimate_probability
from failbench.recording.score import greatest_touch
from failbench.scenario import Scenario
from graceful_plan import Scene, documents


def families(scenarios: Iterable[Scenario]) -> str:
    """Return a table of useful patterns: scenes, tasks and families of faults, with numbers of scenarios."""
    counts: Counter[str] = Counter()
    for scenario in scenarios:
        labels = {f"{tag.split('/')[0]}/*" for tag in scenario.tags}
        counts.update({f"{scenario.scene}/*", f"{scenario.scene}/{scenario.task}/*", *labels})
    return documents.table(["pattern", "scenarios"], [[label, count] for label, count in sorted(counts.items())])


def rollouts(rows: Rows, scene: Scene) -> str:
    """Return a table of the rollouts' mean outcomes, overall and per entity, with 95 % intervals."""
    valid = [row for row in rows["rollouts"] if row["status"] == "completed"]
    worst = greatest_touch(scene)
    lines: list[list[object]] = []
    for name, bound in (
        ("observed_impact", worst),
        ("own_loss", scene.own_severity),
        ("energy_impact", worst),
        ("secondary_impact", worst),
        ("spilled", 1.0),
    ):
        found = estimate_mean([row[name] for row in valid], (0.0, bound))
        lines.append([name.replace("_", " "), found.mean, f"[{found.low:.3g}, {found.high:.3g}]"])
    numbers = {row["rollout"] for row in valid}
    touching = {(row["entity"], row["rollout"]) for row in rows["contacts"] if not row["secondary"]}
    hit = Counter(entity for entity, number in touching if number in numbers)
    for name, count in [
        ("dropped", sum(row["dropped"] for row in valid)),
        *((f"hit {e}", n) for e, n in hit.most_common()),
    ]:
        found = estimate_probability([1.0] * count + [0.0] * (len(valid) - count))
        lines.append([name, found.mean, f"[{found.low:.3g}, {found.high:.3g}]"])
    diverged = len(rows["rollouts"]) - len(valid)
    head = f"{len(rows['rollouts'])} rollouts" + (f"; {diverged} diverged and are left out" if diverged else "")
    return f"{head}\n\n" + documents.table(["per failure", "mean", "95 %"], lines)

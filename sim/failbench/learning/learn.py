"""Learn a network from scratch: generate scenes, simulate drops, fit, and record the provenance."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path as FilePath
from typing import Any

from failbench.calibrations.calibrate import rounded, rounded_figures, versions
from failbench.calibrations.failure_jobs import Progress
from failbench.calibrations.failures import read_failures, write_failures
from failbench.learning.generated import PREFIX
from failbench.learning.rollouts import DropData, drop_things, pairs_of
from failbench.learning.training import Learned, Training, train


def learn(
    data: DropData | None = None,
    training: Training | None = None,
    *,
    kept: str | FilePath | None = None,
    progress: Progress | None = None,
) -> Learned:
    """Simulate drops in generated scenes, and fit a network to them.

    Args:
        data: Numbers of scenes and drops.
        training: Settings of the fit.
        kept: File to store the drops in, or to read them from if it exists.
        progress: Called after each motion.

    Raises:
        FormatError: If the file exists and holds something else.
        SettingError: If there are no drops to learn from.
    """
    data, training = data or DropData(), training or Training()
    file = None if kept is None else FilePath(kept)
    if file is not None and file.exists():
        failures, source = read_failures(file), {"drops_from": file.name}
    else:
        failures, refused = drop_things(data, progress)
        settings = {key: value for key, value in asdict(data).items() if key != "processes"}
        source = {"motions_without": len(refused), "data": settings}
        if file is not None:
            write_failures(file, failures)
    pairs, scenes = pairs_of(failures), {part.scene for part in failures}
    found = train(pairs, training)
    about = {
        **versions(),
        "scenes": len(scenes),
        "bundled_scenes": sum(not name.startswith(PREFIX) for name in scenes),
        "motions": len(failures),
        "drops": sum(len(part) for part in failures),
        "pairs": len(pairs),
        **source,
        "training": asdict(training),
        **document(found),
    }
    return found._replace(network=replace(found.network, about=about))


def document(found: Learned) -> dict[str, Any]:
    """Return the quality on the scenes that selected the network, as JSON values."""
    return {
        "decay": found.decay,
        "scale": rounded(found.scale),
        "bundled": {"drop_model": rounded_figures(found.plain), "network": rounded_figures(found.corrected)},
    }


def table(found: Learned) -> str:
    """Return the quality on the scenes that selected the network, as a table."""
    names = ("brier_skill", "auc", "calibration_error", "ratio", "log_loss")
    rows: list[tuple[str, ...]] = [("", *names)]
    for label, figures in (("drop model", found.plain), ("network", found.corrected)):
        rows.append((label, *(f"{getattr(figures, name):.4f}" for name in names)))
    about = found.network.about
    head = (
        f"{about['drops']} drops in {about['scenes']} scenes; quality on the {about['bundled_scenes']} bundled ones, "
    )
    head += "which selected the network:\n"
    return head + "\n".join(f"{row[0]:<12}" + "".join(f"{cell:>19}" for cell in row[1:]) for row in rows)

"""Films of the worst consequence of every fault. Run it with `python -m`.

The films show the failures of the contact sheet at half speed. A bar is green before the onset and red after it. The
outline is the healthy robot at the same time.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from failbench.pictures.contact_sheet import WORDS, Worst, beside_healthy, camera_on, healthy_run, worst_of
from failbench.pictures.drawing import TouchPaint
from failbench.pictures.offscreen import Offscreen
from failbench.pictures.playback import film, healthy
from failbench.rollouts.execution import Execution
from failbench.simulated.states import CHECKPOINT
from graceful_plan.array_types import Array, UInt8

if TYPE_CHECKING:
    from PIL.Image import Image


_WIDTH, _HEIGHT, _BAR = 320, 240, 6
"""Width and height of a film, and height of the bar at its lower edge [pixels]."""
_RATE, _SLOW = 12.5, 2.0
"""Frames per second, and slow-down factor."""
_LEAD, _TAIL, _LEAST = 0.3, 0.45, 0.8
"""Shown time before the onset, after the worst moment, and at least after the onset [s]."""
_REST = 1200.0
"""Duration of the last frame [ms]."""
_QUALITY = 55
"""WebP quality in per cent: edges stay sharp, and all films together stay below 3 MB."""
_BEFORE, _AFTER, _TO_COME = (42, 127, 79), (194, 24, 91), (205, 205, 205)
"""Colours of the bar before and after the onset, and of its remaining part."""


def fault_films(folder: str | Path) -> tuple[Path, ...]:
    """Write a film of each fault into a folder, as animated WebP.

    Raises:
        NoPicture: If no OpenGL works without a window.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    execution, files = healthy_run(), []
    with Offscreen(execution.world.model, _WIDTH, _HEIGHT) as offscreen:
        for worst in worst_of(execution, tuple(WORDS)):
            frames = list(_frames(execution, worst, offscreen))
            times = [round(1000.0 / _RATE)] * (len(frames) - 1) + [_REST]
            files.append(folder / f"{worst.job.fault.NAME}.webp")
            frames[0].save(
                files[-1], save_all=True, append_images=frames[1:], duration=times, loop=0, quality=_QUALITY, method=6
            )
    return tuple(files)


def _frames(execution: Execution, worst: Worst, offscreen: Offscreen) -> Iterator[Image]:
    from PIL import Image

    dt = execution.dt
    onset = execution.checkpoint(worst.job.onset)
    first = max(0, onset - math.ceil(_LEAD / (CHECKPOINT * dt)))
    lead, horizon = (onset - first) * CHECKPOINT * dt, max(_LEAST, worst.time + _TAIL)
    every, steps = round(1.0 / (_RATE * _SLOW * dt)), round((lead + horizon) / dt)
    touches = TouchPaint(execution.world, execution.baseline)
    moments = film(execution, worst.job, horizon=horizon, lead=lead)
    camera = camera_on(execution, worst.place)
    for step, (moment, (_, intact)) in enumerate(zip(moments, healthy(execution, first, steps), strict=False)):
        touches.observe(moment.model, moment.data, moment.time)
        if step % every == 0:
            pixels = beside_healthy(execution, moment.data, intact, touches, camera, offscreen)
            _draw_bar(pixels, step / steps, lead / (lead + horizon))
            yield Image.fromarray(pixels)


def _draw_bar(pixels: UInt8[Array, "height width 3"], now: float, onset: float) -> None:
    """Draw the film's progress over the lower edge of a picture: green until the onset, red after it."""
    done, broken = round(now * _WIDTH), round(onset * _WIDTH)
    pixels[-_BAR:] = _TO_COME
    pixels[-_BAR:, : min(done, broken)] = _BEFORE
    pixels[-_BAR:, broken : max(done, broken)] = _AFTER


def main() -> None:
    """Write the films into the folder named on the command line."""
    parser = argparse.ArgumentParser(prog="fault_films", description=fault_films.__doc__)
    parser.add_argument("folder", type=Path, help="folder for the films")
    fault_films(parser.parse_args().folder)


if __name__ == "__main__":
    main()

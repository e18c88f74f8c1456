"""Films from pictures: captions, and files of frames, animated images and videos."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from failbench.basics.errors import NoPicture
from graceful_plan.array_types import Array, UInt8
from graceful_plan.exceptions import FormatError

if TYPE_CHECKING:
    from PIL.Image import Image


ANIMATED = (".gif", ".webp", ".apng")
SUFFIXES = ("", *ANIMATED, ".mp4")
"""Supported suffixes of a film's path; no suffix is a folder of PNG files."""

_INK, _PAPER, _MUTED = (25, 25, 25), (255, 255, 255), (110, 110, 110)


def check_output(output: Path) -> None:
    """Raise FormatError or NoPicture if no film can be written to `output`."""
    suffix = output.suffix.lower()
    if suffix not in SUFFIXES:
        raise FormatError(str(output), f"expected a folder for PNG files, or a name in {', '.join(SUFFIXES[1:])}")
    if suffix == "" and output.exists() and not output.is_dir():
        raise FormatError(str(output), "frames are written into a folder, but this is a file")
    if suffix == "" and output.exists() and any(output.iterdir()):
        raise FormatError(str(output), "this folder is not empty; frames of two films would be mixed up")
    if suffix == ".mp4":
        _ffmpeg()


def write_film(frames: Iterator[Image], output: Path, fps: float) -> tuple[Path, ...]:
    """Write frames as they arrive, in the format of `output`'s suffix, and return the files."""
    suffix = output.suffix.lower()
    if suffix == "":
        return _write_frames(frames, output)
    output.parent.mkdir(parents=True, exist_ok=True)
    if suffix == ".mp4":
        _write_video(frames, output, fps)
    else:
        # GIF stores durations in hundredths of a second and truncates the rest.
        duration = 10 * round(100.0 / fps) if suffix == ".gif" else 1000.0 / fps
        first = next(frames)
        rest = list(frames) if suffix == ".apng" else frames  # Pillow iterates twice for APNG
        first.save(output, save_all=True, append_images=rest, duration=duration, loop=0)
    return (output,)


def _write_frames(frames: Iterator[Image], folder: Path) -> tuple[Path, ...]:
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for i, frame in enumerate(frames):
        files.append(folder / f"{i:05d}.png")
        frame.save(files[-1])
    return tuple(files)


def _write_video(frames: Iterator[Image], output: Path, fps: float) -> None:
    first = next(frames)
    writer = _ffmpeg().write_frames(str(output), first.size, fps=fps, macro_block_size=2, quality=8)
    writer.send(None)
    try:
        for frame in chain([first], frames):
            writer.send(np.ascontiguousarray(frame))
    finally:
        writer.close()


def _ffmpeg() -> Any:
    try:
        return importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise NoPicture("MP4 needs imageio-ffmpeg", "pip install '.[viz]', or write a .gif, .webp or .apng") from error


def captioned(pixels: UInt8[Array, "height width 3"], heading: str, text: str, colour: str) -> Image:
    """Return a picture with two lines of text over its lower edge.

    Args:
        pixels: The picture.
        heading: The upper line.
        text: The lower line.
        colour: Colour of the strip beside the text.
    """
    from PIL import Image, ImageDraw

    picture = Image.fromarray(pixels)
    draw = ImageDraw.Draw(picture)
    width, height = picture.size
    size = max(10, height // 30)
    top = height - round(3.4 * size)
    draw.rectangle((0, top, width, height), fill=_PAPER)
    draw.rectangle((0, top, size // 2, height), fill=colour)
    for line, words, ink in ((0, heading, _INK), (1, text, _MUTED)):
        draw.text((1.4 * size, top + (0.4 + 1.35 * line) * size), words, fill=ink, font=font(size))
    return picture


def font(size: int) -> Any:
    """Return the font of captions, for a letter size of about `size` [pixels]."""
    from PIL import ImageFont

    return ImageFont.load_default(size)

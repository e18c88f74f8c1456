"""A contact sheet of all faults, each at its worst consequence. Run it with `python -m`.

Every fault strikes the same motion of the Panda in the scene "tabletop" at several onsets. The picture shows the worst
hit over all onsets or, without any hit, the time when the tool is farthest from its place in the healthy run.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

import graceful_plan as gp
from failbench.fault.registry import faults
from failbench.pictures.drawing import TouchPaint, add_geoms, outlined
from failbench.pictures.film import font
from failbench.pictures.offscreen import Offscreen
from failbench.pictures.playback import film, healthy
from failbench.recording.records import Rollout, RolloutRequest
from failbench.rollouts.execution import Execution, execute
from failbench.rollouts.rollout import run_rollouts
from failbench.simulated.world import build_world
from graceful_plan.array_types import Array, Float, UInt8
from graceful_plan.viz.offscreen import camera_at

if TYPE_CHECKING:
    from PIL.Image import Image


SCENE, TASK = "tabletop", "lift_to_goal"
DEGREE = "critical"
WORDS = {
    "complete_shutdown": "a joint loses all torque",
    "loose_joint": "a joint sags and sways",
    "limited_range": "a joint meets hard stops",
    "partial_degradation": "a drive is far too weak",
    "gradual_degradation": "a drive fades to nothing",
    "stuck_position": "a joint seizes and stays",
    "increased_friction": "a dry bearing holds back",
    "noise": "a sensor's readings scatter wildly",
    "bias_drift": "a sensor's reading drifts away",
    "control_delay": "commands arrive much too late",
    "dropout": "a sensor's reading keeps freezing",
    "scale_error": "a sensor exaggerates every angle",
    "dead_zone": "a sensor misses small motions",
    "gripper_failure": "the gripper opens on the way",
    "weak_grip": "fingers hold too weakly",
    "stuck_gripper": "the gripper springs open, sticks",
    "battery_degradation": "all drives fade to nothing",
    "voltage_drop": "all drives pause for 0.2 s",
    "power_loss": "the arm falls until braked",
}
"""Effect of each fault, in about five words."""

_MOMENTS = 12
"""Onsets tried for each fault, spread evenly over the motion."""
_GOLDEN = 0.618034
"""Shift of the onsets from fault to fault, as a fraction of their spacing, so that no two faults begin together."""
_AFTER = 0.02
"""Time from the first touch to the picture [s]: the contact force is near its peak then."""
_COLUMNS, _WIDTH, _HEIGHT, _TEXT, _GAP = 4, 400, 300, 84, 14
"""Layout [pixels]: columns, size of a picture, height of the text below it, space between."""
_DISTANCE, _AZIMUTH, _ELEVATION = 0.78, 128.0, -28.0
"""Camera distance [m], azimuth and elevation [degrees] for an event in the middle of the scene."""
_VISIBLE = 0.02
"""Distance of the tool from its healthy position above which the healthy robot is outlined [m]."""
_INK, _MUTED, _PAPER = "#191919", "#6e6e6e", "#ffffff"
_LEGEND = (
    ("#ed008c", "force on what is hit; its length", "grows with the root of the force"),
    ("#f0cd10", "what has been hit", ""),
    ("#1565d8", "where the healthy robot", "would be at the same time"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Worst:
    """The worst consequence of a fault.

    Args:
        job: The fault and its onset.
        time: Time of the picture since the onset [s].
        place: Position of the event, in W [m].
        text: Description.
    """

    job: RolloutRequest
    time: float
    place: Float[Array, " xyz"]
    text: str


def contact_sheet(output: str | Path) -> Path:
    """Write the contact sheet of all faults to a PNG file.

    Raises:
        NoPicture: If no OpenGL works without a window.
    """
    execution = healthy_run()
    cells = []
    with Offscreen(execution.world.model, _WIDTH, _HEIGHT) as offscreen:
        for worst in worst_of(execution, tuple(WORDS)):
            name = worst.job.fault.NAME
            cells.append(_cell(picture(execution, worst, offscreen), (name, WORDS[name], worst.text)))
    output = Path(output)
    output.parent.mkdir(parents=True, exist_ok=True)
    _page([*cells, _legend()]).save(output, optimize=True)
    return output


def healthy_run() -> Execution:
    """Return the healthy execution of the motion that every fault strikes."""
    task = gp.load_scene(SCENE).tasks[TASK]
    plan = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50, seed=0, speed=0.5)
    return execute(plan, build_world(task.scene))


def worst_of(execution: Execution, names: Sequence[str]) -> list[Worst]:
    """Return the worst consequence of each fault over several onsets."""
    known = faults()
    spacing = execution.duration / _MOMENTS
    jobs = [
        RolloutRequest(fault=known[name](degree=DEGREE), onset=(i + place * _GOLDEN % 1.0) * spacing, seed=i)
        for place, name in enumerate(names)
        for i in range(_MOMENTS)
    ]
    rollouts = run_rollouts(execution, jobs)
    return [_worst(execution, rollouts[i : i + _MOMENTS]) for i in range(0, len(jobs), _MOMENTS)]


def _worst(execution: Execution, rollouts: Sequence[Rollout]) -> Worst:
    """Return the hit with the greatest product of severity and energy or, without hits, the greatest deviation."""
    entities = execution.world.scene.entities
    blows = [(event, one.job) for one in rollouts for event in one.events if not event.secondary]
    if not blows:
        return max((_farthest(execution, one.job) for one in rollouts), key=lambda found: found[0])[1]
    event, job = max(blows, key=lambda blow: entities[blow[0].entity].severity[blow[0].striker] * blow[0].energy)
    striker = {"body": "robot", "carried": "object"}.get(event.striker, event.striker)
    energy = f"{event.energy:.2g} J" if event.energy >= 0.1 else f"{1000.0 * event.energy:.2g} mJ"
    return Worst(
        job=job,
        time=event.time + _AFTER,
        place=np.array(event.position),
        text=f"{striker} hits {event.entity}, {energy}, {event.time:.2f} s later",
    )


def _farthest(execution: Execution, job: RolloutRequest) -> tuple[float, Worst]:
    """Return the greatest distance of the tool from its healthy position [m], and its description."""
    tool = execution.world.model.site(execution.world.scene.tool).id
    broken = [moment.data.site_xpos[tool].copy() for moment in film(execution, job, horizon=1.0, lead=0.0)]
    steps = healthy(execution, execution.checkpoint(job.onset), len(broken))
    distance = np.linalg.norm(np.array(broken) - [data.site_xpos[tool].copy() for _, data in steps], axis=1)
    step = int(np.argmax(distance))
    text = f"tool {100 * distance[step]:.2g} cm off its path after {step * execution.dt:.2f} s"
    return float(distance[step]), Worst(job=job, time=step * execution.dt, place=broken[step], text=text)


def picture(execution: Execution, worst: Worst, offscreen: Offscreen) -> UInt8[Array, "height width 3"]:
    """Take the picture of a worst consequence, with the outline of the healthy robot where it differs."""
    touches = TouchPaint(execution.world, execution.baseline)
    steps = round(worst.time / execution.dt) + 1
    *_, (_, intact) = healthy(execution, execution.checkpoint(worst.job.onset), steps)
    broken = intact
    for moment in film(execution, worst.job, horizon=steps * execution.dt, lead=0.0):
        touches.observe(moment.model, moment.data, moment.time)
        broken = moment.data
    return beside_healthy(execution, broken, intact, touches, camera_on(execution, worst.place), offscreen)


def beside_healthy(
    execution: Execution,
    broken: mujoco.MjData,
    intact: mujoco.MjData,
    touches: TouchPaint,
    camera: mujoco.MjvCamera,
    offscreen: Offscreen,
) -> UInt8[Array, "height width 3"]:
    """Take a picture of a broken robot and all it has hit, with the outline of the healthy robot where it differs."""
    world = execution.world
    touches.paint(offscreen.model)
    pixels = offscreen.picture(broken, camera, touches.draw)
    tool, robot = world.model.site(world.scene.tool).id, world.striker_bodies["body"]
    if np.linalg.norm(broken.site_xpos[tool] - intact.site_xpos[tool]) < _VISIBLE:
        return pixels
    shape = offscreen.silhouette(intact, camera, lambda view: add_geoms(view, world.model, intact, robot))
    return outlined(pixels, shape)


def camera_on(execution: Execution, place: Float[Array, " xyz"]) -> mujoco.MjvCamera:
    """Return a camera that sees a place and its surroundings."""
    data = mujoco.MjData(execution.world.model)
    mujoco.mj_forward(execution.world.model, data)
    centre = np.mean([data.xpos[body] for body in execution.world.movable.values()], axis=0)
    distance = _DISTANCE + float(np.linalg.norm(place - centre))
    return camera_at(0.5 * (centre + place) + [0.0, 0.0, 0.14], distance, _AZIMUTH, _ELEVATION)


def _cell(pixels: UInt8[Array, "height width 3"], lines: Sequence[str]) -> Image:
    from PIL import Image, ImageDraw

    cell = Image.new("RGB", (_WIDTH, _HEIGHT + _TEXT), _PAPER)
    cell.paste(Image.fromarray(pixels), (0, 0))
    draw = ImageDraw.Draw(cell)
    for i, (text, size, ink) in enumerate(zip(lines, (22, 18, 18), (_INK, _INK, _MUTED), strict=True)):
        draw.text((0, _HEIGHT + 4 + 26 * i), text, fill=ink, font=font(size))
    return cell


def _legend() -> Image:
    from PIL import Image, ImageDraw

    cell = Image.new("RGB", (_WIDTH, _HEIGHT + _TEXT), _PAPER)
    draw = ImageDraw.Draw(cell)
    draw.text((20, 30), f"One motion, {len(WORDS)} faults, all {DEGREE}:", fill=_INK, font=font(20))
    draw.text((20, 58), "the worst that each of them does", fill=_INK, font=font(20))
    for i, (colour, *lines) in enumerate(_LEGEND):
        y = 110 + 64 * i
        draw.rectangle((20, y, 44, y + 24), fill=colour)
        draw.text((58, y), "\n".join(lines), fill=_MUTED, font=font(18))
    return cell


def _page(cells: Sequence[Image]) -> Image:
    from PIL import Image

    width, height = cells[0].size
    rows = -(-len(cells) // _COLUMNS)
    page = Image.new("RGB", (_COLUMNS * (width + _GAP) + _GAP, rows * (height + _GAP) + _GAP), _PAPER)
    for i, cell in enumerate(cells):
        row, column = divmod(i, _COLUMNS)
        page.paste(cell, (_GAP + column * (width + _GAP), _GAP + row * (height + _GAP)))
    return page


def main() -> None:
    """Write the contact sheet to the file named on the command line."""
    parser = argparse.ArgumentParser(prog="contact_sheet", description=contact_sheet.__doc__)
    parser.add_argument("output", type=Path, help="PNG file to write")
    contact_sheet(parser.parse_args().output)


if __name__ == "__main__":
    main()

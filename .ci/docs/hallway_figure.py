"""Reproduce Figure 1 of the method: a bottle carried past people, for w = 0 and the default weight.

A picture from above shows the impact of a failure along each motion; a film shows FailBench's healthy robot executing
both motions side by side.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

import failbench as fb
import graceful_plan as gp
from failbench.pictures.film import captioned, write_film
from failbench.pictures.offscreen import Offscreen
from failbench.pictures.playback import healthy
from graceful_plan.costs.cost import checked_state, moving_batch
from graceful_plan.viz.outlines import draw_entities
from graceful_plan.viz.style import STYLE, heat_map

if TYPE_CHECKING:
    from PIL.Image import Image

Array = np.ndarray

TASK, SECONDS = "carry_bottle", 5.0
_NAMES = {0.0: "w = 0", None: "default weight"}
_COLOURS = {0.0: "#111111", None: "#0b62c4"}
_SAMPLES = 400
_SIZE, _FPS, _SPEEDUP = (720, 216), 10.0, 2.0
"""Size of one of the two views [pixels], frames per second, and speed-up of the film."""


def planned() -> tuple[gp.Scene, dict[float | None, gp.PlanResult]]:
    """Plan the task with both weights."""
    task = gp.load_scene("hallway").tasks[TASK]
    plan = {w: gp.plan(task.start, task.goal, task.scene, w=w, time_limit=SECONDS) for w in _NAMES}
    return task.scene, plan


def draw(scene: gp.Scene, results: dict[float | None, gp.PlanResult], file: Path) -> None:
    """Draw both motions from above, coloured by the impact of a failure, and this impact over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(3, 1, figsize=(9.0, 6.4), height_ratios=(3, 3, 2.4), layout="constrained")
        lines = {w: _line(scene, result) for w, result in results.items()}
        most = max(float(impact.max()) for _, _, _, impact in lines.values())
        for above, (w, line) in zip(axes, lines.items(), strict=False):
            image = _draw_above(above, scene, line, most)
            cost = results[w].cost
            assert cost is not None
            t = line[0]
            above.set_title(f"{_NAMES[w]}: {t[-1]:.1f} s, impact {cost.impact:.1f}; numbers: severity of each entity")
            axes[2].fill_between(t, line[3], color=_COLOURS[w], alpha=0.15)
            axes[2].plot(t, line[3], color=_COLOURS[w], label=_NAMES[w])
        axes[1].set(xlabel="x [m]")
        figure.colorbar(image, ax=axes[:2], shrink=0.8, aspect=30, pad=0.01, label="impact of a failure here")
        axes[2].set(xlabel="time [s]", ylabel="impact of a failure", ylim=(0.0, None), xlim=(0.0, None))
        axes[2].legend()
        figure.savefig(file, dpi=110)
        plt.close(figure)


def _line(scene: gp.Scene, result: gp.PlanResult) -> tuple[Array, Array, Array, Array]:
    """Return times, configurations, positions of the bottle, and the impact of a failure at each."""
    trajectory = result.unwrap()
    t = np.linspace(0.0, trajectory.duration, _SAMPLES)
    state = trajectory.at(t)
    assert scene.carried is not None
    bottle = np.array([scene.data_at(q).body(scene.carried.body).xpos for q in state.q])
    impact = checked_state(gp.Objective().impact, moving_batch(scene, state.q, state.qd, t))
    return t, state.q, bottle, impact


def _draw_above(axes: Any, scene: gp.Scene, line: tuple[Array, Array, Array, Array], most: float) -> Any:
    from matplotlib.collections import LineCollection

    t, q, bottle, impact = line
    draw_entities(axes, scene)
    for name, entity in scene.moving.items():
        walked = entity.at(t).position
        axes.plot(*walked[:, :2].T, color="#7a3fa0", linestyle=":", linewidth=1.2)
        axes.annotate(name, walked[0, :2], fontsize=7)
    axes.plot(q[:, 0], q[:, 1], color="#777777", linewidth=0.8)
    edges = np.stack([bottle[:-1, :2], bottle[1:, :2]], axis=1)
    image = LineCollection(list(edges), cmap=heat_map(), linewidths=4.0, capstyle="round")
    image.set_array(impact[:-1])
    image.set_clim(0.0, most)
    axes.add_collection(LineCollection(list(edges), colors="#333333", linewidths=5.2, capstyle="round"))
    axes.add_collection(image)
    for wall in (-1.2, 1.2):
        axes.axhline(wall, color="#444444", linewidth=2.0)
    axes.set(xlim=(-1.0, 11.0), ylim=(-1.3, 1.3), aspect="equal", ylabel="y [m]")
    return image


def record(scene: gp.Scene, results: dict[float | None, gp.PlanResult], file: Path) -> None:
    """Film both motions, one over the other, as FailBench's healthy robot executes them."""
    from PIL import Image as image

    runs = {w: fb.execute(result, fb.build_world(scene)) for w, result in results.items()}
    films = [list(_frames(run, _NAMES[w], _COLOURS[w])) for w, run in runs.items()]
    longest = max(map(len, films))
    pairs = zip(*([*frames, *[frames[-1]] * (longest - len(frames))] for frames in films), strict=True)

    def stacked() -> Iterator[Image]:
        for upper, lower in pairs:
            both = image.new("RGB", (_SIZE[0], 2 * _SIZE[1]))
            both.paste(upper, (0, 0))
            both.paste(lower, (0, _SIZE[1]))
            yield both

    write_film(stacked(), file, _FPS)


def _frames(execution: Any, name: str, colour: str) -> Iterator[Image]:
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance, camera.azimuth, camera.elevation = [4.8, 0.0, 0.4], 6.2, 90.0, -42.0
    every = round(_SPEEDUP / (_FPS * execution.dt))
    steps = round(execution.duration / execution.dt)
    with Offscreen(execution.world.model, *_SIZE) as offscreen:
        for step, (_, data) in enumerate(healthy(execution, 0, steps)):
            if step % every == 0:
                yield captioned(offscreen.picture(data, camera), name, f"{step * execution.dt:.1f} s", colour)


def main() -> None:
    """Write the picture and the film into the folder that the command line names."""
    parser = argparse.ArgumentParser(prog="hallway", description=__doc__)
    parser.add_argument("folder", type=Path, help="where hallway.png and hallway.webp go")
    folder = parser.parse_args().folder
    scene, results = planned()
    draw(scene, results, folder / "hallway.png")
    record(scene, results, folder / "hallway.webp")


if __name__ == "__main__":
    main()

"""The pictures of docs/gallery.md that no command of the library makes by itself: `make gallery`.

Pages are taken in chromium, with its driver, which the system's packages have; without them they are left as they are.
"""

from __future__ import annotations

import argparse
import base64
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import graceful_plan as gp
from graceful_plan.mobile.floor.generated import GeneratedFloor, floor_plan
from graceful_plan.mobile.floor.grid_paths import FloorGrid
from graceful_plan.viz.outlines import draw_entities

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
_COMMAND = (sys.executable, "-m", "graceful_plan.tools.cli")
_COLOURS = ("#0b62c4", "#a3408f", "#00805a")
_FLOORS, _HARM, _ELSEWHERE = 40, 1.0, 0.4
"""Of so many floors the first one is taken where the ordinary drive has more than this impact, and w = 1 gets farther
than this from it [m]."""
_WAIT = 12.0
"""How long a page may take until everything on it is drawn [s]; there is no graphics card."""


def rooms() -> None:
    """Draw the first floor by chance on which failures do harm and regard for them changes the drive."""
    seed, made, drives = next(found for found in map(_driven, range(_FLOORS)) if _matters(*found[2]))
    floor, grid = made.floor, FloorGrid(floor=made.floor, radius=0.3)
    with _figure(IMAGES / "rooms.png", 2, (10.0, 4.4)) as (cells, among):
        for axes in (cells, among):
            _draw_map(axes, floor, distances=axes is cells)
        for method, colour in zip(("dijkstra", "theta_star"), _COLOURS, strict=False):
            xy = grid.path(made.start[:2], made.goal[:2], method=method).xy
            cells.plot(*xy.T, color=colour, label=f"{method}, {_length(xy):.1f} m")
        for solid in floor.entities:
            among.plot(*solid.pose[:2], "o", color="#d55e00", markersize=7)
            among.annotate(solid.entity or "", solid.pose[:2], (6, 4), textcoords="offset points", fontsize=7)
        for result, w, colour in zip(drives, (0.0, 1.0), _COLOURS, strict=False):
            _draw_drive(among, result, colour, f"w = {w:g}")
        cells.set_title("tint: distance to the next obstacle; paths over cells")
        among.set_title(f"what a Jackal drives among people, floor {seed}")


def _driven(seed: int) -> tuple[int, GeneratedFloor, tuple[gp.PlanResult, gp.PlanResult]]:
    made = floor_plan(seed, rooms=(3, 2), people=5)
    scene, goal = made.floor.to_scene("jackal"), gp.BasePose(*made.goal)
    first, second = (gp.plan(made.start, goal, scene, w=w, time_limit=15.0) for w in (0.0, 1.0))
    return seed, made, (first, second)


def _matters(first: gp.PlanResult, second: gp.PlanResult) -> bool:
    """Whether the second drive is elsewhere than the first one, which does harm."""
    if first.trajectory is None or second.trajectory is None or first.cost is None:
        return False
    one, other = first.trajectory.q[:, None, :2], second.trajectory.q[None, :, :2]
    return first.cost.impact > _HARM and bool(np.linalg.norm(one - other, axis=2).min(axis=0).max() > _ELSEWHERE)


def drive() -> None:
    """Draw the drive of a base through an apartment, with and without regard for failures."""
    task = gp.load_scene("apartment").tasks["bring_parcel"]
    floor = gp.OccupancyGrid.from_scene(task.scene, heights=(0.05, 1.0), resolution=0.05)
    with _figure(IMAGES / "drive.png", 1, (7.0, 4.6)) as (axes,):
        _draw_map(axes, floor, distances=False)
        draw_entities(axes, task.scene)
        for w, colour in ((0.0, _COLOURS[0]), (1.0, _COLOURS[1])):
            result = gp.plan(task.start, task.goal, task.scene, w=w, time_limit=15.0)
            _draw_drive(axes, result, colour, f"w = {w:g}")
        axes.set_title("a parcel through the apartment; numbers: severity of what falls on whom")


def commands() -> None:
    """Run the commands of the guides whose pictures they show."""
    with tempfile.TemporaryDirectory() as folder:
        coffee, place = f"{folder}/coffee.json", ("--scene", "desk", "--task", "bring_coffee")
        _run("plan", *place, "--w", "0", "--iterations", "100", "--output", coffee)
        _run("explain", coffee, *place, "--output", IMAGES / "explanation.png")
        _run("map", *place, "--height", "0.3", "--speed", "0.5", "--output", IMAGES / "impact_map.png")


def pages() -> None:
    """Take the viewer, and the pages of `tune` and `bench`, as they are in a browser."""
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        print("there is no chromium with its driver here: pages are left out", file=sys.stderr)
        return
    for dark in (False, True):
        _take_viewer(IMAGES / f"viewer{'_dark' if dark else ''}.png", dark=dark)
    with tempfile.TemporaryDirectory() as folder:
        _run("tune", "dining_table", "serve_tea", "--time-limit", "6", "--output", f"{folder}/tune", good=(0, 1))
        _take(Path(folder, "tune", "front.html").as_uri(), IMAGES / "tune_page.png", dark=False, height=1160)
        planners = ("auto", "rrt_connect", "rrt_star", "chomp")
        _run("bench", "--planners", *planners, "--time-limit", "0.3", "--output", f"{folder}/bench")
        _take(Path(folder, "bench", "report.html").as_uri(), IMAGES / "bench_page.png", dark=True, height=1160)


def _take_viewer(file: Path, *, dark: bool) -> None:
    with gp.view("dining_table", task="serve_tea", w=1.0, dark=dark, port=8490, time_limit=8.0) as viewer:
        page: Any = viewer._page
        page.begin()
        page.state.worker.wait(60.0)
        page.controls.risk_map.value = True
        page.player.seek(0.45 * page.state.duration)
        page._lay_map()
        _take(viewer.url, file, dark=dark, height=820)


def _take(url: str, file: Path, *, dark: bool, height: int) -> None:
    from PIL import Image
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for argument in ("headless=new", "no-sandbox", "disable-dev-shm-usage", "hide-scrollbars", "use-angle=swiftshader",
                     "enable-unsafe-swiftshader", "ignore-gpu-blocklist"):  # fmt: skip
        options.add_argument(f"--{argument}")
    browser = webdriver.Chrome(options=options, service=Service(str(shutil.which("chromedriver"))))
    try:
        size = {"width": 1300, "height": height, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        paper = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [paper]})
        browser.get(url)
        time.sleep(_WAIT)
        # That there is no graphics card here is of no interest in a picture.
        _dismiss(browser)
        taken = browser.execute_cdp_cmd("Page.captureScreenshot", {})
        file.write_bytes(base64.b64decode(taken["data"]))
        Image.open(file).convert("RGB").quantize(128).save(file, optimize=True)
    finally:
        browser.quit()


def _dismiss(browser: Any) -> None:
    frames: list[Any] = [None, *browser.find_elements("tag name", "iframe")]
    for frame in frames:
        if frame is not None:
            browser.switch_to.frame(frame)
        for button in browser.find_elements("css selector", "[class*=Notification-closeButton]"):
            button.click()
        browser.switch_to.default_content()
    browser.execute_script("scrollTo(0, 0)")
    time.sleep(2.0)


def _run(*arguments: str | Path, good: tuple[int, ...] = (0,)) -> None:
    done = subprocess.run([*_COMMAND, *map(str, arguments)], stdout=subprocess.DEVNULL, check=False)
    if done.returncode not in good:
        sys.exit(f"graceful-plan {arguments[0]} ended with {done.returncode}")


@contextmanager
def _figure(file: Path, count: int, size: tuple[float, float]) -> Iterator[Any]:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, count, figsize=size, layout="constrained", squeeze=False)
    yield axes[0]
    for one in axes[0]:
        one.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        one.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    figure.savefig(file, dpi=110)
    plt.close(figure)


def _draw_map(axes: Any, floor: gp.OccupancyGrid, *, distances: bool) -> None:
    """Draw walls, and how far they are."""
    x, y = floor.origin[:2]
    rows, columns = floor.shape
    extent = (x, x + columns * floor.resolution, y, y + rows * floor.resolution)
    if distances:
        axes.imshow(floor.distance, origin="lower", extent=extent, cmap="YlGnBu", alpha=0.5)
    walls = np.where(floor.distance <= 0.0, 1.0, np.nan)
    axes.imshow(walls, origin="lower", extent=extent, cmap="gray", vmin=-2.0, vmax=2.0)


def _draw_drive(axes: Any, result: gp.PlanResult, colour: str, name: str) -> None:
    trajectory, impact = result.unwrap(), result.cost.impact if result.cost is not None else np.nan
    xy = trajectory.q[:, :2]
    axes.plot(*xy.T, color=colour, linewidth=1.8, label=f"{name}: {trajectory.duration:.1f} s, impact {impact:.2g}")


def _length(xy: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())


PICTURES: dict[str, Callable[[], None]] = {
    "rooms": rooms,
    "drive": drive,
    "commands": commands,
    "pages": pages,
}


def main() -> None:
    """Make the pictures that are named, or all of them."""
    parser = argparse.ArgumentParser(prog="gallery", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(PICTURES)}; all by default")
    names = parser.parse_args().names
    for name in names or PICTURES:
        if name not in PICTURES:
            parser.error(f"there is no {name!r}; choose from {', '.join(PICTURES)}")
        PICTURES[name]()


if __name__ == "__main__":
    main()

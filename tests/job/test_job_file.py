"""Job files: what they say is what the job asks for, and errors name file and line."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from order_jobs import JOBS
from places import ROOT

import graceful_plan as gp
from graceful_plan.exceptions import SceneError

GOOD = """\
version: 1
scene: lid.yaml
goals:
  kettle: {at: [0.5, 0.3, 0.4]}
  laptop: {onto: table, n: 2}
allow:
  - {clear: lid, in_region: [[0.3, 0.2, 0.3], [0.7, 0.5, 0.5]], n: 3}
  - {close_lid: lid, vessel: kettle}
  - {load: laptop, onto: table}
  - {wait: 8, price: 0.5}
"""


SCENES = ROOT / "tests" / "support" / "scenes"


def written(folder: Path, text: str, scene: Path = JOBS / "lid") -> Path:
    """Write a job file beside a copy of its scene."""
    for ending in (".xml", ".yaml"):
        shutil.copy(scene.with_suffix(ending), folder)
    file = folder / "task.yaml"
    file.write_text(text)
    return file


def test_a_file_asks_for_what_it_says(tmp_path: Path) -> None:
    job = gp.load_job(written(tmp_path, GOOD))
    assert set(job.goals) == {"kettle", "laptop"}
    at = job.goals["kettle"].at
    assert at is not None
    np.testing.assert_allclose(at[:3, 3], [0.5, 0.3, 0.4])
    assert (job.goals["laptop"].on, job.goals["laptop"].n) == ("table", 2)
    clear, close, load, wait = job.allowed
    assert isinstance(clear, gp.Clear) and (clear.name, clear.n) == ("lid", 3)
    assert isinstance(close, gp.CloseLid) and (close.vessel, close.lid) == ("kettle", "lid")
    assert isinstance(load, gp.Load) and load.on == "table"
    assert isinstance(wait, gp.Wait) and (wait.max_seconds, wait.price) == (8.0, 0.5)


def test_a_bundled_scene_is_named(tmp_path: Path) -> None:
    text = "version: 1\nscene: dining_table\ngoals: {bottle: {onto: table}}\n"
    assert gp.load_job(written(tmp_path, text)).scene.name == "dining_table"


def test_a_file_pours(tmp_path: Path) -> None:
    text = (
        "version: 1\nscene: pour.yaml\ngoals: {kettle: {onto: table}}\nallow: [{pour: kettle, into: pot, fill: 0.3}]\n"
    )
    (pour,) = gp.load_job(written(tmp_path, text, SCENES / "pour")).allowed
    assert isinstance(pour, gp.Pour) and (pour.name, pour.into, pour.fill) == ("kettle", "pot", 0.3)


def test_a_file_opens_and_closes_a_drawer(tmp_path: Path) -> None:
    text = (
        "version: 1\nscene: drawer.yaml\ngoals: {mug: {onto: table}}\nallow:\n"
        "  - {open: drawer, handle: drawer_handle, to: 0.2}\n"
        "  - {close: drawer, handle: drawer_handle, required: true}\n"
    )
    file = written(tmp_path, text, SCENES / "drawer")
    opening, closing = gp.load_job(file).allowed
    assert isinstance(opening, gp.Open) and (opening.name, opening.to, opening.required) == ("drawer", 0.2, False)
    assert isinstance(closing, gp.Close) and (closing.handle, closing.required) == ("drawer_handle", True)
    file.write_text(text.replace("0.2", "0.9"))
    with pytest.raises(SceneError, match="range") as raised:
        gp.load_job(file)
    assert "task.yaml:5: " in str(raised.value)


@pytest.mark.parametrize(
    ("old", "new", "line", "names"),
    [
        ("kettle: {at", "vase: {at", 4, "kettle"),
        ("[0.5, 0.3, 0.4]", "[0.5, 0.3]", 4, "3"),
        ("[0.3, 0.2, 0.3]", "[0.3, 0.2]", 7, "length"),
        ("n: 2", "n: 1.5", 5, "whole"),
        ("onto: table, n", "above: table, n", 5, "in_region"),
        ("wait: 8", "jump: 8", 10, "wait"),
        ("wait: 8", "wait: -1", 10, "max_seconds"),
        ("lid.yaml", "../lid.yaml", 2, "folder"),
        ("lid.yaml", "attic", 2, "dining_table"),
        ("version: 1", "version: 2", 1, "version"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, old: str, new: str, line: int, names: str) -> None:
    file = written(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(SceneError, match=names) as raised:
        gp.load_job(file)
    assert f"task.yaml:{line}: " in str(raised.value)

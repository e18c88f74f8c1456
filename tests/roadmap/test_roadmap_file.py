"""Roadmaps in files: the same when read again, refused when stale, damaged or hostile."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.exceptions import FormatError, GracefulPlanError, SettingError
from graceful_plan.roadmap import file as roadmap_file
from graceful_plan.roadmap.fingerprint import fingerprint, scene_fingerprint


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop_l1").tasks["green_to_blue"]


@pytest.fixture(scope="module")
def roadmap(task):
    return gp.Roadmap.build(task.scene, nodes=60)


@pytest.fixture(scope="module")
def written(roadmap, tmp_path_factory):
    file = tmp_path_factory.mktemp("roadmap") / "table.npz"
    roadmap.save(file)
    return file


def same(first: gp.Roadmap, second: gp.Roadmap) -> bool:
    arrays = [
        (
            r.q,
            r.edges.tail,
            r.edges.head,
            *(getattr(r.edges.prices, k) for k in ("motion", "edge", "column", "exposure")),
        )
        for r in (first, second)
    ]
    return all(np.array_equal(a, b) and a.dtype == b.dtype for a, b in zip(*arrays, strict=True))


def test_what_is_read_is_what_was_written(task, roadmap, written):
    again = gp.Roadmap.load(written, gp.load_scene("tabletop_l1").tasks["green_to_blue"].scene)
    assert same(again, roadmap)
    assert again.query(task.start, task.goal).cost == roadmap.query(task.start, task.goal).cost
    assert [p.name for p in written.parent.iterdir()] == [written.name]


def test_severities_weights_and_tasks_may_differ(task, roadmap, written):
    other = task.scene.with_severity({next(iter(task.scene.entities)): 33.0})
    loaded = gp.Roadmap.load(written, other, objective=gp.Objective(w=7.0))
    assert same(loaded, roadmap)
    assert loaded.objective.w == 7.0
    expected = roadmap.query(task.start, task.goal, other, w=7.0)
    assert loaded.query(task.start, task.goal).cost == expected.cost


@dataclass(frozen=True)
class Own(gp.Cost):
    """A cost whose setting no file can hold."""

    setting: object

    def state(self, batch: gp.StateBatch) -> np.ndarray:
        return np.zeros(len(batch))


def box_pose(x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda s: (s.add_box("box", [0.1] * 3, box_pose(3.0)), None), "surroundings"),
        (lambda s: (s.add_box("box", [0.1] * 3, box_pose(3.0), entity="glass"), None), "entities"),
        (lambda s: (gp.load_scene("tabletop").tasks["green_to_blue"].scene, None), "surroundings"),
        (lambda s: (gp.load_scene("tabletop_l1"), None), "carried object"),
        (lambda s: (s, gp.Objective(impact=gp.ImpactCost("aabb"))), "costs"),
        (lambda s: (s, gp.Objective(impact=gp.ImpactCost(components=("carried",)))), "costs"),
        (lambda s: (s, gp.Objective(impact=gp.ImpactCost(gp.Footprint("arm")))), "costs"),
        (lambda s: (s, gp.Objective(impact=gp.ImpactCost(consequence="energy"))), "costs"),
        (lambda s: (s, gp.Objective(motion=gp.JointLength((1.0,) * 6 + (2.0,)))), "costs"),
        (lambda s: (s, gp.Objective(exposure="time")), "costs"),
        (lambda s: (s, gp.Objective(pace=0.3)), "costs"),
    ],
)
def test_stale_files_are_refused(task, written, change, part):
    scene, objective = change(task.scene)
    with pytest.raises(gp.StaleRoadmapError, match=f"another {part}") as caught:
        gp.Roadmap.load(written, scene, objective=objective)
    assert part in caught.value.parts and isinstance(caught.value, GracefulPlanError)


def test_another_release_is_refused(task, written, monkeypatch):
    monkeypatch.setattr("graceful_plan.roadmap.fingerprint.__version__", "0.0.0")
    scene = gp.load_scene("tabletop_l1").tasks["green_to_blue"].scene  # hashes of scenes are kept
    with pytest.raises(gp.StaleRoadmapError, match="library"):
        gp.Roadmap.load(written, scene)


def test_fingerprints_tell_limits_and_poses_apart(task):
    scene = task.scene
    first = scene_fingerprint(scene)
    assert scene_fingerprint(gp.load_scene("tabletop_l1").tasks["green_to_blue"].scene) == first
    assert scene_fingerprint(gp.load_scene("tabletop_l1").tasks["right_to_left"].scene) == first
    near, far = (scene_fingerprint(scene.add_box("box", [0.1] * 3, box_pose(x))) for x in (3.0, 3.001))
    assert {part for part in near if near[part] != far[part]} == {"surroundings"}


def test_costs_of_ones_own_are_told_apart_by_their_settings(task, tmp_path):
    file, objective = tmp_path / "own.npz", gp.Objective(impact=Own("one"))
    roadmap = gp.Roadmap.build(task.scene, objective=objective, nodes=8)
    roadmap.save(file)
    assert same(gp.Roadmap.load(file, task.scene, objective=objective), roadmap)
    with pytest.raises(gp.StaleRoadmapError, match="costs"):
        gp.Roadmap.load(file, task.scene, objective=gp.Objective(impact=Own("another")))


def test_costs_that_cannot_be_told_apart_are_not_written(task, tmp_path):
    roadmap = gp.Roadmap.build(task.scene, objective=gp.Objective(impact=Own(object())), nodes=8)
    with pytest.raises(SettingError, match="dataclasses"):
        roadmap.save(tmp_path / "own.npz")
    assert not list(tmp_path.iterdir())


# --- damage -----------------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_truncated_files_are_refused(task, written, tmp_path_factory, share):
    data = written.read_bytes()
    cut = tmp_path_factory.mktemp("cut") / "cut.npz"
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(FormatError, match="cut"):
        gp.Roadmap.load(cut, task.scene)


@settings(max_examples=150, deadline=None)
@given(where=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_wrong_bit_is_noticed_or_does_not_matter(task, roadmap, written, tmp_path_factory, where, bit):
    data = bytearray(written.read_bytes())
    data[int(where * len(data))] ^= 1 << bit
    file = tmp_path_factory.mktemp("bit") / "bit.npz"
    file.write_bytes(bytes(data))
    try:
        loaded = gp.Roadmap.load(file, task.scene)
    except GracefulPlanError:
        return
    assert same(loaded, roadmap)


def rewritten(file: Path, to: Path, *, compressed: bool = False, **changes: np.ndarray | None) -> Path:
    """A copy with some arrays changed or, where None, left out."""
    with np.load(file) as data:
        arrays = {name: data[name] for name in data.files} | changes
    kept = {name: value for name, value in arrays.items() if value is not None}
    (np.savez_compressed if compressed else np.savez)(to, **kept)
    return to


def header_of(file: Path, **changes: object) -> np.ndarray:
    with np.load(file) as data:
        header = json.loads(data["header"].tobytes()) | changes
    return np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)


def test_other_versions_and_other_files(task, written, tmp_path):
    for changes, words in (
        ({"header": header_of(written, version=2)}, "format 2"),
        ({"header": header_of(written, schema="something")}, "not a roadmap"),
        ({"header": header_of(written, version=1, fingerprint=None)}, "damaged"),
        ({"header": np.frombuffer(b"[]", dtype=np.uint8)}, "damaged"),
        ({"header": np.frombuffer(b"\xff{", dtype=np.uint8)}, "damaged"),
        ({"q": None}, "not a roadmap"),
        ({"more": np.zeros(3)}, "not a roadmap"),
    ):
        file = rewritten(written, tmp_path / "other.npz", **changes)
        with pytest.raises(FormatError, match=words):
            gp.Roadmap.load(file, task.scene)
    with pytest.raises(FormatError, match="compressed"):
        gp.Roadmap.load(rewritten(written, tmp_path / "small.npz", compressed=True), task.scene)
    (tmp_path / "text.npz").write_text("a roadmap, honestly")
    with pytest.raises(FormatError, match="damaged or not a roadmap"):
        gp.Roadmap.load(tmp_path / "text.npz", task.scene)
    with pytest.raises(FileNotFoundError):
        gp.Roadmap.load(tmp_path / "none.npz", task.scene)


@pytest.mark.parametrize("name", ["tail", "head", "edge", "column", "exposure", "motion", "q"])
def test_numbers_out_of_range_are_refused_even_with_a_right_checksum(task, written, tmp_path, name):
    with np.load(written) as data:
        arrays = {key: data[key].copy() for key in data.files}
    header = json.loads(arrays.pop("header").tobytes())
    for value in (-1, np.iinfo(np.int32).max) if arrays[name].dtype == np.int32 else (np.nan, np.inf):
        changed = {key: array.copy() for key, array in arrays.items()}
        changed[name].flat[0] = value
        header["arrays"] = roadmap_file._checksum(changed)
        text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
        np.savez(tmp_path / "forged.npz", header=text, **changed)
        with pytest.raises(FormatError, match="outside of their range"):
            gp.Roadmap.load(tmp_path / "forged.npz", task.scene)


def test_pickles_are_not_opened(task, written, tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path(tmp_path / "sprung").touch, ())

    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.array([Trap()], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(written) as source, zipfile.ZipFile(tmp_path / "trap.npz", "w") as target:
        for member in source.namelist():
            target.writestr(member, buffer.getvalue() if member == "q.npy" else source.read(member))
    with pytest.raises(FormatError):
        gp.Roadmap.load(tmp_path / "trap.npz", task.scene)
    assert not (tmp_path / "sprung").exists()


def test_a_file_that_cannot_be_written_whole_stays_as_it_was(roadmap, written, tmp_path, monkeypatch):
    file = tmp_path / "kept.npz"
    file.write_bytes(b"before")

    def full(*_args: object, **_named: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(roadmap_file.np, "savez", full)
    with pytest.raises(OSError, match="no space"):
        roadmap.save(file)
    assert [p.name for p in tmp_path.iterdir()] == ["kept.npz"] and file.read_bytes() == b"before"
    with pytest.raises(OSError, match=r"missing|No such file"):
        roadmap.save(tmp_path / "missing" / "file.npz")


def test_the_objective_is_hashed_without_its_weight(task):
    first, second = (fingerprint(task.scene, gp.Objective(w=w)) for w in (0.0, 5.0))
    assert first == second

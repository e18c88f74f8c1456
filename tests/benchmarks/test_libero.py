"""The benchmark in scenes of LIBERO, as far as it needs none of their packages."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from places import ROOT

sys.path.insert(0, str(ROOT))

from benchmarks.libero import draw, figures, scenes
from benchmarks.libero.runs import NONE, OBJECTIVES, OURS, PARTS, Done, Events, Motion, read
from benchmarks.subjects import libero

from benchmarks import report, store, suite
from benchmarks import run as runner

BDDL = "(define (problem x) (:objects mug_1 - mug plate_1 - plate) (:obj_of_interest mug_1) (:goal (And {})))"


def motion(contact: float, energy: float, *, duration: float = 1.0, refused: str = "") -> Motion:
    return Motion(
        refused=refused,
        first=1.0,
        duration=duration,
        contact=dict.fromkeys(PARTS, 0.0) | {"bystanders": contact},
        energy=dict.fromkeys(PARTS, 0.0) | {"bystanders": energy},
        predicted=[contact, energy],
        held=0.0,
        events=Events(
            kind=["floor", "furniture"] * 2,
            predicted={"mixture": [0.1, 0.9, 0.2, 0.8], "Algorithm 1": [0.5] * 4},
            happened=[False, True, False, True],
        ),
    )


def head(name: str, base: Motion, own: Motion) -> Done:
    motions = dict.fromkeys(OBJECTIVES, own) | {NONE: base}
    return Done(task=name, grasp="weld", load=1.0, least=2.0, drops=10, motions=motions)


def test_only_tasks_that_put_an_object_somewhere_are_drawn(tmp_path):
    for number, suite_name in enumerate(draw.SUITES):
        (tmp_path / suite_name).mkdir()
        for name, goal in (
            ("carry", "(On mug_1 plate_1)"),
            ("open", "(Open cabinet_1_top)"),
            ("in", "(In mug_1 box_1)"),
        ):
            (tmp_path / suite_name / f"{name}{number}.bddl").write_text(BDDL.format(goal))
    drawn = draw.drawn(tmp_path)
    assert len(drawn) == 2 * len(draw.SUITES) and not any("open" in name for name in drawn)
    assert drawn == draw.drawn(tmp_path) != sorted(drawn)


@pytest.mark.parametrize(
    ("name", "category", "kind"),
    [
        ("plate_1_main", "glass", "bowls, plates, mugs"),
        ("wine_bottle_1_main", "glass", "groceries, books, pans"),
        ("wooden_two_layer_shelf_1_main", "table", "racks and containers"),
        ("living_room_table", "table", "furniture"),
        ("milk_1_main", "robust", "groceries, books, pans"),
        ("floor", "floor", "floor"),
    ],
)
def test_classes_and_kinds_follow_from_names(name, category, kind):
    assert scenes.class_of(name) == category and scenes.kind_of(name) == kind


def test_harm_per_task_is_that_of_a_drop_times_the_duration():
    heads = [head("a", motion(4.0, 0.4), motion(2.0, 0.4, duration=2.0)), head("b", motion(8.0, 0.0), motion(1.0, 0.1))]
    typical = figures.less(heads, OURS, figures.CONTACT)
    assert typical.geometric.mean == pytest.approx(np.sqrt(1.0 * 8.0))
    assert figures.summed(heads, OURS, figures.CONTACT)[0] == pytest.approx(12.0 / 5.0)
    assert figures.summed(heads, OURS, figures.BY_ENERGY)[0] == pytest.approx(0.4 / 0.9)
    assert figures.longer(heads, OURS) == pytest.approx(0.5)


def test_harmless_motions_count_as_one_hit_of_the_least_severity():
    heads = [head("a", motion(4.0, 0.0), motion(0.0, 0.0))]
    assert figures.less(heads, OURS, figures.CONTACT).geometric.mean == pytest.approx(4.0 / 0.2)
    assert figures.summed(heads, OURS, figures.CONTACT)[0] == np.inf
    assert np.isnan(figures.summed(heads, OURS, figures.BY_ENERGY)[0])


def test_refused_motions_are_left_out():
    heads = [head("a", motion(4.0, 0.4), motion(2.0, 0.2)), head("b", motion(9.0, 0.9), motion(0.0, 0.0, refused="no"))]
    assert figures.less(heads, OURS, figures.CONTACT).geometric.n == 1
    assert figures.summed(heads, OURS, figures.CONTACT)[0] == pytest.approx(2.0)
    (found,) = [t for t in figures.targets(heads, figures.events_of(heads), 5, 2) if t.what.startswith("motions")]
    assert found.met is False and found.measured == f"{len(OBJECTIVES) + 1} of {2 * len(OBJECTIVES)}"


def test_stored_tasks_are_read_again(tmp_path):
    written = head("a", motion(4.0, 0.4), motion(2.0, 0.2))
    (tmp_path / "file").write_text(store.line(written))
    assert list(read(tmp_path / "file")) == [written]


def test_without_the_packages_nothing_is_measured(monkeypatch):
    monkeypatch.delenv(libero.PYTHON, raising=False)
    with pytest.raises(report.NotMeasured, match=libero.PYTHON):
        libero.run(suite.Options(quick=True))
    assert "libero" in runner.SUBJECTS and "libero" in runner.APART

"""The benchmark in scenes of LIBERO, as far as it needs none of their packages."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from places import ROOT

sys.path.insert(0, str(ROOT))

from benchmarks.libero import draw, figures, grasps, mixed, robosuite_scenes, scenes
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


# --- grasps and places ------------------------------------------------------------------------------------------------

_RING = "".join(
    f'''<geom type="box" size=".002 .012 .025" pos="{0.05 * np.cos(a)} {0.05 * np.sin(a)} .05" euler="0 0 {a}"/>'''
    for a in 2.0 * np.pi * np.arange(16) / 16
)
_BOWLS = f"""<mujoco><compiler angle="radian"/><worldbody><geom type="plane" size="1 1 1"/>
  <body name="bowl"><freejoint/>{_RING}</body>
  <body name="caddy" pos="0.5 0 0"><geom type="box" size=".1 .1 .01" pos="0 0 .01"/>
    <geom type="box" size=".001 .1 .1" pos=".013 0 .1"/>
    <site name="inside" type="box" size=".05 .05 .05" pos="0 0 .06"/>
  </body></worldbody></mujoco>"""


def bowls() -> SimpleNamespace:
    """Return a bowl with a rim, and a shelf with one thin wall, as a scene with an exported configuration."""
    model = mujoco.MjModel.from_xml_string(_BOWLS)

    def data_at(qpos):
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        return data

    carried = SimpleNamespace(body="bowl")
    return SimpleNamespace(
        model=model, robot_bodies=(), data_at=data_at, keyframes={"exported": model.qpos0}, carried=carried
    )


def test_places_to_hold_spread_over_the_rim():
    scene = bowls()
    places = np.array(grasps._places_to_hold(scene, "bowl"))  # pyright: ignore[reportArgumentType, reportPrivateUsage]
    assert np.linalg.norm(places[0, :2]) < 1e-9
    rim = np.sort(np.arctan2(places[1:, 1], places[1:, 0]))
    assert np.diff([*rim, rim[0] + 2.0 * np.pi]).max() < np.pi / 2.0  # whichever side the arm reaches


def test_thin_walls_count_among_what_an_object_is_put_down_above():
    scene = bowls()
    data = scene.data_at(scene.keyframes["exported"])
    at = np.array([0.5, 0.0])
    assert scenes._highest(scene, [], data, at, 0.05) == pytest.approx(0.2)  # pyright: ignore
    assert scenes._highest(scene, [], data, at - [0.09, 0.0], 0.05) == pytest.approx(0.02)  # pyright: ignore


@pytest.mark.parametrize(
    ("p", "place", "inside", "arrives"),
    [
        ((0.5, 0.0, 0.03), "inside", True, True),
        ((0.5, 0.0, 0.2), "inside", True, False),
        ((0.44, 0.0, 0.03), "inside", True, False),
        ((0.5, 0.0, 0.12), "inside", False, True),
        ((0.5, 0.0, 0.03), "inside", False, False),
        ((0.51, 0.0, 0.2), "caddy", False, True),
        ((0.55, 0.0, 0.2), "caddy", False, False),
    ],
)
def test_an_object_arrives_in_or_on_its_place(p, place, inside, arrives):
    scene = bowls()
    carry = SimpleNamespace(scene=scene, region=None, place=place, inside=inside)
    data = scene.data_at([*p, 1.0, 0.0, 0.0, 0.0])
    assert scenes.arrived(carry, scene.model, data) is arrives  # pyright: ignore[reportArgumentType]


def test_an_object_arrives_in_its_region():
    scene = bowls()
    data = scene.data_at([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])
    for low, arrives in (([0.0, 0.1, 0.2], True), ([0.0, 0.1, 0.31], False)):
        region = np.array([low, np.add(low, 0.15)])
        carry = SimpleNamespace(scene=scene, region=region, place="region", inside=True)
        assert scenes.arrived(carry, scene.model, data) is arrives  # pyright: ignore[reportArgumentType]
        places = np.array(scenes._inside(region))  # pyright: ignore[reportPrivateUsage]
        assert ((places > region[0, :2]) & (places < region[1, :2])).all()


# --- all faults, and robosuite ----------------------------------------------------------------------------------------


def mixed_task(name: str, less: tuple[float, float, float], mean: float) -> mixed.Mixed:
    def one(mean: float, less: tuple[float, float, float]) -> mixed.MixedMotion:
        by_fault = {"noise/severe": 0.0, "gripper_failure/severe": 2.0 * mean}
        return mixed.MixedMotion(
            duration=1.0, healthy=0.0, mean=[mean, 0.0, 2.0 * mean], own=0.0, by_fault=by_fault, less=list(less)
        )

    motions = {label: one(mean, less) for label in mixed.OBJECTIVES} | {NONE: one(4.0, (1.0, 1.0, 1.0))}
    return mixed.Mixed(task=name, grasp="fingers", least=1.0, n=38, motions=motions)


def test_harm_of_all_faults_is_a_table_of_motions_faults_and_tasks(tmp_path):
    done = [
        mixed_task("a", (2.0, 1.5, 3.0), 2.0),
        mixed_task("b", (8.0, 0.5, 9.0), 0.5),
        mixed.Mixed(task="c", refused="NoTransport: no"),
    ]
    text = "\n".join(mixed.mixed_sections(done))
    assert "in 2 of them" in text and "Not measured: c (NoTransport: no)" in text
    row = next(line for line in text.splitlines() if line.startswith(f"| {OURS} |"))
    assert "1.25" in row and "4.00 [" in row  # mean harm of 2 and 0.5; geometric mean of 2 and 8
    assert row.endswith("| 0 | 1 |")  # one is better beyond its interval
    assert "| gripper_failure | 8.00 | 2.50 |" in text
    file = tmp_path / "file"
    file.write_text("".join(store.line(x) for x in done))
    assert list(mixed.read_mixed(file))[:2] == done[:2]
    assert not list(mixed.mixed_sections(done[2:]))


def test_rows_of_robosuite_tell_what_was_refused():
    own, never = motion(2.0, 0.2), motion(0.0, 0.0, refused="no way")
    heads = [head("robosuite.Lift.cube", motion(4.0, 0.4), own), head("robosuite.Stack.cubeA", never, own)]
    heads.append(Done(task="x", refused="NoTransport: x: no grasp"))
    found = robosuite_scenes.Loaded(scene="robosuite.Lift", file=1.0, spec=0.5, status="SOLVED", first=0.4)
    text = "\n".join(robosuite_scenes.robosuite_sections([found], heads))
    assert "| robosuite.Lift.cube | weld | 1.0 | 1.0 | no | 4.00 | 2.00 | 2.00 |" in text
    assert "no way" in text and "no grasp" in text


def test_without_the_packages_nothing_is_measured(monkeypatch):
    monkeypatch.delenv(libero.PYTHON, raising=False)
    with pytest.raises(report.NotMeasured, match=libero.PYTHON):
        libero.run(suite.Options(quick=True))
    assert "libero" in runner.SUBJECTS and "libero" in runner.APART

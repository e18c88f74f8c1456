"""Formats: writing and reading gives the same content; other files are refused with their name."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import graceful_plan as gp
from graceful_plan.exceptions import FormatError, NonFiniteError, SettingError, ShapeError, UnknownNameError
from graceful_plan.formats.parquet_file import MissingArrow

pq = pytest.importorskip("pyarrow.parquet")

NUMBERS = st.floats(-1e6, 1e6)
NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\x00\r"), min_size=1)


@st.composite
def samples(draw):
    """Draw the data of trajectories, with odd names and times in whole nanoseconds from 0."""
    n, nq = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    joints = tuple(draw(st.lists(NAMES, min_size=nq, max_size=nq, unique=True)))
    steps = draw(st.lists(st.integers(1, 10**10), min_size=n - 1, max_size=n - 1))
    t = np.concatenate([[0], np.cumsum(steps, dtype=int)]) / 10**9
    q, qd, qdd = (draw(hnp.arrays(float, (n, nq), elements=NUMBERS)) for _ in range(3))
    return t, q, qd, qdd, joints


def same(a: gp.Trajectory, b: gp.Trajectory) -> None:
    assert a.joints == b.joints
    for key in ("t", "q", "qd", "qdd"):
        np.testing.assert_array_equal(getattr(a, key), getattr(b, key))


@settings(max_examples=15)
@given(made=samples())
@example(made=(*(np.zeros((1, 1)[:n]) for n in (1, 2, 2, 2)), ("0E0",)))
def test_every_form_survives_a_round_trip(made, tmp_path_factory):
    trajectory = gp.Trajectory(*made)
    file = tmp_path_factory.mktemp("forms") / "t"
    same(gp.Trajectory.from_json(trajectory.to_json()), trajectory)
    same(gp.Trajectory.from_csv(trajectory.to_csv()), trajectory)
    same(gp.Trajectory.from_ros(trajectory.to_ros(accelerations=True)), trajectory)
    same(gp.Trajectory.from_ros(trajectory.to_ros_yaml(accelerations=True)), trajectory)
    trajectory.to_parquet(file)
    same(gp.Trajectory.from_parquet(file), trajectory)


@pytest.fixture(scope="module")
def trajectory():
    rng = np.random.default_rng(3)
    q, qd, qdd = rng.normal(size=(3, 5, 2))
    return gp.Trajectory(np.array([0.0, 0.25, 1.5, 2.0, 3.000000001]), q, qd, qdd, ("arm/one", "arm/two"))


@pytest.mark.parametrize("form", ["json", "csv", "parquet", "ros_yaml"])
def test_files_equal_the_text(trajectory, tmp_path, form):
    file = tmp_path / "t"
    text = getattr(trajectory, f"to_{form}")(file, **({"accelerations": True} if form == "ros_yaml" else {}))
    assert text is None or file.read_text() == text
    same(getattr(gp.Trajectory, f"from_{form.removesuffix('_yaml')}")(file), trajectory)


# --- ROS --------------------------------------------------------------------------------------------------------------


def test_a_message_has_the_fields_of_ros(trajectory):
    message = trajectory.to_ros(frame="world")
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "world"}
    assert message["joint_names"] == ["arm/one", "arm/two"]
    assert [p["time_from_start"] for p in message["points"]][-2:] == [
        {"sec": 2, "nanosec": 0},
        {"sec": 3, "nanosec": 1},
    ]
    assert {key for point in message["points"] for key in point} == {
        "positions", "velocities", "accelerations", "effort", "time_from_start",
    }  # fmt: skip
    assert json.loads(json.dumps(message)) == message == yaml.safe_load(trajectory.to_ros_yaml(frame="world"))


def test_rounded_times_keep_the_motion_within_its_limits():
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    trajectory = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50).unwrap()
    found = gp.Trajectory.from_ros(trajectory.to_ros())
    np.testing.assert_allclose(found.q, trajectory.q, atol=1e-8)
    for here, there in zip(found.piece_accelerations, trajectory.piece_accelerations, strict=True):
        np.testing.assert_allclose(here, there, rtol=1e-6, atol=1e-5)
    assert gp.verify(found, task.scene).passed


def test_a_later_start_is_the_start_of_the_message(trajectory):
    later = gp.Trajectory(trajectory.t + 8.0, trajectory.q, trajectory.qd, trajectory.qdd, trajectory.joints)
    assert later.to_ros() == trajectory.to_ros()


@pytest.mark.parametrize(
    "names", [{"arm/one": "a_one", "arm/two": "a_two"}, lambda name: name.replace("arm/", "a_")], ids=["map", "call"]
)
def test_joints_have_other_names_over_there(trajectory, names):
    message = trajectory.to_ros(names, accelerations=True)
    assert message["joint_names"] == ["a_one", "a_two"]
    same(gp.Trajectory.from_ros(message, trajectory.joints, names), trajectory)
    turned = gp.Trajectory.from_ros(message, trajectory.joints[::-1], names)
    np.testing.assert_array_equal(turned.q, trajectory.q[:, ::-1])


def test_a_mapping_selects_joints(trajectory):
    names = {"arm/two": "b", "arm/one": "a"}
    assert gp.Trajectory.from_ros(trajectory.to_ros(names), names=names).joints == ("arm/two", "arm/one")


def test_an_object_with_the_attributes_of_a_message_is_one(trajectory):
    def as_object(value):
        if isinstance(value, dict):
            return SimpleNamespace(**{key: as_object(item) for key, item in value.items()})
        return [as_object(item) for item in value] if isinstance(value, list) else value

    same(gp.Trajectory.from_ros(as_object(trajectory.to_ros(accelerations=True))), trajectory)


def test_missing_accelerations_are_taken_from_the_cubics(trajectory):
    message = trajectory.to_ros()
    assert all(point["accelerations"] == [] for point in message["points"])
    found = gp.Trajectory.from_ros(message)
    begins, ends = trajectory.piece_accelerations
    np.testing.assert_allclose(found.qdd[:-1], begins)
    np.testing.assert_allclose(found.qdd[-1], ends[-1])


def test_joints_besides_have_to_stand_still(trajectory):
    message = trajectory.to_ros()
    with pytest.raises(FormatError, match="arm/two"):
        gp.Trajectory.from_ros(message, ["arm/one"])
    for point in message["points"]:
        point["positions"][1] = 0.5
    np.testing.assert_array_equal(gp.Trajectory.from_ros(message, ["arm/one"]).q[:, 0], trajectory.q[:, 0])


@pytest.mark.parametrize(
    ("names", "error", "message"),
    [
        ({"arm/one": "a"}, UnknownNameError, "unknown joint in names 'arm/two'; valid: arm/one"),
        (lambda name: "a", SettingError, "names = 'a', expected a distinct name"),
    ],
)
def test_names_that_do_not_serve_are_refused(trajectory, names, error, message):
    with pytest.raises(error, match=message):
        trajectory.to_ros(names)


def test_samples_closer_than_a_nanosecond_cannot_be_sent():
    close = gp.Trajectory(np.array([0.0, 1e-10]), *np.zeros((3, 2, 1)), ("a",))
    with pytest.raises(SettingError, match="nanosecond"):
        close.to_ros()


def broken(change):
    message = gp.Trajectory(np.array([0.0, 1.0]), *np.ones((3, 2, 1)), ("a",)).to_ros()
    change(message)
    return message


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        (lambda m: m.pop("points"), FormatError, "points"),
        (lambda m: m.update(points=[]), FormatError, "there are no points"),
        (lambda m: m.update(joint_names=[]), FormatError, "joint_names"),
        (lambda m: m.update(joint_names=["a", "a"]), FormatError, "joint_names"),
        (lambda m: m.update(joint_names=["a", "b"]), ShapeError, "positions of message has shape"),
        (lambda m: [p.pop("velocities") for p in m["points"]], FormatError, "lack velocities; time it again"),
        (lambda m: m["points"][1].pop("velocities"), FormatError, "velocities"),
        (lambda m: m["points"][1].pop("time_from_start"), FormatError, "time_from_start"),
        (lambda m: m["points"][1]["time_from_start"].update(sec=0.5), FormatError, "whole numbers"),
        (lambda m: m["points"][1]["time_from_start"].update(sec=10**400), FormatError, "whole numbers"),
        (lambda m: m["points"][1]["time_from_start"].update(nanosec=-1), FormatError, "whole numbers"),
        (lambda m: m["points"][1]["time_from_start"].update(sec=0), SettingError, "time must increase"),
        (lambda m: m["points"][1].update(positions=[np.nan]), NonFiniteError, "positions of message"),
    ],
)
def test_other_texts_are_refused(change, error, said):
    with pytest.raises(error, match=said):
        gp.Trajectory.from_ros(broken(change))


@pytest.mark.parametrize(
    "text",
    [
        "a: [\n",
        "\n",
        "joint_names: 3\npoints: 4\n",
        "joint_names: [a]\npoints: 4\n",
        "joint_names: [a]\npoints: [4]\n",
        "joint_names: [a]\npoints: [{positions: 1, time_from_start: 3}]\n",
        "joint_names: [a]\npoints: [{positions: 1, time_from_start: {sec: 3, nanosec: 0}}]\n",
        "- 1\n- 2\n",
        "!!python/object:os.x {}\n",
    ],
)
def test_broken_yaml_is_refused(text):
    with pytest.raises(FormatError):
        gp.Trajectory.from_ros(text)


def test_a_missing_joint_is_named(trajectory):
    with pytest.raises(UnknownNameError, match=r"'leg'.*arm/one, arm/two"):
        gp.Trajectory.from_ros(trajectory.to_ros(), ["leg"])


# --- tables -----------------------------------------------------------------------------------------------------------

HEADER = "t [s],q a [rad or m],qd a [rad/s or m/s],qdd a [rad/s^2 or m/s^2]\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("\n", "the columns have to be t"),
        ("t,q a\n0,0\n", "'t' is no column with its unit"),
        ("t [ms]\n", "'t [ms]' is no column with its unit"),
        ("q a [rad or m],t [s]\n0,0\n", "found: q a, t"),
        ("t [s],q a [rad or m],qd b [rad/s or m/s],qdd a [rad/s^2 or m/s^2]\n0,0,0,0\n", "found: t, q a, qd b, qdd a"),
        (HEADER + "0,1,2\n", "line 2 is not 4 numbers"),
        (HEADER + "0,1,2,x\n", "line 2 is not 4 numbers"),
        (HEADER + '0,"1,2,3\n', "not CSV"),
    ],
)
def test_broken_csv_is_refused(text, said):
    with pytest.raises(FormatError, match=said.replace("[", r"\[")):
        gp.Trajectory.from_csv(text)


def test_csv_with_times_that_do_not_increase_is_refused():
    with pytest.raises(SettingError, match="time must increase"):
        gp.Trajectory.from_csv(HEADER + "1,0,0,0\n0,0,0,0\n")


def test_csv_without_samples_is_refused():
    with pytest.raises(ShapeError, match="t has shape"):
        gp.Trajectory.from_csv(HEADER)


def test_parquet_carries_its_units(trajectory, tmp_path):
    trajectory.to_parquet(tmp_path / "t.parquet")
    schema = pq.read_schema(tmp_path / "t.parquet")
    assert schema.field("qd arm/two").metadata == {b"unit": b"rad/s or m/s"}
    assert schema.metadata[b"schema"] == b"graceful_plan.trajectory"


@pytest.mark.parametrize("change", ["text", "schema", "unit", "type", "order", "null"])
def test_other_parquet_is_refused(trajectory, tmp_path, change):
    import pyarrow as pa

    file = tmp_path / "t.parquet"
    trajectory.to_parquet(file)
    table = pq.read_table(file)
    if change == "text":
        file.write_text("t,q\n")
    elif change == "schema":
        pq.write_table(table.replace_schema_metadata({b"schema": b"other"}), file)
    elif change == "unit":
        pq.write_table(table.set_column(0, pa.field("t", pa.float64(), metadata={"unit": "ms"}), table["t"]), file)
    elif change == "type":
        pq.write_table(table.set_column(0, table.field("t").with_type(pa.string()), table["t"].cast(pa.string())), file)
    elif change == "order":
        pq.write_table(table.select(table.column_names[::-1]), file)
    else:
        nothing = pa.nulls(len(table), pa.float64())
        pq.write_table(table.set_column(0, table.field("t").with_nullable(True), nothing), file)
    with pytest.raises(FormatError, match=r"t\.parquet: "):
        gp.Trajectory.from_parquet(file)


def test_without_pyarrow_the_message_helps(trajectory, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *_: None)
    for call in (trajectory.to_parquet, gp.Trajectory.from_parquet):
        with pytest.raises(MissingArrow, match=r"pip install '\.\[data\]'"):
            call(tmp_path / "t.parquet")


@pytest.mark.parametrize("read", [gp.Trajectory.from_csv, gp.Trajectory.from_json])
def test_files_that_are_no_text_are_refused(read, tmp_path):
    (tmp_path / "t").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match=str(tmp_path / "t")):
        read(tmp_path / "t")

"""Floor maps: files, hostile files, distances, slices of scenes, and scenes made from maps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import TypeCheckError

import graceful_plan as gp
from graceful_plan.exceptions import FormatError, SettingError, ShapeError, UnknownNameError
from graceful_plan.mobile.floor.files.moving_ai import MovingAIScenario, read_scenarios
from graceful_plan.mobile.floor.occupancy_grid import MAX_CELLS, OccupancyGrid

_TOLERANCE = 1e-5  # distances are single precision, rounded down
YAML = "image: {image}\nresolution: 0.1\norigin: [1.0, 2.0, 0.5]\nnegate: {negate}\n{more}"
THRESHOLDS = "occupied_thresh: 0.65\nfree_thresh: 0.196\n"


def rooms():
    occupied = np.zeros((60, 80), dtype=bool)
    occupied[20:23, :60] = occupied[40:43, 20:] = True
    return occupied


def written(folder, pixels, *, most=255, negate=0, more=THRESHOLDS, plain=False):
    rows, columns = np.shape(pixels)
    head = f"{'P2' if plain else 'P5'} # made by hand\n{columns} {rows}\n{most}\n"
    if plain:
        body = "\n".join(" ".join(map(str, row)) for row in pixels).encode()
    else:
        body = np.asarray(pixels).astype(">u2" if most > 255 else np.uint8).tobytes()
    (folder / "m.pgm").write_bytes(head.encode() + body)
    (folder / "m.yaml").write_text(YAML.format(image="m.pgm", negate=negate, more=more))
    return folder / "m.yaml"


@pytest.mark.parametrize("outside", [True, False])
@given(seed=st.integers(0, 1000), share=st.floats(0, 0.5))
@settings(max_examples=15, deadline=None)
def test_distances_are_to_the_nearest_square(outside, seed, share):
    from graceful_plan.core import _native

    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 14, 2))
    blocked = rng.uniform(size=shape) < share
    found = _native.distance_field(blocked=blocked.astype(np.uint8), resolution=0.1, outside=outside)
    row, column = np.indices(shape)
    least = np.full(shape, np.inf)
    for r, c in np.argwhere(blocked):
        gap = np.hypot(np.maximum(np.abs(row - r) - 0.5, 0), np.maximum(np.abs(column - c) - 0.5, 0))
        least = np.minimum(least, np.where((row == r) & (column == c), 0, gap))
    if outside:
        sides = np.stack([row, column, shape[0] - 1 - row, shape[1] - 1 - column])
        least = np.minimum(least, np.where(blocked, 0, sides.min(axis=0) + 0.5))
    np.testing.assert_allclose(found, 0.1 * least, atol=_TOLERANCE)
    assert (found <= 0.1 * least + 1e-12).all()


def test_pixels_become_occupancy_as_in_map_server(tmp_path):
    # Above, below and between the thresholds; 205 is unknown, since 50 / 255 = .1961 is above .196.
    file = written(tmp_path, [[0, 89, 90], [205, 206, 254]])
    floor = OccupancyGrid.from_map_server(file)
    assert floor.occupancy.tolist() == [[-1, 0, 0], [100, 100, -1]]
    assert floor.origin == (1.0, 2.0, 0.5) and floor.resolution == 0.1
    assert floor.occupied.tolist() == [[True, False, False], [True, True, True]]
    negated = OccupancyGrid.from_map_server(written(tmp_path, [[0, 89, 166, 255]], negate=1))
    assert negated.occupancy.tolist() == [[0, -1, 100, 100]]
    scale = OccupancyGrid.from_map_server(written(tmp_path, [[0, 153, 255]], more="mode: scale\n" + THRESHOLDS))
    assert scale.occupancy.tolist() == [[100, round(100 * (0.4 - 0.196) / (0.65 - 0.196)), 0]]
    raw = OccupancyGrid.from_map_server(written(tmp_path, [[0, 37, 100, 101, 255]], more="mode: raw\n"))
    assert raw.occupancy.tolist() == [[0, 37, 100, -1, -1]]


@pytest.mark.parametrize("plain", [True, False])
def test_deep_and_plain_pictures_are_read(tmp_path, plain):
    file = written(tmp_path, [[0, 30000, 65535]], most=65535, plain=plain)
    assert OccupancyGrid.from_map_server(file).occupancy.tolist() == [[100, -1, 0]]


def test_png_is_read(tmp_path):
    from PIL import Image

    file = written(tmp_path, [[0]])
    Image.fromarray(np.array([[0, 254], [205, 254]], dtype=np.uint8)).save(tmp_path / "other.png")
    found = OccupancyGrid.from_map_server(file, image=tmp_path / "other.png")
    assert found.occupancy.tolist() == [[-1, 0], [100, 0]]


@given(seed=st.integers(0, 100), mixed=st.booleans())
@settings(max_examples=10, deadline=None)
def test_saved_maps_can_be_read(tmp_path_factory, seed, mixed):
    rng, folder = np.random.default_rng(seed), tmp_path_factory.mktemp("maps")
    values = np.arange(-1, 101) if mixed else np.array([-1, 0, 100])
    floor = OccupancyGrid(
        occupancy=rng.choice(values, size=rng.integers(1, 9, 2)), resolution=0.05, origin=(0.1, -2.0, 1e-3)
    )
    floor.save(folder / "m.yaml")
    again = OccupancyGrid.from_map_server(folder / "m.yaml")
    np.testing.assert_array_equal(again.occupancy, floor.occupancy)
    assert (again.resolution, again.origin) == (floor.resolution, floor.origin)
    floor.save_moving_ai(folder / "m.map")
    np.testing.assert_array_equal(OccupancyGrid.from_moving_ai(folder / "m.map").occupied, floor.occupied)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"P5\n4 4\n255\n" + bytes(15), "truncated: 15 of 16"),
        (b"P2\n2 2\n255\n1 2 3", "truncated: 3 of 4"),
        (b"P2\n2 1\n255\n1 -2", "not whole numbers"),
        (b"P2\n2 1\n255\n1 300", "above the greatest value"),
        (b"P5\n999999999 999999999\n255\n", "999999999 x 999999999 pixels"),
        (b"P5\n99999999999999999999 1\n255\n", "no width"),
        (b"P5\n0 4\n255\n", "0 x 4 pixels"),
        (b"P5\n2 2\n70000\n", "greatest value is 70000"),
        (b"P6\n2 2\n255\n", "neither a PGM"),
        (b"", "neither a PGM"),
        (b"\x89PNG\r\n\x1a\n" + bytes(8) + b"\xff\xff\xff\xff\xff\xff\xff\xff" + bytes(20), "4294967295 x 4294967295"),
        (b"\x89PNG\r\n\x1a\n" + bytes(8) + b"\0\0\0\1\0\0\0\1" + bytes(20), "broken PNG"),
    ],
)
def test_hostile_pictures_are_refused(tmp_path, content, said):
    file = written(tmp_path, [[0]])
    (tmp_path / "m.pgm").write_bytes(content)
    with pytest.raises(FormatError, match=said):
        OccupancyGrid.from_map_server(file)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("image: ../secret.pgm\nresolution: 1\norigin: [0, 0, 0]\n", "not in the folder"),
        ("image: /etc/hostname\nresolution: 1\norigin: [0, 0, 0]\n", "not in the folder"),
        ("image: m.pgm\nresolution: 0\norigin: [0, 0, 0]\n", "resolution of 0"),
        ("image: m.pgm\nresolution: .nan\norigin: [0, 0, 0]\n", "not finite"),
        ("image: m.pgm\nresolution: 1\norigin: [0, 0]\n", "2 numbers, expected 3"),
        ("image: m.pgm\nresolution: 1\norigin: [0, 0, 0]\nmode: other\n", "unknown mode 'other'"),
        ("image: m.pgm\nresolution: 1\norigin: [0, 0, 0]\nnegat: 1\n", "unknown key 'negat'"),
        ("image: m.pgm\nresolution: 1\norigin: [0, 0, 0]\nnegate: 2\n", "negate has to be 0 or 1"),
        ("image: m.pgm\nresolution: 1\norigin: [0, 0, 0]\n", "needs the key 'occupied_thresh'"),
        (
            "image: m.pgm\nresolution: 1\norigin: [0, 0, 0]\noccupied_thresh: 0.2\nfree_thresh: 0.4\n",
            "0 <= free < occupied",
        ),
        ("image: gone.pgm\nresolution: 1\norigin: [0, 0, 0]\n" + THRESHOLDS, "cannot be read"),
        ("image: &a m.pgm\n", "anchors"),
    ],
)
def test_hostile_yaml_is_refused(tmp_path, text, said):
    written(tmp_path, [[0]])
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(FormatError, match=said):
        OccupancyGrid.from_map_server(tmp_path / "m.yaml")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("type octile\nheight 2\nwidth 2\nmap\n..\n", "1 of 2"),
        ("type octile\nheight 1\nwidth 3\nmap\n..\n", "row 0 "),
        ("type octile\nheight 1\nwidth 2\nmap\n.x\n", "'x'"),
        ("type octile\nheight 99999999\nwidth 99999999\nmap\n", "99999999"),
        ("type octile\nheight 99999999999\nwidth 1\nmap\n", "height"),
        ("type tile\nheight 1\nwidth 1\nmap\n.\n", "m.map"),
        ("", "m.map"),
    ],
)
def test_hostile_movingai_maps_are_refused(tmp_path, text, said):
    (tmp_path / "m.map").write_text(text)
    with pytest.raises(FormatError, match=said):
        OccupancyGrid.from_moving_ai(tmp_path / "m.map")


def test_movingai_maps_and_scenarios_count_from_above(tmp_path):
    (tmp_path / "m.map").write_text("type octile\nheight 2\nwidth 3\nmap\n.@S\nTWG\n")
    floor = OccupancyGrid.from_moving_ai(tmp_path / "m.map")
    assert floor.occupied.tolist() == [[True, True, False], [False, True, False]]
    one = MovingAIScenario((0, 1), (2, 0), 3.5)
    (tmp_path / "m.scen").write_text("version 1\n0\tm.map\t3\t2\t0\t0\t2\t1\t3.5\n")
    assert read_scenarios(tmp_path / "m.scen") == [one]
    (tmp_path / "m.scen").write_text("version 1\n1 m.map 3 2 0 0 2 5 3.5\n")
    with pytest.raises(FormatError, match=r"m\.scen"):
        read_scenarios(tmp_path / "m.scen")


def test_misuse_is_refused():
    with pytest.raises(ShapeError, match="occupancy"):
        OccupancyGrid(occupancy=np.zeros(3, dtype=int), resolution=1.0)
    with pytest.raises(SettingError, match=r"-1 .*100"):
        OccupancyGrid(occupancy=np.full((2, 2), 101), resolution=1.0)
    with pytest.raises(SettingError, match="resolution"):
        OccupancyGrid(occupancy=rooms(), resolution=-1.0)
    box = gp.StaticBody(name="box", kind="box", size=[1.0, 1.0, 1.0], pose=np.zeros(3))
    with pytest.raises(SettingError, match="class"):
        OccupancyGrid(occupancy=rooms(), resolution=1.0, entities=(box,))
    with pytest.raises(SettingError, match="yaw of 0"):
        OccupancyGrid(occupancy=rooms(), resolution=1.0, origin=(0.0, 0.0, 1.0)).walls()
    with pytest.raises(UnknownNameError, match="robot that drives"):
        OccupancyGrid(occupancy=rooms(), resolution=0.1).to_scene("panda")
    assert MAX_CELLS == 2**26


@given(seed=st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_cells_and_points_belong_together_and_clearance_is_never_too_much(seed):
    rng = np.random.default_rng(seed)
    floor = OccupancyGrid(
        occupancy=rng.uniform(size=(12, 15)) < 0.1, resolution=0.2, origin=tuple(rng.uniform(-2, 2, 3))
    )
    cells = rng.integers(0, [15, 12], (20, 2))
    np.testing.assert_array_equal(floor.cells(floor.centres(cells)), cells)
    xy = rng.uniform(-0.5, 3.5, (30, 2))
    np.testing.assert_allclose(floor.on_map(floor.in_world(xy)), xy, atol=1e-12)
    clear = floor.clearance(floor.in_world(xy))
    for point, least in zip(xy, clear, strict=True):
        gaps = [
            np.hypot(*np.maximum(np.abs(point - (np.array(c) + 0.5) * 0.2) - 0.1, 0))
            for c in np.argwhere(floor.occupied)[:, ::-1]
        ]
        assert least <= min([*gaps, *np.maximum(point, 0), *np.maximum((3.0, 2.4) - point, 0)]) + 1e-6


def test_a_scene_is_cut_where_something_stands_between_two_heights():
    scene = OccupancyGrid(occupancy=np.zeros((40, 40), dtype=bool), resolution=0.1).to_scene()
    c, s = np.cos(0.4), np.sin(0.4)
    X = np.array([[c, -s, 0, 2.0], [s, c, 0, 2.0], [0, 0, 1, 0.2], [0, 0, 0, 1.0]])
    scene = scene.edit(
        add=[
            gp.StaticBody(name="turned", kind="box", size=[0.6, 0.2, 0.1], pose=X),
            gp.StaticBody(name="high", kind="box", size=[0.3, 0.3, 0.1], pose=np.array([1.0, 1.0, 1.5])),
            gp.StaticBody(name="post", kind="cylinder", size=[0.15, 0.5], pose=np.array([3.0, 1.0, 0.5])),
            gp.StaticBody(name="ball", kind="sphere", size=0.2, pose=np.array([1.0, 3.0, 0.2])),
        ]
    )
    floor = OccupancyGrid.from_scene(scene, heights=(0.05, 0.4), resolution=0.05, bounds=(0.1, 3.9, 0.1, 3.9))
    row, column = np.indices(floor.shape)
    xy = floor.centres(np.stack([column, row], axis=-1))
    local = (xy - 2.0) @ np.array([[c, -s], [s, c]])
    inside = (np.abs(local) < (0.6, 0.2)).all(axis=-1) | (np.linalg.norm(xy - (3.0, 1.0), axis=-1) < 0.15)
    inside |= np.linalg.norm(xy - (1.0, 3.0), axis=-1) < 0.19
    far = (np.abs(local) > np.array([0.6, 0.2]) + 0.036).any(axis=-1)
    far &= (np.linalg.norm(xy - (3.0, 1.0), axis=-1) > 0.19) & (np.linalg.norm(xy - (1.0, 3.0), axis=-1) > 0.24)
    assert floor.occupied[inside].all() and not floor.occupied[far].any()
    with pytest.raises(SettingError, match="height"):
        OccupancyGrid.from_scene(scene, heights=(5.0, 6.0))
    with pytest.raises(SettingError, match="wider cells"):
        OccupancyGrid.from_scene(scene, resolution=1e-3, bounds=(0.0, 100.0, 0.0, 100.0))


def test_a_turned_map_becomes_the_same_floor_as_a_scene():
    person = gp.StaticBody(
        name="ann", kind="cylinder", size=[0.25, 0.85], pose=np.array([0.0, 3.0, 0.85]), entity="adult"
    )
    floor = OccupancyGrid(occupancy=rooms(), resolution=0.1, origin=(-3.0, -1.0, 0.3), entities=(person,))
    scene = floor.to_scene(severity={"adult": 30.0})
    assert scene.entities["ann"].severity["body"] == 30.0
    rng = np.random.default_rng(0)
    cells = rng.integers(0, [80, 60], (200, 2))
    q = np.column_stack([floor.centres(cells), np.zeros(200)])
    # A base whose middle is on an obstacle, or far from everything.
    on = floor.occupied[cells[:, 1], cells[:, 0]]
    far = (floor.clearance(q[:, :2]) > 0.6) & (np.linalg.norm(q[:, :2] - (0, 3), axis=1) > 0.9)
    clearance = gp.clearance(q, scene)
    assert (clearance[on] < 0).all() and (clearance[far] > 0).all() and on.any() and far.any()


def test_walls_go_into_any_scene():
    floor = OccupancyGrid(occupancy=rooms(), resolution=0.1, origin=(-4.0, -3.0, 0.0))
    scene = floor.to_scene()
    more = scene.edit(add=[floor.walls("more", height=0.5)])
    assert more.model.body("more").geomnum[0] == 2


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    "change",
    [
        {"occupancy": [[0], [0, 1]]}, {"occupancy": [[NAN]]}, {"occupancy": [["a"]]}, {"resolution": 1e-320},
        {"resolution": 1e300}, {"resolution": NAN}, {"origin": (1e300, 0.0, 0.0)}, {"origin": (0.0, NAN, 0.0)},
        {"occupied_from": NAN}, {"name": "a\0b"}, {"name": "\ud800"}, {"entities": ("vase",)},
    ],
    ids=str,
)  # fmt: skip
def test_unusable_maps_are_refused(change):
    with pytest.raises((gp.GracefulPlanError, TypeCheckError)):
        OccupancyGrid(**({"occupancy": [[0, 100]], "resolution": 0.1} | change))


def test_questions_about_far_away_and_files_that_cannot_be(tmp_path):
    floor = OccupancyGrid(occupancy=[[0, 0], [0, 100]], resolution=0.1)
    assert floor.clearance([[1e300, 0.0], [0.05, -1e300], [0.05, 0.05]]).tolist() == pytest.approx(
        [0.0, 0.0, 0.05], abs=1e-6
    )
    assert (floor.cells([1e300, -1e300]) == [2**40, -(2**40)]).all()
    for write in (floor.save, floor.save_moving_ai):
        for name in ("a\0.yaml", str(tmp_path / "absent" / "a.yaml")):
            with pytest.raises(FormatError, match="cannot be written"):
                write(name)
    with pytest.raises(SettingError, match="resolution"):
        OccupancyGrid.from_scene(gp.load_scene("tabletop"), resolution=1e-9)
    (tmp_path / "a\nb.map").write_text("type octile\nheight 1\nwidth 1\nmap\n.\n")
    assert OccupancyGrid.from_moving_ai(tmp_path / "a\nb.map").name == "a_b"

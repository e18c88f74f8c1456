"""Impact maps: the robot's own values at reachable poses, symmetry, blocking obstacles, unhappy paths."""

import dataclasses
import json
import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.analysis.gantry import centre_of_mass, gantry_scene
from graceful_plan.analysis.impact_maps import DIRECTIONS
from graceful_plan.costs.objective import moving_batch
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError
from graceful_plan.viz.impact_maps import draw_impact_map
from sizes import first_quick

_ROUNDING = 1e-9
"""Relative; the same formulas with poses from another kinematic chain."""
_TASKS = [
    ("tabletop_l3", "green_to_blue"),
    ("desk", "bring_coffee"),
    ("dining_table", "serve_tea"),
    ("kitchen_counter", "move_oil"),
]
_FALLING = ("carried", "contents")

WORLD = """<mujoco><worldbody>
  <geom name="ground" type="plane" size="0 0 1"/>{targets}
  <body name="arm" pos="0 0 1"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <joint name="x" type="slide" axis="1 0 0" range="-5 5"/><joint name="y" type="slide" axis="0 1 0" range="-5 5"/>
    <joint name="z" type="slide" axis="0 0 1" range="-5 5"/>
    <geom name="hand" type="sphere" size="0.2"/><site name="tool" pos="0 0 -0.3"/></body>
  <body name="load" pos="3 3 1" euler="0 0 90"><freejoint/><geom type="box" size="0.03 0.05 0.04"/></body>
</worldbody></mujoco>"""


def boxes(*places, half="0.1 0.1 0.1"):
    """A scene of slides that hold a box over boxes on the ground."""
    names = [f"target{i}" for i in range(len(places))]
    bodies = [
        f'<body name="{name}" pos="{x} {y} 0.1"><geom type="box" size="{half}"/></body>'
        for name, (x, y) in zip(names, places, strict=True)
    ]
    return gp.Scene.from_mjcf(
        WORLD.format(targets="".join(bodies)),
        robot="arm",
        tool="tool",
        velocity=[1.0] * 3,
        acceleration=[1.0] * 3,
        entities=dict.fromkeys(names, "glass"),
    ).attach("load", X_TO=np.eye(4))


class DropsHalfTheTime(gp.InteractionModel):
    """The gripper lets go in half of all failures; in the other half everything is hit."""

    share = 0.5

    def probability(self, batch):
        return sum(self.sources(batch).values())

    def sources(self, batch):
        drop = gp.ImpactCost(model="mixture").interaction.probability(batch)
        return {"drop": self.share * drop, "collapse": np.full_like(drop, 1.0 - self.share)}

    @property
    def knows_own_loss(self):
        return True

    def own_loss(self, batch, fragility):
        drop = gp.FailureMixture().own_loss(batch, fragility)["drop"]
        return {"drop": self.share * drop, "collapse": np.full_like(drop, 1.0 - self.share)}

    def fault_shares(self):
        return {"drop": {"slip": 0.4 * self.share, "open": 0.6 * self.share}, "collapse": {"power": 1.0 - self.share}}


class NeverDrops(DropsHalfTheTime):
    share = 0.0


@dataclasses.dataclass(frozen=True)
class OwnImpact(gp.Cost):
    def state(self, batch):
        return np.ones(len(batch))


def lowest_point(scene, q):
    """Height of the lowest point of the carried object at q, from MuJoCo; capsules count as cylinders."""
    model, data, low = scene.model, scene.data_at(q), []
    for geom in scene.components["carried"].geoms:
        half, R = model.geom_aabb[geom, 3:], data.geom_xmat[geom].reshape(3, 3)
        centre = data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3]
        kind = mujoco.mjtGeom(int(model.geom_type[geom]))
        reach = np.abs(R[2]) @ half
        if kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
            reach = abs(R[2, 2]) * half[2] + half[0] * math.sqrt(max(0.0, 1.0 - R[2, 2] ** 2))
        elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            reach = half[0]
        low.append(centre[2] - reach)
    return min(low)


def one_cell(place, width=0.01):
    x, y = place[:2]
    return (x - width / 2, x + width / 2, y - width / 2, y + width / 2)


# --- agreement with the robot -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", first_quick(["mixture", "box_overlap"]))
@pytest.mark.parametrize("name", first_quick(_TASKS), ids="/".join)
def test_a_cell_has_the_impact_of_the_robot_there(name, model):
    task = gp.load_scene(name[0]).tasks[name[1]]
    scene, rng, seen = task.scene, np.random.default_rng(0), 0
    share = rng.uniform(size=(12, 1))
    goal = np.atleast_2d(task.goal)[0]
    for q in (1.0 - share) * task.start + share * goal + rng.normal(scale=0.1, size=(12, len(goal))):
        c = scene.data_at(q).subtree_com[scene.model.body(scene.carried.body).id]
        found = gp.impact_map(
            scene,
            gp.ImpactCost(model=model),
            height=lowest_point(scene, q),
            surface=0.0,
            q=q,
            bounds=one_cell(c),
            resolution=0.01,
        )
        if found.blocked.all():
            continue
        cost = gp.ImpactCost(model=model, components=_FALLING)
        impact = (cost.probability(gp.StateBatch(scene, q[None]))[0] * cost.severity_table(scene)).sum(axis=0)
        np.testing.assert_allclose(found.by_entity[0, 0], impact, atol=_ROUNDING * max(1.0, impact.max()))
        seen += impact.sum() > 0.1
    assert seen >= 2


@given(st.floats(-0.3, 0.3), st.floats(0.0, 2.0), st.floats(0.0, 2.0 * np.pi))
def test_a_cell_with_a_velocity_has_the_impact_of_the_robot_there(x, speed, direction):
    scene = boxes((0.0, 0.0), (0.35, 0.1))
    found = gp.impact_map(
        scene,
        height=0.3,
        surface=0.0,
        speed=speed,
        direction=direction,
        q=[0.0, 0.0, 0.0],
        bounds=one_cell((x, 0.05)),
        resolution=0.01,
    )
    data = scene.data_at([0.0, 0.0, 0.0])
    q = np.array([x, 0.05, 0.3 + 0.04]) - data.subtree_com[scene.model.body("load").id]
    qd = speed * np.array([np.cos(direction), np.sin(direction), 0.0])
    cost = gp.ImpactCost()
    expected = (cost.probability(moving_batch(scene, q[None], qd[None]))[0] * cost.severity_table(scene)).sum(axis=0)
    np.testing.assert_allclose(found.by_entity[0, 0], expected, atol=1e-9)


# --- laws -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.0, 0.7])
def test_a_symmetric_scene_has_a_symmetric_map(speed):
    found = gp.impact_map(
        boxes((0.0, 0.0)), height=0.3, speed=speed, bounds=(-0.5, 0.5, -0.4, 0.4), resolution=0.05
    ).impact
    assert found.max() > 1.0
    assert np.ptp(found) > 1.0
    for mirrored in (found[::-1], found[:, ::-1]):
        np.testing.assert_allclose(found, mirrored, rtol=1e-9)


def test_all_directions_are_the_mean_of_each():
    settings = {"height": 0.4, "speed": 1.0, "bounds": (-0.5, 0.5, -0.5, 0.5), "resolution": 0.1}
    scene = boxes((0.1, 0.0), (-0.2, 0.3))
    each = [
        gp.impact_map(scene, direction=2.0 * np.pi * k / DIRECTIONS, **settings).by_entity for k in range(DIRECTIONS)
    ]
    np.testing.assert_allclose(gp.impact_map(scene, **settings).by_entity, np.mean(each, axis=0), rtol=1e-12)
    assert np.ptp([part.sum() for part in each]) > 0.0


def test_the_object_flies_on_in_its_direction():
    scene = boxes((0.5, 0.0))
    settings = {"height": 0.6, "speed": 1.0, "bounds": (0.0, 1.0, -0.025, 0.025), "resolution": 0.05}
    middle = [
        np.average(found.x, weights=found.impact[0])
        for found in (gp.impact_map(scene, direction=direction, **settings) for direction in (0.0, np.pi))
    ]
    assert middle[0] < 0.4
    assert middle[1] > 0.6


def test_entities_add_up_and_the_ground_is_none():
    found = gp.impact_map(boxes((0.0, 0.0), (0.3, 0.0)), height=0.3, speed=0.3, resolution=0.05)
    np.testing.assert_allclose(found.impact, found.by_entity.sum(axis=-1))
    assert found.entities == ("target0", "target1", "load")
    assert found.by_entity.shape == (len(found.y), len(found.x), 3)
    without = gp.impact_map(
        boxes((0.0, 0.0), (0.3, 0.0)), gp.ImpactCost(own_loss=False), height=0.3, speed=0.3, resolution=0.05
    )
    assert without.entities == ("target0", "target1")
    np.testing.assert_array_equal(without.by_entity, found.by_entity[..., :2])


def test_a_deeper_fall_damages_the_object_more():
    """A fall of 0.2 m onto the box, and of 0.4 m onto the ground."""
    found = gp.impact_map(boxes((0.0, 0.0)), height=0.4, bounds=(-0.5, 0.5, -0.01, 0.01), resolution=0.02)
    own = found.by_entity[0, :, found.entities.index("load")]
    assert own[0] == pytest.approx(own[-1]) and own[0] > 1.2 * own[len(own) // 2] > 0.0


def test_only_falling_components_are_in_the_map():
    scene, settings = boxes((0.0, 0.0)), {"height": 0.3, "resolution": 0.1}
    body, all_parts, carried = (
        gp.impact_map(scene, gp.ImpactCost(model="box_overlap", components=components), **settings).impact
        for components in (("body",), ("body", "carried", "contents"), ("carried",))
    )
    assert not body.any()
    assert carried.any()
    np.testing.assert_array_equal(all_parts, carried)


def test_other_failures_are_left_out():
    scene, settings = boxes((0.0, 0.0)), {"height": 0.3, "resolution": 0.1}
    mixed = gp.impact_map(scene, gp.ImpactCost(model=DropsHalfTheTime()), **settings)
    np.testing.assert_allclose(mixed.impact, gp.impact_map(scene, **settings).impact, rtol=1e-12)
    with pytest.raises(SettingError, match="gripper"):
        gp.impact_map(scene, gp.ImpactCost(model=NeverDrops()), **settings)


# --- places -----------------------------------------------------------------------------------------------------------


def test_cells_are_blocked_where_boxes_overlap():
    # The box stands turned by 90 degrees: half sizes 0.05 and 0.03. The ground begins where the box ends.
    found = gp.impact_map(boxes((0.0, 0.0)), height=0.05, bounds=(-0.3, 0.3, -0.3, 0.3), resolution=0.02)
    x, y = np.meshgrid(found.x, found.y)
    np.testing.assert_array_equal(found.blocked, (np.abs(x) < 0.15) & (np.abs(y) < 0.13))
    assert np.isnan(found.by_entity[found.blocked]).all()
    assert np.isfinite(found.by_entity[~found.blocked]).all()


def test_the_robot_is_not_in_the_map():
    scene = boxes((0.6, 0.0))
    data = scene.data_at([0.0, 0.0, 0.0])
    found = gp.impact_map(scene, height=float(data.geom("hand").xpos[2]), bounds=(-0.1, 0.1, -0.1, 0.1))
    assert not found.blocked.any()


@pytest.mark.parametrize(("name", "top"), [("tabletop", 0.4), ("desk", 0.74), ("dining_table", 0.74)])
def test_heights_count_from_where_most_things_stand(name, top):
    task = next(iter(gp.load_scene(name).tasks.values()))
    found = gp.impact_map(task.scene, height=0.2, resolution=0.2)
    assert found.surface == pytest.approx(top, abs=1e-6)
    assert not found.blocked.all()


def test_the_default_window_is_around_the_entities_and_within_reach():
    scene = boxes((0.5, 0.2), (-0.3, 0.1))
    found = gp.impact_map(scene, height=0.3, resolution=0.05)
    half = 0.5 * (found.x[1] - found.x[0])
    assert (found.x[0] - half, found.x[-1] + half) == pytest.approx((-0.6, 0.8))
    task = gp.load_scene("desk").tasks["bring_coffee"]
    wide = gp.impact_map(task.scene, height=0.3, resolution=0.1)
    assert np.hypot(wide.x.max(), wide.y.max()) < 2.0


def test_the_object_is_upright_unless_a_configuration_is_given():
    scene = boxes((0.0, 0.0))
    upright = gp.impact_map(scene, height=0.3, resolution=0.1)
    np.testing.assert_allclose(upright.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-9)
    held = gp.impact_map(scene, height=0.3, resolution=0.1, q=[0.0, 0.0, 0.0])
    np.testing.assert_allclose(held.rotation, np.eye(3), atol=1e-9)


# --- the gantry -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", _TASKS, ids="/".join)
def test_a_gantry_keeps_everything_but_the_robot(name):
    scene = gp.load_scene(name[0]).tasks[name[1]].scene
    gantry = gantry_scene(scene, np.eye(3))
    assert list(gantry.entities) == list(scene.entities)
    assert all(gantry.entities[k].severity == scene.entities[k].severity for k in scene.entities)
    assert gantry.contents == scene.contents
    place = np.array([0.3, -0.2, 1.5])
    data, body = gantry.data_at(place), gantry.model.body(gantry.carried.body).id
    np.testing.assert_allclose(data.subtree_com[body], place, atol=1e-9)
    np.testing.assert_allclose(data.xmat[body].reshape(3, 3), np.eye(3), atol=1e-9)
    np.testing.assert_allclose(centre_of_mass(gantry), centre_of_mass(scene), atol=1e-9)
    robots = {gantry.model.body(b).name for b in scene.robot_bodies}
    assert not {body for body in gantry.unlabelled if body in robots}


def test_a_gantry_of_nothing():
    with pytest.raises(ShapeError, match="carried"):
        gantry_scene(gp.load_scene("desk"), np.eye(3))


# --- documents and pictures -------------------------------------------------------------------------------------------


def test_the_document_has_the_same_values():
    found = gp.impact_map(boxes((0.0, 0.0)), height=0.05, speed=0.2, direction=1.0, resolution=0.05)
    document = json.loads(found.to_json())
    impact = np.array(document["impact"], dtype=float)
    np.testing.assert_array_equal(impact, found.impact)
    assert found.blocked.any()
    assert document["by_entity"].keys() == {"target0", "load"}
    assert (document["height"], document["speed"], document["direction"]) == (0.05, 0.2, 1.0)


def test_the_text_names_the_worst_place():
    found = gp.impact_map(boxes((0.0, 0.0)), height=0.3, resolution=0.05)
    first, *_ = str(found).splitlines()
    assert first.startswith("load let go at rest, 0.3 m above z = 0.000 m: ")
    row = next(line for line in str(found).splitlines() if line.startswith("everything"))
    worst = np.unravel_index(np.argmax(found.impact), found.impact.shape)
    assert [float(x) for x in row.split()[1:]] == pytest.approx(
        [found.impact.max(), found.x[worst[1]], found.y[worst[0]]], rel=1e-3, abs=1e-3
    )


@pytest.mark.parametrize(
    ("bounds", "resolution"),
    [(None, 0.08), (one_cell((0.0, 0.0)), 0.02), (one_cell((0.4, 0.0)), 0.02)],
    ids=["all", "blocked", "free"],
)
def test_a_picture_is_drawn(bounds, resolution, tmp_path):
    scene = boxes((0.0, 0.0))
    found = gp.impact_map(scene, height=0.05, speed=0.3, direction=0.5, bounds=bounds, resolution=resolution)
    assert str(found)
    draw_impact_map(found, scene, tmp_path / "picture.png")
    from matplotlib.image import imread

    assert np.ptp(imread(tmp_path / "picture.png")[..., :3], axis=(0, 1)).max() > 0.5


# --- unhappy paths --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"height": -0.1}, r"height = -0\.1, expected a finite number of at least 0"),
        ({"height": math.nan}, "height = nan"),
        ({"speed": -1.0}, r"speed = -1\.0"),
        ({"speed": math.inf}, "speed = inf"),
        ({"direction": math.nan}, r"direction = nan, expected an angle \[rad\], finite"),
        ({"surface": math.nan}, "surface = nan"),
        ({"resolution": 0.0}, r"resolution = 0\.0, expected a finite width"),
        ({"resolution": 1e-5}, r"resolution = 1e-05, expected wider cells: these are .* at most 1000000"),
        ({"bounds": (0.5, -0.5, 0.0, 1.0)}, "bounds = .*least x, greatest x"),
        ({"impact": OwnImpact()}, r"impact = OwnImpact\(.*, expected an ImpactCost"),
    ],
)
def test_settings_outside_of_their_range(settings, message):
    with pytest.raises(SettingError, match=message):
        gp.impact_map(boxes((0.0, 0.0)), **({"height": 0.3} | settings))


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"q": [0.0]}, ShapeError, "q has shape"),
        ({"q": [0.0, math.nan, 0.0]}, NonFiniteError, r"q is not finite at index \(1,\)"),
        ({"bounds": (0.0, 1.0)}, ShapeError, "bounds has shape"),
        ({"bounds": (0.0, 1.0, 0.0, math.nan)}, NonFiniteError, "bounds is not finite"),
    ],
)
def test_arrays_of_the_wrong_kind(settings, error, message):
    with pytest.raises(error, match=message):
        gp.impact_map(boxes((0.0, 0.0)), height=0.3, **settings)


def test_nothing_is_carried():
    with pytest.raises(ShapeError, match="carried"):
        gp.impact_map(gp.load_scene("desk"), height=0.3)


def test_nothing_stands_on_anything():
    scene = boxes()
    with pytest.raises(SettingError, match="surface = None"):
        gp.impact_map(scene, height=0.3)
    with pytest.raises(SettingError, match="bounds = None"):
        gp.impact_map(scene, height=0.3, surface=0.0)
    found = gp.impact_map(scene, height=0.3, surface=0.0, bounds=one_cell((0.0, 0.0)))
    assert found.entities == ("load",) and found.impact.all()

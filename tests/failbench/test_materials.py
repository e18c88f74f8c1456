"""Materials of the bundled scenes bounce and roll as documented, and objects at rest stay at rest."""

import re

import mujoco
import numpy as np
import pytest
from places import ROOT

import failbench
from benchmarks import suite
from support.scenes import materials

SCENES = ("desk", "dining_table", "kitchen_counter")
EACH = [(scene, name) for scene in SCENES for name in materials.of(scene)]


def documented():
    """Rows of the table in docs/failbench.md: material, damping ratio, e set and measured, lever arm [mm]."""
    lines = (ROOT / "docs" / "failbench.md").read_text().split("## Materials")[1].split("\n## ")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if re.match(r"\| [a-z]", line)]
    return {
        name: [float(re.split(r"\s", cell)[0]) for cell in row]
        for names, *row in rows[1:]
        for name in names.split(", ")
    }


@pytest.mark.parametrize(("scene", "name"), EACH)
def test_materials_bounce_and_roll_as_specified(scene, name):
    found, asked = materials.measure(scene, name), materials.MATERIALS[name]
    assert found.restitution[1] == pytest.approx(asked.restitution, abs=0.05)
    assert found.restitution[2] == pytest.approx(asked.restitution, abs=0.05)
    assert found.rolling == pytest.approx(asked.rolling, rel=0.05)


def test_the_measurement_is_right_for_mujocos_defaults():
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/><worldbody>
        <geom type="plane" size="0 0 1"/>
        <body><freejoint/><geom type="cylinder" size="{materials.RADIUS} 0.08"/></body></worldbody></mujoco>"""
    )
    assert materials.rolling(model) == pytest.approx(0.0, abs=2e-5)
    for ratio, least, most in ((1.0, 0.0, 0.02), (0.2, 0.5, 0.65)):
        sphere = mujoco.MjModel.from_xml_string(
            f"""<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
            <geom type="plane" size="0 0 1" solref="0.02 {ratio}" priority="1"/>
            <body><freejoint/><geom type="sphere" size="{materials.RADIUS}"/></body></worldbody></mujoco>"""
        )
        assert least <= materials.restitution(sphere, 0.3) <= most


def test_soft_partners_take_the_bounce():
    assert max(materials.measure("kitchen_counter", "glass", on="skin").restitution) < 0.05
    assert materials.measure("kitchen_counter", "glass", on="stone").restitution[1] == pytest.approx(0.3, abs=0.05)


def test_the_table_in_the_docs_equals_the_scenes():
    table = documented()
    assert set(table) == set(materials.MATERIALS)
    for scene, name in EACH:
        ratio, asked, measured, arm = table[name]
        assert suite.scene(scene).spec.find_default(name).geom.solref[1] == ratio
        assert (asked, 1e-3 * arm) == pytest.approx(materials.MATERIALS[name])
        assert measured == pytest.approx(materials.measure(scene, name).restitution[1], abs=0.01)


@pytest.mark.parametrize("scene", SCENES)
def test_movable_things_have_a_material(scene):
    """Every body with a free joint and a collision geom has a material of the table."""
    world = failbench.build_world(suite.scene(scene))
    model, spec = world.model, suite.scene(scene).spec
    known = {tuple(spec.find_default(name).geom.solref) for name in materials.of(scene)}
    for body in world.movable.values():
        for geom in np.flatnonzero((model.geom_bodyid == body) & (model.geom_contype > 0)):
            assert tuple(model.geom_solref[geom]) in known, model.geom(geom).name


def test_a_lying_bottle_comes_to_rest():
    world = failbench.build_world(suite.scene("dining_table"))
    model = materials.alone(world, world.movable["bottle"])
    data = mujoco.MjData(model)
    data.qpos[:] = [0.0, 0.0, model.geom_size[1, 0], np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]
    data.qvel[0], data.qvel[5] = 0.3, -0.3 / model.geom_size[1, 0]
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
    assert data.qpos[0] > 0.2  # it rolls
    mujoco.mj_step(model, data, nstep=round(5.0 / model.opt.timestep))
    assert data.qpos[0] < 1.0
    assert np.abs(data.qvel).max() < 0.01


@pytest.mark.parametrize("scene", SCENES)
def test_objects_at_rest_stay_and_fall_asleep(scene):
    world = failbench.build_world(suite.scene(scene))
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = world.scene.home_qpos
    mujoco.mj_forward(model, data)
    bodies = list(world.movable.values())
    before = data.xpos[bodies].copy()
    for _ in range(round(0.4 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert np.linalg.norm(data.xpos[bodies] - before, axis=1).max() < 5e-4
    assert np.all(data.tree_asleep[model.body_treeid[bodies]] >= 0)


def test_materials_do_not_change_the_pads():
    """Pads use their own contact parameters: no material makes the grasp springy."""
    world = failbench.build_world(suite.scene("dining_table"))
    model, pads = world.model, world.robot.pads
    others = np.setdiff1d(np.arange(model.ngeom), pads)
    assert model.geom_priority[pads].min() > model.geom_priority[others].max()
    assert np.all(model.geom_solref[pads] == [2.0 * model.opt.timestep, 1.0])
    assert model.geom_condim[pads].max() == 4  # 6 elsewhere

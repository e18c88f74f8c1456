from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.judge.exact import exactly_free, state_contacts
from graceful_plan.scene import contacts
from graceful_plan.scene.contacts import allowed_pairs, geoms_named, without
from graceful_plan.scene.elements import AllowedContact

_MASK = st.sampled_from([0, 1, 2, 3])


@st.composite
def heaps(draw: st.DrawFn) -> mujoco.MjModel:
    """Draw overlapping spheres on a random tree of bodies, with every kind of contact filter."""
    count = draw(st.integers(2, 9))
    spec = mujoco.MjSpec()
    bodies = [spec.worldbody]
    for i in range(count):
        parent = bodies[draw(st.integers(0, len(bodies) - 1))]
        body = parent.add_body(name=f"b{i}")
        if draw(st.booleans()):
            body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE)
        bodies.append(body)
    for i, body in enumerate(bodies):
        for k in range(draw(st.integers(1, 2))):
            size = [0.5, 0.0, 0.0]
            contype, conaffinity = draw(_MASK), draw(_MASK)
            name = f"g{i}_{k}"
            body.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size, contype=contype, conaffinity=conaffinity
            )
    for _ in range(draw(st.integers(0, 2))):
        first, second = draw(st.integers(0, count - 1)), draw(st.integers(0, count - 1))
        if first != second:
            spec.add_exclude(bodyname1=f"b{first}", bodyname2=f"b{second}")
    if draw(st.booleans()):
        spec.add_pair(geomname1="g0_0", geomname2=f"g{count}_0")
    if draw(st.booleans()):
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    return spec.compile()


def _contacts(model: mujoco.MjModel) -> set[tuple[int, int]]:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    return {(min(a, b), max(a, b)) for a, b in data.contact.geom.tolist()}


@settings(max_examples=30, deadline=None)
@given(heaps(), st.data())
def test_pairs_equal_those_tested_by_mujoco(model: mujoco.MjModel, data: st.DataObject) -> None:
    moving = data.draw(st.sets(st.integers(1, model.nbody - 1), min_size=1))
    pairs = contacts.tested_pairs(model, moving)
    found = {(min(a, b), max(a, b)) for a, b in pairs.tolist()}
    assert len(found) == len(pairs)
    assert found == {
        (a, b) for a, b in _contacts(model) if model.geom_bodyid[a] in moving or model.geom_bodyid[b] in moving
    }
    assert all(int(model.geom_bodyid[first]) in moving for first, _ in pairs.tolist())


def test_a_geom_that_moves_comes_first() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="base"><geom size="1"/><body><geom name="rigid" size="1"/>
        <body><joint/><geom name="link" size="1"/></body></body></body></worldbody></mujoco>"""
    )
    link = model.geom("link").id
    assert contacts.tested_pairs(model, {1, 2, 3}).tolist() == [[link, 0], [link, 1]]


_ARM = """<mujoco><worldbody><geom name="ground" type="plane" size="1 1 1"/>
<body name="hand"><joint/><geom name="palm" size="1"/>
  <body name="thumb"><geom name="tip" size="1"/><geom name="paint" size="1" contype="0" conaffinity="0"/></body>
  <body name="finger"><joint/><geom name="finger" size="1"/></body></body>
<body name="cup"><freejoint/><geom name="cup" size="1"/></body></worldbody></mujoco>"""


def _ids(model: mujoco.MjModel, *names: str) -> tuple[int, ...]:
    return tuple(model.geom(name).id for name in names)


def test_a_body_includes_its_rigid_descendants() -> None:
    model = mujoco.MjModel.from_xml_string(_ARM)
    assert geoms_named(model, "hand") == _ids(model, "palm", "tip")
    assert geoms_named(model, "finger") == _ids(model, "finger")
    assert geoms_named(model, "tip") == _ids(model, "tip")
    assert geoms_named(model, "world") == _ids(model, "ground")
    with pytest.raises(UnknownNameError, match=r"'paw'.*palm"):
        geoms_named(model, "paw")


def test_a_geom_takes_precedence_over_a_body_without_geoms() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/><body name="floor"/><body name="void"/>
        <body name="ball"><geom name="ball" size=".1"/><geom name="other" size=".1"/></body></worldbody></mujoco>"""
    )
    assert geoms_named(model, "floor") == _ids(model, "floor")
    assert geoms_named(model, "ball") == _ids(model, "ball", "other")
    assert geoms_named(model, "void") == ()


def test_allowed_pairs_are_taken_out() -> None:
    model = mujoco.MjModel.from_xml_string(_ARM)
    declared = [AllowedContact("hand", "cup"), AllowedContact("cup", "world", "ends")]
    palm, tip, cup, ground, finger = _ids(model, "palm", "tip", "cup", "ground", "finger")
    assert allowed_pairs(model, declared, "always") == {(palm, cup), (tip, cup)}
    assert allowed_pairs(model, declared, "ends") == {(ground, cup)}
    pairs = np.array([[palm, cup], [cup, tip], [cup, ground], [finger, cup]])
    assert without(pairs, allowed_pairs(model, declared, "always")).tolist() == [[cup, ground], [finger, cup]]
    assert without(pairs[:0], set()).shape == (0, 2)


def test_when_is_one_of_two_words() -> None:
    with pytest.raises(SettingError, match=r"'often'.*'always'.*'ends'"):
        AllowedContact("hand", "cup", "often")


def test_a_gripper_with_unnamed_bodies_can_hold():
    scene = gp.Scene.from_mjcf(
        """<mujoco><worldbody>
          <body name="arm"><joint name="j"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
            <site name="tool" pos="0.4 0 0"/>
            <body pos="0.4 0.03 0"><geom type="box" size="0.02 0.01 0.01"/></body></body>
          <body name="block" pos="1 0 0"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>
        </worldbody></mujoco>""",
        robot="arm",
        tool="tool",
        velocity=[1.0],
        acceleration=[1.0],
        carried="block",
        X_TO=gp.FROM_ABOVE,
    )
    finger, block = 1, 2
    assert (finger, block) in scene.allowed_pairs("always")
    with pytest.raises(UnknownNameError):
        geoms_named(scene.model, "#99")


_CHAIN = """<mujoco><worldbody><geom name="ground" type="plane" size="1 1 1" pos="0 0 -5"/>
<body name="r/foot"><geom size=".1"/><body name="r/a" pos="0 0 1"><joint range="-1 1"/><geom size=".1"/>
<body name="r/b" pos="0 0 1"><joint range="-1 1"/><geom size=".1"/>
<body name="r/c" pos="0 0 1"><joint range="-1 1"/><geom size=".1"/><site name="r/tip"/></body></body></body></body>
</worldbody><contact><exclude body1="r/a" body2="r/c"/></contact></mujoco>"""


def _chain(*allowed: AllowedContact) -> gp.Scene:
    return gp.Scene.from_mjcf(
        _CHAIN, robot="r/", tool="r/tip", velocity=[1.0] * 3, acceleration=[1.0] * 3, allowed_contacts=allowed
    )


def test_links_that_may_touch_are_listed_with_the_reason() -> None:
    scene = _chain(AllowedContact("r/foot", "r/c", reason="SRDF"))
    count, unchecked = contacts.unchecked_links(
        scene.model, scene.robot_bodies, scene.collision_pairs(), scene.allowed_contacts
    )
    assert unchecked == {
        "SRDF": [("r/foot", "r/c")],
        "adjacent": [("r/a", "r/b"), ("r/b", "r/c")],
        "filters of the model": [("r/a", "r/c")],
    }
    # The parent of r/a does not move, so MuJoCo tests the pair.
    assert count == 2
    assert "links that may not touch: 2 pairs; that may:\n  SRDF: r/foot - r/c\n  adjacent: " in scene.describe()


def test_more_contacts_may_be_allowed_later() -> None:
    scene = _chain()
    later = scene.with_allowed_contacts(AllowedContact("r/foot", "r/a"))
    assert len(later.collision_pairs()) == len(scene.collision_pairs()) - 1
    assert "  allowed: r/foot - r/a" in later.describe() and "  r/foot - r/a (always)" in later.describe()
    assert len(later.add_box("crate", [0.1] * 3, [2.0, 0.0, 0.0]).allowed_contacts) == 1
    with pytest.raises(UnknownNameError, match="'r/nose'"):
        scene.with_allowed_contacts(AllowedContact("r/foot", "r/nose"))


@pytest.mark.parametrize(("gap", "touching"), [(0.02, False), (0.001, False), (-0.001, True)])
def test_bodies_within_a_margin_do_not_touch(gap: float, touching: bool) -> None:
    """MuJoCo lists it among the contacts, with its positive distance."""
    scene = gp.Scene.from_mjcf(
        f"""<mujoco><worldbody>
          <geom name="wall" type="box" size=".1 1 1" pos="{1.3 + gap} 0 0" margin=".05"/>
          <body name="arm/x"><joint name="arm/x" type="slide" axis="1 0 0" range="-2 2"/>
            <geom type="sphere" size=".2" mass="1" margin=".05"/><site name="arm/tool"/></body>
        </worldbody></mujoco>""",
        robot="arm/",
        tool="arm/tool",
        velocity=[1.0],
        acceleration=[1.0],
    )
    assert bool(state_contacts(np.array([1.0]), scene)) is touching
    assert exactly_free(np.array([[1.0]]), scene).tolist() == [not touching]

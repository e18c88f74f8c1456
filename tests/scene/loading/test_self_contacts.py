"""MJCF models whose contact filters omit contacts between links."""

from __future__ import annotations

import logging
from pathlib import Path

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SceneError, SettingError, UnsupportedError
from graceful_plan.judge.exact import exactly_free
from graceful_plan.scene.loading.self_contacts import touching

FOLDED = [0.0, 2.6, 2.6]
"""The last link crosses the first one."""


def _arm(filters: str = 'conaffinity="0"', more: str = "") -> str:
    """Return an arm of three long links beside a wall."""
    link = f'<geom type="capsule" size=".04" fromto="0 0 .06 0 0 .34" {filters}/>'
    joint = '<joint axis="0 1 0" range="-3 3"/>'
    return f"""<mujoco><compiler angle="radian"/><worldbody>
      <geom name="wall" type="box" size=".1 1 1" pos="2 0 0"/>
      <body name="a"><joint name="turn" axis="0 0 1" range="-3 3"/>{link}
      <body name="b" pos="0 0 .4">{joint}{link}
      <body name="c" pos="0 0 .4">{joint}{link}
      <site name="tip" pos="0 0 .4"/>
      </body></body></body></worldbody>{more}</mujoco>"""


def _scene(text: str, self_collision: str = "model") -> gp.Scene:
    return gp.Scene.from_mjcf(
        text, robot="a", tool="tip", velocity=[1.0] * 3, acceleration=[3.0] * 3, self_collision=self_collision
    )


def test_filters_that_exclude_all_links_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "graceful_plan"):
        scene = _scene(_arm())
    assert "robot 'a'" in caplog.text and "1 pairs" in caplog.text and "self_collision='links'" in caplog.text
    assert "links that may not touch: 0 pairs" in scene.describe()
    assert exactly_free(np.array([FOLDED]), scene).all()
    caplog.clear()
    with caplog.at_level(logging.WARNING, "graceful_plan"):
        _scene(_arm(""))
        _scene(_arm(), self_collision="links")
    assert not caplog.records


def test_links_are_tested_despite_filters() -> None:
    scene = _scene(_arm(), self_collision="links")
    assert "links that may not touch: 1 pairs; that may:\n  adjacent: a - b, b - c" in scene.describe()
    assert not exactly_free(np.array([FOLDED]), scene).any()
    assert exactly_free(np.array([[0.0, 0.5, 0.0]]), scene).all()
    found = gp.plan([0.0, 0.5, 0.0], FOLDED, scene, w=0.0, time_limit=20.0)
    assert found.status is gp.PlanStatus.INVALID_GOAL
    # The surroundings are tested as before, also in scenes derived from this one.
    later = scene.add_box("crate", [0.1] * 3, [0.0, 0.8, 0.3])
    assert len(later.collision_pairs()) == len(scene.collision_pairs()) + 3 == 1 + 3 + 3


def test_links_are_as_those_of_a_model_without_filters() -> None:
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 3)) * 3.0
    free = exactly_free(q, _scene(_arm(), self_collision="links"))
    np.testing.assert_array_equal(free, exactly_free(q, _scene(_arm(""))))
    assert 0.3 < free.mean() < 1.0


def test_excluded_pairs_and_what_overlaps_everywhere_may_touch() -> None:
    exclude = '<contact><exclude body1="a" body2="c"/></contact>'
    assert len(_scene(_arm(more=exclude), self_collision="links").collision_pairs()) == 3
    long = _arm().replace('<site name="tip"', '<geom type="sphere" size=".7" conaffinity="0"/><site name="tip"')
    scene = _scene(long, self_collision="links")
    assert "overlap: a - c" in scene.describe()
    contacts = touching(mujoco.MjSpec.from_string(long.replace('conaffinity="0"', "")), "a", "tip").contacts
    assert {(c.first, c.second) for c in contacts} == {("a", "b"), ("b", "c"), ("a", "c")}


def test_kinds_are_two_and_a_bit_is_needed() -> None:
    with pytest.raises(SettingError, match=r"'all'.*'model', 'links'"):
        _scene(_arm(), self_collision="all")
    full = _arm(f'contype="{2**31 - 1}" conaffinity="0"')
    with pytest.raises(UnsupportedError, match="contype"):
        _scene(full, self_collision="links")


_LINKAGE = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="a"><joint name="turn" axis="0 1 0" range="-2 2"/><geom type="capsule" size=".04" fromto="0 0 0 0 0 .3"/>
    <body name="palm" pos="0 0 .4"><site name="tip" pos="0 0 .2"/><geom size=".05"/>
      <body name="knuckle" pos="0 .06 .05"><joint name="k" axis="1 0 0" range="-1 1"/><geom size=".02"/></body>
      <body name="finger" pos="0 .06 .07"><joint name="f" axis="1 0 0" range="-1 1"/><geom size=".02"/>
        <body name="nail" pos="0 0 .01"><geom size=".02"/></body></body></body></body>
  </worldbody></mujoco>"""
"""The knuckle and the finger are siblings that overlap, so the filters of the model test them."""


def _linkage(self_collision: str = "model", allowed_contacts: tuple[gp.AllowedContact, ...] = ()) -> gp.Scene:
    return gp.Scene.from_mjcf(
        _LINKAGE,
        robot="a",
        tool="tip",
        velocity=[1.0],
        acceleration=[3.0],
        self_collision=self_collision,
        allowed_contacts=allowed_contacts,
    )


def test_links_that_always_overlap_are_told_with_the_line_to_paste(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "graceful_plan"):
        scene = _linkage()
    assert "allowed_contacts=[gp.AllowedContact('knuckle', 'finger')]" in caplog.text
    assert not exactly_free(np.array([[0.0]]), scene).any()
    caplog.clear()
    with caplog.at_level(logging.WARNING, "graceful_plan"):
        pasted = _linkage(allowed_contacts=(gp.AllowedContact("knuckle", "finger"),))
        links = _linkage(self_collision="links")
    assert "overlap in nearly" not in caplog.text
    for scene in (pasted, links):
        assert exactly_free(np.array([[0.0], [1.0]]), scene).all()


def test_links_that_overlap_only_in_the_state_at_loading_are_not_told(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "graceful_plan"):
        scene = _scene(_arm("").replace('pos="0 0 .4">', 'pos="0 0 .15">'))
    assert not exactly_free(np.array([[0.0, 0.0, 0.0]]), scene).any()
    assert "overlap in nearly" not in caplog.text


def test_scene_files_follow_the_same_rule(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "linkage.xml").write_text(_LINKAGE)
    file = tmp_path / "linkage.yaml"
    told = "version: 1\nworld: linkage.xml\ntool: tip\nrobot: {prefix: a, velocity: [1], acceleration: [3]}\n"

    def free(more: str) -> bool:
        caplog.clear()
        file.write_text(told + more)
        with caplog.at_level(logging.WARNING, "graceful_plan"):
            return bool(exactly_free(np.array([[0.0], [1.0]]), gp.load_scene(file)).all())

    assert not free("")
    assert "AllowedContact('knuckle', 'finger')" in caplog.text
    for more in ("allowed_contacts: [{first: knuckle, second: finger}]", "self_collision: links"):
        assert free(more)
        assert not caplog.records
    with pytest.raises(SceneError, match=r"linkage\.yaml:5: .*'all'.*'links'"):
        free("self_collision: all")

"""Links whose spheres always overlap count as free where exact geometry is free, and almost nowhere else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core import slack
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import Judge

ARM = """<mujoco><compiler angle="radian"/><worldbody><body name="r/base">
  <geom type="box" size="0.06 0.06 0.1" pos="0 0 -0.1"/>
  <body name="r/short"><joint name="r/a" axis="0 0 1" range="-3 3"/>
    <geom type="sphere" size="0.01" mass="1"/>
    <body name="r/long" pos="0 0 {gap}"><joint name="r/b" axis="0 1 0" range="{range}"/>
      <geom type="box" size="0.06 0.06 0.1" pos="0 0 0.1" mass="1"/><site name="r/tool" pos="0 0 0.2"/>
</body></body></body></worldbody></mujoco>"""


def _scene(gap: float, limits: str) -> gp.Scene:
    return _with(ARM.format(gap=gap, range=limits))


def _with(text: str) -> gp.Scene:
    return gp.Scene.from_mjcf(
        text,
        robot="r/",
        tool="r/tool",
        velocity=[1.0, 1.0],
        acceleration=[1.0, 1.0],
        allowed_contacts=[gp.AllowedContact("r/base", "r/short")],
    )


def _drawn(scene: gp.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Draw configurations; return them and which of them are free by exact geometry."""
    q = np.random.default_rng(7).uniform(*scene.limits.position.T, (500, 2))
    judge = Judge(scene)
    touched = {touch.sample for touch in judge.touches(q) if judge.is_violation(touch, at_end=False)}
    return q, np.array([k not in touched for k in range(len(q))])


def test_links_that_never_touch_are_free() -> None:
    scene = _scene(0.006, "-0.01 0.01")
    q, free = _drawn(scene)
    assert free.all()
    compiled = compile_scene(scene)
    assert compiled.robot.self_slack.min() < 0.0
    assert compiled.kernels.free(q).all()
    assert not compiled.proof.free(q).any()  # the judge's pre-check must remain conservative


@pytest.mark.parametrize("gap", [0.012, 0.02])
def test_links_that_sometimes_touch_are_free_elsewhere(gap: float) -> None:
    scene = _scene(gap, "-0.5 0.5")
    q, free = _drawn(scene)
    assert 0.1 < free.mean() < 0.9
    compiled = compile_scene(scene)
    said = compiled.kernels.free(q)
    assert np.mean(said[free]) > 0.75 > np.mean(compiled.proof.free(q[free]))
    assert np.mean(said[~free]) < 0.01
    assert not compiled.proof.free(q[~free]).any()
    clear = compiled.kernels.clearance(q)
    np.testing.assert_array_equal(clear > 0.0, said)


def test_few_lost_configurations_count_where_a_link_is_a_mesh() -> None:
    corners = "".join(f"{x} {y} {z} " for x in (-0.06, 0.06) for y in (-0.06, 0.06) for z in (-0.1, 0.1))
    asset = f'<asset><mesh name="m" vertex="{corners}"/></asset><worldbody>'
    box, mesh = 'type="box" size="0.06 0.06 0.1" pos="0 0 0.1"', 'type="mesh" mesh="m" pos="0 0 0.1"'
    text = ARM.format(gap=0.03, range="-0.26 0.26")
    boxes, of_mesh = _with(text), _with(text.replace("<worldbody>", asset, 1).replace(box, mesh))
    assert not compile_scene(boxes).robot.self_slack.any()
    q, free = _drawn(of_mesh)
    compiled = compile_scene(of_mesh)
    lost = 1.0 - np.mean(compiled.proof.free(q[free]))
    assert 0.01 < lost < 0.1
    assert np.mean(compiled.kernels.free(q[free])) > 0.99


def test_every_motion_is_judged_exactly() -> None:
    scene = _scene(0.012, "-0.5 0.5")
    result = gp.plan([-1.0, 0.0], [1.0, 0.05], scene, w=0.0, iterations=200)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert gp.verify(result.trajectory, scene).passed


def test_bundled_robots_need_none() -> None:
    for name in ("desk", "tabletop"):
        task = next(iter(gp.load_scene(name).tasks.values()))
        assert not compile_scene(task.scene).robot.self_slack.any()


def test_the_floor_extent_of_a_base_makes_no_difference() -> None:
    """Slack is computed once per robot: the floor's extent does not matter, the arm's joint ranges do."""
    robot = compile_scene(gp.load_scene("hallway")).robot
    pair = next(pair for pair in robot.self_pair if slack._carriers(robot, int(pair[0])) > {0, 1, 2, 3})
    wider = np.where(np.arange(len(robot.upper)) < 3, 100.0, robot.upper)
    assert slack._key(replace(robot, upper=wider), pair) == slack._key(robot, pair)
    assert slack._key(replace(robot, upper=robot.upper + 0.1), pair) != slack._key(robot, pair)


def test_slack_is_stored_for_other_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("GRACEFUL_PLAN_NO_CACHE", raising=False)
    monkeypatch.setattr(slack, "_SLOW", 0.0)
    slack.forget()
    first = compile_scene(_scene(0.006, "-0.01 0.01")).robot.self_slack
    (file,) = (tmp_path / "graceful_plan").iterdir()

    def refuse(*_: object) -> float:
        raise AssertionError("computed again")

    slack.forget()
    computed = slack._slack
    monkeypatch.setattr(slack, "_slack", refuse)
    np.testing.assert_array_equal(compile_scene(_scene(0.006, "-0.01 0.01")).robot.self_slack, first)
    slack.forget()
    monkeypatch.setattr(slack, "_slack", computed)
    for nonsense in ([1.0], [np.nan], []):  # clearances above 0 would make collisions free
        np.savez(file, values=np.array(nonsense))
        np.testing.assert_array_equal(compile_scene(_scene(0.006, "-0.01 0.01")).robot.self_slack, first)
        slack.forget()

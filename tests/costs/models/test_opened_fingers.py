"""Fingers that have let go: how far open they are, and whom they touch on the rest of a motion."""

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.analysis.harm_law import HarmLaw
from graceful_plan.costs.cost import AHEAD, StateBatch
from graceful_plan.costs.fault_prior import FaultPrior
from graceful_plan.costs.models.drop.fingers import opened_fingers, opened_positions, opening_probability

_COVER = 0.0021
"""How far spheres stick out of fingers, and rounding in single precision [m]."""

_GANTRY = """
<mujoco><worldbody>
  <body name="cart" pos="0 0 0.5"><joint name="x" type="slide" axis="1 0 0" range="-2 2"/>
    <joint name="y" type="slide" axis="0 1 0" range="-2 2"/>
    <geom name="hand" type="box" size="0.02 0.02 0.02"/><site name="tool" pos="0 0 -0.1"/>
    {fingers}
  </body>
  <body name="beside" pos="0.6 {beside} 0.4"><geom type="box" size="0.02 0.02 0.05"/></body>
  <body name="ball" pos="0 0 0.4"><freejoint/><geom type="sphere" size="0.015"/></body>
</worldbody></mujoco>"""
_SLIDES = """
    <body name="left" pos="0 0.026 -0.1"><joint name="left" type="slide" axis="0 1 0" range="0 0.05"/>
      <geom type="box" size="0.01 0.01 0.03"/></body>
    <body name="right" pos="0 -0.026 -0.1"><joint name="right" type="slide" axis="0 -1 0" range="0 0.05"/>
      <geom type="box" size="0.01 0.01 0.03"/></body>"""
_HINGES = "".join(
    f"""
    <body name="f{k}" euler="0 0 {120 * k}"><body name="finger{k}" pos="0.03 0 -0.03">
      <joint name="j{k}" axis="0 1 0" range="-60 0"/><geom type="capsule" size="0.008" fromto="0 0 0 0 0 -0.08"/>
    </body></body>"""
    for k in range(3)
)


def _scene(fingers: str = _SLIDES, beside: float = 0.1) -> gp.Scene:
    """A hand that is moved over a plane, with something beside its way along x, 0.6 m from its start."""
    return gp.Scene.from_mjcf(
        _GANTRY.format(fingers=fingers, beside=beside),
        robot="cart",
        tool="tool",
        carried="ball",
        X_TO=np.eye(4),
        entities={"beside": "glass"},
        velocity=(1.0, 1.0),
        acceleration=(5.0, 5.0),
    )


def _states(scene: gp.Scene, x: list[float], speed: float = 1.0) -> StateBatch:
    """States on the way along x, which goes on at a speed [m/s]."""
    q = np.column_stack([x, np.zeros(len(x))])
    ahead = q[:, None] + np.multiply.outer(AHEAD, [speed, 0.0])
    return StateBatch(scene, q, np.tile([1.0, 0.0], (len(q), 1)), np.full(len(q), speed), ahead=ahead)


def _hits(batch: StateBatch) -> np.ndarray:
    """P that the body, which fingers are part of, hits the only entity."""
    return gp.ImpactCost().probability(batch)[:, list(batch.scene.components).index("body"), 0]


# --- open -------------------------------------------------------------------------------------------------------------


def test_open_is_the_end_at_which_fingers_are_farther_apart() -> None:
    assert list(opened_positions(_scene()).values()) == [0.05, 0.05]
    assert list(opened_positions(_scene(_HINGES)).values()) == pytest.approx([-np.pi / 3] * 3)
    assert list(opened_positions(gp.load_scene("tabletop")).values()) == [0.04, 0.04]


@pytest.mark.parametrize("fingers", [_SLIDES, _HINGES])
def test_spheres_of_opened_fingers_are_where_mujoco_has_these(fingers: str) -> None:
    scene = _scene(fingers)
    seen = opened_fingers(scene)
    assert seen is not None
    model, data = scene.model, mujoco.MjData(scene.model)
    opened = opened_positions(scene)
    data.qpos[model.jnt_qposadr[list(opened)]] = list(opened.values())
    thing = model.body("beside").geomadr[0]
    mine = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in {int(model.jnt_bodyid[j]) for j in opened}]
    for q in np.random.default_rng(0).uniform([0.3, -0.2], [0.9, 0.3], (40, 2)):
        data.qpos[scene.qpos_adr] = q
        mujoco.mj_kinematics(model, data)
        exact = min(mujoco.mj_geomDistance(model, data, g, thing, 9.0, None) for g in mine)
        if exact > 0.0:
            assert exact - _COVER <= seen.all.clearance(q) <= exact + 1e-6


def test_without_fingers_nothing_opens() -> None:
    scene = _scene(fingers="")
    assert opened_fingers(scene) is None and not opened_positions(scene)
    assert not _hits(_states(scene, [0.0, 0.5])).any()


# --- whom they touch --------------------------------------------------------------------------------------------------


def test_opened_fingers_touch_what_held_ones_pass() -> None:
    scene = _scene(beside=0.1)  # held fingers pass at 0.044 m from it, opened ones reach 0.006 m into it
    assert (gp.clearance(scene, _states(scene, [0.55, 0.6, 0.65]).q) > 0.03).all()
    before, at_it, after, too_far = _hits(_states(scene, [0.3, 0.5, 0.7, -0.6]))
    assert before > 0.99 and at_it > 0.99
    assert after == too_far == 0.0  # already past it; not there within the second that failures are watched for
    assert not _hits(_states(_scene(beside=0.13), [0.3, 0.5])).any()


def test_fingers_need_some_time_to_open() -> None:
    scene = _scene()
    assert _hits(_states(scene, [0.61]))[0] == 0.0  # a finger and the thing are 0.03 m from middle to edge
    assert _hits(_states(scene, [0.61], speed=0.1))[0] > 0.99


def test_a_state_alone_tells_nothing() -> None:
    batch = _states(_scene(), [0.3, 0.5])
    alone = StateBatch(batch.scene, batch.q, batch.direction, batch.speed)
    assert not _hits(alone).any()
    kernel = gp.ImpactCost().kernel(batch.scene, (1.0, 1.0))
    assert kernel is not None
    np.testing.assert_allclose(kernel.moving_states(batch.q, batch.qd), gp.ImpactCost().state(alone), atol=1e-9)


def test_many_states_are_worked_on_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    batch = _states(_scene(), np.linspace(-0.7, 0.8, 50).tolist())
    assert batch.ahead is not None
    whole = opening_probability(batch.scene, batch.q, batch.ahead)
    monkeypatch.setattr("graceful_plan.costs.models.drop.fingers._STATES", 7)
    np.testing.assert_array_equal(opening_probability(batch.scene, batch.q, batch.ahead), whole)
    assert opening_probability(batch.scene, batch.q[:0], batch.ahead[:0]).shape == (0, 1)


# --- in the mixture ---------------------------------------------------------------------------------------------------


def test_only_faults_that_open_the_gripper_count() -> None:
    batch = _states(_scene(), [0.3])
    for fault, share in (("gripper_failure", 1.0), ("stuck_gripper", 0.778), ("weak_grip", 0.0), ("power_loss", 0.0)):
        prior = FaultPrior({fault: 1.0})
        drop = gp.Footprint(faults=prior).sources(batch).get("drop", np.zeros((1, 2, 1)))
        assert drop[0, list(batch.scene.components).index("body"), 0] == pytest.approx(share, abs=0.01)
        assert sum(prior.opening_shares().values()) == pytest.approx(share, abs=1e-6)
    assert gp.Footprint(faults=FaultPrior({"weak_grip": 1.0})).components == ("carried", "contents")
    falling = gp.ImpactCost(components=("carried", "contents"))
    assert falling.state(batch)[0] + 1.0 < gp.ImpactCost().state(batch)[0]
    law = HarmLaw(gp.ImpactCost(), batch.scene)
    np.testing.assert_allclose(law.states(batch) @ law.value, gp.ImpactCost().state(batch))


def test_explanations_name_them() -> None:
    scene = _scene()
    trajectory = gp.retime(gp.Path(np.array([[0.0, 0.0], [1.2, 0.0]])), scene.limits)
    found = gp.explain(trajectory, scene)
    event = found.contributions[0]
    assert event.event == "opened fingers into beside" and dict(event.faults) == {"gripper_failure": 1.0}
    assert gp.evaluate(trajectory, scene).impact_by_component["body"] == pytest.approx(event.impact)

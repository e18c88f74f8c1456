"""Algorithm 1 as printed: the transcriptions of kernel and judge, a literal one, and values by hand."""

import numpy as np
import pytest
import slow_overlap

import graceful_plan as gp
from graceful_plan.judge.reference_cost import reference_probability
from sizes import first_quick

_SAME = 1e-9  # all three use double precision

# A robot of two boxes, 1/8 wide; the second is 1/4 further along x and 3/8 higher. A stack of two boxes with a gap
# between them, and a pile of three. All numbers are sums of powers of two, so that contacts are exact.
_STACKS = """
<mujoco><compiler autolimits="true"/>
<worldbody>
  <body name="stack">
    <geom type="box" size="0.125 0.125 0.0625" pos="0 0 0.0625"/>
    <geom type="box" size="0.0625 0.0625 0.0625" pos="0 0 0.5625"/>
  </body>
  <body name="pile" pos="4 0 0">
    <geom type="box" size="0.5 0.5 0.0625" pos="0 0 0.0625"/>
    <geom type="box" size="0.5 0.5 0.0625" pos="0 0 0.1875"/>
    <geom type="box" size="0.5 0.5 0.0625" pos="0 0 0.3125"/>
  </body>
  <body name="robot/x"><joint name="x" type="slide" axis="1 0 0" range="-8 8"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body name="robot/y"><joint name="y" type="slide" axis="0 1 0" range="-8 8"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body name="robot/z"><joint name="z" type="slide" axis="0 0 1" range="-8 8"/>
        <geom type="box" size="0.0625 0.0625 0.0625"/>
        <geom type="box" size="0.0625 0.0625 0.0625" pos="0.25 0 0.375"/>
        <site name="tool"/>
  </body></body></body>
</worldbody></mujoco>"""

_AREA = 1.0 / 64.0  # area of one robot box
_ABOVE, _STRADDLES, _EQUAL, _BELOW = 1.0, 0.3125, 0.0625, -1.0
_ON_TOP, _UNDERNEATH = 0.6875, -0.4375


@pytest.fixture(scope="module")
def stacks():
    return gp.Scene.from_mjcf(
        _STACKS,
        robot="robot/",
        tool="tool",
        velocity=[1.0] * 3,
        acceleration=[1.0] * 3,
        entities={"stack": "glass", "pile": "glass"},
    )


def _by_all(scene, q, component, entity):
    """Return P after checking that all three agree."""
    row, column = list(scene.components).index(component), list(scene.entities).index(entity)
    literal = np.array([slow_overlap.probability(scene, x, component, entity) for x in q])
    np.testing.assert_allclose(reference_probability(scene, q, [component])[:, 0, column], literal, atol=_SAME)
    np.testing.assert_allclose(gp.interaction_probability(q, scene, "box_overlap")[:, row, column], literal, atol=_SAME)
    return literal


@pytest.mark.parametrize(
    ("height", "counts"),
    [
        (_ABOVE, True),
        (_STRADDLES, True),  # a box is below the upper and above the lower one; the other is above both
        (_EQUAL, True),
        (-0.25, True),  # only the robot's upper box is as high as the stack, and it is beside it
        (_BELOW, False),
        (_ON_TOP, False),  # contact: neither above, nor overlapping in height
        (_UNDERNEATH, False),
    ],
)
def test_heights_are_compared_once_for_both_bodies(stacks, height, counts):
    """Half of the lower box is above the stack's upper geom, all of it above the lower geom."""
    (P,) = _by_all(stacks, np.array([[0.0625, 0.0, height]]), "body", "stack")
    assert P == (pytest.approx(1.5 * _AREA / (2.0 * _AREA)) if counts else 0.0)


def test_the_overlap_is_a_share_of_the_smaller_area(stacks):
    """The robot's boxes have 2 units of area, the stack 4 + 1; a quarter of one box is over the wide geom only."""
    (P,) = _by_all(stacks, np.array([[0.125 + 0.03125, 0.0, _ABOVE]]), "body", "stack")
    assert P == pytest.approx(0.25 / 2.0)


def test_stacked_geoms_make_nothing_more_than_certain(stacks):
    (P,) = _by_all(stacks, np.array([[4.0, 0.0, _ABOVE]]), "body", "pile")
    assert P == 1.0


def test_beside_and_not_above_is_no_hit(stacks):
    assert not _by_all(stacks, np.array([[0.0, 1.0, h] for h in (_ABOVE, _EQUAL)]), "body", "stack").any()


@pytest.mark.parametrize("name", first_quick(gp.scenes()))
def test_three_transcriptions_agree(name):
    task = next(iter(gp.load_scene(name).tasks.values()))
    q = np.random.default_rng(5).uniform(*task.scene.limits.position.T, (15, len(task.scene.joints)))
    q = np.concatenate([q, np.linspace(task.start, task.goal[0], 5)])
    pairs = [(component, entity) for component in ("body", "carried") for entity in task.scene.entities]
    found = np.array([_by_all(task.scene, q, *pair) for pair in pairs])
    assert ((found > 0.0) & (found < 1.0)).sum() > 10
    assert (found == 0.0).sum() > 20

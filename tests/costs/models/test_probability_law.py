"""No model of harm returns less than 0 or more than 1 in any state, and no cost of an edge is negative."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import drop_kernel
from sizes import first_quick

STATES = 1024
PRESETS = ("drop_only", "arm", "service_robot")

# A fragile object above three obstacles, without a floor, in whose states all contributions are tiny or certain.
GANTRY = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="arm/x" pos="0 0 .4"><joint name="arm/x" type="slide" axis="1 0 0" range="-1 1"/>
   <geom type="box" size=".02 .02 .02" mass="1"/>
   <body name="arm/y"><joint name="arm/y" type="slide" axis="0 1 0" range="-1 1"/>
    <geom type="box" size=".02 .02 .02" mass="1"/>
    <body name="arm/z"><joint name="arm/z" type="slide" axis="0 0 1" range="0 .8"/>
     <geom type="box" size=".02 .02 .02" mass="1"/>
     <body name="arm/r"><joint name="arm/r" axis="0 1 0" range="-1.5 1.5"/>
      <geom type="box" size=".02 .02 .02" mass="1"/><site name="arm/tip" pos="0 0 -.1"/></body></body></body></body>
  <body name="cup" pos="0 0 .3"><freejoint/><geom type="cylinder" size=".04 .06" mass=".3"/></body>
  {boxes}
</worldbody></mujoco>"""


def above_obstacles(seed, entity="glass"):
    rng = np.random.default_rng(seed)
    boxes = ""
    for i in range(3):
        x, y, a, b, h = *rng.uniform(-0.8, 0.8, 2), *rng.uniform(0.05, 1.5, 2), rng.uniform(0.02, 0.2)
        boxes += f'<body name="b{i}" pos="{x} {y} {h}"><geom type="box" size="{a} {b} {h}"/></body>'
    return gp.Scene.from_mjcf(
        GANTRY.format(boxes=boxes), robot="arm/", tool="arm/tip", velocity=[1.0] * 4,
        acceleration=[5.0] * 4, entities={} if entity is None else {"b0": entity},
    ).attach("cup", X_TO=gp.FROM_ABOVE)  # fmt: skip


def states(scene, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.uniform(*scene.limits.position.T, (STATES, len(scene.joints)))
    return q, 0.5 * np.minimum(scene.limits.velocity, 5.0) * rng.normal(size=q.shape)


def check(scene, faults):
    q, qd = states(scene)
    for model in ("box_overlap", gp.FailureMixture(faults)):
        for velocity in (None, qd):
            P = gp.interaction_probability(q, scene, model, velocity)
            assert np.isfinite(P).all() and (P >= 0.0).all() and (P <= 1.0 + 1e-12).all(), model
    if scene.carried is not None:
        kernel = drop_kernel(scene, DropSettings.shipped())
        for velocity in (None, qd):
            for P in (kernel.probability(q, velocity), kernel.own_loss(q, velocity)):
                assert (P >= 0.0).all() and (P <= 1.0).all()
    bound = gp.Objective(impact=gp.ImpactCost(model=gp.FailureMixture(faults)), w=1.0).bind(scene)
    half = STATES // 2
    assert (bound.states(q) >= 0.0).all()
    assert (bound.edges(q[:half], q[half:]) >= 0.0).all()
    if bound.kernel is not None:
        assert (bound.kernel.edges(q[:half], q[half:], rough=True) >= 0.0).all()
        assert (bound.kernel.state_slopes(q, qd)[0] >= 0.0).all()


@pytest.mark.parametrize("faults", first_quick(PRESETS))
@pytest.mark.parametrize("name", first_quick(gp.scenes()))
def test_bundled_scenes_and_the_same_without_entities(name, faults):
    whole = gp.load_scene(name)
    task = next(iter(whole.tasks.values())).scene
    for scene in (whole, task, whole.edit(remove=list(whole.entities)), task.edit(remove=list(task.entities))):
        check(scene, faults)


@pytest.mark.parametrize("seed", first_quick(range(4)))
@pytest.mark.parametrize("entity", ["glass", None])
def test_three_obstacles_without_a_floor(seed, entity):
    check(above_obstacles(seed, entity), "drop_only")


@pytest.mark.parametrize("planner", ["rrt_star", "informed_rrt_star"])
def test_tree_planners_meet_no_negative_cost(planner):
    scene = above_obstacles(1)
    q, _ = states(scene, seed=3)
    q = q[gp.clearance(q, scene) > 0.01]
    for start, goal in zip(q[:3], q[3:6], strict=True):
        result = gp.plan(start, goal, scene, w=1.0, planner=planner, iterations=200, refine=False)
        assert result.status is not gp.PlanStatus.NONFINITE

"""Damage by energy: the curve against its integral, energies against MuJoCo, and their use in the cost."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.costs.consequence import (
    BODY_ENERGY,
    BODY_SPREAD,
    CARRIED_LOSS,
    Damage,
    arrival_energy,
    damage_probability,
    damaged_by_body,
    damaged_by_carried,
)
from graceful_plan.costs.cost import moving_batch
from graceful_plan.exceptions import ShapeError, UnknownNameError
from graceful_plan.scene.harm.fragility import Fragility, FragilityTable
from graceful_plan.testing import check_cost

ENERGY = gp.ImpactCost(model="mixture", components=("body", "carried", "contents"), consequence="energy")


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("desk").tasks["bring_coffee"]


def states(task: gp.Task, n: int = 20, speed: float = 0.0, seed: int = 0) -> gp.StateBatch:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(n, 7))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return gp.StateBatch(task.scene, task.start + rng.normal(0.0, 0.15, (n, 7)), direction, np.full(n, speed))


# --- the curve --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spread", [0.1, 0.7, 3.0])
def test_curve_is_the_mean_over_shares(spread: float) -> None:
    row = Fragility(0.5, 1.0, spread)
    share = ((np.arange(20_000) + 0.5) / 20_000) ** CARRIED_LOSS  # exp(-X) is a uniform number to the power of b
    for energy in (0.01, 0.3, 0.5, 2.0, 50.0):
        expected = np.mean([row.probability(energy * part) for part in share])
        assert damaged_by_carried(np.array([energy]), row)[0] == pytest.approx(expected, abs=5e-4)


@given(st.floats(1e-3, 1e3), st.floats(0.05, 5.0), st.lists(st.floats(0.0, 1e6), min_size=2, max_size=9))
def test_curve_is_a_distribution(median: float, spread: float, energies: list[float]) -> None:
    row = Fragility(median, 1.0, spread)
    P = damaged_by_carried(np.array(sorted(energies)), row)
    assert ((P >= 0.0) & (P <= 1.0)).all() and (np.diff(P) >= 0.0).all()
    assert damaged_by_carried(np.zeros(1), row)[0] == 0.0
    tougher = damaged_by_carried(np.array(sorted(energies)), Fragility(2.0 * median, 1.0, spread))
    assert (tougher <= P + 1e-4).all()


def test_body_arrives_with_a_log_normal_energy() -> None:
    row = Fragility(1.0, 1.0, 0.7)
    z = np.random.default_rng(0).normal(size=20_000)
    expected = np.mean([row.probability(BODY_ENERGY * e) for e in np.exp(BODY_SPREAD * z)])
    assert damaged_by_body(row) == pytest.approx(expected, abs=0.01)


# --- energies ---------------------------------------------------------------------------------------------------------


def lowest_and_tops(scene: gp.Scene, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the lowest point of the carried object and the highest of each entity, by corners of geom boxes."""
    data = scene.data_at(q)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T

    def heights(geom: int) -> np.ndarray:
        centre, half = scene.model.geom_aabb[geom, :3], scene.model.geom_aabb[geom, 3:]
        R = data.geom_xmat[geom].reshape(3, 3)
        if scene.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            angle = np.linspace(0.0, 2.0 * np.pi, 721)
            ring = np.column_stack([np.cos(angle), np.sin(angle)]) * half[0]
            points = np.concatenate([np.column_stack([ring, np.full(721, z)]) for z in (-half[2], half[2])])
        else:
            points = signs * half
        return data.geom_xpos[geom, 2] + ((centre + points) @ R.T)[:, 2]

    collides = scene.model.geom_contype | scene.model.geom_conaffinity
    low = min(heights(g).min() for g in scene.components["carried"].geoms if collides[g])
    tops = [max(heights(g).max() for g in entity.geoms) for entity in scene.entities.values()]
    return float(low), np.array(tops)


def test_energy_at_rest_is_weight_times_height(task: gp.Task) -> None:
    batch, model = states(task), task.scene.model
    assert task.scene.carried is not None
    mass = model.body_subtreemass[model.body(task.scene.carried.body).id]
    found = arrival_energy(batch)
    compared = 0
    for q, energies in zip(batch.q, found, strict=True):
        low, tops = lowest_and_tops(task.scene, q)
        height = np.maximum(low - tops, 0.0)
        box = np.array([name not in ("plant",) for name in task.scene.entities])  # boxes around round tops are too high
        np.testing.assert_allclose(energies[box], (mass * 9.81 * height)[box], rtol=1e-3, atol=0.02)
        compared += int((height > 0.0).sum())
    assert compared > 20


def test_speed_adds_kinetic_energy(task: gp.Task) -> None:
    rest, moving = states(task, speed=0.0), states(task, speed=0.7)
    model = task.scene.model
    assert task.scene.carried is not None
    body = model.body(task.scene.carried.body).id
    step = 1e-6
    for i in range(len(rest)):
        ends = [
            task.scene.data_at(moving.q[i] + sign * step * moving.qd[i]).subtree_com[body].copy() for sign in (-1, 1)
        ]
        v = (ends[1] - ends[0]) / (2.0 * step)
        more = arrival_energy(moving)[i] - arrival_energy(rest)[i]
        np.testing.assert_allclose(more, 0.5 * model.body_subtreemass[body] * v @ v, rtol=1e-4)


# --- probabilities and cost -------------------------------------------------------------------------------------------


def test_damage_by_component(task: gp.Task) -> None:
    batch, table = states(task, speed=0.5), FragilityTable.shipped()
    P = damage_probability(batch, table)
    energy = arrival_energy(batch)
    names, components = list(task.scene.entities), list(task.scene.components)
    assert P.shape == (len(batch), len(components), len(names))
    for e, name in enumerate(names):
        row = table.of(task.scene.entities[name].category)
        assert (P[:, components.index("contents"), e] == row.wetted).all()
        assert (P[:, components.index("body"), e] == damaged_by_body(row)).all()
        np.testing.assert_array_equal(P[:, components.index("carried"), e], damaged_by_carried(energy[:, e], row))


@pytest.mark.parametrize("model", ["box_overlap", "mixture"])
def test_damage_is_rarer_than_contact(task: gp.Task, model: str) -> None:
    batch = states(task, n=100, speed=0.5)
    contact, damage = (gp.ImpactCost(model=model, consequence=word) for word in ("contact", "energy"))
    P, harm = contact.interaction.probability(batch), damage.interaction.probability(batch)
    assert ((harm >= 0.0) & (harm <= P)).all() and harm.any()
    assert (damage.state(batch) <= contact.state(batch) + 1e-12).all()
    np.testing.assert_allclose(sum(damage.interaction.sources(batch).values()), harm, atol=1e-12)
    assert damage.interaction.fault_shares() == contact.interaction.fault_shares()


def test_unbreakable_entities_cost_nothing_and_fragile_ones_their_contact(task: gp.Task) -> None:
    batch = states(task, n=50)
    components = ("carried",)
    never = FragilityTable({}, Fragility(1e9, 0.0, 0.7))
    always = FragilityTable({}, Fragility(1e-30, 1.0, 0.7))
    assert (gp.ImpactCost("mixture", components, never).state(batch) < 1e-6).all()
    # An object at rest below an entity's top arrives with no energy.
    row, above = list(task.scene.components).index("carried"), arrival_energy(batch) > 0.0
    P = gp.ImpactCost("mixture").interaction.probability(batch)[:, row][above]
    harm = gp.ImpactCost("mixture", components, always).interaction.probability(batch)[:, row][above]
    assert P.max() > 0.5
    np.testing.assert_allclose(harm, P, rtol=1e-6)


def test_higher_is_worse(task: gp.Task) -> None:
    batch = states(task)
    energy = arrival_energy(batch)
    lifted = batch.q.copy()
    lifted[:, 1] -= 0.15  # lean the shoulder back
    up = gp.StateBatch(task.scene, lifted)
    higher = up.object_poses[:, 2, 3] > batch.object_poses[:, 2, 3] + 0.02
    assert higher.any()
    assert (arrival_energy(up)[higher] >= energy[higher] - 0.05).all()


def test_mixture_multiplies_contacts_by_damage(task: gp.Task) -> None:
    batch, scene, table = states(task, n=200, speed=0.5), task.scene, FragilityTable.shipped()
    contact, damage = (gp.ImpactCost(consequence=word).interaction for word in ("contact", "energy"))
    expected = contact.probability(batch) * damage_probability(batch, table)
    found = damage.probability(batch)
    components = list(scene.components)
    for name in ("carried", "contents"):  # the core rounds energies near 0 and the normal distribution
        row = components.index(name)
        assert expected[:, row].max() > 0.1
        np.testing.assert_allclose(found[:, row], expected[:, row], atol=3e-3)


def test_failing_arm_does_damage_with_the_energy_of_the_body(task: gp.Task) -> None:
    batch, scene, table = states(task, n=50, speed=0.5), task.scene, FragilityTable.shipped()
    mixture = gp.FailureMixture(faults="arm")
    contact, damage = (gp.ImpactCost(mixture, consequence=word).interaction for word in ("contact", "energy"))
    of_body = np.array([damaged_by_body(table.of(entity.category)) for entity in scene.entities.values()])
    for source in set(contact.sources(batch)) - {"drop", "spill", "stop"}:
        np.testing.assert_allclose(damage.sources(batch)[source], contact.sources(batch)[source] * of_body)


@pytest.mark.parametrize("faults", ["drop_only", "arm"])
def test_kernel_of_damage_is_its_sum(task: gp.Task, faults: str) -> None:
    batch, cost = states(task, n=40, speed=0.5), gp.ImpactCost(gp.FailureMixture(faults=faults), consequence="energy")
    kernel = cost.kernel(task.scene, (0.3, 0.9))
    assert kernel is not None
    np.testing.assert_allclose(kernel.moving_states(batch.q, batch.qd), cost.state(batch), rtol=1e-5)


def test_gradient_of_damage_is_the_finite_difference(task: gp.Task) -> None:
    cost = gp.ImpactCost(components=("carried",), consequence="energy", own_loss=False)
    batch, h = states(task, n=60, speed=0.5), 1e-6
    found = cost.gradients(batch)
    assert found is not None and np.ptp(cost.state(batch)) > 0.2
    for of_velocity, slopes in enumerate(found):
        for j, step in enumerate(h * np.eye(7)):
            moved = [
                moving_batch(task.scene, batch.q + s * step * (1 - of_velocity), batch.qd + s * step * of_velocity)
                for s in (1.0, -1.0)
            ]
            difference = (cost.state(moved[0]) - cost.state(moved[1])) / (2.0 * h)
            error = np.abs(slopes[:, j] - difference) / (1.0 + np.abs(difference))
            assert np.median(error) < 1e-7 and np.quantile(error, 0.95) < 1e-4  # the rest are next to kinks


def test_other_models_have_neither_kernel_nor_gradient_of_damage(task: gp.Task) -> None:
    check_cost(ENERGY, task.scene)
    cost = gp.ImpactCost(model="box_overlap", consequence="energy")
    assert cost.kernel(task.scene, (0.3, 0.9)) is None and cost.gradient(states(task, n=3)) is None
    assert not cost.is_published() and isinstance(cost.interaction, Damage)
    assert hash(ENERGY) == hash(replace(ENERGY))


@pytest.mark.long
def test_planners_run_on_the_damage_cost(task: gp.Task) -> None:
    objective = gp.Objective(impact=ENERGY, w=1.0)
    result = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=60)
    assert result.status is gp.PlanStatus.SOLVED and result.path is not None
    cost = gp.evaluate(result.path, task.scene, objective)
    assert sum(cost.impact_by_entity.values()) == pytest.approx(cost.impact)
    contact = gp.Objective(impact=gp.ImpactCost("mixture", ENERGY.components))
    assert cost.impact < gp.evaluate(result.path, task.scene, contact).impact


def test_nothing_carried() -> None:
    scene = gp.load_scene("desk")
    batch = gp.StateBatch(scene, np.tile(scene.limits.position.mean(axis=1), (4, 1)))
    assert damage_probability(batch, FragilityTable.shipped()).shape == (4, 1, len(scene.entities))
    assert gp.ImpactCost(consequence="energy").state(batch).tolist() == [0.0] * 4
    with pytest.raises(ShapeError, match="carried object"):
        arrival_energy(batch)


def test_misuse() -> None:
    with pytest.raises(UnknownNameError, match=r"'damage'.*contact, energy"):
        gp.ImpactCost(consequence="damage")

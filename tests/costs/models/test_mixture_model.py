"""Failures of all kinds: the mixture model weighs drops, spills and failing arms by a fault prior."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wrapped import Wrapped

import graceful_plan as gp
from graceful_plan.costs.consequence import Damage
from graceful_plan.costs.cost import AHEAD, StateBatch
from graceful_plan.costs.fault_prior import GENERATORS, FaultPrior, presets
from graceful_plan.costs.models.body.body import SINGLE, BodyModel
from graceful_plan.costs.models.body.constants import BodySettings
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import drop_kernel
from graceful_plan.costs.models.mixture.mixture import FailureMixture
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.testing import check_cost

_SAME = 1e-9  # relative: the same terms summed in another order
_TINY = 1e-5  # absolute, for severities around 10: single precision of probabilities near 0
_SCENES = ("contents", "no contents", "nothing carried")
_KNOWN_STEPS = len(AHEAD)


@pytest.fixture(scope="module")
def scenes() -> dict[str, gp.Scene]:
    return {
        "contents": gp.load_scene("desk").tasks["bring_coffee"].scene,
        "no contents": gp.load_scene("tabletop_l1").tasks["green_to_blue"].scene,
        "nothing carried": gp.load_scene("tabletop_l1"),
    }


def states(scene: gp.Scene, n: int, seed: int = 0, *, still: bool = False) -> StateBatch:
    rng = np.random.default_rng(seed)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    qd = scene.limits.velocity * rng.uniform(-1.0, 1.0, q.shape) * (not still)
    speed = np.linalg.norm(qd, axis=1)
    return StateBatch(scene, q, qd / np.where(speed > 0.0, speed, 1.0)[:, None], speed)


def prior_of(**effects: float) -> FaultPrior:
    """A prior with a single fault that has these effects."""
    return FaultPrior({"mishap": 1.0}, {"mishap": effects})


def row(scene: gp.Scene, component: str) -> int:
    return list(scene.components).index(component)


# --- laws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("faults", presets())
@pytest.mark.parametrize("name", _SCENES)
def test_sources_add_up_to_probabilities(scenes: dict[str, gp.Scene], name: str, faults: str) -> None:
    model, batch = FailureMixture(faults=faults), states(scenes[name], 40)
    P, sources = model.probability(batch), model.sources(batch)
    assert set(sources) == {g for g, weight in model.prior.weights().items() if weight > 0.0}
    np.testing.assert_allclose(sum(sources.values()), P, rtol=1e-12)
    assert P.min() >= 0.0 and P.max() <= 1.0 + 1e-12
    assert all(share.min() >= 0.0 for share in sources.values())
    harmless = faults == "drop_only" and name == "nothing carried"
    assert P.any() != harmless
    assert model.probability(states(scenes[name], 0)).shape == (0, *P.shape[1:])


@pytest.mark.parametrize("faults", presets())
@pytest.mark.parametrize("name", _SCENES)
def test_kernel_and_model_agree(scenes: dict[str, gp.Scene], name: str, faults: str) -> None:
    scene, cost = scenes[name], gp.ImpactCost(model=FailureMixture(faults=faults))
    kernel = cost.kernel(scene, (0.3, 0.7))
    assert kernel is not None
    batch = states(scene, 40, still=True)
    single = faults != "drop_only"
    tolerance = {"rtol": SINGLE, "atol": _TINY} if single else {"rtol": _SAME, "atol": 1e-12}
    np.testing.assert_allclose(kernel.states(batch.q), cost.state(batch), **tolerance)


@pytest.mark.parametrize("components", [("body",), ("carried",), ("contents",), ()])
def test_the_kernel_charges_single_components(scenes: dict[str, gp.Scene], components: tuple[str, ...]) -> None:
    scene, cost = scenes["contents"], gp.ImpactCost(model=FailureMixture(faults="service_robot"), components=components)
    kernel, batch = cost.kernel(scene, (0.3, 0.7)), states(scene, 20, still=True)
    assert kernel is not None
    np.testing.assert_allclose(kernel.states(batch.q), cost.state(batch), rtol=SINGLE, atol=_TINY)
    assert cost.state(batch).any() == bool(components)


@pytest.mark.parametrize("faults", presets())
def test_edges_are_evaluated_at_their_speed(scenes: dict[str, gp.Scene], faults: str) -> None:
    scene, rng = scenes["no contents"], np.random.default_rng(3)
    q0 = rng.uniform(*scene.limits.position.T, size=(6, len(scene.joints)))
    q1 = q0 + rng.uniform(-0.2, 0.2, q0.shape)
    native = gp.Objective(impact=gp.ImpactCost(model=FailureMixture(faults=faults))).bind(scene)
    generic = gp.Objective(impact=gp.ImpactCost(model=Wrapped(FailureMixture(faults=faults)))).bind(scene)
    assert native.kernel is not None and generic.kernel is None
    assert generic.edges(q0, q1)[:, 1].max() > 0.0
    np.testing.assert_allclose(native.edges(q0, q1), generic.edges(q0, q1), rtol=1e-2, atol=1e-6)


def test_the_model_keeps_the_contract_of_costs(scenes: dict[str, gp.Scene]) -> None:
    for faults in presets():
        check_cost(gp.ImpactCost(model=FailureMixture(faults=faults)), scenes["no contents"], samples=8)


@pytest.mark.parametrize("name", _SCENES)
def test_gradients_are_for_models_without_arms_that_fail(scenes: dict[str, gp.Scene], name: str) -> None:
    batch = states(scenes[name], 3)
    assert gp.ImpactCost(model=FailureMixture(faults="arm")).gradient(batch) is None
    found = gp.ImpactCost(model=FailureMixture(faults=prior_of(drop=0.5, spill=0.5))).gradient(batch)
    assert found is not None and found.shape == batch.q.shape and found.any() == (name != "nothing carried")


@given(weights=st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2), seed=st.integers(0, 99))
@settings(max_examples=10, deadline=None)
def test_probabilities_are_linear_in_the_rates(scenes: dict[str, gp.Scene], weights: list[float], seed: int) -> None:
    effects = {"slip": {"drop": 0.8, "spill": 0.5}, "jam": {"stuck": 0.6, "spill": 0.2}}
    slip, jam = weights[0] + 0.01, weights[1] + 0.01
    batch = states(scenes["contents"], 5, seed)
    both, only_slip, only_jam = (
        FailureMixture(faults=FaultPrior(rates, effects)).probability(batch)
        for rates in ({"slip": slip, "jam": jam}, {"slip": 1.0}, {"jam": 1.0})
    )
    np.testing.assert_allclose(both, (slip * only_slip + jam * only_jam) / (slip + jam), atol=1e-12)


# --- one fault at a time ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("generator", GENERATORS)
def test_a_single_fault_acts_like_its_generator(scenes: dict[str, gp.Scene], generator: str) -> None:
    scene = scenes["contents"]
    model, batch = FailureMixture(faults=prior_of(**{generator: 0.5})), states(scene, 200)
    assert set(model.sources(batch)) == {generator}
    P = model.probability(batch)
    strikers = {name for c, name in enumerate(scene.components) if P[:, c].any()}
    expected = {"drop": {"carried", "contents"}, "spill": {"contents"}, "stop": {"contents"}}
    expected = expected.get(generator, {"body", "carried"})
    assert strikers == expected
    assert P.max() <= 0.5
    certain = FailureMixture(faults=prior_of(**{generator: 1.0})).probability(batch)
    np.testing.assert_allclose(P, 0.5 * certain, rtol=1e-12)


def test_drops_and_spills_by_hand(scenes: dict[str, gp.Scene]) -> None:
    scene = scenes["contents"]
    batch = states(scene, 30)
    alone = drop_kernel(scene, DropSettings.shipped()).probability(batch.q, batch.qd)
    # Dropped in 1 of 4 cases; spilled in half of the others.
    P = FailureMixture(faults=prior_of(drop=0.25, spill=0.5)).probability(batch)
    np.testing.assert_allclose(P[:, row(scene, "carried")], 0.25 * alone[:, 0], rtol=1e-12)
    np.testing.assert_allclose(P[:, row(scene, "contents")], 0.25 * alone[:, 1] + 0.375 * alone[:, 2], rtol=1e-12)
    assert not P[:, row(scene, "body")].any()


def test_a_dropped_object_does_not_fall_with_the_arm(scenes: dict[str, gp.Scene]) -> None:
    scene = scenes["contents"]
    batch = states(scene, 30)
    alone = BodyModel(BodySettings.shipped()).probability(batch)[:, 0]  # collapse
    found = FailureMixture(faults=prior_of(drop=0.75, collapse=1.0)).sources(batch)["collapse"]
    np.testing.assert_allclose(found[:, row(scene, "body")], alone[:, 0], rtol=1e-12)
    np.testing.assert_allclose(found[:, row(scene, "carried")], 0.25 * alone[:, 1], rtol=1e-12)
    assert alone[:, 1].any()


def test_a_known_future_motion_is_used(scenes: dict[str, gp.Scene]) -> None:
    scene, model = scenes["contents"], FailureMixture(faults=prior_of(stuck=1.0))
    batch = states(scene, 20)
    rest = np.repeat(batch.q[:, None], _KNOWN_STEPS, axis=1)  # the motion has ended, although velocities remain
    over = StateBatch(scene, batch.q, batch.direction, batch.speed, ahead=rest)
    assert not np.allclose(model.probability(batch), model.probability(over))
    dropped = FailureMixture()
    np.testing.assert_array_equal(dropped.probability(batch), dropped.probability(over))


# --- as settings ------------------------------------------------------------------------------------------------------


def test_components_are_the_ones_that_can_strike() -> None:
    assert FailureMixture().components == ("carried", "contents") == gp.ImpactCost().components
    assert gp.ImpactCost(model="box_overlap").components == ("carried", "contents")
    for faults in ("arm", "service_robot", prior_of(stray=0.1)):
        assert FailureMixture(faults=faults).components == ("body", "carried", "contents")
        assert gp.ImpactCost(model=FailureMixture(faults=faults)).components == ("body", "carried", "contents")
    assert FailureMixture(faults=prior_of(drop=1.0, stray=0.0)).components == ("carried", "contents")
    assert gp.ImpactCost(model=FailureMixture(faults="arm"), components=("carried",)).components == ("carried",)


def test_no_components_are_not_those_of_the_model(scenes: dict[str, gp.Scene]) -> None:
    none = gp.ImpactCost(components=())
    assert none.components == () and none != gp.ImpactCost()
    assert not none.state(states(scenes["contents"], 20)).any()


def test_damage_by_a_model_strikes_with_its_components() -> None:
    damage = Damage(FailureMixture(faults="arm"), FragilityTable.shipped())
    assert gp.ImpactCost(model=damage).components == ("body", "carried", "contents")


def test_shares_of_faults_add_up_to_the_weights() -> None:
    for name in presets():
        model = FailureMixture(faults=name)
        shares = model.fault_shares()
        assert shares == FaultPrior.preset(name).fault_shares()
        for generator, weight in model.prior.weights().items():
            assert sum(shares[generator].values()) == pytest.approx(weight)


def test_explanations_name_the_faults(scenes: dict[str, gp.Scene]) -> None:
    scene, task = scenes["contents"], gp.load_scene("desk").tasks["bring_coffee"]
    path = gp.Path(np.stack([task.start, np.atleast_2d(task.goal)[0]]))
    effects = {"weak_grip": {"drop": 0.9}, "power_loss": {"drop": 0.5, "collapse": 1.0}}
    model = FailureMixture(faults=FaultPrior({"weak_grip": 3.0, "power_loss": 1.0}, effects))
    found = gp.explain(path, scene, gp.Objective(impact=gp.ImpactCost(model=model)))
    assert {r.source for r in found.contributions} == {"drop", "collapse"}
    for r in found.contributions:
        assert set(r.faults) == ({"weak_grip", "power_loss"} if r.source == "drop" else {"power_loss"})
        assert sum(r.faults.values()) == pytest.approx(1.0)


def test_moving_entities_meet_the_same_faults() -> None:
    model = FailureMixture(faults=prior_of(drop=0.3, collapse=0.6))
    moving = model.moving()
    assert (moving.drop, moving.collapse) == (0.3, 0.6)
    assert moving.settings == model.settings


def test_instances_are_values() -> None:
    model = FailureMixture(faults=FaultPrior.preset("arm"))
    twin = pickle.loads(pickle.dumps(model))
    assert twin == model and hash(twin) == hash(model)
    assert model != FailureMixture(faults="service_robot")
    assert model.prior == FailureMixture(faults="arm").prior


def test_misuse_names_the_culprit() -> None:
    with pytest.raises(UnknownNameError, match=r"'nonsense'.*arm, drop_only, service_robot"):
        FailureMixture(faults="nonsense")


@dataclass(frozen=True)
class NotAPrior:
    drop: float = 1.0


def test_invalid_priors_are_refused() -> None:
    with pytest.raises((SettingError, TypeError), match="faults"):
        FailureMixture(faults=NotAPrior())  # type: ignore[arg-type]


@pytest.mark.parametrize("generator", ["collapse", "joint", "stuck", "stray"])
def test_failures_that_are_noticed_earlier_hit_less(scenes: dict[str, gp.Scene], generator: str) -> None:
    scene = scenes["no contents"]
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    motion = gp.retime(gp.Path(np.array([task.start, task.goal[0]])), scene.limits, scene.joints)
    impacts = []
    for after in (None, 1.0, 0.3, 0.1):
        prior = FaultPrior({"mishap": 1.0}, {"mishap": {generator: 1.0}}, noticed_after=after)
        cost = gp.ImpactCost(model=FailureMixture(faults=prior))
        impacts.append(gp.evaluate(motion, scene, gp.Objective(impact=cost)).impact)
    never, whole, soon, sooner = impacts
    assert whole == pytest.approx(never, rel=1e-6) and soon <= whole and sooner <= soon
    assert sooner < 0.9 * never


def test_drops_do_not_wait_to_be_noticed(scenes: dict[str, gp.Scene]) -> None:
    batch = states(scenes["contents"], 10)
    late, soon = (
        FailureMixture(faults=FaultPrior({"slip": 1.0}, {"slip": {"drop": 0.8, "spill": 0.5}}, noticed_after=after))
        for after in (None, 0.05)
    )
    np.testing.assert_array_equal(late.probability(batch), soon.probability(batch))


def test_the_kernel_knows_when_failures_are_noticed(scenes: dict[str, gp.Scene]) -> None:
    scene, prior = scenes["no contents"], FaultPrior({"mishap": 1.0}, {"mishap": {"joint": 0.7}}, noticed_after=0.1)
    cost = gp.ImpactCost(model=FailureMixture(faults=prior))
    kernel, batch = cost.kernel(scene, (0.3, 0.7)), states(scene, 20, still=True)
    assert kernel is not None
    np.testing.assert_allclose(kernel.states(batch.q), cost.state(batch), rtol=SINGLE, atol=_TINY)

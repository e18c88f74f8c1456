from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from gaussian_family import GaussianFamily, Prepared
from scipy.optimize import minimize

import graceful_plan as gp
from failbench.calibrations import fitting
from failbench.calibrations.failures import Failures
from failbench.calibrations.fitting import Constant, Sample
from graceful_plan.exceptions import SettingError

Array = np.ndarray

TRUTH = {"width": 0.035, "speed": 0.12, "reach": 1.3}


def _prepared(n: int, rng: np.random.Generator) -> Prepared:
    """Return invented landings, half of them near."""
    offset = rng.normal(scale=0.12, size=(n, 5, 2))
    half = np.stack([np.full((n, 5, 2), 0.03), np.broadcast_to(rng.uniform(0.02, 0.06, size=(5, 2)), (n, 5, 2))])
    return Prepared(offset, rng.uniform(0.0, 0.5, size=(n, 5)), half)


def _made_up(values: Mapping[str, float], n: int, seed: int, shape: str = "box") -> list[Sample]:
    rng, found = np.random.default_rng(seed), []
    for task in range(2):
        prepared = _prepared(n, rng)
        happened = rng.random((n, 5)) < GaussianFamily().probability(values, prepared)
        found.append(
            Sample(
                scene="made_up",
                task=f"task{task}",
                shape=shape,
                prepared=prepared,
                hit=happened,
                counted=np.ones((n, 5), dtype=bool),
                motion=task * 100 + np.arange(n) // 50,
            )
        )
    return found


def test_fits_recover_the_constants_of_generated_events() -> None:
    found = fitting.fit(GaussianFamily(), _made_up(TRUTH, 1500, 0), trust=1.0)["box"]
    for name, true in TRUTH.items():
        fitted = found[name]
        assert fitted.low <= fitted.value <= fitted.high
        assert fitted.value == pytest.approx(true, rel=0.1)
        assert fitted.low - 0.03 * true <= true <= fitted.high + 0.03 * true  # 95 %, with some tolerance


def test_intervals_shrink_with_more_motions() -> None:
    widths = []
    for n in (500, 4500):
        found = fitting.fit(GaussianFamily(), _made_up(TRUTH, n, 1), trust=1.0)["box"]
        widths.append(np.array([x.high - x.low for x in found.values()]))
    assert (widths[1] < 0.6 * widths[0]).all()  # expected: a third


@pytest.mark.long
def test_intervals_cover() -> None:
    inside = 0
    for seed in range(10):
        found = fitting.fit(GaussianFamily(), _made_up(TRUTH, 400, 10 + seed), trust=1.0)["box"]
        inside += sum(found[name].low <= true <= found[name].high for name, true in TRUTH.items())
    assert inside >= 24  # of 30; 28.5 are expected


def test_each_shape_gets_its_own() -> None:
    other = TRUTH | {"width": 0.08}
    samples = _made_up(TRUTH, 800, 2) + _made_up(other, 800, 3, shape="round")
    found = fitting.fit(GaussianFamily(), samples, trust=1.0)
    assert set(found) == {"box", "round"}
    assert found["box"]["width"].value < 0.05 < found["round"]["width"].value


def test_shared_constants_are_the_same_for_all_shapes() -> None:
    class Shared(GaussianFamily):
        constants = tuple(replace(c, shared=c.name == "speed") for c in GaussianFamily.constants)

    other = TRUTH | {"width": 0.08}
    samples = _made_up(TRUTH, 800, 2) + _made_up(other, 800, 3, shape="round")
    found = fitting.fit(Shared(), samples, trust=1.0)
    assert found["box"]["speed"] == found["round"]["speed"]
    assert found["box"]["speed"].value == pytest.approx(TRUTH["speed"], rel=0.15)
    assert found["box"]["width"].value < 0.05 < found["round"]["width"].value


def test_another_optimiser_finds_the_same_optimum() -> None:
    samples = _made_up(TRUTH, 400, 8)
    family = GaussianFamily()
    layout = fitting.FitLayout(
        family, tuple((c, None) for c in family.constants), tuple(c.prior for c in family.constants)
    )
    found = fitting.optimum(layout, samples, 5.0, 30)
    other = minimize(
        lambda z: fitting.loss(layout, samples, z, 5.0), np.zeros(3), method="L-BFGS-B", bounds=layout.bounds().T
    )
    assert fitting.loss(layout, samples, found, 5.0) <= other.fun + 0.1
    assert np.allclose(found, other.x, atol=0.03)


def test_the_gradient_is_the_derivative_of_the_loss() -> None:
    samples = _made_up(TRUTH, 100, 9) + _made_up(TRUTH, 100, 10, shape="round")
    family = GaussianFamily()
    slots = ((family.constants[0], None), *((c, shape) for shape in ("box", "round") for c in family.constants[1:]))
    layout = fitting.FitLayout(family, slots, tuple(c.prior for c, _ in slots))
    z = np.array([0.3, -0.2, 0.1, 0.4, -0.3])
    loss, gradient, fisher, shares = fitting.quadratic(layout, samples, z, 2.0)
    assert loss == pytest.approx(fitting.loss(layout, samples, z, 2.0))
    for i, axis in enumerate(1e-4 * np.eye(5)):
        ahead, behind = (fitting.loss(layout, samples, z + sign * axis, 2.0) for sign in (1.0, -1.0))
        assert gradient[i] == pytest.approx((ahead - behind) / 2e-4, rel=1e-3, abs=0.05)
    assert np.allclose(gradient, 2.0 * z + sum(shares.values()))
    assert (np.linalg.eigvalsh(fisher) > 0.0).all()


def test_shapes_without_drops_get_the_common_constants() -> None:
    samples = _made_up(TRUTH, 500, 7)
    found = fitting.fit(GaussianFamily(), samples, trust=1.0, shapes=("ball",))
    for name, true in TRUTH.items():
        assert found["ball"][name].value == pytest.approx(true, rel=0.2)
        assert found["ball"][name].low < found["ball"][name].value < found["ball"][name].high


def test_without_evidence_the_prior_stays() -> None:
    found = fitting.fit(GaussianFamily(), _made_up(TRUTH, 20, 4), trust=1e9)["box"]
    for constant in GaussianFamily.constants:
        assert found[constant.name].value == pytest.approx(constant.prior, rel=1e-3)
        assert found[constant.name].high - found[constant.name].low < 1e-3


def test_bounds_hold() -> None:
    class Bounded(GaussianFamily):
        constants = tuple(
            Constant(name=c.name, prior=c.prior, spread=c.spread, low=c.low, high=1.05 * c.prior)
            for c in GaussianFamily.constants
        )

    found = fitting.fit(Bounded(), _made_up(TRUTH, 500, 5), trust=1.0)["box"]
    for constant in Bounded.constants:
        fitted = found[constant.name]
        assert constant.low <= fitted.low <= fitted.value <= fitted.high <= constant.high


def test_events_of_weight_zero_do_not_matter() -> None:
    samples = _made_up(TRUTH, 300, 6)
    hidden = []
    for sample in samples:
        counted = sample.counted.copy()
        counted[:, 0] = False
        hit = sample.hit.copy()
        hit[:, 0] = True
        hidden.append((replace(sample, counted=counted), replace(sample, counted=counted, hit=hit)))
    first, second = (fitting.fit(GaussianFamily(), [pair[i] for pair in hidden]) for i in (0, 1))
    assert first == second


def test_drops_of_a_task_are_put_together() -> None:
    scene = gp.load_scene("tabletop_l1")
    task = scene.tasks["green_to_blue"]
    entities = tuple(task.scene.entities)
    hit = np.zeros((3, len(entities)), dtype=bool)
    hit[0, 1] = True
    counted = np.ones(len(entities), dtype=bool)
    counted[-1] = False
    parts = [
        Failures(
            scene="tabletop_l1",
            task="green_to_blue",
            motion="",
            grasp="weld",
            components=("carried",),
            entities=entities,
            categories=entities,
            faults=("gripper_failure",),
            counted=counted[None],
            fault=np.zeros(3, dtype=np.int64),
            q=np.tile(task.start, (3, 1)),
            qd=np.zeros((3, len(task.start))),
            ahead=np.tile(task.start, (3, 10, 1)),
            hit=hit[:, None],
            dropped=np.ones(3, dtype=bool),
            spilled=np.zeros(3),
        )
    ] * 2
    (sample,) = fitting.samples_of(GaussianFamily(), parts, {("tabletop_l1", "green_to_blue"): task.scene})
    assert sample.shape == "box"
    assert sample.hit.shape == (6, len(entities))
    assert not sample.counted[:, -1].any()
    assert sample.motion.tolist() == [0, 0, 0, 1, 1, 1]
    (p,) = fitting.predictions(GaussianFamily(), [sample], {"box": TRUTH})
    assert p.shape == sample.hit.shape
    assert (p >= 0.0).all() and (p <= 1.0).all()


@pytest.mark.parametrize(
    ("prior", "spread", "text"), [(2.0, 1.0, r"prior of x = 2\.0"), (0.0, 0.0, r"spread of x = 0\.0")]
)
def test_invalid_constants_are_refused(prior: float, spread: float, text: str) -> None:
    with pytest.raises(SettingError, match=text):
        Constant(name="x", prior=prior, spread=spread, high=1.0)


def test_nothing_to_fit_is_refused() -> None:
    with pytest.raises(SettingError, match="samples"):
        fitting.fit(GaussianFamily(), [])

"""Fault effects: the library's table lists FailBench's faults without importing it; fits of effects."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from failbench.calibrations.calibrate import write
from failbench.calibrations.effects_fit import EffectsCalibration, fit_effects, likeliest, predicted
from failbench.calibrations.failure_jobs import MotionKind, make_motion
from failbench.calibrations.failures import Failures, simulate_failures, write_failures
from failbench.calibrations.fault_events import FaultEvents, fault_events
from failbench.calibrations.mixture import log_likelihood
from failbench.cli import DONE, main
from failbench.fault.registry import DEGREES, faults, reactions
from graceful_plan import load_scene
from graceful_plan.costs import fault_prior
from graceful_plan.costs.fault_prior import FAILURES, FaultPrior, presets, shipped_effects
from graceful_plan.exceptions import SettingError, ShapeError


def test_shipped_effects_cover_exactly_the_existing_faults():
    assert list(shipped_effects()) == [*faults(), *reactions()]
    assert tuple(DEGREES) == fault_prior.DEGREES


@pytest.mark.parametrize("name", presets())
def test_presets_name_existing_faults(name):
    assert set(FaultPrior.preset(name).rates) <= {*faults(), *reactions()}


# --- the fit ----------------------------------------------------------------------------------------------------------


def draw(shares, n=40_000, motions=50, seed=0, concentration=(0.2, 1.0)):
    """Draw events of a fault that acts like each generator with some probability; half are hits by the body."""
    rng = np.random.default_rng(seed)
    probability = rng.beta(*concentration, size=(n, len(FAILURES)))
    body = rng.random(n) < 0.5
    probability[body, :2] = 0.0
    drop, spill, *arm = shares
    dropped = ~body & (rng.random(n) < drop)
    kind = 1 + rng.choice(len(FAILURES), size=n, p=[spill, *arm, 1.0 - spill - sum(arm)])
    kind[dropped] = 0
    chance = np.column_stack([probability, np.zeros(n)])[np.arange(n), kind]
    motion = rng.integers(motions, size=n)
    return FaultEvents(
        probability=probability,
        happened=rng.random(n) < chance,
        body=body,
        motion=motion,
        scene=np.where(motion % 2 == 0, "desk", "kitchen"),
    )


TRUE = (0.6, 0.2, 0.0, 0.35, 0.0, 0.1)
BOTH = (0.9, 0.0, 0.8, 0.0, 0.0, 0.0)  # a loss of power: the arm falls, and so does the object


@pytest.mark.long
@pytest.mark.parametrize("true", [TRUE, BOTH], ids=["several", "both"])
def test_the_truth_is_found_and_lies_in_the_intervals(true):
    effect = fit_effects({"weak_grip": draw(true, n=10_000)}, resamples=30, seed=1)["weak_grip"]
    for name, share in zip(FAILURES, true, strict=True):
        found = effect.shares[name]
        # Spills can be observed only if the object is not dropped.
        assert found.value == pytest.approx(share, abs=0.06 if name != "spill" else 0.2)
        half = 0.5 * (found.high - found.low)
        assert found.low - half - 0.01 <= share <= found.high + half + 0.01  # twice the interval's width, for luck
        assert 0.0 <= half < (0.1 if name != "spill" else 0.45)
    assert effect.motions == 50
    assert effect.fitted.ratio == pytest.approx(1.0, abs=0.02)
    assert effect.held_out is not None and effect.held_out.events == effect.fitted.events
    assert effect.held_out.log_loss >= effect.fitted.log_loss - 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_no_other_shares_are_likelier(seed):
    rng = np.random.default_rng(seed)

    def some():
        return np.append(rng.random(), rng.dirichlet(np.full(6, 0.4))[:5])

    true = some()
    events = draw(true, n=1000, seed=seed)
    best = likeliest(events)
    assert (best >= 0.0).all() and best[0] <= 1.0 + 1e-9 and best[1:].sum() <= 1.0 + 1e-9
    reached = log_likelihood(predicted(events, best), events.happened)
    near = [np.clip(best + rng.normal(0.0, 0.02, 6), 0.0, 1.0) for _ in range(50)]
    others = [true, *(some() for _ in range(50)), *(x for x in near if x[1:].sum() <= 1.0)]
    assert reached >= max(log_likelihood(predicted(events, x), events.happened) for x in others) - 0.02


def test_a_fault_of_the_gripper_and_one_of_the_arm():
    gripper = draw((0.8, 0.0, 0.0, 0.0, 0.0, 0.0), n=4000)
    assert likeliest(gripper) == pytest.approx([0.8, 0, 0, 0, 0, 0], abs=0.06)
    alone = gripper.rows(gripper.body)  # the body came near nothing
    assert likeliest(alone) == pytest.approx([0.0] * 6, abs=1e-3)
    stuck = draw((0.0, 0.0, 0.0, 0.0, 0.7, 0.0), n=4000)
    assert likeliest(stuck) == pytest.approx([0, 0, 0, 0, 0.7, 0], abs=0.06)


def test_one_scene_cannot_be_held_out():
    events = draw(TRUE, n=200).rows(np.arange(200) < 50)
    alone = events.rows(events.scene == "desk")
    assert fit_effects({"noise": alone}, resamples=2)["noise"].held_out is None


def test_written_files_can_be_read(tmp_path, monkeypatch):
    effects = fit_effects({"noise": draw(TRUE, n=2000), "dropout": draw((0.0,) * 6, n=2000)}, resamples=5)
    file = tmp_path / "fault_effects.yaml"
    about = {"scenes": ["desk"], "failures": 12}
    write(EffectsCalibration(effects=effects, degree="moderate", seed=0, about=about), file)
    table = yaml.safe_dump({"effects": yaml.safe_load(file.read_text())["effects"]})
    (tmp_path / "faults.yaml").write_text("version: 1\npresets: {mine: {noise: 1, dropout: 1}}\n" + table)
    prior = FaultPrior.load(tmp_path / "faults.yaml", degree="moderate")
    for name in FAILURES:
        assert prior.effects["noise"].get(name, 0.0) == pytest.approx(effects["noise"].shares[name].value, abs=1e-4)
    assert sum(prior.effects["dropout"].values()) == pytest.approx(0.0, abs=1e-3)
    about = yaml.safe_load(file.read_text())
    assert about["version"] == 1 and about["provenance"]["failures"] == 12 and about["provenance"]["seed"] == 0
    assert set(about["provenance"]["intervals"]["moderate"]["noise"]) <= set(FAILURES)
    # The file can replace the shipped one.
    monkeypatch.setattr(fault_prior, "_EFFECTS", file)
    fault_prior._shipped_effects.cache_clear()
    try:
        assert set(shipped_effects("moderate")) == {"noise", "dropout", *reactions()}
    finally:
        fault_prior._shipped_effects.cache_clear()


def test_failures_become_events():
    hit = np.zeros((4, 2, 3), bool)
    hit[1, 0, 2] = hit[3, 1, 0] = True
    counted = np.array([[True, True, True], [True, True, False]])
    part = Failures(
        scene="desk",
        task="t",
        motion="",
        grasp="weld",
        components=("body", "carried"),
        entities=("a", "b", "c"),
        categories=("glass",) * 3,
        faults=("noise", "dropout"),
        counted=counted,
        fault=np.array([0, 1, 1, 0]),
        q=np.zeros((4, 7)),
        qd=np.zeros((4, 7)),
        ahead=np.zeros((4, 2, 7)),
        hit=hit,
        dropped=np.zeros(4, bool),
        spilled=np.zeros(4),
    )

    def model(scene, failures):
        assert failures is part
        return {"stray": np.arange(24.0).reshape(4, 2, 3) / 24.0}

    found = fault_events([part, part], {("desk", "t"): load_scene("desk")}, model)
    assert list(found) == ["noise", "dropout"]
    noise = found["noise"]
    assert len(noise) == 20 and list(noise.motion) == [0] * 10 + [1] * 10 and set(noise.scene) == {"desk"}
    column = list(FAILURES).index("stray")
    np.testing.assert_array_equal(noise.probability[:5, column], np.arange(5.0) / 24.0)
    np.testing.assert_array_equal(noise.probability[5:10, column], np.arange(18.0, 23.0) / 24.0)
    assert not np.delete(noise.probability, column, axis=1).any()
    assert list(np.flatnonzero(noise.happened)) == [8, 18]
    assert list(noise.body[:10]) == [True] * 3 + [False] * 2 + [True] * 3 + [False] * 2
    assert list(np.flatnonzero(found["dropout"].happened)) == [2, 12]


def test_misuse_is_refused():
    events = draw(TRUE, n=20)
    with pytest.raises(ShapeError, match=r"happened.*\(10,\).*\(20,\)"):
        replace(events, happened=events.happened[:10])
    with pytest.raises(ShapeError, match="probability has shape"):
        replace(events, probability=events.probability[:, :3])
    with pytest.raises(SettingError, match=r"probability = .*\[0, 1\]"):
        replace(events, probability=events.probability + 1.0)
    with pytest.raises(SettingError, match="noise"):
        fit_effects({"noise": events.rows(np.zeros(20, bool))})


@pytest.mark.long
def test_the_command_fits_effects_to_failures_of_a_file(tmp_path):
    task = load_scene("tabletop_l1").tasks["green_to_blue"]
    motion = make_motion(task, MotionKind(way="rrt_connect", speed=0.6), 1)
    assert motion is not None
    feared = [faults()[name](degree="severe") for name in ("gripper_failure", "control_delay")]
    happened = simulate_failures(motion, task.scene, feared, n=40, seed=1, task="green_to_blue")
    file, out = tmp_path / "failures.npz", tmp_path / "effects.yaml"
    write_failures(file, [happened])
    command = ["calibrate", str(out), "--model", "effects", "--scenes", "tabletop_l1", "--drops", str(file)]
    assert main(command) == DONE
    shares = yaml.safe_load(out.read_text())["effects"]["severe"]
    assert set(shares) == {"gripper_failure", "control_delay"}
    assert shares["gripper_failure"] == {"drop": 1.0}
    assert sum(shares["control_delay"].values()) < 0.5

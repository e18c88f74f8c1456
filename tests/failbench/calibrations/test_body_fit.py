"""Fits recover the margins of generated data, and the model reads the file that the calibration writes."""

import dataclasses

import numpy as np
import pytest

import graceful_plan as gp
from failbench.calibrations import body_fit, failure_jobs, failures
from failbench.calibrations.body_fit import SINGLE, WHOLE, faults_of, touches, wide
from failbench.calibrations.body_margins import fit_margin, predicted
from failbench.calibrations.calibrate import scenes_of
from failbench.calibrations.failures import fault_label
from failbench.cli import DONE, main
from graceful_plan.costs.models.body.body import FAR, BodyModel, mode_names
from graceful_plan.costs.models.body.constants import GENERATORS, BodySettings, Margin
from graceful_plan.exceptions import SettingError, ShapeError


@pytest.mark.parametrize("ways", [1, 3])
def test_a_margin_is_found_again(ways):
    rng = np.random.default_rng(ways)
    truth = Margin(offset=-0.04, spread=0.02)
    d = rng.uniform(-0.15, 0.3, size=(20_000, ways))
    hit = rng.uniform(size=len(d)) < predicted(d, truth)
    found = fit_margin(d, hit)
    assert found.offset == pytest.approx(truth.offset, abs=0.003)
    assert found.spread == pytest.approx(truth.spread, rel=0.08)
    assert predicted(d, found).mean() == pytest.approx(hit.mean(), rel=0.02)


def test_unfittable_data_are_refused():
    with pytest.raises(SettingError, match="hit"):
        fit_margin(np.zeros((3, 1)), np.zeros(3, dtype=bool))
    with pytest.raises(ShapeError, match="d has shape"):
        fit_margin(np.zeros((3, 1)), np.zeros(2, dtype=bool))


def test_wide_settings_cut_nothing_near():
    margin = wide(BodySettings.shipped()).stuck.body
    assert margin.offset + FAR * margin.spread == pytest.approx(0.35)


def test_a_weight_counts_as_copies():
    rng = np.random.default_rng(5)
    d = rng.uniform(-0.15, 0.3, size=(300, 1))
    hit = rng.uniform(size=300) < predicted(d, Margin(offset=-0.04, spread=0.02))
    counts = rng.integers(0, 3, size=300)
    found = fit_margin(d, hit, counts.astype(float))
    copied = fit_margin(np.repeat(d, counts, axis=0), np.repeat(hit, counts))
    assert (found.offset, found.spread) == pytest.approx((copied.offset, copied.spread), abs=1e-4)


@pytest.fixture(scope="module")
def parts():
    faults, kinds = faults_of(gp.load_scene("tabletop_l1")), failure_jobs.KINDS[:1]
    jobs = failure_jobs.failure_jobs(gp.load_scene, ["tabletop_l1"], faults, n=2 * len(faults), kinds=kinds)
    return [failure_jobs.run_job(job) for job in jobs[:2]]


@pytest.mark.long
def test_labels_hold_the_struck_entities(parts):
    labels = parts[0].faults
    scene = gp.load_scene("tabletop_l1")
    joints = scene.joints
    assert set(labels) == {f"{name} {joint}" for name in SINGLE for joint in joints} | set(WHOLE)
    assert len(parts[0].only(["stuck_position " + joints[3]])) == 2
    assert labels == tuple(map(fault_label, faults_of(scene)))


@pytest.mark.long
def test_hits_belong_to_the_failed_joint(parts):
    scenes = scenes_of(parts, gp.load_scene)
    settings = BodySettings.shipped()
    found = touches(settings, parts, scenes)
    assert {generator for generator, _ in found} == set(GENERATORS)
    assert all(len({len(column) for column in events}) == 1 for events in found.values())
    part, scene = parts[0], scenes[parts[0].scene, parts[0].task]
    batch = part.states(scene)
    d = BodyModel(wide(settings)).distances(batch, batch.ahead)[:, :, 0][..., part.counted[0]]
    modes = mode_names(scene)
    expected = [
        d[i, modes.index(part.faults[part.fault[i]].replace("complete_shutdown ", "joint/"))]
        for i in range(len(part))
        if part.faults[part.fault[i]].startswith("complete_shutdown")
    ]
    mine = found["joint", "body"]
    np.testing.assert_array_equal(mine.d[mine.motion == 0], np.ravel(expected))
    assert mine.hit.sum() <= sum(part.hit[:, 0].sum() for part in parts)
    with pytest.raises(SettingError, match="step"):
        touches(dataclasses.replace(settings, step=0.2), parts, scenes)


@pytest.mark.long
def test_the_model_reads_the_file_of_the_command(parts, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(body_fit, "_RESAMPLES", 2)
    kept, written = tmp_path / "failures.npz", tmp_path / "body.yaml"
    failures.write_failures(kept, parts)
    options = ["--model", "body", "--scenes", "tabletop_l1", "--drops", str(kept)]
    assert main(["calibrate", str(written), *options]) == DONE
    assert "collapse, body" in capsys.readouterr().out
    expected, read = body_fit.fit_body(parts, resamples=0).settings(), BodySettings.load(written)
    assert expected != BodySettings.shipped()
    for generator in GENERATORS:
        first, second = (dataclasses.asdict(getattr(x, generator)) for x in (expected, read))
        for row in ("body", "carried"):
            assert second[row] == pytest.approx(first[row], rel=1e-3)
    assert read.steps == BodySettings.shipped().steps

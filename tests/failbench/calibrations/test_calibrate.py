from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from gaussian_family import GaussianFamily

import graceful_plan as gp
from failbench.calibrations import calibrate, failure_jobs, family_fit
from failbench.calibrations.failures import DROP, Failures
from graceful_plan.exceptions import SettingError
from graceful_plan.yaml_file import read_yaml

SCENES = ("tabletop", "tabletop_l1")


def drops(names) -> list[Failures]:
    kinds = failure_jobs.KINDS[:1]
    jobs = [job for name in names for job in failure_jobs.failure_jobs(gp.load_scene, [name], n=30, kinds=kinds)[:2]]
    found = [failure_jobs.run_job(job) for job in jobs]
    return [part for part in found if isinstance(part, Failures)]


@pytest.fixture(scope="module")
def dropped() -> list[Failures]:
    return drops(SCENES)


@pytest.fixture(scope="module")
def calibrated(dropped: list[Failures]) -> family_fit.FamilyCalibration:
    return family_fit.fit_family(GaussianFamily(), dropped, model="gaussian", shapes=("ball",), about={"horizon": 1.0})


@pytest.mark.long
def test_fitting_helps(dropped: list[Failures], calibrated: family_fit.FamilyCalibration) -> None:
    assert len(dropped) == 4
    assert calibrated.fitted.brier_skill > 0.0
    samples = family_fit.samples_of(GaussianFamily(), dropped, calibrate.scenes_of(dropped, gp.load_scene))
    priors = {c.name: c.prior for c in GaussianFamily.constants}
    before = family_fit.figures(
        *family_fit.events([GaussianFamily().probability(priors, s.prepared) for s in samples], samples)
    )
    assert calibrated.fitted.log_loss < before.log_loss
    assert set(calibrated.held_out) == {*SCENES, "all"}
    parts = [calibrated.held_out[name].events for name in SCENES]
    tried = calibrated.provenance["trusts_tried"]
    assert calibrated.held_out["all"].log_loss == pytest.approx(min(tried.values()), rel=1e-4)
    assert min(tried, key=lambda x: tried[x]) == str(calibrated.provenance["trust"])
    assert calibrated.held_out["all"].events == sum(parts) == calibrated.fitted.events


@pytest.mark.long
def test_the_document_has_a_provenance(calibrated: family_fit.FamilyCalibration, tmp_path: Path) -> None:
    calibrate.write(calibrated, tmp_path / "constants.yaml")
    root = read_yaml(tmp_path / "constants.yaml")
    about = root["provenance"]
    assert (root["version"].number(), about["model"].string()) == (1, "gaussian")
    assert about["scenes"].strings() == SCENES
    assert about["failures"].number() == 120
    assert about["horizon"].number() == 1.0
    assert about["shapes"]["box"].number() == 120
    assert about["shapes"]["ball"].number() == 0
    assert about["units"]["speed"].string() == "m/s"
    for shape in ("box", "ball"):
        for name, fitted in calibrated.constants[shape].items():
            assert root["classes"][shape][name].number() == pytest.approx(fitted.value, rel=1e-4)
            interval = about["intervals"]["classes"][shape][name].numbers(2)
            assert interval == pytest.approx((fitted.low, fitted.high), rel=1e-4)
    assert not list(root["shared"].items())
    assert "tabletop_l1" in str(calibrated)


@pytest.mark.long
def test_one_scene_is_not_enough() -> None:
    with pytest.raises(SettingError, match="at least two"):
        family_fit.fit_family(GaussianFamily(), drops(SCENES[:1]), model="gaussian")


@pytest.mark.long
def test_drops_do_not_depend_on_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[int, int]] = []
    all_jobs, kinds = failure_jobs.failure_jobs, failure_jobs.KINDS[:1]
    monkeypatch.setattr(
        failure_jobs, "failure_jobs", lambda *a, **k: all_jobs(*a, **{**k, "repeats": 1}, kinds=kinds)[:2]
    )
    amount = failure_jobs.FailureSettings(n=4)
    first, refused = failure_jobs.generate(["tabletop_l1"], DROP, amount, progress=lambda *x: told.append(x))
    second, _ = failure_jobs.generate(["tabletop_l1"], DROP, dataclasses.replace(amount, processes=2))
    assert not refused
    assert told == [(1, 2), (2, 2)]
    for a, b in zip(first, second, strict=True):
        assert (a.task, a.motion) == (b.task, b.motion)
        assert np.array_equal(a.q, b.q) and np.array_equal(a.hit, b.hit)

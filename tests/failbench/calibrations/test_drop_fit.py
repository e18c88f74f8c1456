from __future__ import annotations

import dataclasses
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from failbench.calibrations import calibrate, drop_fit, failure_jobs, family_fit
from failbench.calibrations.drop_fit import DropFamily
from failbench.calibrations.failures import Failures
from failbench.cli import DONE, MISUSE, main
from graceful_plan.costs.models.drop.constants import DropConstants, DropSettings
from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES
from graceful_plan.costs.models.mixture.mixture import FailureMixture

FAMILY = DropFamily()


def test_every_constant_has_a_prior() -> None:
    assert {c.name for c in FAMILY.constants} == {field.name for field in dataclasses.fields(DropConstants)}


def test_priors_and_bounds_name_constants_of_the_model() -> None:
    for end in ("prior", "low", "high"):
        DropConstants(**{c.name: getattr(c, end) for c in FAMILY.constants})


def test_the_fitted_prediction_equals_the_model() -> None:
    scene = gp.load_scene("tabletop_l3").tasks["green_to_blue"].scene
    task = gp.load_scene("tabletop_l3").tasks["green_to_blue"]
    u = np.linspace(0.0, 1.0, 7)[:, None]
    q = task.start + u * (task.goal[0] - task.start)
    qd = np.vstack([np.zeros(7), np.tile(0.4 * (task.goal[0] - task.start), (6, 1))])
    shipped = DropSettings.shipped()
    shape = FAMILY.shape(scene)
    found = FAMILY.probability(dataclasses.asdict(getattr(shipped, shape)), FAMILY.prepare(scene, q, qd))
    expected = gp.interaction_probability(q, scene, FailureMixture(), qd)
    assert shape == "box"
    assert np.array_equal(found, expected[:, list(scene.components).index("carried")])


@pytest.fixture(scope="module")
def calibrated() -> family_fit.FamilyCalibration:
    kinds = failure_jobs.KINDS[:1]
    jobs = [failure_jobs.failure_jobs(gp.load_scene, [x], n=20, kinds=kinds)[0] for x in ("tabletop", "desk")]
    parts = [part for part in map(failure_jobs.run_job, jobs) if isinstance(part, Failures)]
    return family_fit.fit_family(FAMILY, parts, model="drop", shapes=SHAPE_CLASSES, iterations=2, trusts=(25.0,))


@pytest.mark.long
def test_the_model_reads_the_file_of_the_calibration(calibrated: family_fit.FamilyCalibration, tmp_path: Path) -> None:
    calibrate.write(calibrated, tmp_path / "footprint.yaml")
    read = DropSettings.load(tmp_path / "footprint.yaml")
    for shape in SHAPE_CLASSES:
        assert set(calibrated.constants[shape]) == {field.name for field in dataclasses.fields(DropConstants)}
        for name, fitted in calibrated.constants[shape].items():
            assert getattr(getattr(read, shape), name) == pytest.approx(fitted.value, rel=1e-4)


@pytest.mark.long
def test_the_command_keeps_its_drops_and_takes_them_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    all_jobs, kinds = failure_jobs.failure_jobs, failure_jobs.KINDS[:1]
    few = lambda *a, **k: all_jobs(*a, **{**k, "repeats": 1}, kinds=kinds)[::4]  # noqa: E731
    monkeypatch.setattr(failure_jobs, "failure_jobs", few)
    monkeypatch.setattr(drop_fit, "fit_family", partial(family_fit.fit_family, iterations=1, trusts=(25.0,)))
    kept, first, second = (tmp_path / name for name in ("drops.npz", "first.yaml", "second.yaml"))
    options = ["--scenes", "tabletop", "tabletop_l1", "-n", "6", "--drops", str(kept), "--workers", "1"]
    assert main(["calibrate", str(first), *options]) == DONE
    assert "tabletop_l1" in capsys.readouterr().out
    assert main(["calibrate", str(second), *options, "--json"]) == DONE
    assert json.loads(capsys.readouterr().out)["provenance"]["failures_from"] == "drops.npz"
    assert DropSettings.load(first) == DropSettings.load(second)


@pytest.mark.parametrize(
    ("options", "text"),
    [(["--scenes", "nowhere"], "nowhere"), (["-n", "0"], "n = 0"), (["--scenes", "tabletop"], "at least two")],
)
def test_misuse_is_refused(
    options: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(failure_jobs, "generate", lambda *_, **__: ([], []))
    assert main(["calibrate", str(tmp_path / "out.yaml"), *options]) == MISUSE
    assert text in capsys.readouterr().err
    assert not (tmp_path / "out.yaml").exists()

"""Fits of the spill model: their data, and the model reads the file that the fit writes."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from failbench.calibrations import failure_jobs, failures, family_fit, spill_fit
from failbench.calibrations.calibrate import write
from failbench.calibrations.failures import Failures
from failbench.calibrations.spill_fit import FAULTS, SPILT, SpillFamily
from failbench.cli import DONE, main
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, drop_kernel
from graceful_plan.costs.models.spill.constants import USES, SpillConstants, SpillSettings
from graceful_plan.costs.models.spill.tables import DEPTH, spill_tables
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.rules.vessel import find_vessel


@pytest.mark.parametrize("use", USES)
def test_every_constant_is_fitted_or_fixed(use: str) -> None:
    family = SpillFamily(use)
    for end in ("prior", "low", "high"):
        given = family.of({c.name: max(getattr(c, end), 1e-3) for c in family.constants})
        assert set(dataclasses.asdict(given)) == {field.name for field in dataclasses.fields(SpillConstants)}
    assert (use == "held") == (family.of({c.name: c.prior for c in family.constants}).soft_speed == -10.0)


def test_the_fitted_prediction_equals_the_model() -> None:
    task = gp.load_scene("desk").tasks["bring_coffee"]
    q = task.start + np.linspace(0.0, 1.0, 7)[:, None] * (task.goal[0] - task.start)
    qd = np.full_like(q, 0.1)
    expected = drop_kernel(task.scene, DropSettings.shipped()).probability(q, qd)
    for use in USES:
        family = SpillFamily(use)
        found = family.probability(
            dataclasses.asdict(SpillSettings.shipped().of(use)), family.prepare(task.scene, q, qd)
        )
        np.testing.assert_allclose(found, expected[:, ROWS.index(use)], atol=1e-12)
        assert family.shape(task.scene) == "all"


@pytest.mark.parametrize(
    ("scene", "task"), [("desk", "bring_coffee"), ("dining_table", "serve_tea"), ("kitchen_counter", "season")]
)
def test_the_container_is_the_one_of_failbench(scene: str, task: str) -> None:
    where = gp.load_scene(scene).tasks[task].scene
    vessel, tables = find_vessel(where), spill_tables(where)
    assert vessel is not None
    assert (tables.rim, tables.depth) == (pytest.approx(vessel.radius), pytest.approx(vessel.height))
    assert tables.full == pytest.approx(np.pi * vessel.radius**2 * vessel.height / vessel.volume)
    assert tables.radius == pytest.approx(np.sqrt(vessel.volume / (np.pi * DEPTH)))


@pytest.mark.long
def test_each_use_has_failures_of_its_own(parts: list[Failures]) -> None:
    for use in USES:
        concerned = SpillFamily(use).concerned(parts)
        assert concerned
        for part in concerned:
            assert {part.faults[i] for i in part.fault} <= set(FAULTS[use])
            assert np.all(part.dropped == (use == "dropped"))
            assert use == "dropped" or np.all(part.spilled > SPILT)
    with pytest.raises(UnknownNameError, match="poured"):
        SpillFamily("poured")


@pytest.fixture(scope="module")
def parts() -> list[Failures]:
    jobs = []
    for name in ("desk", "kitchen_counter"):
        faults, kinds = spill_fit.faults_of(gp.load_scene(name)), failure_jobs.KINDS[:1]
        jobs += failure_jobs.failure_jobs(gp.load_scene, [name], faults, n=2 * len(faults), kinds=kinds)[:1]
    return [part for part in map(failure_jobs.run_job, jobs) if isinstance(part, Failures)]


@pytest.mark.long
def test_the_model_reads_the_file_of_the_command(
    parts: list[Failures], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = partial(family_fit.fit_family, iterations=1, trusts=(25.0,))
    monkeypatch.setattr(spill_fit, "fit_family", quick)
    kept, written = tmp_path / "failures.npz", tmp_path / "spill.yaml"
    failures.write_failures(kept, parts)
    options = ["--model", "spill", "--scenes", "desk", "kitchen_counter", "--drops", str(kept)]
    assert main(["calibrate", str(written), *options]) == DONE
    assert "held" in capsys.readouterr().out
    expected, read = spill_fit.fit_spill(parts).settings(), SpillSettings.load(written)
    for use in USES:
        assert dataclasses.asdict(read.of(use)) == pytest.approx(dataclasses.asdict(expected.of(use)), rel=1e-4)


@pytest.mark.long
def test_shared_constants_are_written_for_both_uses(
    parts: list[Failures], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spill_fit, "fit_family", partial(family_fit.fit_family, iterations=1, trusts=(25.0,)))
    written = tmp_path / "spill.yaml"
    write(spill_fit.fit_spill(parts, about={"motions_without": ["desk/lift_coffee: no motion"]}), written)
    assert SpillSettings.load(written) == SpillSettings.load(written)
    assert written.read_text().count("no motion") == len(USES)

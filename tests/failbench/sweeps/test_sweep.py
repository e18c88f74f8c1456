import dataclasses
import hashlib
import json
import sys
from pathlib import Path

import fake_work
import pytest
import yaml
from places import SUPPORT

from failbench.basics.chunks import attempt
from failbench.basics.errors import ExecutionRefused, SweepBusy, SweepFailed
from failbench.basics.tables import TABLES
from failbench.fault.registry import faults, to_document
from failbench.sweeps import sweep as sweeping
from failbench.sweeps.card import CARD, write_card
from failbench.sweeps.dataset import MANIFEST, read_dataset
from failbench.sweeps.definition import PlanSettings, Sweep, SweepMotion
from failbench.sweeps.executors import LocalExecutor
from failbench.sweeps.journal import SweepJournal
from failbench.sweeps.sweep import JOURNAL, generate_dataset, read_sweep, resume, sweep_of, versions
from graceful_plan.exceptions import FormatError, SettingError, UnknownNameError
from sizes import first_quick
from support.sweeps.kill_sweep import Trial

DROP, LOOSE, NOISE = (to_document(faults()[name]()) for name in ("gripper_failure", "loose_joint", "noise"))


class InProcess:
    """Runs chunks in this process, in the given order."""

    def __init__(self, order=1, stop_after=None):
        self.order, self.stop_after = order, stop_after
        self.seen = []

    def map(self, work, chunks):
        for chunk in list(chunks)[:: self.order]:
            if len(self.seen) == self.stop_after:
                raise KeyboardInterrupt
            self.seen.append(chunk.index)
            yield attempt(work, chunk)


@pytest.fixture(scope="module")
def sweep():
    motion = SweepMotion(name="lift", scene="tabletop", task="lift_to_goal", plan=PlanSettings(iterations=100))
    return Sweep(motions=(motion,), faults=(DROP, LOOSE, NOISE), rollouts=40, horizon=0.04)


@pytest.fixture(scope="module")
def reference(sweep, tmp_path_factory):
    """The files of an undisturbed sweep."""
    folder = tmp_path_factory.mktemp("reference")
    generate_dataset(sweep, folder, executor=InProcess())
    return files(folder)


def files(folder: Path) -> dict[str, str]:
    """Return checksums of a dataset's files."""
    found = [*folder.glob("*/*.parquet"), folder / MANIFEST]
    return {str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest() for file in found}


@pytest.mark.long
@pytest.mark.parametrize("workers", first_quick([2, 1, 4]))
def test_the_bytes_do_not_depend_on_the_number_of_workers(sweep, reference, tmp_path, workers):
    made = generate_dataset(sweep, tmp_path, executor=LocalExecutor(workers=workers))
    assert files(tmp_path) == reference
    assert made.manifest["rows"]["rollouts"] == 120


def test_the_card_describes_the_dataset_and_keeps_foreign_files(sweep, tmp_path):
    manifest = {"rows": {"rollouts": 120, "contacts": 7}, "versions": versions()}
    write_card(tmp_path, sweep, manifest)
    card = tmp_path / CARD
    head, text = card.read_text().removeprefix("---\n").split("---\n", 1)
    configs = yaml.safe_load(head)["configs"]
    assert {c["config_name"]: c["data_files"] for c in configs} == {t: f"{t}/*.parquet" for t in TABLES}
    write_card(tmp_path, sweep, {**manifest, "rows": {"rollouts": 120, "contacts": 0}})
    assert "- config_name: contacts" not in card.read_text()
    assert text.count("\n| `") == sum(map(len, TABLES.values()))
    assert "120 rollouts" in text and "Motions: lift. Faults: gripper_failure (severe), " in text
    card.write_text(card.read_text().replace("120 rollouts", "many rollouts"))
    write_card(tmp_path, sweep, manifest)
    assert "120 rollouts" in card.read_text()
    card.write_text("mine")
    write_card(tmp_path, sweep, manifest)
    assert card.read_text() == "mine"


@pytest.mark.long
def test_hugging_face_finds_the_tables_by_the_card(sweep, tmp_path):
    hf = pytest.importorskip("datasets")
    longer = dataclasses.replace(sweep, faults=(DROP,), rollouts=4, horizon=0.6)
    rows = generate_dataset(longer, tmp_path / "made", executor=InProcess()).manifest["rows"]
    assert all(rows.values())
    for table, count in rows.items():
        found = hf.load_dataset(str(tmp_path / "made"), table, split="train", cache_dir=str(tmp_path / "cache"))
        assert (found.num_rows, found.column_names) == (count, [column.name for column in TABLES[table]])


def test_the_dataset_matches_the_sweep(sweep, reference, tmp_path):
    generate_dataset(sweep, tmp_path, executor=InProcess(order=-1))
    assert files(tmp_path) == reference and "120 rollouts" in (tmp_path / CARD).read_text()
    made = read_dataset(tmp_path)
    assert made.sweep.question == sweep.question
    assert read_sweep(tmp_path).to_document() == made.sweep.to_document()
    assert made.rollouts["rollout"].to_pylist() == list(range(120))
    assert made.rollouts["fault"].to_pylist() == [f["fault"] for f in (DROP, LOOSE, NOISE) for _ in range(40)]
    assert made.manifest["versions"].items() >= versions().items()
    counts = made.rollouts["contacts"].to_pylist()
    assert made.contacts["rollout"].to_pylist() == [i for i, count in enumerate(counts) for _ in range(count)]


@pytest.mark.long
def test_an_interrupted_sweep_resumes(sweep, reference, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        generate_dataset(sweep, tmp_path, executor=InProcess(stop_after=2))
    assert not (tmp_path / MANIFEST).exists()
    with pytest.raises(KeyboardInterrupt):
        generate_dataset(sweep, tmp_path, executor=InProcess(stop_after=1))
    rest = InProcess()
    progress = []
    resume(tmp_path, executor=rest, callback=progress.append)
    assert rest.seen == [3, 4, 5]
    assert [p.chunks_done for p in progress] == [4, 5, 6]
    assert [p.rollouts_done for p in progress] == [80, 112, 120]
    assert {(p.chunks, p.rollouts, p.failed) for p in progress} == {(6, 120, 0)}
    assert files(tmp_path) == reference


@pytest.mark.long
def test_a_complete_sweep_is_exported_again_and_nothing_is_done(sweep, reference, tmp_path):
    generate_dataset(sweep, tmp_path, executor=InProcess())
    (tmp_path / "rollouts" / "part-00000.parquet").write_bytes(b"oops")
    idle = InProcess()
    resume(tmp_path, executor=idle)
    assert idle.seen == []
    assert files(tmp_path) == reference


@pytest.mark.long
def test_failed_chunks_are_tried_again_by_resume(sweep, reference, tmp_path, monkeypatch):
    real = sweeping.run_chunk

    def flaky(one, chunk):
        if chunk.index in (1, 4):
            raise ArithmeticError("no such luck")
        return real(one, chunk)

    monkeypatch.setattr(sweeping, "run_chunk", flaky)
    progress = []
    with pytest.raises(SweepFailed, match=r"2 of 6 .* lift / gripper_failure severe / .*32-39: Arith"):
        generate_dataset(sweep, tmp_path, executor=InProcess(), callback=progress.append)
    assert progress[-1].failed == 2
    with pytest.raises(FormatError, match="an unfinished one"):
        read_dataset(tmp_path)
    monkeypatch.undo()
    again = InProcess()
    resume(tmp_path, executor=again)
    assert again.seen == [1, 4]
    assert files(tmp_path) == reference


def test_another_sweep_in_the_folder_is_refused_with_the_difference(sweep, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        generate_dataset(sweep, tmp_path, executor=InProcess(stop_after=0))
    other = dataclasses.replace(sweep, seed=1, horizon=0.06)
    with pytest.raises(FormatError, match=r"journal\.sqlite: .*horizon, seed"):
        generate_dataset(other, tmp_path, executor=InProcess())


def test_other_versions_and_other_files_are_refused(sweep, tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        generate_dataset(sweep, tmp_path, executor=InProcess(stop_after=1))
    with monkeypatch.context() as patch:
        patch.setattr(sweeping, "versions", lambda: versions() | {"mujoco": "5.0"})
        with pytest.raises(FormatError, match=r"\(mujoco\)"):
            resume(tmp_path, executor=InProcess())
    with monkeypatch.context() as patch:
        patch.setattr(sweeping.mujoco, "mj_saveModel", lambda model, name, buffer: buffer.fill(0))
        with pytest.raises(FormatError, match=r"\(motion lift\)"):
            resume(tmp_path, executor=InProcess())


def test_a_folder_without_a_sweep_is_refused(tmp_path):
    for call in (resume, read_sweep):
        with pytest.raises(FormatError):
            call(tmp_path)
    with SweepJournal(tmp_path / JOURNAL):
        pass
    with pytest.raises(FormatError, match=r"journal\.sqlite: "):
        resume(tmp_path)
    with SweepJournal(tmp_path / JOURNAL), pytest.raises(SweepBusy):
        resume(tmp_path)


@pytest.mark.long
def test_a_kill_before_the_sweep_was_begun_is_nothing_to_generate(sweep, reference, tmp_path):
    with SweepJournal(tmp_path / JOURNAL):
        pass
    with pytest.warns(UserWarning, match="empty"):
        generate_dataset(sweep, tmp_path, executor=InProcess())
    assert files(tmp_path) == reference


@pytest.mark.long
def test_misuse_is_found_before_anything_is_begun(sweep, tmp_path):
    elbow = dataclasses.replace(sweep, faults=({"fault": "loose_joint", "targets": ["elbow"]},))
    with pytest.raises(UnknownNameError, match="elbow"):
        generate_dataset(elbow, tmp_path, executor=InProcess())
    planned = sweep.planned().motions[0].trajectory
    hasty = dataclasses.replace(planned, t=planned.t / 20.0, qd=20.0 * planned.qd, qdd=400.0 * planned.qdd)
    motion = SweepMotion(name="rush", scene="tabletop", task="lift_to_goal", trajectory=hasty)
    with pytest.raises(ExecutionRefused, match="rush: "):
        generate_dataset(dataclasses.replace(sweep, motions=(motion,)), tmp_path, executor=InProcess())
    assert list(tmp_path.iterdir()) == []


def test_sweep_of_scenarios_is_every_fault_on_every_task():
    made = sweep_of(["drop/*/severe"], 8, plans=(PlanSettings(w=0.0), PlanSettings(w=1.0)))
    assert [fault["fault"] for fault in made.faults] == ["gripper_failure", "weak_grip", "stuck_gripper"]
    names = [motion.name for motion in made.motions]
    assert names[:2] == ["desk/bring_coffee/0", "desk/bring_coffee/1"]
    assert [motion.plan.w for motion in made.motions[:2]] == [0.0, 1.0]
    assert len({motion.scene for motion in made.motions}) > 3
    with pytest.raises(SettingError, match="same faults"):
        sweep_of(["tabletop/lift_to_goal/noise/*", "desk/bring_coffee/dropout/*"], 8)
    with pytest.raises(UnknownNameError, match="cake"):
        sweep_of(["cake/*"], 8)


@pytest.mark.long
def test_kills_of_drivers_and_workers_change_nothing(tmp_path):
    trial = Trial(tmp_path, rollouts=40, workers=2, seed=1, horizon=0.3)
    trial.run(4)
    assert trial.kills.total() == 4
    assert trial.kills["driver"] and trial.kills["worker"]
    assert trial.wrong == 0
    assert trial.rows == trial.sweeps * 160


@pytest.mark.long
def test_ray_makes_the_same_bytes(sweep, reference, tmp_path, monkeypatch):
    ray = pytest.importorskip("ray")
    from failbench.sweeps.ray_executor import RayExecutor

    # Ray's workers are separate processes; this lets them import the test modules.
    monkeypatch.setenv("PYTHONPATH", ":".join([str(SUPPORT), *sys.path]))
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        chunks = fake_work.chunks(5)
        deadly = fake_work.Fake(raising=1, deadly=3, deadly_times=1, notes=tmp_path)
        outcomes = {outcome.chunk.index: outcome for outcome in RayExecutor().map(deadly, chunks)}
        assert outcomes[1].error == "motion / fault 1 / 0-2: ArithmeticError: no such luck"
        assert all(outcomes[i].rows == fake_work.rows(chunks[i]) for i in (0, 2, 3, 4))
        hopeless = fake_work.Fake(deadly=0, deadly_times=99, notes=tmp_path)
        (outcome,) = RayExecutor().map(hopeless, chunks[:1])
        assert " 3 times" in outcome.error
        generate_dataset(sweep, tmp_path / "made", executor=RayExecutor())
        assert ray.is_initialized(), "a Ray that ran before is left running"
    finally:
        ray.shutdown()
    assert files(tmp_path / "made") == reference
    assert json.loads((tmp_path / "made" / MANIFEST).read_text())["rows"]["rollouts"] == 120

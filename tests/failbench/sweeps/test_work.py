import dataclasses
import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from failbench.basics.tables import TABLES
from failbench.fault.registry import faults, to_document
from failbench.recording.records import ContactEvent, Rollout
from failbench.rollouts.rollout import run_rollouts
from failbench.simulated.world import SimSettings
from failbench.sweeps import summary, work
from failbench.sweeps.definition import CHUNK, PlanSettings, Sweep, SweepMotion, fault_of
from failbench.sweeps.rows import contact_rows, rollout_row
from failbench.sweeps.work import execution_of, jobs_of, run_chunk
from graceful_plan.exceptions import FormatError, SettingError, UnknownNameError

DROP, LOOSE = (to_document(faults()[name]()) for name in ("gripper_failure", "loose_joint"))
PLANNED = SweepMotion(name="lift", scene="tabletop", task="lift_to_goal", plan=PlanSettings(iterations=100))

OWN_FAULT = """
from dataclasses import dataclass
import numpy as np
from failbench import Fault

@dataclass(frozen=True, kw_only=True)
class Shiver(Fault):
    NAME, CATEGORY, PARAMETER = "shiver", "sensor", "nothing"
    AMOUNTS = {"minor": 1.0, "moderate": 2.0, "severe": 3.0, "critical": 4.0}

    def apply(self, plant, level):
        plant.misread(plant.joints, np.full(len(plant.joints), 0.01 * self.amount * level))
"""


@pytest.fixture(scope="module")
def sweep():
    return Sweep(motions=(PLANNED,), faults=(DROP, LOOSE), rollouts=5, horizon=0.1).planned()


@given(st.integers(1, 3), st.integers(1, 3), st.integers(1, 100))
def test_chunks_are_every_rollout_once_in_order(motions, kinds, rollouts):
    sweep = Sweep(
        motions=tuple(dataclasses.replace(PLANNED, name=f"m{i}") for i in range(motions)),
        faults=(DROP,) * kinds,
        rollouts=rollouts,
    )
    numbers = [sweep.first_rollout(c) + i for c in sweep.chunks for i in range(c.last - c.first)]
    assert numbers == list(range(motions * kinds * rollouts))
    assert [c.index for c in sweep.chunks] == list(range(len(sweep.chunks)))
    assert all(1 <= c.last - c.first <= CHUNK for c in sweep.chunks)
    assert len({c.name for c in sweep.chunks}) == (len(sweep.chunks) if kinds == 1 else len(sweep.chunks) // kinds)
    for chunk in sweep.chunks:
        assert sweep.place(sweep.first_rollout(chunk)) == (chunk.motion, chunk.fault, chunk.first)
    with pytest.raises(SettingError, match="rollout"):
        sweep.place(len(numbers))


@pytest.mark.long
def test_chunks_are_named_by_content(sweep):
    assert sweep.chunks[0].name == "lift / gripper_failure severe / rollouts 0-4"


def test_json_form_is_complete(sweep):
    changed = dataclasses.replace(sweep, horizon=0.5, seed=3, settings=SimSettings(grasp="weld", timestep=0.001))
    for one in (sweep, changed):
        text = json.dumps(one.to_document(), allow_nan=False)
        again = Sweep.from_document(json.loads(text))
        assert json.dumps(again.to_document()) == text
        assert again.settings == one.settings
        assert again.motions[0].plan == one.motions[0].plan


def test_planning_is_reproducible_and_no_part_of_the_question(sweep):
    unplanned = Sweep(motions=(PLANNED,), faults=(DROP, LOOSE), rollouts=5, horizon=0.1)
    assert sweep.question == unplanned.question == unplanned.to_document()
    assert unplanned.planned().to_document() == sweep.to_document()
    given_trajectory = dataclasses.replace(PLANNED, plan=None, trajectory=sweep.motions[0].trajectory)
    own = dataclasses.replace(unplanned, motions=(given_trajectory,))
    assert own.question["motions"][0]["trajectory"] is not None


def test_rows_have_the_columns_and_the_values_of_rollouts(sweep):
    chunk = sweep.chunks[1]
    rows = run_chunk(sweep, chunk)
    rollouts = run_rollouts(execution_of(sweep, 0), jobs_of(sweep, 0, 1), horizon=0.1)
    assert [list(row) for row in rows["rollouts"]] == [[c.name for c in TABLES["rollouts"]]] * 5
    assert all(list(row) == [c.name for c in TABLES["contacts"]] for row in rows["contacts"])
    assert [row["rollout"] for row in rows["rollouts"]] == [5, 6, 7, 8, 9]
    assert [row["onset"] for row in rows["rollouts"]] == [rollout.onset for rollout in rollouts]
    assert [row["contacts"] for row in rows["rollouts"]] == [len(rollout.events) for rollout in rollouts]
    assert {row["rollout"] for row in rows["contacts"]} <= {5, 6, 7, 8, 9}
    poses = [{p["name"]: p["wxyz_xyz"] for p in row["poses"]} for row in rows["rollouts"]]
    assert poses == [{name: list(pose) for name, pose in rollout.poses.items()} for rollout in rollouts]
    assert json.loads(json.dumps(rows, allow_nan=False)) == rows
    assert json.loads(rows["rollouts"][0]["fault_settings"]) == LOOSE
    assert all(row["healthy_harm"] == row["healthy_spilled"] == 0.0 for row in rows["rollouts"])
    assert all(row["whole_impact"] == row["observed_impact"] for row in rows["rollouts"])


@pytest.mark.long
def test_rows_depend_on_the_chunk_alone(sweep):
    first = [run_chunk(sweep, chunk) for chunk in sweep.chunks]
    copy = pickle.loads(pickle.dumps(sweep))
    work._execution.cache_clear()
    work._world.cache_clear()
    assert [run_chunk(copy, chunk) for chunk in reversed(copy.chunks)] == first[::-1]


def test_all_faults_on_all_motions_have_the_same_luck(sweep):
    drop, loose = (jobs_of(sweep, 0, fault) for fault in (0, 1))
    assert [(job.onset, job.seed) for job in drop] == [(job.onset, job.seed) for job in loose]
    assert len({job.seed for job in drop}) == 5


def test_the_rollouts_of_a_fault_are_drawn_once_not_for_every_chunk(sweep, monkeypatch):
    calls = []
    real = work.make_requests
    monkeypatch.setattr(work, "make_requests", lambda *args, **named: calls.append(named) or real(*args, **named))
    many = dataclasses.replace(sweep, rollouts=1000, seed=77)
    drawn = [jobs_of(many, 0, 0)[chunk.first : chunk.last] for chunk in many.chunks[: -(-1000 // CHUNK)]]
    assert len(calls) == 1 and sum(map(len, drawn)) == 1000
    (first, *_), (other, *_) = jobs_of(many, 0, 1), jobs_of(dataclasses.replace(many, seed=78), 0, 1)
    assert len(calls) == 3 and first != other


def test_a_fault_of_the_users_own(tmp_path):
    file = tmp_path / "shiver.py"
    file.write_text(OWN_FAULT)
    document = {"fault": f"{file}:Shiver", "degree": "minor"}
    fault = fault_of(document)
    assert (fault.NAME, fault.degree) == ("shiver", "minor")
    assert fault_of(document) == fault
    sweep = Sweep(motions=(PLANNED,), faults=(document,), rollouts=1, horizon=0.05).planned()
    (row,) = run_chunk(sweep, sweep.chunks[0])["rollouts"]
    assert (row["fault"], row["degree"]) == ("shiver", "minor")
    with pytest.raises(FormatError, match=r"shiver\.py: .*'Shake'.*Shiver"):
        fault_of({"fault": f"{file}:Shake"})


def test_execution_of_an_unplanned_motion_is_refused():
    with pytest.raises(SettingError, match="'lift'"):
        execution_of(Sweep(motions=(PLANNED,), faults=(DROP,), rollouts=1), 0)


def test_unknown_task_names_the_tasks():
    with pytest.raises(UnknownNameError, match=r"'dance'.*lift_to_goal"):
        dataclasses.replace(PLANNED, task="dance").planned()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motions": ()}, "motions"),
        ({"motions": (PLANNED, PLANNED)}, "all of different names"),
        ({"faults": ()}, "faults"),
        ({"rollouts": 0}, "rollouts"),
        ({"rollouts": 10**12}, "rollouts"),
        ({"seed": -1}, "seed"),
        ({"horizon": float("nan")}, "horizon"),
        ({"horizon": 0.001}, "horizon"),
        ({"horizon": 1e9}, "horizon"),
    ],
)
def test_senseless_sweeps_are_refused(change, message):
    with pytest.raises(SettingError, match=message):
        Sweep(**{"motions": (PLANNED,), "faults": (DROP,), "rollouts": 1} | change)


def test_a_motion_needs_a_trajectory_or_a_planner():
    with pytest.raises(SettingError, match=r"trajectory.*'a'"):
        SweepMotion(name="a", scene="tabletop")
    with pytest.raises(SettingError, match=r"task.*'a'"):
        SweepMotion(name="a", scene="tabletop", plan=PlanSettings())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("seed"), "missing keys: seed"),
        (lambda d: d.update(colour="red"), "unknown keys: colour"),
        (lambda d: d.update(version=2), "version is 2, this version reads 1"),
        (lambda d: d.update(schema="cake"), "schema is 'cake'"),
        (lambda d: d["motions"][0].pop("task"), "motion 0: missing keys: task"),
        (lambda d: d["motions"][0]["plan"].update(luck=1), "motion 0: plan: unknown keys: luck"),
        (lambda d: d["settings"].update(gravity=0), "settings: unknown keys: gravity"),
        (lambda d: d["motions"][0].update(scene=3), "motion 0: scene has to be text, not 3"),
        (lambda d: d["motions"][0].update(trajectory={"t": [0.0]}), "missing keys"),
        (lambda d: d["motions"][0].update(trajectory="t.json"), "trajectory has to be an object or null, not 't.json'"),
        (lambda d: d["motions"][0].update(plan=[]), "plan has to be an object or null"),
        (lambda d: d["motions"][0]["plan"].update(w="much"), "motion 0: plan: w has to be a number, not 'much'"),
        (lambda d: d["settings"].update(timestep=True), "settings: timestep has to be a number, not True"),
        (lambda d: d.update(settings=[]), "settings has to be an object"),
        (lambda d: d.update(motions=3), "motions has to be a list, not 3"),
        (lambda d: d.update(motions=[3]), "motion 0: an object is expected, not int"),
        (lambda d: d.update(horizon="long"), "horizon has to be a number, not 'long'"),
        (lambda d: d.update(faults=["gripper_failure"]), "fault 0 has to be an object, not 'gripper_failure'"),
    ],
)
def test_documents_that_are_no_sweep_are_refused(sweep, change, message):
    document = json.loads(json.dumps(sweep.to_document()))
    change(document)
    with pytest.raises(FormatError, match=message):
        Sweep.from_document(document, "my.json")


def test_file_that_is_not_json_is_refused(tmp_path):
    (tmp_path / "s.json").write_text("{")
    with pytest.raises(FormatError, match=r"s\.json: not JSON"):
        Sweep.from_json(tmp_path / "s.json")


def test_bundled_planner_settings_are_accepted_by_plan():
    assert {field.name for field in dataclasses.fields(PlanSettings)} <= set(gp.plan.__annotations__)


def test_numbers_of_a_diverged_simulation_become_null(sweep):
    nan = float("nan")
    event = ContactEvent(
        striker="body",
        entity="blue",
        time=0.1,
        position=(nan, 0.0, float("inf")),
        peak_force=1.0,
        impulse=nan,
        speed=1.0,
        energy=nan,
    )
    job = jobs_of(sweep, 0, 0)[0]
    state = np.array([1.0, 2.0])
    rollout = Rollout(
        job=job, onset=0.0, status="diverged", events=(event,), poses={"blue": np.full(7, nan)}, state=state
    )
    (contact,) = contact_rows(3, rollout)
    assert (contact["x"], contact["y"], contact["z"], contact["impulse"]) == (None, 0.0, None, None)
    row = rollout_row(rollout, execution_of(sweep, 0))
    assert row["poses"] == [{"name": "blue", "wxyz_xyz": [None] * 7}]
    assert (row["status"], row["state"]) == ("diverged", [1.0, 2.0])
    json.dumps([row, contact], allow_nan=False)
    all_diverged = {"rollouts": [{"rollout": 3, **row}], "contacts": [contact]}
    text = summary.rollouts(all_diverged, execution_of(sweep, 0).world.scene)
    assert text.startswith("1 rollouts; 1 diverged and are left out")

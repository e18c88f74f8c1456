from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from failbench import RolloutRequest, build_world, execute, run_rollouts
from failbench.fault.registry import CATEGORIES, DEGREES, faults
from failbench.scenario import Scenario, read_file, scenarios
from graceful_plan.exceptions import SceneError, UnknownNameError

_ALL = scenarios()
_TASKS = [(name, task) for name in gp.scenes() for task in gp.load_scene(name).tasks]


def test_every_task_fault_and_degree_has_its_scenario() -> None:
    assert len(faults()) == 19
    assert len(_ALL) == len(_TASKS) * 19 * 4
    names = [scenario.name for scenario in _ALL]
    assert len(set(names)) == len(names)
    assert {(s.scene, s.task) for s in _ALL} == set(_TASKS)
    assert {(s.fault.NAME, s.fault.degree) for s in _ALL} == {
        (fault, degree) for fault in faults() for degree in DEGREES
    }
    assert all(s.name == f"{s.scene}/{s.task}/{s.fault.NAME}/{s.fault.degree}" for s in _ALL)


def test_one_scenario_by_name() -> None:
    (found,) = scenarios("tabletop/lift_to_goal/gripper_failure/severe")
    assert found.fault == faults()["gripper_failure"](degree="severe")
    assert found.tags == tuple(f"{family}/gripper_failure/severe" for family in ("end_effector", "drop", "paper"))


@pytest.mark.parametrize("category", CATEGORIES)
def test_categories_are_families(category: str) -> None:
    found = scenarios(f"{category}/*")
    assert {s.fault.NAME for s in found} == {name for name, fault in faults().items() if fault.CATEGORY == category}
    assert len(found) == len(_TASKS) * 4 * len({s.fault.NAME for s in found})


def test_families_are_disjoint() -> None:
    drop, collapse, stray = (
        {s.fault.NAME for s in scenarios(f"{family}/*")} for family in ("drop", "collapse", "stray")
    )
    assert drop | collapse | stray == set(faults())  # each fault is in exactly one family
    assert not drop & collapse and not drop & stray and not collapse & stray


def test_only_full_containers_spill() -> None:
    spilling = {(s.scene, s.task) for s in scenarios("spill/*")}
    full = {(name, task) for name, task in _TASKS if "contents" in gp.load_scene(name).tasks[task].scene.components}
    assert spilling == full
    assert ("dining_table", "serve_tea") in spilling
    assert ("tabletop", "lift_to_goal") not in spilling


def test_robots_that_drive_are_found_by_scene_and_family_and_name() -> None:
    found = scenarios("mobile/*")
    assert {s.scene for s in found} == set(gp.mobile_scenes()) and not {s.scene for s in _ALL} & {
        s.scene for s in found
    }
    tasks = {(name, task) for name in gp.mobile_scenes() for task in gp.load_scene(name).tasks}
    assert {(s.scene, s.task) for s in found} == tasks
    kitchen, apartment = scenarios("kitchen/serve_pan/*"), scenarios("apartment/serve_tea/*/severe")
    assert len(kitchen) == 19 * 4  # a Fetch has a gripper, a Jackal has none
    assert {s.fault.NAME for s in apartment} == {n for n, kind in faults().items() if kind.TARGETS != ("gripper",)}
    assert len(apartment) >= 14
    (one,) = scenarios("apartment/serve_tea/stuck_position/critical")
    assert one.tags == ("mobile/stuck_position/critical", "actuator/stuck_position/critical")
    assert all(s.scene not in gp.mobile_scenes() for s in scenarios("actuator/*"))


def test_patterns_narrow_down() -> None:
    assert {s.fault.degree for s in scenarios("drop/*/critical")} == {"critical"}
    assert {s.scene for s in scenarios("tabletop_l?/*")} == {"tabletop_l1", "tabletop_l3"}
    assert len(scenarios("desk/*/noise/minor")) == len(gp.load_scene("desk").tasks)


def test_a_pattern_that_matches_nothing_lists_what_would() -> None:
    with pytest.raises(UnknownNameError, match=r"'drip/\*'.*desk/\*.*drop/\*.*spill/\*"):
        scenarios("drip/*")


_HEAD = "version: 1\nfamilies:\n  own:\n"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("version: 2\nfamilies: {}\n", 1, "only version 1"),
        (_HEAD + "    faults: [noise, hiccup]\n", 4, "unknown name 'hiccup' in .*own.faults; valid: complete_shutdown"),
        (_HEAD + "    scenes: [moon]\n", 4, "unknown name 'moon' in .*own.scenes; valid: desk"),
        (_HEAD + "    needs: luck\n", 4, "needs is 'luck', expected carried or contents"),
        (_HEAD + "    fault: [noise]\n", 4, "unknown key 'fault'"),
    ],
)
def test_errors_of_broken_registries_name_the_place(tmp_path: Path, text: str, line: int, words: str) -> None:
    file = tmp_path / "scenarios.yaml"
    file.write_text(text)
    with pytest.raises(SceneError, match=words) as caught:
        read_file(file)
    assert caught.value.line == line


_MOBILE = [(name, task) for name in gp.mobile_scenes() for task in gp.load_scene(name).tasks]


@pytest.mark.long
@pytest.mark.parametrize(("scene_name", "task_name"), [*_TASKS, *_MOBILE])
def test_every_scenario_runs(scene_name: str, task_name: str) -> None:
    task = gp.load_scene(scene_name).tasks[task_name]
    mine: list[Scenario] = list(scenarios(f"{scene_name}/{task_name}/*"))
    execution = execute(_begin(task), build_world(task.scene))
    jobs = [RolloutRequest(fault=s.fault, onset=0.5 * execution.duration, seed=i) for i, s in enumerate(mine)]
    rollouts = run_rollouts(execution, jobs, horizon=0.03, batch=len(jobs))
    assert [rollout.job for rollout in rollouts] == jobs
    assert {rollout.status for rollout in rollouts} == {"completed"}
    for rollout in rollouts:
        assert all(np.isfinite(pose).all() for pose in rollout.poses.values())
        assert all(event.entity in task.scene.entities for event in rollout.events)


def _begin(task: gp.Task) -> gp.Trajectory:
    """Return a short motion from the start of a task towards its first goal, at half the speed."""
    way = task.goal[0] - task.start
    path = gp.Path(np.stack([task.start, task.start + 0.005 * way / np.linalg.norm(way)]))
    return gp.retime(path, task.scene.limits, task.scene.joints, speed=0.5)

"""Generated benchmark problems: free at both ends, determined by the seed, unchanged after writing and reading."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

import graceful_plan as gp

if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from benchmarks.motion_problems import KINDS, make, write
from benchmarks.subjects import motion_problems


@pytest.mark.parametrize("kind", ["bookshelf_thin", "box"])
def test_problems_survive_writing_and_reading(kind: str, tmp_path: Path):
    made = make(kind, 2, 3)
    write(made, tmp_path / "problems.yaml")
    read = gp.load_problems(tmp_path / "problems.yaml")
    assert [problem.name for problem in read] == [problem.name for problem in made] == [f"{kind}/0", f"{kind}/1"]
    for ours, theirs in zip(made, read, strict=True):
        np.testing.assert_array_equal(ours.start, theirs.start)
        np.testing.assert_array_equal(ours.goals, theirs.goals)
        np.testing.assert_allclose(gp.clearance(ours.goals, ours.scene), gp.clearance(theirs.goals, theirs.scene))
        assert float(gp.clearance(np.vstack([theirs.start, theirs.goals]), theirs.scene).min()) > 0.002
        first = {"iterations": 20_000, "callback": lambda _: True}
        assert gp.plan(theirs.start, theirs.goal, theirs.scene, w=0.0, **first).status is gp.PlanStatus.SOLVED


def test_the_goal_pose_in_the_file_is_the_pose_of_the_goal(tmp_path: Path):
    made = make("box", 1, 3)
    write(made, tmp_path / "problems.yaml")
    (read,) = gp.load_problems(tmp_path / "problems.yaml")
    assert read.pose is not None
    data = read.scene.data_at(read.goals[0])
    np.testing.assert_allclose(data.site("panda/tool").xpos, read.pose.X_WT[:3, 3], atol=1e-9)


def test_the_seed_decides():
    first, again, other = make("box", 1, 5), make("box", 1, 5), make("box", 1, 6)
    np.testing.assert_array_equal(first[0].goals, again[0].goals)
    assert not np.array_equal(first[0].goals, other[0].goals)


@pytest.mark.parametrize("kind", KINDS)
def test_furniture_has_something_to_reach_for_and_boards_of_some_size(kind: str):
    furniture = KINDS[kind](np.random.default_rng(0))
    assert furniture.reaches
    names = [name for name, *_ in furniture.shapes]
    assert len(set(names)) == len(names)
    assert all(min(size) > 0.0 for _, _, size, _ in furniture.shapes)


def test_a_problem_is_examined():
    (problem,) = make("box", 1, 5)
    finding = motion_problems.examine((problem, 1, False))
    assert finding.status == "SOLVED" and np.isfinite([*finding.search, finding.lengths[-1]]).all()
    assert finding.lengths[-1] <= finding.lengths[0]

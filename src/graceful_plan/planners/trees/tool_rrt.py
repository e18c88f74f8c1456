"""Two trees that grow in the space of tool poses, and connect in joint space.

A sample is a pose of the tool, not a configuration: distances are those of tool poses, and the tool moves straight
towards the sample by differential inverse kinematics (damped least squares, in batches on the native kinematics). The
pose comes from a random configuration; in the null space, joints drift towards this configuration, so that all postures
can be reached. Equal poses may have different configurations, so straight edges in joint space connect the trees.

References:
    A. Shkolnik, R. Tedrake, "Path planning in 1000+ dimensions using a task-space Voronoi bias", ICRA 2009. Differs in:
    two trees, steps to the pose as far as they are free, edges between the trees in joint space.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Protocol, final, runtime_checkable

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core.kernels import Kernels
from graceful_plan.core.tool_motion import missing_twist, steps_inside, tool_jacobian
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.shortcut import Shortcut, first_and_shorter
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.planners.trees.tree import Tree
from graceful_plan.setting_checks import count, positive_or_none

_AT_ONCE = 8
"""Samples in a batch."""
_DRIFT = 0.1
"""Drift in the null space in one step, as a share of the distance to the sample's configuration."""
_LONGEST = 0.2
"""Largest step of a joint [rad or m]."""
_JOINT_STEP = 0.02
"""Step in a problem without a tool, as a share of the extent."""


@final
@dataclass(frozen=True, kw_only=True)
class ToolRRT(Planner):
    """Two trees that grow by straight motions of the tool. Stops at the first path, after shortcutting it.

    It ignores the cost. One iteration is eight samples, or one round of shortcutting. A problem without a scene has no
    tool and is searched in joint space.

    Args:
        step: Translation of the tool in one step [m].
        lever: Weight of rotation in distances [m/rad]; the tool rotates by at most `step / lever` in one step.
        steps: Largest number of steps towards a sample.
        max_nodes: Number of nodes above which the trees are discarded and restarted.
        shortcut: Settings of cost-aware shortcutting; None for no shortcutting.
    """

    name: ClassVar[str] = "tool_rrt"
    anytime: ClassVar[bool] = False

    step: float = 0.05
    lever: float = 0.2
    steps: int = 6
    max_nodes: int = 10_000
    shortcut: Shortcut | None = Shortcut()

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_or_none("step", self.step)
        positive_or_none("lever", self.lever)
        count("steps", self.steps)
        count("max_nodes", self.max_nodes, 10)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path, then cheaper versions of it by shortcutting."""
        return first_and_shorter(self._connect, self.shortcut, InterruptibleProblem(problem, objective, budget), rng)

    def _connect(self, questions: InterruptibleProblem, rng: np.random.Generator) -> Path | None:
        """Grow both trees alternately until an edge between them is free.

        Raises:
            Interrupted: If the time is over.
        """
        problem = questions.problem
        if isinstance(problem, SceneProblem):
            space: _Space = _ToolSpace(problem.kernels, problem.lower, problem.upper, self.step, self.lever)
        else:
            space = _JointSpace(_JOINT_STEP * problem.extent)
        trees = [_SpaceTree(roots, space) for roots in (problem.start[None], problem.goals)]
        met = _meeting(trees[0], np.zeros(1, dtype=int), trees[1], questions)
        side = 0
        while met is None and questions.budget.spend():
            samples = rng.uniform(problem.lower, problem.upper, (_AT_ONCE, len(problem.lower)))
            new = trees[side].grow(samples, self.steps, questions)
            found = _meeting(trees[side], new, trees[1 - side], questions)
            met = found if found is None or side == 0 else found[::-1]
            side = 1 - side
            if met is None and sum(len(tree.nodes) for tree in trees) > self.max_nodes:
                trees = [_SpaceTree(roots, space) for roots in (problem.start[None], problem.goals)]
        if met is None:
            return None
        behind = trees[1].nodes.branch(met[1])[::-1]
        return Path(np.concatenate([trees[0].nodes.branch(met[0]), behind])).without_duplicates()


@runtime_checkable
class _Space(Protocol):
    """Space in which trees grow: its distances and its steps."""

    def places(self, q: Float[Array, "n nq"]) -> Float[Array, "n place"]:
        """Return vectors whose Euclidean distances are those of the space."""
        ...

    def towards(self, q: Float[Array, "n nq"], goal: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Step from configurations towards the places of others; unchanged where no step is possible."""
        ...


@final
@dataclass(frozen=True, eq=False)
class _ToolSpace:
    """Space of tool poses."""

    kernels: Kernels
    lower: Float[Array, " nq"]
    upper: Float[Array, " nq"]
    step: float
    lever: float

    def places(self, q: Float[Array, "n nq"]) -> Float[Array, "n place"]:
        """Return the position and the rotation matrix, scaled so that small rotations count by the lever."""
        X_WT = self.kernels.tool_pose(q)
        R = X_WT[:, :3, :3].reshape(len(q), 9)
        return np.concatenate([X_WT[:, :3, 3], self.lever / np.sqrt(2.0) * R], axis=1)

    def towards(self, q: Float[Array, "n nq"], goal: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Move the tool straight towards its pose in the goal."""
        X_WT, jacobian = tool_jacobian(self.kernels, q)
        twist = missing_twist(X_WT, self.kernels.tool_pose(goal))
        size = np.maximum(np.linalg.norm(twist[:, :3], axis=1), self.lever * np.linalg.norm(twist[:, 3:], axis=1))
        twist *= np.minimum(1.0, self.step / np.maximum(size, 1e-12))[:, None]
        moved, _ = steps_inside(twist, jacobian, q, (self.lower, self.upper), _DRIFT * (goal - q))
        longest = np.abs(moved).max(axis=1, keepdims=True)
        moved *= np.minimum(1.0, _LONGEST / np.maximum(longest, 1e-12))
        return np.clip(q + moved, self.lower, self.upper)


@final
@dataclass(frozen=True, eq=False)
class _JointSpace:
    """Joint space, for a problem without a tool."""

    step: float

    def places(self, q: Float[Array, "n nq"]) -> Float[Array, "n place"]:
        """Return the configurations themselves."""
        return q

    def towards(self, q: Float[Array, "n nq"], goal: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Step straight towards the goal."""
        gap = goal - q
        return q + gap * np.minimum(1.0, self.step / np.maximum(np.linalg.norm(gap, axis=1, keepdims=True), 1e-12))


@final
class _SpaceTree:
    """A tree of configurations with the distances of a space."""

    def __init__(self, roots: Float[Array, "root nq"], space: _Space) -> None:
        self.space = space
        self.nodes = Tree(roots, np.zeros(len(roots)))
        self._places = space.places(roots)

    def grow(self, samples: Float[Array, "n nq"], steps: int, questions: InterruptibleProblem) -> Int[Array, " m"]:
        """Step from the nearest nodes towards samples while steps are free; return the last new node of each sample."""
        gaps = ((self._places[None] - self.space.places(samples)[:, None]) ** 2).sum(axis=2)
        near = gaps.argmin(axis=1)
        q = [self.nodes.q[near]]
        for _ in range(steps):
            q.append(self.space.towards(q[-1], samples))
        went = np.stack(q, axis=1)
        n, _, nq = went.shape
        first, last = went[:, :-1].reshape(-1, nq), went[:, 1:].reshape(-1, nq)
        far = np.linalg.norm(last - first, axis=1) > 1e-6
        far[far] = questions.edges_free(first[far], last[far])
        reached = np.cumprod(far.reshape(n, steps), axis=1).sum(axis=1)
        return np.array([self._added(went[i, 1 : 1 + k], int(near[i])) for i, k in enumerate(reached) if k], dtype=int)

    def _added(self, q: Float[Array, "step nq"], parent: int) -> int:
        for one in q:
            parent = self.nodes.add(one, 0.0, parent)
        self._places = np.concatenate([self._places, self.space.places(q)])
        return parent


def _meeting(
    growing: _SpaceTree, new: Int[Array, " n"], other: _SpaceTree, questions: InterruptibleProblem
) -> tuple[int, int] | None:
    """Return a new node and a node of the other tree with a free straight edge between them; None if there are none."""
    if not len(new):
        return None
    gaps = np.linalg.norm(growing.nodes.q[new][:, None] - other.nodes.q[None], axis=2)
    near = gaps.argmin(axis=1)
    free = questions.edges_free(growing.nodes.q[new], other.nodes.q[near])
    if not free.any():
        return None
    best = int(np.where(free, gaps.min(axis=1), np.inf).argmin())
    return int(new[best]), int(near[best])

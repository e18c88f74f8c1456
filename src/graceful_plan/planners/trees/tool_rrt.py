"""Two trees that grow in the space of the tool's poses, and meet in that of the joints.

A sample is a pose of the tool, not a configuration: nodes near to it are near in the room, and an arm goes towards it
straight, by differential inverse kinematics (damped least squares, in batches on the native kinematics; mink's
quadratic programs do the same one configuration at a time). Joints that a pose leaves free drift towards those of the
configuration that the sample is the pose of, so that no posture is out of reach. Poses are where nothing is known of
the arm's own branches, so trees are joined by straight edges between configurations.

References:
    A. Shkolnik, R. Tedrake, "Path planning in 1000+ dimensions using a task-space Voronoi bias", ICRA 2009. Differs in:
    two trees, steps to the pose as far as they are free, edges between the trees in joint space.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Protocol, final, runtime_checkable

import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.core.kernels import Kernels
from graceful_plan.core.tool_motion import missing_twist, steps_inside, tool_jacobian
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.questions import Questions
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.settings import count, positive
from graceful_plan.planners.shortcut import Shortcut, first_and_shorter
from graceful_plan.planners.trees.tree import Tree
from graceful_plan.planners.trivial import stays_at_goal

Array = np.ndarray

_AT_ONCE = 8
"""Samples whose turns are taken together, each question being about all of them."""
_DRIFT = 0.1
"""Of the way to the configuration of its sample that a joint drifts in a step, as far as it is free to."""
_LONGEST = 0.2
"""Step of a joint [rad or m]."""
_JOINT_STEP = 0.02
"""Of a problem without a tool: a step, as a share of the extent."""


@final
@dataclass(frozen=True, kw_only=True)
class ToolRRT(Planner):
    """A pair of trees that grow by straight motions of the tool. Stops at the first path, after shortcutting it.

    It pays no heed to the cost. One iteration is eight samples, or one round of shortcutting. A problem without a tool,
    one that is not a scene's, is searched in its own coordinates.

    Args:
        step: Of the tool in one step [m].
        lever: What a turn of the tool counts [m/rad]; a step turns it by at most `step / lever`.
        steps: Towards a sample at most.
        max_nodes: The trees are dropped and grown anew when they hold more nodes.
        shortcut: Cost-aware shortcuts of the path found; None yields it as it is.
    """

    name: ClassVar[str] = "tool_rrt"
    anytime: ClassVar[bool] = False

    step: float = 0.05
    lever: float = 0.2
    steps: int = 6
    max_nodes: int = 10_000
    shortcut: Shortcut | None = Shortcut()

    def __post_init__(self) -> None:
        positive("step", self.step)
        positive("lever", self.lever)
        count("steps", self.steps)
        count("max_nodes", self.max_nodes, 10)

    @stays_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path, then shorter cuts of it."""
        return first_and_shorter(self._connect, self.shortcut, Questions(problem, objective, budget), rng)

    def _connect(self, questions: Questions, rng: np.random.Generator) -> Path | None:
        """Grow both trees in turns until an edge between them is free.

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
    """Where trees grow: how far apart configurations are there, and how one goes from one towards others."""

    def places(self, q: Float[Array, "n nq"]) -> Float[Array, "n place"]:
        """Return what distances are measured between."""
        ...

    def towards(self, q: Float[Array, "n nq"], goal: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Make a step from configurations towards the places of others; none where it cannot go on."""
        ...


@final
@dataclass(frozen=True, eq=False)
class _ToolSpace:
    """Poses of the tool."""

    kernels: Kernels
    lower: Float[Array, " nq"]
    upper: Float[Array, " nq"]
    step: float
    lever: float

    def places(self, q: Float[Array, "n nq"]) -> Float[Array, "n place"]:
        """Return position and, scaled so that small turns count by the lever, rotation matrix."""
        X_WT = self.kernels.tool_pose(q)
        R = X_WT[:, :3, :3].reshape(len(q), 9)
        return np.concatenate([X_WT[:, :3, 3], self.lever / np.sqrt(2.0) * R], axis=1)

    def towards(self, q: Float[Array, "n nq"], goal: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Move the tool straight towards the pose that it has in the goal."""
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
    """The coordinates of a problem without a tool."""

    step: float

    def places(self, q: Float[Array, "n nq"]) -> Float[Array, "n place"]:
        """Return the configurations themselves."""
        return q

    def towards(self, q: Float[Array, "n nq"], goal: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Go straight."""
        gap = goal - q
        return q + gap * np.minimum(1.0, self.step / np.maximum(np.linalg.norm(gap, axis=1, keepdims=True), 1e-12))


@final
class _SpaceTree:
    """A tree of configurations whose nearest nodes are those of the nearest places."""

    def __init__(self, roots: Float[Array, "root nq"], space: _Space) -> None:
        self.space = space
        self.nodes = Tree(roots, np.zeros(len(roots)))
        self._places = space.places(roots)

    def grow(self, samples: Float[Array, "n nq"], steps: int, questions: Questions) -> Int[Array, " m"]:
        """Go from the nearest nodes towards samples as far as that is free; return the last nodes of all that went."""
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
    growing: _SpaceTree, new: Int[Array, " n"], other: _SpaceTree, questions: Questions
) -> tuple[int, int] | None:
    """Return a node of each tree between which the straight edge is free, from the new ones to the nearest."""
    if not len(new):
        return None
    gaps = np.linalg.norm(growing.nodes.q[new][:, None] - other.nodes.q[None], axis=2)
    near = gaps.argmin(axis=1)
    free = questions.edges_free(growing.nodes.q[new], other.nodes.q[near])
    if not free.any():
        return None
    best = int(np.where(free, gaps.min(axis=1), np.inf).argmin())
    return int(new[best]), int(near[best])

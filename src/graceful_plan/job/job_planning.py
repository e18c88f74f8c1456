"""plan_job(): sample the choices, search over sequences of actions, improve the motions of the best one."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError
from graceful_plan.job.actions import Action, Clear, Clearing, CloseLid, Closing, Hauling, Load, Loading, Transport
from graceful_plan.job.bounds import sequence_bound
from graceful_plan.job.close_passages import close_passages
from graceful_plan.job.job_result import JobResult, JobStatus, Step
from graceful_plan.job.job_state import JobState, PoseKey, pose_key, pose_of
from graceful_plan.job.jobs import Job, Where
from graceful_plan.job.motions import JobMotion, Motions, added
from graceful_plan.job.opening import opened_for
from graceful_plan.job.placing import lid_pose, placements, support_of, touched
from graceful_plan.job.reasons import conflict, reasons, unreachable
from graceful_plan.job.rejected import ChosenSequence, Rejected
from graceful_plan.job.search import Node, SequenceSearch, deeds_cost
from graceful_plan.planners.planner import Budget
from graceful_plan.query.arguments import (
    checked_cancelled,
    checked_objective,
    checked_seed,
    checked_speed,
    checked_time_limit,
)
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.goals import start_configuration
from graceful_plan.result import CostBreakdown, TracePoint
from graceful_plan.scene.roles import rigid_pose
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_GRASPS = 4
"""Default number of grasps of each object to choose from."""
_SEARCHED, _BOUNDED = 0.65, 0.75
"""Shares of the time limit at which the search ends, and the lower bound is found; then motions are improved."""
_LOOKED = 4
"""Number of actions that the lower bound looks at for each planned one, if there is no time limit."""
_IMPROVING = 12
"""Iterations with which each planned motion of the best sequence is improved, if there is no time limit."""
_CONTENDERS, _CONTENDERS_COST = 3, 1.5
"""Largest number of sequences whose motions are improved, and of their cost relative to that of the best."""
_SLOTS = 16
"""Placements on a tray from which that of each object is chosen."""
_TOO_SHORT = 0.05
"""Time below which nothing is improved [s]."""
DEFAULT_TIME_LIMIT = 20.0
"""Time limit of `plan_job` without a time limit and without a number of iterations [s]."""


def plan_job(
    job: Job,
    w: float | None = None,
    *,
    start: Configuration | None = None,
    objective: Objective | None = None,
    grasps: int = _GRASPS,
    time_limit: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
    speed: float = 1.0,
    cancelled: Callable[[], bool] | None = None,
) -> JobResult:
    """Plan a whole task so that a failure at any moment of it does little harm.

    The cost of a sequence is the sum of the costs of its motions, each in the state of the world in which it is made:
    an object that was put down can be harmed by later motions, and a closed vessel spills nothing.

    Args:
        job: The job.
        w: Safety weight, as in `plan`.
        start: Configuration at the start; the keyframe "ready", else the middle of the joint ranges, by default.
        objective: Objective of all motions, as in `plan`.
        grasps: Number of grasps of each object to choose from; more are drawn if all of them are refused.
        time_limit: Time limit [s]; 20 by default, unlimited if `iterations` is given.
        iterations: Number of actions to plan. Without a time limit, the result then depends only on the seed.
        seed: Seed of all random numbers.
        speed: Fraction of the velocity limits to use, as in `plan`.
        cancelled: As in `plan`.

    Returns:
        The result; SOLVED only if all motions passed the independent judge and all goals are met. It is the cheapest
        sequence over the grasps, placements and motions found, if `exhaustive`.

    Raises:
        GracefulPlanError: For misuse.
    """
    if not isinstance(job, Job):
        raise SettingError("job", job, "a Job")
    if not job.goals:
        raise SettingError("job", job, "a job with a goal: place()")
    checked_seed(seed)
    limit = DEFAULT_TIME_LIMIT if time_limit is None and iterations is None else time_limit
    session = JobSession(
        job, checked_objective(objective, w), grasps=grasps, seed=seed, speed=checked_speed(speed), start=start
    )
    return session.answer(limit, iterations, cancelled, ())


@dataclass(frozen=True, kw_only=True, eq=False)
class _Choices:
    """The transports to goals and all actions, with sampled placements, and the motions planned so far."""

    goals: list[Transport]
    actions: tuple[Action, ...]
    motions: Motions


@dataclass(frozen=True, kw_only=True, eq=False)
class _Improved:
    """A complete sequence with improved motions."""

    node: Node
    steps: tuple[Step, ...]
    cost: CostBreakdown


@final
class JobSession:
    """The choices of a job, sampled once, with all planned motions."""

    def __init__(
        self,
        job: Job,
        objective: Objective,
        *,
        grasps: int,
        seed: int = 0,
        speed: float = 1.0,
        start: Configuration | None = None,
    ) -> None:
        self._job, self._objective, self._n, self._seed, self._speed = job, objective, grasps, seed, speed
        q = start_configuration(_default_start(job.scene) if start is None else start, job.scene)
        self._state = JobState(world=job.scene, q=q)

    def answer(
        self,
        limit: float | None,
        iterations: int | None,
        cancelled: Callable[[], bool] | None,
        order: tuple[str, ...],
    ) -> JobResult:
        """Search and improve; see `plan_job`."""
        budget = Budget(
            checked_time_limit(limit, iterations), iterations, checked_cancelled(cancelled), time.perf_counter()
        )
        for name in order:
            if name not in self._job.goals:
                raise UnknownNameError("goal of the job", name, self._job.goals)
        before = dict(self._choices.motions.seconds) if "_choices" in vars(self) else {}
        search = self.search(order)
        motions = search.motions
        limited = np.isfinite(budget.time_limit)
        motions.limited, motions.cancelled = limited and iterations is None, budget.cancelled
        motions.left = lambda: budget.time_limit - budget.elapsed
        trace: list[TracePoint] = []

        def improved(node: Node) -> None:
            cost = deeds_cost(node.deeds, self._objective.w)
            trace.append(TracePoint(time=budget.elapsed, total=cost.total, motion=cost.motion, impact=cost.impact))

        def late(share: float) -> bool:
            return budget.elapsed > budget.time_limit * share

        def over(planned: int) -> bool:
            is_late = late(1.0 if search.best is None else _SEARCHED)
            return budget.cancelled() or is_late or (iterations is not None and planned >= iterations)

        if why := conflict(search):
            return JobResult(
                status=JobStatus.INFEASIBLE, detail=why, stats=_stats(search, budget, before), again=self.answer
            )
        search.run(over, improved)
        if search.best is None:
            status = JobStatus.INFEASIBLE if search.exhausted and not search.unsure else JobStatus.TIMEOUT
            if budget.cancelled():
                status = JobStatus.CANCELLED
            return JobResult(
                status=status,
                detail=reasons(search),
                rejected=_rejected(search),
                stats=_stats(search, budget, before),
                again=self.answer,
            )
        bound = sequence_bound(
            search,
            lambda looked: (
                budget.cancelled() or late(_BOUNDED) or (iterations is not None and looked >= _LOOKED * iterations)
            ),
        )
        chosen, *others = self._improved(search, budget, iterations)
        cost = chosen.cost
        trace.append(TracePoint(time=budget.elapsed, total=cost.total, motion=cost.motion, impact=cost.impact))
        return JobResult(
            status=JobStatus.SOLVED,
            steps=chosen.steps,
            detail=close_passages(chosen.steps),
            cost=cost,
            lower_bound=min(cost.total, bound),
            exhaustive=search.exhausted and not search.unsure,
            trace=tuple(trace),
            rejected=_rejected(search, chosen, others),
            stats=_stats(search, budget, before),
            again=self.answer,
        )

    def search(self, order: tuple[str, ...] = ()) -> SequenceSearch:
        """Return a new search that shares choices and motions with earlier ones."""
        choices = self._choices
        return SequenceSearch(self._state, choices.goals, choices.actions, choices.motions, order)

    @cached_property
    def _choices(self) -> _Choices:
        """Sampled when they are first used, within the time limit."""
        job, scene = self._job, self._job.scene
        movable = {*job.goals}
        for action in job.allowed:
            movable |= {action.name} if isinstance(action, Clear | Load) else set()
            movable |= {action.lid, action.vessel} if isinstance(action, CloseLid) else set()
            movable |= set(action.moves) if isinstance(action, Action) else set()
        names = tuple(sorted(movable))
        empty = self._state.parked(names)
        # Neighbours as well: as they are known, they may overlap a bit.
        supports = {name: touched(scene, name) for name in names}
        slots = {action.name: self._slots(action.name) for action in job.allowed if isinstance(action, Load)}
        goals = []
        for name, goal in job.goals.items():
            if goal.on in slots:
                slot = slots[goal.on].get(name)
                supports[name] |= {goal.on}
                goals.append(Transport(name, () if slot is None else (slot,), onto=goal.on))
                continue
            if goal.on is not None and (opened := opened_for(goal.on, job.allowed, self._state)) is not None:
                X_BW = np.linalg.inv(opened.pose(goal.on))
                found = placements(
                    opened.scene(), name, on=goal.on, in_region=goal.in_region, n=goal.n, seed=self._seed
                )
                supports[name] |= {goal.on}
                goals.append(Transport(name, tuple(pose_key(X_BW @ X) for X in found), onto=goal.on))
                continue
            to = self._places(name, goal, empty)
            supports[name] |= self._under(name, to)
            goals.append(Transport(name, to, slots=slots.get(name, {})))
        actions: list[Action] = list(goals)
        for action in job.allowed:
            if isinstance(action, Load):
                start = pose_key(self._state.pose(action.name))
                for name, slot in slots[action.name].items():
                    supports[name] |= {action.name}
                    if job.goals[name].on != action.name:
                        actions.append(Loading(name, action.name, slot, start, goals))
                if action.name not in job.goals:
                    where = Where(on=action.on, in_region=action.in_region, n=action.n)
                    to = self._places(action.name, where, empty)
                    supports[action.name] |= self._under(action.name, to)
                    actions.append(Hauling(action.name, to, slots[action.name], start))
            elif isinstance(action, Clear):
                on = action.on or (support_of(scene, action.name) if action.in_region is None else None)
                where = Where(on=on, in_region=action.in_region, n=action.n)
                to = self._places(action.name, where, empty)
                supports[action.name] |= self._under(action.name, to)
                actions.append(Clearing(action.name, to, goals))
            elif isinstance(action, CloseLid):
                X_VL = (
                    lid_pose(scene, action.vessel, action.lid)
                    if action.X_VL is None
                    else rigid_pose("X_VL", action.X_VL)
                )
                supports[action.lid] |= {action.vessel}
                actions.append(Closing(action.lid, action.vessel, X_VL))
            elif isinstance(action, Action):
                actions.append(action)
        motions = Motions(
            objective=self._objective,
            movable=names,
            supports={name: tuple(sorted(bodies)) for name, bodies in supports.items()},
            given=job.own_grasps,
            n_grasps=self._n,
            q_home=self._state.q,
            seed=self._seed,
            speed=self._speed,
        )
        return _Choices(goals=goals, actions=tuple(actions), motions=motions)

    def _slots(self, tray: str) -> dict[str, PoseKey]:
        """Return a pose of each goal object on a tray, relative to it, far from the middle and from each other."""
        job, state, found = self._job, self._state, {}
        X_TW = np.linalg.inv(state.pose(tray))
        taken = [state.pose(tray)[:3, 3]]
        for name, goal in job.goals.items():
            note = job.scene.notes.objects.get(name)
            has_contents = note is not None and note.contents is not None
            if name == tray or has_contents:
                if has_contents and goal.on == tray:
                    raise UnsupportedError(f"{name!r} has contents, whose spill from the tray {tray!r} is not modelled")
                continue
            choices = placements(state.scene(), name, on=tray, n=_SLOTS, seed=self._seed)
            if len(choices):
                apart = np.linalg.norm(choices[:, None, :2, 3] - np.array(taken)[None, :, :2], axis=-1).min(axis=1)
                X_WO = choices[int(np.argmax(apart))]
                found[name] = pose_key(X_TW @ X_WO)
                taken.append(X_WO[:3, 3])
                state = state.moved(name, X_WO)
        return found

    def _places(self, name: str, where: Where, empty: JobState) -> tuple[PoseKey, ...]:
        if where.at is not None:
            return (pose_key(where.at),)

        def sampled(scene: Scene) -> Float[Array, "placement 4 4"]:
            return placements(scene, name, on=where.on, in_region=where.in_region, n=where.n, seed=self._seed)

        found = sampled(self._job.scene)
        if len(found) < where.n:
            # Where other things stand now, there may be space once they are moved.
            others = empty.moved(name, self._state.pose(name)).scene()
            found = np.concatenate([found, sampled(others)])[: where.n]
        return tuple(pose_key(X) for X in found)

    def _under(self, name: str, to: Sequence[PoseKey]) -> set[str]:
        under = {support_of(self._state.moved(name, pose_of(X)).scene(), name) for X in to}
        return {body for body in under if body is not None}

    def _improved(self, search: SequenceSearch, budget: Budget, iterations: int | None) -> list[_Improved]:
        """Improve the motions of the best sequences in the time that is left; return them, the cheapest first.

        The search compares first motions; of sequences that are nearly as good, another one may be the best at the
        end.
        """
        assert search.best is not None
        most = _CONTENDERS_COST * search.best.cost
        contenders = sorted((node for node in search.complete if node.cost <= most), key=lambda node: node.cost)
        found = []
        for k, node in enumerate(contenders[:_CONTENDERS]):
            share = (budget.time_limit - budget.elapsed) / (min(len(contenders), _CONTENDERS) - k)
            steps = self._better(node, budget, budget.elapsed + share, iterations)
            cost = added([step.cost for step in steps], self._objective.w)
            found.append(_Improved(node=node, steps=steps, cost=cost))
        return sorted(found, key=lambda one: one.cost.total)

    def _better(self, node: Node, budget: Budget, end: float, iterations: int | None) -> tuple[Step, ...]:
        """Plan the motions of a sequence again, the costliest first, until a time of the budget's clock [s]."""
        flat = [(kind, name, list(motions)) for deed in node.deeds for kind, name, motions in deed.steps]
        free = [(motions, k) for _, _, motions in flat for k, motion in enumerate(motions) if self._is_open(motion)]
        free.sort(key=lambda at: -at[0][at[1]].cost.total)
        for done, (motions, k) in enumerate(free):
            left = end - budget.elapsed
            if budget.cancelled() or left < _TOO_SHORT:
                break
            seconds = left / (len(free) - done)
            motions[k] = self._choices.motions.better(motions[k], seconds, None if iterations is None else _IMPROVING)
        worlds = [self._state, *(deed.state for deed in node.deeds)]
        states = [before for before, deed in zip(worlds, node.deeds, strict=False) for _ in deed.steps]
        clock, steps = self._state.clock, []
        for (kind, name, motions), before in zip(flat, states, strict=True):
            # Improved motions take longer or shorter, so that moving entities are elsewhere in those that follow.
            pieces = self._choices.motions.in_time(replace(before, clock=clock), motions)
            clock += sum(piece.trajectory.duration for piece in pieces)
            cost = added([piece.cost for piece in pieces], self._objective.w)
            steps.append(Step(kind=kind, name=name, pieces=tuple(pieces), cost=cost))
        return tuple(steps)

    def _is_open(self, piece: JobMotion) -> bool:
        """Tell whether a motion may be better by another route: it is planned and no straight one without harm."""
        q = piece.trajectory.q
        return piece.label in ("transit", "carry") and piece.cost.total > 1.001 * float(np.linalg.norm(q[-1] - q[0]))


def _stats(search: SequenceSearch, budget: Budget, before: Mapping[str, float]) -> dict[str, float]:
    """Return the time spent on each part [s], without that of earlier calls, and the number of planned actions."""
    parts = {part: seconds - before.get(part, 0.0) for part, seconds in search.motions.seconds.items()}
    total = budget.elapsed
    rest = total - sum(parts.values())
    return {**parts, "search": rest, "total_time": total, "actions": float(search.planned)}


def _rejected(
    search: SequenceSearch, chosen: _Improved | None = None, others: Sequence[_Improved] = ()
) -> tuple[Rejected, ...]:
    """Return the alternatives to the chosen sequence, last the goals that no first action meets."""
    left = ((edge.actions, bound) for edge, bound in search.open_edges())
    if chosen is None or search.best is None:
        return (*search.record.rejected(left, None, {}), *unreachable(search))
    first = deeds_cost(chosen.node.deeds, search.motions.objective.w)
    result = ChosenSequence(actions=chosen.node.actions, cost=chosen.cost, first=first, best=search.best.cost)
    improved = {other.node.actions: other.cost for other in reversed(others)}
    return (*search.record.rejected(left, result, improved), *unreachable(search))


def _default_start(scene: Scene) -> Configuration:
    return "ready" if "ready" in scene.keyframes else scene.limits.position.mean(axis=1)

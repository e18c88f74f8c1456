"""Starts of robots that move: motions leave along the present velocity.

The path begins with a straight lead-in along the velocity, long enough to stop in it, and the search starts at its end.
Timing begins with the present speed, so a motion along that path may stop there at worst. Descents keep only the
direction of the lead-in; their curves turn away as early as the limits allow. Where a straight lead-in is blocked, it
is the path of another stop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import RetimingError, SettingError, UnsupportedError
from graceful_plan.judge.verification import verify
from graceful_plan.path import Path, finite_array
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.escape import TARGET_CLEARANCE
from graceful_plan.query.endpoints.goals import start_configuration
from graceful_plan.query.endpoints.lead_in import LeadIn, Takeover
from graceful_plan.query.endpoints.real_start import RealStart, real_start, without_turns
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import REST, State, Trajectory

Array = np.ndarray

_SHORTEST = 1e-3
"""Least length of a lead-in [rad]: timing merges vertices that are closer than 1e-5."""
_LONGER = (1.0001, 1.05, 1.6, 3.0, 6.0, 12.0)
"""Lengths of lead-ins to try, relative to the braking distance within the limits of the joints; without a carried
object whose specific force is limited, only the first two."""
_SAMPLES = 9
"""Configurations of a lead-in that the fast checker checks, and vertices of one that is not straight."""
_STUB = 0.25
"""Length of the straight beginning of a lead-in that is not straight, relative to the distance of its vertices."""
_EXCESS = 1e-7
"""Largest relative excess of a start velocity over its limit that is clipped instead of refused."""
_ROUNDING = 1e-9
"""Relative reserve of a start velocity below its limit."""


def find_start(
    start: Configuration | State,
    constraints: SceneConstraints,
    tolerance: float,
    speed: float,
    *,
    late: Callable[[], bool],
    max_wait: float = 0.0,
    stops: bool = False,
) -> tuple[RealStart, LeadIn | None] | PlanResult:
    """Return where to begin planning, and the lead-in if the robot moves; if it cannot stop, return why.

    Args:
        start: Configuration, keyframe, or state; a `Takeover` has the motion that the robot leaves.
        constraints: Constraints and scene.
        tolerance: See `real_start`.
        speed: Fraction of the velocity limits to use.
        late: Whether no time is left; it ends the search for a stop.
        max_wait: Longest wait before the motion [s], which a moving robot cannot do.
        stops: Whether the motion stops before it goes on, without a lead-in.

    Raises:
        GracefulPlanError: For wrong shapes, NaN and unknown names, for a moving robot with a base, and for a moving
            robot that shall wait.
    """
    scene = constraints.scene
    takeover = start if isinstance(start, Takeover) else None
    if not isinstance(start, State):
        return real_start(start_configuration(start, scene), constraints, tolerance, speed), None
    q, velocity = _checked(start, scene)
    if np.abs(velocity).max() <= REST:
        real = real_start(q, constraints, tolerance, speed)
        return replace(real, takeover=None if takeover is None else takeover.without_turns(real.turns)), None
    if scene.base is not None:
        raise UnsupportedError("a moving start does not support mobile bases; stop first, then plan from rest")
    if max_wait:
        raise SettingError("max_wait", max_wait, "0 for a robot that moves: it cannot wait")
    excess = np.abs(velocity) / (speed * scene.limits.velocity)
    if excess.max() > 1.0 + _EXCESS:
        return PlanResult(status=PlanStatus.INVALID_START, detail=_too_fast(velocity, excess, speed, scene))
    velocity = velocity / np.maximum(excess * (1.0 + _ROUNDING), 1.0)
    q, turns = without_turns(q, scene)
    takeover = None if takeover is None else takeover.without_turns(turns)
    return _stoppable(State(q, velocity), turns, constraints, speed, takeover, late=late, stops=stops)


def _checked(state: State, scene: Scene) -> tuple[Array, Array]:
    nq = len(scene.joints)
    q = finite_array("start.q", state.q, ndim=1, last=nq)
    return q, finite_array("start.qd", state.qd, ndim=1, last=nq)


def _stoppable(
    state: State,
    turns: Float[Array, " nq"],
    constraints: SceneConstraints,
    speed: float,
    takeover: Takeover | None,
    *,
    late: Callable[[], bool],
    stops: bool,
) -> tuple[RealStart, LeadIn | None] | PlanResult:
    """Return the lead-in by the first stop that the judge passes, or with `stops` that stop; else why there is none."""
    scene = constraints.scene
    held = constraints.around(state.q[None])
    before = None if takeover is None else takeover.before
    why = ""
    for stop, is_straight in _stops(state, held, speed, takeover, late):
        if late():
            return PlanResult(status=PlanStatus.TIMEOUT, detail="start: the robot moves, and no stop was found in time")
        verdict = verify(
            stop,
            scene,
            start=state,
            constraints=held.constraints,
            clearance=compile_scene(scene).proof.clearance,
            before=before,
        )
        if not verdict.passed:
            problems = "; ".join(f"{name}: {verdict.checks[name].detail}" for name in verdict.failures)
            why = why or f"the straight stop takes {stop.duration:.3g} s; {problems}"
            continue
        if not stops:
            path = Path(stop.at(np.linspace(stop.t[0], stop.t[-1], _SAMPLES)).q).without_duplicates()
            is_clear = bool((held.clearance(path.q) >= TARGET_CLEARANCE).all())
            path = Path(path.q[[0, -1]]) if is_straight else _tangent(path, state.qd)
            return RealStart(stop.q[-1], turns, takeover=takeover), LeadIn(state.qd, path, is_clear, stop)
        return RealStart(stop.q[-1], turns, stop, note="it stops first", takeover=takeover), None
    return PlanResult(status=PlanStatus.INVALID_START, detail=f"start: the robot moves and cannot stop; {why}")


def _tangent(path: Path, velocity: Float[Array, " nq"]) -> Path:
    """Return a path that leaves exactly along a velocity, apart from that the same."""
    step = _STUB * float(path.segment_lengths[0]) / np.linalg.norm(velocity)
    return Path(np.insert(path.q, 1, path.q[0] + step * velocity, axis=0))


def _stops(
    state: State, held: SceneConstraints, speed: float, takeover: Takeover | None, late: Callable[[], bool]
) -> Iterator[tuple[Trajectory, bool]]:
    """Yield stops to try: straight ones, one along the former motion, and one in which every joint brakes by itself.

    Each comes with whether it is straight. Once it is late, no more stops are timed.
    """
    yield from ((straight, True) for straight in _straight(state, held, speed, late))
    if takeover is not None and not late() and (along := takeover.stop()) is not None:
        yield along, False
    yield _each_joint(state, held.scene, speed), False


def _straight(state: State, held: SceneConstraints, speed: float, late: Callable[[], bool]) -> Iterator[Trajectory]:
    """Yield straight stops from the shortest one on; with contents, longer ones are gentler."""
    size = float(np.linalg.norm(state.qd))
    seconds = float((np.abs(state.qd) / (speed**2 * held.scene.limits.acceleration)).max())
    for longer in _LONGER if held.felt else _LONGER[:2]:
        if late():
            return
        length = max(_SHORTEST, longer * 0.5 * size * seconds)
        line = Path(np.stack([state.q, state.q + length / size * state.qd]))
        try:
            yield held.retimed(line, deviation=0.0, speed=speed, start_speed=size)
        except RetimingError:
            continue


def _each_joint(state: State, scene: Scene, speed: float) -> Trajectory:
    """Return the stop in which each joint brakes as hard as it may, so that each one stops as early as it can."""
    most = speed**2 * scene.limits.acceleration * (1.0 - _ROUNDING)
    braking, seconds = -np.sign(state.qd) * most, np.abs(state.qd) / most
    t = np.unique(np.append(0.0, seconds[seconds > 0.0]))
    t = t[np.append(True, np.diff(t) > 1e-6)]
    past = np.minimum(t[:, None], seconds)
    qd = state.qd + braking * past
    qd[t[:, None] >= seconds - 1e-6] = 0.0
    qdd = np.where(t[:, None] < seconds - 1e-6, braking, 0.0)
    return Trajectory(t, state.q + past * (state.qd + 0.5 * braking * past), qd, qdd, scene.joints)


def _too_fast(velocity: Float[Array, " nq"], excess: Float[Array, " nq"], speed: float, scene: Scene) -> str:
    worst = int(excess.argmax())
    share = "" if speed == 1.0 else f"{speed:g} of "
    limit = f"{share}its limit {scene.limits.velocity[worst]:.9g}"
    return f"start: joint {scene.joints[worst]!r} moves at {velocity[worst]:.9g} rad/s or m/s, above {limit}"

"""Stops of a robot that moves, and the paths along them.

A straight stop follows the present velocity. With limits on the specific force of a carried object, longer straight
stops are gentler. Where a straight one is blocked, the robot may follow its former motion, or brake each joint by
itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.query.endpoints.escape import TARGET_CLEARANCE
from graceful_plan.query.endpoints.lead_in import Takeover
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.topp import EndSpeeds
from graceful_plan.timing.trajectory import State, Trajectory

_SHORTEST = 1e-3
"""Least length of a straight stop [rad]: timing merges vertices that are closer than 1e-5."""
_LONGER = (1.0001, 1.05, 1.6, 3.0, 6.0, 12.0)
"""Lengths of straight stops to try, relative to the braking distance within the limits of the joints; without a carried
object whose specific force is limited, only the first two."""
_SAMPLES = 9
"""Configurations of a stop that the fast checker checks, and vertices of one that is not straight."""
_STUB = 0.25
"""Length of the straight beginning of a stop that is not straight, relative to the distance of its vertices."""
_EXCESS = 1e-7
"""Largest relative excess of a velocity over its limit that is clipped instead of refused."""
_ROUNDING = 1e-9
"""Relative reserve of a velocity below its limit."""


def share_of_limits(velocity: Float[Array, " nq"], speed: float, scene: Scene) -> Float[Array, " nq"]:
    """Return the speeds of the joints relative to a fraction `speed` of their limits."""
    return np.abs(velocity) / (speed * scene.limits.velocity)


def within_limits(velocity: Float[Array, " nq"], speed: float, scene: Scene) -> Float[Array, " nq"] | None:
    """Return a velocity, clipped where it exceeds a fraction `speed` of a limit by rounding; None if it exceeds it."""
    excess = share_of_limits(velocity, speed, scene)
    return None if excess.max() > 1.0 + _EXCESS else velocity / np.maximum(excess * (1.0 + _ROUNDING), 1.0)


def too_fast(word: str, velocity: Float[Array, " nq"], speed: float, scene: Scene) -> str:
    """Return a message that names the joint whose speed exceeds a fraction `speed` of its limit the most."""
    worst = int(share_of_limits(velocity, speed, scene).argmax())
    share = "" if speed == 1.0 else f"{speed:g} of "
    limit = f"{share}its limit {scene.limits.velocity[worst]:.9g}"
    return f"{word}: joint {scene.joints[worst]!r} moves at {velocity[worst]:.9g} rad/s or m/s, above {limit}"


def stops_from(
    state: State, held: SceneConstraints, speed: float, late: Callable[[], bool], takeover: Takeover | None = None
) -> Iterator[tuple[Trajectory, bool]]:
    """Yield stops to try: straight ones, one along the former motion, and one in which every joint brakes by itself.

    Each comes with whether it is straight. Once it is late, no more stops are timed.

    Args:
        state: Position and velocity.
        held: Constraints and scene.
        speed: Fraction of the velocity limits to use.
        late: Whether no time is left.
        takeover: The motion that the robot leaves; None if it is not known.
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
            yield held.retimed(line, deviation=0.0, speed=speed, ends=EndSpeeds(start=size))
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


def path_along(
    stop: Trajectory, velocity: Float[Array, " nq"], held: SceneConstraints, *, is_straight: bool
) -> tuple[Path, bool]:
    """Return the path of a stop from a velocity, and whether the fast checker finds it free."""
    path = Path(stop.at(np.linspace(stop.t[0], stop.t[-1], _SAMPLES)).q).without_duplicates()
    is_clear = bool((held.clearance(path.q) >= TARGET_CLEARANCE).all())
    return (Path(path.q[[0, -1]]) if is_straight else _tangent(path, velocity)), is_clear


def _tangent(path: Path, velocity: Float[Array, " nq"]) -> Path:
    """Return a path that leaves exactly along a velocity, apart from that the same."""
    step = _STUB * float(path.segment_lengths[0]) / np.linalg.norm(velocity)
    return Path(np.insert(path.q, 1, path.q[0] + step * velocity, axis=0))

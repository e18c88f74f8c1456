"""Pouring from one vessel into another, so that less is spilled by what follows.

The vessel is carried over the opening of the receiver, tilted about the point of its rim that is over the middle of
the opening until only the wanted fill stays in (`Vessel.brim_tilt`), turned back, and put down where it stood. While it
is tilted, its contents are taken to be over the receiver: they count neither as harm nor in simulations.

Frames: W world, B body of the vessel, R centre of its rim.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.job.actions import Action, Deed
from graceful_plan.job.grasping import Grasp
from graceful_plan.job.job_state import JobState, pose_key
from graceful_plan.job.motions import JobMotion, Motions, Refusal, Stance, reversed_motion
from graceful_plan.job.tool_paths import JointPath, along_joint
from graceful_plan.path import is_real
from graceful_plan.scene.elements import Contents, Granular, Liquid
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.roles import FROM_ABOVE
from graceful_plan.scene.rules.vessel import Vessel, find_vessel
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_ABOVE = (0.03, 0.08)
"""Heights of the upright vessel above the rim of the receiver [m], the first at which the arm can pour."""
_TURNS = 2.0 * np.pi * np.arange(8) / 8
"""Angles about the vertical axis: of the vessel, and of the direction in which it is tilted [rad]."""
_FLOWING = 1.0
"""Time for which the vessel stays tilted [s]."""
_CALM = 0.3
"""Fraction of the planned speed at which it is tilted, so that its contents do not splash."""
_LITRE = 1e-3
"""A litre [m^3]."""


@final
@dataclass(frozen=True, eq=False)
class Pour(Action):
    """Allow to pour from a vessel into another, once, down to a fill level. For `Job.allow`.

    The vessel is put down again where it stood. The poured contents count as those of the receiver from then on.

    Args:
        name: The vessel: an object with contents.
        into: The receiver: an open vessel with a geom "<into>_contents" for its contents.
        fill: Share of the vessel's capacity that stays in it, at least 0 and less than 1.
    """

    name: str
    into: str
    fill: float = 0.0

    def __post_init__(self) -> None:
        if not (is_real(self.fill) and 0.0 <= self.fill < 1.0):
            raise SettingError("fill", self.fill, "at least 0 and less than 1")
        if self.name == self.into:
            raise SettingError("into", self.into, f"another vessel than {self.name!r}")

    @property
    def moves(self) -> tuple[str, ...]:
        """The vessel."""
        return (self.name,)

    def check(self, scene: Scene) -> None:
        """Raise an error if the vessel has no contents, or the receiver cannot hold them."""
        contents = _contents(scene, self.name)
        if contents is None:
            raise SettingError("name", self.name, "an object with contents")
        _vessel(scene, self.name, contents)
        _vessel(scene, self.into, contents)
        inside = _contents(scene, self.into)
        if inside is not None and type(inside) is not type(contents):
            raise SettingError("into", self.into, "a vessel that is empty or has contents of the same kind")

    def candidates(self, state: JobState, motions: Motions) -> Iterator[Hashable]:
        """Yield grasps of the vessel, unless this was done before or no more is in it than shall stay."""
        contents = _contents(state.world, self.name)
        if ("pour", self.name, self.into) in state.facts or contents is None:
            return
        if contents.volume > self._left(state.world, contents):
            here = pose_key(state.pose(self.name))
            yield from motions.grasps(state, self.name, [here])

    def _left(self, world: Scene, contents: Contents) -> float:
        """Return what stays in the vessel [litres]."""
        return self.fill * _capacity(_vessel(world, self.name, contents))

    def motion(self, state: JobState, choice: Hashable, motions: Motions) -> Deed | Refusal:
        """Lift the vessel, pour, and put it down where it stood."""
        assert isinstance(choice, Grasp)
        contents = _contents(state.world, self.name)
        assert contents is not None
        left, inside = self._left(state.world, contents), _contents(state.world, self.into)
        room = _capacity(_vessel(state.world, self.into, contents)) - (0.0 if inside is None else inside.volume)
        if contents.volume - left > room:
            more = f"{contents.volume - left:.3g} litres do not fit into {self.into!r}, only {room:.3g}"
            return Refusal(name=self.name, why=f"pour {self.name!r}: {more}")
        stance = motions.stance(state, self.name, choice, pose_key(state.pose(self.name)))
        if isinstance(stance, Refusal):
            return stance
        rest = None if left == 0.0 else replace(contents, volume=left)
        then = state.with_contents(self.name, rest)
        then = then.with_contents(self.into, _mixed(inside, replace(contents, volume=contents.volume - left)))
        key = ("pour", id(self), id(choice), *state.surroundings)
        poured = motions.once(key, lambda: (self._poured(state, choice, stance, motions), state))[0]
        if isinstance(poured, Refusal):
            return poured
        return self._with_ends(poured, (state, then), choice, stance, motions)

    def _poured(self, state: JobState, grasp: Grasp, stance: Stance, motions: Motions) -> list[JobMotion] | Refusal:
        """Return the motions from upright over the receiver to upright again."""
        empty = state.with_contents(self.name, None)
        held = empty.holding(self.name, grasp, motions.supports.get(self.name, ()))
        refusal = Refusal(
            name=self.name, why=f"the arm cannot pour from {self.name!r} over {self.into!r}: out of reach"
        )
        for path in self._tilts(state, grasp):
            # The tilted end is the harder one to reach, so the path is followed from there, backwards.
            back = JointPath(path.goal.X_WT, path.axis, path.point, -path.amount)
            if not len(motions.reached(PoseGoal(path.X_WT), held, stance.q)):
                continue
            for q in motions.reached(PoseGoal(back.X_WT), held, stance.q, 2):
                upright = along_joint(q, back, held, speed=_CALM * motions.speed, seed=motions.seed)
                if isinstance(upright, str):
                    refusal = Refusal(name=self.name, why=f"pour from {self.name!r}: {upright}")
                    continue
                righted = motions.checked("pour", self.name, held, upright)
                tilted = motions.checked("pour", self.name, held, reversed_motion(upright))
                if isinstance(righted, Refusal) or isinstance(tilted, Refusal):
                    refusal = next(one for one in (righted, tilted) if isinstance(one, Refusal))
                    continue
                return [tilted, motions.still("pour", held, q, _FLOWING), righted]
        return refusal

    def _tilts(self, state: JobState, grasp: Grasp) -> Iterator[JointPath]:
        """Yield paths of the tool that tilt the vessel over the receiver, from all sides."""
        contents = _contents(state.world, self.name)
        assert contents is not None
        vessel, receiver = (_vessel(state.world, name, contents) for name in (self.name, self.into))
        X_WB, X_WI = state.pose(self.name), state.pose(self.into)
        mouth = X_WI[:3, :3] @ receiver.p_BR + X_WI[:3, 3]
        left = self._left(state.world, contents)
        tilt = 0.5 * np.pi + vessel.repose if left == 0.0 else replace(vessel, volume=_LITRE * left).brim_tilt
        for above in _ABOVE:
            lip = mouth + [0.0, 0.0, vessel.height + above]
            for turn in _TURNS:
                R = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
                X = np.eye(4)
                X[:3, :3] = R @ X_WB[:3, :3]
                for way in np.stack([np.cos(_TURNS), np.sin(_TURNS), np.zeros(len(_TURNS))], axis=1):
                    # The point of the rim towards which the vessel is tilted is over the middle of the opening.
                    X[:3, 3] = lip - X[:3, :3] @ vessel.p_BR - vessel.radius * way
                    axis = np.array([-way[1], way[0], 0.0])
                    yield JointPath(grasp.tool_at(X.copy()), axis, lip, tilt)

    def _with_ends(
        self,
        poured: list[JobMotion],
        states: tuple[JobState, JobState],
        grasp: Grasp,
        stance: Stance,
        motions: Motions,
    ) -> Deed | Refusal:
        """Add the motions to the receiver and back, with the contents before and after."""
        (state, then), name = states, self.name
        support, opened = motions.supports.get(name, ()), state.scene(grasp.opening)
        full, light, free = (
            state.holding(name, grasp, support),
            then.holding(name, grasp, support),
            then.scene(grasp.opening),
        )
        over, lifted = poured[0].trajectory.q[0], stance.lift.q[-1]
        before = [
            motions.planned("transit", name, state.scene(), state.q, stance.retreat.q[-1]),
            motions.checked("approach", name, opened, stance.approach),
            motions.still("grip", opened, stance.q),
            motions.checked("lift", name, full, stance.lift),
        ]
        after = [
            motions.planned("carry", name, full, lifted, over),
            *poured,
            motions.planned("carry", name, light, over, lifted),
            motions.checked("lower", name, light, stance.lower),
            motions.still("release", free, stance.q),
            motions.checked("retreat", name, free, stance.retreat),
        ]
        made: list[list[JobMotion]] = [[], []]
        for some, pieces in zip(made, (before, after), strict=True):
            for piece in pieces:
                if isinstance(piece, Refusal):
                    return piece
                some.append(piece)
        seconds = sum(piece.trajectory.duration for some in made for piece in some)
        end = then.after(stance.retreat.q[-1], seconds).knowing("pour", name, self.into)
        return Deed(steps=[("pick", name, made[0]), ("pour", name, made[1])], state=end)


def _contents(world: Scene, name: str) -> Contents | None:
    note = world.notes.objects.get(name)
    return None if note is None else note.contents


def _vessel(world: Scene, name: str, contents: Contents) -> Vessel:
    """Return a vessel with some contents, in the frame of its body."""
    vessel = find_vessel(world.attach(name, X_TO=FROM_ABOVE, contents=contents))
    assert vessel is not None
    return vessel


def _capacity(vessel: Vessel) -> float:
    """Return what fits into an upright vessel [litres]."""
    return float(np.pi * vessel.radius**2 * vessel.height) / _LITRE


def _mixed(inside: Contents | None, more: Contents) -> Contents:
    """Return the contents of a vessel after more of them were added."""
    if inside is None:
        return replace(more, geoms=())
    volume = inside.volume + more.volume
    if isinstance(inside, Granular) or isinstance(more, Granular):
        return replace(inside, volume=volume)
    heat = (inside.volume * inside.temperature + more.volume * more.temperature) / volume
    kind = "oil" if "oil" in (inside.kind, more.kind) else "water"
    return Liquid(volume, heat, kind, inside.geoms)

"""Stops on the way along household motions: planned ones against straight brakes, executed in FailBench."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import failbench
import graceful_plan as gp
from benchmarks import report, suite
from failbench.fault.reaction import ProtectiveStop
from failbench.recording.score import observed_impact

Array = np.ndarray

TITLE = "Stops on the way: contents and grasp, planned against braked"
QUESTION = (
    "Do planned stops keep contents and grasp where a stop of category 1 loses them, and how much longer are they?"
)
HEADLINE = "losses by stops of category 1 that the planned stop avoids"
DEPENDS_ON = (*suite.PLANNING, *suite.SIMULATION)
COUNT = 300
SPEEDS = (1.0, 0.5)
"""Fractions of the velocity limits at which the motions are planned."""
EVERY = 0.1
"""Time between two planned stops [s]."""
STOPS: Mapping[str, ProtectiveStop] = {
    "category 1": ProtectiveStop(),
    "gentle": ProtectiveStop(degree="minor"),
    "planned": ProtectiveStop(prepared=EVERY),
}
LOST = 0.01
"""Lost share of the contents that counts as a spill; FailBench ignores less."""
MEASURED = f"""\
Motions of all bundled household tasks and of one table task a scene, planned at full and at half speed with the default
weight, are stopped at moments drawn by chance. Every stop is executed by FailBench in MuJoCo, with the object held by
friction (by a weld where the fingers lose it on the way), up to the time at which the motion would have ended.
"Category 1" brakes straight along the path at the greatest acceleration of motions, "gentle" at a quarter of it, and
"planned" follows the next stop of `plan_stops(every={EVERY:g})`. "Loses" means: more than {100 * LOST:.0f} % of the
contents, or the object. "Goes on" is the same motion without a stop. Times and ways count from the moment of the stop
to standstill, the way of the tool as planned. "No stop" are moments whose next planned stop keeps the constraints only
by ending with the motion (`PreparedStops.gaps`). Harm is the sum of the severities of all hits, as in `validate`.
"""


@dataclass(frozen=True, kw_only=True)
class Stopped:
    """One kind of stop at one moment."""

    loses: bool
    harm: float
    seconds: float
    """Time to standstill [s]."""
    way: float
    """Way of the tool to standstill [m]."""


@dataclass(frozen=True, kw_only=True)
class Moment:
    """All kinds of stops at one moment of a motion."""

    task: str
    vessel: bool
    """Whether the object has contents that can be spilled."""
    friction: bool
    speed: float
    goes_on_loses: bool
    none: bool
    """Whether there is no planned stop."""
    stops: Mapping[str, Stopped]
    planning: float
    """Time to plan a stop, as a mean along the motion [s]."""


def run(options: suite.Options) -> str:
    """Stop motions at moments drawn by chance."""
    names = suite.task_names(options)
    tables = {name.partition("/")[0]: name for name in names if suite.is_tabletop(name)}
    names = [name for name in names if not suite.is_tabletop(name)] + list(tables.values())
    cases = [(name, speed) for name in names for speed in SPEEDS]
    count = options.pick(COUNT, quick=len(cases))
    jobs = [(*case, count // len(cases) + (k < count % len(cases)), k) for k, case in enumerate(cases)]
    parts = suite.spread(measure, jobs, options.processes, "stops")
    found = sorted((moment for part in parts for moment in part), key=lambda one: (one.task, one.speed))
    return "\n".join(
        [
            MEASURED,
            report.targets(_targets(found)),
            _without(found),
            "### Losses and harm\n",
            report.table(("object", "speed", "n", "goes on", *_each("loses"), *_each("harm")), _harm_rows(found)),
            "### Time and way to standstill, medians\n",
            report.table(
                ("object", "speed", "no stop", *_each("[s]"), "planned: 90 % [s]", *_each("[m]"), "to plan [ms]"),
                _way_rows(found),
            ),
        ]
    )


def measure(job: tuple[str, float, int, int]) -> list[Moment]:
    """Stop one motion at some moments: of a task, at a speed, how many, and the seed."""
    name, speed, count, seed = job
    task = suite.task(name)
    motion = gp.plan(task.start, task.goal, task.scene, speed=speed, iterations=60).unwrap()
    began = time.perf_counter()
    stops = gp.plan_stops(motion, task.scene, every=EVERY)
    planning = (time.perf_counter() - began) / len(stops.stops)
    execution, friction = _execution(motion, task.scene)
    onsets = np.sort(np.random.default_rng(seed).uniform(0.02, 0.98, count)) * motion.duration
    kinds = list(STOPS)
    jobs = [
        failbench.RolloutRequest(fault=STOPS[kind], onset=float(onset), seed=seed)
        for onset in onsets.tolist()
        for kind in kinds
    ]
    horizon = motion.duration - float(onsets[0]) + 0.2
    rollouts = failbench.run_rollouts(execution, jobs, horizon=horizon, threads=1)
    kept = execution.healthy.kept
    found = []
    for k in range(count):
        mine = dict(zip(kinds, rollouts[k * len(kinds) : (k + 1) * len(kinds)], strict=True))
        onset = mine["planned"].onset
        left = None if kept is None else kept[execution.checkpoint(onset) :]
        found.append(
            Moment(
                task=name,
                vessel=kept is not None,
                friction=friction,
                speed=speed,
                goes_on_loses=left is not None and bool(left[-1] < (1.0 - LOST) * left[0]),
                none=_is_in_gap(onset, stops),
                stops={kind: _stopped(kind, rollout, motion, stops, task.scene) for kind, rollout in mine.items()},
                planning=planning,
            )
        )
    return found


def _execution(motion: gp.Trajectory, scene: gp.Scene) -> tuple[failbench.Execution, bool]:
    """Return the healthy run, and whether friction holds the object."""
    try:
        return failbench.execute(motion, failbench.build_world(scene)), True
    except failbench.ExecutionRefused:
        world = failbench.build_world(scene, failbench.SimSettings(grasp="weld"))
        return failbench.execute(motion, world), False


def _is_in_gap(onset: float, stops: gp.PreparedStops) -> bool:
    """Return whether the next moment of the grid lacks a stop."""
    following = np.ceil(onset / EVERY - 1e-9) * EVERY
    return any(first - 1e-6 <= following <= last + 1e-6 for first, last in stops.gaps)


def _stopped(
    kind: str, rollout: failbench.Rollout, motion: gp.Trajectory, stops: gp.PreparedStops, scene: gp.Scene
) -> Stopped:
    onset = rollout.onset
    if kind == "planned":
        taken = stops.after(onset)
        seconds = float(taken.t[-1]) - onset
        path = motion.spliced(taken).at(np.linspace(onset, onset + seconds, 100)).q
    else:
        speed = np.abs(motion.at(onset).qd)
        seconds = float((speed / scene.limits.acceleration).max()) / STOPS[kind].amount
        path = motion.at(np.linspace(onset, min(onset + 0.5 * seconds, motion.duration), 100)).q
    places = scene.pose(path)[:, :3, 3]
    return Stopped(
        loses=rollout.dropped or rollout.spilled > LOST,
        harm=observed_impact(rollout, scene),
        seconds=seconds,
        way=float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()),
    )


# --- targets and tables -----------------------------------------------------------------------------------------------


def _targets(found: Sequence[Moment]) -> Iterator[report.Target]:
    lost = [one for one in found if one.stops["category 1"].loses]
    avoided = sum(not one.stops["planned"].loses for one in lost)
    yield report.all_done(HEADLINE, avoided, len(lost))
    yield report.none_of(
        f"planned stops that lose contents or object, of {len(found)}", sum(one.stops["planned"].loses for one in found)
    )
    quick = [one for one in lost if not one.none]
    more = [_more(one, lambda stop: stop.seconds) for one in quick]
    way = [_more(one, lambda stop: stop.way) for one in quick]
    yield report.Target(
        what=f"longer time to standstill, median of the {len(quick)} of these moments that have a stop",
        wanted="<= 0.5 s",
        measured=f"{np.median(more):.2f} s" if quick else "none",
        met=bool(np.median(more) <= 0.5) if quick else None,
    )
    yield report.Target(
        what="longer way of the tool, median of the same",
        wanted="<= 0.1 m",
        measured=f"{np.median(way):.2f} m" if quick else "none",
        met=bool(np.median(way) <= 0.1) if quick else None,
    )


def _without(found: Sequence[Moment]) -> str:
    lost = [one for one in found if one.stops["category 1"].loses]
    none = sum(one.none for one in lost)
    return (
        f"{none} of the {len(lost)} moments at which the stop of category 1 loses something lack a stop: there the "
        f"robot goes on to a later one, or to the end of the motion. Over all {len(found)} moments, the planned stop "
        f"takes {np.median([_more(one, lambda stop: stop.seconds) for one in found]):.2f} s and "
        f"{np.median([_more(one, lambda stop: stop.way) for one in found]):.2f} m longer in the median.\n"
    )


def _more(one: Moment, of: Callable[[Stopped], float]) -> float:
    return of(one.stops["planned"]) - of(one.stops["category 1"])


def _groups(found: Sequence[Moment]) -> Iterator[tuple[str, str, list[Moment]]]:
    for vessel in (True, False):
        for speed in SPEEDS:
            mine = [one for one in found if one.vessel == vessel and one.speed == speed]
            if mine:
                yield "open vessel" if vessel else "other", f"{speed:g}", mine
    yield "all", "", list(found)


def _each(what: str) -> tuple[str, ...]:
    return tuple(f"{kind}: {what}" for kind in STOPS)


def _harm_rows(found: Sequence[Moment]) -> Iterator[tuple[str, ...]]:
    for word, speed, mine in _groups(found):
        yield (
            word,
            speed,
            str(len(mine)),
            str(sum(one.goes_on_loses for one in mine)),
            *(str(sum(one.stops[kind].loses for one in mine)) for kind in STOPS),
            *(f"{np.mean([one.stops[kind].harm for one in mine]):.3f}" for kind in STOPS),
        )


def _way_rows(found: Sequence[Moment]) -> Iterator[tuple[str, ...]]:
    for word, speed, mine in _groups(found):
        yield (
            word,
            speed,
            report.percent(float(np.mean([one.none for one in mine]))),
            *(f"{np.median([one.stops[kind].seconds for one in mine]):.2f}" for kind in STOPS),
            f"{np.percentile([one.stops['planned'].seconds for one in mine], 90):.2f}",
            *(f"{np.median([one.stops[kind].way for one in mine]):.3f}" for kind in STOPS),
            f"{1e3 * np.median([one.planning for one in mine]):.0f}",
        )

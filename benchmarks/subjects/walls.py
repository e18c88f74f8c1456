"""Is what the drop model predicts beside walls what happens? What flies against a side falls down in front of it."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks import events as failures
from benchmarks import report, suite, walled
from benchmarks.events import FIGURES, Events
from benchmarks.subjects import drop_prediction
from failbench.calibrations import skill
from failbench.calibrations.failure_jobs import FailureJob, MotionKind, failure_jobs

TITLE = "Drop model beside walls: predicted and observed hits, event by event"
MEASURED = f"""\
Scenes: each of `benchmarks/unseen`, {walled.VERSIONS} times with {walled.WALLS} walls beside the ways of its tasks
(`benchmarks/walled.py`): 10 to 70 cm high, 16 to 60 cm long, at any angle, as near as the ends of all tasks allow.
Drops and figures as in `drop_prediction`; walls count as furniture. No constant of the model was fitted on any of them.
What its step 0 is made of (which sides count, how sharply) was chosen by looking at such drops beside other
walls, and at some of the scenes that lie under these.
"""
SEED = 9100
KINDS = (
    MotionKind(way="auto", w=0.3, speed=0.5, iterations=150),
    MotionKind(way="auto", w=1.0, speed=0.8, iterations=150),
    MotionKind(way="via", speed=0.7),
    MotionKind(way="via", speed=1.0),
)
DROPS = 30
"""Along each motion."""
RATIO = (0.8, 1.25)
MODELS = ("mixture", "Algorithm 1")


def run(options: suite.Options) -> str:
    """Drop, predict and compare."""
    drops, refused = failures.fail(jobs(options), options)
    models = {name: drop_prediction.MODELS[name] for name in MODELS}
    events = drop_prediction.events_of(drops, models, walled.load)
    count = sum(len(part) for part in drops)
    parts = [
        MEASURED,
        f"{count} drops along {len(drops)} motions: {len(events.happened)} events.\n",
        *(f"No drops: {reason}.\n" for reason in refused),
        report.targets(_targets(events, options.pick(200, quick=10))),
        report.table(("model", *FIGURES), [(model, *events.figures(model)) for model in MODELS]),
        "`footprint` by motion and by what is hit:\n",
        report.table(("motions", "what is hit", *FIGURES), _hit_rows(events)),
    ]
    return "\n".join(parts)


def jobs(options: suite.Options) -> list[FailureJob]:
    """Return what is dropped: along every kind of motion, for every task of every scene."""
    names, kinds, n = options.pick((walled.names(), KINDS, DROPS), quick=(walled.names()[:2], KINDS[3:], 6))
    return [
        job
        for k, name in enumerate(names)
        for job in failure_jobs(walled.load, [name], n=n, seed=SEED + k, kinds=kinds)
    ]


def _targets(events: Events, resamples: int) -> list[report.Target]:
    p, y = events.predicted["mixture"], events.happened
    ratio = skill.bootstrap(skill.predicted_ratio, p, y, events.motion, resamples=resamples)
    wanted, met = f"{RATIO[0]} to {RATIO[1]}", RATIO[0] <= ratio.mean <= RATIO[1]
    return [report.Target(what="predicted over observed hits", wanted=wanted, measured=str(ratio), met=met)]


def _hit_rows(events: Events) -> list[Sequence[object]]:
    rows: list[Sequence[object]] = []
    made, hit = events.labels["made"], events.labels["hit"]
    for kind in ("optimised", "others"):
        for what in drop_prediction.HIT:
            part = events.only((made == kind) & (hit == what))
            if len(part.happened):
                rows.append((kind, what, *part.figures("mixture")))
    return rows

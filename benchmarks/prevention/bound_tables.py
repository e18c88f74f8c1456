"""Tables of the bound: the attainable reduction, the first by the model, and the causes of the difference."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence

import numpy as np
from scipy.stats import rankdata

from benchmarks import report
from benchmarks.prevention.bound_record import DEFAULT, NAMED, PRIORS, WEIGHTS, Array, Bound, name_of
from benchmarks.prevention.runs import NONE
from failbench.basics.statistics import Estimate, cluster_bootstrap

PRIOR_OF = {"drops": "default", "mixed": "service"}
"""The prior that predicts each kind of failures."""
SURE = 1.1
"""The best motion of a task counts as better if it does this much less harm than the planner's."""
BEST, BEST_AT_SPEED = "best", "best at the same speed"
_SHARES = (
    "motion", "harm per task, x less, median", "geometric mean", "share of the attainable", "at the same speed",
    "duration",
)  # fmt: skip
_PICKS = (
    "least", "harm per task, x less, median", "geometric mean", "share of the attainable at the same speed",
    "duration", "J over that of the planner's own motion, median",
)  # fmt: skip
_HEAVIER = (
    "failures", "prior", "w", "harm per task, x less, geometric mean", "others only", "worse", "better", "duration"
)  # fmt: skip
_TASKS = (
    "task", "failures", "motions", "default", "service", "arm", "default, w = 1", "w = 3", "best at the same speed",
    "best", "which", "duration",
)  # fmt: skip
_COMPARED = f"""\
What keeps the planner from the best motion? The planner's motion at w = {WEIGHTS[0]:g} (drops: default prior, mixed:
service prior) against the best one at the same speed. "Observed": its harm per task over that of the best; "predicted":
the same ratio by the model. "J": cost of the best motion over that of the planner's at w = {WEIGHTS[0]:g}. Geometry of
the best against the default motion: mean height of the carried object, greatest horizontal distance, and distance of
the last configuration. "Rank": Spearman's correlation of predicted and observed harm per task over all motions, on the
failures that choose. Limit, if the best does {SURE:g} times less harm: **search** if the best has less J, so that the
planner missed it; **weight** if the model knows that it is safer, but it is not worth its motion; **model** if the
model predicts more harm for it than for the planner's.
"""
_LIMITS = (
    "task", "failures", "best at the same speed", "observed", "predicted", "J", "duration", "height", "aside", "end",
    "rank", "limit",
)  # fmt: skip


def bound_targets(found: Sequence[Bound]) -> Iterator[report.Target]:
    """Yield the targets: shares of the attainable at the default weight."""
    for kind in found[0].second:
        for prior in PRIORS:
            share = share_of(found, kind, name_of(prior, WEIGHTS[0]))
            yield report.Target(
                what=f"{kind}: {prior} prior at w = {WEIGHTS[0]:g}, share of the attainable",
                wanted=">= 0.9",
                measured=str(share),
                met=share.mean >= 0.9,
            )


def tables(found: Sequence[Bound], kinds: Collection[str]) -> Iterator[str]:
    """Yield all tables with their captions, for kinds of failures."""
    for kind in kinds:
        names = [name for name in NAMED[1:] if all(name in one.second[kind] for one in found)]
        yield f"Named motions, {kind}:\n"
        yield report.table(_SHARES, [_share_row(found, kind, name) for name in (*names, BEST, BEST_AT_SPEED)])
        yield (
            f"The motion that the model ranks first among all at the same speed, {kind}, {PRIOR_OF[kind]} prior, on the"
            " failures that choose, which it does not know:\n"
        )
        yield report.table(_PICKS, [_pick_row(found, kind, w) for w in (*WEIGHTS, math.inf)])
    yield f"A heavier weight, against w = {WEIGHTS[0]:g} with the same prior:\n"
    yield report.table(
        _HEAVIER, [row for kind in kinds for prior in PRIORS for row in _heavier_rows(found, kind, prior)]
    )
    yield "Task by task, times less harm per executed task than at w = 0:\n"
    yield report.table(_TASKS, [_task_row(one, kind) for kind in kinds for one in found])
    yield _COMPARED
    yield report.table(_LIMITS, [_limit_row(one, kind) for kind in kinds for one in found])
    yield from (_limits_told(found, kind) for kind in kinds)


def share_of(found: Sequence[Bound], kind: str, name: str, *, same_speed: bool = False) -> Estimate:
    """Return the summed reduction of a motion over that of the best one, with an interval from resampled tasks.

    Tasks without this motion are left out.

    Args:
        found: The tasks.
        kind: Kind of failures.
        name: The motion.
        same_speed: Whether to compare with the best motion at the same speed.
    """
    having = [one for one in found if name in one.second[kind]]
    best = [(one.best_at_speed if same_speed else one.best)[kind] for one in having]
    return _share(
        np.array([one.less(kind, name) for one in having]),
        np.array([one.less(kind, which) for one, which in zip(having, best, strict=True)]),
    )


def _share_row(found: Sequence[Bound], kind: str, name: str) -> Sequence[object]:
    chosen = [{BEST: one.best[kind], BEST_AT_SPEED: one.best_at_speed[kind]}.get(name, name) for one in found]
    ratio = [1.0 / (1.0 - one.less(kind, which)) for one, which in zip(found, chosen, strict=True)]
    longer = np.median([one.duration[which] / one.duration[NONE] for one, which in zip(found, chosen, strict=True)])
    shares = (
        ("", "")
        if name in (BEST, BEST_AT_SPEED)
        else tuple(str(share_of(found, kind, name, same_speed=same)) for same in (False, True))
    )
    geometric = float(np.exp(np.mean(np.log(ratio))))
    return name, f"{np.median(ratio):.2f}", f"{geometric:.2f}", *shares, f"{100.0 * (longer - 1.0):+.0f} %"


def _pick_row(found: Sequence[Bound], kind: str, w: float) -> Sequence[object]:
    """Return the harm that a perfect search over these motions would prevent."""
    prior = PRIOR_OF[kind]
    picks = [one.least(prior, w) for one in found]
    less = np.array([one.less_first(kind, pick) for one, pick in zip(found, picks, strict=True)])
    best = np.array([one.less(kind, one.best_at_speed[kind]) for one in found])
    longer = np.median([one.duration[pick] / one.duration[NONE] for one, pick in zip(found, picks, strict=True)])
    own = name_of(prior, w)
    gaps = [
        one.modelled[pick].cost(prior, w) / one.modelled[own].cost(prior, w)
        for one, pick in zip(found, picks, strict=True)
        if own in one.modelled
    ]
    return (
        "predicted harm" if math.isinf(w) else f"J at w = {w:g}",
        f"{np.median(1.0 / (1.0 - less)):.2f}",
        f"{np.exp(np.mean(-np.log(1.0 - less))):.2f}",
        str(_share(less, best)),
        f"{100.0 * (longer - 1.0):+.0f} %",
        f"{np.median(gaps):.2f}" if gaps else "",
    )


def _share(reduction: Array, best: Array) -> Estimate:
    """Return a summed reduction over that of the best motion, with an interval from resampled tasks.

    At least nothing is attainable in a task: the motion at w = 0 is one of the motions.
    """
    attainable = np.maximum(best, 0.0)

    def share(rows: Array) -> float:
        return float(rows[:, 0].sum() / max(rows[:, 1].sum(), 1e-9))

    return cluster_bootstrap(np.stack([reduction, attainable], axis=1), np.arange(len(best)), share, resamples=2000)


def _heavier_rows(found: Sequence[Bound], kind: str, prior: str) -> Iterator[Sequence[object]]:
    light = name_of(prior, WEIGHTS[0])
    for w in WEIGHTS[1:]:
        heavy = name_of(prior, w)
        both = [one for one in found if {light, heavy} <= one.second[kind].keys()]
        if heavy not in NAMED or not both:  # others are judged only where they were chosen
            continue
        logs = _log_ratios(both, kind, light, heavy, others=False)
        told = [_geometric(_log_ratios(both, kind, light, heavy, others=others)) for others in (False, True)]
        longer = np.median([one.duration[heavy] / one.duration[light] for one in both])
        sides = (np.count_nonzero(logs < 0.0), np.count_nonzero(logs > 0.0))
        yield kind, prior, f"{w:g}", *told, *sides, f"{100.0 * (longer - 1.0):+.0f} %"


def _log_ratios(found: Sequence[Bound], kind: str, light: str, heavy: str, *, others: bool) -> Array:
    return np.array(
        [np.log(one.per_task(kind, light, others=others) / one.per_task(kind, heavy, others=others)) for one in found]
    )


def _geometric(logs: Array) -> str:
    """Return the geometric mean of ratios with an interval from resampled tasks."""
    estimate = cluster_bootstrap(logs, np.arange(len(logs)), resamples=2000)
    mean, low, high = np.exp([estimate.mean, estimate.low, estimate.high])
    return f"{mean:.2f} [{low:.2f}, {high:.2f}]"


def _task_row(one: Bound, kind: str) -> Sequence[object]:
    best = one.best[kind]

    def ratio(name: str) -> str:
        return f"{1.0 / (1.0 - one.less(kind, name)):.2f}" if name in one.second[kind] else "-"

    named = [ratio(name_of(prior, WEIGHTS[0])) for prior in PRIORS]
    heavier = [ratio(name_of("default", w)) for w in WEIGHTS[1:]]
    longer = f"{100.0 * (one.duration[best] / one.duration[NONE] - 1.0):+.0f} %"
    bests = (ratio(one.best_at_speed[kind]), ratio(best))
    return one.task, kind, len(one.duration), *named, *heavier, *bests, best, longer


def _limit_row(one: Bound, kind: str) -> Sequence[object]:
    own, best = name_of(PRIOR_OF[kind], WEIGHTS[0]), one.best_at_speed[kind]
    if own not in one.second[kind]:
        return one.task, kind, best, *["-"] * 9
    a, b = one.modelled[own], one.modelled[best]
    default = one.modelled[DEFAULT]
    prior = PRIOR_OF[kind]
    return (
        one.task,
        kind,
        best,
        f"{one.per_task(kind, own) / one.per_task(kind, best):.2f}",
        f"{_ratio(a.impact[prior], b.impact[prior]):.2f}",
        f"{b.cost(prior, WEIGHTS[0]) / a.cost(prior, WEIGHTS[0]):.2f}",
        f"{100.0 * (one.duration[best] / one.duration[own] - 1.0):+.0f} %",
        f"{100.0 * (b.height - default.height):+.0f} cm",
        f"{100.0 * b.aside:.0f} cm",
        f"{b.end:.1f} rad",
        f"{rank_of(one, kind):.2f}",
        limit_of(one, kind),
    )


def _ratio(a: float, b: float) -> float:
    return a / max(b, 1e-12) if a > 0.0 else float(b <= 0.0)


def rank_of(one: Bound, kind: str) -> float:
    """Return Spearman's correlation of predicted and observed harm per task over the motions of a task.

    NaN if either is constant.
    """
    observed = {name: harm * one.duration[name] for name, harm in one.first[kind].items()}
    predicted = [one.modelled[name].impact[PRIOR_OF[kind]] for name in observed]
    if np.ptp(predicted) == 0.0 or np.ptp(list(observed.values())) == 0.0:
        return math.nan
    return float(np.corrcoef(rankdata(predicted), rankdata(list(observed.values())))[0, 1])


def limit_of(one: Bound, kind: str) -> str:
    """Return what keeps the planner from the best motion at its speed: "search", "weight", "model", or "" if little."""
    prior = PRIOR_OF[kind]
    own, best = name_of(prior, WEIGHTS[0]), one.best_at_speed[kind]
    if own not in one.second[kind] or one.per_task(kind, own) < SURE * one.per_task(kind, best):
        return ""
    a, b = one.modelled[own], one.modelled[best]
    if b.cost(prior, WEIGHTS[0]) < a.cost(prior, WEIGHTS[0]):
        return "search"
    return "weight" if b.impact[prior] < a.impact[prior] else "model"


def _limits_told(found: Sequence[Bound], kind: str) -> str:
    limits = [limit_of(one, kind) for one in found]
    told = ", ".join(f"{limit or 'none'} {limits.count(limit)}" for limit in ("search", "weight", "model", ""))
    ranks = [rank for one in found if not math.isnan(rank := rank_of(one, kind))]
    return f"{kind}: {told}; median rank correlation {np.median(ranks) if ranks else math.nan:.2f}.\n"

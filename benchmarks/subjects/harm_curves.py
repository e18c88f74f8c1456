"""What does a detour buy? Harm over duration of motions planned with different costs over a grid of their weights."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from benchmarks import suite
from benchmarks.prevention.figures import draw
from benchmarks.prevention.runs import (
    CURVES,
    MODELS,
    NONE,
    OURS,
    OWN_SECONDS,
    PUBLISHED,
    SECONDS,
    SEED,
    CurveJob,
    HeadlineJob,
    do_curve,
    do_headline,
    read_curves,
    read_headlines,
)
from benchmarks.prevention.tables import CURVE_DROPS, Sizes, curve_sections
from benchmarks.prevention.work import fill, found, headline_jobs, kept, task_names

TITLE = "Harm over duration: the default model, Algorithm 1 and common sense over their weights"
MEASURED = f"""\
Tasks as in `prevention`, planned at half of the velocity limits in {SECONDS:g} s, with costs written in Python in
{OWN_SECONDS:g} s, so that costs are compared and not their speed; the object is dropped along every motion. Harm is
that per executed task, "x less" as in `prevention`.

Common sense, as own costs: "keep away", the severity of everything around times exp(- distance / 0.15 m); "not above",
the severity of everything straight below; "carry low", the height above what is below. Each is planned with over a
grid of weights, and so are the default model and Algorithm 1; "at equal duration" reads harm per task off the lower
envelope of what a planner offers over its weights, w = 0 included, interpolating its logarithm.
"""
PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "prevention.png"
WEIGHTS = (0.1, 0.3, 1.0, 3.0, 10.0)
RELATIVE = (0.3, 1.0, 3.0, 10.0)
"""Weights of own costs, as multiples of that at which the straight path costs as much again; see `weight_of`."""


def run(options: suite.Options) -> str:
    """Do what is left to do, and report on all that is done."""
    sizes, names = sizes_of(options), task_names(options)
    job = HeadlineJob(drops=sizes.drops, mixed=0, labels=(NONE, OURS, PUBLISHED))
    with kept(options) as folder:
        heads = folder / f"curve_heads.{SEED}.{sizes.drops}.jsonl"
        curves = folder / f"curves.{SEED}.{sizes.drops}.jsonl"
        fill(heads, headline_jobs(names, heads, job), do_headline, options, "harm_curves, default weights")
        fill(curves, curve_jobs(names, heads, curves, sizes), do_curve, options, "harm_curves")
        done = found(names, heads, curves)
    if not options.quick:
        draw(done, PICTURE)
    asked: Iterable[str] = (name for all_of in names.values() for name in all_of)
    picture = [] if options.quick else [f"![harm per task over duration](../docs/images/{PICTURE.name})\n"]
    return "\n".join([MEASURED, *curve_sections(done, list(asked), sizes), *picture])


def sizes_of(options: suite.Options) -> Sizes:
    """Return sizes as they were asked for."""
    weights, relative = options.pick((WEIGHTS, RELATIVE), quick=((1.0,), (3.0,)))
    drops = options.drops or options.pick(CURVE_DROPS, quick=8)
    return Sizes(drops=drops, weights=options.weights or weights, relative=relative)


def curve_jobs(names: Mapping[str, Sequence[str]], heads: Path, file: Path, sizes: Sizes) -> list[CurveJob]:
    """List what is left to do of curves in tasks whose motion at w = 0 failed, task by task."""
    grasps = {done.task: done.grasp for done in read_headlines(heads) if done.motions[NONE].harm}
    have = {(done.task, done.cost): set(done.points) for done in read_curves(file)}
    jobs = []
    for name in (name for all_of in names.values() for name in all_of if name in grasps):
        for cost in CURVES:
            wanted = sizes.weights if cost in MODELS else sizes.relative
            left = tuple(w for w in wanted if f"{w:g}" not in have.get((name, cost), ()))
            if left:
                jobs.append(CurveJob(task=name, cost=cost, weights=left, grasp=grasps[name], drops=sizes.drops))
    return jobs

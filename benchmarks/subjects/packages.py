"""From `pip install` to a validated plan of one's own robot, step by step; and the wheel on every Python here."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks import report, suite

TITLE = "Packages: five minutes from pip install, and every Python"
ROOT = Path(__file__).parents[2]
FIVE_MINUTES = 300.0
VERSIONS = ("3.11", "3.12", "3.13")
MEASURED = """\
"Five minutes": `.ci/five_minutes.py` with the wheel, in a fresh environment: the robot is `examples/own_robot.py`, an
arm with a cup in MJCF; it is planned by the defaults, validated by 100 failures in FailBench, and its page is opened in
the viewer, in a browser without a window. Packages come from wherever pip is set to look and its cache. "Wheel": into a
fresh environment of each Python, with its dependencies, then `.ci/smoke_wheel`: `pip check`, planning, evaluating,
`doctor` and FailBench from a folder where no source is. Wheels are those in `dist/`; what is missing there is built.
"""
_STEP = re.compile(r"^ *([\d.]+) s  ([^:\n]+)(?:: (.*))?$", flags=re.MULTILINE)


def run(options: suite.Options) -> str:
    """Install and use the wheels; a quick run does the first Python only."""
    found = [python for python in map(_interpreter, VERSIONS) if python is not None]
    lines = [] if options.quick else list(_five_minutes(_wheel(Path(sys.executable))))
    lines += [_smoke(python) for python in found[: options.pick(len(found), quick=1)]]
    return f"{MEASURED}\n{report.targets(lines)}"


def _five_minutes(wheel: Path) -> Iterator[report.Target]:
    script = ROOT / ".ci" / "five_minutes.py"
    done = subprocess.run([sys.executable, str(script), str(wheel)], capture_output=True, text=True, check=False)
    print(done.stdout, done.stderr, file=sys.stderr)
    for seconds, what, said in _STEP.findall(done.stdout):
        if what.startswith("in all"):
            met = done.returncode == 0 and float(seconds) < FIVE_MINUTES
            yield report.Target(what="five minutes", wanted=f"< {FIVE_MINUTES:g} s", measured=f"{seconds} s", met=met)
        else:
            told = f"{seconds} s" + (f": {said}" if said else "")
            yield report.Target(what=f"- {what}", wanted="done", measured=told, met=True)
    if done.returncode:
        yield report.Target(what="all steps", wanted="done", measured=f"ended with {done.returncode}", met=False)


def _interpreter(version: str) -> Path | None:
    """Return where the Python of a version is; None if it is not here, or its name leads nowhere."""
    asked = [f"python{version}", "-c", "import sys; print(sys.executable)"]
    try:
        return Path(subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip())
    except (OSError, subprocess.CalledProcessError):
        return None


def _version(python: Path) -> tuple[int, int]:
    asked = [str(python), "-c", "import sys; print(*sys.version_info[:2])"]
    major, minor = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()
    return int(major), int(minor)


def _wheel(python: Path) -> Path:
    """Return the wheel for a Python: of 3.11, or by the stable ABI; built if it is not in `dist/`."""
    wanted = "*-cp311-cp311-*.whl" if _version(python) == (3, 11) else "*-cp312-abi3-*.whl"
    dist = ROOT / "dist"
    if not list(dist.glob(wanted)):
        with tempfile.TemporaryDirectory() as folder:
            own = _environment(python, Path(folder))
            pip = [str(own / "bin" / "python"), "-m", "pip", "-q"]
            pinned = ["--require-hashes", "--only-binary", ":all:", "-r", str(ROOT / "requirements" / "build.txt")]
            subprocess.run([*pip, "install", *pinned], check=True)
            build = ["wheel", "--no-deps", "--no-build-isolation", f"--config-settings=build-dir={folder}/build"]
            subprocess.run([*pip, *build, "--wheel-dir", str(dist), str(ROOT)], check=True)
    return max(dist.glob(wanted), key=lambda file: file.stat().st_mtime)


def _environment(python: Path, folder: Path) -> Path:
    subprocess.run([str(python), "-m", "venv", str(folder / "env")], check=True)
    return folder / "env"


def _smoke(python: Path) -> report.Target:
    wheel, version = _wheel(python), ".".join(map(str, _version(python)))
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        own = _environment(python, Path(folder)) / "bin"
        subprocess.run([str(own / "python"), "-m", "pip", "install", "-q", str(wheel)], check=True)
        installed = time.perf_counter() - began
        path = os.pathsep.join([str(own), os.environ["PATH"]])
        done = subprocess.run([str(ROOT / ".ci" / "smoke_wheel")], env={**os.environ, "PATH": path}, check=False)
        smoked = time.perf_counter() - began - installed
    kind = wheel.name.split("-", 2)[2].removesuffix(".whl")
    said = (
        f"{kind}: installed in {installed:.0f} s, smoke {'done' if done.returncode == 0 else 'FAILED'}, {smoked:.0f} s"
    )
    return report.Target(what=f"wheel on Python {version}", wanted="done", measured=said, met=done.returncode == 0)

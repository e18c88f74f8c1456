"""Time each step from `pip install` to a validated and displayed plan of a custom robot, in a new environment.

    python .ci/five_minutes.py dist/graceful_plan-*.whl     # or . to compile the source tree

Packages come from the index that pip is configured for. Without a browser, the last step fetches the viewer's page.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

WITHIN = 300.0
"""Time limit for all steps together [s]."""
ROBOT = Path(__file__).parents[1] / "examples" / "own_robot.py"
LOAD = """
import sys; sys.path.insert(0, "."); import own_robot, graceful_plan as gp
scene = gp.Scene.from_mjcf(
    own_robot.ARM, robot="arm/", tool="arm/tool", carried="cup",
    entities={"vase": "glass", "table": "table"}, **own_robot.LIMITS,
)
"""
PLAN = f"""{LOAD}
result = gp.plan(own_robot.START, own_robot.GOAL, scene, w=1.0)
result.unwrap().to_json("plan.json")
print(result.status.name, "impact", round(result.cost.impact, 2), "duration", round(result.trajectory.duration, 2), "s")
"""
VALIDATE = f"""{LOAD}
import failbench as fb
report = fb.validate(gp.Trajectory.from_json("plan.json"), scene, n=100, settings=fb.SimSettings(grasp="weld"))
print("predicted", round(report.predicted, 2), "observed", report.observed)
"""
VIEW = f"""{LOAD}
viewer = gp.view(gp.Trajectory.from_json("plan.json"), scene, w=1.0, port=8460)
print(viewer.url, flush=True)
viewer.wait()
"""
PICTURE = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
           "--virtual-time-budget=20000", "--window-size=1300,900")  # fmt: skip


def main() -> int:
    """Run the steps and print the duration of each; return 1 if the total exceeds `WITHIN`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path, help="a wheel, or the source tree")
    parser.add_argument("--picture", type=Path, help="where the screenshot goes, if there is a browser")
    args = parser.parse_args()
    package, rows = args.package.resolve(), []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        shutil.copy(ROBOT, place)
        python = place / "env" / "bin" / "python"

        def step(what: str, act: Callable[[], str]) -> None:
            began = time.perf_counter()
            output = act()
            rows.append((what, time.perf_counter() - began))
            print(f"{rows[-1][1]:7.1f} s  {what}{output and ': ' + output}", flush=True)

        def run(*command: str) -> str:
            done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
            if done.returncode:
                raise SystemExit(f"{' '.join(command[:3])} failed:\n{done.stderr}")
            return done.stdout.strip().splitlines()[-1] if done.stdout.strip() else ""

        step("a fresh environment", lambda: run(sys.executable, "-m", "venv", "env"))
        step(
            "pip install '.[viz]'",
            lambda: run(str(python), "-m", "pip", "install", "-q", f"{package}[viz]"),
        )
        step("pip check", lambda: run(str(python), "-m", "pip", "check"))
        step("own robot, planned", lambda: run(str(python), "-c", PLAN))
        step("validated by 100 failures", lambda: run(str(python), "-c", VALIDATE))
        step("seen", lambda: _seen(python, place, args.picture))
    total = sum(seconds for _, seconds in rows)
    print(f"{total:7.1f} s  in all, wanted {WITHIN:g} s")
    return int(total > WITHIN)


def _seen(python: Path, place: Path, picture: Path | None) -> str:
    """Open the viewer and take a screenshot in a browser, or fetch the page if there is no browser."""
    with subprocess.Popen([str(python), "-c", VIEW], cwd=place, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            browser = shutil.which("chromium") or shutil.which("google-chrome")
            if browser is None:
                with urllib.request.urlopen(url, timeout=60.0) as answer:
                    return f"{len(answer.read()) / 1e6:.1f} MB of a page; no browser here"
            file = (picture or place / "seen.png").resolve()
            command = [browser, *PICTURE, f"--user-data-dir={place / 'browser'}", f"--screenshot={file}", url]
            subprocess.run(command, check=True, capture_output=True, env={**os.environ, "HOME": str(place)})
            return json.dumps({"picture": file.name, "kB": file.stat().st_size // 1000})
        finally:
            process.terminate()


if __name__ == "__main__":
    sys.exit(main())

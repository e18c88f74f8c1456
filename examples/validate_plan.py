"""Validate a motion: FailBench breaks the robot along it and compares observed harm with predicted impact."""

import sys

import failbench as fb
import graceful_plan as gp


def main(n: int = 200, iterations: int | None = None) -> dict[str, fb.ValidationReport]:
    """Plan with w = 0 and w = 1 and simulate n failures along each motion; return the reports."""
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    reports = {}
    for name, w in {"ordinary": 0.0, "graceful": 1.0}.items():
        result = gp.plan(task.start, task.goal, task.scene, w=w, iterations=iterations)
        reports[name] = fb.validate(result, task.scene, "drop/*/severe", n=n)
        print(f"{name}: predicted {reports[name].predicted:.2f}, observed {reports[name].observed} per failure")
    per_task = {name: report.observed_per_task.mean for name, report in reports.items()}
    print("harm per executed task, at {:g} failures an hour: ".format(reports["graceful"].rate), end="")
    print(", ".join(f"{name} {harm:.2g}" for name, harm in per_task.items()))
    return reports


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))

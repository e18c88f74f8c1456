"""Check pinned dependencies for known vulnerabilities, and report the number that could not be checked.

python .ci/audit.py [FILE ...]

pip-audit needs the network, and passes packages that it could not check. Here they are reported: the exit status is 1
if a vulnerability is known, else 0, and the last line has the number of checked pins.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

FILES = ("build", "runtime", "dev", "docs", "viewer", "robots", "checks")


def audited(file: Path) -> list[dict[str, object]] | str:
    """Return the findings of pip-audit for each pin in a file, or its error message."""
    command = [sys.executable, "-m", "pip_audit", "--disable-pip", "--no-deps", "--format", "json", "-r", str(file)]
    run = subprocess.run([*command, "--progress-spinner", "off"], capture_output=True, text=True, check=False)
    try:
        return json.loads(run.stdout)["dependencies"]
    except (ValueError, KeyError):
        return (run.stderr.strip().splitlines() or ["no answer"])[-1][-200:]


def main() -> int:
    """Return 1 if a vulnerability is known, else 0."""
    root = Path(__file__).parents[1] / "requirements"
    files = [Path(name) for name in sys.argv[1:]] or [root / f"{name}.txt" for name in FILES]
    looked_at, total, known = 0, 0, 0
    for file in files:
        found = audited(file)
        if isinstance(found, str):
            print(f"{file.name}: not audited: {found}")
            continue
        total += len(found)
        looked_at += sum("vulns" in pin for pin in found)
        for pin in found:
            for weakness in pin.get("vulns", []):  # type: ignore[attr-defined]
                known += 1
                print(f"{pin['name']} {pin.get('version')}: {weakness['id']}, fixed in {weakness['fix_versions']}")
    print(f"{looked_at} of {total} pins checked, {known} known vulnerabilities")
    if looked_at < total or not total:
        print("the others could not be checked: the vulnerability service is not reachable")
    return min(known, 1)


if __name__ == "__main__":
    sys.exit(main())

"""Write the SHA-256 of every wheel in a folder beside them, or compare those of two folders.

python .ci/hashes.py FOLDER [OTHER]

With one folder: FOLDER/SHA256SUMS, which `sha256sum --check` reads, and which whoever publishes wheels signs. With two:
whether both hold the same wheels with the same bytes; where they do not, the members that differ are named.
"""

from __future__ import annotations

import hashlib
import sys
import zipfile
from pathlib import Path


def sums(folder: Path) -> dict[str, str]:
    """Return the checksum of each wheel by its name."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.glob("*.whl"))}


def differing(one: Path, other: Path) -> list[str]:
    """Name the members of two wheels that are not the same."""
    with zipfile.ZipFile(one) as first, zipfile.ZipFile(other) as second:
        names = sorted({*first.namelist(), *second.namelist()})
        there = [{x.filename: (x.CRC, x.date_time, x.external_attr) for x in z.infolist()} for z in (first, second)]
    return [name for name in names if there[0].get(name) != there[1].get(name)]


def main() -> int:
    """Return whether two folders differ."""
    folders = [Path(name) for name in sys.argv[1:3]]
    found = [sums(folder) for folder in folders]
    if not found or not found[0]:
        raise SystemExit(f"there are no wheels in {folders[0] if folders else 'no folder'}")
    if len(folders) == 1:
        lines = [f"{checksum}  {name}\n" for name, checksum in found[0].items()]
        (folders[0] / "SHA256SUMS").write_text("".join(lines))
        print("".join(lines), end="")
        return 0
    for name in sorted({*found[0], *found[1]}):
        if found[0].get(name) != found[1].get(name):
            both = name in found[0] and name in found[1]
            print(f"{name}: {differing(folders[0] / name, folders[1] / name) if both else 'in one folder only'}")
    print("the same bytes" if found[0] == found[1] else "not the same bytes")
    return int(found[0] != found[1])


if __name__ == "__main__":
    sys.exit(main())

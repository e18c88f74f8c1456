"""Description of the machine: processor, memory, instruction sets, versions."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path

from graceful_plan._version import __version__
from graceful_plan.core.kernels import instruction_sets

PACKAGES = ("numpy", "mujoco", "ompl", "toppra", "scipy", "casadi")


def describe() -> dict[str, str]:
    """Return the properties that times depend on, by name; none identifies the owner of the machine."""
    return {
        "processor": processor(),
        "cores": str(os.cpu_count()),
        "memory": f"{memory_gb():.0f} GB",
        "system": f"{platform.system()} {platform.machine()}",
        "kernels": ", ".join(instruction_sets()),
        "versions": ", ".join(
            [
                f"graceful_plan {__version__}",
                f"Python {platform.python_version()}",
                *(f"{package} {version(package)}" for package in PACKAGES),
            ]
        ),
    }


def described() -> str:
    """Return the description in one line."""
    about = describe()
    hardware = f"{about['processor']}, {about['cores']} cores, {about['memory']}"
    return f"{hardware}; {about['system']}; kernels: {about['kernels']}; {about['versions']}"


def processor() -> str:
    """Return the model of the processor."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return platform.processor() or platform.machine()
    fields = [line.split(":", 1) for line in info.read_text().splitlines() if ":" in line]
    values = {key.strip(): value.strip() for key, value in reversed(fields)}
    name = values.get("model name", platform.machine())
    numbers = ", ".join(f"{key} {values[key]}" for key in ("cpu family", "model") if key in values)
    return f"{name} ({numbers})" if numbers else name


def memory_gb() -> float:
    """Return the memory of the machine [GB]; NaN if unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    except (ValueError, OSError):
        return float("nan")


def resident_megabytes() -> float:
    """Return the resident memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def version(package: str) -> str:
    """Return the version of an installed package."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "missing"

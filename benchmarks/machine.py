"""What a figure was measured on: processor, instruction sets, versions, how busy the machine was."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path

import graceful_plan as gp
from graceful_plan.kernels import instruction_sets

PACKAGES = ("numpy", "mujoco", "ompl", "toppra", "mink", "scipy")


def describe() -> str:
    """One line: processor, cores, memory, instruction sets, system, versions."""
    own = f"graceful_plan {gp.__version__}, Python {platform.python_version()}"
    versions = ", ".join([own, *(f"{package} {_version(package)}" for package in PACKAGES)])
    hardware = f"{processor()}, {os.cpu_count()} cores, {_memory_gb():.0f} GB"
    return f"{hardware}; {platform.system()}; kernels: {', '.join(instruction_sets())}; {versions}"


def load() -> float:
    """Load average of the last minute: how many others wanted the processor."""
    return os.getloadavg()[0]


def resident_megabytes() -> float:
    """Memory that this process holds [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def processor() -> str:
    """Model of the processor."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return platform.processor() or platform.machine()
    fields = [line.split(":", 1) for line in info.read_text().splitlines() if ":" in line]
    values = {key.strip(): value.strip() for key, value in reversed(fields)}
    name = values.get("model name", platform.machine())
    numbers = ", ".join(f"{key} {values[key]}" for key in ("cpu family", "model") if key in values)
    return f"{name} ({numbers})" if numbers else name


def _memory_gb() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "missing"

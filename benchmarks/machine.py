"""What a figure was measured on: processor, instruction sets, versions, how busy the machine was."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import graceful_plan as gp
from graceful_plan.compare.runs.machine import memory_gb, processor, version
from graceful_plan.core.kernels import instruction_sets

PACKAGES = ("numpy", "mujoco", "ompl", "toppra", "mink", "scipy")


def describe() -> str:
    """One line: processor, cores, memory, instruction sets, system, versions."""
    own = f"graceful_plan {gp.__version__}, Python {platform.python_version()}"
    versions = ", ".join([own, *(f"{package} {version(package)}" for package in PACKAGES)])
    hardware = f"{processor()}, {os.cpu_count()} cores, {memory_gb():.0f} GB"
    return f"{hardware}; {platform.system()}; kernels: {', '.join(instruction_sets())}; {versions}"


def load() -> float:
    """Load average of the last minute: how many others wanted the processor."""
    return os.getloadavg()[0]


def resident_megabytes() -> float:
    """Memory that this process holds [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

"""What a log says about where it was made: versions, machine, clock."""

import functools
import importlib.metadata
import os
import platform
import subprocess
import time
from pathlib import Path

_PROJECT = Path(__file__).resolve().parents[2]
_PACKAGES = ("pcpc", "numba", "llvmlite", "numpy", "cantools", "python-can", "mcap")


def facts() -> dict[str, str]:
    """Return versions, source state and machine as text, and one reading of both clocks."""
    return _lasting() | {
        "clock_monotonic_ns": str(time.monotonic_ns()),
        "clock_wall_ns": str(time.time_ns()),
    }


@functools.cache
def _lasting() -> dict[str, str]:
    """Return what does not change while a process lives."""
    found = {
        "python": platform.python_version(),
        "kernel": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
        "processor": _processor(),
        "cpus": str(os.cpu_count()),
        "git": _git(),
    }
    for package in _PACKAGES:
        try:
            found[f"version_{package}"] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[f"version_{package}"] = "not installed"
    return found


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return "unknown"
    return next(
        (x.split(":", 1)[1].strip() for x in lines if x.startswith("model name")), "unknown"
    )


def _git() -> str:
    """Return the commit, with `-dirty` where files differ from it; `none` outside a checkout."""
    command = ["git", "-C", str(_PROJECT), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5)
    except (OSError, subprocess.TimeoutExpired):
        return "none"
    return done.stdout.strip() or "none"

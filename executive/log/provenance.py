"""What a log says about where it was made: versions, machine, clock, the commit of the rig."""

import functools
import importlib.metadata
import os
import platform
import re
import subprocess
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from pcpc.executive.rig.file_laws import FILE_LAWS

_PROJECT = Path(__file__).resolve().parents[2]
RIG_COMMIT = "rig_git"  # the key of `of_rig`
_RIGS_OWN = (  # endings of files that nobody has added yet
    ".yaml", ".yml", ".py", ".dbc",
    *(ending for law in FILE_LAWS.values() for ending in law.endings),
)  # fmt: skip
_PATIENCE_S = 5.0  # of one answer of git
_PACKAGES = ("pcpc", "numba", "llvmlite", "numpy", "cantools", "python-can", "mcap")


def facts() -> dict[str, str]:
    """Return versions, source state and machine as text, and one reading of both clocks."""
    return _lasting() | {
        "clock_monotonic_ns": str(time.monotonic_ns()),
        "clock_wall_ns": str(time.time_ns()),
    }


def of_rig(rig: Path) -> dict[str, str]:
    """Return the commit of the work tree that a rig file lies in; {} of one that lies in none.

    `-dirty` where the rig's folder differs from it. Without a work tree no process is started, else
    one; without git, or if it takes too long, nothing is known.
    """
    file = rig.resolve()
    root = next((above for above in file.parents if (above / ".git").exists()), None)
    if root is None:
        return {}
    text = _answer_of_git(
        file.parent,
        "status", "--porcelain=v2", "--branch", "--no-ahead-behind", "-z", "--no-renames",
        "--untracked-files=all", "--ignored=matching", "--", ".",
    )  # fmt: skip
    if text is None:
        return {}
    commit = _commit(text.split("\0"), file.relative_to(root).as_posix())
    return {RIG_COMMIT: commit} if commit else {}


def _answer_of_git(folder: Path, *words: str) -> str | None:
    """Return what git prints in a folder, None if it fails or is slow; it takes no lock there."""
    ours = ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE")  # of a hook that runs us
    environment = {key: value for key, value in os.environ.items() if key not in ours}
    environment["GIT_OPTIONAL_LOCKS"] = "0"
    try:
        done = subprocess.run(
            ["git", "-c", "core.fsmonitor=false", "--literal-pathspecs", "-C", str(folder), *words],
            capture_output=True,
            stdin=subprocess.DEVNULL,
            check=True,
            timeout=_PATIENCE_S,
            env=environment,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return os.fsdecode(done.stdout)


def rig_commits(metadata: Mapping[str, Mapping[str, str]], nodes: Iterable[str]) -> str:
    """Return what a log's nodes say of the commit: once, or by node where they differ."""
    commits = {node: text for node in nodes if (text := metadata[node].get(RIG_COMMIT, ""))}
    if len({*commits.values()}) == 1:
        return next(iter(commits.values()))
    return ", ".join(f"{text} ({node})" for node, text in commits.items())


def _commit(lines: Sequence[str], file: str) -> str:
    """Return the commit that `git status` tells; "" before the first, or if `file` is ignored."""
    commit = next((x.split()[2] for x in lines if x.startswith("# branch.oid ")), "")
    if not re.fullmatch("[0-9a-f]{40,64}", commit):
        return ""
    if any(f"{file}/".startswith(f"{x[2:].rstrip('/')}/") for x in lines if x.startswith("! ")):
        return ""
    changed = any(x[:2] in ("1 ", "u ") for x in lines)
    new = any(x.startswith("? ") and x.endswith(_RIGS_OWN) for x in lines)
    return commit[:12] + "-dirty" * (changed or new)


@functools.cache
def _lasting() -> dict[str, str]:
    """Return what does not change while a process lives."""
    lasting = {
        "python": platform.python_version(),
        "kernel": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
        "processor": _processor(),
        "cpus": str(os.cpu_count()),
        "git": _git(),
    }
    for package in _PACKAGES:
        try:
            lasting[f"version_{package}"] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            lasting[f"version_{package}"] = "not installed"
    return lasting


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return "unknown"
    return next(
        (x.split(":", 1)[1].strip() for x in lines if x.startswith("model name")), "unknown"
    )


def _git() -> str:
    """Return the commit, with `-dirty` where files differ from it; `none` outside a checkout.

    `git describe --dirty` would lock the index, whatever it is told.
    """
    commit = _answer_of_git(_PROJECT, "describe", "--always", "--abbrev=12")
    if not commit:
        return "none"
    changed = _answer_of_git(_PROJECT, "status", "--porcelain", "--untracked-files=no")
    return "none" if changed is None else commit.strip() + "-dirty" * bool(changed)

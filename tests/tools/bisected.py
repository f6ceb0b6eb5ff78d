"""A git repository with a rig and a history, and `pcpc bisect` of it, mostly in this process."""

import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from logcommand import Done, run_here
from processes import ROOT

from pcpc.tools.after.bisect import runs
from pcpc.tools.after.compare.versions import Side

AUTHOR = ("-c", "user.name=engineer", "-c", "user.email=engineer@example.org")
RIG = "motor/rig.yaml"
TAU, ULP_MORE = "tau_s: 0.1}", "tau_s: 0.10000000000000002}"  # the next float64


def git(folder: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *AUTHOR, *words], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert text.count(old) == 1, f"{file}: {old!r} {text.count(old)} times"
    file.write_text(text.replace(old, new))


def commit(folder: Path, subject: str) -> str:
    git(folder, "add", "-A")
    git(folder, "commit", "-q", "--allow-empty", "-m", subject)
    return git(folder, "rev-parse", "HEAD")


def begun(folder: Path) -> Path:
    """Return a repository with the rig of a user, in `motor/`, and one commit, tagged `good`."""
    (folder / "motor").mkdir(parents=True)
    for name in ("rig.yaml", "law.py", "model.py", "probe.dbc"):
        (folder / "motor" / name).write_text((ROOT / "plants/probe" / name).read_text())
    edit(folder / RIG, "duration_s: 10.0", "duration_s: 0.05")
    git(folder, "init", "-q", "-b", "main")
    commit(folder, "one")
    git(folder, "tag", "good")
    return folder


def note(folder: Path, number: int) -> str:
    """Commit a comment in the rig, which changes no bit."""
    file = folder / RIG
    file.write_text(f"{file.read_text()}# {number}\n")
    return commit(folder, f"comment {number}")


def in_this_process(patch: pytest.MonkeyPatch) -> list[Side]:
    """Let runs be in this process, which spares the start of one each; return those done."""
    done: list[Side] = []

    def simulated(side: Side, folder: Path, *more: str) -> "subprocess.CompletedProcess[str]":
        done.append(side)
        words = ["simulate", str(side.root / side.rig), "-o", folder, "--no-figure", "--quiet"]
        found = run_here(*words, *more)
        return subprocess.CompletedProcess([], found.code, found.out, found.err)

    patch.setattr(runs, "simulation", simulated)
    return done


def bisected(*words: str | Path, code: int = 0) -> Done:
    done = run_here("bisect", *words)
    assert done.code == code, done
    return done


def state(folder: Path) -> Sequence[str]:
    """Return all of a repository that `pcpc bisect` has to leave alone."""
    return [
        git(folder, "for-each-ref"), git(folder, "worktree", "list"), git(folder, "stash", "list"),
        git(folder, "symbolic-ref", "-q", "HEAD"), git(folder, "ls-files", "--stage"),
        git(folder, "status", "--porcelain", "--ignored"),
        *(f"{path} {path.read_bytes()!r}" for path in sorted((folder / "motor").iterdir())
          if path.is_file()),
    ]  # fmt: skip

"""What `make` installs with, and shows: a moving line on a terminal, two in CI, all on failure."""

import os
import pty
import select
import subprocess
import sys
from pathlib import Path

import pytest
from places import PATIENCE_S, ROOT

from pcpc.tools.dev.installing import Course

SCRIPT = str(ROOT / "tools" / "dev" / "installing.py")
PIP = """
import sys
print("Obtaining file:///pcpc")
print("Collecting numba~=0.68.1 (from pcpc==0.1.0)")
print("  Downloading numba-0.68.1-cp311-cp311-linux_x86_64.whl (3.8 MB)", flush=True)
sys.stdin.readline()
print("Requirement already satisfied: numpy in /somewhere")
print("Installing collected packages: numba, numpy, rich", flush=True)
sys.stdin.readline()
sys.exit(int(sys.argv[1]))
"""
PYTHON = """\
#!/bin/sh
case $1 in
-m) [ $2 = compileall ] || { mkdir -p $3/bin; cp $0 $3/bin/python; cp $0 $3/bin/pip; };;
-P) shift 2; exec "$@";;
config) echo "$PIP_SAYS";;
install | pip)
    case "$*" in *" -e "*) echo "$(basename $0) $@" >> "$(dirname "$0")/installed";; esac
    [ "$UV_IS_THERE" = no ] || cp $0 "$(dirname "$0")/uv"
    [ $1 = install ] || exit ${UV_ENDS:-0};;
esac
"""
MIRROR = {"PIP_SAYS": "global.index-url='https://mirror'"}
WORDS = [sys.executable, "-P", SCRIPT, sys.executable, "-c", PIP]


def test_in_ci_there_is_a_line_before_and_a_line_after() -> None:
    done = subprocess.run([*WORDS, "0"], capture_output=True, text=True, input="")
    first, last = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (0, ""), done
    assert first.startswith("installing: about ") and last.startswith("installed in "), done.stderr


def test_how_far_uv_is() -> None:
    course = Course()
    course.take("Resolved 206 packages in 1.96s\n")
    course.take("Downloading scipy (33.7MiB)\n")
    assert course.words(3.0) == "installing: 206 packages, loading scipy (33.7MiB), 3 s"
    course.take("Prepared 206 packages in 5.78s\n")
    assert course.words(9.0) == "installing: 206 packages, unpacking them, the last step, 9 s"


def test_a_failure_shows_what_pip_said_and_keeps_its_code() -> None:
    done = subprocess.run([*WORDS, "7"], capture_output=True, text=True, input="")
    assert done.returncode == 7
    assert "Collecting numba~=0.68.1 (from pcpc==0.1.0)\n" in done.stderr, done.stderr


def test_on_a_terminal_the_line_says_what_is_done_now() -> None:
    ours, theirs = pty.openpty()
    pipe = subprocess.PIPE
    with subprocess.Popen([*WORDS, "0"], stdin=pipe, stderr=theirs, stdout=pipe) as process:
        os.close(theirs)
        assert process.stdin is not None
        shown(ours, b"installing: 1 packages, loading numba (3.8 MB), ")
        process.stdin.write(b"\n")  # and pip goes on
        process.stdin.flush()
        shown(ours, b"installing: 2 packages, unpacking 3 packages, the last step, ")
        process.stdin.close()
        shown(ours, b"installed in ")
        assert process.wait(PATIENCE_S) == 0
    os.close(ours)


def shown(terminal: int, words: bytes) -> None:
    """Read until a terminal has shown these words."""
    seen = b""
    while words not in seen:
        assert select.select([terminal], [], [], PATIENCE_S)[0], (words, seen)
        seen += os.read(terminal, 4096)


@pytest.mark.parametrize(
    ("goals", "extras"),
    [
        (["install"], ["plot"]),
        (["tools"], ["plot,test"]),
        (["tools", "install"], ["plot,test"]),
        (["install", "tools", "tools"], ["plot", "plot,test"]),
    ],
)
def test_it_runs_once_for_all_that_is_asked_for(
    goals: list[str], extras: list[str], tmp_path: Path
) -> None:
    lines = installed(goals, tmp_path)
    assert [line.partition("-e ")[2] for line in lines] == [f".[{one}]" for one in extras]


@pytest.mark.parametrize(
    ("given", "programs"),
    [
        ({}, ["uv pip"]),
        ({"UV_IS_THERE": "no"}, ["pip install"]),
        ({"UV_ENDS": "2"}, ["uv pip", "pip install"]),
        (MIRROR, ["pip install"]),
        ({"PIP_SAYS": "global.extra-index-url='https://more'"}, ["uv pip"]),
    ],
)
def test_uv_installs_unless_it_is_not_to_be_had_or_pip_has_a_mirror(
    given: dict[str, str], programs: list[str], tmp_path: Path
) -> None:
    lines = installed(["install"], tmp_path, given)
    assert [" ".join(line.split()[:2]) for line in lines] == programs


def test_a_mirror_that_is_named_later_is_asked_by_pip(tmp_path: Path) -> None:
    installed(["install"], tmp_path)
    lines = installed(["tools"], tmp_path, MIRROR)
    assert [" ".join(line.split()[:2]) for line in lines] == ["uv pip", "pip install"]


def installed(goals: list[str], folder: Path, given: dict[str, str] | None = None) -> list[str]:
    """Return the commands that install pcpc when these goals are made, in turn, in a new place."""
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    python, venv = folder / "python", folder / "venv"
    python.write_text(PYTHON)
    python.chmod(0o755)
    for goal in goals:
        words = ["make", f"PYTHON={python}", f"VENV={venv}", goal]
        done = subprocess.run(
            words, cwd=ROOT, env=alone | (given or {}), capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    return (venv / "bin" / "installed").read_text().splitlines()

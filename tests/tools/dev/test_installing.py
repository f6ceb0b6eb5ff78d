"""What `make` shows of pip: a line that moves on a terminal, two lines in CI, all on failure."""

import os
import pty
import select
import subprocess
import sys
from pathlib import Path

import pytest
from places import PATIENCE_S, ROOT

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
install) echo "$@" >> "$(dirname "$0")/installed";;
esac
"""
WORDS = [sys.executable, "-P", SCRIPT, sys.executable, "-c", PIP]


def test_in_ci_there_is_a_line_before_and_a_line_after() -> None:
    done = subprocess.run([*WORDS, "0"], capture_output=True, text=True, input="")
    first, last = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (0, ""), done
    assert first.startswith("installing: about ") and last.startswith("installed in "), done.stderr


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
def test_pip_runs_once_for_all_that_is_asked_for(
    goals: list[str], extras: list[str], tmp_path: Path
) -> None:
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    python, venv = tmp_path / "python", tmp_path / "venv"
    python.write_text(PYTHON)
    python.chmod(0o755)
    for goal in goals:
        words = ["make", f"PYTHON={python}", f"VENV={venv}", goal]
        done = subprocess.run(words, cwd=ROOT, env=alone, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    lines = (venv / "bin" / "installed").read_text().splitlines()
    assert [line.partition("-e ")[2] for line in lines] == [f".[{one}]" for one in extras]

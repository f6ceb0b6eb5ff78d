"""What `make` shows of pip: a line that moves on a terminal, two lines in CI, all on failure."""

import os
import pty
import select
import subprocess
import sys

from places import ROOT

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
WAIT_S = 20.0
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
        assert process.wait(WAIT_S) == 0
    os.close(ours)


def shown(terminal: int, words: bytes) -> None:
    """Read until a terminal has shown these words."""
    seen = b""
    while words not in seen:
        assert select.select([terminal], [], [], WAIT_S)[0], (words, seen)
        seen += os.read(terminal, 4096)

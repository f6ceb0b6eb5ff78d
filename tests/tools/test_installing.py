"""What `make` shows of pip: a line that moves on a terminal, two lines in CI, all on failure."""

import os
import pty
import subprocess
import sys
from pathlib import Path

SCRIPT = str(Path(__file__).resolve().parents[2] / "tools" / "installing.py")
PIP = """
import sys, time
print("Obtaining file:///pcpc")
print("Collecting numba~=0.68.1 (from pcpc==0.1.0)")
print("  Downloading numba-0.68.1-cp311-cp311-linux_x86_64.whl (3.8 MB)", flush=True)
time.sleep(0.7)
print("Requirement already satisfied: numpy in /somewhere")
print("Installing collected packages: numba, numpy, rich", flush=True)
time.sleep(0.7)
sys.exit(int(sys.argv[1]))
"""
WORDS = [sys.executable, "-P", SCRIPT, sys.executable, "-c", PIP]


def test_in_ci_there_is_a_line_before_and_a_line_after() -> None:
    done = subprocess.run([*WORDS, "0"], capture_output=True, text=True)
    first, last = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (0, ""), done
    assert first.startswith("installing: about ") and last.startswith("installed in "), done.stderr


def test_a_failure_shows_what_pip_said_and_keeps_its_code() -> None:
    done = subprocess.run([*WORDS, "7"], capture_output=True, text=True)
    assert done.returncode == 7
    assert "Collecting numba~=0.68.1 (from pcpc==0.1.0)\n" in done.stderr, done.stderr


def test_on_a_terminal_the_line_says_what_is_done_now() -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen([*WORDS, "0"], stderr=theirs, stdout=subprocess.PIPE) as process:
        os.close(theirs)
        seen = b""
        while b"installed in" not in seen:
            seen += os.read(ours, 4096)
        assert process.wait(20.0) == 0
    os.close(ours)
    assert b"installing: 1 packages, loading numba (3.8 MB), " in seen, seen
    assert b"installing: 2 packages, unpacking 3 packages, the last step, " in seen, seen

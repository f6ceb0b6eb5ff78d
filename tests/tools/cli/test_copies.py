"""A command in a copy of a process is what a new process is, see `copies`."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from copies import Copy
from processes import PATIENT, RIGS, ROOT, Running, alive, own_bus, pcpc, until

TESTS = ROOT / "tests"
KILLED = """
import os, signal, sys
from pathlib import Path
from hosting import hosting
from processes import PATIENT, Running
rig, bus, folder = sys.argv[1:]
words = ("run", rig, "--bus", bus, "--set", "duration_s=3600", *PATIENT, "--no-figure")
with (
    Running(*words, cwd=Path(folder)) as run, hosting(Path(folder)) as copy,
    hosting(Path(folder), before=["env"]) as new,
):
    run.pid("recorder")
    print(run.process.pid, *run.children.values(), copy.process.pid, new.process.pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""
PROBE = str(RIGS.parents[1] / "probe" / "rig.yaml")


@pytest.mark.parametrize(
    ("words", "code"), [("check rig.yaml --json", 0), ("check no.yaml", 2), ("--version", 0)]
)
def test_it_does_what_a_new_process_does(words: str, code: int, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(f"base: {PROBE}\nrig: mine\n")
    copy = pcpc(*words.split(), cwd=tmp_path)
    new = pcpc(*words.split(), cwd=tmp_path, before=["env"])
    assert (copy.code, copy.out, copy.err) == (new.code, new.out, new.err), f"{copy}\n{new}"
    assert copy.code == code, copy


def test_it_has_a_session_of_its_own_and_ends_by_signals(tmp_path: Path) -> None:
    words = ("run", PROBE, "--bus", own_bus(), "--set", "duration_s=3600", *PATIENT, "--no-figure")
    for number, code in ((signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)):
        with Running(*words, cwd=tmp_path) as running:
            assert isinstance(running.process, Copy)
            running.pid("executive")
            assert os.getsid(running.process.pid) == running.process.pid
            running.process.send_signal(number)
            assert running.done().code == code, running
            assert not alive(running.process.pid) and running.left() == []


def test_what_killed_tests_had_started_ends(tmp_path: Path) -> None:
    path = os.pathsep.join(map(str, (TESTS, TESTS / "tools", ROOT)))
    tests = subprocess.run(
        [sys.executable, "-c", KILLED, PROBE, own_bus(), str(tmp_path)],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        cwd=ROOT,
    )
    pids = [*map(int, tests.stdout.split())]
    assert tests.returncode == -signal.SIGKILL and len(pids) >= 5, tests
    until(lambda: not any(map(alive, pids)), f"{pids} end")


def test_what_is_read_at_a_start_comes_from_a_new_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONVERBOSE", "1")
    done = pcpc("--version")
    assert "import 'pcpc.tools.cli'" in done.err, done

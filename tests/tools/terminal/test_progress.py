"""What takes longer than a moment says so, also where nobody can tell how far it is."""

import os
import queue
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from live_run import Screen
from logcommand import barrel_log
from places import PATIENCE_S

from pcpc.drivers.compiled.compile_cache import source_hash
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import source
from pcpc.tools.terminal import progress
from pcpc.tools.terminal.progress import Compiling, Progress


def test_what_cannot_tell_how_far_it_is_is_told_while_it_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said: queue.Queue[str] = queue.Queue()
    err = SimpleNamespace(write=said.put, flush=lambda: None, isatty=lambda: False)
    monkeypatch.setattr(sys, "stderr", err)
    monkeypatch.setattr(progress, "_PATIENCE_S", 1e-3)
    monkeypatch.setattr(progress, "_LINES_S", 0.0)
    with Progress().going_on("it sorts"):
        lines = [said.get(timeout=PATIENCE_S) for _ in range(3)]
    assert lines == ["it sorts, 0 s\n"] * 3
    while not said.empty():
        said.get()
    with pytest.raises(queue.Empty):
        said.get(timeout=0.05)


def test_what_was_compiled_since_a_command_began_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def compiled(name: str, age_s: float) -> None:
        file = tmp_path / source_hash() / "laws" / f"{name}.nbc"
        file.parent.mkdir(exist_ok=True, parents=True)
        file.touch()
        os.utime(file, times=(time.time() - age_s,) * 2)

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "laws" / "none"))
    first = Compiling()
    assert "once: 0 of about " in first.text()
    compiled("before", age_s=60.0)
    later = Compiling()
    assert later.text() == ""
    for name in ("one", "two"):
        compiled(name, age_s=-60.0)
    assert "once: 2 functions, " in later.text() and "once: 2 of about " in first.text()


def test_a_log_that_takes_long_to_read_says_how_far_it_is(
    capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = barrel_log("pd")
    whole = logs.read(path)
    quiet = source.read(path, Progress(quiet=True))
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(source, "_PATIENCE_S", -1.0)
    told = source.read(path, Progress())
    assert capsys.readouterr().err.startswith(f"{path}: 0 of 0 MiB")
    for log in (quiet, told):
        assert log.missing == [] and log.node.keys() == whole.node.keys()
        for role, node in whole.node.items():
            for name, values in node.columns.items():
                np.testing.assert_array_equal(log.node[role].columns[name], values)


def test_a_long_wait_is_told_in_few_lines_and_what_is_new_at_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now_s)
    shown = progress.Progress()
    for tenths in range(3000):
        now_s = 0.1 * tenths
        what = "the device" if tenths < 2500 else "SYNC"
        shown.show(f"waiting for {what}, {now_s:.0f} s")
    told = capsys.readouterr().err.splitlines()
    assert 8 <= len(told) <= 16, told
    first = next(line for line in told if "SYNC" in line)
    assert 250 <= int(first.split()[-2]) <= 252, told
    for tenths in range(3000, 3100):
        now_s = 0.1 * tenths
        shown.show(f"RUN cycle {tenths} 1000 Hz")
    told = capsys.readouterr().err.splitlines()
    assert len(told) <= 6, told

"""What a recording does to its reader ends in a line with an exit code; nothing is left of it."""

import gzip
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import pytest
from foreign import START_S, blf_container, blf_file
from places import PATIENCE_S

from pcpc.drivers.errors import Exit
from pcpc.tools.after.log import recording
from pcpc.tools.after.log.readers import child
from pcpc.tools.after.log.recording import ForeignRecording, read
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

OWN_READERS = True
LIMITS = child.ReaderLimits(600 << 20, 4 << 20, 1.0)


@pytest.fixture(autouse=True)
def _temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give them a folder of their own."""
    (tmp_path / "t").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "t"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "t"))


def database(folder: Path, columns: str, rows: str = "") -> Path:
    """Write python-can's SQLite file whose rows are counted without end."""
    table = sqlite3.connect(path := folder / "a.db")
    counter = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
    table.execute(f"CREATE VIEW messages AS {counter} SELECT {columns} FROM c {rows}")
    table.close()
    return path


def long(folder: Path) -> Path:
    """Write more frames than a pipe holds."""
    text = f"({START_S}.5) can0 100#\n" * 60_001
    (path := folder / "a.log.gz").write_bytes(gzip.compress(text.encode(), 1))
    return path


def hanging(folder: Path) -> Path:
    return database(folder, "x, 256, 0, 0, 0, 0, NULL", "WHERE x < 0")


def greedy(folder: Path) -> Path:
    return database(folder, "x, 256, 0, 0, 0, 700000000, zeroblob(700000000)")


def packed(folder: Path) -> Path:
    (path := folder / "a.log.gz").write_bytes(gzip.compress(bytes(40 << 20), 1))
    return path


def container(folder: Path) -> Path:
    (path := folder / "a.blf").write_bytes(blf_file([blf_container(bytes(200 << 20))], 1))
    return path


def children() -> list[int]:
    """Return the processes that this one has."""
    return [int(pid) for task in Path("/proc/self/task").iterdir()
            for pid in (task / "children").read_text().split()]  # fmt: skip


def recorded(
    path: Path, progress: Progress, limits: child.ReaderLimits | None
) -> ForeignRecording | str:
    """Read a file; return the recording, or the error's line. No process and no file is left."""
    before, outcome = children(), ""
    try:
        return read(path, None, progress, limits)
    except LogCommandError as error:
        outcome = f"{error} [{error.code}]"
    finally:
        assert children() == before and not list((path.parent / "t").iterdir())
    assert outcome.count("\n") == 0 and outcome.startswith(f"{path}: "), outcome
    return outcome


class _Meanwhile(Progress):
    """Does something once the first frames are there."""

    def __init__(self, action: Callable[[], None]) -> None:
        super().__init__(quiet=True)
        self._action = action

    def show(self, text: str) -> None:
        assert text.endswith(" frames"), text
        self._action()


def sent(number: signal.Signals) -> _Meanwhile:
    """Send a signal to the reader."""
    return _Meanwhile(lambda: os.kill(children()[-1], number))


QUIET = Progress(quiet=True)
CUT_MDF = (b"MDF     4.10    pcpc    " + bytes(4) + (410).to_bytes(2, "little")).ljust(64, b"\0")
CUT_MDF += b"##HD" + bytes(4) + (104).to_bytes(8, "little") + (6).to_bytes(8, "little") + bytes(48)


@pytest.mark.parametrize(
    ("made", "progress", "limits", "said"),
    [
        (packed, QUIET, LIMITS, f"{child.UNPACKS} [2]"),
        (long, QUIET, replace(LIMITS, bytes=1_550_000), f"{child.UNPACKS} [2]"),
        (hanging, QUIET, LIMITS, "its reader hangs after 0 frames or a few more: "),
        (greedy, QUIET, LIMITS, "needs more than 600 MiB of memory after 0 frames: "),
        (container, QUIET, replace(LIMITS, memory_bytes=300 << 20), "more than 300 MiB"),
        (long, sent(signal.SIGKILL), None, "its reader was killed after 20000 frames"),
        (long, sent(signal.SIGSEGV), None, "its reader crashed by SIGSEGV after 20000 f"),
    ],
)  # fmt: skip
def test_what_ends_a_reader_is_one_line(
    made: Callable[[Path], Path], progress: Progress, limits: child.ReaderLimits | None, said: str,
    tmp_path: Path,
) -> None:  # fmt: skip
    outcome = recorded(made(tmp_path), progress, limits)
    assert isinstance(outcome, str) and said in outcome, outcome
    code = Exit.ENVIRONMENT if "killed" in said else Exit.WRONG_INPUT
    assert outcome.endswith(f"[{code}]"), outcome


def test_a_reader_that_does_not_start_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child, "word", lambda *_: "no word")
    outcome = recorded(long(tmp_path), QUIET, None)
    assert isinstance(outcome, str) and "with exit code 1 (json.decoder." in outcome, outcome


def test_whoever_stops_an_import_stops_its_reader(tmp_path: Path) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recorded(long(tmp_path), _Meanwhile(stop), None)
    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, 1.0)
    with pytest.raises(KeyboardInterrupt):  # from a reader that never writes
        recorded(hanging(tmp_path), QUIET, replace(LIMITS, stall_s=60.0))
    signal.signal(signal.SIGALRM, before)


def test_a_reader_ends_with_the_program_that_started_it(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from pcpc.tools.after.log import recording as r; "
    code += "r.read(Path(sys.argv[1]), None, r.Progress(True))"
    with subprocess.Popen([sys.executable, "-c", code, hanging(tmp_path)]) as program:
        task = Path(f"/proc/{program.pid}/task/{program.pid}/children")
        while not (own := task.read_text().split()):
            assert program.poll() is None
        while b"child" not in (command := Path(f"/proc/{own[0]}/cmdline")).read_bytes():
            assert program.poll() is None
        program.kill()
    is_there_until_s = time.monotonic() + PATIENCE_S
    while command.exists() and command.read_bytes():
        assert time.monotonic() < is_there_until_s, "it computes on"


def test_a_reader_of_its_own_reads_what_one_here_reads(tmp_path: Path) -> None:
    lines = "".join(f"({START_S}.{i:06d}) can{i % 2} 100#{i:04X}\n" for i in range(40_001))
    (tmp_path / "a.log").write_text(lines + f"({START_S + 1}.0) can0 101##1AA\nwhat is it\n")
    seen: list[None] = []
    found = recorded(tmp_path / "a.log", _Meanwhile(lambda: seen.append(None)), None)
    assert isinstance(found, ForeignRecording)
    data = [row["data"][: row["dlc"]].tobytes() for row in found.frames]
    assert data == [i.to_bytes(2, "big") for i in range(40_001)] + [b"\xaa"]
    assert dict(found.channels) == {"can0": 20_002, "can1": 20_000} and len(seen) == 4
    assert found.account.damage == ["line 40003: no line of candump: 'what is it'"]
    one = read(tmp_path / "a.log", "can1", QUIET).frames
    assert len(one) == 20_000 and one["data"].shape[1] == 8


def test_what_a_library_prints_is_not_shown(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Of a damaged file asammdf prints a traceback as its object is deleted."""
    (tmp_path / "a.mf4").write_bytes(CUT_MDF)
    outcome = recorded(tmp_path / "a.mf4", QUIET, None)
    assert "damaged after 0 frames" in str(outcome), outcome
    assert capfd.readouterr() == ("", "")


def test_a_stream_that_is_cut_anywhere_is_no_end(tmp_path: Path) -> None:
    text = "(1.5) can0 100#1122\n" * 3
    (path := tmp_path / "a.log").write_text(text)
    child.write(stream := BytesIO(), path, None, LIMITS)
    whole = stream.getvalue()
    for size in range(len(whole)):
        with pytest.raises(EOFError):
            recording._last_word(BytesIO(whole[:size]), [], LIMITS, path, QUIET)


class _Counted(child.ReaderLimits):
    """Counts how often a reader's time begins anew."""

    times = 0

    def be_patient(self) -> None:
        _Counted.times += 1


def test_a_readers_time_begins_anew_with_each_block(tmp_path: Path) -> None:
    child.write(BytesIO(), long(tmp_path), None, _Counted(1, 1, 1.0))
    assert _Counted.times == 3


def test_the_limits_grow_with_the_file(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x" * 10_000)
    small = child.ReaderLimits.of(tmp_path / "a")
    os.truncate(tmp_path / "a", 500_000_000)
    large = child.ReaderLimits.of(tmp_path / "a")
    assert large.bytes - small.bytes == 200 * 499_990_000 == large.memory_bytes - small.memory_bytes
    assert small.stall_s < 11.0 and large.stall_s > 500.0

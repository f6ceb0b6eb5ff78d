"""Files that the page asks for: a recording from now on, or what the host has seen last.

One recording at a time, for all clients; it has taps of its own and a thread, so that no disk holds
the server or the loop. Names come from the time and the rig, never from a client. All files of a
host together have at most so many bytes; a recording that reaches them, or whose disk has no more
room, is ended, with the reason, and what is in it opens. It is handed to the kernel every FLUSH_S.
"""

import re
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import code_of
from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes.tap import Tap
from pcpc.tools.after.log.part import LogPart
from pcpc.tools.live.host.commands import PageRequest
from pcpc.tools.live.host.sources import RunSource, Stretch

FOLDER, MOST_MB = Path("runs/host"), 4000
POLL_S, FLUSH_S = 0.05, 0.5
_MB = 1e6


class RunRecording:
    """A file that grows with a run, until somebody ends it, or no bytes are `left`."""

    def __init__(self, source: RunSource, path: Path, left: Callable[[], float]) -> None:
        self.path, self.why, self.cycles = path, "", 0
        self._source, self._left, self.size = source, left, 0
        self._taps: dict[str, Tap] = {}
        self._part = LogPart(path)
        try:
            self._look()  # from here on, whenever the thread begins
        except OSError:
            self._part.give_up()
            raise
        self._asked = threading.Event()
        self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    @property
    def going(self) -> bool:
        """Whether it is still written."""
        return self._thread.is_alive()

    @property
    def lost(self) -> int:
        """Rows that were overwritten in a ring before they were read."""
        return sum(sum(tap.missed.values()) for tap in self._taps.values())

    def end(self) -> None:
        """End it; return once the file is whole."""
        self._asked.set()
        self._thread.join()

    def _write(self) -> None:
        try:
            flushed_s = time.monotonic()
            while not self._asked.wait(POLL_S):
                is_over = not any(node.live.running for node in self._source.nodes.values())
                self._look()
                full = False
                if time.monotonic() - flushed_s >= FLUSH_S:
                    flushed_s = time.monotonic()
                    self._part.flush()
                    full = self._left() <= 0.0
                self.size = self._part.size
                if is_over or full:
                    self.why = "the run has ended" if is_over else "all recordings have their size"
                    break
            else:
                self._look()
            self._part.close({role: tap.missed for role, tap in self._taps.items()})
            self.size = self.path.stat().st_size
        except OSError as error:
            self.why = f"{error.strerror}; what was written until then opens"
            self._part.give_up()

    def _look(self) -> None:
        """Write what the nodes have put since; take up those that have come."""
        for role, node in list(self._source.nodes.items()):
            if role not in self._taps:
                self._part.node(node.description)
                self._taps[role] = Tap(node.live)
        for role, tap in self._taps.items():
            for ring in sh.RINGS:
                self._part.nodes[role].add(ring, tap.raw(ring))
        self.cycles = max((part.written["record"] for part in self._part.nodes.values()), default=0)


class Recordings:
    """The files of one run, in `folder`; those of all runs of a host, `files`, have `most_mb`."""

    def __init__(
        self, folder: Path = FOLDER, most_mb: int = MOST_MB, files: list[Path] | None = None
    ) -> None:
        self._folder, self._most = folder, most_mb * _MB
        self._files = [] if files is None else files
        self._recording: RunRecording | None = None
        self._turn = threading.Lock()  # of those who begin a file
        self._snapping = threading.Lock()

    def start(self, source: RunSource) -> dict[str, Any]:
        """Begin a recording of a running source; UserError."""
        with self._turn:
            if one := self.running:
                raise UserError(f"{one.path} is being recorded already")
            self._check_room()
            path = self._new(source.rig, "")
            cycles = [int(node.live.block.control.cycle) for node in source.nodes.values()]
            try:
                self._recording = RunRecording(source, path, self._left)
            except OSError as error:
                raise self._failed(path, error) from None
            return {"file": str(path), "cycle": min(cycles) + 1}

    def stop(self) -> dict[str, Any]:
        """End the recording; UserError if there is none."""
        with self._turn:
            if (recording := self.running) is None:
                raise UserError("nothing is being recorded")
            recording.end()
            if recording.why:
                raise UserError(f"{recording.path}: {recording.why}")
            return {"file": str(recording.path), "cycles": recording.cycles}

    @property
    def running(self) -> RunRecording | None:
        """The recording that goes on."""
        return self._recording if self._recording and self._recording.going else None

    def snapshot(self, source: RunSource, last_s: float) -> dict[str, Any]:
        """Write the newest `last_s` seconds that the host has of a running source; UserError."""
        if not self._snapping.acquire(blocking=False):
            raise UserError("a snapshot is being written; ask again")
        try:
            self._check_room()
            stretches = [node.newest(last_s) for node in source.nodes.values()]
            cycles = [
                int(k) for part in stretches if len(part.rows) for k in part.rows.cycle[[0, -1]]
            ]
            if not cycles:
                raise UserError("the host has seen no cycle yet")
            with self._turn:
                path = self._new(source.rig, "-last")
            try:
                _write(path, stretches)
            except OSError as error:
                raise self._failed(path, error) from None
            return {"file": str(path), "first": min(cycles), "last": max(cycles)}
        finally:
            self._snapping.release()

    def state(self) -> dict[str, Any] | None:
        """Return what is told of the recording, None as long as there was none."""
        recording = self._recording
        return None if recording is None else {
            "file": str(recording.path), "going": recording.going, "cycles": recording.cycles,
            "mb": recording.size / _MB, "lost": recording.lost, "why": recording.why,
        }  # fmt: skip

    def close(self) -> None:
        """End what is being written."""
        with self._turn:
            if self._recording is not None:
                self._recording.end()

    def _left(self) -> float:
        """Return how many bytes may still be written, by all recordings of the host together."""
        used = 0
        for path in list(self._files):
            with suppress(OSError):
                used += path.stat().st_size
        return self._most - used

    def _check_room(self) -> None:
        if (left := self._left()) <= 0.0:
            used_mb = (self._most - left) / _MB
            told = f"{self._folder}: recordings of {used_mb:.0f} MB, the limit"
            raise UserError(f"{told}; delete some, or start with a larger --recordings-mb")

    def _new(self, rig: str, kind: str) -> Path:
        """Return a file that was not there; UserError."""
        name = re.sub(r"[^a-z0-9._-]", "_", rig.lower())[:64].lstrip(".")
        stem = f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{name}{kind}"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            for number in range(1000):
                path = self._folder / f"{stem}{f'-{number}' if number else ''}.mcap"
                with suppress(FileExistsError):
                    path.touch(exist_ok=False)
                    self._files.append(path)
                    return path
        except OSError as error:
            raise self._failed(self._folder, error) from None
        raise UserError(f"{self._folder}: too many files of this second")

    def _failed(self, path: Path, error: OSError) -> UserError:
        """Return the error of a file that could not be begun, which is taken away."""
        if path in self._files:
            self._files.remove(path)
            with suppress(OSError):
                path.unlink()
        what = f"{path}: cannot be written: {error.strerror}; see --recordings"
        return UserError(what, code_of(error))


def recordings_of(page: PageRequest, files: list[Path]) -> Recordings:
    """Return the recordings of a run, of a page that has written `files`."""
    return Recordings(page.recordings or FOLDER, page.recordings_mb or MOST_MB, files)


def _write(path: Path, stretches: Sequence[Stretch]) -> None:
    """Write stretches of nodes as a log; OSError."""
    part = LogPart(path)
    try:
        for stretch in stretches:
            node = part.node(stretch.about)
            node.add("record", node.rows(stretch.rows))
            node.add("frame", stretch.frames)
            node.add("event", stretch.events)
        part.close({name: dict.fromkeys(sh.RINGS, 0) for name in part.nodes})
    except OSError:
        part.give_up()
        raise

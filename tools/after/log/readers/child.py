"""A process that reads one recording, so that its parent outlives whatever the file does to it.

    ["drive.blf", null, 4123, 4.5e9, 2e8, 11.0]     its word: file, channel, parent, `ReaderLimits`
    {"rows": 20000, "width": 8}, rows               its output: a line of JSON, rows of `row_type`
    {"end": {..., "left_out": {"error": 2}}, ...}   at last the account, the channels and their
    {"error": "a.blf: no BLF file", "code": 2}      frames; or why there is none

Rows are data frames in the order of the file. `source` is a number for each channel and id.
"""

import errno
import json
import math
import os
import resource
import signal
import struct
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.drivers.errors import Exit, UserError, printable
from pcpc.tools.after.log.readers.account import (
    CLASSIC_BYTES,
    Account,
    NotReadError,
    RecordedFrame,
)
from pcpc.tools.after.log.readers.formats import frames_of
from pcpc.tools.start.children import end_with

UNPACKS = "it unpacks to more than 200 times its size"
WHOLE = "give the whole recording"
AT_ONCE = 20_000  # frames


@dataclass(frozen=True)
class ReaderLimits:
    """What a reader may take; `bytes`: of unpacked files, and of rows."""

    memory_bytes: int
    bytes: int
    stall_s: float  # of computing without rows

    @classmethod
    def of(cls, path: Path) -> "ReaderLimits":
        """Return those for a file of this size."""
        size = path.stat().st_size
        return cls((4 << 30) + 200 * size, (16 << 20) + 200 * size, 10.0 + 1e-6 * size)

    def apply(self) -> None:
        """Limit this process, as far as the machine can do that."""
        _limit(resource.RLIMIT_AS, self.memory_bytes)
        _limit(resource.RLIMIT_FSIZE, self.bytes)
        _limit(resource.RLIMIT_CORE, 0)
        self.be_patient()

    def be_patient(self) -> None:
        """Count the time without rows from now on."""
        spent = resource.getrusage(resource.RUSAGE_SELF)
        _limit(resource.RLIMIT_CPU, spent.ru_utime + spent.ru_stime + self.stall_s)


def _limit(kind: int, most: float) -> None:
    with suppress(
        ValueError, OSError, OverflowError
    ):  # a stricter limit holds already, or the system has none
        resource.setrlimit(kind, (math.ceil(most), resource.getrlimit(kind)[1]))


def row_type(width: int) -> np.dtype[Any]:
    """Return the type of a row whose data have room for `width` bytes."""
    names = {"stamp_ns": "<i8", "id": "<u4", "source": "<u4"}
    names |= dict.fromkeys(("dlc", "direction", "flags"), "u1")
    return np.dtype([*names.items(), ("data", "u1", (width,))])


class _Rows:
    """Packs data frames into rows, counts those that are left out."""

    def __init__(self, out: IO[bytes], channel: str | None, account: Account) -> None:
        self._out, self._channel, self._account = out, channel, account
        self._known: dict[tuple[str, int], int] = {}
        self._rows, self.channels = bytearray(), Counter[str]()
        self._pack_for(CLASSIC_BYTES)

    def _pack_for(self, width: int) -> None:
        self._width, self._row = width, struct.Struct(f"<qLLBBB{width}s")

    def take(self, frame: RecordedFrame) -> None:
        """Take one frame."""
        name = ""
        if frame.channel is not None:
            name = printable(frame.channel)
            self.channels[name] += 1
            if self._channel not in (None, name):
                return
        if frame.kind:
            self._account.left_out[frame.kind] += 1
            return
        if frame.flags and self._width == CLASSIC_BYTES:
            self.send()
            self._pack_for(LENGTHS[-1])
        word = can_id.word_of(frame.number, frame.extended)
        self._rows += self._row.pack(
            frame.time_ns, word, self._known.setdefault((name, word), len(self._known)),
            len(frame.data), frame.is_received, frame.flags, frame.data,
        )  # fmt: skip

    def send(self) -> None:
        """Hand on the rows so far."""
        head = {"rows": len(self._rows) // self._row.size, "width": self._width}
        self._out.write(json.dumps(head).encode() + b"\n" + self._rows)
        self._out.flush()
        self._rows.clear()


def write(out: IO[bytes], path: Path, channel: str | None, limits: ReaderLimits) -> None:
    """Write what a recording holds, or in an error why that is nothing."""
    last = _outcome(out, path, channel, limits)
    out.write(json.dumps(last).encode() + b"\n")
    out.flush()


def _outcome(
    out: IO[bytes], path: Path, channel: str | None, limits: ReaderLimits
) -> dict[str, Any]:
    """Write the rows; return the account or the error."""
    account, number = Account(), 0
    rows = _Rows(out, channel, account)
    code = Exit.WRONG_INPUT
    try:
        with frames_of(path, account) as frames:
            for number, frame in enumerate(frames, 1):
                rows.take(frame)
                if number % AT_ONCE == 0:
                    rows.send()
                    limits.be_patient()
        rows.send()
        return {"end": vars(account), "channels": rows.channels}
    except BrokenPipeError:
        raise
    except NotReadError as error:
        text = f"{path}: {error}"
    except UserError as error:
        text, code = str(error), error.code
    except NotImplementedError as error:  # a reader that needs another package
        text, code = f"{path}: {error}", Exit.ENVIRONMENT
    except MemoryError:
        most = f"more than {limits.memory_bytes >> 20} MiB of memory"
        text = f"{path}: needs {most} after {number} frames: it is damaged there; {WHOLE}"
    except OSError as error:
        text = f"{path}: {error.strerror or error}; is it whole?"
        if error.errno == errno.EFBIG:
            text = f"{path}: {UNPACKS}"
    except Exception as error:  # asammdf and python-can let everything through
        reason = printable(" ".join(str(error).split())[:300]) or type(error).__name__
        text = f"{path}: damaged after {number} frames ({reason}); {WHOLE}"
    return {"error": text, "code": code}


def word(path: Path, channel: str | None, limits: ReaderLimits) -> str:
    """Return the word of a process that this one starts."""
    return json.dumps([str(path), channel, os.getpid(), *astuple(limits)])


def main() -> None:
    """Be that process."""
    name, channel, parent, *most = json.loads(sys.argv[1])
    with suppress(AttributeError):  # only Linux tells of a parent's end; elsewhere its pipe does
        end_with(parent, signal.SIGKILL)
    limits = ReaderLimits(*most)
    limits.apply()
    with suppress(BrokenPipeError):
        write(sys.stdout.buffer, Path(name), channel, limits)


if __name__ == "__main__":
    main()

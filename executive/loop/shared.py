"""The memory of one node: variables, counters, rings and mailbox, ordered by who may write it.

    PUBLISHED   the node writes, clients read: control words, answers, snapshot, statistics, rings
    MAILBOX     clients write, the node trusts nothing of it: tunings, lock, rows taken
    the rest    only the loop has it: the table, wiring, limits, frames, the bus

    snapshot    seqlock: the writer makes `seq` odd, copies, makes it even; it starts with
                `seq | 1`, so that a writer killed in mid-copy does not invert the parity.
                Readers retry a bounded number of times.
    rings       one row a cycle, a frame, an event, see `executive.loop.ring_layout`
    mailbox     tunings: indices and values, taken by the loop between two cycles, all or none

Each ring has one writer (the loop) and one reader (the recorder): `ends` holds rows put (head) and
dropped, `taken` in the mailbox rows taken. How clients get it: `executive.loop.sharing`. A
description in JSON goes with it: the variables with unit and writer, the columns of a row, the rig.
"""

import contextlib
import mmap
import os
import re
import socket
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.wire_layout import WIRE
from pcpc.drivers.canopen.layout import DRIVE
from pcpc.drivers.compiled.rows import FRAME, RECEIVER, SIGNAL, row_of
from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.robots.layout import ROBOT
from pcpc.executive.loop import ring_layout
from pcpc.executive.loop.control import CONTROL
from pcpc.executive.loop.injection_layout import faults
from pcpc.executive.loop.reception_layout import (
    LOSS,
    LOSS_STATE,
    STREAK,
    intrusion,
    meeting,
    plausible,
)
from pcpc.executive.loop.requests import ANSWER, MAIL, SLOTS
from pcpc.executive.loop.ring_layout import ENDS, EVENT_ROW, EVENT_WORDS, FRAME_WORDS, RECORD_HEAD
from pcpc.executive.loop.timing_layout import BUCKETS, FIGURES, LATE, LATEST, STAGES, USAGE

CDR_HEADER = 1 << 40  # as int64, little-endian: four bytes of padding, then 00 01 00 00

RECORDER_PATIENCE = 12  # times the patience with a node that may wait for the recorder
LINE_WORDS = 8  # what two processes write lies on lines of its own
PAGE_BYTES = mmap.PAGESIZE

RINGS = ("record", "frame", "event")
GREETING = 0x1FFFFFE0  # 29 bits, the last in every arbitration; see `executive.nodes.greeting`

# Sizes are fixed, so that one compiled loop serves every rig; `nodes.plan` checks the fit.
MAX_VARIABLES = 8192
MAX_BLOCKS = 8
MAX_COPIES = 1024
MAX_LIMITS = 64
MAX_FRAMES = 32
MAX_PEERS = 16  # nodes below one
MAX_SIGNALS = 256
MAX_SCHEDULE = 2048
RECORD_RING_WORDS = 1 << 20  # 8 MiB: ten seconds of a 100-column record at 1 kHz
FRAME_RING_WORDS = FRAME_WORDS << 16  # six seconds of ten classic frames a cycle at 1 kHz
EVENT_RING_ROWS = 1 << 10
KEYFRAME_WORDS, MAX_SPANS = 1 << 15, 64  # 256 KiB: the largest node fills half of it

_ROLE = row_of("starts awaited peer meeting")  # of a received frame; peer: of the node waited for
_KIND = row_of("is_sync is_heartbeat is_emergency told")  # of a sent frame; told: its last code
_MOMENT, _COPY = row_of("cycle place"), row_of("source target")
_VIEWS = row_of("p p_end x x_end u u_end y y_end")  # of a block
_LIMIT = row_of("", "low high rate last safe sent")  # rate: a cycle; last: before a ramp

# The record of a node, ordered by who may write it; each part begins on a page of its own.
_PUBLISHED = [  # written by the node, read by all
    ("control", CONTROL),
    ("seq", "<i8", (LINE_WORDS,)),
    ("answer", ANSWER),
    ("record_ends", ENDS),
    ("frame_ends", ENDS),
    ("event_ends", ENDS),
    ("snapshot", "<f8", (MAX_VARIABLES,)),
    ("stages", FIGURES, (STAGES,)),
    ("histogram", "<i8", (STAGES, BUCKETS)),
    ("latest", LATE, (LATEST,)),
    ("keyframe_seq", "<i8", (LINE_WORDS,)),  # see `executive.loop.keyframe_layout`
    ("keyframe", "<i8", (KEYFRAME_WORDS,)),
    ("record", "<i8", (RECORD_RING_WORDS,)),
    ("frame", "<i8", (FRAME_RING_WORDS,)),
    ("event", EVENT_ROW, (EVENT_RING_ROWS,)),
]
_MAILBOX = [  # written by clients, which the loop does not trust
    ("mail", MAIL),
    ("mail_index", "<i8", (SLOTS,)),
    ("mail_value", "<f8", (SLOTS,)),
    ("record_taken", "<i8", (LINE_WORDS,)),
    ("frame_taken", "<i8", (LINE_WORDS,)),
    ("event_taken", "<i8", (LINE_WORDS,)),
]
# of the loop alone, each a record of its own: what was set once, then what the loop keeps
_CLOCK = [
    ("kind", "<i8"),  # of `executive.loop.clock`
    ("trigger", "<i8"),  # what starts a cycle: CLOCKED, ON_FRAMES
    ("arm_pass", "<i8"),  # the pass after which the clock runs
    ("period_ns", "<i8"),
    ("phase_ns", "<i8"),  # of the deadlines, on the common grid of whole periods
    ("late_ns", "<i8"),  # a cycle that starts later than this counts as late
    ("wall_offset_ns", "<i8"),  # wall time minus the clock of the loop
    ("deadline", "<i8"),
    ("wake", "<i8"),
    ("behind", "<i8"),  # periods skipped just before this cycle
    ("now_ns", "<i8"),  # of a clock that somebody else sets
    ("timespec", "<i8", (2,)),
]
_RX = [
    ("n", "<i8"),
    ("frames", FRAME, (MAX_FRAMES,)),  # tables of drivers.can.dbc
    ("signals", SIGNAL, (MAX_SIGNALS,)),
    ("role", _ROLE, (MAX_FRAMES,)),
    ("loss", LOSS, (MAX_FRAMES,)),  # of `executive.loop.losses`
    ("listen_ns", "<i8"),  # before the first word on a bus
    ("patience", "<i8"),  # receive time-outs until the other node counts as silent
    ("starters", "<i8"),  # frames that start a cycle, and frames awaited in it
    ("awaited", "<i8"),
    ("started", "<i8"),  # those of this cycle so far
    ("fresh", "<i8"),
    ("state", RECEIVER, (MAX_FRAMES,)),  # see drivers.can.e2e
    ("source", "<i8", (MAX_FRAMES,)),  # who sends them, see `executive.loop.strangers`
    *((name, STREAK) for name in ("foreign", "repeats")),
    ("loss_state", LOSS_STATE, (MAX_FRAMES,)),
]
_GUARD = [  # the supervisor
    ("cycles", "<i8"),  # of the run
    ("hold_cycles", "<i8"),
    ("fault_after", "<i8"),
    ("mode_index", "<i8"),  # the received variable that asks for STOP, or -1
    ("overrun_policy", "<i8"),  # of `executive.loop.supervisor`
    ("overrun_after", "<i8"),  # overruns in a row that count
    ("grace_passes", "<i8"),  # cycles at the start in which none does
    ("odd_output", "<i8"),  # the fault when an output is no finite number
    ("safe_start", "<i8"),  # 1: before the first valid input commands are safe
    ("waits", "<i8"),  # 1: FAULT lasts until a reset; 0: until its ramp is over
    ("manual", "<i8"),  # 1: a fault disarms
    ("estop_index", "<i8"),  # the received variable that is an emergency stop, or -1
    ("stop_row", "<i8"),  # the received frame that is a stop, or -1
    ("ramp_step", "<f8"),  # change of the gain a cycle in FAULT
    ("quick_step", "<f8"),  # the same of a quick stop
    ("n_safe", "<i8"),
    ("safe_index", "<i8", (MAX_LIMITS,)),
    ("safe", row_of("", "last safe"), (MAX_LIMITS,)),
    *((name, "<i8") for name in ("missing", "overruns")),  # cycles in a row: no valid input, late
    *((name, "<i8") for name in ("faulted", "disarmed")),
    ("reset", "<i8"),  # 1: asked for in the cycle before
    ("stop", "<i8"),  # 1: the end was asked for
    ("off", "<i8"),  # 1: the CAN controller is bus-off
    ("quick", "<i8"),  # of `executive.loop.limits`
    ("gain", "<f8"),  # 1, or how far the ramp of FAULT or of the end has come down
    ("pace", "<f8"),  # its change a cycle; 0 before a ramp
]
_TUNING = [
    ("low", "<f8", (MAX_VARIABLES,)),  # of a parameter; nan for all other variables
    ("high", "<f8", (MAX_VARIABLES,)),
    ("n", "<i8"),
    ("schedule", _MOMENT, (MAX_SCHEDULE,)),  # of the scheduled tunings, by cycle
    ("value", "<f8", (MAX_SCHEDULE,)),
    ("done", "<i8"),  # those of the schedule that were applied
    ("asked_index", "<i8", (SLOTS,)),  # a request as it was when it was checked
    ("asked_value", "<f8", (SLOTS,)),
]
_BLOCKS = [
    ("n", "<i8"),
    ("owe_periods", "<i8"),  # 1: after a stall they are stepped for the skipped periods too
    ("controller", "<i8"),  # and the one that replaces it on FALL_BACK, or -1
    ("fallback", "<i8"),
    ("views", _VIEWS, (MAX_BLOCKS,)),
    ("copies", _COPY, (MAX_COPIES,)),  # the wiring
    ("copies_end", "<i8", (MAX_BLOCKS + 1,)),  # end of each block's copies; last: what is sent
    ("n_noted", "<i8"),
    ("noted_index", "<i8", (MAX_LIMITS,)),  # variables whose changes are events
    ("noted", "<f8", (MAX_LIMITS,)),  # their last values
]
_LIMITS = [
    ("n", "<i8"),
    ("place", "<i8", (MAX_LIMITS,)),
    ("table", _LIMIT, (MAX_LIMITS,)),
]
_TX = [
    ("n", "<i8"),
    ("frames", FRAME, (MAX_FRAMES,)),  # in the order of sending
    ("signals", SIGNAL, (MAX_SIGNALS,)),
    ("kind", _KIND, (MAX_FRAMES,)),
    ("last_word", "<i8"),  # of `executive.loop.sending`
    ("first", "<i8"),  # places of what is sent
    ("past", "<i8"),
]
_RINGS = [
    ("wait_recorder", "<i8"),  # lockstep: a full ring delays instead of dropping
    ("record_rows", "<i8"),
    ("frame_rows", "<i8"),
    ("frame_words", "<i8"),  # of a row
    ("n_state", "<i8"),
    ("n_timing", "<i8"),
    ("state_columns", "<i8", (MAX_VARIABLES,)),
    ("timing_columns", "<i8", (MAX_VARIABLES,)),
]
_TIMING = [  # when this cycle did what; see `executive.loop.timing`
    *((name, "<i8") for name in ("received", "stepped", "sent", "done", "publish_ns")),
    ("stage_ns", "<i8", (STAGES,)),
    ("usage", "<i8", (18,)),  # struct rusage
    ("usage_before", "<i8", (len(USAGE),)),
]
_KEEP = [
    ("every", "<i8"),  # passes; 0 for no keyframes
    ("next", "<i8"),  # the pass behind which the next one is published
    ("n", "<i8"),
    ("span", row_of("start length"), (MAX_SPANS,)),  # bytes from `v` on
]
_PRIVATE = [
    ("k", "<i8"),  # the cycle: time is k T
    ("passes", "<i8"),  # cycles done; k minus passes were skipped
    ("n_variables", "<i8"),
    ("v", "<f8", (MAX_VARIABLES,)),  # the table
    *(
        (name, np.dtype(fields, align=True))
        for name, fields in (
            ("clock", _CLOCK), ("rx", _RX), ("meeting", meeting(MAX_FRAMES, MAX_PEERS)),
            ("guard", _GUARD),
            ("tuning", _TUNING), ("faults", faults(MAX_FRAMES)), ("blocks", _BLOCKS),
            ("limits", _LIMITS), ("tx", _TX), ("rings", _RINGS), ("timing", _TIMING),
            ("keep", _KEEP), ("wire", WIRE), ("plausible", plausible(MAX_LIMITS)),
            ("intrusion", intrusion(MAX_FRAMES, MAX_SIGNALS)), ("canopen", DRIVE),
            ("robot", ROBOT),
        )
    ),
]  # fmt: skip


def _whole_pages(fields: list[Any], name: str) -> list[Any]:
    """Return `fields` with a last one that fills their page."""
    rest = -np.dtype(fields, align=True).itemsize % PAGE_BYTES
    return [*fields, (name, "u1", (rest or PAGE_BYTES,))]


_PUBLISHED_PAGES = _whole_pages(_PUBLISHED, "end_of_published")
_MAILBOX_PAGES = _whole_pages(_MAILBOX, "end_of_mailbox")
PUBLISHED = np.dtype(_PUBLISHED_PAGES, align=True)
MAILBOX = np.dtype(_MAILBOX_PAGES, align=True)
PUBLISHED_BYTES, MAILBOX_BYTES = PUBLISHED.itemsize, MAILBOX.itemsize
MAILBOX_FIELDS = [name for name, *_ in _MAILBOX]
LOOP = np.dtype([*_PUBLISHED_PAGES, *_MAILBOX_PAGES, *_PRIVATE], align=True)


class SharedError(UserError):
    """A node's memory cannot be made or is not there."""

    code = Exit.ENVIRONMENT


def block_name(rig: str, bus: str, role: str) -> str:
    """Return the name of a node: one executive and one plant of this user to a rig and bus."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", f"{rig}.{bus}.{role}".replace(":", "-"))


@dataclass(frozen=True)
class Client:
    """What a client holds of a node besides its memory: the line to it and its mailbox file."""

    line: socket.socket
    mailbox: int


class NodeMemory:
    """A node's memory: its fields by name; what is not writable here cannot be written.

    The node's own process has all of them and `loop`, the LOOP record; a client has PUBLISHED and
    MAILBOX, and `client`.
    """

    def __init__(
        self, name: str, description: dict[str, Any], arrays: dict[str, NDArray[Any]],
        loop: Any = None, client: Client | None = None,
    ) -> None:  # fmt: skip
        self.name, self.description, self.loop, self.client = name, description, loop, client
        self.arrays = arrays | {
            "record": rows_of(arrays["record"], description["record_columns"]),
            "frame": rows_of(arrays["frame"], ring_layout.frame_words(description)),
            "event": rows_of(arrays["event"].view(np.int64), EVENT_WORDS),
            "snapshot": arrays["snapshot"][: len(description["variables"])],
        }
        for ring in RINGS:
            self.arrays[f"{ring}_values"] = self.arrays[ring].view(np.float64)
        if client is not None:
            weakref.finalize(self, _let_go, client)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.arrays[name]

    @property
    def control(self) -> Any:
        """The control words, by name."""
        return self["control"]

    @property
    def mail(self) -> Any:
        """The words of a request, by name."""
        return self["mail"]

    @property
    def answer(self) -> Any:
        """The words of the answer to one, by name."""
        return self["answer"]

    def ends(self, ring: str) -> Any:
        """Return the ends of a ring: rows put, `head`, and `dropped`."""
        return self[f"{ring}_ends"]

    def alive(self) -> bool:
        """Return whether the process of the node is there."""
        if self.client is None:
            return True
        try:
            return self.client.line.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) != b""
        except BlockingIOError:
            return True
        except OSError:
            return False

    def tell(self, word: bytes) -> None:
        """Say a word of `executive.loop.sharing` to the node, if it is still there."""
        if self.client is not None:
            with contextlib.suppress(OSError):
                self.client.line.send(word)


def rows_of(words: NDArray[Any], columns: int) -> NDArray[np.int64]:
    """Return the memory (n,) of a ring as rows (n // columns, columns)."""
    rows = len(words) // columns
    return words[: rows * columns].reshape(rows, columns)


def _let_go(client: Client) -> None:
    client.line.close()
    os.close(client.mailbox)


def blank() -> mmap.mmap:
    """Return zeroed private memory for a LOOP record; pages that nobody uses cost nothing."""
    size = -(-LOOP.itemsize // PAGE_BYTES) * PAGE_BYTES
    return mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)


def fields(memory: mmap.mmap, kind: np.dtype[Any]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a structure that begins `memory`, and its records, by name.

    The shapes are those in `kind`.
    """
    record = np.frombuffer(memory, kind, 1)
    names = [name for name in kind.names or () if kind[name].shape or kind[name].names]
    return {name: record[name][0] for name in names}


def private(description: Mapping[str, Any]) -> NodeMemory:
    """Return a node's memory of which only this process knows: virtual time, replay."""
    memory = blank()
    full = full_description("", description)
    return NodeMemory("", full, fields(memory, LOOP), np.recarray(1, LOOP, memory)[0])


def full_description(name: str, description: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a node says about itself, with its name and the size of a row."""
    columns = RECORD_HEAD + len(description["state_columns"]) + 1
    columns += len(description["timing_columns"])
    return dict(description) | {"name": name, "record_columns": columns}


def snapshot(block: NodeMemory, into: NDArray[np.float64] | None = None, tries: int = 100) -> Any:
    """Return a consistent copy of all variables; the old `into` when the writer never paused.

    Both (variables,). Raises SharedError if there is no old copy either.
    """
    seq, values = block["seq"], block["snapshot"]
    for _ in range(tries):
        before = int(seq[0])
        if before & 1:
            continue
        copy = values.copy()
        if int(seq[0]) == before:
            return copy
    if into is None:
        raise SharedError(f"{block.name}: the writer died or never pauses")
    return into

"""The shared block of one node: its variables, counters, rings and mailbox in one file of /dev/shm.

A plain file with mmap (multiprocessing.shared_memory unlinks what it only attached to). The file
begins with a JSON description: the arrays and their places, the variables with unit and writer, the
rig. Readers in other processes attach by name; nothing that they do can delay the loop.

    snapshot    seqlock: the writer makes `seq` odd, copies, makes it even; it starts with
                `seq | 1`, so that a writer killed in mid-copy does not invert the parity.
                Readers retry a bounded number of times.
    records     one row a cycle: [cycle, stamp ns, CDR header, state..., CDR header, timing...]
    frames      one row a frame: [CDR header, stamp ns, cycle, id|dlc|direction|e2e, data]
    events      one row an event: [stamp ns, cycle, code, argument, value as float64 bits]
    mailbox     tunings: indices and values, taken by the loop between two cycles, all or none

Each ring has one writer (the loop) and one reader (the recorder): `ends` holds rows put and
dropped, `taken` in the mailbox rows taken.
"""

import json
import mmap
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.wire_layout import FRAME_BYTES, WIRE

FOLDER = Path("/dev/shm")
MAGIC = b"pcpc 1\0\0"
CDR_HEADER = 1 << 40  # as int64, little-endian: four bytes of padding, then 00 01 00 00

# words of `control`, one cache line (8 words) apart where two processes write
STOP, STATE, CYCLE, DONE, FAULT = 0, 8, 9, 10, 11
PASSES, LATE, SKIPPED, HELD, STALE = 12, 13, 14, 15, 16
SENT, RECEIVED, LOST, CRC_ERRORS, REPEATED = 17, 18, 19, 20, 21
SATURATED, SEND_ERRORS, BUS_ERRNO, FOREIGN, WAKE_MAX_NS = 22, 23, 24, 25, 26
PID, READY, REALTIME = 27, 28, 29
LOST_ON_PURPOSE, REFUSED = 30, 31
CONTROL_WORDS = 64

PUT, DROPPED = 0, 8  # words of a ring's `ends`; its `taken` is one word of the mailbox
END_WORDS = 16
LINE_WORDS = 8  # what two processes write lies on lines of its own
PAGE_BYTES = 4096

REQUEST, COUNT, LOCK = 0, 1, 8  # words of `mail`; LOCK: 0 none, 1 tune, 2 all
MAIL_WORDS = 16
MAIL_SLOTS = 64
ACK, ACK_CYCLE, REFUSAL, REFUSED_ENTRY = range(4)  # words of `answer`
ACCEPTED, BAD_COUNT, NO_PARAMETER, OUT_OF_RANGE, LOCKED = range(5)  # values of REFUSAL

RINGS = ("record", "frame", "event")
RECORD_HEAD = 3  # cycle, stamp, CDR header
FRAME_WORDS = 5
EVENT_WORDS = 5

FAULT_EVENT, STATE_EVENT, TUNING_EVENT, SKIP_EVENT, CHANGE_EVENT = 1, 2, 3, 4, 5
LATE_EVENT, FALLBACK_EVENT, REFUSED_EVENT = 6, 7, 8

# Sizes are fixed, so that one compiled loop serves every rig; `executive.node` checks the fit.
MAX_VARIABLES = 8192
MAX_BLOCKS = 8
MAX_COPIES = 1024
MAX_LIMITS = 64
MAX_FRAMES = 32
MAX_SIGNALS = 256
RECORD_RING_WORDS = 1 << 20  # 8 MiB: ten seconds of a 100-column record at 1 kHz
FRAME_RING_ROWS = 1 << 16  # six seconds of ten frames a cycle at 1 kHz
EVENT_RING_ROWS = 1 << 10

# columns of `limits` (low, high, change a cycle, last value) and `safe` (last value, safe value)
LOW, HIGH, RATE, LAST, SAFE = range(5)
STARTS, AWAITED, PEER = 0, 1, 2  # columns of `rx_role`; PEER: of the node that is waited for
MEETING = 3  # a further one: what the frame is to `executive.meeting`
SKIP, FAULT_AFTER, FALL_BACK = range(3)  # `overrun_policy`
STAGES, BUCKETS, LATEST = 6, 320, 8  # sizes of `executive.timing`
COUNTED, TOTAL, LEAST, MOST = range(4)  # columns of `stages`
LATE_CYCLE, LATE_NS, LATE_USAGE = 0, 1, 1 + STAGES  # columns of `latest`
IS_SYNC, IS_HEARTBEAT = 0, 1  # columns of `tx_role`

# The record of a node, ordered by who may write it; each part begins on a page of its own.
_PUBLISHED = [  # written by the node, read by all
    ("control", "<i8", (CONTROL_WORDS,)),
    ("seq", "<i8", (LINE_WORDS,)),
    ("answer", "<i8", (LINE_WORDS,)),
    ("record_ends", "<i8", (END_WORDS,)),
    ("frame_ends", "<i8", (END_WORDS,)),
    ("event_ends", "<i8", (END_WORDS,)),
    ("snapshot", "<f8", (MAX_VARIABLES,)),
    ("stages", "<i8", (STAGES, 4)),  # count, sum, least, most of each stage's ns
    ("histogram", "<i8", (STAGES, BUCKETS)),
    ("latest", "<i8", (LATEST, LATE_USAGE + 4)),  # cycle, stages, faults and switches
    ("record", "<i8", (RECORD_RING_WORDS,)),
    ("frame", "<i8", (FRAME_RING_ROWS, FRAME_WORDS)),
    ("event", "<i8", (EVENT_RING_ROWS, EVENT_WORDS)),
]
_MAILBOX = [  # written by clients, which the loop does not trust
    ("mail", "<i8", (MAIL_WORDS,)),
    ("mail_index", "<i8", (MAIL_SLOTS,)),
    ("mail_value", "<f8", (MAIL_SLOTS,)),
    ("record_taken", "<i8", (LINE_WORDS,)),
    ("frame_taken", "<i8", (LINE_WORDS,)),
    ("event_taken", "<i8", (LINE_WORDS,)),
]
_PRIVATE = [  # of the loop alone
    # set once
    ("trigger", "<i8"),  # what starts a cycle: CLOCKED, ON_FRAMES
    ("is_plant", "<i8"),
    ("period_ns", "<i8"),
    ("phase_ns", "<i8"),  # of the deadlines, on the common grid of whole periods
    ("late_ns", "<i8"),  # a cycle that starts later than this counts as late
    ("cycles", "<i8"),
    ("n_blocks", "<i8"),
    ("n_variables", "<i8"),
    ("n_limits", "<i8"),
    ("n_safe", "<i8"),
    ("n_rx", "<i8"),
    ("n_tx", "<i8"),
    ("n_starters", "<i8"),  # frames that start a cycle, and frames awaited in it
    ("n_awaited", "<i8"),
    ("n_schedule", "<i8"),
    ("n_noted", "<i8"),
    ("n_state", "<i8"),
    ("n_timing", "<i8"),
    ("record_rows", "<i8"),
    ("arm_pass", "<i8"),  # the pass after which the clock runs
    ("patience", "<i8"),  # receive time-outs until the other node counts as silent
    ("hold_cycles", "<i8"),
    ("fault_after", "<i8"),
    ("mode_index", "<i8"),  # the received variable that asks for STOP, or -1
    ("wait_recorder", "<i8"),  # lockstep: a full ring delays instead of dropping
    ("virtual_time", "<i8"),  # lockstep: stamps are k T
    ("wall_offset_ns", "<i8"),  # wall time minus the clock of the loop
    ("overrun_policy", "<i8"),
    ("overrun_after", "<i8"),  # overruns in a row that count
    ("grace_passes", "<i8"),  # cycles at the start in which none does
    ("controller_block", "<i8"),  # and the one that replaces it on FALL_BACK, or -1
    ("fallback_block", "<i8"),
    ("ramp_step", "<f8"),  # change of the gain a cycle in FAULT
    ("views", "<i8", (MAX_BLOCKS, 8)),  # p0 p1 x0 x1 u0 u1 y0 y1
    ("copies", "<i8", (MAX_COPIES, 2)),  # source, target of the wiring
    ("copies_end", "<i8", (MAX_BLOCKS + 1,)),  # end of each block's copies; last: what is sent
    ("limit_index", "<i8", (MAX_LIMITS,)),
    ("limits", "<f8", (MAX_LIMITS, 5)),
    ("safe_index", "<i8", (MAX_LIMITS,)),
    ("safe", "<f8", (MAX_LIMITS, 5)),
    ("schedule", "<i8", (MAX_LIMITS, 2)),  # cycle, variable of a scheduled tuning, by cycle
    ("schedule_value", "<f8", (MAX_LIMITS,)),
    ("tunable_low", "<f8", (MAX_VARIABLES,)),  # of a parameter; nan for all other variables
    ("tunable_high", "<f8", (MAX_VARIABLES,)),
    ("noted_index", "<i8", (MAX_LIMITS,)),  # variables whose changes are events
    ("noted", "<f8", (MAX_LIMITS,)),  # their last values
    ("state_columns", "<i8", (MAX_VARIABLES,)),
    ("timing_columns", "<i8", (MAX_VARIABLES,)),
    ("rx", "<i8", (MAX_FRAMES, 12)),  # tables of drivers.dbc
    ("rx_signals", "<i8", (MAX_SIGNALS, 10)),
    ("rx_scales", "<f8", (MAX_SIGNALS, 4)),
    ("rx_role", "<i8", (MAX_FRAMES, 4)),
    ("loss", "<f8", (MAX_FRAMES, 2)),  # of `executive.losses`
    ("tx", "<i8", (MAX_FRAMES, 12)),  # in the order of sending
    ("tx_signals", "<i8", (MAX_SIGNALS, 10)),
    ("tx_scales", "<f8", (MAX_SIGNALS, 4)),
    ("tx_role", "<i8", (MAX_FRAMES, 2)),
    # what the loop keeps
    ("k", "<i8"),  # the cycle: time is k T
    ("passes", "<i8"),  # cycles done; k minus passes were skipped
    ("behind", "<i8"),  # periods skipped just before this cycle
    ("deadline", "<i8"),
    ("wake", "<i8"),
    ("received", "<i8"),
    ("stepped", "<i8"),
    ("sent", "<i8"),
    ("done", "<i8"),
    ("publish_ns", "<i8"),
    ("virtual_now", "<i8"),
    ("missing", "<i8"),  # consecutive cycles without complete valid input
    ("started", "<i8"),  # frames of this cycle so far: starters, awaited
    ("fresh", "<i8"),
    ("faulted", "<i8"),
    ("scheduled", "<i8"),  # tunings of the schedule that were applied
    ("gain", "<f8"),  # 1, or how far the ramp of FAULT has come down
    ("v", "<f8", (MAX_VARIABLES,)),  # the table
    ("asked_index", "<i8", (MAIL_SLOTS,)),  # a request as it was when it was checked
    ("asked_value", "<f8", (MAIL_SLOTS,)),
    ("rx_state", "<i8", (MAX_FRAMES, 9)),  # receivers, see drivers.e2e
    ("loss_state", "<i8", (MAX_FRAMES, 2)),
    ("met", "<i8", (MAX_FRAMES,)),  # heartbeats that were heard, see `executive.meeting`
    ("sampled", "<i8"),  # 1: the first sample of the node below has begun
    ("holding", "<i8"),  # row + 1 of the frame in `held`, 0 without
    ("held", "u1", (FRAME_BYTES,)),
    ("overruns", "<i8"),  # in a row
    ("times", "<i8", (STAGES,)),
    ("usage", "<i8", (18,)),  # struct rusage
    ("usage_before", "<i8", (4,)),
    ("timespec", "<i8", (2,)),
    ("wire", WIRE),
]


def _whole_pages(fields: list[Any], name: str) -> list[Any]:
    """Return `fields` with a last one that fills their page."""
    rest = -np.dtype(fields, align=True).itemsize % PAGE_BYTES
    return [*fields, (name, "u1", (rest or PAGE_BYTES,))]


_PUBLISHED_PAGES = _whole_pages(_PUBLISHED, "end_of_published")
_MAILBOX_PAGES = _whole_pages(_MAILBOX, "end_of_mailbox")
PUBLISHED_BYTES = np.dtype(_PUBLISHED_PAGES, align=True).itemsize
MAILBOX_BYTES = np.dtype(_MAILBOX_PAGES, align=True).itemsize
MAILBOX_FIELDS = [name for name, *_ in _MAILBOX]
LOOP = np.dtype([*_PUBLISHED_PAGES, *_MAILBOX_PAGES, *_PRIVATE], align=True)


class SharedError(Exception):
    """The shared block cannot be made or is not there."""


def block_name(rig: str, bus: str, role: str) -> str:
    """Return the name of a node's block: one executive and one plant to a rig and bus."""
    return f"{rig}.{bus}.{role}".replace(":", "-").replace("/", "_")


def path_of(name: str) -> Path:
    """Return the file of block `name`, private to the user."""
    return FOLDER / f"pcpc-{os.getuid()}-{name}"


class Shared:
    """A mapped block: `arrays` by name, `loop` the LOOP record, `description` the JSON head."""

    def __init__(self, path: Path, memory: mmap.mmap, description: dict[str, Any]) -> None:
        self.path = path
        self.description = description
        self.memory = memory
        offset = description["loop_offset"]
        self.loop: Any = np.recarray(1, LOOP, memory, offset)[0]
        columns = description["record_columns"]
        rows = RECORD_RING_WORDS // columns
        self.arrays: dict[str, NDArray[Any]] = {
            "record": self.loop.record[: rows * columns].reshape(rows, columns),
            "frame": self.loop.frame,
            "event": self.loop.event,
            "snapshot": self.loop.snapshot[: len(description["variables"])],
        }
        for name in LOOP.names or ():
            field = self.loop[name]
            if isinstance(field, np.ndarray):
                self.arrays.setdefault(name, field)
        for ring in RINGS:
            self.arrays[f"{ring}_values"] = self.arrays[ring].view(np.float64)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.arrays[name]

    def unlink(self) -> None:
        """Remove the name; the memory lives on in the processes that have mapped it."""
        self.path.unlink(missing_ok=True)


def record_columns(description: Mapping[str, Any]) -> int:
    """Return the words of one row of the record ring."""
    return RECORD_HEAD + len(description["state_columns"]) + 1 + len(description["timing_columns"])


def create(name: str, description: Mapping[str, Any]) -> Shared:
    """Make the block `name`, zeroed and in memory, replacing one that a dead process left."""
    full = dict(description) | {"record_columns": record_columns(description), "loop_offset": 0}
    full["loop_offset"] = 4096 * (len(json.dumps(full)) // 4096 + 2)
    body = json.dumps(full).encode()
    head = MAGIC + len(body).to_bytes(8, "little") + body
    size = full["loop_offset"] + LOOP.itemsize
    path = path_of(name)
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        os.posix_fallocate(descriptor, 0, size)
        memory = mmap.mmap(descriptor, size)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise SharedError(f"{path}: {size >> 20} MiB of shared memory: {error.strerror}") from None
    finally:
        os.close(descriptor)
    memory[: len(head)] = head
    os.replace(temporary, path)
    return Shared(path, memory, full)


def attach(name: str) -> Shared:
    """Map the block `name` of a running node; SharedError if there is none."""
    return attach_path(path_of(name))


def attach_path(path: Path) -> Shared:
    """As `attach`, by file."""
    try:
        descriptor = os.open(path, os.O_RDWR)
    except FileNotFoundError:
        raise SharedError(f"{path.name}: no such node is running here") from None
    try:
        memory = mmap.mmap(descriptor, os.fstat(descriptor).st_size)
    finally:
        os.close(descriptor)
    if memory[:8] != MAGIC:
        raise SharedError(f"{path}: not a block of this version of pcpc")
    size = int.from_bytes(memory[8:16], "little")
    description = json.loads(memory[16 : 16 + size])
    if len(memory) != description["loop_offset"] + LOOP.itemsize:
        raise SharedError(f"{path}: a block of another version of pcpc")
    return Shared(path, memory, description)


def snapshot(block: Shared, into: NDArray[np.float64] | None = None, tries: int = 100) -> Any:
    """Return a consistent copy of all variables; the old `into` when the writer never paused.

    Raises SharedError if there is no old copy either.
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
        raise SharedError(f"{block.path.name}: the writer died or never pauses")
    return into

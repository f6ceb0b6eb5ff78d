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
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop import ring_layout
from pcpc.executive.loop.control import Control
from pcpc.executive.loop.layout import LOOP as LOOP
from pcpc.executive.loop.layout import Loop, Mailbox, Published
from pcpc.executive.loop.requests import Answer, Mail
from pcpc.executive.loop.ring_layout import EVENT_RING_ROWS as EVENT_RING_ROWS
from pcpc.executive.loop.ring_layout import EVENT_WORDS, RECORD_HEAD, Ends
from pcpc.executive.loop.ring_layout import FRAME_RING_WORDS as FRAME_RING_WORDS
from pcpc.executive.loop.ring_layout import RECORD_RING_WORDS as RECORD_RING_WORDS
from pcpc.executive.loop.sizes import *  # noqa: F403

CDR_HEADER = 1 << 40  # as int64, little-endian: four bytes of padding, then 00 01 00 00

RECORDER_PATIENCE = 12  # times the patience with a node that may wait for the recorder
PAGE_BYTES = mmap.PAGESIZE
_TELL_TRIES = 10  # without its host's word a node that has ended stays until it is killed

RINGS = ("record", "frame", "event")
GREETING = 0x1FFFFFE0  # 29 bits, the last in every arbitration; see `executive.nodes.greeting`

PUBLISHED, MAILBOX = Published.dtype, Mailbox.dtype
PUBLISHED_BYTES, MAILBOX_BYTES = PUBLISHED.itemsize, MAILBOX.itemsize
MAILBOX_FIELDS = (MAILBOX.names or ())[:-1]  # the last fills its page


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
        loop: Loop | None = None, client: Client | None = None,
    ) -> None:  # fmt: skip
        self.name, self.description, self.client = name, description, client
        self.loop = cast(Loop, loop)
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
    def control(self) -> Control:
        """The control words, by name."""
        return cast(Control, self["control"])

    @property
    def mail(self) -> Mail:
        """The words of a request, by name."""
        return cast(Mail, self["mail"])

    @property
    def answer(self) -> Answer:
        """The words of the answer to one, by name."""
        return cast(Answer, self["answer"])

    def ends(self, ring: str) -> Ends:
        """Return the ends of a ring: rows put, `head`, and `dropped`."""
        return cast(Ends, self[f"{ring}_ends"])

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
        if self.client is None:
            return
        for _ in range(_TELL_TRIES):
            with contextlib.suppress(OSError):  # of a kernel that is short of memory
                self.client.line.send(word)
                break


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

"""Received frames from the wire to the table, and signs of a second sender: what mutants run on.

What is expected stands in `expected_reception`. A step is a frame, now and then behind some cycles;
most go on from the one before, the others are repeated, forged, damaged, late or lost on purpose.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.dbc import Kind
from pcpc.executive.loop import control
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.intrusion import HINT_TURNS
from pcpc.executive.loop.variables import BUS_AT
from pcpc.tools.dev.evidence import compared_plausible
from pcpc.tools.dev.evidence.compared_senders import OWN
from pcpc.tools.dev.evidence.episodes import Episodes
from pcpc.tools.dev.evidence.expected_reception import (
    ANOTHER,
    AWAITED,
    BEAT,
    CARE,
    CHANGED,
    COUNTED,
    FB,
    GONE,
    GREETING,
    IS_BELOW,
    LOSS,
    MEETS,
    ROWS,
    SCALE,
    SIGNALS,
    SLOW,
    SPOILED,
    STARTS,
    STOP,
    SYNC,
    WIDE,
    Node,
    Settings,
)

STEPS = 150
STUBS = """
import types
def _injected(n, row):
    return n.faults.count[0]
inject = loop_function(_injected)
"""  # what a fault on purpose did stands in the step
DRIVER = """
from pcpc.drivers.can import e2e as _e2e


@loop_function
def reception(_m, n, about, frames, told, kept):
    rx, seen = n.rx, n.intrusion
    for s in range(about.shape[0]):
        a, t = about[s], told[s]
        for _ in range(a[0]):
            n.passes += 1
            _e2e.begin_cycle(rx.state, rx.n)
            m_age_frames(_m, n)
            rx.started = rx.fresh = n.wire.muted = 0
        n.k, n.clock.behind, n.wire.source = a[1], a[2], a[4]
        n.faults.count[0] = a[5]
        n.faults.peer_stall[0] = a[10]
        if a[3] >= 0 and a[6] != 0:
            n.faults.acted[a[3]] = n.passes + 1
        if a[7] != 0:
            n.guard.faulted = a[8]
        n.meeting.between = a[9]
        for i in range(16):
            n.wire.rx[i] = frames[s, 0, i]
            n.faults.another[i] = frames[s, 1, i]
        n.frame_taken[0] = n.frame_ends.head
        n.event_taken[0] = n.event_ends.head
        if a[11] != 0:
            m_note_bus_error(_m, n)
            if n.guard.off != 0:
                m_fault_while_off(_m, n)
        else:
            t[0] = m_take_frame(_m, n)
        t[59] = n.guard.off
        for i in range(6):
            t[60 + i] = n.v[BUS_AT + i]
        t[1] = m_taken_on_purpose(_m, n)
        t[2], t[3], t[4], t[5] = rx.started, rx.fresh, n.wire.muted, n.guard.faulted
        t[6], t[7], t[8] = n.guard.quick, n.event_ends.head, n.frame_ends.head
        event = n.event[(n.event_ends.head - 1) % 1024]
        t[9], t[10], t[11] = event.code, event.argument, event.bits
        for i in range(2):
            last = (n.frame_ends.head - 1 - i) % 65536 * 5
            t[12 + 2 * i], t[13 + 2 * i] = n.frame[last + 3], n.frame[last + 4]
        for i in range(len(COUNTED)):
            t[16 + i] = words(n.control)[COUNTED[i]]
        for i in range(10):
            t[32 + i] = words(rx.state[max(a[3], 0)])[i]
            t[42 + i] = words(n.faults.on_wire[max(a[3], 0)])[i]
        t[52], t[53], t[54] = n.faults.shown, rx.foreign.count, rx.repeats.count
        for i in range(2):  # nodes below
            t[55 + i], t[57 + i] = n.meeting.sampled[i], n.meeting.holding[i]
        for i in range(4):
            kept[s, i] = n.v[20 + i]
            kept[s, 4 + i] = n.v[30 + i]
"""
DRIVER = DRIVER.replace("COUNTED", repr(tuple(map(control.place, COUNTED)))).replace(
    "BUS_AT", str(BUS_AT)
)


def _frame(word: int, length: int, data: bytes) -> bytes:
    return struct.pack("<IB3x8s", word, length, data)


class _Traffic:
    """Draws frames of all rows, most with the counter behind the last one."""

    def __init__(self, draw: np.random.Generator) -> None:
        self.draw, self.counter, self.data = draw, [0] * 6, [bytes(8)] * 6

    def next(self, row: int) -> bytes:
        """Return a frame."""
        draw, has, fate = self.draw, ROWS[row], self.draw.random()
        steps = [0, 1, 2, 4, 5, 6, 8, -1, -2]
        step = int(draw.choice(steps, p=[0.2, 0.48, 0.05, 0.05, 0.05, 0.02, 0.03, 0.1, 0.02]))
        self.counter[row] += step
        if step != 0 or fate < 0.6:
            low = draw.integers(0, 14, 8) if fate < 0.9 else draw.integers(0, 256, 8)
            self.data[row] = low.astype(np.uint8).tobytes()
        content = bytearray(has.sent(self.data[row], self.counter[row]))
        if draw.random() < 0.06:
            content[int(draw.integers(has.dlc))] ^= 1 << int(draw.integers(8))
        length = has.dlc + (int(draw.choice([-1, 1])) if draw.random() < 0.03 else 0)
        return _frame(has.can_id, length, bytes(content))


def _drawn_steps(draw: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return steps and their frames."""
    about, frames = np.zeros((STEPS, 12), np.int64), np.zeros((STEPS, 2, 16), np.uint8)
    traffic = _Traffic(draw)
    few = [0, 1, 2, 3, 9, 10, 20]
    about[:, 0] = draw.choice(few, STEPS, p=[0.55, 0.3, 0.05, 0.04, 0.02, 0.02, 0.02])
    about[: int(draw.integers(0, 25)), 0] = 0  # before the first cycle
    skips = draw.choice([0, 1, 74, 75, 76, 99], STEPS, p=[0.84, 0.06, 0.03, 0.03, 0.03, 0.01])
    about[:, 1] = 1 + np.cumsum(about[:, 0] + skips)
    about[:, 2] = draw.choice([0, 1, 2, 5], STEPS, p=[0.8, 0.1, 0.05, 0.05])
    weights = [0.32, 0.2, 0.1, 0.12, 0.01, 0.2, 0.05]
    about[:, 3] = draw.choice([FB, BEAT, SYNC, SLOW, STOP, WIDE, -1], STEPS, p=weights)
    about[:8, 3] = np.where(draw.random(8) < 0.5, -1, about[:8, 3])  # greetings
    about[:, 4] = draw.choice([11, 22, -1], STEPS, p=[0.97, 0.02, 0.01])
    injected = [CHANGED, GONE, CHANGED | ANOTHER, GONE | ANOTHER]
    about[:, 5] = np.where(draw.random(STEPS) < 0.1, draw.choice(injected, STEPS), 0)
    about[:, 6] = draw.random(STEPS) < 0.05
    about[:, 7] = draw.random(STEPS) < 0.2
    about[:, 8] = np.where(draw.random(STEPS) < 0.1, draw.integers(1, 5, STEPS), 0)
    about[:, 9] = draw.random(STEPS) < 0.5
    about[:, 10] = np.where(draw.random(STEPS) < 0.05, 51, 50)  # a place above 0, or not
    for s, row in enumerate(about[:, 3].tolist()):
        if draw.random() < 0.04:
            about[s, 11], kind = 1, draw.choice([0x4, 0x40, 0x100, 0x20, 0x1, 0x144, 0x2, 0x165])
            odd = draw.integers(0, 256, 8) & draw.choice([0, 4, 8, 0x10, 0x20, 0x40, 0x80, 255])
            both = [_frame(int(kind) | 1 << 29, 8, odd.astype(np.uint8).tobytes())] * 2
        elif row < 0:
            words = [*OWN, 0x555, GREETING, *[GREETING ^ 3] * 4, GREETING ^ 3 ^ 1 << 8]
            length, odd = int(draw.choice([1, 1, 1, 8])), np.zeros(8, np.uint8)
            odd[int(draw.integers(8))] = draw.random() < 0.3
            both = [_frame(int(draw.choice(words)), length, odd.tobytes())] * 2
        else:
            both = [traffic.next(row), traffic.next(row)]
            about[s, 4] = 0 if row == STOP else about[s, 4]
            if about[s, 5] & ANOTHER == 0:
                both[1] = both[0]
        frames[s] = np.frombuffer(b"".join(both), np.uint8).reshape(2, 16)
    _early_beats(about, frames)
    return about, frames


def _early_beats(about: NDArray[np.int64], frames: NDArray[np.uint8]) -> None:
    """End with two heartbeats in a cycle, and two as late as still counts for a turn of one."""
    before = int(about[-5, 1])
    about[-4:] = 0
    about[-4:, 0] = 1, 0, HINT_TURNS, 0
    about[-4:, 1] = before + np.cumsum(about[-4:, 0])
    about[-4:, 3], about[-4:, 4], about[-4:, 10] = BEAT, 11, 50
    has = ROWS[BEAT]
    content = _frame(has.can_id, has.dlc, bytes(has.sent(bytes(8), 0)))
    frames[-4:] = np.frombuffer(content, np.uint8)


def _install(n: Any, has: Settings) -> None:
    n.clock.kind = Time.GIVEN
    n.rx.n, n.tx.n, n.rx.awaited = len(ROWS), len(OWN), 2
    n.tx.frames["can_id"][: len(OWN)] = OWN
    n.guard.stop_row, n.v[51], n.faults.n_peer_stalls = STOP, 1.0, 1
    n.faults.n, n.meeting.greets, n.meeting.ordered = has.faults, has.greets, has.ordered
    n.meeting.greeting[:16] = np.frombuffer(_frame(GREETING, 1, b""), np.uint8)
    n.rx.state["last_counter"] = n.faults.on_wire["last_counter"] = -1
    n.rx.state["state"] = n.faults.on_wire["state"] = 5
    n.intrusion.reaction, n.intrusion.beat_every[BEAT] = has.reaction, has.turn
    for row, one in enumerate(ROWS):
        crc = (one.mask != 0) + one.wide
        first = sum(its < row for its, _, _ in SIGNALS)
        past = first + sum(its == row for its, _, _ in SIGNALS)
        n.rx.frames[row] = (one.can_id, 0, one.dlc, 0, first, past, one.every, crc, 0, one.byte,
                            one.shift, one.mask, one.place.start, one.data_id, 0)  # fmt: skip
        n.rx.role[row] = STARTS[row], AWAITED[row], has.peer * IS_BELOW[row], MEETS[row]
        n.intrusion.care[row], n.faults.spoiled[row] = row in CARE, row in SPOILED
        if row in LOSS:
            n.rx.loss[row], n.rx.loss_state[row] = LOSS[row], (7 + row, 0)
    for i, (_, byte, place) in enumerate(SIGNALS):
        row = n.rx.signals[i]
        row.shift, row.mask, row.kind = 8 * byte, 255, Kind.SCALED
        row.variable, row.factor = place, SCALE
    compared_plausible.install(n.plausible, has.signals)


def reception(driver: Any, draw: np.random.Generator, count: int) -> Any:
    """Feed what takes frames with `count` episodes."""
    episodes = Episodes(driver.reception)
    for number in range(count):
        signals = [compared_plausible.Signal(0.125, 1.5, 1.0, 9, 4) for _ in range(3)]
        turn = 1 if number % 5 == 4 else 8
        peer, faults = 1 + number // 4 % 2, int(number % 7 > 0)
        has = Settings(number % 3, number % 2, number // 2 % 2, peer, faults, turn, signals)
        _install(episodes.new_loop(), has)
        (about, frames), model = _drawn_steps(draw), Node(has)
        steps = zip(about.tolist(), frames, strict=True)
        fed = [model.feed(one, *(its.tobytes() for its in both)) for one, both in steps]
        told, kept = (np.array(one) for one in zip(*fed, strict=True))
        episodes.add((about, frames), (told.astype(np.int64), kept))
    return episodes.differ

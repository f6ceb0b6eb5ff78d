"""Received frames from the wire to the table, and signs of a second sender: what mutants run on.

What is expected stands in `expected_reception`. A step is a frame, now and then behind some cycles;
most go on from the one before, the others are repeated, forged, damaged, late or lost on purpose.
"""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from pcpc.drivers.can.dbc import SignalKind
from pcpc.drivers.can.e2e import begin_cycle
from pcpc.executive.loop.bus_state import fault_while_off, note_bus_error
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.intrusion import HINT_TURNS
from pcpc.executive.loop.on_wire import age_frames
from pcpc.executive.loop.reception import take_frame
from pcpc.executive.loop.variables import BUS_AT
from pcpc.tools.dev.evidence import compared_plausible
from pcpc.tools.dev.evidence.compared_senders import FOREIGN_LIMIT, OWN, REPEAT_LIMIT
from pcpc.tools.dev.evidence.comparison import LAST_EVENT, Compared, Episodes, frame_word, same
from pcpc.tools.dev.evidence.expected_reception import (
    ANOTHER,
    AWAITED,
    BEAT,
    CARE,
    CHANGED,
    COUNT,
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
    STALLED,
    STARTS,
    STOP,
    SYNC,
    WIDE,
    ExpectedNode,
    Settings,
    Step,
)

STEPS = 150


def _injected(n: Any, row: int) -> Any:
    return n.faults.count[0]


def put_beside(copy: Any) -> None:
    """Have a fault on purpose do what stands in the step."""
    copy.inject = copy.loop_function(_injected)


def received(n: Any, given: Step) -> Any:
    """Let cycles begin, then take a frame or what the controller told."""
    for _ in range(given.cycles):
        n.passes += 1
        begin_cycle(n.rx.state, n.rx.n)
        age_frames(n)
        n.rx.started = n.rx.fresh = n.wire.muted = 0
    n.k, n.clock.behind, n.wire.source = given.k, given.behind, given.source
    n.faults.count[0] = given.done
    n.faults.peer_stall[0], n.faults.peer_stood = given.stall, given.stood
    n.clock.kind = Time.GIVEN if given.replays != 0 else Time.LOCKSTEP
    n.v[20] += given.bias
    if given.row >= 0 and given.acts != 0:
        n.faults.acted[given.row] = n.passes + 1
    if given.sets != 0:
        n.guard.faulted = given.fault
    n.meeting.between = given.second
    for i in range(16):
        n.wire.rx[i] = given.frame[i]
        n.faults.another[i] = given.other[i]
    n.frame_taken[0] = n.frame_ends.head
    n.event_taken[0] = n.event_ends.head
    if given.error == 0:
        return take_frame(n)
    note_bus_error(n)
    if n.guard.off != 0:
        fault_while_off(n)
    return 0


def _frame_of(back: int, word: int) -> Callable[[ExpectedNode], int]:
    return lambda m: m.last_frame(back)[word]


def _count_of(word: str) -> Callable[[ExpectedNode], int]:
    return lambda m: m.count_of(word)


RECEPTION = Compared(
    Step, received,
    whole={
        "came": lambda m: m.taken, "taken_on_purpose(n)": lambda m: m.on_purpose,
        **same("rx.started", "rx.fresh", "wire.muted", "guard.quick", "guard.off", "faults.shown"),
        "guard.faulted": lambda m: m.fault, "frame_ends.head": lambda m: len(m.log), **LAST_EVENT,
        **{frame_word(back, 3 + i): _frame_of(back, i) for back in range(2) for i in range(2)},
        **{f"control.{word}": _count_of(word) for word in COUNTED},
        "words(rx.state[max(given.row, 0)])[0:10]": lambda m: m.receivers[m.row].told(),
        "words(faults.on_wire[max(given.row, 0)])[0:10]": lambda m: m.came[m.row].told(),
        "rx.foreign.count": lambda m: m.windows[FOREIGN_LIMIT][1],
        "rx.repeats.count": lambda m: m.windows[REPEAT_LIMIT][1],
        "meeting.sampled[0:2]": lambda m: [m.sampled * its for its in m.peers],
        "meeting.holding[0:2]": lambda m: [(BEAT + 1) * bool(m.held) * its for its in m.peers],
    },
    real={
        f"v[{BUS_AT}:{BUS_AT + 6}]": lambda m: m.bus, "v[20:25]": lambda m: m.v,
        "v[30:33]": lambda m: [signal.count for signal in m.judge_of.signals],
    },
)  # fmt: skip


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


def _draw_steps(given: Any, draw: np.random.Generator) -> None:
    """Draw steps and their frames."""
    traffic = _Traffic(draw)
    few = [0, 1, 2, 3, 9, 10, 20]
    given.cycles = draw.choice(few, STEPS, p=[0.55, 0.3, 0.05, 0.04, 0.02, 0.02, 0.02])
    given.cycles[: int(draw.integers(0, 25))] = 0  # before the first cycle
    skips = draw.choice([0, 1, 74, 75, 76, 99], STEPS, p=[0.84, 0.06, 0.03, 0.03, 0.03, 0.01])
    given.k = 1 + np.cumsum(given.cycles + skips)
    given.behind = draw.choice([0, 1, 2, 5], STEPS, p=[0.8, 0.1, 0.05, 0.05])
    weights = [0.32, 0.2, 0.1, 0.12, 0.01, 0.2, 0.05]
    given.row = draw.choice([FB, BEAT, SYNC, SLOW, STOP, WIDE, -1], STEPS, p=weights)
    given.row[:8] = np.where(draw.random(8) < 0.5, -1, given.row[:8])  # greetings
    given.source = draw.choice([11, 22, -1], STEPS, p=[0.97, 0.02, 0.01])
    injected = [CHANGED, GONE, CHANGED | ANOTHER, GONE | ANOTHER]
    given.done = np.where(draw.random(STEPS) < 0.1, draw.choice(injected, STEPS), 0)
    given.acts = draw.random(STEPS) < 0.05
    given.sets = draw.random(STEPS) < 0.2
    given.fault = np.where(draw.random(STEPS) < 0.1, draw.integers(1, 5, STEPS), 0)
    given.second = draw.random(STEPS) < 0.5
    given.bias = np.where(given.k % 7 == 0, 0.125 * (given.k % 5 - 2), 0.0)
    given.stall = np.where(draw.random(STEPS) < 0.05, STALLED, STALLED - 1)
    given.replays, given.stood = draw.random(STEPS) < 0.5, draw.random(STEPS) < 0.05
    for step in given:
        if draw.random() < 0.04:
            step.error, kind = 1, draw.choice([0x4, 0x40, 0x100, 0x20, 0x1, 0x144, 0x2, 0x165])
            odd = draw.integers(0, 256, 8) & draw.choice([0, 4, 8, 0x10, 0x20, 0x40, 0x80, 255])
            both = [_frame(int(kind) | 1 << 29, 8, odd.astype(np.uint8).tobytes())] * 2
        elif step.row < 0:
            words = [*OWN, 0x555, GREETING, *[GREETING ^ 3] * 4, GREETING ^ 3 ^ 1 << 8]
            length, odd = int(draw.choice([1, 1, 1, 8])), np.zeros(8, np.uint8)
            odd[int(draw.integers(8))] = draw.random() < 0.3
            both = [_frame(int(draw.choice(words)), length, odd.tobytes())] * 2
        else:
            both = [traffic.next(step.row), traffic.next(step.row)]
            step.source = 0 if step.row == STOP else step.source
            if step.done & ANOTHER == 0:
                both[1] = both[0]
        step.frame, step.other = (np.frombuffer(one, np.uint8) for one in both)
    _draw_early_beats(given)


def _draw_early_beats(given: Any) -> None:
    """End with two heartbeats in a cycle, and two as late as still counts for a turn of one."""
    before, last = int(given.k[-5]), given[-4:]
    last[:] = np.zeros(1, last.dtype)[0]
    last.cycles = 1, 0, HINT_TURNS, 0
    last.k = before + np.cumsum(last.cycles)
    last.row, last.source, last.stall = BEAT, 11, STALLED - 1
    has = ROWS[BEAT]
    content = _frame(has.can_id, has.dlc, bytes(has.sent(bytes(8), 0)))
    last.frame[:] = last.other[:] = np.frombuffer(content, np.uint8)


def _install(n: Any, has: Settings) -> None:
    n.rx.n, n.tx.n, n.rx.awaited = len(ROWS), len(OWN), 2
    n.tx.frames["can_id"][: len(OWN)] = OWN
    n.guard.stop_row, n.v[STALLED], n.faults.n_peer_stalls = STOP, 1.0, 1
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
        n.intrusion.care[row] = row in CARE and (row != FB or has.reaction != COUNT)
        n.faults.spoiled[row] = row in SPOILED
        if row in LOSS:
            n.rx.loss[row], n.rx.loss_state[row] = LOSS[row], (7 + row, 0)
    for i, (_, byte, place) in enumerate(SIGNALS):
        row = n.rx.signals[i]
        row.shift, row.mask, row.kind = 8 * byte, 255, SignalKind.SCALED
        row.variable, row.factor = place, SCALE
    compared_plausible.install(n.plausible, has.signals)


def reception(feed: Any, draw: np.random.Generator, count: int) -> Episodes:
    """Feed what takes frames with `count` episodes."""
    episodes = Episodes(RECEPTION, feed)
    for number in range(count):
        signals = [compared_plausible.LimitedSignal(0.125, 1.5, 1.0, 9, 4) for _ in range(3)]
        turn = 1 if number % 5 == 4 else 8
        peer, faults = 1 + number // 4 % 2, int(number % 7 > 0)
        has = Settings(number % 3, number % 2, number // 2 % 2, peer, faults, turn, signals)
        _install(episodes.new_loop(), has)
        rows = episodes.new_rows(STEPS)
        _draw_steps(rows, draw)
        episodes.add(rows, ExpectedNode(has))
    return episodes

"""What the wire did to frames, apart from what the rig does to them on purpose behind it.

Frames on which losses or faults may act are checked twice: as they came, and as they are handed on.
What counts against a run is of the first check, so that it is what it would be without losses and
faults, frame by frame:

    missed         frames that were not on the wire, by the counters of those that were
    starved cycles  those without input for longer than the rig allows, where no fault took it
    others         wrong CRC or length, repeated, a counter that jumped

A node that stands still on purpose takes what it would have sent; who knows of it waits for none.
Losses, which belong to the rig's bus, excuse no stale cycle.
"""

from pcpc.drivers.can import codec, e2e
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.structures import data_of
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.doubts import is_doubted
from pcpc.executive.loop.injected_frames import EXCUSED_CYCLES
from pcpc.executive.loop.injection import peer_stalled
from pcpc.executive.loop.layout import Loop


@loop_inline
def age_frames(n: Loop) -> None:
    """Age the frames to which something may be done, as they came, by one cycle."""
    for row in range(n.rx.n):
        if n.faults.spoiled[row] != 0:
            e2e.age(n.faults.on_wire, row)


@loop_inline
def note_as_came(n: Loop, row: int) -> None:
    """Check and count the frame in `wire.rx` as it came, if something may be done to it."""
    n.faults.shown = 0
    if n.faults.spoiled[row] != 0:
        _note(n, row)


@loop_function
def _note(n: Loop, row: int) -> None:
    frame, rx = n.wire.rx, n.rx
    length = codec.length_of(frame, row, rx.frames)
    state, lost = e2e.check(data_of(frame), length, row, rx.frames, n.faults.on_wire)
    count(n, state, lost)
    acted, right = n.faults.acted[row], state == FrameState.OK or state == FrameState.OK_SOME_LOST
    lasts = max(int64(EXCUSED_CYCLES), 2 * rx.frames[row].every_n)
    n.faults.shown = int64(right and acted > 0 and n.passes + 1 - acted <= lasts)


@loop_inline
def count(n: Loop, state: int, lost: int) -> None:
    """Count what is wrong with a frame of this state, before which `lost` are missing."""
    n.control.missed += lost
    n.control.crc_errors += 1 if state == FrameState.ERROR else 0
    n.control.repeated += 1 if state == FrameState.REPEATED else 0
    n.control.wrong_sequence += 1 if state == FrameState.WRONG_SEQUENCE else 0


@loop_function
def taken_on_purpose(n: Loop) -> bool:
    """Return whether all input that is missing in this cycle was taken by faults on purpose.

    In a replay a cycle's periods pass before: whether the other node stood still is noted.
    """
    stood = n.faults.peer_stood != 0 if n.clock.kind == Time.GIVEN else peer_stalled(n)
    if stood:
        return True
    short = n.rx.awaited - n.rx.fresh
    for row in range(n.rx.n):
        unused = n.rx.state[row].fresh == 0 or is_doubted(n, row)
        if n.faults.spoiled[row] != 0 and n.faults.on_wire[row].fresh != 0 and unused:
            short -= n.rx.role[row].awaited
    return short <= 0

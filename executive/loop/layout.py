"""The LOOP record: the memory of one node, ordered by who may write it (no numba here).

See `executive.loop.shared`; each part that others write begins on a page of its own. What only the
loop has is a record each: what was set once, then what the loop keeps.
"""

from pcpc.drivers.can.wire_layout import Wire
from pcpc.drivers.canopen.layout import Canopen
from pcpc.drivers.compiled.records import Cells, Element, Record, carried, cells
from pcpc.drivers.compiled.rows import FrameRow, SignalRow
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.drive.layout import Hooks
from pcpc.drivers.robots.layout import Robot
from pcpc.executive.loop.control import Control
from pcpc.executive.loop.injection_layout import Faults
from pcpc.executive.loop.intrusion_layout import Intrusion
from pcpc.executive.loop.plausibility_layout import Plausible
from pcpc.executive.loop.reception_layout import Meeting, Rx
from pcpc.executive.loop.requests import SLOTS, Answer, Mail
from pcpc.executive.loop.ring_layout import (
    EVENT_RING_ROWS,
    FRAME_RING_WORDS,
    RECORD_RING_WORDS,
    Ends,
    EventRow,
    Rings,
)
from pcpc.executive.loop.sizes import (
    LINE_WORDS,
    MAX_BLOCKS,
    MAX_COPIES,
    MAX_FRAMES,
    MAX_LIMITS,
    MAX_SCHEDULE,
    MAX_SIGNALS,
    MAX_VARIABLES,
)
from pcpc.executive.loop.timing_layout import BUCKETS, LATEST, STAGES, Figures, Late, Timing

KEYFRAME_HEAD = 3  # words: passes, cycle, stamp ns
KEYFRAME_WORDS, MAX_SPANS = 1 << 15, 64  # 256 KiB: the largest node fills half of it


class Published(Record, fills="end_of_published"):
    """What the node writes and all read."""

    control: Control
    seq: Cells[int] = cells(LINE_WORDS)
    answer: Answer
    record_ends: Ends
    frame_ends: Ends
    event_ends: Ends
    snapshot: Cells[float] = cells(MAX_VARIABLES)
    stages: Cells[Figures] = cells(STAGES)
    histogram: Cells[int] = cells(STAGES, BUCKETS)
    latest: Cells[Late] = cells(LATEST)
    keyframe_seq: Cells[int] = cells(LINE_WORDS)  # see `executive.nodes.planned_keyframes`
    keyframe: Cells[int] = cells(KEYFRAME_WORDS)
    record: Cells[int] = cells(RECORD_RING_WORDS)
    frame: Cells[int] = cells(FRAME_RING_WORDS)
    event: Cells[EventRow] = cells(EVENT_RING_ROWS)


class Mailbox(Record, fills="end_of_mailbox"):
    """What clients write; the loop does not trust it."""

    mail: Mail
    mail_index: Cells[int] = cells(SLOTS)
    mail_value: Cells[float] = cells(SLOTS)
    record_taken: Cells[int] = cells(LINE_WORDS)
    frame_taken: Cells[int] = cells(LINE_WORDS)
    event_taken: Cells[int] = cells(LINE_WORDS)


class Clock(Record):
    """When a cycle begins."""

    kind: int  # of `executive.loop.clock`
    trigger: int  # what starts a cycle: CLOCKED, ON_FRAMES
    arm_pass: int  # the pass after which the clock runs
    period_ns: int
    phase_ns: int  # of the deadlines, on the common grid of whole periods
    late_ns: int  # a cycle that starts later than this counts as late
    wall_offset_ns: int  # wall time minus the clock of the loop
    deadline: int
    wake: int
    behind: int  # periods skipped just before this cycle
    now_ns: int  # of a clock that somebody else sets
    timespec: Cells[int] = cells(2)


class Safe(Element):
    """A received value that becomes safe in FAULT."""

    last: float
    safe: float


class Guard(Record):
    """The supervisor."""

    cycles: int  # of the run
    hold_cycles: int
    fault_after: int
    mode_index: int  # the received variable that asks for STOP, or -1
    overrun_policy: int  # of `executive.loop.supervisor`
    overrun_after: int  # overruns in a row that count
    grace_passes: int  # cycles at the start in which none does
    odd_output: int  # the fault when an output is no finite number
    safe_start: int  # 1: before the first valid input commands are safe
    waits: int  # 1: FAULT lasts until a reset; 0: until its ramp is over
    manual: int  # 1: a fault disarms
    estop_index: int  # the received variable that is an emergency stop, or -1
    stop_row: int  # the received frame that is a stop, or -1
    ramp_step: float  # change of the gain a cycle in FAULT
    quick_step: float  # the same of a quick stop
    n_safe: int
    safe_index: Cells[int] = cells(MAX_LIMITS)
    safe: Cells[Safe] = carried("last", shape=MAX_LIMITS)
    missing: int = carried()  # cycles in a row without valid input
    overruns: int = carried()  # in a row
    faulted: int = carried()
    disarmed: int = carried()
    reset: int = carried()  # 1: asked for in the cycle before
    stop: int = carried()  # 1: the end was asked for
    off: int = carried()  # 1: the CAN controller is bus-off
    quick: int = carried()  # of `executive.loop.limits`
    gain: float = carried()  # 1, or how far the ramp of FAULT or of the end has come down
    pace: float = carried()  # its change a cycle; 0 before a ramp


class Moment(Element):
    """Of a scheduled tuning."""

    cycle: int
    place: int


class Tuning(Record):
    """What changes parameters."""

    low: Cells[float] = cells(MAX_VARIABLES)  # of a parameter; nan for all other variables
    high: Cells[float] = cells(MAX_VARIABLES)
    n: int
    schedule: Cells[Moment] = cells(MAX_SCHEDULE)  # of the scheduled tunings, by cycle
    value: Cells[float] = cells(MAX_SCHEDULE)
    done: int  # those of the schedule that were applied
    asked_index: Cells[int] = cells(SLOTS)  # a request as it was when it was checked
    asked_value: Cells[float] = cells(SLOTS)


class BlockViews(Element):
    """Where a block's parameters, states, inputs and outputs lie in the table."""

    p: int
    p_end: int
    x: int
    x_end: int
    u: int
    u_end: int
    y: int
    y_end: int


class Copy(Element):
    """Of a variable to another one."""

    source: int
    target: int


class Blocks(Record):
    """What is stepped."""

    n: int
    owe_periods: int  # 1: after a stall they are stepped for the skipped periods too
    controller: int  # and the one that replaces it on FALL_BACK, or -1
    fallback: int
    views: Cells[BlockViews] = cells(MAX_BLOCKS)
    copies: Cells[Copy] = cells(MAX_COPIES)  # the wiring
    copies_end: Cells[int] = cells(MAX_BLOCKS + 1)  # end of each block's copies; last: what is sent
    n_noted: int
    noted_index: Cells[int] = cells(MAX_LIMITS)  # variables whose changes are events
    noted: Cells[float] = carried(shape=MAX_LIMITS)  # their last values


class CommandLimit(Element):
    """What `executive.loop.limits` does to a command."""

    low: float
    high: float
    rate: float  # a cycle
    last: float  # before a ramp
    safe: float
    sent: float


class CommandLimits(Record):
    """Of the commands."""

    n: int
    place: Cells[int] = cells(MAX_LIMITS)
    table: Cells[CommandLimit] = carried("last", "sent", shape=MAX_LIMITS)


class FrameUse(Element):
    """What a sent frame is."""

    is_sync: int
    is_heartbeat: int
    is_emergency: int
    told: int  # its last code


class Tx(Record):
    """What is sent."""

    n: int
    frames: Cells[FrameRow] = cells(MAX_FRAMES)  # in the order of sending
    signals: Cells[SignalRow] = cells(MAX_SIGNALS)
    kind: Cells[FrameUse] = carried("told", shape=MAX_FRAMES)
    last_word: int  # of `executive.loop.sending`
    first: int  # places of what is sent
    past: int


class Span(Element):
    """Bytes from `v` on."""

    start: int
    length: int


class Keep(Record):
    """What is kept in keyframes, see `executive.nodes.planned_keyframes`."""

    every: int  # passes; 0 for no keyframes
    next: int  # the pass behind which the next one is published
    n: int
    span: Cells[Span] = cells(MAX_SPANS)


class Loop(Published, Mailbox):
    """All of a node."""

    k: int  # the cycle: time is k T
    passes: int  # cycles done; k minus passes were skipped
    n_variables: int
    v: Cells[float] = cells(MAX_VARIABLES)  # the table
    clock: Clock
    rx: Rx
    meeting: Meeting
    guard: Guard
    tuning: Tuning
    faults: Faults
    blocks: Blocks
    limits: CommandLimits
    tx: Tx
    rings: Rings
    timing: Timing
    keep: Keep
    wire: Wire
    plausible: Plausible
    intrusion: Intrusion
    drive: Hooks
    canopen: Canopen
    robot: Robot


LOOP = Loop.dtype
structure(LOOP)  # to compiled functions that take one, whichever is called first

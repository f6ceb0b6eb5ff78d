"""What the loop keeps of what comes, and of the meeting: parts of LOOP."""

from pcpc.drivers.compiled.records import Cells, Element, Record, carried, cells
from pcpc.drivers.compiled.rows import FrameBytes, FrameRow, Receiver, SignalRow
from pcpc.executive.loop.sizes import MAX_FRAMES, MAX_PEERS, MAX_SIGNALS


class FrameRole(Element):
    """What a received frame does in a cycle."""

    starts: int
    awaited: int
    peer: int  # of the node waited for
    meeting: int


class Streak(Element):
    """A count in a row."""

    since: int  # the pass in which it began
    count: int


class Loss(Element):
    """Of `executive.loop.losses`."""

    enter: float  # p
    leave: float  # q


class LossState(Element):
    """Of `executive.loop.losses`."""

    draw: int  # s
    lost: int  # 1 in the lost state


class Rx(Record):
    """What is received."""

    n: int
    frames: Cells[FrameRow] = cells(MAX_FRAMES)  # tables of drivers.can.dbc
    signals: Cells[SignalRow] = cells(MAX_SIGNALS)
    role: Cells[FrameRole] = cells(MAX_FRAMES)
    loss: Cells[Loss] = cells(MAX_FRAMES)  # of `executive.loop.losses`
    listen_ns: int  # before the first word on a bus
    patience: int  # receive time-outs until the other node counts as silent
    starters: int  # frames that start a cycle, and frames awaited in it
    awaited: int
    started: int = carried()  # those of this cycle so far
    fresh: int = carried()
    state: Cells[Receiver] = carried(shape=MAX_FRAMES)  # see drivers.can.e2e
    source: Cells[int] = cells(MAX_FRAMES)  # who sends them, see `executive.loop.strangers`
    foreign: Streak = carried()
    repeats: Streak = carried()
    loss_state: Cells[LossState] = carried(shape=MAX_FRAMES)


class Meeting(Record):
    """See `executive.loop.meeting`."""

    between: int  # 1: a local node: above on its first bus, below on the second
    seeks_below: int  # 1: waits for the node below; 0: is the lowest, waits for nobody
    ordered: int  # lockstep: takes and records only what always happens
    met: Cells[int] = cells(MAX_FRAMES)  # heartbeats that were heard
    peers: int  # how many nodes are below
    heard: int  # a bit for each that was
    sampled: Cells[int] = cells(MAX_PEERS)  # 1: the first sample of a node below has begun
    holding: Cells[int] = cells(MAX_PEERS)  # row + 1 of the frame in `held`, 0 without
    held: Cells[FrameBytes] = cells(MAX_PEERS)
    on_second: int  # of a plant: 1: it is on the second bus of the executive
    greets: int  # 1: it was started alone, and tells what plant its rig has
    greeting: FrameBytes

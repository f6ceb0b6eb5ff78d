"""What the loop keeps of what it doubts, of losses and of the meeting: parts of LOOP."""

from typing import Any

from pcpc.drivers.can.wire_layout import FRAME_BYTES
from pcpc.drivers.compiled.rows import row_of

STREAK = row_of("since count")  # since: the pass in which the count began
LOSS = row_of("", "enter leave")  # p and q of `executive.loop.losses`
LOSS_STATE = row_of("draw lost")  # s of it; 1 in the lost state


def plausible(limits: int) -> list[Any]:
    """Return the fields; a cycle of -1 is none yet. See `executive.loop.plausibility`."""
    return [
        ("n", "<i8"),
        ("row", "<i8", (limits,)),  # of the received frames
        ("place", "<i8", (limits,)),
        ("count_place", "<i8", (limits,)),
        ("still_cycles", "<i8", (limits,)),
        ("fault_after", "<i8", (limits,)),
        ("bounds", row_of("", "low high rate"), (limits,)),  # rate: a cycle
        ("taken", "<f8", (limits,)),
        ("taken_at", "<i8", (limits,)),
        ("came", "<f8", (limits,)),
        ("came_at", "<i8", (limits,)),
        ("in_a_row", "<i8", (limits,)),
        ("told_until", "<i8", (limits,)),
    ]


def intrusion(frames: int, signals: int) -> list[Any]:
    """Return the fields, most by received frame. See `executive.loop.intrusion`."""
    return [
        ("reaction", "<i8"),  # to what is believed
        ("care", "<i8", (frames,)),  # 1: it may be taken back, its values not taken, or it beats
        ("counted_frame", "u1", (frames, FRAME_BYTES)),  # the one that moved the counter
        ("hints", "<i8", (frames,)),
        ("hint_since", "<i8", (frames,)),  # the pass in which they began
        ("told_until", "<i8", (frames,)),
        ("beat_every", "<i8", (frames,)),  # cycles, of a heartbeat
        ("beat_at", "<i8", (frames,)),
        ("early_at", "<i8", (frames,)),
        ("doubted", "<i8", (frames,)),  # pass + 1 in which it is no input
        ("kept", "<i8", (frames,)),  # pass + 1 in which `before` holds
        ("fresh", "<i8", (frames,)),  # what it added to the input of that cycle
        ("before", "<f8", (signals,)),  # values before this cycle's frame
    ]


def meeting(frames: int, peers: int) -> list[Any]:
    """Return the fields. See `executive.loop.meeting`."""
    return [
        ("between", "<i8"),  # 1: a local node: above on its first bus, below on the second
        ("seeks_below", "<i8"),  # 1: waits for the node below; 0: is the lowest, waits for nobody
        ("ordered", "<i8"),  # lockstep: takes and records only what always happens
        ("met", "<i8", (frames,)),  # heartbeats that were heard
        ("peers", "<i8"),  # how many nodes are below
        ("heard", "<i8"),  # a bit for each that was
        ("sampled", "<i8", (peers,)),  # 1: the first sample of a node below has begun
        ("holding", "<i8", (peers,)),  # row + 1 of the frame in `held`, 0 without
        ("held", "u1", (peers, FRAME_BYTES)),
        ("on_second", "<i8"),  # of a plant: 1: it is on the second bus of the executive
        ("greets", "<i8"),  # 1: it was started alone, and tells what plant its rig has
        ("greeting", "u1", (FRAME_BYTES,)),
    ]

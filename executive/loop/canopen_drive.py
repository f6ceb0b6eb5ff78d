"""The plant's drive on CANopen: its place in a cycle. What it does stands in `drivers.canopen`.

    reception   each frame goes by the drive first; its answer is sent at once
    before      the blocks are stepped: states and loops, from the last sample to the command
    after       they were: the new sample, and what the drive sends by itself

The loop calls these by their addresses, so that a rig without a drive need not compile them. SYNC
and heartbeats of other nodes are also the node's own, where its DBC file has them.
"""

from typing import Any

import numpy as np

from pcpc.drivers.can import codec
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.canopen.layout import Mistake, Row
from pcpc.drivers.canopen.motion import measure
from pcpc.drivers.canopen.node import Whose, hear, speak, work
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.structures import copy
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.sending import send_tx
from pcpc.executive.loop.strangers import note_foreign, word_of

SEEN = (  # what the table shows: name, unit (or whose), meaning
    ("controlword", "", "CiA 402: what the master wants"),
    ("statusword", "", "CiA 402: state of the drive"),
    ("mode", "", "mode of operation that is active"),
    ("nmt", "", "CANopen: 127 pre-operational, 5 operational, 4 stopped"),
    ("error_code", "", "CiA 402: 0 without a fault"),
    ("target_position", "position", "of the master"),
    ("target_velocity", "velocity", "of the master"),
    ("target_torque", "", "of the master, share of what is rated"),
    ("demand_position", "position", "of the profile, or the target"),
    ("position", "position", "as the drive tells it, homed"),
    ("velocity", "velocity", "as the drive tells it"),
    *(("master." + one.name.lower(), "", f"how often a {one.says}") for one in Mistake),
)


@loop_function
def hear_drive(n: Any) -> Any:
    """Let the drive hear `wire.rx`; return 1 if it is nobody else's, else 0."""
    d, word = n.canopen, word_of(n.wire.rx)
    d.k = n.k
    whose = hear(d, n.wire.rx)
    if whose == Whose.OTHER:
        return np.int64(0)
    if whose == Whose.TWIN:
        note_foreign(n, word)
    elif whose == Whose.ALL and codec.frame_of(word, n.rx.frames, n.rx.n) >= 0:
        return np.int64(0)
    else:
        push_frame(n, n.wire.rx, 1, FrameState.OK)
        n.control.received += 1
    answer(n)
    return np.int64(1)


@loop_function
def work_drive(n: Any) -> Any:
    """Step the drive: from the last sample to its command."""
    d = n.canopen
    d.k, at = n.k, d.place_gains
    d.gains.position_per_s, d.gains.velocity = n.v[at], n.v[at + 1]
    d.gains.integral_per_s = n.v[at + 2]
    n.v[d.place_command] = work(d)
    answer(n)
    return np.int64(0)


@loop_function
def speak_drive(n: Any) -> Any:
    """Let the drive take the new sample and send what is due."""
    d = n.canopen
    x, position, velocity = d.state, n.v[d.place_position], 0.0
    if d.place_velocity >= 0:
        velocity = n.v[d.place_velocity]
    elif n.passes > 0:
        velocity = (position - x.before) * d.rate_hz / (1 + n.clock.behind)
    x.before = position
    measure(d, position, velocity)
    speak(d)
    send_outbox(n)
    show(n)
    return np.int64(0)


@loop_function
def answer(n: Any) -> None:
    """Send what the drive has to say at once; in lockstep, if there is room, behind its node's.

    There whoever waits for a frame of the drive goes on once it is here.
    """
    d = n.canopen
    if d.answers_last == 0 or d.n_out > len(d.outbox) // 2:
        send_outbox(n)


@loop_function
def send_outbox(n: Any) -> None:
    """Send what the drive has to say."""
    d = n.canopen
    for i in range(d.n_out):
        copy(n.wire.tx, d.outbox[i])
        send_tx(n)
    d.n_out = 0


@loop_function
def show(n: Any) -> None:
    """Write what is seen into the table, in the order of `SEEN`."""
    d, at = n.canopen, n.canopen.place_seen
    n.v[at] = d.value[Row.CONTROLWORD]
    n.v[at + 1] = d.value[Row.STATUSWORD]
    n.v[at + 2] = d.state.mode
    n.v[at + 3] = d.state.nmt
    n.v[at + 4] = d.value[Row.ERROR_CODE]
    n.v[at + 5] = d.value[Row.TARGET_POSITION] / d.position_scale
    n.v[at + 6] = d.value[Row.TARGET_VELOCITY] / d.velocity_scale
    n.v[at + 7] = d.value[Row.TARGET_TORQUE] * 1e-3
    n.v[at + 8] = d.state.demand_position
    n.v[at + 9] = d.state.position
    n.v[at + 10] = d.state.velocity
    for i in range(len(d.mistakes)):
        n.v[at + 11 + i] = d.mistakes[i]

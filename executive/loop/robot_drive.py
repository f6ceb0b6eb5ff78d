"""The plant's drive in a robot's dialect: its place in a cycle, as `executive.loop.canopen_drive`.

What it does stands in `drivers.robots`.
"""

from typing import Any

import numpy as np

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.canopen.node import Whose
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.robots import loops, mit, moteus, odrive
from pcpc.drivers.robots.layout import Dialect, Mistake
from pcpc.executive.loop.canopen_drive import answer, send_outbox
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.strangers import note_foreign, word_of

hear_odrive, work_odrive, speak_odrive = odrive.hear, odrive.work, odrive.speak
hear_mit, work_mit, speak_mit = mit.hear, mit.work, mit.speak
hear_moteus, work_moteus, speak_moteus = moteus.hear, moteus.work, moteus.speak
measure = loops.measure
SEEN = (  # what the table shows: name, unit (or whose), meaning
    ("state", "", "ODrive: 1 idle, 8 closed loop; MIT: 0 off, 1 on, 13 lost; moteus: mode"),
    ("errors", "", "ODrive: bits of what is wrong; moteus: fault"),
    ("target_position", "position", "of the master"),
    ("target_velocity", "velocity", "of the master"),
    ("target_torque", "", "of the master, as its protocol has it"),
    ("position", "position", "as the drive tells it"),
    ("velocity", "velocity", "as the drive tells it"),
    ("torque", "", "as the drive tells it, in its protocol's unit"),
    *(("master." + one.name.lower(), "", f"how often a {one.says}") for one in Mistake),
)


@loop_function
def hear_robot(n: Any) -> Any:
    """Let the drive hear `wire.rx`; return 1 if it is nobody else's, else 0."""
    d, r, at = n.canopen, n.robot, n.canopen.place_gains
    d.k = n.k
    if r.dialect == Dialect.ODRIVE:
        whose = hear_odrive(r, d, n.wire.rx)
    elif r.dialect == Dialect.MIT:
        whose = hear_mit(r, d, n.wire.rx)
    else:
        whose = hear_moteus(r, d, n.wire.rx)
    if whose == Whose.OTHER:
        return np.int64(0)
    if whose == Whose.TWIN:
        note_foreign(n, word_of(n.wire.rx))
    else:
        push_frame(n, n.wire.rx, 1, FrameState.OK)
        n.control.received += 1
    if r.state.regained != 0:
        r.state.regained = 0
        n.v[at], n.v[at + 1] = d.gains.position_per_s, d.gains.velocity
        n.v[at + 2] = d.gains.integral_per_s
    answer(n)
    return np.int64(1)


@loop_function
def work_robot(n: Any) -> Any:
    """Step the drive: from the last sample to its command."""
    d, r, at = n.canopen, n.robot, n.canopen.place_gains
    d.k = n.k
    d.gains.position_per_s, d.gains.velocity = n.v[at], n.v[at + 1]
    d.gains.integral_per_s = n.v[at + 2]
    if r.dialect == Dialect.ODRIVE:
        torque = work_odrive(r, d)
    elif r.dialect == Dialect.MIT:
        torque = work_mit(r, d)
    else:
        torque = work_moteus(r, d)
    n.v[d.place_command] = d.rated * torque
    return np.int64(0)


@loop_function
def speak_robot(n: Any) -> Any:
    """Let the drive take the new sample and send what is due."""
    d, r = n.canopen, n.robot
    position, velocity = n.v[d.place_position], 0.0
    if d.place_velocity >= 0:
        velocity = n.v[d.place_velocity]
    elif n.passes > 0:
        velocity = (position - d.state.before) * d.rate_hz / (1 + n.clock.behind)
    d.state.before = position
    measure(r, position, velocity)
    if r.dialect == Dialect.ODRIVE:
        speak_odrive(r, d)
    elif r.dialect == Dialect.MIT:
        speak_mit(r, d)
    else:
        speak_moteus(r, d)
    send_outbox(n)
    show(n)
    return np.int64(0)


@loop_function
def show(n: Any) -> None:
    """Write what is seen into the table, in the order of `SEEN`."""
    r, x, at = n.robot, n.robot.state, n.canopen.place_seen
    n.v[at] = x.power
    n.v[at + 1] = x.errors
    n.v[at + 2] = x.target_position / r.position_scale
    n.v[at + 3] = x.target_velocity / r.velocity_scale
    n.v[at + 4] = x.target_torque
    n.v[at + 5] = x.position / r.position_scale
    n.v[at + 6] = x.velocity / r.velocity_scale
    n.v[at + 7] = x.torque
    for i in range(len(r.mistakes)):
        n.v[at + 8 + i] = r.mistakes[i]

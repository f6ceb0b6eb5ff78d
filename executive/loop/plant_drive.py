"""The plant's drive, on CANopen or in a robot's dialect: its place in a cycle.

    reception   each frame goes by the drive first; its answer is sent at once
    before      the blocks are stepped: states and loops, from the last sample to the command
    after       they were: the new sample, and what the drive sends by itself

What it does stands in `drivers.canopen` and `drivers.robots`. The loop calls these by their
addresses, so that a rig without a drive need not compile them. SYNC and heartbeats of other nodes
are also the node's own, where its DBC file has them.
"""

from typing import Any

from pcpc.drivers.can import codec
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.canopen import layout as canopen
from pcpc.drivers.canopen.layout import Od
from pcpc.drivers.canopen.motion import measure
from pcpc.drivers.canopen.node import hear, speak, work
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.numbered import NumberedEnum, WordedEnum
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.stage import call_at
from pcpc.drivers.compiled.structures import copy
from pcpc.drivers.drive.foreign import Maker, maker_of
from pcpc.drivers.drive.layout import Drive, Whose
from pcpc.drivers.robots import layout as robots
from pcpc.drivers.robots.loops import measure as measure_robot
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.sending import send_tx
from pcpc.executive.loop.strangers import note_foreign, word_of


def _counted(mistakes: type[WordedEnum]) -> list[tuple[str, str, str]]:
    every = [*((one.name, one) for one in mistakes), *((f"from_{one.name}", one) for one in Maker)]
    return [("master." + name.lower(), "", f"how often a {one.says}") for name, one in every]


SEEN = (  # what the table shows of one on CANopen: name, unit (or whose), meaning
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
    *_counted(canopen.Mistake),
)
SEEN_ROBOT = (  # and of a robot's
    (
        "state",
        "",
        "ODrive: 1, 8 closed loop; MIT: 0, 1 on, 13 lost; RobStride: 0, 2 on; moteus: mode",
    ),
    ("errors", "", "ODrive, RobStride: bits of what is wrong; moteus: fault"),
    ("target_position", "position", "of the master"),
    ("target_velocity", "velocity", "of the master"),
    ("target_torque", "", "of the master, as its protocol has it"),
    ("position", "position", "as the drive tells it"),
    ("velocity", "velocity", "as the drive tells it"),
    ("torque", "", "as the drive tells it, in its protocol's unit"),
    *_counted(robots.Mistake),
)
# the place of each behind the first
_numbered: Any = NumberedEnum
Seen = _numbered("Seen", [name.upper() for name, *_ in SEEN], start=0)
SeenRobot = _numbered("SeenRobot", [name.upper() for name, *_ in SEEN_ROBOT], start=0)
MISTAKES = len(SEEN) - len(canopen.Mistake) - len(Maker)
MISTAKES_ROBOT = len(SEEN_ROBOT) - len(robots.Mistake) - len(Maker)


@loop_function
def hear_drive(n: Loop) -> int:
    """Let the drive hear `wire.rx`; return 1 if it is nobody else's, else 0."""
    d = n.canopen
    d.k = n.k
    return taken(n, d, hear(d, n.wire.rx))


@loop_function
def hear_robot(n: Loop) -> int:
    """Let a robot's drive hear it."""
    r = n.robot
    r.k = n.k
    copy(r.rx, n.wire.rx)
    took = taken(n, r, call_at(r.hears, r))
    if took != 0 and r.state.regained != 0:
        r.state.regained = 0
        g, place = r.gains, r.place_gains
        n.v[place], n.v[place + 1] = g.position_per_s, g.velocity
        n.v[place + 2] = g.integral_per_s
    return took


@loop_function
def taken(n: Loop, d: Drive, whose: int) -> int:
    """Record `wire.rx` and answer; return 1 if it is nobody else's, else 0."""
    word = word_of(n.wire.rx)
    awaited = whose == Whose.ALL and codec.frame_of(word, n.rx.frames, n.rx.n) >= 0
    if whose == Whose.OTHER:
        note_other(n, d, word)
    if whose == Whose.OTHER or awaited:
        return int64(0)
    if whose == Whose.TWIN:
        note_foreign(n, word)
    else:
        push_frame(n, n.wire.rx, 1, FrameState.OK)
        n.control.received += 1
    answer(n, d)
    return int64(1)


@loop_function
def note_other(n: Loop, d: Drive, word: int) -> None:
    """Count what is another maker's order to this node, unless a drive of the rig takes it."""
    maker = maker_of(n.wire.rx, d.node)
    known = maker < 0 or d.makers >> int64(maker) & 1 != 0
    if not known and codec.frame_of(word, n.rx.frames, n.rx.n) < 0:
        d.foreign[maker] += 1


@loop_function
def begin(n: Loop, d: Drive) -> None:
    """Tell the drive cycle and gains."""
    place = d.place_gains
    d.k = n.k
    d.gains.position_per_s, d.gains.velocity = n.v[place], n.v[place + 1]
    d.gains.integral_per_s = n.v[place + 2]


@loop_function
def work_drive(n: Loop) -> int:
    """Step the drive: from the last sample to its command."""
    d = n.canopen
    begin(n, d)
    n.v[d.place_command] = work(d)
    answer(n, d)
    return int64(0)


@loop_function
def work_robot(n: Loop) -> int:
    """Step a robot's drive."""
    r = n.robot
    begin(n, r)
    call_at(r.works, r)
    n.v[r.place_command] = r.rated * r.state.torque
    return int64(0)


@loop_function
def velocity_at(n: Loop, d: Drive, position: float) -> float:
    """Return the velocity of the new sample: measured, or by the difference of positions."""
    velocity = 0.0
    if d.place_velocity >= 0:
        velocity = n.v[d.place_velocity]
    elif n.passes > 0:
        velocity = (position - d.before) * d.rate_hz / (1 + n.clock.behind)
    d.before = position
    return velocity


@loop_function
def speak_drive(n: Loop) -> int:
    """Let the drive take the new sample and send what is due; show it."""
    d, position = n.canopen, n.v[n.canopen.place_position]
    measure(d, position, velocity_at(n, d, position))
    speak(d)
    send_outbox(n, d)
    x, place = d.state, d.place_seen
    n.v[place + Seen.CONTROLWORD] = d.value[Od.CONTROLWORD]
    n.v[place + Seen.STATUSWORD] = d.value[Od.STATUSWORD]
    n.v[place + Seen.MODE] = x.mode
    n.v[place + Seen.NMT] = x.nmt
    n.v[place + Seen.ERROR_CODE] = d.value[Od.ERROR_CODE]
    n.v[place + Seen.TARGET_POSITION] = d.value[Od.TARGET_POSITION] / d.position_scale
    n.v[place + Seen.TARGET_VELOCITY] = d.value[Od.TARGET_VELOCITY] / d.velocity_scale
    n.v[place + Seen.TARGET_TORQUE] = d.value[Od.TARGET_TORQUE] * 1e-3
    n.v[place + Seen.DEMAND_POSITION] = x.demand_position
    n.v[place + Seen.POSITION] = x.position
    n.v[place + Seen.VELOCITY] = x.velocity
    for i in range(len(d.mistakes)):
        n.v[place + MISTAKES + i] = d.mistakes[i]
    for i in range(len(d.foreign)):
        n.v[place + MISTAKES + len(d.mistakes) + i] = d.foreign[i]
    return int64(0)


@loop_function
def speak_robot(n: Loop) -> int:
    """Do the same for a robot's drive."""
    r, position = n.robot, n.v[n.robot.place_position]
    measure_robot(r, position, velocity_at(n, r, position))
    call_at(r.speaks, r)
    send_outbox(n, r)
    x, place = r.state, r.place_seen
    n.v[place + SeenRobot.STATE] = x.power
    n.v[place + SeenRobot.ERRORS] = x.errors
    n.v[place + SeenRobot.TARGET_POSITION] = x.target_position / r.position_scale
    n.v[place + SeenRobot.TARGET_VELOCITY] = x.target_velocity / r.velocity_scale
    n.v[place + SeenRobot.TARGET_TORQUE] = x.target_torque
    n.v[place + SeenRobot.POSITION] = x.position / r.position_scale
    n.v[place + SeenRobot.VELOCITY] = x.velocity / r.velocity_scale
    n.v[place + SeenRobot.TORQUE] = x.torque
    for i in range(len(r.mistakes)):
        n.v[place + MISTAKES_ROBOT + i] = r.mistakes[i]
    for i in range(len(r.foreign)):
        n.v[place + MISTAKES_ROBOT + len(r.mistakes) + i] = r.foreign[i]
    return int64(0)


@loop_function
def answer(n: Loop, d: Drive) -> None:
    """Send what the drive has to say at once; in lockstep, if there is room, behind its node's.

    There whoever waits for a frame of the drive goes on once it is here.
    """
    if d.answers_last == 0 or d.n_out > len(d.outbox) // 2:
        send_outbox(n, d)


@loop_function
def send_outbox(n: Loop, d: Drive) -> None:
    """Send what the drive has to say."""
    for i in range(d.n_out):
        copy(n.wire.tx, d.outbox[i])
        send_tx(n)
    d.n_out = 0

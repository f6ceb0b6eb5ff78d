"""Acme's dialect: a torque in, the position out.

300 + node   a torque, float32; it is switched on by the first one
380 + node   the position, float32: the answer
"""

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.canopen.frames import put
from pcpc.drivers.canopen.node import Whose
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.robots.layout import Dialect
from pcpc.drivers.robots.loops import measure, number_at, word_of
from pcpc.drivers.robots.settings import Setting
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.plant_drive import SeenRobot, begin, send_outbox, taken, velocity_at
from pcpc.executive.nodes.planned_robot import RobotKind

TORQUE, POSITION = 0x300, 0x380


@loop_function
def hear(n: Loop) -> int:
    """Take a torque and answer with the position; return 1 if the frame is nobody else's."""
    d, frame, whose = n.canopen, n.wire.rx, int64(Whose.OTHER)
    d.k = n.k
    if four_bytes(frame, 0) == TORQUE + d.node and frame[LENGTH] == 4:
        x = n.robot.state
        x.target_torque, x.power, whose = number_at(data_of(frame), 0), 1, int64(Whose.OURS)
        put(d, POSITION + d.node, 4, word_of(x.position), 0)
    return taken(n, whose)


@loop_function
def work(n: Loop) -> int:
    """Hold the torque, within the limit."""
    begin(n)
    x, most = n.robot.state, n.robot.value[0]
    x.torque = min(max(x.target_torque, -most), most)
    n.v[n.canopen.place_command] = n.canopen.rated * x.torque
    return int64(0)


@loop_function
def speak(n: Loop) -> int:
    """Take the new sample; show it."""
    d, x, place = n.canopen, n.robot.state, n.canopen.place_seen
    position = n.v[d.place_position]
    measure(n.robot, position, velocity_at(n, position))
    send_outbox(n)
    n.v[place + SeenRobot.STATE] = x.power
    n.v[place + SeenRobot.TARGET_TORQUE] = x.target_torque
    n.v[place + SeenRobot.POSITION] = x.position
    n.v[place + SeenRobot.TORQUE] = x.torque
    return int64(0)


KIND = RobotKind(
    Dialect.NONE,
    range(1, 128),
    (Setting("most_torque", 1, 0.5),),
    1.0,
    lambda node, _: {TORQUE + node, POSITION + node},
    lambda node, _: {TORQUE + node, POSITION + node},
    lambda node, _: {TORQUE + node: "torque", POSITION + node: "position"},
    (hear, work, speak),
)

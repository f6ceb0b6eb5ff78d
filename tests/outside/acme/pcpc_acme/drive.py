"""Acme's dialect: a torque in, the position out.

300 + node   a torque, float32; the first one switches it on
380 + node   the position, float32: the answer
"""

import sys

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.drive.layout import Whose
from pcpc.drivers.drive.outbox import put
from pcpc.drivers.robots.fields import number_at, word_of
from pcpc.drivers.robots.layout import Robot
from pcpc.drivers.robots.settings import Setting
from pcpc.executive.nodes.planned_robot import RobotKind

TORQUE, POSITION = 0x300, 0x380


@loop_function
def hear(r: Robot) -> int:
    """Take the frame in `rx`; return whose it is."""
    if four_bytes(r.rx, 0) != TORQUE + r.node or r.rx[LENGTH] != 4:
        return int64(Whose.OTHER)
    r.state.target_torque, r.state.power = number_at(data_of(r.rx), 0), 1
    put(r, POSITION + r.node, 4, word_of(r.state.position), 0)
    return int64(Whose.OURS)


@loop_function
def work(r: Robot) -> int:
    """Hold the torque, within the limit."""
    most = r.value[0]
    r.state.torque = min(max(r.state.target_torque, -most), most)
    return int64(0)


@loop_function
def speak(r: Robot) -> int:
    """Send nothing: it only answers."""
    return int64(0)


KIND = RobotKind(
    sys.modules[__name__],
    range(1, 128),
    (Setting("most_torque", 1, 0.5),),
    1.0,
    lambda node, _: {TORQUE + node, POSITION + node},
    lambda node, _: {TORQUE + node, POSITION + node},
    lambda node, _: {TORQUE + node: "torque", POSITION + node: "position"},
)

"""Orders in another maker's protocol: what a drive hears if its master takes it for another.

Recognised is what a master of each cannot do without, to this node; to another one, or to all, it
may be right. What J1939 and others send beside it is none of these.

    CiA 402     000: start, stop, reset; 600 + node, 8 bytes: SDO
    ODrive      node << 5 | 7: state 1 or 8
    MIT         node, 7 bytes of FF: on, off, zero, forget
    moteus      CAN FD to the node that begins with 01 00: one byte into its register 0, the mode
    RobStride   29 bits, of type 03 or 12, to the node: on, write; in J1939 both are reserved
"""

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.numbered import WordedEnum
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH
from pcpc.drivers.compiled.structures import data_of


class Maker(WordedEnum):
    """Whose protocol an order was in; behind `master.from_` the name of a variable."""

    CIA402 = "frame to this node was CANopen's, which the drive does not speak"
    ODRIVE = "frame to this node was an ODrive's, which the drive is not"
    MIT = "frame to this node was MIT mode's, which the drive does not speak"
    MOTEUS = "frame to this node was a moteus', which the drive is not"
    ROBSTRIDE = "frame to this node was a RobStride's, which the drive is not"


@loop_function
def maker_of(frame: Cells[Byte], node: int) -> int:
    """Return whose order to a node a frame is, -1 for nobody's."""
    word, n, data = four_bytes(frame, 0), int64(frame[LENGTH]), data_of(frame)
    number, order, first = word & 0x1FFFFFFF, int64(data[7]), four_bytes(data, 0)
    if frame[FLAGS] != 0:
        sets_mode = n >= 3 and data[0] == 1 and data[1] == 0
        to_node = number & 127 == node and number <= 0xFFFF
        return int64(Maker.MOTEUS if to_node and sets_mode else -1)
    if word >> int64(31) != 0:
        kind = number >> int64(24)
        to_node = number & 255 == node and n == 8
        return int64(Maker.ROBSTRIDE if to_node and (kind == 0x03 or kind == 0x12) else -1)
    if word >> int64(30) != 0:
        return int64(-1)
    if number == 0 and n == 2 and data[1] == node:
        return int64(Maker.CIA402 if 0 < data[0] <= 130 else -1)
    if n == 8 and number == 0x600 + node:
        return int64(Maker.CIA402)
    ones = first == 0xFFFFFFFF and four_bytes(data, 3) == 0xFFFFFFFF
    if n == 8 and number == node and ones and 0xFB <= order <= 0xFE:
        return int64(Maker.MIT)
    if n >= 4 and number == node << int64(5) | 7 and (first == 1 or first == 8):
        return int64(Maker.ODRIVE)
    return int64(-1)

"""What each drive has, as the compiled loop uses it (no numba here).

place_...  of variables in the node's table
outbox     frames to be sent, as `drivers.can.wire` has them
"""

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Cells, Element, Record, carried, cells
from pcpc.drivers.compiled.rows import FrameBytes
from pcpc.drivers.drive.foreign import Maker

OUTBOX_FRAMES = 16


class Whose(NumberedEnum):
    """Whose a frame is: another node's, the drive's, of all (SYNC), or of a second such drive."""

    OTHER, OURS, ALL, TWIN = range(4)


class DriveGains(Element):
    """Of its loops."""

    position_per_s: float
    velocity: float
    integral_per_s: float


class Hooks(Record):
    """What a node calls of its drive, by `compiled.stage.call_at`."""

    on: int  # 1: there is one
    hears: int
    works: int
    speaks: int


class Drive(Record):
    """A drive."""

    node: int
    place_position: int
    place_velocity: int  # -1: the differences of positions
    place_command: int
    place_gains: int  # three
    place_seen: int  # the first of what is seen, see `executive.loop.plant_drive`
    rate_hz: float
    rated: float  # the command at 100 %, of a robot's drive at a torque of 1
    position_scale: float  # of the protocol's unit to that of the plant
    velocity_scale: float
    gains: DriveGains
    k: int  # the cycle
    n_out: int
    answers_last: int  # 1: in lockstep, behind what its node sends
    outbox: Cells[FrameBytes] = cells(OUTBOX_FRAMES)
    before: float = carried()  # the position, a cycle ago
    makers: int  # a bit for each whose orders some drive of the rig takes
    foreign: Cells[int] = carried(shape=len(Maker))  # orders of others

"""The memory of a robot's drive, as a structure that the compiled loop uses (no numba here).

    value     its settings, in the order of the dialect's own table (`odrive`, `mit`, `moteus`, ...)
    state     what it carries from one cycle to the next, in the units of its protocol
    rx        the frame that it hears

Its dialect are three functions of it, whose addresses it has: `hears` returns whose `rx` is,
`works` brings `state.torque` to that of the cycle, `speaks` sends what is due at its end.
"""

from pcpc.drivers.compiled.numbered import WordedEnum
from pcpc.drivers.compiled.records import Cells, Element, carried, cells
from pcpc.drivers.compiled.rows import FrameBytes
from pcpc.drivers.drive.layout import Drive

MAX_SETTINGS = 64
CYCLIC = 8  # frames that are sent by themselves, at most


class Mistake(WordedEnum):
    """What a master does wrong, counted; behind `master.` the name of a variable."""

    FRAME_SHORT = "frame was shorter than its command"
    NOT_FINITE = "value was no finite number"
    COMMAND_REFUSED = "command was none that the drive has, or not now"
    VALUE_REFUSED = "setting was not there, or its value outside of its bounds"
    TARGET_CLIPPED = "target was outside the limits"
    SILENT = "master was silent for longer than the drive waits"
    NOT_SWITCHED = "frame of CAN FD came without the bit rate switch of the bus"
    TO_CANOPEN = "drive was to switch to CANopen, and keeps its protocol"
    TO_MIT = "drive was to switch to MIT mode, and keeps its protocol"


class SettingRow(Element):
    """A setting as it was declared."""

    number: int
    whole: int
    writable: int
    start: float
    low: float
    high: float


class RobotState(Element):
    """What it carries from one cycle to the next, in the units of its protocol."""

    power: int
    errors: int
    disarmed_by: int
    result: int
    arrived: int
    boots: int
    host: int  # that the last order came from
    reports: int  # 1: feedback is sent by itself
    fed_at: int
    regained: int  # 1 once the master has given gains
    position: float
    velocity: float
    torque: float
    offset: float
    target_position: float
    target_velocity: float
    target_torque: float
    stiffness: float
    damping: float
    most_velocity: float
    most_torque: float
    way_position: float  # what is demanded of the loops, and the next two
    way_velocity: float
    way_torque: float
    integral: float


class Cursor(Element):
    """A place in a frame and its answer."""

    at: int
    end: int
    ok: int
    out: int
    answers: int
    mode: int


class Robot(Drive):
    """The drive."""

    hears: int  # of `compiled.stage.call_at`, and the next two
    works: int
    speaks: int
    rx: FrameBytes
    n: int  # settings
    settings: Cells[SettingRow] = cells(MAX_SETTINGS)
    cursor: Cursor  # in a frame and its answer
    value: Cells[float] = carried(shape=MAX_SETTINGS)
    state: RobotState = carried()
    mistakes: Cells[int] = carried(shape=len(Mistake))
    switches: int  # 1: the bus has a second bit rate
    sent_at: Cells[int] = carried(shape=CYCLIC)

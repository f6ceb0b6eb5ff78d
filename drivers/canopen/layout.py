"""The memory of a CANopen drive, as a structure that the compiled loop uses (no numba here).

    objects    the dictionary as it was declared, a row an object, see `drivers.canopen.objects`
    value      the raw value of each row
    state      what the drive carries from one cycle to the next, beside the values

Rows of the PDOs come first, each PDO's on its own: communication, then mapping.
"""

from typing import Any

import numpy as np

from pcpc.drivers.compiled.numbered import NumberedEnum, WordedEnum
from pcpc.drivers.compiled.records import Byte, Cells, Element, carried, cells
from pcpc.drivers.drive.layout import Drive

MAX_OBJECTS = 1024
PDOS = 4  # of each direction; numbers 0 to 3 are received, 4 to 7 sent
MAX_ENTRIES = 8  # mapped in one PDO
TEXTS, TEXT_BYTES = 3, 32
READ, WRITE, TO_DRIVE, FROM_DRIVE = 1, 2, 4, 8  # access; the last two: may be mapped
RPDO_ROWS, TPDO_ROWS = 3 + 1 + MAX_ENTRIES, 5 + 1 + MAX_ENTRIES
COB_ID, KIND, INHIBIT, EVENT = 1, 2, 3, 4  # rows of a PDO's communication
RPDO_MAPPING, TPDO_MAPPING = 3, 5  # row with the number of its entries
FIRST_TPDO = PDOS * RPDO_ROWS
OTHERS = FIRST_TPDO + PDOS * TPDO_ROWS


class Heartbeat(NumberedEnum):
    """The states of CiA 301, as a heartbeat has them."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class ErrorRegister(NumberedEnum):
    """Error registers of CiA 301's emergency frame."""

    NONE, GENERIC, COMMUNICATION, MOTION = 0, 0x01, 0x11, 0x21


class ErrorCode(NumberedEnum):
    """Its error codes, each with its register."""

    register: ErrorRegister

    def __new__(cls, code: int, register: ErrorRegister = ErrorRegister.GENERIC) -> "ErrorCode":
        """Return a member."""
        one = int.__new__(cls, code)
        one._value_, one.register = code, register
        return one

    NONE = 0, ErrorRegister.NONE
    SOFTWARE = 0x6100
    LAW = 0x6200
    SENSOR = 0x7300
    BUS = 0x8100, ErrorRegister.COMMUNICATION
    SILENCE = 0x8130, ErrorRegister.COMMUNICATION
    BACK_FROM_OFF = 0x8140, ErrorRegister.COMMUNICATION
    COLLISION = 0x8150, ErrorRegister.COMMUNICATION
    PROTOCOL = 0x8200, ErrorRegister.COMMUNICATION
    PDO_SHORT = 0x8210, ErrorRegister.COMMUNICATION
    FOLLOWING = 0x8611, ErrorRegister.MOTION
    EXTERNAL = 0x9000


class Power(NumberedEnum):
    """The states of CiA 402, with the bits that a statusword has for each."""

    word: int

    def __new__(cls, word: int) -> "Power":
        """Return the next member."""
        one = int.__new__(cls, len(cls.__members__))
        one._value_, one.word = int(one), word
        return one

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


POWER_WORDS = np.array([power.word for power in Power], np.int64)
VOLTAGE, WARNING, REMOTE, REACHED, LIMITED = 1 << 4, 1 << 7, 1 << 9, 1 << 10, 1 << 11  # beside it


class OperationMode(NumberedEnum):
    """Modes of operation, object 0x6060."""

    NONE = 0
    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    HOMING = 6
    CYCLIC_POSITION = 8
    CYCLIC_VELOCITY = 9
    CYCLIC_TORQUE = 10


class ObjectType(NumberedEnum):
    """Data types of CiA 301."""

    I8, I16, I32, U8, U16, U32 = range(2, 8)
    F32, TEXT = 8, 9


RO, RW = READ, READ | WRITE
SENT, TAKEN = RO | FROM_DRIVE, RW | TO_DRIVE | FROM_DRIVE
SERVO_DRIVE = 0x0002_0192  # CiA 402
MODES = sum(1 << mode - 1 for mode in OperationMode if mode)
SELF_STARTING = 8  # of object 0x1F80
NO_WINDOW = 0xFFFF_FFFF  # nothing is watched


class Od(NumberedEnum):
    """Rows of the dictionary behind those of the PDOs, each with its object.

    Index, subindex, kind, access; value at the start, lowest and highest.
    """

    declared: tuple[Any, ...]

    def __new__(cls, *declared: Any) -> "Od":
        """Return the next member."""
        one = int.__new__(cls, OTHERS + len(cls.__members__))
        one._value_, one.declared = int(one), declared
        return one

    DEVICE_TYPE = 0x1000, 0, ObjectType.U32, RO, SERVO_DRIVE
    ERROR_REGISTER = 0x1001, 0, ObjectType.U8, SENT
    ERROR_COUNT = 0x1003, 0, ObjectType.U8, RW, 0, 0, 0
    ERROR_1 = 0x1003, 1, ObjectType.U32, RO
    ERROR_2 = 0x1003, 2, ObjectType.U32, RO
    ERROR_3 = 0x1003, 3, ObjectType.U32, RO
    ERROR_4 = 0x1003, 4, ObjectType.U32, RO
    SYNC_ID = 0x1005, 0, ObjectType.U32, RW, 0x80, 0x80, 0x80
    DEVICE_NAME = 0x1008, 0, ObjectType.TEXT, RO
    HARDWARE = 0x1009, 0, ObjectType.TEXT, RO
    SOFTWARE = 0x100A, 0, ObjectType.TEXT, RO
    EMERGENCY_ID = 0x1014, 0, ObjectType.U32, RO
    CONSUMERS = 0x1016, 0, ObjectType.U8, RO, 1
    CONSUMER = 0x1016, 1, ObjectType.U32, RW, 0, 0, 0x7F_FFFF
    HEARTBEAT_MS = 0x1017, 0, ObjectType.U16, RW
    IDENTITY = 0x1018, 0, ObjectType.U8, RO, 4
    VENDOR = 0x1018, 1, ObjectType.U32, RO
    PRODUCT = 0x1018, 2, ObjectType.U32, RO
    REVISION = 0x1018, 3, ObjectType.U32, RO, 1 << 16
    SERIAL = 0x1018, 4, ObjectType.U32, RO
    SDO_COUNT = 0x1200, 0, ObjectType.U8, RO, 2
    SDO_IN = 0x1200, 1, ObjectType.U32, RO
    SDO_OUT = 0x1200, 2, ObjectType.U32, RO
    STARTUP = 0x1F80, 0, ObjectType.U32, RW, 0, 0, SELF_STARTING
    ERROR_CODE = 0x603F, 0, ObjectType.U16, SENT
    CONTROLWORD = 0x6040, 0, ObjectType.U16, TAKEN
    STATUSWORD = 0x6041, 0, ObjectType.U16, SENT
    QUICK_STOP_OPTION = 0x605A, 0, ObjectType.I16, RW, 2, 0, 6
    SHUTDOWN_OPTION = 0x605B, 0, ObjectType.I16, RW, 0, 0, 1
    DISABLE_OPTION = 0x605C, 0, ObjectType.I16, RW, 0, 0, 1
    HALT_OPTION = 0x605D, 0, ObjectType.I16, RW, 1, 1, 1
    FAULT_OPTION = 0x605E, 0, ObjectType.I16, RW, 2, 0, 2
    MODE = 0x6060, 0, ObjectType.I8, TAKEN
    MODE_DISPLAY = 0x6061, 0, ObjectType.I8, SENT
    POSITION_DEMAND = 0x6062, 0, ObjectType.I32, SENT
    POSITION_ACTUAL = 0x6064, 0, ObjectType.I32, SENT
    FOLLOWING_WINDOW = 0x6065, 0, ObjectType.U32, RW, NO_WINDOW
    FOLLOWING_MS = 0x6066, 0, ObjectType.U16, RW
    POSITION_WINDOW = 0x6067, 0, ObjectType.U32, RW, 10
    POSITION_MS = 0x6068, 0, ObjectType.U16, RW
    VELOCITY_DEMAND = 0x606B, 0, ObjectType.I32, SENT
    VELOCITY_ACTUAL = 0x606C, 0, ObjectType.I32, SENT
    VELOCITY_WINDOW = 0x606D, 0, ObjectType.U16, RW, 10
    VELOCITY_MS = 0x606E, 0, ObjectType.U16, RW
    TARGET_TORQUE = 0x6071, 0, ObjectType.I16, TAKEN
    MAX_TORQUE = 0x6072, 0, ObjectType.U16, TAKEN, 1000, 0, 1000
    TORQUE_DEMAND = 0x6074, 0, ObjectType.I16, SENT
    TORQUE_ACTUAL = 0x6077, 0, ObjectType.I16, SENT
    TARGET_POSITION = 0x607A, 0, ObjectType.I32, TAKEN
    HOME_OFFSET = 0x607C, 0, ObjectType.I32, RW
    LIMITS = 0x607D, 0, ObjectType.U8, RO, 2
    LIMIT_LOW = 0x607D, 1, ObjectType.I32, RW, -(1 << 31)
    LIMIT_HIGH = 0x607D, 2, ObjectType.I32, RW, (1 << 31) - 1
    PROFILE_VELOCITY = 0x6081, 0, ObjectType.U32, TAKEN, 1000, 0, (1 << 31) - 1
    ACCELERATION = 0x6083, 0, ObjectType.U32, TAKEN, 10_000, 1, (1 << 31) - 1
    DECELERATION = 0x6084, 0, ObjectType.U32, TAKEN, 10_000, 1, (1 << 31) - 1
    QUICK_STOP_DECELERATION = 0x6085, 0, ObjectType.U32, TAKEN, 50_000, 1, (1 << 31) - 1
    HOMING_METHOD = 0x6098, 0, ObjectType.I8, TAKEN, 37, 35, 37
    VELOCITY_OFFSET = 0x60B1, 0, ObjectType.I32, TAKEN
    TORQUE_OFFSET = 0x60B2, 0, ObjectType.I16, TAKEN
    FOLLOWING_ERROR = 0x60F4, 0, ObjectType.I32, SENT
    TARGET_VELOCITY = 0x60FF, 0, ObjectType.I32, TAKEN
    MODES = 0x6502, 0, ObjectType.U32, RO, MODES
    ABORT_OPTION = 0x6007, 0, ObjectType.I16, RW, 1, 0, 3
    MAX_PROFILE_VELOCITY = 0x607F, 0, ObjectType.U32, RW, (1 << 31) - 1, 0, (1 << 31) - 1
    HOMING_SPEEDS = 0x6099, 0, ObjectType.U8, RO, 2
    HOMING_FAST = 0x6099, 1, ObjectType.U32, RW
    HOMING_SLOW = 0x6099, 2, ObjectType.U32, RW
    HOMING_ACCELERATION = 0x609A, 0, ObjectType.U32, RW
    PERIODS = 0x60C2, 0, ObjectType.U8, RO, 2
    PERIOD = 0x60C2, 1, ObjectType.U8, RW, 1, 1, 255
    PERIOD_EXPONENT = 0x60C2, 2, ObjectType.I8, RW, -3, -6, 0
    SYNC_PERIOD = 0x1006, 0, ObjectType.U32, RW


class Mistake(WordedEnum):
    """What a master does wrong, counted; behind `master.` the name of a variable."""

    SDO_ABORTED = "SDO was aborted"
    COMMAND_IGNORED = "controlword asked for a transition that its state does not have"
    VALUE_REFUSED = "value in a PDO was outside its object's bounds"
    TARGET_CLIPPED = "target was outside the software limits"
    PDO_SHORT = "PDO was shorter than its mapping"
    PDO_EARLY = "PDO came outside OPERATIONAL"
    PDO_MISSING = "PDO was missing between two SYNCs"
    PDO_TWICE = "PDO came more than once between two SYNCs"
    SYNC_OFF = "SYNC was off by half of the period 0x1006, and more than a cycle"


class ObjectRow(Element):
    """An object as it was declared."""

    index: int
    subindex: int
    bits: int
    sign: int
    text: int
    access: int
    low: int
    high: int
    start: int


class DriveState(Element):
    """What the drive carries from one cycle to the next, beside the values."""

    nmt: int
    beat_at: int  # the cycle of the last one
    boots: int
    syncs: int
    sync_at: int  # the cycle of the last one
    heard: int  # 1: the heartbeat that is awaited came once
    heard_at: int
    guarded: int  # the next toggle
    power: int
    word_before: int  # of the command
    mode: int
    enabled: int
    moves: int
    pends: int
    acknowledged: int
    homed: int
    reached: int
    limited: int
    behind_since: int
    near_since: int
    stopped_before: int
    wanted: int
    steps_left: int
    leaves: int  # for which state, after a ramp
    segment_row: int
    segment_toggle: int
    segment_at: int
    segment_size: int
    segment_since: int
    segment_data: int
    segment_loads: int
    position: float
    velocity: float
    offset: float
    demand_position: float
    demand_velocity: float
    integral: float
    target: float
    pending: float
    step: float


class Canopen(Drive):
    """The drive."""

    n: int  # objects
    objects: Cells[ObjectRow] = cells(MAX_OBJECTS)
    text: Cells[Byte] = cells(TEXTS * TEXT_BYTES)
    value: Cells[int] = carried(shape=MAX_OBJECTS)
    state: DriveState = carried()
    map_id: Cells[int] = carried(shape=2 * PDOS)  # -1: not valid
    map_n: Cells[int] = carried(shape=2 * PDOS)
    map_row: Cells[int] = carried(shape=2 * PDOS * MAX_ENTRIES)
    mistakes: Cells[int] = carried(shape=len(Mistake))  # of the master
    pending: Cells[int] = carried(shape=PDOS)  # 1: what came waits for a SYNC
    owed: Cells[int] = carried(shape=PDOS)  # more, or fewer, than the SYNCs between
    since_sync: Cells[int] = carried(shape=PDOS)  # how often it came; -1: never, not awaited
    pending_low: Cells[int] = carried(shape=PDOS)  # its first four bytes, and the others
    pending_high: Cells[int] = carried(shape=PDOS)
    sent_low: Cells[int] = carried(shape=PDOS)
    sent_high: Cells[int] = carried(shape=PDOS)
    sent_at: Cells[int] = carried(shape=PDOS)  # -1: not yet
    sync_count: Cells[int] = carried(shape=PDOS)

"""The object dictionary of the drive, declared once: for SDOs, PDOs and the EDS.

    units   position, velocity and acceleration in increments, as the rig's `scale` has them; torque
            in 1/1000 of what is rated; times in ms

An object that is not here does not exist (abort 0x06020000): node guarding (use the heartbeat,
0x1017), storing and restoring of parameters, touch probes, interpolated position, profile torque,
the velocity mode of frequency converters. Homing on the spot needs no speeds (0x6099, 0x609A),
which masters write all the same. Limits are those of the abort codes 0x06090031 and
0x06090032. Source: CiA 301, 7.5; CiA 402-2 and IEC 61800-7-201.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pcpc.drivers.canopen import layout as at
from pcpc.drivers.canopen.layout import Heartbeat, Mode, Row
from pcpc.drivers.compiled.numbered import NumberedEnum


class Kind(NumberedEnum):
    """Data types of CiA 301."""

    I8, I16, I32, U8, U16, U32 = range(2, 8)
    F32, TEXT = 8, 9


BITS = {Kind.I8: 8, Kind.I16: 16, Kind.I32: 32, Kind.U8: 8, Kind.U16: 16, Kind.U32: 32}
BITS[Kind.F32] = 32  # as they are on the wire
RO, RW = at.READ, at.READ | at.WRITE
SENT, TAKEN = RO | at.FROM_DRIVE, RW | at.TO_DRIVE | at.FROM_DRIVE
NOT_VALID = 1 << 31  # of a COB-ID
SERVO_DRIVE = 0x0002_0192  # CiA 402
MODES = sum(1 << mode - 1 for mode in Mode if mode)
SELF_STARTING = 8  # of object 0x1F80
STATUS_MS = 20  # event timer of the first sent PDO: masters wait 0.2 s for a statusword
NO_WINDOW = 0xFFFF_FFFF  # nothing is watched


@dataclass(frozen=True)
class Object:
    """One object: its place, type, access, value at the start and bounds."""

    name: str
    index: int
    subindex: int
    kind: Kind
    access: int
    start: int = 0
    low: int | None = None
    high: int | None = None
    text: str = ""

    @property
    def bits(self) -> int:
        """Its size; 0 of a text."""
        return BITS.get(self.kind, 0)

    @property
    def signed(self) -> bool:
        """Whether raw values are in two's complement."""
        return self.kind in (Kind.I8, Kind.I16, Kind.I32)

    @property
    def bounds(self) -> tuple[int, int]:
        """The lowest and the highest value."""
        low = -(1 << self.bits - 1) if self.signed else 0
        high = low + (1 << self.bits) - 1 if self.bits else 0
        return (low if self.low is None else self.low, high if self.high is None else self.high)

    @property
    def key(self) -> str:
        """Its index and subindex, as a rig writes them: 6040, 1018.2."""
        return f"{self.index:04X}" + (f".{self.subindex}" if self.subindex else "")


_OTHERS: Mapping[Row, tuple[Any, ...]] = {
    Row.DEVICE_TYPE: (0x1000, 0, Kind.U32, RO, SERVO_DRIVE),
    Row.ERROR_REGISTER: (0x1001, 0, Kind.U8, SENT),
    Row.ERROR_COUNT: (0x1003, 0, Kind.U8, RW, 0, 0, 0),
    Row.ERROR_1: (0x1003, 1, Kind.U32, RO),
    Row.ERROR_2: (0x1003, 2, Kind.U32, RO),
    Row.ERROR_3: (0x1003, 3, Kind.U32, RO),
    Row.ERROR_4: (0x1003, 4, Kind.U32, RO),
    Row.SYNC_ID: (0x1005, 0, Kind.U32, RW, 0x80, 0x80, 0x80),
    Row.DEVICE_NAME: (0x1008, 0, Kind.TEXT, RO),
    Row.HARDWARE: (0x1009, 0, Kind.TEXT, RO),
    Row.SOFTWARE: (0x100A, 0, Kind.TEXT, RO),
    Row.EMERGENCY_ID: (0x1014, 0, Kind.U32, RO),
    Row.CONSUMERS: (0x1016, 0, Kind.U8, RO, 1),
    Row.CONSUMER: (0x1016, 1, Kind.U32, RW, 0, 0, 0x7F_FFFF),
    Row.HEARTBEAT_MS: (0x1017, 0, Kind.U16, RW),
    Row.IDENTITY: (0x1018, 0, Kind.U8, RO, 4),
    Row.VENDOR: (0x1018, 1, Kind.U32, RO),
    Row.PRODUCT: (0x1018, 2, Kind.U32, RO),
    Row.REVISION: (0x1018, 3, Kind.U32, RO, 1 << 16),
    Row.SERIAL: (0x1018, 4, Kind.U32, RO),
    Row.SDO_COUNT: (0x1200, 0, Kind.U8, RO, 2),
    Row.SDO_IN: (0x1200, 1, Kind.U32, RO),
    Row.SDO_OUT: (0x1200, 2, Kind.U32, RO),
    Row.STARTUP: (0x1F80, 0, Kind.U32, RW, 0, 0, SELF_STARTING),
    Row.ERROR_CODE: (0x603F, 0, Kind.U16, SENT),
    Row.CONTROLWORD: (0x6040, 0, Kind.U16, TAKEN),
    Row.STATUSWORD: (0x6041, 0, Kind.U16, SENT),
    Row.QUICK_STOP_OPTION: (0x605A, 0, Kind.I16, RW, 2, 0, 6),
    Row.SHUTDOWN_OPTION: (0x605B, 0, Kind.I16, RW, 0, 0, 1),
    Row.DISABLE_OPTION: (0x605C, 0, Kind.I16, RW, 0, 0, 1),
    Row.HALT_OPTION: (0x605D, 0, Kind.I16, RW, 1, 1, 1),
    Row.FAULT_OPTION: (0x605E, 0, Kind.I16, RW, 2, 0, 2),
    Row.MODE: (0x6060, 0, Kind.I8, TAKEN),
    Row.MODE_DISPLAY: (0x6061, 0, Kind.I8, SENT),
    Row.POSITION_DEMAND: (0x6062, 0, Kind.I32, SENT),
    Row.POSITION_ACTUAL: (0x6064, 0, Kind.I32, SENT),
    Row.FOLLOWING_WINDOW: (0x6065, 0, Kind.U32, RW, NO_WINDOW),
    Row.FOLLOWING_MS: (0x6066, 0, Kind.U16, RW),
    Row.POSITION_WINDOW: (0x6067, 0, Kind.U32, RW, 10),
    Row.POSITION_MS: (0x6068, 0, Kind.U16, RW),
    Row.VELOCITY_DEMAND: (0x606B, 0, Kind.I32, SENT),
    Row.VELOCITY_ACTUAL: (0x606C, 0, Kind.I32, SENT),
    Row.VELOCITY_WINDOW: (0x606D, 0, Kind.U16, RW, 10),
    Row.VELOCITY_MS: (0x606E, 0, Kind.U16, RW),
    Row.TARGET_TORQUE: (0x6071, 0, Kind.I16, TAKEN),
    Row.MAX_TORQUE: (0x6072, 0, Kind.U16, TAKEN, 1000, 0, 1000),
    Row.TORQUE_DEMAND: (0x6074, 0, Kind.I16, SENT),
    Row.TORQUE_ACTUAL: (0x6077, 0, Kind.I16, SENT),
    Row.TARGET_POSITION: (0x607A, 0, Kind.I32, TAKEN),
    Row.HOME_OFFSET: (0x607C, 0, Kind.I32, RW),
    Row.LIMITS: (0x607D, 0, Kind.U8, RO, 2),
    Row.LIMIT_LOW: (0x607D, 1, Kind.I32, RW, -(1 << 31)),
    Row.LIMIT_HIGH: (0x607D, 2, Kind.I32, RW, (1 << 31) - 1),
    Row.PROFILE_VELOCITY: (0x6081, 0, Kind.U32, TAKEN, 1000, 0, (1 << 31) - 1),
    Row.ACCELERATION: (0x6083, 0, Kind.U32, TAKEN, 10_000, 1, (1 << 31) - 1),
    Row.DECELERATION: (0x6084, 0, Kind.U32, TAKEN, 10_000, 1, (1 << 31) - 1),
    Row.QUICK_STOP_DECELERATION: (0x6085, 0, Kind.U32, TAKEN, 50_000, 1, (1 << 31) - 1),
    Row.HOMING_METHOD: (0x6098, 0, Kind.I8, TAKEN, 37, 35, 37),
    Row.VELOCITY_OFFSET: (0x60B1, 0, Kind.I32, TAKEN),
    Row.TORQUE_OFFSET: (0x60B2, 0, Kind.I16, TAKEN),
    Row.FOLLOWING_ERROR: (0x60F4, 0, Kind.I32, SENT),
    Row.TARGET_VELOCITY: (0x60FF, 0, Kind.I32, TAKEN),
    Row.MODES: (0x6502, 0, Kind.U32, RO, MODES),
    Row.ABORT_OPTION: (0x6007, 0, Kind.I16, RW, 1, 0, 3),
    Row.MAX_PROFILE_VELOCITY: (0x607F, 0, Kind.U32, RW, (1 << 31) - 1, 0, (1 << 31) - 1),
    Row.HOMING_SPEEDS: (0x6099, 0, Kind.U8, RO, 2),
    Row.HOMING_FAST: (0x6099, 1, Kind.U32, RW),
    Row.HOMING_SLOW: (0x6099, 2, Kind.U32, RW),
    Row.HOMING_ACCELERATION: (0x609A, 0, Kind.U32, RW),
    Row.PERIODS: (0x60C2, 0, Kind.U8, RO, 2),
    Row.PERIOD: (0x60C2, 1, Kind.U8, RW, 1, 1, 255),
    Row.PERIOD_EXPONENT: (0x60C2, 2, Kind.I8, RW, -3, -6, 0),
    Row.SYNC_PERIOD: (0x1006, 0, Kind.U32, RW),
}
_FIRST = {  # of CiA 402: what the PDOs carry at first; all but the first are not valid then
    "received": ((Row.CONTROLWORD,), (Row.CONTROLWORD, Row.MODE),
                 (Row.CONTROLWORD, Row.TARGET_POSITION), (Row.CONTROLWORD, Row.TARGET_VELOCITY)),
    "sent": ((Row.STATUSWORD,), (Row.STATUSWORD, Row.MODE_DISPLAY),
             (Row.STATUSWORD, Row.POSITION_ACTUAL), (Row.STATUSWORD, Row.VELOCITY_ACTUAL)),
}  # fmt: skip


def _mapping_entry(row: Row) -> int:
    """Return a mapping entry: index, subindex and bits of an object."""
    index, subindex, kind = _OTHERS[row][:3]
    return int(index) << 16 | int(subindex) << 8 | BITS[kind]


def _pdo(received: bool, number: int, node: int) -> Iterator[Object]:
    """Yield the objects of one PDO in the order of its rows."""
    index = (0x1400 if received else 0x1800) + number
    what = f"{'R' if received else 'T'}PDO {number + 1}"
    cob_id = (0x200 if received else 0x180) + 0x100 * number + node
    yield Object(f"{what} communication", index, 0, Kind.U8, RO, 2 if received else 5)
    valid = 0 if number == 0 else NOT_VALID
    yield Object(f"{what} COB-ID", index, 1, Kind.U32, RW, cob_id | valid)
    yield Object(f"{what} transmission type", index, 2, Kind.U8, RW, 255)
    if not received:
        yield Object(f"{what} inhibit time", index, 3, Kind.U16, RW)
        yield Object(f"{what} event timer", index, 5, Kind.U16, RW, 0 if number else STATUS_MS)
    first = _FIRST["received" if received else "sent"][number]
    mapping = index + 0x200
    yield Object(f"{what} mapping", mapping, 0, Kind.U8, RW, len(first), 0, at.MAX_ENTRIES)
    for i in range(at.MAX_ENTRIES):
        start = _mapping_entry(first[i]) if i < len(first) else 0
        yield Object(f"{what} entry {i + 1}", mapping, i + 1, Kind.U32, RW, start)


def objects(node: int, name: str) -> list[Object]:
    """Return the dictionary of the drive `node`, in the order of the rows; `name` is the rig's."""
    found = [one for i in range(at.PDOS) for one in _pdo(True, i, node)]
    found += [one for i in range(at.PDOS) for one in _pdo(False, i, node)]
    own = {Row.EMERGENCY_ID: 0x80 + node, Row.SDO_IN: 0x600 + node, Row.SDO_OUT: 0x580 + node}
    texts = {Row.DEVICE_NAME: name, Row.HARDWARE: "emulated", Row.SOFTWARE: "pcpc"}
    for row in Row:
        one = Object(row.name.replace("_", " ").capitalize(), *_OTHERS[row])
        found.append(replace(one, start=own.get(row, one.start), text=texts.get(row, "")))
    return found


def changed_dictionary(every: list[Object], starts: Mapping[str, int]) -> list[Object]:
    """Return the dictionary with other values at the start, by key; ValueError says what is wrong.

    COB-IDs and mappings are taken as they are.
    """
    known = {one.key: i for i, one in enumerate(every)}
    found = list(every)
    for key, value in starts.items():
        if key.upper() not in known:
            raise ValueError(f"{key}: the drive has no such object")
        one = every[known[key.upper()]]
        low, high = one.bounds
        if not one.access & at.WRITE:
            raise ValueError(f"{key}: {one.name} cannot be written")
        if not low <= value <= high:
            raise ValueError(f"{key}: {value} is outside {low}..{high}")
        found[known[key.upper()]] = replace(one, start=value)
    return found


def install(d: object, node: int, every: list[Object]) -> None:
    """Write the dictionary into the zeroed DRIVE record `d`, which is as after power-on."""
    into: Any = d
    into.node, into.n, into.on = node, len(every), 1
    texts = 0
    for i, one in enumerate(every):
        place = -1
        if one.kind == Kind.TEXT:
            place = texts * at.TEXT_BYTES
            raw = one.text.encode("ascii", "replace")[: at.TEXT_BYTES]
            into.text[place : place + len(raw)] = list(raw)
            texts += 1
        low, high = one.bounds
        size = len(one.text.encode("ascii", "replace")[: at.TEXT_BYTES])
        signed = int(one.signed) if place < 0 else size  # of a text: its length
        into.objects[i] = (
            one.index, one.subindex, one.bits, signed, place, one.access, low, high, one.start,
        )  # fmt: skip
        into.value[i] = one.start
    into.state.nmt = Heartbeat.BOOT_UP
    into.sent_at[:] = into.since_sync[:] = -1

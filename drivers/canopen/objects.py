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
from pcpc.drivers.canopen.layout import RO, RW, Heartbeat, ObjectType, Od

BITS = {
    ObjectType.I8: 8,
    ObjectType.I16: 16,
    ObjectType.I32: 32,
    ObjectType.U8: 8,
    ObjectType.U16: 16,
    ObjectType.U32: 32,
}
BITS[ObjectType.F32] = 32  # as they are on the wire
NOT_VALID = 1 << 31  # of a COB-ID
STATUS_MS = 20  # event timer of the first sent PDO: masters wait 0.2 s for a statusword


@dataclass(frozen=True)
class Object:
    """One object: its place, type, access, value at the start and bounds."""

    name: str
    index: int
    subindex: int
    kind: ObjectType
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
        return self.kind in (ObjectType.I8, ObjectType.I16, ObjectType.I32)

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


_FIRST = {  # of CiA 402: what the PDOs carry at first; all but the first are not valid then
    "received": ((Od.CONTROLWORD,), (Od.CONTROLWORD, Od.MODE),
                 (Od.CONTROLWORD, Od.TARGET_POSITION), (Od.CONTROLWORD, Od.TARGET_VELOCITY)),
    "sent": ((Od.STATUSWORD,), (Od.STATUSWORD, Od.MODE_DISPLAY),
             (Od.STATUSWORD, Od.POSITION_ACTUAL), (Od.STATUSWORD, Od.VELOCITY_ACTUAL)),
}  # fmt: skip


def _mapping_entry(row: Od) -> int:
    """Return a mapping entry: index, subindex and bits of an object."""
    index, subindex, kind = row.declared[:3]
    return int(index) << 16 | int(subindex) << 8 | BITS[kind]


def _pdo(received: bool, number: int, node: int) -> Iterator[Object]:
    """Yield the objects of one PDO in the order of its rows."""
    index = (0x1400 if received else 0x1800) + number
    pdo_name = f"{'R' if received else 'T'}PDO {number + 1}"
    cob_id = (0x200 if received else 0x180) + 0x100 * number + node
    yield Object(f"{pdo_name} communication", index, 0, ObjectType.U8, RO, 2 if received else 5)
    valid = 0 if number == 0 else NOT_VALID
    yield Object(f"{pdo_name} COB-ID", index, 1, ObjectType.U32, RW, cob_id | valid)
    yield Object(f"{pdo_name} transmission type", index, 2, ObjectType.U8, RW, 255)
    if not received:
        yield Object(f"{pdo_name} inhibit time", index, 3, ObjectType.U16, RW)
        yield Object(
            f"{pdo_name} event timer", index, 5, ObjectType.U16, RW, 0 if number else STATUS_MS
        )
    first = _FIRST["received" if received else "sent"][number]
    mapping = index + 0x200
    yield Object(
        f"{pdo_name} mapping", mapping, 0, ObjectType.U8, RW, len(first), 0, at.MAX_ENTRIES
    )
    for i in range(at.MAX_ENTRIES):
        start = _mapping_entry(first[i]) if i < len(first) else 0
        yield Object(f"{pdo_name} entry {i + 1}", mapping, i + 1, ObjectType.U32, RW, start)


def objects(node: int, name: str) -> list[Object]:
    """Return the dictionary of the drive `node`, in the order of the rows; `name` is the rig's."""
    dictionary = [one for i in range(at.PDOS) for one in _pdo(True, i, node)]
    dictionary += [one for i in range(at.PDOS) for one in _pdo(False, i, node)]
    ids = {Od.EMERGENCY_ID: 0x80 + node, Od.SDO_IN: 0x600 + node, Od.SDO_OUT: 0x580 + node}
    texts = {Od.DEVICE_NAME: name, Od.HARDWARE: "emulated", Od.SOFTWARE: "pcpc"}
    for row in Od:
        od_object = Object(row.name.replace("_", " ").capitalize(), *row.declared)
        dictionary.append(
            replace(od_object, start=ids.get(row, od_object.start), text=texts.get(row, ""))
        )
    return dictionary


def changed_dictionary(dictionary: list[Object], starts: Mapping[str, int]) -> list[Object]:
    """Return the dictionary with other values at the start, by key; ValueError says what is wrong.

    COB-IDs and mappings are taken as they are.
    """
    rows = {one.key: i for i, one in enumerate(dictionary)}
    changed = list(dictionary)
    for key, value in starts.items():
        if key.upper() not in rows:
            raise ValueError(f"{key}: the drive has no such object")
        od_object = dictionary[rows[key.upper()]]
        low, high = od_object.bounds
        if not od_object.access & at.WRITE:
            raise ValueError(f"{key}: {od_object.name} cannot be written")
        if not low <= value <= high:
            raise ValueError(f"{key}: {value} is outside {low}..{high}")
        changed[rows[key.upper()]] = replace(od_object, start=value)
    return changed


def install(d: object, node: int, dictionary: list[Object]) -> None:
    """Write the dictionary into the zeroed Canopen record `d`, which is as after power-on."""
    into: Any = d
    into.node, into.n = node, len(dictionary)
    texts = 0
    for i, od_object in enumerate(dictionary):
        text_offset = -1
        if od_object.kind == ObjectType.TEXT:
            text_offset = texts * at.TEXT_BYTES
            raw = od_object.text.encode("ascii", "replace")[: at.TEXT_BYTES]
            into.text[text_offset : text_offset + len(raw)] = list(raw)
            texts += 1
        low, high = od_object.bounds
        size = len(od_object.text.encode("ascii", "replace")[: at.TEXT_BYTES])
        signed = int(od_object.signed) if text_offset < 0 else size  # of a text: its length
        into.objects[i] = (
            od_object.index, od_object.subindex, od_object.bits, signed, text_offset,
            od_object.access, low, high, od_object.start,
        )  # fmt: skip
        into.value[i] = od_object.start
    into.state.nmt = Heartbeat.BOOT_UP
    into.sent_at[:] = into.since_sync[:] = -1

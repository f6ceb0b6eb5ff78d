"""The EDS or DCF of a real drive, and what it makes of the dictionary of ours.

    objects of ours      value at the start (a DCF's ParameterValue, else DefaultValue) and bounds;
                         of 0x6502 the modes that both have
    0x2000 to 0x5FFF     of the manufacturer: kept and given back, without an effect
    all others           belong to what our drive does not do, and do not exist; nor does a value
                         that it cannot have, as an option of a ramp: its own one stays

An object that is measured or that a master reads as state has no value at the start. Whatever is
not taken over is listed: one odd entry refuses no file. Source: CiA 306-1.
"""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pcpc.drivers.canopen import layout as at
from pcpc.drivers.canopen.eds_sections import EdsVariable, Sections, number, sections, variables
from pcpc.drivers.canopen.layout import ObjectType, Od
from pcpc.drivers.canopen.objects import BITS, NOT_VALID, Object
from pcpc.drivers.errors import printable

_WANTED = "give an EDS or DCF file of CiA 306"
_OWN = 0x2000, 0x5FFF  # indices of a manufacturer
_SIZES = {int(kind): bits for kind, bits in BITS.items()}
_BOOLEAN = 0x01
_REAL = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(E[-+]?\d+)?", re.IGNORECASE)
_ACCESS = {  # what may be done, and what a PDO may do where it can be mapped
    "ro": (at.READ, at.FROM_DRIVE), "const": (at.READ, at.FROM_DRIVE),
    "wo": (at.WRITE, at.TO_DRIVE), "rw": (at.READ | at.WRITE, at.FROM_DRIVE | at.TO_DRIVE),
    "rwr": (at.READ | at.WRITE, at.FROM_DRIVE), "rww": (at.READ | at.WRITE, at.TO_DRIVE),
}  # fmt: skip
_NOT_POSSIBLE = (  # within the bounds
    (Od.QUICK_STOP_OPTION, 3),
    (Od.QUICK_STOP_OPTION, 4),
    (Od.HOMING_METHOD, 36),
)
_STATED = (  # what a drive says of itself, though no master can write it
    Od.DEVICE_NAME, Od.HARDWARE, Od.SOFTWARE, Od.VENDOR, Od.PRODUCT, Od.REVISION, Od.SERIAL,
)  # fmt: skip


@dataclass
class EdsContent:
    """The dictionary, and what of the file the drive does not have: 60B8, 605B=1, or with why."""

    every: list[Object]
    left_out: list[str] = field(default_factory=list)


def read(path: Path, dictionary: Sequence[Object], node: int) -> EdsContent:
    """Return what the file makes of a dictionary of the drive `node`.

    OSError; ValueError: it is no such file, or that of another node.
    """
    file = sections(path.read_bytes())
    content = EdsContent(list(dictionary))
    _check_node(file, node, content)
    entries = sorted(variables(file), key=lambda one: (one.index, one.subindex))
    if not entries:
        raise ValueError(f"has no object{', ' + file.odd[0] if file.odd else ''}; {_WANTED}")
    rows = {(one.index, one.subindex): i for i, one in enumerate(dictionary)}
    taken = set[str]()
    for entry in entries:
        try:
            if entry.key in taken:
                raise ValueError("again")
            _take(content, entry, rows.get((entry.index, entry.subindex)), node)
            taken.add(entry.key)
        except ValueError as error:
            content.left_out.append(f"{entry.key} ({error})")
    content.left_out += file.odd
    _let_go(content)
    return content


def _check_node(file: Sections, node: int, content: EdsContent) -> None:
    """Raise ValueError if a DCF is that of another node."""
    for section in ("DEVICECOMISSIONING", "DEVICECOMMISSIONING"):
        text = file.of.get(section, {}).get("nodeid")
        if not text:
            continue
        try:
            node_id = number(text, 0)
        except ValueError as error:
            content.left_out.append(f"[DeviceComissioning] NodeID ({error})")
            continue
        if not 1 <= node_id <= 127:  # 255: of a device that was not given any
            content.left_out.append(f"[DeviceComissioning] NodeID {printable(text[:40])}")
        elif node_id != node:
            raise ValueError(f"[DeviceComissioning]: NodeID {text}, the rig's node is {node}")


def _take(content: EdsContent, entry: EdsVariable, row: int | None, node: int) -> None:
    """Take over what is said of an object; ValueError says why not."""
    if row is not None:
        content.every[row] = _ours(content, row, entry, node)
    elif not _OWN[0] <= entry.index <= _OWN[1]:
        content.left_out.append(entry.key)
    elif len(content.every) >= at.MAX_OBJECTS:
        raise ValueError(f"more than {at.MAX_OBJECTS} objects")
    elif new := _passive_object(content, entry, node):
        content.every.append(new)
    else:
        content.left_out.append(entry.key)


def _ours(content: EdsContent, row: int, entry: EdsVariable, node: int) -> Object:
    """Return an object of ours with what the file says of it."""
    od_object, text = content.every[row], entry.value
    kind = _type_of(entry)
    if od_object.kind == ObjectType.TEXT:
        if not (text.isascii() and text.isprintable() and len(text) <= at.TEXT_BYTES):
            raise ValueError(f"not {at.TEXT_BYTES} characters of ASCII")
        return replace(od_object, text=text) if text else od_object
    if _SIZES.get(kind) != od_object.bits or kind == ObjectType.F32:
        problem = f"DataType 0x{kind:04X}, the drive has 0x{int(od_object.kind):04X}"
        raise ValueError(f"{od_object.name}: {problem}")
    if not text:
        return od_object
    start = _signed_value(number(text, node), od_object)
    if row == Od.MODES:
        return replace(od_object, start=start & od_object.start)
    settable = od_object.access & at.WRITE and row != Od.ERROR_COUNT
    if not (settable or row in _STATED):
        if start != od_object.start and row != Od.ERROR_COUNT:
            content.left_out.append(f"{entry.key}={text}")
        return od_object
    low, high = od_object.bounds
    if od_object.access & at.WRITE and row >= at.OTHERS:
        low, high = _limits(entry, od_object, node)
    if not low <= start <= high or (row, start) in _NOT_POSSIBLE:
        content.left_out.append(f"{entry.key}={text}")
        return od_object
    return replace(od_object, start=start, low=low, high=high)


def _type_of(entry: EdsVariable) -> int:
    """Return the data type of CiA 301; ValueError without one."""
    if text := entry.keys.get("datatype"):
        return number(text, 0)
    raise ValueError("no DataType")


def _limits(entry: EdsVariable, od_object: Object, node: int) -> tuple[int, int]:
    """Return the bounds that both have; those of the file count if they are two, and differ."""
    low, high = od_object.bounds
    limits = [entry.keys.get(key) for key in ("lowlimit", "highlimit")]
    if limits[0] and limits[1]:
        ends = [_signed_value(number(end, node), od_object) for end in limits if end]
        if ends[0] < ends[1]:  # 0 and 0 are no limits
            return max(low, ends[0]), min(high, ends[1])
    return low, high


def _signed_value(value: int, od_object: Object) -> int:
    """Return a number that may have been written as the bits of a negative one."""
    whole = 1 << od_object.bits
    return value - whole if od_object.signed and whole >> 1 <= value < whole else value


def _passive_object(content: EdsContent, entry: EdsVariable, node: int) -> Object | None:
    """Return an object without an effect; None of a type that the drive cannot hold."""
    kind = _type_of(entry)
    kind = int(ObjectType.U8) if kind == _BOOLEAN else kind
    if kind not in _SIZES:
        return None
    access = (entry.keys.get("accesstype") or "rw").split("#")[0].strip()
    if access.lower() not in _ACCESS:
        raise ValueError(f"AccessType {printable(access[:20])}")
    rights, mapped = _ACCESS[access.lower()]
    if number(entry.keys.get("pdomapping") or "0", node):
        rights |= mapped
    name = entry.keys.get("parametername", "")
    od_object = Object(name, entry.index, entry.subindex, ObjectType(kind), rights)
    if kind == ObjectType.F32:
        return replace(od_object, start=_bits_of_float(entry.value or "0"))
    start = _signed_value(number(entry.value or "0", node), od_object)
    low, high = od_object.bounds
    if not low <= start <= high:
        raise ValueError(f"{start} does not fit into {od_object.bits} bits")
    low, high = _limits(entry, od_object, node)
    if not low <= start <= high:
        content.left_out.append(f"{entry.key} (limits without {entry.value or 0})")
        return replace(od_object, start=start)
    return replace(od_object, start=start, low=low, high=high)


def _bits_of_float(text: str) -> int:
    """Return the bits of a REAL32: of a number, or as they stand there, with 0x."""
    if text.upper().startswith("0X"):
        bits = number(text, 0)
    elif _REAL.fullmatch(text):
        try:
            bits = struct.unpack("<I", struct.pack("<f", float(text)))[0]
        except OverflowError:
            bits = -1
    else:
        raise ValueError(f"expected a number, got '{printable(text[:40])}'")
    if not 0 <= bits < 1 << 32:
        raise ValueError(f"{text[:40]} does not fit into a REAL32")
    return bits


def _let_go(content: EdsContent) -> None:
    """Let PDOs be not valid that map what the drive does not have, and say which."""
    objects_by_key = {(one.index, one.subindex): one for one in content.every}
    for p in range(2 * at.PDOS):
        received = p < at.PDOS
        first = p * at.RPDO_ROWS if received else at.FIRST_TPDO + (p - at.PDOS) * at.TPDO_ROWS
        mapping = first + (at.RPDO_MAPPING if received else at.TPDO_MAPPING)
        entries = [
            content.every[mapping + 1 + i].start for i in range(content.every[mapping].start)
        ]
        direction = at.TO_DRIVE if received else at.FROM_DRIVE
        unmappable = [
            entry for entry in entries
            if (one := objects_by_key.get((entry >> 16, entry >> 8 & 255))) is None
            or not one.access & direction or one.bits != entry & 255
        ]  # fmt: skip
        if unmappable or sum(entry & 255 for entry in entries) > 64:
            cob_id, count = content.every[first + at.COB_ID], content.every[mapping]
            content.every[first + at.COB_ID] = replace(cob_id, start=cob_id.start | NOT_VALID)
            content.every[mapping] = replace(count, start=0)
            content.left_out.append(f"{count.index:04X}")

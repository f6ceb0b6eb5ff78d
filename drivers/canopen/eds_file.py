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


def read(path: Path, every: Sequence[Object], node: int) -> EdsContent:
    """Return what the file makes of a dictionary of the drive `node`.

    OSError; ValueError: it is no such file, or that of another node.
    """
    file = sections(path.read_bytes())
    found = EdsContent(list(every))
    _check_node(file, node, found)
    entries = sorted(variables(file), key=lambda one: (one.index, one.subindex))
    if not entries:
        raise ValueError(f"has no object{', ' + file.odd[0] if file.odd else ''}; {_WANTED}")
    known = {(one.index, one.subindex): i for i, one in enumerate(every)}
    for entry in entries:
        try:
            _take(found, entry, known.get((entry.index, entry.subindex)), node)
        except ValueError as error:
            found.left_out.append(f"{entry.key} ({error})")
    found.left_out += file.odd
    _let_go(found)
    return found


def _check_node(file: Sections, node: int, found: EdsContent) -> None:
    """Raise ValueError if a DCF is that of another node."""
    for section in ("DEVICECOMISSIONING", "DEVICECOMMISSIONING"):
        text = file.of.get(section, {}).get("nodeid")
        if not text:
            continue
        try:
            wanted = number(text, 0)
        except ValueError as error:
            found.left_out.append(f"[DeviceComissioning] NodeID ({error})")
            continue
        if not 1 <= wanted <= 127:  # 255: of a device that was not given any
            found.left_out.append(f"[DeviceComissioning] NodeID {printable(text[:40])}")
        elif wanted != node:
            raise ValueError(f"[DeviceComissioning]: NodeID {text}, the rig's node is {node}")


def _take(found: EdsContent, entry: EdsVariable, place: int | None, node: int) -> None:
    """Take over what is said of an object; ValueError says why not."""
    if place is not None:
        found.every[place] = _ours(found, place, entry, node)
    elif not _OWN[0] <= entry.index <= _OWN[1]:
        found.left_out.append(entry.key)
    elif len(found.every) >= at.MAX_OBJECTS:
        raise ValueError(f"more than {at.MAX_OBJECTS} objects")
    elif new := _passive_object(found, entry, node):
        found.every.append(new)
    else:
        found.left_out.append(entry.key)


def _ours(found: EdsContent, place: int, entry: EdsVariable, node: int) -> Object:
    """Return an object of ours with what the file says of it."""
    one, text = found.every[place], entry.value
    kind = _type_of(entry)
    if one.kind == ObjectType.TEXT:
        if not (text.isascii() and text.isprintable() and len(text) <= at.TEXT_BYTES):
            raise ValueError(f"not {at.TEXT_BYTES} characters of ASCII")
        return replace(one, text=text) if text else one
    if _SIZES.get(kind) != one.bits or kind == ObjectType.F32:
        what = f"DataType 0x{kind:04X}, the drive has 0x{int(one.kind):04X}"
        raise ValueError(f"{one.name}: {what}")
    if not text:
        return one
    start = _signed_value(number(text, node), one)
    if place == Od.MODES:
        return replace(one, start=start & one.start)
    settable = one.access & at.WRITE and place != Od.ERROR_COUNT
    if not (settable or place in _STATED):
        if start != one.start and place != Od.ERROR_COUNT:
            found.left_out.append(f"{entry.key}={text}")
        return one
    low, high = one.bounds
    if one.access & at.WRITE and place >= at.OTHERS:
        low, high = _limits(entry, one, node)
    if not low <= start <= high or (place, start) in _NOT_POSSIBLE:
        found.left_out.append(f"{entry.key}={text}")
        return one
    return replace(one, start=start, low=low, high=high)


def _type_of(entry: EdsVariable) -> int:
    """Return the data type of CiA 301; ValueError without one."""
    if text := entry.keys.get("datatype"):
        return number(text, 0)
    raise ValueError("no DataType")


def _limits(entry: EdsVariable, one: Object, node: int) -> tuple[int, int]:
    """Return the bounds that both have; those of the file count if they are two, and differ."""
    low, high = one.bounds
    told = [entry.keys.get(key) for key in ("lowlimit", "highlimit")]
    if told[0] and told[1]:
        ends = [_signed_value(number(end, node), one) for end in told if end]
        if ends[0] < ends[1]:  # 0 and 0 are no limits
            return max(low, ends[0]), min(high, ends[1])
    return low, high


def _signed_value(value: int, one: Object) -> int:
    """Return a number that may have been written as the bits of a negative one."""
    whole = 1 << one.bits
    return value - whole if one.signed and whole >> 1 <= value < whole else value


def _passive_object(found: EdsContent, entry: EdsVariable, node: int) -> Object | None:
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
    one = Object(name, entry.index, entry.subindex, ObjectType(kind), rights)
    if kind == ObjectType.F32:
        return replace(one, start=_bits_of_float(entry.value or "0"))
    start = _signed_value(number(entry.value or "0", node), one)
    low, high = one.bounds
    if not low <= start <= high:
        raise ValueError(f"{start} does not fit into {one.bits} bits")
    low, high = _limits(entry, one, node)
    if not low <= start <= high:
        found.left_out.append(f"{entry.key} (limits without {entry.value or 0})")
        return replace(one, start=start)
    return replace(one, start=start, low=low, high=high)


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


def _let_go(found: EdsContent) -> None:
    """Let PDOs be not valid that map what the drive does not have, and say which."""
    known = {(one.index, one.subindex): one for one in found.every}
    for p in range(2 * at.PDOS):
        received = p < at.PDOS
        first = p * at.RPDO_ROWS if received else at.FIRST_TPDO + (p - at.PDOS) * at.TPDO_ROWS
        mapping = first + (at.RPDO_MAPPING if received else at.TPDO_MAPPING)
        entries = [found.every[mapping + 1 + i].start for i in range(found.every[mapping].start)]
        wanted = at.TO_DRIVE if received else at.FROM_DRIVE
        odd = [
            entry for entry in entries
            if (one := known.get((entry >> 16, entry >> 8 & 255))) is None
            or not one.access & wanted or one.bits != entry & 255
        ]  # fmt: skip
        if odd or sum(entry & 255 for entry in entries) > 64:
            cob_id, count = found.every[first + at.COB_ID], found.every[mapping]
            found.every[first + at.COB_ID] = replace(cob_id, start=cob_id.start | NOT_VALID)
            found.every[mapping] = replace(count, start=0)
            found.left_out.append(f"{count.index:04X}")

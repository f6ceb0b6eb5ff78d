"""The EDS or DCF of a real drive, and what it makes of the dictionary of ours.

    objects of ours      value at the start (a DCF's ParameterValue, else DefaultValue) and bounds;
                         of 0x6502 the modes that both have
    0x2000 to 0x5FFF     of the manufacturer: kept and given back, without an effect
    all others           belong to what our drive does not do, and do not exist; nor does a value
                         that it cannot have, as an option of a ramp: its own one stays

An object that is measured or that a master reads as state has no value at the start. Numbers are
decimal, 0x hexadecimal, 0 octal, or $NODEID+number. Source: CiA 306-1.
"""

import configparser
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pcpc.drivers.canopen import layout as at
from pcpc.drivers.canopen.layout import Row
from pcpc.drivers.canopen.objects import BITS, NOT_VALID, RO, RW, Kind, Object

_WANTED = "give an EDS or DCF file of CiA 306"
_OWN = 0x2000, 0x5FFF  # indices of a manufacturer
_SECTION = re.compile(r"([0-9A-F]{4})(?:sub([0-9A-F]{1,2}))?", re.IGNORECASE)
_SIZES = {int(kind): bits for kind, bits in BITS.items()}
_REAL_32, _RECORDS = 0x08, (0x08, 0x09)
_ALSO: dict[int, int] = {0x01: Kind.U8, _REAL_32: Kind.U32}  # truth values; bits of a float
_NOT_POSSIBLE = (  # within the bounds
    (Row.QUICK_STOP_OPTION, 3),
    (Row.QUICK_STOP_OPTION, 4),
    (Row.HOMING_METHOD, 36),
)
_STATED = (  # what a drive says of itself, though no master can write it
    Row.DEVICE_NAME, Row.HARDWARE, Row.SOFTWARE, Row.VENDOR, Row.PRODUCT, Row.REVISION, Row.SERIAL,
)  # fmt: skip


@dataclass
class EdsContent:
    """The dictionary, and what of the file the drive does not have: 60B8, 605B=1."""

    every: list[Object]
    left_out: list[str] = field(default_factory=list)


def read(path: Path, every: Sequence[Object], node: int) -> EdsContent:
    """Return what the file makes of a dictionary of the drive `node`.

    OSError; ValueError says what is wrong, with the file's section.
    """
    parser = configparser.RawConfigParser(strict=False, delimiters=("=",), comment_prefixes=(";",))
    try:
        parser.read_string(path.read_bytes().decode("latin-1").lstrip("\xef\xbb\xbf"))
    except configparser.MissingSectionHeaderError as error:
        raise ValueError(f"line {error.lineno}: no [section]; {_WANTED}") from None
    except configparser.ParsingError as error:
        raise ValueError(f"line {error.errors[0][0]}: expected key=value; {_WANTED}") from None
    told = parser.get("DeviceComissioning", "NodeID", fallback="")
    if told and _number(told, 0, "DeviceComissioning") != node:
        raise ValueError(f"[DeviceComissioning]: NodeID {told}, the rig's node is {node}")
    found = EdsContent(list(every))
    known = {(one.index, one.subindex): i for i, one in enumerate(every)}
    entries = sorted(_entries(parser), key=lambda one: one[:2])
    if not entries:
        raise ValueError(f"has no object; {_WANTED}")
    for index, subindex, section, entry in entries:
        where = f"[{section}]"
        if (place := known.get((index, subindex))) is not None:
            one = _ours(found.every[place], place, entry, node, where)
            found.every[place] = one or found.every[place]
            if one is None:
                value = entry.get("parametervalue") or entry.get("defaultvalue")
                found.left_out.append(f"{found.every[place].key}={value}")
        elif _OWN[0] <= index <= _OWN[1] and (
            new := _passive_object(index, subindex, entry, node, where)
        ):
            found.every.append(new)
        else:
            found.left_out.append(f"{index:04X}" + (f".{subindex}" if subindex else ""))
    if len(found.every) > at.MAX_OBJECTS:
        raise ValueError(f"{len(found.every)} objects; the drive holds {at.MAX_OBJECTS}")
    _let_go(found)
    return found


def _entries(parser: Any) -> Iterator[tuple[int, int, str, dict[str, str]]]:
    """Yield index, subindex, section and entries of each variable."""
    for section in parser.sections():
        match = _SECTION.fullmatch(section.strip())
        if match is None:
            continue
        index, subindex = int(match[1], 16), int(match[2] or "0", 16)
        entry = {key: value.split(";")[0].strip() for key, value in parser.items(section)}
        count = entry.get("compactsubobj", "0") or "0"
        if match[2] is None and (n := _number(count, 0, f"[{section}]")) > 0:
            yield index, 0, section, {"datatype": "5", "accesstype": "ro", "defaultvalue": str(n)}
            for i in range(1, min(n, 254) + 1):
                yield index, i, section, entry
        elif match[2] or _number(entry.get("objecttype") or "7", 0, f"[{section}]") not in _RECORDS:
            yield index, subindex, section, entry


def _ours(one: Object, place: int, entry: dict[str, str], node: int, where: str) -> Object | None:
    """Return an object of ours with what the file says of it; None if it cannot be so."""
    kind = _number(entry.get("datatype", ""), node, where)
    text = entry.get("parametervalue") or entry.get("defaultvalue") or ""
    if one.kind == Kind.TEXT:
        fits = text.isascii() and text.isprintable()
        return replace(one, text=text[: at.TEXT_BYTES]) if text and fits else one
    if _SIZES.get(kind) != one.bits:
        what = f"DataType 0x{kind:04X}, the drive has 0x{int(one.kind):04X}"
        raise ValueError(f"{where}: {one.name}: {what}")
    settable = one.access & at.WRITE and place != Row.ERROR_COUNT
    if not text or not (settable or place in (*_STATED, Row.MODES)):
        return one
    start = _signed_value(_number(text, node, where), one)
    if place == Row.MODES:
        return replace(one, start=start & one.start)
    low, high = one.bounds
    if one.access & at.WRITE and place >= at.OTHERS:
        told = [entry.get(key) for key in ("lowlimit", "highlimit")]
        if told[0] and told[1]:
            ends = [_signed_value(_number(end, node, where), one) for end in told if end]
            if ends[0] < ends[1]:  # 0 and 0 are no limits
                low, high = max(low, ends[0]), min(high, ends[1])
    possible = low <= start <= high and (place, start) not in _NOT_POSSIBLE
    return replace(one, start=start, low=low, high=high) if possible else None


def _signed_value(value: int, one: Object) -> int:
    """Return a number that may have been written as the bits of a negative one."""
    whole = 1 << one.bits
    return value - whole if one.signed and whole >> 1 <= value < whole else value


def _passive_object(
    index: int, subindex: int, entry: dict[str, str], node: int, where: str
) -> Object | None:
    """Return an object without an effect; None of a type that the drive cannot hold."""
    told = _number(entry.get("datatype", ""), node, where)
    kind = int(_ALSO.get(told, told))
    if kind not in _SIZES:
        return None
    text = entry.get("parametervalue") or entry.get("defaultvalue") or "0"
    access = entry.get("accesstype", "rw").lower()
    mapped = entry.get("pdomapping", "0") == "1"
    rights = RO if access in ("ro", "const") else RW
    if mapped:
        rights |= at.FROM_DRIVE | (at.TO_DRIVE if rights == RW else 0)
    name = entry.get("parametername", "")
    one = Object(name, index, subindex, Kind(kind), rights)
    start = 0 if told == _REAL_32 else _signed_value(_number(text, node, where), one)
    low, high = one.bounds
    if not low <= start <= high:
        raise ValueError(f"{where}: {start} does not fit into {one.bits} bits")
    return replace(one, start=start)


def _number(text: str, node: int, where: str) -> int:
    """Return a number of the file; ValueError."""
    total, bare = 0, text.strip().replace(" ", "").upper()
    if "$NODEID" in bare:
        total, bare = node, bare.replace("+$NODEID", "").replace("$NODEID", "").lstrip("+")
    try:
        octal = re.fullmatch(r"0[0-7]+", bare)
        return total + (
            int(bare, 8) if octal else int(bare or "0", 0) if bare or total else int("")
        )
    except ValueError:
        raise ValueError(f"{where}: expected a number, got '{text[:40]}'") from None


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

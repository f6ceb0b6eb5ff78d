"""The drive's EDS: its object dictionary as masters read it. Source: CiA 306-1."""

import math
import struct
from collections.abc import Sequence
from itertools import groupby

from pcpc.drivers.canopen import layout as at
from pcpc.drivers.canopen.layout import ObjectType
from pcpc.drivers.canopen.objects import Object

_MANDATORY = 0x1000, 0x1001, 0x1018
_VAR, _RECORD = 0x7, 0x9


def text(dictionary: Sequence[Object], product: str = "CiA 402 drive of pcpc") -> str:
    """Return the EDS of a dictionary."""
    indices = sorted({one.index for one in dictionary})
    parts = [
        _section("FileInfo", FileVersion=1, FileRevision=0, EDSVersion="4.0", Description=product),
        _section(
            "DeviceInfo", VendorName="pcpc", ProductName=product, VendorNumber=0, ProductNumber=0,
            **{f"BaudRate_{k}": 1 for k in (10, 20, 50, 125, 250, 500, 800, 1000)},
            SimpleBootUpMaster=0, SimpleBootUpSlave=1, Granularity=8, DynamicChannelsSupported=0,
            GroupMessaging=0, NrOfRXPDO=at.PDOS, NrOfTXPDO=at.PDOS, LSS_Supported=0,
        ),
        _list("MandatoryObjects", [i for i in indices if i in _MANDATORY]),
        _list("OptionalObjects", [i for i in indices if i not in _MANDATORY]),
        _list("ManufacturerObjects", []),
    ]  # fmt: skip
    ordered = sorted(dictionary, key=lambda one: (one.index, one.subindex))
    for index, group in groupby(ordered, key=lambda one: one.index):
        parts += _entries(index, list(group))
    return "\n".join(parts)


def _entries(index: int, group: list[Object]) -> list[str]:
    if len(group) == 1 and group[0].subindex == 0:
        return [_object(f"{index:04X}", group[0])]
    name = group[0].name
    head = _section(
        f"{index:04X}", ParameterName=name, ObjectType=f"0x{_RECORD:X}", SubNumber=len(group)
    )
    return [head, *(_object(f"{index:04X}sub{one.subindex:X}", one) for one in group)]


def _object(section: str, od_object: Object) -> str:
    start = od_object.text if od_object.kind == ObjectType.TEXT else str(od_object.start)
    low, high = od_object.bounds
    limits = {"LowLimit": low, "HighLimit": high}
    if od_object.kind == ObjectType.TEXT:
        limits = {}
    elif od_object.kind == ObjectType.F32:
        limits, start = {}, _real(od_object.start)
    return _section(
        section,
        ParameterName=od_object.name,
        ObjectType=f"0x{_VAR:X}",
        DataType=f"0x{int(od_object.kind):04X}",
        **limits,
        AccessType=_access(od_object),
        DefaultValue=start,
        PDOMapping=int(bool(od_object.access & (at.TO_DRIVE | at.FROM_DRIVE))),
    )


def _access(od_object: Object) -> str:
    """Return how an object is read and written, and mapped if only one way."""
    mapped = od_object.access & (at.TO_DRIVE | at.FROM_DRIVE)
    if not od_object.access & at.WRITE:
        return "ro"
    if not od_object.access & at.READ:
        return "wo"
    return {at.TO_DRIVE: "rww", at.FROM_DRIVE: "rwr"}.get(mapped, "rw")


def _real(bits: int) -> str:
    """Return a REAL32 as a number that is read back as these bits."""
    value = struct.unpack("<f", struct.pack("<I", bits))[0]
    return f"{value:.9g}" if math.isfinite(value) else f"0x{bits:08X}"


def _section(name: str, **entries: object) -> str:
    lines = (f"{key}={value}" for key, value in entries.items())
    return "\n".join([f"[{name}]", *lines, ""])


def _list(name: str, indices: Sequence[int]) -> str:
    entries = {str(i + 1): f"0x{index:04X}" for i, index in enumerate(indices)}
    return _section(name, SupportedObjects=len(indices), **entries)

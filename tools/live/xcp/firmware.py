"""The XCP slave of a device in C: what `pcpc generate c RIG --device --xcp` adds to its files.

xcp.c, xcp.h    the same for all rigs: packets on CAN, one DAQ list
xcp_rig.h       ids, names, codes of this rig's slave; its table stands in rig.c
"""

import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources

from pcpc.drivers.errors import UserError
from pcpc.executive.loop.table import Variable
from pcpc.executive.rig.messages import database_of
from pcpc.executive.rig.reading import Rig
from pcpc.tools.live.xcp.lists import DIVISIONS
from pcpc.tools.live.xcp.packets import Cmd, Err
from pcpc.tools.live.xcp.slave import event_name, period

_OURS = resources.files("pcpc.tools.live.xcp") / "c"
_MOST = sys.float_info.max
_EXTENDED = 0x80000000


def with_xcp(
    files: Mapping[str, str], rig: Rig, places: Sequence[tuple[Variable, str]], ids: str
) -> dict[str, str]:
    """Return a device's files, its fixed ones with PCPC_XCP, with the slave; UserError: wrong ids.

    `places`: the node's variables with their expressions in C, "" for one that it does not hold.
    """
    if taken := [name for name in ("xcp.c", "xcp.h", "xcp_rig.h") if name in files]:
        raise UserError(f"--xcp: {taken[0]} is of a block of this rig; rename the block")
    device_files = dict(files)
    first = '#include "rig.h"\n'
    device_files["rig.c"] = device_files["rig.c"].replace(
        first, first + '#include "xcp_rig.h"\n', 1
    )
    device_files |= {name: (_OURS / name).read_text() for name in ("xcp.c", "xcp.h")}
    device_files["xcp_rig.h"] = "\n".join(_header(rig, len(places), _ids(rig, ids)))
    device_files["rig.c"] += "\n".join([*_table(places), *_events(rig.config.period_ns)])
    return device_files


def absent(files: Mapping[str, str]) -> list[str]:
    """Return the variables that a device with these files does not hold."""
    return re.findall(r"^    \{0, .*/\* (\S+) \*/$", files["rig.c"], re.MULTILINE)


def _ids(rig: Rig, text: str) -> list[int]:
    """Return the two ids, with the bit of 29 bits as a frame's id has it; UserError."""
    if not re.fullmatch(r"(?i)0x[0-9a-f]{1,8},0x[0-9a-f]{1,8}", text):
        raise UserError(f"--xcp {text}: expected two ids, as 0x7E0,0x7E1")
    names_by_id = {message.frame_id: message.name for message in database_of(rig).messages}
    ids = [int(word, 16) for word in text.split(",")]
    for one in ids:
        if one in names_by_id:
            raise UserError(
                f"--xcp: 0x{one:X} is {names_by_id[one]} of the DBC file; give two others"
            )
    if ids[0] == ids[1] or max(ids) >= 1 << 29:
        raise UserError(f"--xcp {text}: expected two different ids of at most 29 bits")
    return [one | _EXTENDED * (one > 0x7FF) for one in ids]


def _header(rig: Rig, count: int, ids: Sequence[int]) -> Iterator[str]:
    yield "/* The XCP slave of this rig, written by `pcpc generate c`. */"
    yield from ("#ifndef XCP_RIG_H", "#define XCP_RIG_H", "", '#include "xcp.h"', "")
    name = rig.config.rig
    yield f"#define XCP_NODE {json.dumps(f'{name}.executive')}\n#define XCP_RIG {json.dumps(name)}"
    yield f"#define XCP_MASTER 0x{ids[0]:X}u\n#define XCP_SLAVE 0x{ids[1]:X}u"
    yield f"#define XCP_VARIABLES {count}u\n#define XCP_EVENTS {len(DIVISIONS)}u\n"
    yield from (f"#define CMD_{name} 0x{code:02X}u" for name, code in Cmd.__members__.items())
    yield from ("", *(f"#define ERR_{one.name} 0x{one:02X}u" for one in Err), "")
    yield "extern const xcp_variable xcp_table[XCP_VARIABLES];"
    yield from ("extern const xcp_event xcp_events[XCP_EVENTS];", "", "#endif", "")


def _table(places: Sequence[tuple[Variable, str]]) -> Iterator[str]:
    yield from ("", "const xcp_variable xcp_table[XCP_VARIABLES] = {")
    for variable, place in places:
        low, high = (variable.low, variable.high) if variable.kind == "parameter" else (1.0, 0.0)
        bounds = ", ".join(repr(min(max(bound, -_MOST), _MOST)) for bound in (low, high))
        yield f"    {{{f'&{place}' if place else 0}, {bounds}}}, /* {variable.name} */"
    yield "};"


def _events(period_ns: int) -> Iterator[str]:
    yield from ("", "const xcp_event xcp_events[XCP_EVENTS] = {")
    for i, every_n in enumerate(DIVISIONS):
        count, unit = period(every_n * period_ns)
        yield f'    {{"{event_name(i)}", {every_n}u, {count}u, {unit}u}},'
    yield from ("};", "")

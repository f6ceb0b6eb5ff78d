"""The A2L file (ASAM MCD-2 MC) of a node: its variables as a calibration tool finds them.

Parameters are CHARACTERISTICs, all else MEASUREMENTs; a name's address is its number times 8, see
`slave`. Elements NAME_0, NAME_1, ... of an array have an entry each, and NAME one for all of them.
A block is a GROUP. All values are doubles, little-endian.
"""

import importlib.metadata
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count, takewhile
from typing import Any, NamedTuple

from pcpc.tools.live.xcp.lists import DIVISIONS
from pcpc.tools.live.xcp.packets import ETHERNET, Cmd, Link
from pcpc.tools.live.xcp.slave import event_name, period

_FAR = 1e300  # where there is no limit
_OPTIONAL = [one for one in Cmd if one < Cmd.SYNCH]
_A2ML = (
    """    /begin A2ML
      struct Protocol_Layer { uint; uint; uint; uint; uint; uint; uint; uint; uchar; uint;
        enum { "BYTE_ORDER_MSB_LAST" = 0, "BYTE_ORDER_MSB_FIRST" = 1 };
        enum { "ADDRESS_GRANULARITY_BYTE" = 1, "ADDRESS_GRANULARITY_WORD" = 2 };
        taggedstruct { ("OPTIONAL_CMD" enum { """
    + ", ".join(f'"{one.name}" = 0x{one:X}' for one in _OPTIONAL)
    + """ })*;
          "COMMUNICATION_MODE_SUPPORTED" taggedunion {
            "BLOCK" taggedstruct { "SLAVE"; "MASTER" struct { uchar; uchar; }; }; }; };
      };
      struct Event { char[101]; char[9]; uint;
        enum { "DAQ" = 1, "STIM" = 2, "DAQ_STIM" = 3 };
        uchar; uchar; uchar; uchar; taggedstruct { "EVENT_COUNTER_PRESENT"; };
      };
      struct Daq { enum { "STATIC" = 0, "DYNAMIC" = 1 }; uint; uint; uchar;
        enum { "OPTIMISATION_TYPE_DEFAULT" = 0 };
        enum { "ADDRESS_EXTENSION_FREE" = 0 };
        enum { "IDENTIFICATION_FIELD_TYPE_ABSOLUTE" = 0 };
        enum { "GRANULARITY_ODT_ENTRY_SIZE_DAQ_BYTE" = 1 };
        uchar;
        enum { "NO_OVERLOAD_INDICATION" = 0, "OVERLOAD_INDICATION_EVENT" = 2 };
        taggedstruct {
          "PRESCALER_SUPPORTED";
          block "TIMESTAMP_SUPPORTED" struct { uint; enum { "SIZE_DWORD" = 4 };
            enum { "UNIT_1US" = 3 }; taggedstruct { "TIMESTAMP_FIXED"; }; };
          (block "EVENT" struct Event)*;
        };
      };
      taggedstruct Common_Parameters {
        block "PROTOCOL_LAYER" struct Protocol_Layer;
        block "DAQ" struct Daq;
      };
      struct Ip { uint; uint; taggedunion { "HOST_NAME" char[256]; "ADDRESS" char[15]; };
        taggedstruct { "MAX_BUS_LOAD" ulong; "MAX_BIT_RATE" ulong; };
        taggedstruct { "PACKET_ALIGNMENT" enum { "PACKET_ALIGNMENT_8" = 0 }; };
        taggedstruct { ("OPTIONAL_TL_SUBCMD" enum { "GET_SLAVE_ID" = 0xFF })*; };
      };
      struct Can { uint; taggedstruct {
        "CAN_ID_MASTER" ulong; "CAN_ID_SLAVE" ulong; "BAUDRATE" ulong; "MEASUREMENT_SPLIT_ALLOWED";
        block "CAN_FD" struct { taggedstruct {
          "MAX_DLC" uint; "CAN_FD_DATA_TRANSFER_BAUDRATE" ulong; }; };
      }; };
      block "IF_DATA" taggedunion if_data { "XCP" struct {
        taggedstruct Common_Parameters;
        taggedstruct {
          block "DAQ_EVENT" taggedunion {
            "FIXED_EVENT_LIST" taggedstruct { ("EVENT" uint)*; }; };
          block "XCP_ON_UDP_IP" struct { struct Ip; taggedstruct Common_Parameters; };
          block "XCP_ON_TCP_IP" struct { struct Ip; taggedstruct Common_Parameters; };
          block "XCP_ON_CAN" struct { struct Can; taggedstruct Common_Parameters; };
        };
      }; };
    /end A2ML"""
)


class A2lVariable(NamedTuple):
    """A variable as the file has it; `range`: of a parameter, else None.

    `has_event`: whether lists may have it, as its value in each cycle is known; else it is polled.
    """

    name: str
    unit: str
    help: str
    range: Sequence[float] | None
    has_event: bool


def variables_of(description: Mapping[str, Any]) -> list[A2lVariable]:
    """Return those of a node, by its description.

    No row has a parameter. It changes by tunings alone, but for those of the loop and of a drive,
    which they write themselves, and where a fault may act.
    """
    recorded = {*description["state_columns"], *description["timing_columns"]}
    injected = {one["of"].rpartition(":")[2] for one in description["faults"].values()}
    tuned_alone = {*description["blocks"], "rig"}  # writers

    def has_event(name: str, kind: str, writer: str) -> bool:
        is_held = kind == "parameter" and writer in tuned_alone and name not in injected
        return name in recorded or is_held

    return [
        A2lVariable(
            name, unit, text, description["ranges"].get(name), has_event(name, kind, writer)
        )
        for name, unit, kind, writer, text in description["variables"]
    ]


def version() -> str:
    """Return that of pcpc."""
    return importlib.metadata.version("pcpc")


def a2l_text(
    rig: str,
    node: str,
    made_by: str,
    period_ns: int,
    variables: Sequence[A2lVariable],
    transport: Iterable[str],
    link: Link = ETHERNET,
) -> str:
    """Return the file of a node. `transport`: lines that say where it is."""
    interface = _interface(period_ns, transport, link)
    return "\n".join(_lines(rig, node, made_by, variables, interface)) + "\n"


def ethernet(ports: Iterable[tuple[str, str, int]]) -> Iterator[str]:
    """Yield the lines of ("UDP" or "TCP", address, port)."""
    for kind, address, port in ports:
        yield f'      /begin XCP_ON_{kind}_IP 0x0101 {port} ADDRESS "{address}"'
        yield f"      /end XCP_ON_{kind}_IP"


def _lines(
    rig: str, node: str, made_by: str, variables: Sequence[A2lVariable], interface: Iterator[str]
) -> Iterator[str]:
    units = {unit: f"CM_{i}" for i, unit in enumerate(sorted({one.unit for one in variables}))}
    yield "ASAP2_VERSION 1 71"
    yield f"/begin PROJECT {_word(rig)} {_text(f'rig {rig}')}"
    yield f"  /begin HEADER {_text(f'written by pcpc {made_by}')}"
    yield f"    VERSION {_text(made_by)}\n  /end HEADER"
    yield f"  /begin MODULE {_word(node)} {_text(f'the {node} of rig {rig}')}"
    yield _A2ML
    yield '    /begin MOD_COMMON ""\n      BYTE_ORDER MSB_LAST\n      ALIGNMENT_FLOAT64_IEEE 8'
    yield "    /end MOD_COMMON"
    yield from interface
    for unit, name in units.items():
        yield f'    /begin COMPU_METHOD {name} "" IDENTICAL "%15.9" {_text(unit)}'
        yield "    /end COMPU_METHOD"
    yield "    /begin RECORD_LAYOUT F64\n      FNC_VALUES 1 FLOAT64_IEEE ROW_DIR DIRECT"
    yield "    /end RECORD_LAYOUT"
    entries = list(_entries(variables))
    polled = "      /begin IF_DATA XCP\n        /begin DAQ_EVENT FIXED_EVENT_LIST"
    polled += "\n        /end DAQ_EVENT\n      /end IF_DATA\n"
    for number, size, variable in entries:
        unit, address = units[variable.unit], f"0x{8 * number:X}"
        kind, dimension = ("VAL_BLK", f" MATRIX_DIM {size} 1 1") if size > 1 else ("VALUE", "")
        text, events = (
            (variable.help, "")
            if variable.has_event
            else (f"{variable.help[:240]} (polled only)", polled)
        )
        if variable.range:
            low, high = (min(max(bound, -_FAR), _FAR) for bound in variable.range)
            yield f"    /begin CHARACTERISTIC {_word(variable.name)} {_text(text)}"
            yield f"      {kind} {address} F64 0 {unit} {low} {high}{dimension}"
            yield f"{events}    /end CHARACTERISTIC"
        else:
            yield f"    /begin MEASUREMENT {_word(variable.name)} {_text(text)}"
            yield f"      FLOAT64_IEEE {unit} 0 0 {-_FAR:g} {_FAR:g}"
            yield f"      ECU_ADDRESS {address}{dimension}\n{events}    /end MEASUREMENT"
    blocks: dict[str, list[A2lVariable]] = {}
    for _, _, variable in entries:
        blocks.setdefault(variable.name.partition(".")[0], []).append(variable)
    for block, members in blocks.items():
        yield from _group(block, members)
    yield "  /end MODULE\n/end PROJECT"


def _entries(variables: Sequence[A2lVariable]) -> Iterator[tuple[int, int, A2lVariable]]:
    """Yield number, size and description of each variable, and of an array before its elements."""
    names = {one.name for one in variables}
    for number, variable in enumerate(variables):
        array = variable.name.removesuffix("_0")
        if array not in names:
            alike = (variable._replace(name=f"{array}_{i}") for i in count())
            pairs = zip(variables[number:], alike, strict=False)
            size = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
            if size > 1:
                yield number, size, variable._replace(name=array)
        yield number, 1, variable


def _group(block: str, members: list[A2lVariable]) -> Iterator[str]:
    yield f"    /begin GROUP G_{_word(block)} {_text(f'block {block}')}\n      ROOT"
    for kind, wanted in (("CHARACTERISTIC", True), ("MEASUREMENT", False)):
        names = [_word(one.name) for one in members if (one.range is not None) is wanted]
        if names:
            yield f"      /begin REF_{kind}"
            yield from (f"        {name}" for name in names)
            yield f"      /end REF_{kind}"
    yield "    /end GROUP"


def _interface(period_ns: int, transport: Iterable[str], link: Link) -> Iterator[str]:
    yield "    /begin IF_DATA XCP"
    yield f"      /begin PROTOCOL_LAYER 0x0101 2000 0 0 0 0 0 0 {link.cto} {link.dto}"
    yield "        BYTE_ORDER_MSB_LAST ADDRESS_GRANULARITY_BYTE"
    yield from (f"        OPTIONAL_CMD {one.name}" for one in _OPTIONAL)
    if most := link.most_in_block:
        yield f"        COMMUNICATION_MODE_SUPPORTED BLOCK SLAVE MASTER {most} {link.apart}"
    yield "      /end PROTOCOL_LAYER"
    yield f"      /begin DAQ DYNAMIC 252 {len(DIVISIONS)} 0 OPTIMISATION_TYPE_DEFAULT"
    yield "        ADDRESS_EXTENSION_FREE IDENTIFICATION_FIELD_TYPE_ABSOLUTE"
    size = min(8, link.dto - 1)
    yield f"        GRANULARITY_ODT_ENTRY_SIZE_DAQ_BYTE {size} OVERLOAD_INDICATION_EVENT"
    yield "        PRESCALER_SUPPORTED"
    yield "        /begin TIMESTAMP_SUPPORTED 1 SIZE_DWORD UNIT_1US"
    yield "        /end TIMESTAMP_SUPPORTED"
    for number, division in enumerate(DIVISIONS):
        name = event_name(number)
        count, unit = period(period_ns * division)
        yield f'        /begin EVENT "{name}" "{name}" {number} DAQ 255 {count} {unit} 0'
        yield "        /end EVENT"
    yield "      /end DAQ"
    yield from transport
    yield "    /end IF_DATA"


def _word(name: str) -> str:
    """Return a name as an identifier of A2L, which begins with a letter."""
    word = re.sub(r"[^A-Za-z0-9_.]", "_", name)
    return word if re.match(r"[A-Za-z_]", word) else f"_{word}"


def _text(text: Any) -> str:
    """Return a string of A2L, in one line."""
    clean = re.sub(r"\s+", " ", str(text))[:255].replace("\\", "\\\\").replace('"', '\\"')
    return f'"{clean}"'

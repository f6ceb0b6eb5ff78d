"""The A2L file (ASAM MCD-2 MC) of a node: its variables as a calibration tool finds them.

Parameters with a range are CHARACTERISTICs, all else MEASUREMENTs; a name's address is its number
times 8, see `slave`. A block is a GROUP. All values are doubles, little-endian.
"""

import importlib.metadata
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import Any, NamedTuple

from pcpc.tools.live.xcp.lists import DIVISIONS
from pcpc.tools.live.xcp.packets import MAX_CTO, MAX_DTO
from pcpc.tools.live.xcp.slave import event_name, period

_FAR = 1e300  # limits of a measurement, which has none
_A2ML = """    /begin A2ML
      struct Protocol_Layer { uint; uint; uint; uint; uint; uint; uint; uint; uchar; ulong;
        enum { "BYTE_ORDER_MSB_LAST" = 0, "BYTE_ORDER_MSB_FIRST" = 1 };
        enum { "ADDRESS_GRANULARITY_BYTE" = 1, "ADDRESS_GRANULARITY_WORD" = 2 };
        taggedstruct { ("OPTIONAL_CMD" char[100])*; };
      };
      struct Event { char[101]; char[9]; uint;
        enum { "DAQ" = 1, "STIM" = 2, "DAQ_STIM" = 3 };
        uchar; uchar; uchar; uchar;
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
            enum { "UNIT_1US" = 3 }; };
          (block "EVENT" struct Event)*;
        };
      };
      struct Ip { uint; uint; taggedunion { "HOST_NAME" char[256]; "ADDRESS" char[16]; }; };
      block "IF_DATA" taggedunion if_data { "XCP" struct { taggedstruct {
        block "PROTOCOL_LAYER" struct Protocol_Layer;
        block "DAQ" struct Daq;
        block "XCP_ON_UDP_IP" struct Ip;
        block "XCP_ON_TCP_IP" struct Ip;
      }; }; };
    /end A2ML"""


class A2lVariable(NamedTuple):
    """A variable as the file has it; `range`: of a parameter, else None."""

    name: str
    unit: str
    help: str
    range: tuple[float, float] | None


def version() -> str:
    """Return that of pcpc."""
    return importlib.metadata.version("pcpc")


def a2l_text(
    rig: str, node: str, made_by: str, period_ns: int, variables: Sequence[A2lVariable],
    transports: Iterable[tuple[str, str, int]],
) -> str:  # fmt: skip
    """Return the file of a node. `transports`: ("UDP" or "TCP", address, port)."""
    return "\n".join(_lines(rig, node, made_by, period_ns, variables, transports)) + "\n"


def _lines(
    rig: str, node: str, made_by: str, period_ns: int, variables: Sequence[A2lVariable],
    transports: Iterable[tuple[str, str, int]],
) -> Iterator[str]:  # fmt: skip
    units = {unit: f"CM_{i}" for i, unit in enumerate(sorted({one.unit for one in variables}))}
    yield "ASAP2_VERSION 1 71"
    yield f"/begin PROJECT {_word(rig)} {_text(f'rig {rig}')}"
    yield f"  /begin HEADER {_text(f'written by pcpc {made_by}')}"
    yield f"    VERSION {_text(made_by)}\n  /end HEADER"
    yield f"  /begin MODULE {_word(node)} {_text(f'the {node} of rig {rig}')}"
    yield _A2ML
    yield '    /begin MOD_COMMON ""\n      BYTE_ORDER MSB_LAST\n      ALIGNMENT_FLOAT64_IEEE 8'
    yield "    /end MOD_COMMON"
    yield from _interface(period_ns, transports)
    for unit, name in units.items():
        yield f'    /begin COMPU_METHOD {name} "" IDENTICAL "%15.9" {_text(unit)}'
        yield "    /end COMPU_METHOD"
    yield "    /begin RECORD_LAYOUT F64\n      FNC_VALUES 1 FLOAT64_IEEE ROW_DIR DIRECT"
    yield "    /end RECORD_LAYOUT"
    for number, one in enumerate(variables):
        unit, at = units[one.unit], f"0x{8 * number:X}"
        if one.range:
            low, high = (f"{bound:.17g}" for bound in one.range)
            yield f"    /begin CHARACTERISTIC {_word(one.name)} {_text(one.help)}"
            yield f"      VALUE {at} F64 0 {unit} {low} {high}\n    /end CHARACTERISTIC"
        else:
            yield f"    /begin MEASUREMENT {_word(one.name)} {_text(one.help)}"
            yield f"      FLOAT64_IEEE {unit} 0 0 {-_FAR:g} {_FAR:g}\n      ECU_ADDRESS {at}"
            yield "    /end MEASUREMENT"
    for block, members in groupby(variables, key=lambda one: one.name.partition(".")[0]):
        yield from _group(block, list(members))
    yield "  /end MODULE\n/end PROJECT"


def _group(block: str, members: list[A2lVariable]) -> Iterator[str]:
    yield f"    /begin GROUP G_{_word(block)} {_text(f'block {block}')}\n      ROOT"
    for kind, wanted in (("CHARACTERISTIC", True), ("MEASUREMENT", False)):
        names = [_word(one.name) for one in members if (one.range is not None) is wanted]
        if names:
            yield f"      /begin REF_{kind}"
            yield from (f"        {name}" for name in names)
            yield f"      /end REF_{kind}"
    yield "    /end GROUP"


def _interface(period_ns: int, transports: Iterable[tuple[str, str, int]]) -> Iterator[str]:
    yield "    /begin IF_DATA XCP"
    yield f"      /begin PROTOCOL_LAYER 0x0101 2000 0 0 0 0 0 0 {MAX_CTO} {MAX_DTO}"
    yield "        BYTE_ORDER_MSB_LAST ADDRESS_GRANULARITY_BYTE"
    for command in ("GET_COMM_MODE_INFO", "GET_ID", "SET_MTA", "UPLOAD", "SHORT_UPLOAD"):
        yield f'        OPTIONAL_CMD "{command}"'
    yield "      /end PROTOCOL_LAYER"
    yield f"      /begin DAQ DYNAMIC 252 {len(DIVISIONS)} 0 OPTIMISATION_TYPE_DEFAULT"
    yield "        ADDRESS_EXTENSION_FREE IDENTIFICATION_FIELD_TYPE_ABSOLUTE"
    yield "        GRANULARITY_ODT_ENTRY_SIZE_DAQ_BYTE 8 OVERLOAD_INDICATION_EVENT"
    yield "        PRESCALER_SUPPORTED"
    yield "        /begin TIMESTAMP_SUPPORTED 1 SIZE_DWORD UNIT_1US"
    yield "        /end TIMESTAMP_SUPPORTED"
    for number, division in enumerate(DIVISIONS):
        name = event_name(number)
        count, unit = period(period_ns * division)
        yield f'        /begin EVENT "{name}" "{name}" {number} DAQ 255 {count} {unit} 0'
        yield "        /end EVENT"
    yield "      /end DAQ"
    for kind, address, port in transports:
        yield f'      /begin XCP_ON_{kind}_IP 0x0101 {port} ADDRESS "{address}"'
        yield f"      /end XCP_ON_{kind}_IP"
    yield "    /end IF_DATA"


def _word(name: str) -> str:
    """Return a name as an identifier of A2L, which begins with a letter."""
    word = re.sub(r"[^A-Za-z0-9_.]", "_", name)
    return word if re.match(r"[A-Za-z_]", word) else f"_{word}"


def _text(text: Any) -> str:
    """Return a string of A2L, in one line."""
    clean = re.sub(r"\s+", " ", str(text)).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{clean[:255]}"'

"""Write states, heartbeats and faults, as the executive declares them, where others read them.

    DBC files           the value table of each `mode` and `nmt_state`
    docs/bus-safety.md  the table of named faults

`python -m pcpc.tools.dev.declarations` writes what has changed; a test finds what has and was not
written. A device's C has them from `tools.make.generate.declared`.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pcpc.drivers.canopen.layout import Heartbeat
from pcpc.drivers.compiled.numbered import NumberedKind
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.states import State

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/bus-safety.md"
SIGNALS: dict[str, NumberedKind] = {"mode": State, "nmt_state": Heartbeat}
_VALUES = re.compile(r"^(VAL_ \d+ (mode|nmt_state)) .*;$", re.MULTILINE)
_ROWS = re.compile(r"(?<=^\|---\|---\|---\|---\|---\|\n)(?:\| \d+ \|.*\n)+", re.MULTILINE)


def rewritten() -> Iterator[tuple[Path, str]]:
    """Yield each file with such a table, and its text with the table as it is declared."""
    for folder in ("plants", "tools/make/template", "tests/executive"):
        for file in sorted((ROOT / folder).rglob("*.dbc")):
            yield file, _VALUES.sub(_values, file.read_text(encoding="utf-8"))
    yield PAGE, _ROWS.sub("".join(map(fault_row, list(Fault)[1:])), PAGE.read_text("utf-8"))


def _values(line: re.Match[str]) -> str:
    every: Any = SIGNALS[line[2]]
    values = " ".join(f'{int(one)} "{one.name}"' for one in every)
    return f"{line[1]} {values} ;"


def fault_row(fault: Fault) -> str:
    """Return the line of a fault in the table of the docs."""
    if isinstance(fault.within, str):
        limit = f"`{fault.within}`"
    else:
        limit = "" if fault.within is None else f"{fault.within} cycle{'s' * (fault.within > 1)}"
    limit = "; ".join(filter(None, (limit, fault.why)))
    columns = str(int(fault)), fault.says, limit, fault.reaction, f"`0x{fault.code:04X}`"
    return f"| {' | '.join(columns)} |\n"


def main() -> int:
    """Write what has changed."""
    for file, text in rewritten():
        if text != file.read_text(encoding="utf-8"):
            file.write_text(text, encoding="utf-8")
            print(file.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The CAN line of a run with `bus.emulate`: a gateway between the sides of its nodes."""

import json
from pathlib import Path

from pcpc.drivers.can.bus import BusAddress
from pcpc.executive.rig.buses import check_line
from pcpc.executive.rig.reading import Rig
from pcpc.tools.start.bus import line_report
from pcpc.tools.start.children import Child
from pcpc.tools.start.folder import LINE


def start(rig: Rig, bus: BusAddress, folder: Path) -> Child:
    """Start the gateway; return once it hears both sides, or has ended. RigError."""
    check_line(rig, "real")

    def main(ready: int) -> int:
        from pcpc.tools.start.bus import emulate  # here, because it compiles

        return emulate.serve(rig, bus, folder / LINE, ready)

    return Child.serving("line", main)


def summary(folder: Path) -> tuple[str, list[str]]:
    """Return in a line what the gateway had to tell at its end, and nodes with a wrong bit rate.

    "" and none if it did not come to that.
    """
    try:
        found = json.loads((folder / LINE).read_text())
    except OSError:
        return "", []
    return line_report.summary(found), line_report.mismatches(found)

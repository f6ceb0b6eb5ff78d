"""A rig with FMUs in a process of its own: code of others may crash, and nobody in it could say so.

The process is copied before anything of an FMU is loaded. The copy goes on with the command; the
process that was started hands on signals and exit code, and names the FMUs if the copy is killed.
"""

import os
import signal
import sys
from typing import Any

from pcpc.drivers.errors import Exit
from pcpc.executive.nodes import fmus
from pcpc.executive.rig.reading import Rig
from pcpc.tools.start.children import end_with, on_request


def outlived(rig: Rig) -> int | None:
    """Return the exit code of the copy that ran `rig`; None in the copy, and of a rig without FMUs.

    The copy ends with this process.
    """
    names = [
        f"{spec.name} ({fmus.step_of(spec).model.name})"
        for node in rig.nodes().values()
        for spec in node.blocks
        if fmus.step_of(spec) is not None
    ]
    if not names:
        return None
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    host, pid = os.getpid(), os.fork()
    if pid == 0:
        end_with(host)
        return None

    def hand_on(number: int, _: Any) -> None:
        os.kill(pid, number)

    on_request(hand_on)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if code >= 0:
        return code
    what = f"ended by {signal.Signals(-code).name} in the code of an FMU"
    print(f"{', '.join(names)}: {what}; nothing is judged", file=sys.stderr)
    return Exit.SAFETY_STOP

"""A first start on two processors: while a command compiles the loop, this compiles the rest.

A process of its own compiles the loop's parts that the command comes to late, then what the rig
steps. The command waits for a function that is being compiled here, and finds those that are done
(`drivers.compiled.kept_code`). Nothing depends on it: should it fail, the command compiles all.

    executive.nodes.first_start RIG PID        ends with process PID
"""

import ctypes
import os
import signal
import subprocess
import sys
from typing import Any

from pcpc.drivers.compiled import compile_cache

_MODULE = "pcpc.executive.nodes.first_start"
_PR_SET_PDEATHSIG = 1


def start_helper(rig: str) -> None:
    """Compile in a second process, where nothing is compiled and there is a processor for it."""
    if len(os.sched_getaffinity(0)) < 2 or not compile_cache.is_empty():
        return
    silent = subprocess.DEVNULL
    helper = subprocess.Popen(
        [sys.executable, "-P", "-m", _MODULE, rig, str(os.getpid())],
        stdin=silent,
        stdout=silent,
        stderr=silent,
        start_new_session=True,
    )
    compile_cache.watch.helper = helper.pid


def main(rig: str, parent: int) -> None:
    """Compile what a rig's first cycle needs; pcpc.Error for a rig that cannot be."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return

    from pcpc.drivers.compiled.structures import structure
    from pcpc.executive.laws.emath_selftest import selftest
    from pcpc.executive.loop import shared, stepping, supervisor, timing, tuning
    from pcpc.executive.nodes.plan import plan
    from pcpc.executive.rig.reading import load_rig

    node = structure(shared.LOOP)
    parts: tuple[Any, ...] = supervisor.supervise, tuning.tune, stepping.limit, timing.count
    for part in parts:
        part.compile((node,))
    loaded = load_rig(rig)
    last: Any = timing.reset
    last.compile((node,))
    selftest()
    for role in loaded.roles:
        plan(loaded, role, loaded.config.pacing)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))

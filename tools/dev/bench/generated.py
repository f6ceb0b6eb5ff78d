"""Generated C of two laws of the barrel against by_hand.c: the same inputs, the same bits.

Both are compiled with -O2 -ffp-contract=off and called by the same native loop, that of drive.c.
"""

import ctypes
from pathlib import Path

from pcpc.tools.dev.bench.compiler import library
from pcpc.tools.dev.bench.ratio import Ratio, interleave
from pcpc.tools.dev.bench.steps import DRIVE, LAWS, in_c, record, step_time
from pcpc.tools.terminal.progress import Progress

BY_HAND = Path(__file__).with_name("by_hand.c")
WRITTEN_TWICE = ("pd", "pd_nn_fast")


def c_library() -> ctypes.CDLL:
    """Return NAME and NAME_by_hand of each law, and the loop over one; CompilerError."""
    return library([BY_HAND, DRIVE], {name: LAWS[name] for name in WRITTEN_TWICE})


def measure(progress: Progress, rounds: int = 15) -> list[Ratio]:
    """Measure the laws; CompilerError, RigError."""
    c = c_library()
    progress.show("recording the inputs: two virtual runs")
    found = []
    for name in WRITTEN_TWICE:
        case = record(name)[name]
        drives = [in_c(case, c), in_c(case, c, f"{name}_by_hand")]
        own, base = interleave(progress, name, rounds, [*map(step_time, drives)])
        against = "C by hand, the same functions"
        found.append(Ratio.from_rounds("generated", name, against, own, base, "ns"))
    return found

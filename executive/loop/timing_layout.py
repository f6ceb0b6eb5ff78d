"""What the loop counts about its own time: stages of a cycle, what is kept of them (no numba)."""

import numpy as np

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.rows import row_of


class Stage(NumberedEnum):
    """The parts of a cycle; work is all but the first."""

    WAKE_LATE, RECEIVE, STEP, SEND, PUBLISH, WORK = range(6)


USAGE = {"minor_faults": 8, "major_faults": 9, "switches": 16, "forced_switches": 17}  # in rusage
STAGES, BUCKETS, LATEST = len(Stage), 320, 8  # see `executive.loop.timing`
FIGURES = row_of("count total least most")  # of a stage's ns
LATE = np.dtype(
    (
        np.record,
        [  # of a cycle; usage: since the one before
            ("cycle", "<i8"),
            ("stage_ns", "<i8", (STAGES,)),
            ("usage", "<i8", (len(USAGE),)),
        ],
    )
)

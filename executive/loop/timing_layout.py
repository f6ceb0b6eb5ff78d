"""What the loop counts about its own time: stages of a cycle, what is kept of them (no numba)."""

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Cells, Element, Record, cells


class Stage(NumberedEnum):
    """The parts of a cycle; work is all but the first."""

    WAKE_LATE, RECEIVE, STEP, SEND, PUBLISH, WORK = range(6)


USAGE = {"minor_faults": 8, "major_faults": 9, "switches": 16, "forced_switches": 17}  # in rusage
STAGES, BUCKETS, LATEST = len(Stage), 320, 8  # see `executive.loop.timing`


class Figures(Element):
    """Of a stage, ns."""

    count: int
    total: int
    least: int
    most: int


class Late(Element):
    """A cycle that woke late."""

    cycle: int
    stage_ns: Cells[int] = cells(STAGES)
    usage: Cells[int] = cells(len(USAGE))  # since the cycle before


class Timing(Record):
    """When this cycle did what; see `executive.loop.timing`."""

    received: int
    stepped: int
    sent: int
    done: int
    publish_ns: int
    stage_ns: Cells[int] = cells(STAGES)
    usage: Cells[int] = cells(18)  # struct rusage
    usage_before: Cells[int] = cells(len(USAGE))

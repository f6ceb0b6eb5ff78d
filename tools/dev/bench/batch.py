"""Closed-loop runs of slew10 in lanes, against C and scipy, and two threads against one.

    lanes    `executive.batch`: WIDTH runs of plant and executive at once, codec rounding, limits,
             supervisor and delay included, no CRC and no records
    C        one run after the other: the C of the suite `simulate`, -O2, with frames, without CRC
    scipy    as in the suite simulate: the plant alone, as accurate

Processor time in ms per simulated second of one run; threads by wall time, the same groups in one
thread and in two. Compiled for this machine's processor, as `pcpc sweep` is.
"""

import threading
import time

from pcpc.drivers.compiled.lanes import WIDTH
from pcpc.executive.batch.group import LaneGroup
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.bench.cycle import RIG
from pcpc.tools.dev.bench.ratio import Measurement, Ratio, interleave
from pcpc.tools.dev.bench.simulate import (
    DURATION_S,
    quickest,
    rival_times,
    run_time_in_c,
    segment,
)
from pcpc.tools.terminal.progress import Progress

SUITE = "batch"
THREADS = 2


def group() -> LaneGroup:
    """Return WIDTH runs of slew10."""
    return LaneGroup(load_rig(RIG, settings=[f"duration_s={DURATION_S}"]), {})


def once(one: LaneGroup) -> None:
    """Do the runs of a group, each lane with another play of the gear."""
    one.begin()
    place = one.plans["plant"].table.index["barrel.gap_rad"]
    for lane in range(WIDTH):
        one.put(lane, "plant", {place: 1e-3 + 1e-4 * lane})
    odd = one.run()
    assert not odd.any(), "no run of these faults"


def in_lanes(one: LaneGroup) -> float:
    """Return the processor time of a run in ns; a group has a thread of its own."""
    start = time.process_time_ns()
    once(one)
    return (time.process_time_ns() - start) / WIDTH


def in_threads(groups: list[LaneGroup], threads: int) -> float:
    """Return the wall time in s of all groups, dealt to threads."""

    def work(mine: list[LaneGroup]) -> None:
        for one in mine:
            once(one)

    workers = [threading.Thread(target=work, args=(groups[i::threads],)) for i in range(threads)]
    begin_s = time.perf_counter()
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return time.perf_counter() - begin_s


def measure(progress: Progress, rounds: int = 15) -> list[Ratio]:
    """Return the ratios; CompilerError, BenchError, RigError."""
    in_c, groups = run_time_in_c(), [group() for _ in range(2 * THREADS)]
    progress.show("batch: matching scipy's accuracy")
    rivals = rival_times(segment())
    runs = 2 * THREADS * WIDTH * DURATION_S * 1e-3  # s to ms per simulated second
    sides: list[Measurement] = [
        lambda: in_lanes(groups[0]) / (DURATION_S * 1e6),
        in_c,
        lambda: in_threads(groups, THREADS) / runs,
        lambda: in_threads(groups, 1) / runs,
        *rivals.values(),
    ]
    own, plain, threads, thread, *others = interleave(progress, SUITE, rounds, sides)
    compared = (
        ("a run in lanes", own, "C -O2, both nodes", plain),
        ("a run in lanes", own, *quickest(rivals, others)),
        (f"{THREADS} threads", threads, "one thread, wall", thread),
    )
    return [
        Ratio.from_rounds(SUITE, what, against, ours, base, "ms/s")
        for what, ours, against, base in compared
    ]

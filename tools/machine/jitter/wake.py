"""A plain loop of CPython: a yardstick of `pcpc jitter`, in a process of its own.

    python -m pcpc.tools.machine.jitter.wake INTERVAL_NS PERIODS PRIORITY CPU OUT    CPU: -1 for any

As wake.c, line by line: absolute deadlines by clock_nanosleep through ctypes, whole
periods skipped after a stall, the real-time set-up of the nodes. Writes how late each cycle woke to
OUT, ns, as int64; prints 1 if SCHED_FIFO was granted, else 0.
"""

import ctypes
import signal
import sys
import time
from array import array
from pathlib import Path

from pcpc.drivers.machine import realtime

_CLOCK_MONOTONIC, _TIMER_ABSTIME = 1, 1


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _StopSignal(Exception):
    """SIGINT or SIGTERM came."""


def measure(interval_ns: int, periods: int) -> "array[int]":
    """Return the lateness of each cycle, ns, until `periods` are over or a signal comes."""
    sleep = ctypes.CDLL(None).clock_nanosleep
    until, late, k = _Timespec(), array("q"), 0
    place = ctypes.byref(until)
    now_ns = time.monotonic_ns
    deadline = (now_ns() // interval_ns + 2) * interval_ns
    try:
        while k < periods:
            until.seconds, until.nanoseconds = divmod(deadline, 1_000_000_000)
            sleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, place, None)
            late.append(now_ns() - deadline)
            behind = now_ns() - deadline - interval_ns
            skipped = behind // interval_ns + 1 if behind > 0 else 0
            k += 1 + skipped
            deadline += (1 + skipped) * interval_ns
    except _StopSignal:
        pass
    return late


def _stop(number: int, frame: object) -> None:
    raise _StopSignal


def main(words: list[str]) -> int:
    """Measure, write, print; return 0."""
    interval_ns, periods, priority, cpu = (int(word) for word in words[:4])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)
    report = realtime.prepare_process() + realtime.prepare_thread(
        priority, None if cpu < 0 else cpu
    )
    late = measure(interval_ns, periods)
    Path(words[4]).write_bytes(late.tobytes())
    print(int(report.is_realtime))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Who computes beside a loop: lockstep as any program, watchers off the loops' processors."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from processes import own_bus

import pcpc
from pcpc.drivers import bystander
from pcpc.executive.loop import shared as sh

LOOP = """
import os, sys
os.sched_setaffinity(0, {int(sys.argv[1])})
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(sys.argv[2])))
    print("granted", flush=True)
except PermissionError:
    print("refused", flush=True)
sys.stdin.read()
"""


@contextmanager
def loop_on(processor: int, priority: int) -> Iterator[tuple[int, bool]]:
    """Have a real-time thread on a processor: its process, and whether it was granted."""
    words = [sys.executable, "-c", LOOP, str(processor), str(priority)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as it:
        assert it.stdin and it.stdout
        yield it.pid, it.stdout.readline() == "granted\n"
        it.stdin.close()


@pytest.fixture
def own() -> Iterator[frozenset[int]]:
    before = frozenset(os.sched_getaffinity(0))
    yield before
    assert bystander.keep_off([]) == before == frozenset(os.sched_getaffinity(0))


def test_watchers_leave_the_processor_of_a_loop_and_come_back(own: frozenset[int]) -> None:
    for processor in own:
        with loop_on(processor, 10) as (pid, granted):
            rest = own - {processor} if granted and len(own) > 1 else own
            assert bystander.keep_off([pid]) == rest == frozenset(os.sched_getaffinity(0))
    assert bystander.keep_off([2**22 + 1]) == own  # there is no such process


def test_the_loop_of_the_highest_priority_is_left_first_and_one_processor_stays(
    own: frozenset[int],
) -> None:
    first, last = min(own), max(own)
    with loop_on(first, 10) as (low, _), loop_on(last, 20) as (high, granted):
        rest = bystander.keep_off([low, high])
        assert rest and (last not in rest) == (granted and len(own) > 1)


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_only_a_loop_that_keeps_time_goes_before_other_programs(pacing: str) -> None:
    long = {"duration_s": 1e5, "supervisor.hold_cycles": 10**6}
    long |= {"supervisor.fault_after_cycles": 10**6}
    with pcpc.running("slew10", pacing=pacing, bus=own_bus(), set=long) as live:
        for node in (live._node("executive"), live._node("plant")):
            threads = os.listdir(f"/proc/{node.pid}/task")
            policies = {os.sched_getscheduler(int(thread)) for thread in threads}
            assert (os.SCHED_FIFO in policies) == bool(node.block["control"][sh.REALTIME])
            assert pacing == "real" or policies == {os.SCHED_OTHER}

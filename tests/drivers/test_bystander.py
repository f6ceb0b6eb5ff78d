"""Who watches keeps off the processors of the loops that it watches, and comes back behind them."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence

import pytest

OWN = sorted(os.sched_getaffinity(0))
LOOP = """\
import os, sys
os.sched_setaffinity(0, {{{processor}}})
if {priority}:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({priority}))
print("there", flush=True)
sys.stdin.read()
"""
WATCHES = """\
import json, os, threading
from pcpc.drivers.machine.bystander import keep_off
over = threading.Event()
other = threading.Thread(target=over.wait, daemon=True)
other.start()
told = []
for processes in {calls}:
    used = keep_off(processes)
    threads = [os.sched_getaffinity(int(one)) for one in os.listdir("/proc/self/task")]
    assert len(threads) >= 2 and all(one == used for one in threads), (used, threads)
    told.append(sorted(used))
print(json.dumps(told))
"""


def _may_be_real_time() -> bool:
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    return subprocess.run([sys.executable, "-c", code], stderr=subprocess.DEVNULL).returncode == 0


pytestmark = pytest.mark.skipif(
    len(OWN) < 2 or not _may_be_real_time(), reason="needs two processors and SCHED_FIFO"
)


def loop(processor: int, priority: int) -> subprocess.Popen[str]:
    """Return a process on one processor, once it is there; priority 0 is that of any program."""
    code = LOOP.format(processor=processor, priority=priority)
    made = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert made.stdout is not None and made.stdout.readline() == "there\n"
    return made


@pytest.fixture
def loops() -> Iterator[list[subprocess.Popen[str]]]:
    made: list[subprocess.Popen[str]] = []
    yield made
    for one in made:
        one.communicate()


def used(*calls: Sequence[int]) -> list[list[int]]:
    """Return the processors that a program uses after each call of keep_off."""
    words = [sys.executable, "-c", WATCHES.format(calls=[list(one) for one in calls])]
    found: list[list[int]] = json.loads(subprocess.check_output(words, text=True))
    return found


def test_it_keeps_off_and_comes_back_when_there_is_nobody(
    loops: list[subprocess.Popen[str]],
) -> None:
    for processor in OWN[:2]:
        loops.append(loop(processor, 5))
        rest = [one for one in OWN if one != processor]
        assert used([loops[-1].pid], []) == [rest, OWN], processor


def test_one_processor_stays_and_it_is_that_of_the_lower_priority(
    loops: list[subprocess.Popen[str]],
) -> None:
    for high, low in ((0, 1), (1, 0)):
        loops += [loop(OWN[high], 7), *(loop(one, 3) for one in OWN if one != OWN[high])]
        pids = [one.pid for one in loops[-len(OWN) :]]
        (found,) = used(pids)
        assert OWN[high] not in found and len(found) == 1, (high, low, found)


def test_programs_of_no_priority_and_processes_that_are_gone_do_not_count(
    loops: list[subprocess.Popen[str]],
) -> None:
    loops += [loop(OWN[0], 0), loop(OWN[1], 5)]
    gone = loop(OWN[0], 5)
    gone.communicate()
    assert used([loops[0].pid, gone.pid]) == [OWN]
    assert used([gone.pid, loops[1].pid]) == [[one for one in OWN if one != OWN[1]]]

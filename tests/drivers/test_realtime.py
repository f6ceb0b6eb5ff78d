"""Real-time set-up in child processes: what is granted holds, what is refused stops nothing."""

import json
import subprocess
import sys
from typing import Any

import pytest
from places import PATIENCE_S, ROOT

from pcpc.drivers.machine.realtime import Report, Setting

CHILD = """
import ctypes, gc, json, os, resource, threading
from pcpc.drivers.machine import realtime

prctl = ctypes.CDLL(None).prctl

def thread_state():
    return {
        "policy": os.sched_getscheduler(0), "priority": os.sched_getparam(0).sched_priority,
        "slack_ns": prctl(30, 0, 0, 0, 0), "cpus": sorted(os.sched_getaffinity(0)),
    }

def in_thread(function, *args):
    result = []
    thread = threading.Thread(target=lambda: result.append(function(*args)))
    thread.start()
    thread.join()
    return result[0]

def set_up(priority, cpu):
    report = realtime.prepare_thread(priority, cpu)
    return report, thread_state()

def fifo_allowed(priority):
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True

def become_ordinary(memlock):
    try:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (memlock, memlock))
    except ValueError:
        pass
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    if os.geteuid() == 0:
        os.setgroups([])
        os.setresgid(65534, 65534, 65534)
        os.setresuid(65534, 65534, 65534)

def as_dict(report):
    return {s.name: [s.granted, s.detail] for s in report}

def locked_kib():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmLck"))
"""


def child(code: str) -> Any:
    """Run CHILD and `code` in a process of its own; return what it assigns to `result`."""
    source = f"{CHILD}\n{code}\nprint(json.dumps(result))"
    done = subprocess.run(
        [sys.executable, "-c", source], cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_loop_thread_gets_what_the_kernel_allows_and_no_other_thread_changes() -> None:
    got = child(
        "before = thread_state()\n"
        "allowed = in_thread(fifo_allowed, 41)\n"
        "report, inside = in_thread(set_up, 41, before['cpus'][-1])\n"
        "result = [allowed, as_dict(report), inside, before, thread_state(),"
        " in_thread(thread_state), os.SCHED_FIFO, report.is_realtime]"
    )
    allowed, report, inside, before, after, newborn, fifo, is_realtime = got
    assert after == before and newborn == before, f"{before} became {after}, new thread {newborn}"
    assert report["SCHED_FIFO"][0] == allowed == is_realtime, f"allowed {allowed}: {report}"
    policy = (inside["policy"], inside["priority"])
    assert policy == ((fifo, 41) if allowed else (before["policy"], 0)), f"{policy}"
    assert report["timer slack"][0] and inside["slack_ns"] in (0, 1), f"slack {inside['slack_ns']}"
    cpus = [before["cpus"][-1]] if allowed else before["cpus"]
    assert inside["cpus"] == cpus and report["affinity"][0] == allowed, f"{inside['cpus']}"


def test_the_process_gets_what_it_reports() -> None:
    report, locked, collecting, frozen, writable, latency = child(
        "path = '/dev/cpu_dma_latency'\n"
        "writable = os.access(path, os.W_OK)\n"
        "report = as_dict(realtime.prepare_process())\n"
        "latency = int.from_bytes(open(path, 'rb').read(4), 'little', signed=True)"
        " if report['cpu_dma_latency'][0] and os.access(path, os.R_OK) else 0\n"
        "result = [report, locked_kib(), gc.isenabled(), gc.get_freeze_count(), writable, latency]"
    )
    assert not collecting and frozen > 1000, f"gc enabled {collecting}, {frozen} objects frozen"
    assert report["cpu_dma_latency"][0] == writable, f"writable {writable}: {report}"
    assert latency == 0, f"{latency} us while the request is held"
    assert report["mlockall"][0] == (locked > 1000), f"{locked} KiB locked: {report}"


def test_an_ordinary_user_gets_the_timer_slack_and_the_cures() -> None:
    before, report, warning, is_realtime, inside, latency = child(
        "become_ordinary(65536)\n"
        "before = thread_state()\n"
        "latency = os.access('/dev/cpu_dma_latency', os.W_OK)\n"
        "process = realtime.prepare_process()\n"
        "thread, inside = in_thread(set_up, 80, 0)\n"
        "both = process + thread\n"
        "result = [before, as_dict(both), both.warning(), both.is_realtime, inside, latency]"
    )
    granted = {name for name, (ok, _) in report.items() if ok}
    expected = {"gc", "timer slack"} | ({"cpu_dma_latency"} if latency else set())
    assert granted == expected, f"granted {granted}: {report}"
    assert inside == {**before, "slack_ns": 1}, f"{before} became {inside}"
    assert "@realtime - rtprio 90" in report["SCHED_FIFO"][1], report["SCHED_FIFO"]
    assert "@realtime - memlock unlimited" in report["mlockall"][1], report["mlockall"]
    start = "not hard real time: SCHED_FIFO refused (Operation not permitted; run as root, or add"
    assert warning.startswith(start) and "\n" not in warning, warning
    assert not is_realtime


def test_memory_is_not_locked_where_nothing_waits_for_a_clock() -> None:
    report, locked = child(
        "report = as_dict(realtime.prepare_process(paced=False))\nresult = [report, locked_kib()]"
    )
    assert sorted(report) == ["cpu_dma_latency", "gc"] and locked == 0, f"{locked} KiB: {report}"


def test_locked_pages_stay_shared_with_the_host_and_later_ones_come_whole() -> None:
    granted, locked, private, own, faults = child(
        "import mmap\n"
        "def private_kib():\n"
        "    lines = open('/proc/self/smaps_rollup').read().splitlines()\n"
        "    return next(int(line.split()[1]) for line in lines if 'Private_Dirty' in line)\n"
        "def faults():\n"
        "    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "def node():\n"
        "    report = realtime.prepare_process()\n"
        "    found = [report.settings[-1].granted, locked_kib(), private_kib()]\n"
        "    host[:] = host\n"
        "    own, later = private_kib(), mmap.mmap(-1, 16 << 20)\n"
        "    before = faults()\n"
        "    for page in range(0, 16 << 20, 4096):\n"
        "        later[page] = 1\n"
        "    return [*found, own, faults() - before]\n"
        "gc.freeze()\n"
        "host = bytearray(os.urandom(1 << 20)) * 64\n"
        "reading, writing = os.pipe()\n"
        "if os.fork() == 0:\n"
        "    os.write(writing, json.dumps(node()).encode())\n"
        "    os._exit(0)\n"
        "result = json.loads(os.read(reading, 4096))"
    )
    assert not granted or locked > 65536, f"{locked} KiB locked"
    assert private < 32768, f"{private} KiB are the node's own"
    assert own > 65536, f"{own} KiB are the node's own once it has written 64 MiB"
    assert not granted or faults < 100, f"{faults} faults in 4,096 pages"


@pytest.mark.parametrize("memlock", [65536, 1 << 40, -1])
def test_memory_is_locked_only_where_no_limit_can_make_a_later_allocation_fail(
    memlock: int,
) -> None:
    limit, report, locked = child(
        f"become_ordinary({memlock})\n"
        "limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]\n"
        "report = as_dict(realtime.prepare_process())\n"
        "grown = bytearray(64 << 20)\n"
        "result = [limit, report, locked_kib()]"
    )
    assert report["mlockall"][0] == (limit == -1), f"limit {limit}: {report['mlockall']}"
    assert (locked > 65536) == (limit == -1), f"limit {limit}: {locked} KiB locked"


@pytest.mark.parametrize("priority", [-1, 0, 100])
def test_an_impossible_priority_is_refused_with_the_range(priority: int) -> None:
    report, inside, before = child(
        "before = thread_state()\n"
        f"report, inside = in_thread(set_up, {priority}, None)\n"
        "result = [as_dict(report), inside['policy'], before['policy']]"
    )
    granted, detail = report["SCHED_FIFO"]
    assert not granted and "1 to 99" in detail and inside == before, f"{inside}: {detail}"
    assert "affinity" not in report, f"{report}"


def test_a_missing_cpu_is_refused_and_names_those_there_are() -> None:
    report, cpus = child(
        "report, inside = in_thread(set_up, 1, 5000)\nresult = [as_dict(report), inside['cpus']]"
    )
    granted, detail = report["affinity"]
    wanted = f"{cpus}" if report["SCHED_FIFO"][0] else "SCHED_FIFO"
    assert not granted and wanted in detail, detail


def test_the_warning_names_the_weightiest_refusal_first_and_nothing_when_all_is_granted() -> None:
    latency = Setting("cpu_dma_latency", False, "why")
    fifo, no_fifo = Setting("SCHED_FIFO", True, ""), Setting("SCHED_FIFO", False, "cure")
    process = Report((Setting("gc", True, ""), latency))
    text = (process + Report((no_fifo,))).warning()
    assert text == "not hard real time: SCHED_FIFO refused (cure); also refused: cpu_dma_latency"
    text = (process + Report((fifo,))).warning()
    assert text == "real time with reservations: cpu_dma_latency refused (why)", text
    assert Report((fifo,)).warning() == "" and Report((fifo,)).is_realtime
    assert Report(()).warning() == "" and not Report(()).is_realtime

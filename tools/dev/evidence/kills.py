"""The kill matrix: any process of a paced run is killed, stopped or slowed down at any moment.

    KILL   kill -9                       STOP   SIGSTOP, SIGCONT after 20 to 600 ms
    TERM   SIGTERM                       SLOW   both in quick turns for half a second
    BORN   kill -9 of the recorder within 50 ms of its start, before the nodes' first cycles

Of each: how long the plant had a command that was neither fresh nor safe, and whether the last one
is safe; whether the log opens and what it lacks; what is left behind; whether the next run on the
bus ends well. What the nodes did is read from their memory, which stays mapped here when they die.

    exposed    cycles in a row of a node in HOLD, FAULT or STOP whose command is not its safe value
    limit      fault_after_cycles + ramp_s/T: the watchdog and its ramp

While a node is stopped its own cycles do not count: its peer's do. A killed node is not judged by
its last command, nor is a plant that was asked to end: the emulator takes its plant with it. What a
plant was told when a run ended in order is the last command frame in its memory.
"""

import math
import os
import random
import select
import signal
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcpc.drivers.can import choice
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.dev.evidence.aftermath import NodeAftermath, leftovers, log_losses, node_run
from pcpc.tools.start import rigs
from pcpc.tools.start.children import Child
from pcpc.tools.start.folder import LOG
from pcpc.tools.start.pool import each
from pcpc.tools.study.binomial import lower_bound
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.progress import Progress

PROCESSES = ("host", "executive", "plant", "recorder")
SIGNALS = ("KILL", "TERM", "STOP", "SLOW")
CASES = (*product(SIGNALS, PROCESSES), ("BORN", "recorder"))
CONFIDENCE = 0.95
JOBS = 3  # side by side, each on a bus of its own: they wait more than they work
MOST_MS = 1000.0  # what a kill may cost of a log, see `executive.log.recorder`
_HEADER = ("process", "signals", "runs", "safe", "cycles", "log", "ms p50", "max", "left", "next")
_RIG = """\
base: {base}
rig: kills
duration_s: 30.0
evaluation: {{window_s: [0.0, 30.0]}}
supervisor: {{fault_after_cycles: 20}}
expect: null
require: null
"""
_NEXT = (  # too short for the rig's own limits
    "--pacing", "lockstep", "--set", "duration_s=0.2", "--set", "require=[{always: time.t_s >= 0}]"
)  # fmt: skip
_FIRST, _LAST = 20, 1500  # cycles from which the moments are drawn
_TRIES = 3  # a loaded machine may end a run before its moment
_START_S, _END_S, _LOOK_S = 120.0, 40.0, 0.005  # the first start compiles
_SOON_S, _BORN_S = 0.0005, 0.05
_LET_GO_S = 1.0  # from the end of a process to that of its sockets
_GOES_ON_S = 0.3  # a run that has not ended by then may go on


class Case(NamedTuple):
    """What is done to which process, from which cycle of the executive on."""

    rig: str
    number: int
    process: str
    signal: str
    cycle: int


class EarlyEnd(Exception):
    """A run has ended before its moment came."""


class _Run:
    """A run under way: its processes, as descriptors that name no other one, and their memory."""

    def __init__(self, rig: str, bus: str, folder: Path, born_s: float = math.inf) -> None:
        """`born_s`: kill the recorder so long after it was seen first."""
        self.host = Child.started("host", "pcpc.tools.cli", _words(rig, bus, folder))
        self.pids: dict[str, int] = {}
        self.nodes: dict[str, Live] = {}
        self._note("host", self.host.process.pid)
        end_s = time.monotonic() + _START_S
        while len(self.pids) < len(PROCESSES):
            if self.host.ended or time.monotonic() > end_s:
                self.__exit__()
                raise EarlyEnd("\n".join(self.host.complaint()))
            self._look(bus)
            if "recorder" in self.pids and born_s < math.inf:
                time.sleep(born_s)
                self.send("recorder", signal.SIGKILL)
                born_s = math.inf
            time.sleep(_LOOK_S if born_s == math.inf else _SOON_S)

    def _note(self, name: str, pid: int) -> None:
        with suppress(ProcessLookupError):
            self.pids[name] = os.pidfd_open(pid)

    def _look(self, bus: str) -> None:
        """Note what has appeared since."""
        children = Path(f"/proc/{self.host.process.pid}/task/{self.host.process.pid}/children")
        with suppress(OSError):
            for pid in map(int, children.read_text().split()):
                name = Path(f"/proc/{pid}/comm").read_text().strip()
                if name == "pcpc recorder" and "recorder" not in self.pids:
                    self._note("recorder", pid)
        for role in ("executive", "plant"):
            if role not in self.nodes:
                with suppress(sh.SharedError):
                    node = Live(sharing.attach(sh.block_name("kills", bus, role)))
                    self.nodes[role] = node
                    self._note(role, node.pid)

    def wait_for(self, cycle: int) -> None:
        """Wait for a cycle, and until the recorder has the nodes: before, there is no log."""
        nodes = self.nodes.values()
        self.nodes["executive"].wait_until(
            lambda now: now.cycle >= cycle and all(node.recorded for node in nodes), _START_S
        )

    def send(self, name: str, number: int) -> None:
        """Send a signal to a process, if it is still there."""
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self.pids[name], number)

    def left(self, within_s: float) -> list[str]:
        """Wait for the end of all processes; return which of them live on."""
        there, end_s = dict(self.pids), time.monotonic() + within_s
        while there and time.monotonic() < end_s:
            over, _, _ = select.select(list(there.values()), [], [], end_s - time.monotonic())
            there = {name: pid for name, pid in there.items() if pid not in over}
        return list(there)

    def __enter__(self) -> "_Run":
        return self

    def __exit__(self, *_: object) -> None:
        """End whatever lives on."""
        for name in self.pids:
            self.send(name, signal.SIGKILL)
        self.host.end(_END_S)
        for pid in self.pids.values():
            os.close(pid)


def run(
    kills: int = 100, seed: int = 1, jobs: int = JOBS, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Disturb `kills` runs, `jobs` side by side; return a row for each. RigError, PoolError."""
    with tempfile.TemporaryDirectory(prefix="pcpc-kills-") as folder:
        rig = Path(folder) / "kills.yaml"
        rig.write_text(_RIG.format(base=Path(rigs.find("hull")).resolve()), encoding="utf-8")
        cases = [
            Case(
                str(rig),
                i,
                CASES[i % len(CASES)][1],
                CASES[i % len(CASES)][0],
                random.Random(f"{seed}/{i}").randint(_FIRST, _LAST),
            )
            for i in range(kills)
        ]
        return each(disturb, cases, progress or Progress(quiet=True), jobs)


def disturb(case: Case) -> dict[str, Any]:
    """Run a case, again if its run ended by itself before; return its row."""
    said = ""
    for tries in range(1, _TRIES + 1):
        held = choice.take_bus(choice.BusRequest("auto", None, "kills", ()))
        try:
            bus = str(held.bus)
            return case._asdict() | {"tries": tries, "bus": bus} | _killed_run(case, bus, tries)
        except EarlyEnd as error:
            said = str(error)
        finally:
            held.release()
    return case._asdict() | {"tries": _TRIES, "ok": False, "wrong": f"never got there: {said}"}


def _killed_run(case: Case, bus: str, tries: int) -> dict[str, Any]:
    folder = Path(case.rig).parent / f"{case.number}-{tries}"
    born = case.signal == "BORN"
    born_s = random.Random(case.cycle).uniform(0.0, _BORN_S) if born else math.inf
    with _Run(case.rig, bus, folder, born_s) as process:
        try:
            if not born:
                process.wait_for(case.cycle)
        except LiveError as error:
            raise EarlyEnd(str(error)) from None
        at = {role: int(node.block.control.cycle) for role, node in process.nodes.items()}
        if not born:
            _act(process, case)
        left = process.left(_END_S)
        end_s = time.monotonic() + _LET_GO_S
        while (names := leftovers(bus)) and time.monotonic() < end_s:
            time.sleep(_LOOK_S)
        seen = {role: node_run(node, case.rig, role) for role, node in process.nodes.items()}
    row: dict[str, Any] = {
        "signal": case.signal,
        "at": at["executive"],
        "left": left + names,
    } | _node_columns(seen, case)
    row |= log_losses(folder / LOG, seen, at if case.process == "recorder" else {})
    words = [*_words(case.rig, bus, f"{folder}-next"), *_NEXT]
    following = Child.started("next", "pcpc.tools.cli", words)
    following.end(_START_S)
    row["next"] = following.code
    wrong = failures_of(row)
    return row | {"ok": not wrong, "wrong": "; ".join(wrong)}


def _words(rig: str, bus: str, folder: Path | str) -> list[str]:
    return ["run", rig, "--bus", bus, "-o", str(folder), "--quiet", "--no-figure"]


def _act(process: _Run, case: Case) -> None:
    """Do what the case says; end a run that goes on all the same."""
    if case.signal in ("KILL", "TERM"):
        process.send(case.process, signal.Signals[f"SIG{case.signal}"])
        return
    draw = random.Random(f"{case.number} {case.cycle}")
    turns, longest_s = (1, 0.6) if case.signal == "STOP" else (25, 0.03)
    for _ in range(turns):
        process.send(case.process, signal.SIGSTOP)
        time.sleep(draw.uniform(0.02 if turns == 1 else 0.001, longest_s))
        process.send(case.process, signal.SIGCONT)
        time.sleep(draw.uniform(0.001, 0.01))
    if "host" in process.left(_GOES_ON_S):
        process.send("host", signal.SIGTERM)


def _node_columns(seen: Mapping[str, NodeAftermath], case: Case) -> dict[str, Any]:
    """Return for how long commands were neither fresh nor safe, and how they were at the end."""
    gone = case.process if case.signal in ("KILL", "BORN") else ""
    return {
        "exposed": {role: one.exposed for role, one in seen.items()},
        "limit": max(one.limit for one in seen.values()),
        "state": {role: one.state for role, one in seen.items()},
        "fault": {role: one.fault for role, one in seen.items()},
        "unsafe": [role for role, one in seen.items() if not one.safe and role != gone],
    }


def failures_of(row: Mapping[str, Any]) -> list[str]:
    """Return what is not as it should be after a run was disturbed."""
    found = [f"{role} ended with a command that is not safe" for role in row["unsafe"]]
    found += [
        f"{role} had no safe command for {n} cycles, the limit is {row['limit']}"
        for role, n in row["exposed"].items()
        if n > row["limit"]
    ]
    if not row["opens"] and row["signal"] != "BORN":
        found.append(f"the log does not open: {row['why']}")
    elif row["opens"] and (row["missing_ms"] > MOST_MS or row["holes"]):
        found.append(f"the log lacks {row['missing_ms']:.0f} ms and {row['holes']} cycles before")
    found += [f"left behind: {name}" for name in row["left"]]
    return found + [f"the next run ended with {row['next']}"] * (row["next"] != 0)


def table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return how many runs of each process and signal ended well; equal ones share a line."""
    names: dict[tuple[str, ...], list[str]] = {}
    for name, process in sorted(CASES, key=lambda case: PROCESSES.index(case[1])):
        some = [row for row in rows if (row["process"], row["signal"]) == (process, name)]
        if some:
            names.setdefault((process, *_figures(some)), []).append(name)
    cells = [(process, " ".join(some), *counts) for (process, *counts), some in names.items()]
    return screen.table([_HEADER, *cells], right=range(2, len(_HEADER)))


def safe_of(rows: Sequence[Mapping[str, Any]]) -> tuple[int, float]:
    """Return how many runs stayed safe, and the lower bound of their share."""
    done = [row for row in rows if "at" in row]
    safe = sum(not row["unsafe"] and max(row["exposed"].values()) <= row["limit"] for row in done)
    return safe, lower_bound(safe, len(rows), CONFIDENCE)


def _figures(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the figures of one line of the table."""
    done = [row for row in rows if "at" in row]  # the others never got to their moment
    missing = [row["missing_ms"] for row in done if row["opens"]]
    return [
        str(len(rows)), str(safe_of(rows)[0]),
        str(max((max(row["exposed"].values()) for row in done), default=0)),
        str(len(missing)),
        *(f"{figure(missing):.0f}" if missing else "" for figure in (np.median, max)),
        str(sum(bool(row["left"]) for row in done)), str(sum(row["next"] == 0 for row in done)),
    ]  # fmt: skip

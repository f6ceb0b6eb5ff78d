"""Run after run on a clock with other seeds, tunings and faults, for hours; each log is judged.

    python -m pcpc.tools.dev.evidence.soak RIG [--hours H]

A run lasts `each_s`: every few seconds a parameter of each node is tuned, a fault begun, a node in
FAULT reset; one of three is stopped or interrupted at a drawn moment, and the next one starts. One
that nobody asked to end comes to its last cycle, also in FAULT. What else has to hold in each log:
`evidence.invariants`. Runs in virtual time are those of `pcpc swarm --rig`.

The memory of host, nodes and recorder (RSS) is looked at every second. A run that lasts
has to end with what it held when it had settled, within 2 %.
"""

import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.injecting import faults_of, inject
from pcpc.executive.nodes.live import Live, running
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import ROLES
from pcpc.tools.dev import command as command_of_repository
from pcpc.tools.dev.evidence.invariants import broken_promises
from pcpc.tools.dev.evidence.options import SOAK, SoakRequest
from pcpc.tools.start import rigs
from pcpc.tools.start.children import Child
from pcpc.tools.start.folder import LOG, run_folder
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import Count, Positive
from pcpc.tools.terminal.progress import Progress

_FACTORS = 0.8, 1.25  # of a tuning, within the parameter's range
_MOST = 3
_OWN = {"timing", "supervisor", "fault"}  # parameters of the loop itself
_ENDS = Exit.OK, Exit.NOT_MET, Exit.LOSS, Exit.SAFETY_STOP, Exit.INTERRUPTED
_LOOK_S, _SAMPLE_S, _CHANGE_S, _JUDGE_S = 0.02, 1.0, 3.0, 1200.0
_SETTLED, _GROWS = 30, 1.02  # samples until all rings have been written once; of the memory
_FEW = 30  # samples after that: fewer tell nothing
_STALL_S = 1.0  # of the machine, in which the last cycles are skipped


class SoakRow(TypedDict):
    """A line of JSON for each run."""

    run: Count
    "number"
    faults: Count
    "on purpose"
    resets: Count
    tuned: Count
    "parameters"
    wrong: list[str]
    "in words; empty: nothing"
    cycles: Count
    "of all nodes"
    settled: dict[str, tuple[Positive, Positive]]
    "memory of each process once it had settled and at the end, kB; empty: it did not last"


def command(request: SoakRequest) -> int:
    """Run for the time asked for; print what was wrong; NOT_MET if anything was."""
    rig, progress = rigs.find(request.rig), Progress(request.quiet)
    rows: list[SoakRow] = []
    begin_s, spent_s, wanted_s = time.monotonic(), 0.0, 3600.0 * request.hours
    while not rows or spent_s < wanted_s:
        each_s = min(request.each_s, wanted_s - spent_s)
        rows.append(judged_run(rig, request.seed, len(rows), each_s))
        spent_s = time.monotonic() - begin_s
        if request.json:
            print(json.dumps(rows[-1]), flush=True)
        for line in rows[-1]["wrong"]:
            progress.say(f"run {len(rows) - 1}: {line}")
        wrong = sum(bool(row["wrong"]) for row in rows)
        spent = f"{spent_s / 3600.0:.2f} h of {request.hours:g}"
        progress.show(f"run {len(rows)}, {spent}, {wrong} with errors")
    progress.close()
    if not request.json:
        print("\n".join(summary_lines(rows)))
    return Exit.NOT_MET if any(row["wrong"] for row in rows) else Exit.OK


def summary_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return how much was done, the memory of each process at its worst, and what was wrong."""
    sums = {key: sum(row[key] for row in rows) for key in ("cycles", "tuned", "faults", "resets")}
    lines = [
        f"{len(rows)} runs, {sums['cycles']:,} cycles",
        f"{sums['tuned']} tunings, {sums['faults']} faults on purpose, {sums['resets']} resets",
    ]
    settled = [row["settled"] for row in rows if row["settled"]]
    cells = [("process", "RSS [kB] settled", "at the end", "change")]
    for name in sorted({name for one in settled for name in one}):
        first, last = max((one[name] for one in settled if name in one), key=lambda x: x[1] / x[0])
        cells.append((name, f"{first:,}", f"{last:,}", f"{100.0 * (last / first - 1.0):+.2f} %"))
    short = ["no run lasted long enough to tell whether its memory grows"]
    lines += screen.table(cells, right=(1, 2, 3)) if settled else short
    return lines + [f"run {row['run']}: {line}" for row in rows for line in row["wrong"]]


def judged_run(rig: str, seed: int, number: int, each_s: float) -> SoakRow:
    """Do a run and judge its log; return its row."""
    draw, loaded = random.Random(f"{seed}/{number}"), load_rig(rig)
    settings: dict[str, Any] = tunings(loaded, draw)
    row: SoakRow = {
        "run": number, "faults": 0, "resets": 0, "tuned": len(settings),
        "wrong": [], "cycles": 0, "settled": {},
    }  # fmt: skip
    memory = dict[str, list[int]]()
    settings["seed"] = draw.randint(1, 10**6)
    settings |= {"duration_s": max(each_s, loaded.config.duration_s)}
    settings |= {"supervisor.on_fault": "wait"}
    with tempfile.TemporaryDirectory(prefix="pcpc-soak-") as folder:
        words = ["run", rig, "-o", f"{folder}/run", "--quiet", "--pacing", "real", "--no-figure"]
        words += [f"--set={name}={x}" for name, x in settings.items()]
        child = Child.started("run", "pcpc.tools.cli", words)
        asked = _disturb(child, loaded.config.rig, draw, row, memory, settings["duration_s"])
        child.end(_JUDGE_S)
        row["wrong"] = [] if child.code in _ENDS else [f"exit {child.code}", *child.complaint()]
        row["cycles"], wrong = broken_promises(Path(folder) / "run" / LOG, loaded)
        if not asked:
            wrong += early_end(Path(folder) / "run", settings["duration_s"])
        row["settled"] = settled_memory(memory)
        row["wrong"] += wrong + growing_memory(row["settled"])
        if row["wrong"] and (Path(folder) / "run").is_dir():
            row["wrong"].append(f"its log: {_kept_folder(Path(folder) / 'run', loaded)}")
    return row


def early_end(run: Path, for_s: float) -> list[str]:
    """Return that a run which waits in FAULT ended before its last cycle though nobody asked."""
    if not (run / "summary.json").is_file():
        return []  # it came to none, and its exit code is told
    summary = json.loads((run / "summary.json").read_text())
    done_s = summary["cycles"] / summary["rate_hz"]
    if done_s > for_s - _STALL_S:
        return []
    return [f"ended by itself after {done_s:.3f} of {for_s:g} s", *summary["faults"]]


def _kept_folder(run: Path, rig: Rig) -> Path:
    """Move a run's folder to those of other runs; return where it is."""
    with run_folder(None, rig) as folder:
        shutil.copytree(run, folder, dirs_exist_ok=True)
    return folder


def tunings(rig: Rig, draw: random.Random) -> dict[str, float]:
    """Return other values for some parameters of the controller, within their ranges."""
    made = plan(rig, "executive", "virtual")
    known = {
        v.name: v
        for v in made.table.variables
        if v.kind == "parameter"
        and v.name.startswith("controller.")
        and made.values.get(made.table.index[v.name])
    }
    chosen = draw.sample(sorted(known), min(_MOST, len(known)))
    drawn = {name: made.values[made.table.index[name]] * draw.uniform(*_FACTORS) for name in chosen}
    return {name: min(max(x, known[name].low), known[name].high) for name, x in drawn.items()}


def _disturb(
    child: Child,
    name: str,
    draw: random.Random,
    row: SoakRow,
    memory: dict[str, list[int]],
    for_s: float,
) -> bool:
    """Note the memory of a paced run under way, tune it, begin its faults; True if ended early."""
    nodes = _nodes(child, name)
    begin_s = next_s = time.monotonic()
    ends_s = begin_s + for_s * draw.uniform(0.3, 1.0) if draw.random() < 1.0 / 3.0 else np.inf
    asked = False
    while not child.ended:
        if any(node.running for node in nodes):  # not while the host judges
            for key, size in _memory_kb(child.process.pid).items():
                memory.setdefault(key, []).append(size)
        with suppress(LiveError, UserError):  # the run may end in between
            if time.monotonic() >= next_s:
                next_s += draw.expovariate(1.0 / _CHANGE_S)
                _change(nodes, draw, row)
            if time.monotonic() >= ends_s:
                ends_s, asked = np.inf, True
                _end(child, nodes, draw)
        with suppress(subprocess.TimeoutExpired):
            child.process.wait(min(_SAMPLE_S, max(next_s - time.monotonic(), _LOOK_S)))
    return asked


def _nodes(child: Child, name: str) -> list[Live]:
    """Wait for the nodes of a run; return them, the lowest first."""
    found: list[Live] = []
    while not child.ended and not any(node.under_way for node in found):
        pid = child.process.pid
        found = [node for node in running(name).values() if _status(node.pid, "PPid") == pid]
        time.sleep(_LOOK_S)
    return sorted(found, key=lambda node: -ROLES.index(node.name.rpartition(".")[2]))


def _change(nodes: Sequence[Live], draw: random.Random, row: SoakRow) -> None:
    for node in nodes:
        if node["supervisor.state"] == State.FAULT:
            with suppress(LiveError):  # its ramp is not over, its cause is still there
                node.tune({"supervisor.reset": 1.0})
                row["resets"] += 1
        for change, value in _live(node, draw).items():
            node.tune({change: value})
            row["tuned"] += 1
    known = faults_of(nodes)
    if known:
        inject(nodes, draw.choice(known).name, for_s=draw.uniform(0.001, 0.1))
        row["faults"] += 1


def _end(child: Child, nodes: Sequence[Live], draw: random.Random) -> None:
    """Stop a run by the executive, at once or by its ramp, or by a signal to its host."""
    how = draw.randint(0, 2)
    if how:
        nodes[-1].tune({"supervisor.stop": float(how)})
    else:
        child.process.send_signal(signal.SIGTERM)


def _memory_kb(host: int) -> dict[str, int]:
    """Return the memory, kB, that the processes of a run hold, by name."""
    found = {"host": _status(host, "VmRSS")}
    with suppress(OSError):
        for pid in Path(f"/proc/{host}/task/{host}/children").read_text().split():
            name = Path(f"/proc/{pid}/comm").read_text().split()[-1]
            found[name] = _status(int(pid), "VmRSS")
    return {name: size for name, size in found.items() if size}


def settled_memory(memory: Mapping[str, Sequence[int]]) -> dict[str, tuple[int, int]]:
    """Return what each process of a run that lasted held when it had settled, and at its end."""
    found = {}
    for name, sizes in memory.items():
        sizes = sizes[_SETTLED:]
        part = len(sizes) // 10
        if len(sizes) >= _FEW:
            found[name] = int(np.median(sizes[:part])), int(np.median(sizes[-part:]))
    return found


def growing_memory(held: Mapping[str, tuple[int, int]]) -> list[str]:
    """Return which processes ended with more memory than they had settled with."""
    return [
        f"{name}: {first:,} kB once it had settled, {last:,} kB at the end"
        for name, (first, last) in held.items()
        if last > _GROWS * first
    ]


def _status(pid: int, key: str) -> int:
    """Return a number that the system tells of a process; 0 of one that is gone."""
    with suppress(OSError):
        words = Path(f"/proc/{pid}/status").read_text().partition(f"{key}:")[2].split()
        return int(words[0]) if words else 0
    return 0


def _live(node: Live, draw: random.Random) -> dict[str, float]:
    """Return another value for one parameter of a law in a node that runs."""
    now = node.read()
    known = {
        name: one.range
        for name, one in node.variables.items()
        if one.range and now[name] and name.partition(".")[0] not in _OWN
    }
    if not known:
        return {}
    name = draw.choice(sorted(known))
    low, high = known[name]
    return {name: min(max(now[name] * draw.uniform(*_FACTORS), low), high)}


if __name__ == "__main__":
    sys.exit(command_of_repository.main(SOAK, sys.argv[1:], own=True))

"""Soak: run after run of a rig with other seeds, tunings and faults, for hours; each log is judged.

Every second run is in virtual time, the others are on a clock, with tunings and faults of the rig's
own `faults:` begun while they run. Of each log, whatever became of the run:

    whole       nothing missing, nothing dropped, no frame of which nobody knows
    limits      every command within its bounds and its rate in every cycle
    safe        commands are their safe value in INIT, and never rise again in a row of FAULT
    replay      `pcpc replay` gives the same bits

On a clock the memory that the nodes hold is taken in the middle; that of the last tenth of the runs
must not be more than 2 % above that of the first.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.supervisor import FAULT, INIT
from pcpc.executive.nodes.injecting import faults_of, inject
from pcpc.executive.nodes.live import Live, LiveError, running
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools import rigs
from pcpc.tools.console.progress import Progress
from pcpc.tools.starting.children import Child
from pcpc.tools.starting.folder import LOG

_FACTORS = 0.8, 1.25  # of a tuning, within the parameter's range
_MOST, _GROWS = 3, 1.02
_OWN = {"timing", "supervisor", "fault"}  # parameters of the loop itself
_LOOK_S, _RUN_S = 0.02, 600.0
_ENDS = Exit.OK, Exit.NOT_MET, Exit.LOSS, Exit.SAFETY_STOP  # how a disturbed run may end


def command(options: argparse.Namespace) -> int:
    """Run for the time asked for; print what was wrong; NOT_MET if anything was."""
    rig, progress = rigs.find(options.rig), Progress()
    rows: list[dict[str, Any]] = []
    begin_s, spent_h = time.monotonic(), 0.0
    while not rows or (spent_h := (time.monotonic() - begin_s) / 3600.0) < options.hours:
        rows.append(one(rig, options.seed, len(rows)))
        wrong = sum(bool(row["wrong"]) for row in rows)
        progress.show(f"run {len(rows)}, {spent_h:.2f} h of {options.hours:g}, {wrong} with errors")
    progress.close()
    grown = growth(rows)
    cycles = sum(row["cycles"] for row in rows)
    print(f"{len(rows)} runs, {cycles:,} cycles, {sum(row['tuned'] for row in rows)} tunings, "
          f"{sum(row['faults'] for row in rows)} faults on purpose")  # fmt: skip
    wrongs = [f"run {row['run']}: {line}" for row in rows for line in row["wrong"]]
    print("".join(f"{line}\n" for line in (*wrongs, *grown)), end="")
    return Exit.NOT_MET if grown or wrongs else Exit.OK


def one(rig: str, seed: int, number: int) -> dict[str, Any]:
    """Do a run and judge its log; return its row."""
    draw = random.Random(f"{seed}/{number}")
    row: dict[str, Any] = {"run": number, "tuned": 0, "faults": 0, "rss_kb": {}, "cycles": 0}
    paced = number % 2 == 1
    with tempfile.TemporaryDirectory(prefix="pcpc-soak-") as folder:
        loaded = load_rig(rig)
        settings = tunings(loaded, draw) | {"seed": draw.randint(1, 10**6)}
        row["tuned"] = len(settings) - 1
        words = ["run" if paced else "simulate", rig, "-o", f"{folder}/run", "--quiet"]
        words += ["--no-figure", *(f"--set={name}={x!r}" for name, x in settings.items())]
        child = Child.started("run", "pcpc.tools.cli", words)
        if paced:
            _disturb(child, loaded.config.rig, draw, row)
        child.end(loaded.config.duration_s + _RUN_S)
        row["wrong"] = [] if child.code in _ENDS else [f"exit {child.code}", *child.complaint()]
        row["wrong"] += judged(Path(folder) / "run" / LOG, row)
    return row


def tunings(rig: Rig, draw: random.Random) -> dict[str, float]:
    """Return other values for some parameters of the controller, within their ranges."""
    made = plan(rig, "executive", "virtual")
    known = {v.name: v for v in made.table.variables
             if v.kind == "parameter" and v.name.startswith("controller.")
             and made.values.get(made.table.index[v.name])}  # fmt: skip
    chosen = draw.sample(sorted(known), min(_MOST, len(known)))
    drawn = {name: made.values[made.table.index[name]] * draw.uniform(*_FACTORS) for name in chosen}
    return {name: min(max(x, known[name].low), known[name].high) for name, x in drawn.items()}


def _disturb(child: Child, name: str, draw: random.Random, row: dict[str, Any]) -> None:
    """Tune a paced run under way, begin its faults, note the memory of its nodes."""
    nodes: dict[str, Live] = {}
    host = child.process.pid
    while not child.ended and not any(node.under_way for node in nodes.values()):
        nodes = {
            key: node for key, node in running(name).items() if _status(node.pid, "PPid") == host
        }
        time.sleep(_LOOK_S)
    with suppress(LiveError, UserError):  # the run may end in between
        for node in nodes.values():
            row["rss_kb"][node.name.rpartition(".")[2]] = _status(node.pid, "VmRSS")
            for change, value in _live(node, draw).items():
                node.tune({change: value})
                row["tuned"] += 1
        known = faults_of(list(nodes.values()))
        for fault in draw.sample(known, min(_MOST, len(known))):
            inject(list(nodes.values()), fault.name, for_s=draw.uniform(0.001, 0.1))
            row["faults"] += 1


def _status(pid: int, key: str) -> int:
    """Return a number that the system tells of a process; 0 of one that is gone."""
    with suppress(OSError):
        return int(Path(f"/proc/{pid}/status").read_text().partition(f"{key}:")[2].split()[0])
    return 0


def _live(node: Live, draw: random.Random) -> dict[str, float]:
    """Return another value for one parameter of a law in a node that runs."""
    now = node.read()
    known = {
        name: one.range for name, one in node.variables.items()
        if one.range and now[name] and name.partition(".")[0] not in _OWN
    }  # fmt: skip
    if not known:
        return {}
    name = draw.choice(sorted(known))
    low, high = known[name]
    return {name: min(max(now[name] * draw.uniform(*_FACTORS), low), high)}


def judged(path: Path, row: dict[str, Any]) -> list[str]:
    """Return what is wrong with a log."""
    try:
        log = logs.read(path)
    except logs.LogError as error:
        return [str(error)]
    lost = [f"{key} {n}" for key, n in log.metadata.get("run", {}).items()
            if key.startswith("dropped.") and n != "0"]  # fmt: skip
    found = [*log.missing, *lost]
    summary = json.loads((path.parent / "summary.json").read_text())
    found += [f"{node}: {account['unread']} frames unread" for node, account in
              summary.get("frames_to", {}).items() if account.get("unread", 0) < 0]  # fmt: skip
    rig = load_rig(path.name, text=log.attachments["rig-resolved.yaml"])
    for role, node in log.node.items():
        row["cycles"] += len(node.cycle)
        found += [f"{role}: {line}" for line in commands(rig, role, node)]
    words = [sys.executable, "-P", "-m", "pcpc.tools.cli", "replay", str(path), "--quiet"]
    replayed = subprocess.run(words, capture_output=True, text=True)
    return found + [f"replay: {replayed.stdout}{replayed.stderr}"] * (replayed.returncode != 0)


def commands(rig: Rig, role: Any, node: logs.Node) -> Iterator[str]:
    """Yield where a command of a node left its bounds or its rate, or was not safe."""
    state = node.columns["supervisor.state"]
    for name, limit in plan(rig, role, "virtual").limits.items():
        sent, safe = node.columns[f"tx.{name}"], limit.safe or 0.0
        if not ((sent >= limit.low) & (sent <= limit.high)).all():
            yield f"{name} was beyond its bounds"
        if limit.rate_per_s is not None:
            most = limit.rate_per_s / rig.config.rate_hz * (1.0 + 1e-9)
            if (np.abs(np.diff(sent)) > most * np.diff(node.cycle)).any():
                yield f"{name} was faster than its rate"
        if (sent[state == INIT] != safe).any():
            yield f"{name} was not safe in INIT"
        ramps = (state[1:] == FAULT) & (state[:-1] == FAULT)
        if (np.diff(np.abs(sent - safe))[ramps] > 0.0).any():
            yield f"{name} rose in FAULT"


def growth(rows: list[dict[str, Any]]) -> list[str]:
    """Return which process needed more memory in the last tenth of the runs than in the first."""
    found = []
    held = [row["rss_kb"] for row in rows if row["rss_kb"]]
    part = max(1, len(held) // 10)
    for role in ("executive", "plant"):
        first, last = (np.mean([row[role] for row in some if role in row] or [0.0])
                       for some in (held[:part], held[-part:]))  # fmt: skip
        if last > _GROWS * first:
            found.append(f"{role}: {first:.0f} kB in the first runs, {last:.0f} kB in the last")
    return found

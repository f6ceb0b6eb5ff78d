"""What holds in the log of any run, whatever became of it: promises, and where one is broken.

whole       nothing missing, nothing dropped, no frame of which nobody knows
limits      every command within its bounds and its rate in every cycle
safe        commands are their safe value in INIT, and never rise again in a row of FAULT
replay      `pcpc replay` gives the same bits
tidy        no claim of its nodes is left
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import Rig
from pcpc.tools.dev.evidence.aftermath import leftovers


def broken_promises(path: Path, rig: Rig) -> tuple[int, list[str]]:
    """Return how many cycles a log of `rig` has, and what is wrong with it."""
    try:
        log = long_logs.read(path)
    except logs.LogError as error:
        return 0, [str(error)]
    lost = [
        f"{key} {n}"
        for key, n in log.metadata.get("run", {}).items()
        if key.startswith("dropped.") and n != "0"
    ]
    found = [*log.missing, *lost]
    summary = json.loads((path.parent / "summary.json").read_text())
    found += [
        f"{node}: {account['unread']} frames unread"
        for node, account in summary.get("frames_to", {}).items()
        if account.get("unread", 0) < 0
    ]
    own = (f"/{rig.config.rig}.", f"/{rig.config.rig}/")  # others may have taken the bus since
    found += [
        f"left behind: {name}"
        for name in leftovers(summary.get("bus") or "none")
        if any(part in name for part in own)
    ]
    for role, node in log.node.items():
        found += [f"{role}: {line}" for line in commands(rig, role, node)]
    words = [sys.executable, "-P", "-m", "pcpc.tools.cli", "replay", str(path), "--quiet"]
    replayed = subprocess.run(words, capture_output=True, text=True)
    found += [f"replay: {replayed.stdout}{replayed.stderr}"] * (replayed.returncode != 0)
    return sum(len(node.cycle) for node in log.node.values()), found


def commands(rig: Rig, role: Any, node: logs.NodeLog) -> Iterator[str]:
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
        if (sent[state == State.INIT] != safe).any():
            yield f"{name} was not safe in INIT"
        ramps = (state[1:] == State.FAULT) & (state[:-1] == State.FAULT)
        if (np.diff(np.abs(sent - safe))[ramps] > 0.0).any():
            yield f"{name} rose in FAULT"

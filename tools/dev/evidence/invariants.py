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
from pathlib import Path

from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import Rig
from pcpc.tools.dev.evidence.aftermath import leftovers
from pcpc.tools.study.swarm.promises import broken_limits


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
        found += [f"{role}: {line}" for line in broken_limits(rig, role, node)]
    words = [sys.executable, "-P", "-m", "pcpc.tools.cli", "replay", str(path), "--quiet"]
    replayed = subprocess.run(words, capture_output=True, text=True)
    found += [f"replay: {replayed.stdout}{replayed.stderr}"] * (replayed.returncode != 0)
    return sum(len(node.cycle) for node in log.node.values()), found

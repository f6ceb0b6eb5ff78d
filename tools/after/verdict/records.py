"""What a run's log should have: cycles, rows and nodes, and that it is the log of this run."""

import re

from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.requirements import LEADER


def missing_lines(executive: logs.NodeLog | None, log: logs.Log, outcome: Outcome) -> list[str]:
    """Return what the log should have and has not."""
    absent = [f"{name}: not in the log" for name in outcome.nodes if name not in log.node]
    replaced = _replacement_lines(executive, log, outcome)
    return [*log.missing, *absent, *replaced, *outcome.missing]


def records(rig: Rig, log: logs.Log, outcome: Outcome) -> dict[str, int | bool]:
    """Return how many cycles are in the log, and rows that are not."""
    kept_back = {"kept_back": True} if rig.config.record.keep is not None else {}
    counts = {"written": _recorded_cycles(log, outcome), "dropped": dropped_rows(log, outcome)}
    return {**counts, **kept_back}


def _replacement_lines(
    executive: logs.NodeLog | None, log: logs.Log, outcome: Outcome
) -> list[str]:
    """Return a line if the log was replaced: by one from before the command, or paced otherwise."""
    if executive is None or outcome.begin_ns is None:
        return []
    paced = log.metadata.get(LEADER, {}).get("pacing", outcome.pacing)
    before = outcome.pacing not in WITHOUT_CLOCK and executive.stamp_ns[0] < outcome.begin_ns
    other = bool(paced != outcome.pacing or before)
    return ["the log is that of another run: it was replaced while this one went on"] * other


def dropped_rows(log: logs.Log, outcome: Outcome) -> int:
    """Return the rows that found a ring full: as the recorder counted, if it came to its end."""
    counts = {k: int(v) for k, v in log.metadata.get("run", {}).items() if k.startswith("dropped.")}
    return max(sum(counts.values()), outcome.dropped)


def _recorded_cycles(log: logs.Log, outcome: Outcome) -> int:
    """Return the cycles in the log: as the recorder counted, if it came to its end."""
    run = log.metadata.get("run", {})
    counts = [int(n) for k, n in run.items() if re.fullmatch(r"written\..*\.record", k)]
    if counts and run.get("discarded", "0") == "0":
        return sum(counts)
    kept = outcome.kept or {name: len(node.cycle) for name, node in log.node.items()}
    return sum(kept.values())

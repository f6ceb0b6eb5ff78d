"""The replay of a log in this process, for tests of runs that are recomputed from their logs."""

from pathlib import Path

from pcpc.tools.after.opened import Opened
from pcpc.tools.after.replay import Verdict, replay
from pcpc.tools.terminal.progress import Progress


def replayed(log: Path) -> list[Verdict]:
    """Replay every node of a log; return what came of each."""
    verdicts = list(replay(Opened(log), Progress(quiet=True)))
    assert verdicts, f"{log}: no node is replayed"
    return verdicts

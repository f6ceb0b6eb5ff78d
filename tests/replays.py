"""The replay of a log in this process, for tests of runs that are recomputed from their logs."""

import argparse
from pathlib import Path

from pcpc.tools.after.replay import Verdict, replay
from pcpc.tools.terminal.progress import Progress


def replayed(log: Path) -> list[Verdict]:
    """Replay every node of a log; return what came of each."""
    options = argparse.Namespace(controller=None, set=[], node="all")
    verdicts = list(replay(log, options, Progress(quiet=True)))
    assert verdicts, f"{log}: no node is replayed"
    return verdicts

"""A run in virtual time brought to its end; what came of it goes into its outcome."""

import sys
import time

from pcpc.executive.log.mcap_writer import RecordError
from pcpc.executive.nodes.plan import failures
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.nodes.watched import StepError
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.terminal.progress import Progress


def to_end(run: VirtualRun, outcome: Outcome, progress: Progress, before: int = 0) -> None:
    """Run it with progress and close it; `before`: cycles that are done already."""
    about = run.blocks[0].description
    begin_s, total, period_s = time.monotonic(), about["cycles"], 1e-9 * about["period_ns"]
    try:
        for cycles in run.advance():
            speed = (cycles - before) * period_s / max(time.monotonic() - begin_s, 1e-9)
            progress.show(f"cycle {cycles}/{total}, {speed:.0f} x real time")
    except StepError as error:
        if str(error):
            print(error, file=sys.stderr)
    except RecordError as error:
        outcome.missing.append(str(error))
    progress.close()
    for line in (line for made in run.plans for line in failures(made)):  # while they are open
        print(line, file=sys.stderr)
    try:
        run.close()
    except RecordError as error:
        outcome.missing.append(str(error))
    for block in run.blocks:
        outcome.judge(block.description["node"], 0, block)
    outcome.realtime = None

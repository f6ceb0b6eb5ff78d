"""The end of a run: the log is read back, judged, drawn, and summed up on disk and screen."""

import contextlib
import sys
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.verdict import report, summary_file
from pcpc.tools.after.verdict import summary as summaries
from pcpc.tools.after.verdict.findings import Finding, FindingKind, lines
from pcpc.tools.after.verdict.judge import EvaluationError, Judge
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.start.folder import LOG
from pcpc.tools.terminal.arguments import RunFolder
from pcpc.tools.terminal.outfile import whole_file


def conclude(
    judge: Judge,
    folder: Path,
    outcome: Outcome,
    run_folder: RunFolder,
    judged: long_logs.Wanted,
) -> int:
    """Read the log back, write summary and figure, print; return the exit code of the verdict.

    `judged`: the columns that lie whole beside a log that keeps a part of the run.
    """
    path, drawn = folder / LOG, not run_folder.no_figure
    run = Opened(path)
    full: OSError | None = None
    try:
        try:
            log = run.part(lambda log: judge.needed_columns(log, drawn))
        except OSError as error:  # no space for the columns of a long log
            full, log = error, run.head
        outcome.kept = {name: len(node.cycle) for name, node in log.node.items()}
        log = long_logs.whole_run(log, judged) if judged else log
    except logs.LogError as error:
        return unreadable(outcome, error)
    finally:
        for name in judged:
            with contextlib.suppress(OSError):
                long_logs.sidecar(path, name).unlink()
    summary = summaries.summarise(judge.rig, log, outcome, judge)
    if full is not None:
        summary.note_missing(long_logs.sidecar(path, "columns"), full)
    if drawn:
        figure = folder / summary_file.FIGURE
        try:
            with whole_file(figure) as unfinished:
                summary.enter(*_figure(judge, log, summary, unfinished))
                if not unfinished.stat().st_size:
                    unfinished.unlink()
        except OSError as error:
            summary.note_missing(figure, error)
    return publish(summary, folder, run_folder)


def unreadable(outcome: Outcome, error: logs.LogError) -> int:
    """Say why there is nothing to judge; return the exit code."""
    if outcome.interrupted:
        print("interrupted before anything was recorded", file=sys.stderr)
        return Exit.INTERRUPTED
    why = outcome.missing or [str(error)]  # of a log that could not be written nothing else is true
    print(*outcome.faults, *why, sep="\n", file=sys.stderr)
    return Exit.SAFETY_STOP if outcome.faults else Exit.LOSS


def publish(summary: summaries.Summary, folder: Path, run_folder: RunFolder) -> int:
    """Write the summary, print it; return the exit code of its verdict."""
    text = summary_file.write_json(summary, folder / summary_file.NAME)
    if run_folder.json:
        print(text)
    else:
        report.show(summary, folder, quiet=run_folder.quiet)
    return summaries.CODES[summary.verdict]


def _figure(judge: Judge, log: logs.Log, summary: summaries.Summary, path: Path) -> list[Finding]:
    """Draw the run; return what is wrong with the evaluation's figure."""
    try:
        reason = judge.draw(log, summary.metrics, path, summary.requirements, summary.changed)
    except EvaluationError as error:
        return lines(FindingKind.EVALUATION, [f"no figure: {error}"])
    if reason:
        print(f"no figure: {reason}", file=sys.stderr)
    return []

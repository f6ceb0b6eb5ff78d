"""Runs that were recorded: two of them, or all runs of two folders, see `pairing`."""

from pathlib import Path

from pcpc.drivers.errors import UserError
from pcpc.tools.after.compare.comparison import Comparison
from pcpc.tools.after.compare.overlay import Criteria, compared_pair
from pcpc.tools.after.compare.pair import ALONE, FAILED, Pair, Side
from pcpc.tools.after.compare.pairing import Recorded, holds_runs, partners, recorded_runs
from pcpc.tools.after.differences import Change
from pcpc.tools.after.log.recorded import log_of
from pcpc.tools.after.log.series import LARGE_BYTES
from pcpc.tools.after.record import Run
from pcpc.tools.terminal.progress import Progress


def recorded_comparison(old: str, new: str, how: Criteria, progress: Progress) -> Comparison:
    """Compare two runs, or all runs of two folders."""
    comparison = Comparison(old, new)
    if not any(holds_runs(Path(text)) for text in (old, new)):
        logs_of = log_of(old), log_of(new)
        if sum(log.stat().st_size for log in logs_of if log.is_file()) > LARGE_BYTES:
            progress.show(f"reading {old} and {new}")
        comparison.pairs.append(compared_pair(*logs_of, how))
        progress.close()
        return comparison

    def unreadable(path: Path, why: str) -> None:
        comparison.pairs.append(Pair(str(path), "", FAILED, [why]))

    together = list(partners(*(recorded_runs(text, unreadable) for text in (old, new))))
    for number, (old_run, new_run) in enumerate(together, 1):
        run = old_run or new_run
        assert run is not None, "a pair has a run"
        progress.show(f"comparing {number}/{len(together)}: {', '.join(filter(None, run.key))}")
        if old_run is not None and new_run is not None:
            comparison.pairs.append(_pair(old_run, new_run, how))
        else:
            comparison.pairs.append(_alone(run, "new" if old_run is None else "old"))
    progress.close()
    return comparison


def _pair(old: Recorded, new: Recorded, how: Criteria) -> Pair:
    try:
        return compared_pair(old.path, new.path, how)
    except (OSError, UserError) as error:
        return Pair(*old.key[:2], FAILED, [str(error)], str(old.path), str(new.path))


def _alone(run: Recorded, side: Side) -> Pair:
    """Return what is known of a run without a partner, its verdict too."""
    told = [f"only in {side}: {run.path}", *[run.key[2]] * bool(run.key[2])]
    pair = Pair(*run.key[:2], ALONE, told, side=side)
    try:
        result = Run(run.path).result
        verdict, reasons = result.verdict, result.problems()
    except (OSError, UserError, ValueError) as error:
        verdict, reasons = "not judged", [str(error)]
    pair.verdict = Change("verdict", *((verdict, "") if side == "old" else ("", verdict)))
    pair.said += [f"verdict {verdict}", *reasons]
    return pair

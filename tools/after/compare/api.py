"""`pcpc.compare`: what two runs differ in, as an object."""

from pathlib import Path

from pcpc.tools.after.compare.comparison import Comparison
from pcpc.tools.after.compare.overlay import Criteria
from pcpc.tools.after.compare.pair import compare as compare_runs
from pcpc.tools.after.compare.recorded import recorded_comparison
from pcpc.tools.after.record import Run
from pcpc.tools.terminal.progress import Progress


def compare(old: str | Path | Run, new: str | Path | Run, tolerance: float = 0.0) -> Comparison:
    """Compare two runs, logs or folders of runs, as `pcpc compare` does.

        found = pcpc.compare(before, after)
        found.changed, found.pairs[0].first, found.pairs[0].changed_metrics, found.markdown()

    `tolerance`: relative change of a metric that counts as equal. Raises pcpc.Error: no such log.
    """
    if isinstance(old, Run) and isinstance(new, Run):
        return Comparison(str(old.path), str(new.path), [compare_runs(old, new, tolerance)])
    paths = [str(one.path if isinstance(one, Run) else one) for one in (old, new)]
    return recorded_comparison(paths[0], paths[1], Criteria(tolerance), Progress(quiet=True))

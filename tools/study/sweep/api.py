"""`pcpc.sweep`: a campaign of runs in virtual time, as a function."""

import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcpc.executive.errors import did_you_mean
from pcpc.tools.after.place import progress
from pcpc.tools.after.record import UnknownName
from pcpc.tools.start.native import native
from pcpc.tools.start.rigs import find
from pcpc.tools.start.settings import settings
from pcpc.tools.study.sweep.commands import SweepRequest
from pcpc.tools.terminal.extras import need_for_sweep

if TYPE_CHECKING:
    import pandas
    import pyarrow

    from pcpc.tools.study.sweep.results import Results
    from pcpc.tools.study.sweep.sensitivity import Share


@dataclass(frozen=True)
class Sweep:
    """A campaign: `table`, a row a run; `spec`, what it follows from; `statement` in words.

    With `until`, `worst` or `rare` the statement is their result. Rows that `worst` and `rare` have
    chosen are not a sample: no share of them is a probability.

    Columns: draw, controller, seed, `vary:NAME`, `metric:NAME`, `margin:NAME` and `held:NAME` of
    requirements, `unjudged:NAME` (why), ok (null: not judged), why, outcome (ran, fault, refused),
    alone (why it was not done in lanes).
    """

    table: "pyarrow.Table"
    spec: Mapping[str, Any]
    folder: Path
    statement: str = ""
    _keep: Any = field(default=None, repr=False)

    @property
    def results(self) -> "Results":
        """Columns and counts by controller."""
        from pcpc.tools.study.sweep.results import Results  # time

        return Results(self.table, self.spec)

    def failures(self, controller: str, requirement: str | None = None) -> tuple[int, int]:
        """Return failures and runs of a controller, of a requirement or of the verdict."""
        return self.results.failures(controller, requirement)

    def sensitivity(self, name: str) -> dict[str, list["Share"]]:
        """Return how much each variation contributes to a column, `metric:NAME` or `margin:NAME`.

        By controller, largest first: shares of its variance, see `Share`. Controllers with too few
        runs, or where nothing varies, are left out. UnknownName for another column.
        """
        from pcpc.tools.study.sweep.figures import shares_of  # time

        known = [one for one in self.table.column_names if one.startswith(("metric:", "margin:"))]
        if name not in known:
            raise UnknownName(f"no column {name}{did_you_mean(name, known)}")
        return shares_of(self.results, name)

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the table as a data frame; ImportError without pandas."""
        return self.table.to_pandas()

    def report(self, folder: str | Path | None = None) -> Path:
        """Write report.html and its figures; return the page."""
        from pcpc.tools.study.sweep.report import report  # time

        return report(self.results, Path(folder or self.folder))


def sweep(
    rig: str | Path,
    controllers: Sequence[str] | None = None,
    *,
    vary: Mapping[str, str] | None = None,
    draws: int | None = None,
    sampling: str | None = None,
    seed: int = 1,
    set: Mapping[str, Any] | None = None,
    until: str | None = None,
    worst: int | None = None,
    rare: int | None = None,
    of: str | None = None,
    limit: float | None = None,
    threads: int | None = None,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    quiet: bool | None = None,
) -> Sweep:
    """Run a rig many times with varying values, in virtual time, eight runs at once.

    Each row is bit-identical to `pcpc simulate` with its settings.

    rig          a rig's name (`pcpc rigs`) or file
    controllers  of the rig, each on the same draws; None: the rig's default
    vary         {"barrel.gap_rad": "x0.5:2"}: lo:hi, lo:hi:n, normal(m,s), lognormal(median,
                 factor), choice(a,b); x before one: a factor on the rig's value
    draws        default 1000; of a grid all, with `until` as many as needed
    sampling     random, lhs, sobol (default), grid
    seed         of draws and noise
    set          other values of the rig, in all runs
    until        a statement that ends it, as "p_fail < 1e-3 at 95%"; needs sampling random
    worst        search for the worst case, the smallest margin of the requirements, with this
                 many runs, in place of draws
    rare         probability of a rare failure by subset simulation, with this many runs a level,
                 as 1000, in place of draws
    of           the metric that `worst` maximises, or that fails above `limit` with `rare`
    limit        see `of`
    threads      default: processors + 2
    scheduler    Dask: tcp://HOST:PORT, or local[:N] for N workers here (your script needs
                 `if __name__ == "__main__":`, as each worker imports it)
    folder       keeps the rows there and resumes; None: a temporary folder
    quiet        no progress; None: progress on a terminal only

    Raises pcpc.Error, one line with place and cure, for a wrong argument. A run that ends in a
    fault, or with values out of range, is a row like any other.
    """
    need_for_sweep()
    request = SweepRequest(
        rig=find(str(rig)), controllers=",".join(controllers) if controllers else None,
        vary=[f"{name}={text}" for name, text in (vary or {}).items()], set=settings(set),
        draws=draws, sampling=sampling, seed=seed, until=until, worst=worst, rare=rare, of=of,
        limit=limit, threads=threads, scheduler=scheduler,
    )  # fmt: skip
    with native("numba" not in sys.modules):
        from pcpc.tools.study.sweep.request import campaign_of, work_of  # time

    from pcpc.tools.study.sweep import shards  # time

    campaign = campaign_of(request)
    keep = None if folder else tempfile.TemporaryDirectory(prefix="pcpc-")
    place = Path(folder or keep.name)  # type: ignore[union-attr]
    work = work_of(request, campaign, place)
    try:
        outcome = work.to_end(progress(quiet))
    finally:
        work.store.close()
    table, spec = shards.merge([place])
    return Sweep(table, spec, place, outcome, keep)

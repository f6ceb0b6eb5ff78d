"""What a campaign's table says on a terminal: counts, metrics and worst runs by controller."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pcpc.tools.study.arrays import Vector
from pcpc.tools.study.engine import FAULT, REFUSED
from pcpc.tools.study.sweep.results import Results

WORST, COLUMNS = 2, 80  # runs of a controller that are told
_SHARES = (("5 %", 5.0), ("median", 50.0), ("95 %", 95.0))


def summary(results: Results, folder: Path) -> str:
    """Return it in 80 columns; `folder`: of the campaign."""
    return "\n".join([*_table(results), *_worst(results, folder)])


def _table(results: Results) -> Iterator[str]:
    names = list(results.spec["controllers"])
    rows = [results.column("controller") == name for name in names]
    width = max(12, *map(len, names)) + 1

    def line(title: str, cells: list[str]) -> str:
        return f"{title:28}" + "".join(f"{cell:>{width}}" for cell in cells)

    yield f"{results.spec['title']}: {len(set(results.column('draw').tolist())):,} draws"
    yield line("", names)
    outcome, ok = results.column("outcome"), results.column("ok")
    counted = {
        "runs": outcome != "",
        "ok": np.equal(ok, True),
        "faults": outcome == FAULT,
        "refused": outcome == REFUSED,
        "not judged": np.array([one is None for one in ok]),
        "done one by one": results.column("alone").astype(bool),
    }
    for title, flags in counted.items():
        counts = [np.count_nonzero(flags[own]) for own in rows]
        if title in ("runs", "ok") or any(counts):
            yield line(title, [f"{count:,}" for count in counts])
    for name in results.measures:
        kind, _, bare = name.partition(":")
        values = results.column(name).astype(np.float64)
        yield f"{bare} ({kind})"
        for title, share in _SHARES:
            yield line(f"  {title}", [_percentile(values[own], share) for own in rows])


def _percentile(values: Vector, share: float) -> str:
    finite = values[~np.isnan(values)]
    return f"{np.percentile(finite, share, method='nearest'):.4g}" if len(finite) else "-"


def _worst(results: Results, folder: Path) -> list[str]:
    """Return the worst runs of each controller, and how to do one again."""
    rows, lines = results.worst_first(), list[str]()
    names, draws, why = (results.column(one) for one in ("controller", "draw", "why"))
    for name in results.spec["controllers"]:
        for row in rows[names[rows] == name][:WORST].tolist():
            lines.append(f"  draw {draws[row]} {name}: {why[row] or 'ok'}"[:COLUMNS])
    again = f"again, with a log: pcpc sweep rerun {folder} DRAW CONTROLLER"
    return ["the worst runs:", *lines, again] if lines else []

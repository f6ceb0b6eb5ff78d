"""What a table of runs says, in 80 columns; which runs are the worst; how one is done again."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pyarrow

WORST, COLUMNS = 2, 80  # runs of a controller that are told


def summary(table: "pyarrow.Table", spec: Mapping[str, Any], folder: Path) -> str:
    """Return counts, metrics and worst runs by controller; `folder`: of the campaign."""
    frame = {name: _values(table[name]) for name in table.column_names}
    controllers = list(spec["controllers"])
    of = {
        name: np.array([i for i, one in enumerate(frame["controller"]) if one == name])
        for name in controllers
    }
    width = max(12, *(len(name) for name in controllers))
    head = f"{'':28}" + "".join(f"{name:>{width + 1}}" for name in controllers)
    lines = [f"{spec['title']}: {len(set(frame['draw'])):,} draws", head]
    counts = {
        "runs": lambda i: True, "ok": lambda i: frame["ok"][i],
        "faults": lambda i: frame["outcome"][i] == "fault",
        "refused": lambda i: frame["outcome"][i] == "refused",
        "not judged": lambda i: frame["ok"][i] is None,
        "done one by one": lambda i: bool(frame["alone"][i]),
    }  # fmt: skip
    for title, counts_it in counts.items():
        numbers = [sum(1 for i in of[name] if counts_it(int(i))) for name in controllers]
        if title in ("runs", "ok") or any(numbers):
            lines.append(f"{title:28}" + "".join(f"{n:>{width + 1},}" for n in numbers))
    for name in (one for one in table.column_names if one.startswith(("metric:", "margin:"))):
        values = np.array(frame[name], float)
        lines.append(f"{name.partition(':')[2]} ({name.partition(':')[0]})")
        for title, share in (("5 %", 5.0), ("median", 50.0), ("95 %", 95.0)):
            cells = [_cell(values[of[one]], share) for one in controllers]
            lines.append(f"  {title:26}" + "".join(f"{cell:>{width + 1}}" for cell in cells))
    return "\n".join([*lines, *_worst(frame, table.column_names, spec, folder)])


def _values(column: "pyarrow.ChunkedArray") -> Any:
    """Return a column; numbers as an array, as there may be many, with NaN where none was told."""
    import pyarrow as pa

    return column.to_numpy() if pa.types.is_floating(column.type) else column.to_pylist()


def _cell(values: Any, share: float) -> str:
    told = values[~np.isnan(values)]
    if not len(told):
        return "-"
    found = np.percentile(told, share, method="nearest")
    return f"{found:.4g}"


def order_of(frame: Mapping[str, Any], names: Any) -> list[int]:
    """Return the rows from the worst on: faults, smallest margins, else largest first metrics."""
    margins = [name for name in names if name.startswith("margin:")]
    metrics = [name for name in names if name.startswith("metric:")]

    def badness(i: int) -> tuple[int, float]:
        fault = frame["outcome"][i] == "fault"
        told = [frame[name][i] for name in margins if not math.isnan(frame[name][i])]
        if told:
            return fault, -min(told)
        value = frame[metrics[0]][i] if metrics else math.nan
        return fault, -math.inf if math.isnan(value) else value

    rows = [i for i, outcome in enumerate(frame["outcome"]) if outcome != "refused"]
    return sorted(rows, key=badness, reverse=True)


def settings_of(frame: Mapping[str, Any], i: int, spec: Mapping[str, Any]) -> list[str]:
    """Return the `--set` options of a row's run."""
    varied = {name[5:]: frame[name][i] for name in frame if name.startswith("vary:")}
    words = [*spec["settings"], *(f"{name}={value!r}" for name, value in varied.items())]
    return [*words, f"seed={frame['seed'][i]}"]


def _worst(
    frame: Mapping[str, Any], names: Any, spec: Mapping[str, Any], folder: Path
) -> list[str]:  # fmt: skip
    """Return the worst runs of each controller, and how to do one again."""
    rows, lines = order_of(frame, names), []
    for controller in spec["controllers"]:
        for i in [i for i in rows if frame["controller"][i] == controller][:WORST]:
            why = frame["why"][i] or "ok"
            lines.append(f"  draw {frame['draw'][i]} {controller}: {why}"[:COLUMNS])
    if not lines:
        return []
    again = f"again, with a log: pcpc sweep rerun {folder} DRAW CONTROLLER"
    return ["the worst runs:", *lines, again]

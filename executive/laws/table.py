"""The columns of a file over time as a block: each held from row to row, or a line between rows.

    hold      y = y_i,                    y' = 0                           t_i <= t < t_i+1    (1)
    linear    y = y_i + y' (t - t_i),     y' = (y_i+1 - y_i)/(t_i+1 - t_i)                     (2)

Before the first row the first value, after the last the last, with y' = 0; y'' = 0 everywhere.
With `repeat` the rows from the first to the last follow each other again and again, and the last
row is the first of the next round. A row begins at the cycle that is within 1 ns of its time.

The values are constants of the compiled step: they take no place among the variables, and a table
is compiled once, in a second or two.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.laws.block import Block, Nothing, Ports, flat, port, stage
from pcpc.executive.laws.emath import floor

_SAME_S = 1e-9  # k T and a time of a file are the same, but for their last bits
_UNITS = {
    "rad": "rad", "m": "m", "Nm": "N m", "N": "N", "V": "V", "A": "A", "s": "s", "hz": "Hz",
    "rad_s": "rad/s", "m_s": "m/s", "rad_s2": "rad/s2", "m_s2": "m/s2",
}  # fmt: skip


class Row(Ports):
    """Where the look-up stands."""

    row = port("", "the newest row that has begun", recorded=False)


def unit_of(name: str) -> str:
    """Return the unit that the end of a name says, "" for none: N m of `load_Nm`."""
    return _UNITS.get(_stem_and_unit(name)[1], "")


def _stem_and_unit(name: str) -> tuple[str, str]:
    """Return a name's stem and its ending of `_UNITS`."""
    ends = [end for end in _UNITS if name.endswith(f"_{end}")]
    end = max(ends, key=len, default="")
    return (name[: -len(end) - 1], end) if end else (name, "")


def derivative(name: str, unit: str, order: int) -> tuple[str, str]:
    """Return name and unit of the first or second derivative: `q_d_rate_rad_s`, rad/s."""
    stem, end = _stem_and_unit(name)
    word, per = ("rate", "s") if order == 1 else ("acc", "s2")
    if end.endswith("_s"):
        end, per = end[:-2], "s2" if order == 1 else "s3"
    base = unit.removesuffix("/s") if per != "s" or order == 2 else unit
    return "_".join(filter(None, (stem, word, end, per * bool(end)))), f"{base or '1'}/{per}"


def block(
    times_s: NDArray[np.float64],
    values: NDArray[np.float64],
    columns: dict[str, str],
    linear: bool,
    repeat: bool,
) -> Block:
    """Return the block of a table: `times_s` (rows,) rising, `values` (rows, columns).

    `columns`: names and units of the outputs. Each has its derivatives as further outputs, unless
    they are columns themselves.
    """
    outputs = {name: port(unit, "of the table") for name, unit in columns.items()}
    rate_at = np.full(len(columns), -1)  # the place of each column's slope among the outputs
    for order, what in ((1, "slope of"), (2, "0, second derivative of")):
        for column, (name, unit) in enumerate(columns.items()):
            derived, its_unit = derivative(name, unit, order)
            if derived not in outputs:
                rate_at[column] = len(outputs) if order == 1 else rate_at[column]
                outputs[derived] = port(its_unit, f"{what} {name}")
    declared: Any = type("Outputs", (Ports,), {"__doc__": "Of a table.", **outputs})
    begins = times_s - _SAME_S
    last, n = len(times_s) - 1, len(columns)
    period = times_s[last] - times_s[0]

    @stage
    def step(t: float, dt: float, p: Nothing, x: Row, u: Nothing, y: declared) -> None:
        """Equations (1), (2)."""
        if repeat and t > begins[0]:
            t -= floor((t - begins[0]) / period) * period
        i = int(x.row)
        if t < begins[i]:
            i = 0
        while i < last and t >= begins[i + 1]:
            i += 1
        x.row = i
        out = flat(y)
        between = linear and i < last and t >= begins[0]
        for c in range(n):
            out[c], slope = values[i, c], 0.0
            if between:
                slope = (values[i + 1, c] - values[i, c]) / (times_s[i + 1] - times_s[i])
                out[c] += slope * (t - times_s[i])
            if rate_at[c] >= 0:
                out[rate_at[c]] = slope

    return Block(step)

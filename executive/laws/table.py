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
from pcpc.executive.laws.units import unit, unit_of_name

_SAME_S = 1e-9  # k T and a time of a file are the same, but for their last bits
_ENDINGS = (  # of a name, behind the word for its derivative
    "rad", "m", "Nm", "N", "V", "A", "s", "hz", "rad_s", "m_s", "rad_s2", "m_s2",
)  # fmt: skip


class Row(Ports):
    """Where the look-up stands."""

    row = port("", "the newest row that has begun", recorded=False)


def unit_of(name: str) -> str:
    """Return the SI unit that the end of a name says, "" for none: N m of `load_Nm`."""
    said = unit_of_name(name)
    return said.text if said is not None and said.factor == 1 else ""


def _stem_and_ending(name: str) -> tuple[str, str]:
    """Return a name's stem and its ending of `_ENDINGS`."""
    ends = [end for end in _ENDINGS if name.endswith(f"_{end}")]
    end = max(ends, key=len, default="")
    return (name[: -len(end) - 1], end) if end else (name, "")


def derivative(name: str, of: str, order: int) -> tuple[str, str]:
    """Return name and unit of the first or second derivative: `q_d_rate_rad_s`, rad/s."""
    stem, end = _stem_and_ending(name)
    word, per = ("rate", "s") if order == 1 else ("acc", "s2")
    if end.endswith("_s"):
        end, per = end[:-2], "s2" if order == 1 else "s3"
    name = "_".join(filter(None, (stem, word, end, per * bool(end))))
    return name, unit(of).per_second(order).text


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
    outputs = {name: port(its_unit, "of the table") for name, its_unit in columns.items()}
    rate_at = np.full(len(columns), -1)  # the place of each column's slope among the outputs
    for order, meaning in ((1, "slope of"), (2, "0, second derivative of")):
        for column, (name, its_unit) in enumerate(columns.items()):
            derived, derived_unit = derivative(name, its_unit, order)
            if derived not in outputs:
                rate_at[column] = len(outputs) if order == 1 else rate_at[column]
                outputs[derived] = port(derived_unit, f"{meaning} {name}")
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

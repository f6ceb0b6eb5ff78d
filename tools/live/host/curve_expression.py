"""A curve that is calculated: `= abs(controller.e_rad) * 1000`, an expression as in requirements.

It has a value at the cycles that have all of its variables, in base units (rad, s, N, m).
"""

from typing import Any

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.laws.units import Unit, unit
from pcpc.executive.rig import expressions
from pcpc.tools.live.history import Cycles, Values
from pcpc.tools.live.host.sources import RunSource

MARK = "="


class CurveExpression:
    """One of these; UserError for what is none, or names what the run does not record."""

    def __init__(self, text: str, source: RunSource) -> None:
        def unit_of(name: str) -> Unit | None:
            role, variable = source.curve(name)
            return unit(source.nodes[role].variables[variable].unit)

        words = text.removeprefix(MARK).strip()
        if not words:
            raise UserError(f"{MARK} wants an expression, as {MARK} abs(x) * 1000")
        try:
            self._value = expressions.value(words, unit_of)
        except expressions.ExpressionError as error:
            raise UserError(str(error)) from None
        self._places = {name: source.place(name) for name in self._value.names}
        if not self._places:
            raise UserError(f"{text}: it needs a variable")

    def part(self, source: RunSource, first: int, last: int) -> tuple[Cycles, Values]:
        """Return the cycles `first` to `last` that have it, and its values (n, 1)."""
        parts = {  # a rate is of two rows
            name: source.nodes[role].part([variable], first - 1, last)
            for name, (role, variable) in self._places.items()
        }
        cycle = None
        for cycles, _ in parts.values():
            cycle = cycles if cycle is None else np.intersect1d(cycle, cycles, True)
        assert cycle is not None
        columns = {
            name: values[np.searchsorted(cycles, cycle), 0]
            for name, (cycles, values) in parts.items()
        }
        rows = expressions.Rows(cycle, columns, source.period_s)
        with np.errstate(all="ignore"):
            values: Any = np.broadcast_to(self._value.at(rows), len(cycle))
        own = cycle >= first
        return cycle[own], np.asarray(values, np.float64)[own, None]

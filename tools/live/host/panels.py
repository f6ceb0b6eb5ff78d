"""What of a panel goes to a client: all of it at first, then only the bins that are new.

    head    8 float64: kind, id, curves, first bin, bins, width (cycles), period (s), newest cycle
    curves  of bins: each curve's least values, then each curve's greatest, float32 (history)
    phase   of points: x, then y, float32

kind is BINS (the newest, to be appended), WHOLE (forget what was) or PHASE.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pcpc.tools.live.history import Values, envelope
from pcpc.tools.live.host import client_messages as messages
from pcpc.tools.live.host.curve_expression import CurveExpression
from pcpc.tools.live.host.sources import RunSource, complete

BINS, WHOLE, PHASE = range(3)


@dataclass
class PanelState:
    """A panel of a client, and up to which bin it has been sent."""

    wanted: messages.Panel | messages.Phase
    places: list[tuple[str, str] | CurveExpression]  # node and variable, or what is calculated
    sent: int | None = None  # the first bin that may have been sent in part
    newest: int = -1

    def message(self, source: RunSource) -> bytes:
        """Return what is new, b"" for nothing."""
        if isinstance(self.wanted, messages.Phase):
            return self._phase(self.wanted, source)
        return self._bins(self.wanted, source)

    def _bins(self, wanted: messages.Panel, source: RunSource) -> bytes:
        """Return the bins since the first that may have been incomplete when it was sent."""
        begin, newest, done = _edges(source)
        period_s = source.period_s
        if wanted.window_s is not None:
            if newest == self.newest:
                return b""
            width = max(1, round(wanted.window_s / period_s / wanted.bins))
            last = newest // width
            oldest = max(last - wanted.bins + 1, begin // width)
            kind = WHOLE if self.sent is None or self.sent < oldest else BINS
            first = oldest if kind == WHOLE or self.sent is None else self.sent
            bins = last - first + 1
            self.sent, self.newest = max(done // width, oldest), newest
        else:
            if self.sent is not None:
                return b""
            from_k, to_k = round(wanted.from_s / period_s), round(wanted.to_s / period_s)
            from_k, to_k = max(from_k, begin), min(to_k, newest)
            width = max(1, -(-(to_k - from_k + 1) // wanted.bins))
            kind, first, bins = WHOLE, from_k // width, max(0, to_k // width - from_k // width + 1)
            self.sent = first
        if bins <= 0:
            return b""
        part = tuple(self.places), first, bins, width
        if part not in source.parts:
            source.parts[part] = _packed_floats(*self._envelopes(source, first, bins, width))
        head = kind, wanted.id, len(self.places), first, bins, width, period_s, newest
        return _head(head) + bytes(source.parts[part])

    def _envelopes(
        self, source: RunSource, first: int, bins: int, width: int
    ) -> tuple[Values, Values]:
        low = np.full((len(self.places), bins), np.nan)
        high = low.copy()
        begin, last = first * width, (first + bins) * width - 1
        groups: dict[Any, list[int]] = {}
        for i, place in enumerate(self.places):
            groups.setdefault(place if isinstance(place, CurveExpression) else place[0], []).append(
                i
            )
        for of, mine in groups.items():
            if isinstance(of, CurveExpression):
                cycle, values = of.part(source, begin, last)
            else:
                names = [self.places[i][1] for i in mine]  # type: ignore[index]
                cycle, values = source.nodes[of].part(names, begin, last)
            low[mine], high[mine] = envelope(cycle, values, first, bins, width)
        return low, high

    def _phase(self, wanted: messages.Phase, source: RunSource) -> bytes:
        """Return the newest points of one variable over the other, at the cycles of both."""
        _, newest = source.span()
        if wanted.to_s is not None:
            newest = min(newest, round(wanted.to_s / source.period_s))
        if newest == self.newest:
            return b""
        self.newest = newest
        first = max(0, newest - round(wanted.window_s / source.period_s))
        (cycle_x, of_x), (cycle_y, of_y) = (
            place.part(source, first, newest)
            if isinstance(place, CurveExpression)
            else source.nodes[place[0]].part([place[1]], first, newest)
            for place in self.places
        )
        both, at_x, at_y = np.intersect1d(cycle_x, cycle_y, True, True)
        every = slice(None, None, max(1, -(-len(both) // wanted.points)))
        xy = of_x[at_x, 0][every], of_y[at_y, 0][every]
        head = PHASE, wanted.id, 2, int(both[0]) if len(both) else 0, len(xy[0]), 1
        return _head((*head, source.period_s, newest)) + _packed_floats(*xy)


def _edges(source: RunSource) -> tuple[int, int, int]:
    """Return the first cycle, the last of any node, and the last of all nodes that run."""
    if "edges" not in source.parts:
        source.parts["edges"] = (*source.span(), complete(source))
    first, last, done = source.parts["edges"]
    return first, last, done


def _head(head: tuple[float, ...]) -> bytes:
    return np.array(head, np.float64).tobytes()


def _packed_floats(*arrays: Values) -> bytes:
    with np.errstate(over="ignore"):
        return b"".join(np.asarray(array).astype(np.float32).tobytes() for array in arrays)

"""The open loop by its answer to an impulse, for laws and plants that look values up by time.

    w_k = u_k + d_k,   d_0 = h, else 0;    s_k = (w_k of h - w_k of -h)/(2 h)                (1)
    S(z) = sum s_k z^-k = 1/(1 + L),       L = 1/S - 1                                       (2)

A ring buffer is another map in every cycle, but the same loop: two runs of the map of a cycle, with
all loops closed, differ by what the impulse does. As many cycles as it takes until nothing is left
of it; without states there are no poles, and a loop that does not come to rest is refused.
"""

from dataclasses import dataclass

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.tools.study.arrays import Complex, Vector
from pcpc.tools.study.margin.cycle_map import CycleMap
from pcpc.tools.study.margin.loops import CutLoop, OpenLoop

_STEP = 1e-6  # of the impulse, times 1 or the command
_LEFT = 1e-6  # of the largest value, over the last tenth
_MOST = 40_000  # cycles
_AGREE = 0.01


@dataclass(frozen=True)
class Impulse(OpenLoop):
    """s of (1), (n,), of a loop; it has no poles to be told."""

    s: Vector

    def passes(self, received: set[str]) -> bool:
        """Return whether the command acts on what its node receives from others, and on itself."""
        return not received.isdisjoint(self.given) and bool(np.abs(self.s[1:]).max() > 0.0)

    def response(self, f_hz: Vector) -> Complex:
        """Return L of (2) at the frequencies f, (n,)."""
        turns = -2j * np.pi * self.dt * np.arange(len(self.s))
        found = np.array([np.exp(turns * f) @ self.s for f in f_hz.tolist()])
        return np.asarray(1.0 / found - 1.0)


def loop_by_impulse(cycle: CycleMap, loop: CutLoop, given: frozenset[str]) -> Impulse:
    """Return the loop at the state of `cycle`; UserError where it does not come to rest.

    given   names of what differences say that the command reaches
    """
    command = float(cycle.v[cycle.place(loop.role, loop.source)])
    h = _STEP * max(1.0, abs(command))
    one, ten = (_answer(cycle, loop, step) for step in (h, 10.0 * h))
    n = min(len(one), len(ten))
    if np.abs(one[:n] - ten[:n]).max() > _AGREE * np.abs(one[1:]).max():
        what = "answers an impulse and one ten times larger differently (rounded, or not smooth)"
        raise UserError(f"the loop of {loop.signal} {what}; --method measured can do it")
    return Impulse(one, dt=cycle.dt, command=command, given=given)


def _answer(cycle: CycleMap, loop: CutLoop, h: float) -> Vector:
    """Return s of (1), to its end; `cycle` is left as it was."""
    start, first, sent = cycle.v.copy(), cycle.k, cycle.place(loop.role, loop.sent)
    both = [(start.copy(), first, [h]), (start.copy(), first, [-h])]
    told: list[list[float]] = [[], []]
    n, end = 0, 1000
    while n < _MOST:
        for i, (v, k, pulse) in enumerate(both):
            cycle.v[:], cycle.k = v, k
            for at in range(n, end):
                cycle.advance(loop, pulse[0] if at == 0 else 0.0, added=True)
                told[i].append(cycle.v[sent])
            both[i] = (cycle.v.copy(), cycle.k, pulse)
        cycle.v[:], cycle.k = start, first
        s = (np.array(told[0]) - np.array(told[1])) / (2.0 * h)
        tail = np.abs(s[-len(s) // 10 :]).max()
        if not np.isfinite(s).all() or tail > 1e6:
            break
        if tail < _LEFT * np.abs(s).max():
            return s
        n, end = end, min(2 * end, _MOST)
    what = f"does not come to rest within {_MOST} cycles: unstable, or an integrator"
    raise UserError(f"the impulse response of the loop of {loop.signal} {what}")

"""The open loop as a state space at the sample rate, by differences of the map of a cycle.

    x_k+1 = A x_k + B v_k,   u_k = C x_k + D v_k                                             (1)
    L(z)  = -(C (z I - A)^-1 B + D)                                                          (2)

x: what a cycle takes over from the one before; v: what the plant is given in the place of the
command u. Central differences; of x those are kept that v reaches and u sees, found by which
differences are exactly 0: noise, scratch and clocks are none of them.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import UserError
from pcpc.tools.margin.cycle_map import CycleMap
from pcpc.tools.margin.loops import Loop
from pcpc.tools.margin.operating import Rest

Vector = NDArray[np.float64]
_STEP = 1e-6  # of a difference, times 1 or the value
_CHANGES = 0.05  # of a response, from cycle to cycle
_KINK = 0.02  # of a slope: how much its two sides may differ


@dataclass(frozen=True)
class Linear:
    """(1); `states` names x, `kinks` those whose two sides differ, `command` is u at rest."""

    a: NDArray[np.float64]
    b: Vector
    c: Vector
    d: float
    dt: float
    states: list[str]
    command: float
    kinks: list[str] = field(default_factory=list)

    def response(self, f_hz: Vector) -> NDArray[np.complex128]:
        """Return L of (2) at the frequencies f, (n,)."""
        z = np.exp(2j * np.pi * f_hz * self.dt)
        if not self.states:
            return np.full(len(z), -self.d, complex)
        eye = np.eye(len(self.b))
        solved = np.linalg.solve(z[:, None, None] * eye - self.a, self.b[None, :, None])
        return np.asarray(-(solved[:, :, 0] @ self.c + self.d))

    def closed(self, gain: float = 1.0) -> NDArray[np.complex128]:
        """Return the poles z of the closed loop with its gain times `gain`."""
        back = gain / (1.0 - gain * self.d)
        return np.linalg.eigvals(self.a + back * np.outer(self.b, self.c)).astype(complex)

    def poles(self) -> NDArray[np.complex128]:
        """Return the poles z of the open loop."""
        return np.linalg.eigvals(self.a).astype(complex)


def linearised(rest: Rest, loop: Loop) -> Linear:
    """Return the open loop at the mean of the states: noise keeps none of them at rest."""
    first = _differences(rest.cycle, loop)
    names = {name: place for place, name in enumerate(rest.cycle.names)}
    places = [names[name] for name in first.states] + rest.cycle.taken(loop)
    rest.cycle.v[places] = rest.mean[places]
    found = _differences(rest.cycle, loop)
    rest.cycle.advance()
    _check_lasting(found, _differences(rest.cycle, loop), loop)
    return found


def _check_lasting(first: Linear, second: Linear, loop: Loop) -> None:
    """Raise UserError where the next cycle has another open loop."""
    f = np.geomspace(1e-4, 0.49, 40) / first.dt
    one, two = first.response(f), second.response(f)
    if np.abs(one - two).max() > _CHANGES * (np.abs(one).max() + np.abs(two).max() + 1e-300):
        what = "is another one in the next cycle: its laws look values up by time (a delay line, a"
        raise UserError(f"the loop of {loop.signal} {what} schedule); --method measured can do it")


def _differences(cycle: CycleMap, loop: Loop) -> Linear:
    """Return the open loop at the state of `cycle`, which is left as it was."""
    kept, start, k = cycle.kept(), cycle.v.copy(), cycle.k
    sent = cycle.place(loop.role, loop.source)
    command = float(start[cycle.taken(loop)[0]])

    def after(place: int | None, h: float) -> Vector:
        """Return what a cycle makes of its start, one value of it changed; the command last."""
        cycle.v[:], cycle.k = start, k
        if place is not None:
            cycle.v[place] += h
        cycle.advance(loop, command + h if place is None else command)
        return np.append(cycle.v[kept], cycle.v[sent])

    n = len(kept)
    slopes, bent = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1), bool)
    middle = after(None, 0.0)
    noise = 1e-13 * (1.0 + np.abs(middle))
    for j, place in enumerate([*kept.tolist(), None]):
        x = command if place is None else start[place]
        h = _STEP * max(1.0, abs(x))
        up, down = after(place, h) - middle, middle - after(place, -h)
        slopes[:, j] = (up + down) / (2.0 * h)
        bent[:, j] = np.abs(up - down) > _KINK * np.abs(up + down) + noise
    cycle.v[:], cycle.k = start, k
    return _reduced(cycle, kept, slopes, bent, command)


def _reduced(
    cycle: CycleMap, kept: NDArray[np.int64], slopes: NDArray[np.float64], bent: NDArray[np.bool_],
    command: float,
) -> Linear:  # fmt: skip
    """Return what of the differences lies between what is given and the command."""
    linked = slopes != 0.0
    a, b, c = linked[:-1, :-1], linked[:-1, -1], linked[-1, :-1]
    inside = _reached(a, b) & _reached(a.T, c)
    rows = np.flatnonzero(inside)
    names = cycle.names
    full = np.append(rows, len(kept))
    own = bent[np.ix_(full, full)]
    at = [*(names[kept[i]] for i in rows), "the command"]
    return Linear(
        slopes[np.ix_(rows, rows)], slopes[rows, -1], slopes[-1, rows], float(slopes[-1, -1]),
        cycle.dt, at[:-1], command, [at[i] for i in np.flatnonzero(own.any(axis=0))],
    )  # fmt: skip


def _reached(a: NDArray[np.bool_], first: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return what is reached from `first` by any number of steps; a[i, j]: from j to i."""
    found = first.copy()
    while True:
        more = found | (a[:, found].any(axis=1))
        if (more == found).all():
            return found
        found = more

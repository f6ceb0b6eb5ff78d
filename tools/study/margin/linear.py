"""The open loop as a state space at the sample rate, by differences of the map of a cycle.

    x_k+1 = A x_k + B v_k,   u_k = C x_k + D v_k                                             (1)
    L(z)  = -(C (z I - A)^-1 B + D)                                                          (2)

x: what a cycle takes over from the one before; v: what the plant is given in the place of the
command u. Central differences; of x those are kept that v reaches and u sees, found by which
differences are exactly 0: noise, scratch and clocks are none of them. Slopes: `slopes.py`.
"""

from dataclasses import dataclass

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.tools.study.arrays import Complex, Flags, Vector
from pcpc.tools.study.margin import impulse, slopes
from pcpc.tools.study.margin.cycle_map import CycleMap
from pcpc.tools.study.margin.loops import CutLoop, OpenLoop
from pcpc.tools.study.margin.operating import Rest

_CHANGES = 0.05  # of a response, from cycle to cycle
UNSTABLE = 1e-7  # of a pole beyond 1: what rounding of several poles at 1 does not reach
_FEW = 300  # states of a law that are looked at, though the command may not reach them


@dataclass(frozen=True)
class Linear(OpenLoop):
    """(1); `states` names x."""

    a: Vector
    b: Vector
    c: Vector
    d: float
    states: list[str]

    def response(self, f_hz: Vector) -> Complex:
        """Return L of (2) at the frequencies f, (n,)."""
        z = np.exp(2j * np.pi * f_hz * self.dt)
        if not self.states:
            return np.full(len(z), -self.d, complex)
        eye = np.eye(len(self.b))
        solved = np.linalg.solve(z[:, None, None] * eye - self.a, self.b[None, :, None])
        return np.asarray(-(solved[:, :, 0] @ self.c + self.d))

    def closed(self) -> Complex:
        """Return the poles z of the closed loop."""
        back = 1.0 / (1.0 - self.d)
        return np.linalg.eigvals(self.a + back * np.outer(self.b, self.c)).astype(complex)

    def passes(self, received: set[str]) -> bool:
        """Return whether the command acts on itself by what its node receives from others."""
        return not received.isdisjoint(self.states)

    def poles(self) -> Complex:
        """Return the poles z of the open loop."""
        return np.linalg.eigvals(self.a).astype(complex)


def linearise(rest: Rest, loop: CutLoop) -> Linear | impulse.Impulse:
    """Return the open loop at the mean of the states: noise keeps none of them at rest.

    Where the next cycle has another one (a delay line that is looked up by time), its answer to
    an impulse stands for it. UserError where there is neither.
    """
    cycle, first = rest.cycle, differences(rest.cycle, loop)
    places = [cycle.index[name] for name in first.states] + cycle.cut_places(loop)
    cycle.v[places] = rest.mean[places]
    found = differences(cycle, loop)
    start, k = cycle.v.copy(), cycle.k
    cycle.advance()
    second = differences(cycle, loop)
    cycle.v[:], cycle.k = start, k
    lasts = _lasts(found, second)
    if lasts and found.given == second.given:
        return found
    try:
        return impulse.loop_by_impulse(cycle, loop, found.given)
    except UserError:
        if lasts and found.states:
            return found
        raise


def _lasts(first: Linear, second: Linear) -> bool:
    """Return whether the next cycle has the same open loop."""
    f = np.geomspace(1e-4, 0.49, 40) / first.dt
    one, two = first.response(f), second.response(f)
    most = np.abs(one).max() + np.abs(two).max() + 1e-300
    return bool(np.abs(one - two).max() <= _CHANGES * most)


def differences(cycle: CycleMap, loop: CutLoop) -> Linear:
    """Return the open loop at the state of `cycle`, which is left as it was."""
    kept, start, k = cycle.kept, cycle.v.copy(), cycle.k
    sent = cycle.place(loop.role, loop.source)
    command = float(start[cycle.cut_places(loop)[0]])

    def cycle_result(moved: dict[int, float]) -> Vector:
        """Return what a cycle makes of its start, some values of it changed; the command last."""
        cycle.v[:], cycle.k = start, k
        for j, h in moved.items():
            if j < len(kept):
                cycle.v[kept[j]] += h
        cycle.advance(loop, command + moved.get(len(kept), 0.0))
        return np.append(cycle.v[kept], cycle.v[sent])

    x = np.append(start[kept], command)
    names = [*(cycle.names[place] for place in kept), "the command"]
    memories = cycle.of_kind(loop.role, "state")
    state = np.array([name in memories for name in names[:-1]])
    also = np.flatnonzero(state) if state.sum() <= _FEW else np.empty(0, np.int64)
    found = slopes.slopes(cycle_result, x, len(kept), also)
    rounded = _of_steps(cycle_result, x, found, names)
    cycle.v[:], cycle.k = start, k
    return _reduced_model(found, names, state, rounded, command, cycle.dt)


def _of_steps(
    after: slopes.Map, x: Vector, found: slopes.Slopes, names: list[str]
) -> dict[str, float]:
    """Put the slopes of what is rounded in the place of differences; return their steps by name."""
    given, seen = _linked_states((found.slopes != 0.0) | found.rounded)
    own = np.append(given, True)  # others, as what draws noise, are none of the loop's
    rounded, columns, told = found.rounded & own, np.flatnonzero(own), dict[str, float]()
    for i in np.flatnonzero(rounded.any(axis=1) & np.append(seen, True)).tolist():
        one = slopes.steps(after, x, i, np.flatnonzero(rounded[i]))
        if one is None:
            continue
        found.slopes[i] = slopes.row(after, x, i, one, columns)
        found.bent[i] = False
        told[names[i]] = abs(float(one.size))
    return told


def _reduced_model(
    found: slopes.Slopes,
    names: list[str],
    state: Flags,
    rounded: dict[str, float],
    command: float,
    dt: float,
) -> Linear:
    """Return what of the differences lies between what is given and the command."""
    linked = found.slopes != 0.0
    given, seen = _linked_states(linked)
    rows = np.flatnonzero(given & seen)
    own = np.ix_(full := np.append(rows, len(given)), full)
    slope, bent = found.slopes[own], found.bent[own].any(axis=0)
    at = [names[i] for i in full]
    idle = np.flatnonzero(np.diagonal(linked)[:-1] & state & (given != seen))
    return Linear(
        slope[:-1, :-1],
        slope[:-1, -1],
        slope[-1, :-1],
        float(slope[-1, -1]),
        at[:-1],
        dt=dt,
        command=command,
        kinks=[at[i] for i in np.flatnonzero(bent)],
        rounded={name: q for name, q in rounded.items() if name in at},
        idle=[names[i] for i in idle],
        given=frozenset(names[i] for i in np.flatnonzero(given)),
    )


def _linked_states(linked: Flags) -> tuple[Flags, Flags]:
    """Return which states what is given reaches, and which of them the command sees."""
    a, b, c = linked[:-1, :-1], linked[:-1, -1], linked[-1, :-1]
    return _reached_states(a, b), _reached_states(a.T, c)


def _reached_states(a: Flags, first: Flags) -> Flags:
    """Return what is reached from `first` by any number of steps; a[i, j]: from j to i."""
    found = first.copy()
    while True:
        more = found | (a[:, found].any(axis=1))
        if (more == found).all():
            return found
        found = more

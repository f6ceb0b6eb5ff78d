"""Harmonic balance of a closed loop: limit cycles of a rig with play or friction.

    x_k+1 = f(x_k; g),     x_k = m + Re(phi e^{i w k})                                       (1)
    (2/P) sum_j f(m + Re(phi e^{i th_j})) e^{-i th_j} = e^{i w} phi                          (2)
    (1/P) sum_j f(m + Re(phi e^{i th_j}))             = m,           th_j = 2 pi (j + 1/2)/P (3)

f is the map of a cycle of all nodes, g a gain in it. (2) and (3) are the describing functions, with
bias, of whatever f has in it that is not linear: of play, of friction, of a limit, of several of
them at once, in the words of their own code. For an amplitude of one state they give phi, m, the
frequency w and the gain g at which such a cycle goes on: a branch g(A), followed from a large
amplitude downwards. Its least gain is where limit cycles begin; where g rises with A they are
stable. Source: Khalil, Nonlinear Systems, 3rd edition, section 7.2, here for a map.

A state that only waits, as the output of a play that is an operator, is no sine: it is carried
along the phases, twice around, in the place of (2) and (3). It does not mind how fast that goes.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pcpc.tools.study.arrays import Complex, Vector

Step = Callable[[Vector, float], Vector]
"""f(x; g): the next state (n,)."""

PHASES = 64
TURNS = np.exp(2j * np.pi * (np.arange(PHASES) + 0.5) / PHASES)  # e^{i th_j}
_CLOSE = 1e-6  # of the residual, relative to the amplitude
_TRIES = 14
_H = 1e-4  # of the differences, relative to the amplitude


@dataclass(frozen=True)
class BalancedCycle:
    """phi (n,), m (n,), w in rad a cycle and the gain g of (2) and (3); `amplitude` of a state."""

    phi: Complex
    mean: Vector
    omega: float
    gain: float
    amplitude: float
    residual: float

    waiting: tuple[int, ...] = ()

    def states(self) -> Iterator[Vector]:
        """Yield the states of (1) at equal phases of a period."""
        for turn in TURNS:
            yield self.mean + (self.phi * turn).real


def first_harmonic(values: Vector) -> Complex:
    """Return the first harmonic of values (P, ...) at equal phases: a for a cos(th).

    The result: (...,), complex.
    """
    return np.asarray(2.0 / PHASES * np.tensordot(np.conj(TURNS), values, 1))


def after_cycle(step: Step, found: BalancedCycle) -> Vector:
    """Return f at the phases of a cycle, (P, n)."""
    states = np.array(list(found.states()))
    held = list(found.waiting)
    if not held:
        return np.array([step(x, found.gain) for x in states])
    kept = states[-1, held]
    new = np.empty((PHASES, len(held)))
    for j in [*range(PHASES), *range(PHASES)]:
        states[j, held] = kept
        kept = new[j] = step(states[j], found.gain)[held]
    at = np.angle(TURNS) % (2.0 * np.pi)
    for i, one in enumerate(held):  # what it is at th was made of th - w
        states[:, one] = np.interp(at - found.omega, at, new[:, i], period=2.0 * np.pi)
    after = np.array([step(x, found.gain) for x in states])
    after[:, held] = new
    return after


def waiting_states(step: Step, found: BalancedCycle) -> tuple[int, ...]:
    """Return the states that are kept as they are at rest, and forgotten at other phases."""
    every = []
    for x in [found.mean, *found.states()]:
        slopes = np.empty(len(x))
        for j in range(len(x)):
            moved = np.array([x, x])
            moved[:, j] += np.array([-0.5, 0.5]) * 1e-6 * max(1e-3, float(np.abs(found.phi[j])))
            low, high = (step(one, found.gain)[j] for one in moved)
            slopes[j] = (high - low) / (moved[1, j] - moved[0, j])
        every.append(slopes)
    seen = np.array(every)
    kept, lost = np.abs(seen - 1.0) < 1e-6, np.abs(seen) < 1e-6
    both = (kept | lost).mean(axis=0) > 0.9
    return tuple(np.flatnonzero(both & kept.any(axis=0) & lost.any(axis=0)).tolist())


def balance(step: Step, at: BalancedCycle, state: int, amplitude: float) -> BalancedCycle | None:
    """Return the cycle in which that state has an amplitude, from one nearby; None if not found."""
    n, unit = len(at.mean), np.abs(at.phi) * amplitude / abs(at.phi[state])
    unit = np.maximum(unit, 1e-9 * unit.max())
    turn = at.phi[state] / abs(at.phi[state])
    phi = at.phi / turn * amplitude / abs(at.phi[state])
    z = np.concatenate(((phi / unit).real, (phi / unit).imag, np.zeros(n), [at.omega, at.gain]))

    def of(z: Vector) -> tuple[Complex, Vector, float, float]:
        phi = (z[:n] + 1j * z[n : 2 * n]) * unit
        return phi, at.mean + z[2 * n : 3 * n] * unit, float(z[3 * n]), float(z[3 * n + 1])

    def wrong(z: Vector) -> Vector:
        phi, mean, omega, gain = of(z)
        after = after_cycle(step, BalancedCycle(phi, mean, omega, gain, amplitude, 0.0, at.waiting))
        first = (first_harmonic(after) - np.exp(1j * omega) * phi) / unit
        size = phi[state] / amplitude
        rest = (after.mean(axis=0) - mean) / unit
        first[list(at.waiting)], rest[list(at.waiting)] = 0.0, 0.0
        return np.concatenate((first.real, first.imag, rest, [size.real - 1.0, size.imag]))

    z, left = _solve(wrong, z)
    if not (left < 100.0 * _CLOSE and z[3 * n + 1] > 0.0):
        return None
    return BalancedCycle(*of(z), amplitude, left, at.waiting)


def _solve(wrong: Callable[[Vector], Vector], z: Vector) -> tuple[Vector, float]:
    """Return where `wrong` is 0, by damped steps of Newton, and the largest rest of it."""
    now = wrong(z)
    for _ in range(_TRIES):
        if np.abs(now).max() < _CLOSE:
            break
        slopes = np.empty((len(now), len(z)))
        for j in range(len(z)):
            moved = z.copy()
            moved[j] += _H
            slopes[:, j] = (wrong(moved) - now) / _H
        if not np.isfinite(slopes).all():
            return z, np.inf
        move, share = np.linalg.lstsq(slopes, -now, rcond=1e-10)[0], 1.0
        while share > 0.05:
            new = wrong(z + share * move)
            if np.linalg.norm(new) < np.linalg.norm(now):
                break
            share *= 0.5
        z, now = z + share * move, wrong(z + share * move)
    return z, float(np.abs(now).max())


def branch(
    step: Step, first: BalancedCycle, state: int, factor: float, most: int
) -> list[BalancedCycle]:
    """Return cycles of falling amplitude, until one is not found, `most` at most."""
    found = [first]
    while len(found) < most:
        new = balance(step, found[-1], state, found[-1].amplitude * factor)
        if new is None:
            new = balance(step, found[-1], state, found[-1].amplitude * factor**0.25)
        if new is None:
            break
        found.append(new)
    return found

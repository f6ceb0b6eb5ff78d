"""What a plant's theorem.py declares: the proofs of its laws, as functions of a run.

    THEOREMS = {"friction_nn": Theorem(prove, ("controller.w1_*", "controller.v_*"), ("s_rate",))}

by the rig's names of the laws. `prove(run)` returns a `Proof` (plants/lyapunov.py) or raises
`NoTheorem` where the case is none of the theorem's. `states` are patterns of variables that no log
keeps, as weights: a replay of the log recomputes them, bit by bit. Parameters of all blocks are
there as well.

A proof is split at its equations: signals of the run, layers that are tuned, the bound by
constants, what is asked; `layered` makes a Proof of them. It writes plant and nodes anew, in numpy
over all cycles at once: a second reading of the equations, independent of the compiled one.

A law reads its weights at the start of a cycle and writes them at its end: what it used in cycle k
is recorded in k - 1, so that proofs begin with the second cycle; see `Cycles.used`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.judging import Run
from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.weights import Layer, State, Vector, Weights, norm
from pcpc.plants.weights import inner as inner  # a part of this contract
from pcpc.plants.weights import size as size

LEAST = 20  # cycles of a stretch
MARGIN = 1.25  # of a compact set over the run
Derived = Callable[[Mapping[str, float]], float]


class NoTheorem(Exception):
    """Why there is none for a run."""


@dataclass(frozen=True)
class Cycles:
    """A run as a proof sees it, from its second cycle on: n cycles, of which n - 1 have a next.

    All columns are those of cycles 1, 2, ...; `used` and `earlier` those of the cycle before each.
    Of a run on clocks it is the longest stretch in which no cycle was skipped and each has the
    records of all other nodes.
    """

    run: Run
    declared: Mapping[str, float] = field(default_factory=dict)  # tuning rates, as the rig has them

    @cached_property
    def stretch(self) -> slice:
        """The rows of the run that are taken, with the one before the first cycle.

        NoTheorem: the log has too few rows.
        """
        recorded = np.ones(len(self.run.cycle), bool)
        for node in self.run.log.node:
            recorded &= self.run.told(node)
        follows = np.diff(self.run.cycle, prepend=self.run.cycle[:1] - 1) == 1
        begins = np.flatnonzero(np.diff(recorded & follows, prepend=False) & recorded & follows)
        best = slice(0, 0)
        for begin in begins:
            over = np.flatnonzero(~(recorded & follows)[begin:])
            end = int(begin + over[0]) if len(over) else len(recorded)
            first = int(begin) - int(begin > 0 and recorded[begin - 1])
            if end - first > best.stop - best.start:
                best = slice(first, end)
        if best.stop - best.start < LEAST:
            raise NoTheorem(f"no {LEAST} cycles in a row have the records of all nodes")
        return best

    @property
    def left_out(self) -> int:
        """How many cycles of the run are not in the stretch."""
        return len(self.run.cycle) - (self.stretch.stop - self.stretch.start)

    @property
    def t_s(self) -> Vector:
        """Time of the cycles. Shape (n,)."""
        return self.run.t_s[self.stretch][1:]

    @property
    def period_s(self) -> float:
        """Of a cycle."""
        return self.run.period_s

    def column(self, name: str) -> Vector:
        """Return a variable `NODE:NAME` (n,)."""
        return self.run[name][self.stretch][1:]

    def earlier(self, name: str) -> Vector:
        """Return a variable as it was in the cycle before each. Shape (n,)."""
        return self.run[name][self.stretch][:-1]

    def columns(self, name: str, count: int = 2) -> Vector:
        """Return NAME with {} for 1 .. count, (n, count)."""
        return np.stack([self.column(name.format(i + 1)) for i in range(count)], axis=1)

    def after(self, values: Vector) -> Vector:
        """Return the values of the next cycle; the last one stays. Both (n, ...)."""
        return np.concatenate((values[1:], values[-1:]))

    def slope(self, values: Vector) -> Vector:
        """Return the difference quotient to the next cycle; 0 of the last one. Both (n, ...)."""
        return (self.after(values) - values) / self.period_s

    def setting(self, name: str) -> float:
        """Return a parameter `NODE:NAME` as the stretch ended."""
        return float(self.run[name][self.stretch][-1])

    def law(self, name: str) -> float:
        """Return a parameter of the controller as the stretch ended."""
        return self.setting(f"executive:controller.{name}")

    def laws(self, *names: str) -> list[float]:
        """Return parameters of the controller as the stretch ended."""
        return [self.law(name) for name in names]

    def settings(self, block: str, names: Sequence[str]) -> list[float]:
        """Return parameters of a block `NODE:BLOCK.` as the stretch ended."""
        return [self.setting(block + name) for name in names]

    def rate(self, name: str) -> float:
        """Return a tuning rate as the rig declares it, whatever the run tuned by."""
        return self.declared[name] if name in self.declared else self.law(name)

    def array(self, name: str, *shape: int) -> Vector:
        """Return a state of a block as it was at the end of each cycle, (n, *shape)."""
        return self._array(name, *shape)[1:]

    def used(self, name: str, *shape: int) -> Vector:
        """Return a state of a block as each cycle found it, (n, *shape)."""
        return self._array(name, *shape)[:-1]

    def moved(self, name: str, *shape: int) -> Vector:
        """Return what each cycle adds to a state of a block, (n, *shape)."""
        return self.array(name, *shape) - self.used(name, *shape)

    def state(self, name: str, *shape: int) -> State:
        """Return weights of a block as each cycle found them and moves them, (n, *shape)."""
        return State(self.used(name, *shape), self.moved(name, *shape))

    def _array(self, name: str, *shape: int) -> Vector:
        size = int(np.prod(shape))
        columns = [self.run[f"{name}_{i}"][self.stretch] for i in range(size)]
        return np.stack(columns, axis=1).reshape(-1, *shape)


@dataclass(frozen=True)
class Theorem:
    """A proof, the states that it needs beside what a log has, and the law's tuning rates.

    `rates`: parameters of the block `block`, by which all that is tuned goes; `derived`: of such as
    are no settings, the setting that says them, and what they are by all settings.
    """

    prove: Callable[[Cycles], Proof]
    states: Sequence[str] = ()
    rates: Sequence[str] = ()
    block: str = "controller"
    derived: Mapping[str, tuple[str, Derived]] = field(default_factory=dict)

    @property
    def said_by(self) -> list[str]:
        """The settings that say the rates."""
        return [self.derived[name][0] if name in self.derived else name for name in self.rates]

    def declared(self, settings: Mapping[str, float]) -> dict[str, float]:
        """Return the rates by the settings of the block."""
        return {
            name: self.derived[name][1](settings) if name in self.derived else settings[name]
            for name in self.rates
        }


def fitted_weights(nodes: Vector, wanted: Vector, ridge: float = 1e-2) -> Vector:
    """Return W (k, m) of least |nodes W - wanted|^2/n + ridge |W|^2; nodes (n, k), wanted (n, m).

    Of `wanted` (n,) it is (k,). The ridge keeps weights small that the run does not tell.
    """
    columns = wanted.reshape(len(nodes), -1)
    square = nodes.T @ nodes / len(nodes) + ridge * np.eye(nodes.shape[1])
    found = np.linalg.solve(square, nodes.T @ columns / len(nodes))
    return np.asarray(found.reshape(-1, *wanted.shape[1:]), np.float64)


def around(values: Vector, draw: np.random.Generator, count: int) -> Vector:
    """Return values drawn from 1.25 times the ranges of a run's, (n, ...) to (count, ...)."""
    high, low = values.max(axis=0), values.min(axis=0)
    middle, half = 0.5 * (high + low), 0.5 * MARGIN * (high - low)
    return draw.uniform(middle - half, middle + half, (count, *values.shape[1:]))


def logistic(z: Vector) -> Vector:
    """Return 1/(1 + exp(-z)). The shape is that of z."""
    return 0.5 + 0.5 * np.tanh(0.5 * z)


def with_threshold(nodes: Vector) -> Vector:
    """Return nodes (n, k) behind a column of 1."""
    return np.concatenate((np.ones((len(nodes), 1)), nodes), axis=1)


def read_out(w: Vector, nodes: Vector) -> Vector:
    """Return w's of each cycle, (n, m); w (n, k, m), nodes (n, k)."""
    return np.einsum("nkm,nk->nm", w, nodes)


def linearised(phi: Vector, v: Vector, x: Vector, v_lacks: Vector) -> tuple[Vector, ...]:
    """Return s - s'z, s' and s'V~'x of logistic nodes s, z = V'x; v (n, i, k), x (n, i).

    phi (n, 1 + k + ...): 1, s, and nodes that V does not reach, which stay in the first.
    `v_lacks` as v.
    """
    inside = slice(1, 1 + v.shape[2])
    slope = phi[:, inside] * (1.0 - phi[:, inside])
    flat = phi.copy()
    flat[:, inside] -= slope * np.einsum("nij,ni->nj", v, x)
    return flat, slope, slope * np.einsum("nij,ni->nj", v_lacks, x)


def dyads(a: Vector, b: Vector) -> Vector:
    """Return ab' of each cycle, (n, p, q); a (n, p), b (n, q)."""
    return a[:, :, None] * b[:, None, :]


def layered(
    run: Cycles,
    about: tuple[str, str],
    layers: Sequence[Layer],
    *,
    v: Vector,
    damping: Vector,
    terms: Mapping[str, Vector],
    error: Vector,
    rest: Vector,
    constants: Constants,
    asked: Sequence[Assumption],
    rates: Sequence[Layer] = (),
    scale: float = 1.0,
    beyond: Mapping[str, Vector] | None = None,
    extra: Vector | None = None,
    step_s: float | None = None,
) -> Proof:
    """Return a proof with what follows from its layers: their part of V, Z~, gamma, the rates.

    `about`: theorem and error; `v`: V without the layers, which come in times `scale`; `rates`:
    the layers' parts by rate, if those are not the layers. As of `constants`, gamma is found.
    """
    tuned = rates or layers
    return Proof(
        *about,
        t_s=run.t_s,
        v=v + scale * np.asarray(sum(one.energy for one in tuned)),
        damping=damping,
        terms=terms,
        error=error,
        weights=norm(*(one.lacks for one in layers)),
        rest=rest,
        constants=replace(constants, gamma=min(one.metric for one in tuned) / scale),
        tuned=tuned,
        beyond=beyond or {},
        asked=(rates_positive(tuned), *asked),
        step_s=step_s,
        extra=extra,
    )


def rates_positive(weights: Sequence[Weights]) -> Assumption:
    """Return whether all tuning rates are above 0: a network that rests has no theorem."""
    dead = [one.name for one in weights if not one.rate > 0.0]
    rates = (
        f"{', '.join(dead)} not above 0"
        if dead
        else ", ".join(f"{one.name} {one.rate:g}" for one in weights)
    )
    return Assumption("tuning rates above 0", not dead, rates, needed=True)


def positive(what: str, value: float) -> Assumption:
    """Return whether what the proof cannot do without is above 0; `what` ends in its symbol."""
    return Assumption(f"{what} above 0", value > 0.0, f"{what.split()[-1]} {value:g}", needed=True)


def switched_on(run: Cycles, claim: str, *names: str) -> Assumption:
    """Return whether switches of the law, without which nothing is tuned, are on."""
    found = {name: run.law(name) for name in names}
    words = ", ".join(f"{name} {value:g}" for name, value in found.items())
    return Assumption(claim, all(value > 0.5 for value in found.values()), words, needed=True)


def never(claim: str, wrong: NDArray[np.bool_], words: str) -> Assumption:
    """Return whether a cycle is `wrong`, (n,); `words` have {} for the share of those that are."""
    share = f"{100.0 * float(np.mean(wrong)):.3g} % of the cycles"
    return Assumption(claim, not wrong.any(), words.format(share))


def acting(wanted: Vector, acts: Vector, unit: str) -> Assumption:
    """Return whether what acts is what the law wants: no limit, quantum, delay; (n, m) both."""
    gap = size(acts - wanted)[:-1]
    words = f"differs by up to {gap.max(initial=0.0):.2g} {unit}, in {{}}"
    return never("what acts is what the law computes", gap > 1e-9, words)


Told = Cycles  # the names until 0.1

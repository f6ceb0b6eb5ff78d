"""What runs made up for the proofs of the books are made of.

Free signals are sines of about 1, so that no term of a proof is small. The rest follows from the
equations that it begins with, in steps of `T`: a third time, after law and theorem.py.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from pcpc.plants.judging import Run
from pcpc.plants.theorem import Cycles
from pcpc.plants.weights import Vector

N, T = 200, 1e-7
LAW = "executive:controller."
Columns = dict[str, Any]


@dataclass
class Made:
    """Columns by name, rows of cycles; a number is a parameter. `declared`: tuning rates."""

    columns: Columns
    declared: dict[str, float]
    period_s: float = T
    log: Any = field(default_factory=lambda: SimpleNamespace(node={}))
    cycle: Vector = field(default_factory=lambda: np.arange(N))

    @property
    def t_s(self) -> Vector:
        """Time of the rows."""
        return self.cycle * self.period_s

    def __getitem__(self, name: str) -> Vector:
        """Return a column."""
        return np.broadcast_to(self.columns[name], N)

    def cycles(self, **changed: Any) -> Cycles:
        """Return it as a proof sees it, with other columns or parameters by the end of a name."""
        known = {old for old in self.columns for new in changed if old.endswith(new)}
        assert len(known) >= len(changed), changed
        own = {old: new for old in known for end, new in changed.items() if old.endswith(end)}
        return Cycles(cast(Run, Made(self.columns | own, self.declared)), self.declared)


class Free:
    """What is drawn."""

    def __init__(self, seed: int) -> None:
        self.draw = np.random.default_rng(seed)

    def waves(self, *shape: int, size: float = 1.0) -> tuple[Vector, Vector, Vector]:
        """Return sines of all rows with both derivatives, (N, *shape) each."""
        a, w = self.draw.uniform(0.5, 1.5, shape) * size, self.draw.uniform(2.0, 9.0, shape)
        angle = np.multiply.outer(T * np.arange(N), w) + self.draw.uniform(0.0, 6.0, shape)
        return a * np.sin(angle), a * w * np.cos(angle), -a * w**2 * np.sin(angle)

    def wave(self, *shape: int, size: float = 1.0) -> Vector:
        """Return sines alone."""
        return self.waves(*shape, size=size)[0]

    def numbers(self, *shape: int) -> Vector:
        """Return numbers of about 1, of either sign."""
        return self.draw.normal(size=shape)


def stepped(start: tuple[Vector, ...], slopes: Callable[..., tuple[Any, ...]]) -> list[Vector]:
    """Return states, a row a cycle as it begins, and where the last one ends, (N + 1, ...) each.

    `slopes(k, *states)`: their derivatives in cycle k.
    """
    found = [tuple(start)]
    for k in range(N):
        found.append(
            tuple(x + T * dx for x, dx in zip(found[k], slopes(k, *found[k]), strict=True))
        )
    return [np.array(one) for one in zip(*found, strict=True)]


def state(name: str, ends: Vector) -> Columns:
    """Return the columns of a state by its values as cycles end."""
    flat = ends.reshape(len(ends), -1)
    return {f"{name}_{i}": flat[:, i] for i in range(flat.shape[1])}


def weights(name: str, begins: Vector, *room: int, first: Vector | None = None) -> Columns:
    """Return the columns of weights (N + 1, ...), in a block with room for more.

    `first`: instead of what the first cycle leaves, so that V* is not V.
    """
    whole = np.full((N, *(room or begins.shape[1:])), 7.0)
    inside = tuple(slice(0, n) for n in begins.shape[1:])
    whole[:, *inside] = begins[1:]
    if first is not None:
        whole[0, *inside] = first
    return state(LAW + name, whole)


def late(values: Vector) -> Vector:
    """Return what acts in a cycle as the next one's record tells it."""
    return np.concatenate((values[:1], values[:-1]))


def each(name: str, values: Vector) -> Columns:
    """Return the columns NAME with {} for 1, 2 of values (N, 2)."""
    return {name.format(j + 1): values[:, j] for j in range(2)}


def under(prefix: str, **values: Any) -> Columns:
    """Return columns, or parameters, of a block."""
    return {prefix + name: value for name, value in values.items()}


def law(**values: Any) -> Columns:
    """Return columns, or parameters, of the controller."""
    return under(LAW, **values)


def logistic(z: Vector) -> Vector:
    """Return 1/(1 + exp(-z))."""
    return 1.0 / (1.0 + np.exp(-z))

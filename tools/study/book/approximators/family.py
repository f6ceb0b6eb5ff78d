"""One interface for all approximators: a thin object over the compiled functions of its file.

    y = net.eval(x)                 output
    phi, jac = net.hidden(x)        hidden vector; its derivative by what V moves, (phi, *)
    W, V = net.weights()            views: output weights, tunable inner weights (may be empty)
    dW, dV = net.gradient(x, E)     phi E' and jac'W E: backpropagation's direction for E = y_d - y
    net.step(dW, dV)                W <- W + dW, V <- V + dV, then limits that the net has

So `net.step(*(eta * d for d in net.gradient(x, E)))` tunes any of them: eta times the negative
gradient of |E|^2/2. What is random is drawn from the constructor's seed; W starts at 0. A law does
not call the object: its step calls the compiled functions on its own views, and its `prepare` may
take the first weights from an object.

x (n,), E and y (m,), W (nodes, m). Source: Lewis, Campos, Selmic (SIAM 2002), chapters 1 and 3.
"""

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcpc.executive.laws.approximators.activations import LOGISTIC
from pcpc.tools.study.book.approximators import backprop, cmac, fuzzy, jumps, rbf, rvfl

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """A grid over low..high with counts[k] centres on input k, at least 2; all (n,)."""

    low: Sequence[float]
    high: Sequence[float]
    counts: Sequence[int]

    def __post_init__(self) -> None:
        rows = list(zip(self.low, self.high, self.counts, strict=True))
        if not all(low < high and count >= 2 for low, high, count in rows):
            raise ValueError(f"{self}: expected low < high and 2 or more centres for every input")

    def spacing(self, fewer: int = 1) -> Array:
        """Return (high - low)/(count - fewer) of every input."""
        return (np.array(self.high) - np.array(self.low)) / (np.array(self.counts) - fewer)


class Approximator(ABC):
    """What all have in common; see the module header."""

    def __init__(self, inputs: int, nodes: int, outputs: int) -> None:
        self.inputs, self.nodes, self.outputs = inputs, nodes, outputs
        self._w = np.zeros((nodes, outputs))
        self._v = np.zeros(0)

    @abstractmethod
    def hidden(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return phi (nodes,) and its derivative by what V moves, (nodes, *)."""

    def eval(self, x: ArrayLike) -> Array:
        """Return y (m,)."""
        phi, _ = self.hidden(x)
        y = np.zeros(self.outputs)
        backprop.output(phi, self._w, y)
        return y

    def weights(self) -> tuple[Array, Array]:
        """Return W (nodes, m) and V, the arrays themselves; V is (0,) where jac is empty."""
        return self._w, self._v

    def gradient(self, x: ArrayLike, error: ArrayLike) -> tuple[Array, Array]:
        """Return dW = phi E' and dV, the direction of backpropagation for the error (m,)."""
        phi, jac = self.hidden(x)
        e = np.asarray(error, float)
        return np.outer(phi, e), self._inner(x, jac.T @ (self._w @ e))

    def step(self, dw: ArrayLike, dv: ArrayLike = 0.0) -> None:
        """Add to W and V in place, arrays of their shape."""
        self._w += np.asarray(dw, float)
        self._v += np.asarray(dv, float)

    def _inner(self, x: ArrayLike, back: Array) -> Array:
        """Return dV from jac'W E."""
        return back

    def _checked_input(self, x: ArrayLike) -> Array:
        point = np.asarray(x, float)
        if point.shape != (self.inputs,):
            raise ValueError(f"input of shape {point.shape}: expected ({self.inputs},)")
        return point


def _smooth(kind: int, x: Array, v: Array) -> tuple[Array, Array]:
    """Return s (L+1,) and its derivative ds/dz (L+1, L); the first row, the threshold's, is 0."""
    nodes = v.shape[1]
    z, slope, s = np.zeros(nodes), np.zeros(nodes), np.zeros(nodes + 1)
    backprop.hidden(kind, x, v, z, s, slope)
    return s, np.vstack((np.zeros(nodes), np.diag(slope)))


class TwoLayer(Approximator):
    """backprop.py: V (n+1, L) drawn uniformly in +-spread, jac = ds/dz (L+1, L).

    With `count`, jumps.py (6): jump nodes k < count at x_1 = c beside it, W = [W_1; W_2].
    """

    def __init__(
        self,
        inputs: int,
        nodes: int,
        outputs: int,
        seed: int,
        spread: float = 1.0,
        kind: int = LOGISTIC,
        c: float = 0.0,
        count: int = 0,
        jump: int = jumps.SIGMOID,
    ) -> None:
        super().__init__(inputs, nodes + 1 + count, outputs)
        self.kind, self.c, self.count, self.jump = kind, c, count, jump
        self._v = np.random.default_rng(seed).uniform(-spread, spread, (inputs + 1, nodes))

    def hidden(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return [s; phi] (nodes,) and [s'; 0] (nodes, L): what the jump nodes are is fixed."""
        point = self._checked_input(x)
        s, jac = _smooth(self.kind, point, self._v)
        phi = np.zeros(self.count)
        jumps.jump_nodes(self.jump, float(point[0]) - self.c, self.count, phi, 0)
        return np.concatenate((s, phi)), np.vstack((jac, np.zeros((self.count, jac.shape[1]))))

    def _inner(self, x: ArrayLike, back: Array) -> Array:
        return np.outer(np.concatenate(([1.0], self._checked_input(x))), back)

    def hebbian(
        self,
        x: ArrayLike,
        error: ArrayLike,
        f: float,
        g: float,
        leak: float = 0.0,
        limit: float = math.inf,
    ) -> None:
        """One step of Hebbian tuning, backprop.py (7); warns if there is no leak and no limit."""
        if leak == 0.0 and limit == math.inf:
            growth = "Hebbian tuning: |V| grows without bound; give a leak or a limit"
            warnings.warn(growth, stacklevel=2)
        s, _ = self.hidden(x)
        e = np.asarray(error, float)
        backprop.tune_hebbian(f, g, leak, limit, e, self._checked_input(x), s, self._w, self._v)


class Fixed(Approximator):
    """A net of which W alone is tuned: phi (nodes,) is a function of x, jac is empty."""

    def __init__(
        self, inputs: int, nodes: int, outputs: int, phi: Callable[[Array], Array]
    ) -> None:
        super().__init__(inputs, nodes, outputs)
        self._phi = phi

    def hidden(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return phi (nodes,)."""
        return self._phi(self._checked_input(x)), np.zeros((self.nodes, 0))


def rvfl_net(
    low: Sequence[float], high: Sequence[float], nodes: int, outputs: int, seed: int
) -> Fixed:
    """Return rvfl.py's: the first layer is drawn in the region low..high and stays."""
    first_layer = rvfl.first_layer(seed, low, high, nodes)
    return Fixed(len(low), nodes + 1, outputs, lambda x: _smooth(LOGISTIC, x, first_layer)[0])


def rbf_net(grid: Grid, outputs: int) -> Fixed:
    """Return rbf.py's (2) to (4): Gaussians on a grid, one-sided edges."""
    low, spacing, counts = np.array(grid.low, float), grid.spacing(), np.array(grid.counts, float)

    def phi(x: Array) -> Array:
        nodes, factors = np.zeros(math.prod(grid.counts)), np.zeros(sum(grid.counts))
        rbf.grid(x, low, spacing, counts, factors, nodes)
        return nodes

    return Fixed(len(low), math.prod(grid.counts), outputs, phi)


def triangle_net(grid: Grid, outputs: int) -> Fixed:
    """Return fuzzy.py's (4): a full grid of triangles, equal to Cmac of order 2."""
    counts, centres = np.array(grid.counts, float), _centres(grid)
    rules = fuzzy.full_grid(grid.counts)

    def phi(x: Array) -> Array:
        nodes, member = np.zeros(len(rules)), np.zeros(len(centres))
        fuzzy.triangles(x, counts, centres, member)
        fuzzy.by_product(member, rules, nodes)
        return nodes

    return Fixed(len(counts), len(rules), outputs, phi)


class Cmac(Approximator):
    """cmac.py: triangles (order 2) or cubic B-splines (order 4) by index; jac is empty."""

    def __init__(self, grid: Grid, outputs: int, order: int = 2) -> None:
        if order not in (2, 4) or min(grid.counts) < order:
            raise ValueError(f"{grid}: order {order}: expected 2 or 4, and so many centres an axis")
        super().__init__(len(grid.counts), math.prod(grid.counts), outputs)
        self.order = order
        self._low, self._d = np.array(grid.low, float), grid.spacing(order - 1)
        self._counts = np.array(grid.counts, float)

    def touched(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return index and value of the nodes that x touches, each of shape (order^n,)."""
        size = self.order**self.inputs
        index, value, work = np.zeros(size), np.zeros(size), np.zeros(self.order)
        point = self._checked_input(x)
        cmac.touched(self.order, point, self._low, self._d, self._counts, index, value, work)
        return index, value

    def hidden(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return phi (nodes,), nearly all zero; `eval` does without it."""
        index, value = self.touched(x)
        phi = np.zeros(self.nodes)
        phi[index.astype(int)] = value
        return phi, np.zeros((self.nodes, 0))

    def eval(self, x: ArrayLike) -> Array:
        """Return y (m,) from the nodes touched."""
        index, value = self.touched(x)
        y = np.zeros(self.outputs)
        cmac.output(index, value, len(index), self._w, y)
        return y


class Fuzzy(Approximator):
    """fuzzy.py (5) to (10): a full grid of tunable Gaussian sets; V = [a; b], jac (rules, 2 sets).

    The sets start on the grid, neighbours crossing at 1/2; |a| stays within 0.1 to 10 times that.
    """

    RANGE = 10.0

    def __init__(self, grid: Grid, outputs: int) -> None:
        super().__init__(len(grid.counts), math.prod(grid.counts), outputs)
        width = rbf.CROSSING / np.repeat(grid.spacing(), grid.counts)
        self._rules = fuzzy.full_grid(grid.counts)
        self._v = np.concatenate((width, _centres(grid)))
        self._sets = len(width)
        self._limits = float(width.min()) / self.RANGE, float(width.max()) * self.RANGE

    def hidden(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return phi (rules,) and d phi/d[a; b], D of ln mu_l less its mean, times phi_l."""
        point = self._checked_input(x)
        a, b = self._v[: self._sets], self._v[self._sets :]
        phi = np.zeros(self.nodes)
        fuzzy.by_logarithm(point, self._rules, a, b, phi)
        log_slope = np.zeros((self.nodes, 2 * self._sets))
        for k in range(self.inputs):
            sets = self._rules[:, k].astype(int)
            distance, rules = point[k] - b[sets], np.arange(self.nodes)
            log_slope[rules, sets] = -2.0 * a[sets] * distance * distance
            log_slope[rules, self._sets + sets] = 2.0 * a[sets] * a[sets] * distance
        return phi, phi[:, None] * (log_slope - phi @ log_slope)

    def step(self, dw: ArrayLike, dv: ArrayLike = 0.0) -> None:
        """Add to W and V in place, then keep |a| in its limits (10)."""
        super().step(dw, dv)
        fuzzy.clamp(self._v[: self._sets], *self._limits)


def _centres(grid: Grid) -> Array:
    """Return the centres of all sets, input by input."""
    axes = zip(grid.low, grid.high, grid.counts, strict=True)
    return np.concatenate([np.linspace(*axis) for axis in axes])

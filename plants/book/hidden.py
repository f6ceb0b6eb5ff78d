"""The hidden layer of a proof: logistic nodes whose weights a law tunes."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pcpc.plants.theorem import dyads, linearised, logistic, size, with_threshold
from pcpc.plants.weights import Layer, State, Vector


@dataclass(frozen=True)
class Hidden:
    """Logistic nodes s(z), z = V'x, of a law over n cycles; V* is V as drawn, the first of the run.

    v: V (n, i, k); x (n, i); nodes (n, 1 + k + ...): 1, s, and nodes that V does not reach.
    """

    v: State
    x: Vector
    nodes: Vector

    @classmethod
    def of(cls, v: State, x: Vector) -> "Hidden":
        """Return those whose nodes are 1 and s(V'x)."""
        return cls(v, x, with_threshold(logistic(np.einsum("nij,ni->nj", v.w, x))))

    @property
    def ideal(self) -> Vector:
        """V* (i, k)."""
        return self.v.w[0]

    @cached_property
    def known(self) -> Vector:
        """The nodes as V* has them; as `nodes`."""
        inside = with_threshold(logistic(self.x @ self.ideal))
        return np.concatenate((inside, self.nodes[:, inside.shape[1] :]), axis=1)

    @cached_property
    def linear(self) -> tuple[Vector, ...]:
        """What `linearised` returns of them."""
        return linearised(self.nodes, self.v.w, self.x, self.ideal - self.v.w)

    def layer(self, name: str, rate: float, back: Vector, leak: Vector | float) -> Layer:
        """Return V with V' = rate (x back' - leak V); `back` (n, k), what comes back through s'."""
        return self.v.layer(name, rate, self.ideal, dyads(self.x, back), leak)

    def constants(self, w: float, eps: float) -> tuple[float, float, float]:
        """Return |Z*|, c0, c1 of lyapunov.py for |W*| and the largest eps, with x of the run.

        s, s* are within 0 and 1, |s'| <= 1/4: |s* - s - s'(z* - z)| <= sqrt(k) + |V~||x|/4.
        """
        v, nodes = float(np.linalg.norm(self.ideal)), self.v.w.shape[2]
        reach = float(size(self.x @ self.ideal).max()) + w * float(size(self.x).max())
        return math.hypot(w, v), eps + w * math.sqrt(nodes), reach / 4.0

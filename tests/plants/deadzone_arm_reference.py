"""The dual-network arm once more, straight from its equations in plain numpy: no code in common.

Matrices as the proofs write them, one array a network; the plant's Runge-Kutta over whole vectors.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
M1, M2, A1, A2 = 1.8, 1.3, 1.0, 1.0
LAM, KV, U_MAX = 7.0, 15.0, 150.0


def inertia(q: Array) -> Array:
    c = np.cos(q[1])
    off = M2 * A2**2 + M2 * A1 * A2 * c
    return np.array(
        [[(M1 + M2) * A1**2 + M2 * A2**2 + 2 * M2 * A1 * A2 * c, off], [off, M2 * A2**2]]
    )


def coriolis(q: Array, v: Array) -> Array:
    h = M2 * A1 * A2 * np.sin(q[1])
    return np.array([[-h * v[1], -h * (v[0] + v[1])], [h * v[0], 0.0]])


def deadzone(u: Array) -> Array:
    return np.where(u > 25.0, 1.5 * (u - 25.0), np.where(u < -20.0, 0.8 * (u + 20.0), 0.0))


def move(state: Array, tau: Array, ts: float, substeps: int = 4) -> Array:
    """Return q, v after `ts` under a constant torque."""

    def rate(s: Array) -> Array:
        q, v = s[:2], s[2:]
        return np.concatenate((v, np.linalg.solve(inertia(q), tau - coriolis(q, v) @ v)))

    h = ts / substeps
    for _ in range(substeps):
        k1 = rate(state)
        k2 = rate(state + h / 2 * k1)
        k3 = rate(state + h / 2 * k2)
        k4 = rate(state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


def sgm(x: Array) -> Array:
    return 0.5 * (1.0 + np.tanh(0.5 * x))


@dataclass
class Networks:
    """Both networks of both joints; rows are joints."""

    seed: int = 11
    positive_slope: bool = True
    s_rate: float = 24.0
    t_rate: float = 500.0
    k1: float = 1e-3
    k2: float = 1e-4
    nodes: int = 20
    weights: dict[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        g, n = np.random.default_rng(self.seed), self.nodes
        rows: dict[str, list[Array]] = {k: [] for k in ("V", "v0", "W", "Vi", "v0i")}
        for _ in range(2):
            rows["V"].append(g.uniform(0, 1, n) * np.where(g.random(n) < 0.5, -1, 1))
            rows["v0"].append(g.uniform(-35, 35, n))
            rows["W"].append(g.uniform(-50, 50, n))
            rows["Vi"].append(g.uniform(0, 1, n) * np.where(g.random(n) < 0.5, -1, 1))
            rows["v0i"].append(g.uniform(-35, 35, n))
        self.weights = {k: np.array(v) for k, v in rows.items()}
        if self.positive_slope:
            self.weights["W"] = np.abs(self.weights["W"]) * np.sign(self.weights["V"])
        self.weights["Wi"] = np.zeros((2, n + 2))

    def compensator(self, w: Array) -> tuple[Array, Array]:
        """Return y (2,) and sigma_i (2, nodes + 2)."""
        x = self.weights
        jumps = np.stack(
            [np.where(w >= 0, 1.0, 0.0), np.where(w >= 0, 1 - np.exp(-np.maximum(w, 0)), 0.0)], 1
        )
        s = np.hstack([sgm(x["Vi"] * w[:, None] + x["v0i"]), jumps])
        return (x["Wi"] * s).sum(1), s

    def slope(self, u: Array) -> tuple[Array, Array]:
        """Return J (2,) and sgm' V (2, nodes)."""
        x = self.weights
        z = sgm(x["V"] * u[:, None] + x["v0"])
        b = z * (1 - z) * x["V"]
        return (x["W"] * b).sum(1), b

    def tune(self, ts: float, r: Array, y: Array, s: Array, slope: Array, b: Array) -> None:
        """One step of both tuning laws, old weights on the right."""
        x, size = self.weights, float(np.linalg.norm(r))
        wi_norm = np.linalg.norm(x["Wi"])
        fall = 1 + ts * self.t_rate * (self.k1 * size + self.k2 * size * wi_norm)
        grown = x["Wi"] + ts * self.t_rate * s * (r * slope)[:, None]
        x["W"] = (x["W"] - ts * self.s_rate * b * (y * r)[:, None]) / (
            1 + ts * self.s_rate * self.k1 * size
        )
        x["Wi"] = grown / fall


def control(
    net: Networks | None, ts: float, desired: tuple[Array, Array, Array], state: Array
) -> tuple[Array, Array]:
    """Return u (2,) and e (2,) of one tick, tuning included; `net` None is PD alone."""
    q, v = state[:2], state[2:]
    e, de = desired[0] - q, desired[1] - v
    r = de + LAM * e
    f = inertia(q) @ (desired[2] + LAM * de) + coriolis(q, v) @ (desired[1] + LAM * e)
    w = f + KV * r
    if net is None:
        return np.clip(w, -U_MAX, U_MAX), e
    y, s = net.compensator(w)
    slope, b = net.slope(w + y)
    net.tune(ts, r, y, s, slope, b)
    return np.clip(w + y, -U_MAX, U_MAX), e


def desired(kind: str, t: float) -> tuple[Array, Array, Array]:
    if kind == "step":
        return np.ones(2), np.zeros(2), np.zeros(2)
    return np.full(2, np.sin(t)), np.full(2, np.cos(t)), np.full(2, -np.sin(t))


def run(kind: str, net: Networks | None, ticks: int, ts: float = 1e-3, delay: int = 0) -> Array:
    """Return [e1, e2, q1, q2, v1, v2, u1, u2] by tick."""
    state, rows = np.zeros(4), []
    line = [np.zeros(2)] * delay
    for k in range(ticks):
        u, e = control(net, ts, desired(kind, k * ts), state)
        rows.append(np.concatenate((e, state, u)))
        line.append(u)
        state = move(state, deadzone(line.pop(0)), ts)
    return np.array(rows)

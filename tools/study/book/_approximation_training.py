"""The nets of `pcpc experiment approximation`: on-line, batch and Levenberg-Marquardt training.

    theta = [V_1, W_1, W_2]            W_2: weights of the jump nodes, none for a standard net  (1)
    J     = mean E^2                   over the training grid                                   (2)
    d     = mc d_previous + (1 - mc) lr (-grad J),  theta <- theta + d                          (3)
    J > 1.04 J_previous:  step refused, lr <- 0.7 lr, d = 0;  J < J_previous:  lr <- 1.05 lr    (4)

lr starts at 0.01, mc = 0.9. First layer: random unit directions times 1.4 L^(1/n)/half range,
thresholds uniform within +-1.4 L^(1/n), W_1 uniform within +-0.1, W_2 = 0, drawn in the order
directions (n, L), thresholds, W_1. (3) (4) is the batch backpropagation with momentum and adaptive
rate of the neural-network toolboxes of the 1990s: chosen, the book names none.

Source of functions and nets: Lewis, Campos, Selmic (SIAM 2002), chapters 1 and 3.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import compiled, inline
from pcpc.executive.laws.approximators.activations import LOGISTIC
from pcpc.tools.study.book.approximators import backprop, jumps

Array = NDArray[np.float64]

EPOCHS = 10_000
MOMENTUM, RATE = 0.9, 0.01
WORSE, SHRINK, GROW = 1.04, 0.7, 1.05
LM_STEPS = 100
FAR_CELLS = 2.0  # of the training grid: what counts as away from the jump


@dataclass(frozen=True)
class Case:
    """A function with a jump at x_1 = c, its net and grids over +-half_range."""

    title: str
    function: Callable[[Array], Array]  # (points, n) -> (points,)
    c: float
    nodes: int
    inputs: int
    half_range: float
    train_points: int
    test_points: int

    def grid(self, points: int) -> Array:
        """Return the grid (points^n, n), first input slowest."""
        line = np.linspace(-self.half_range, self.half_range, points)
        axes = np.meshgrid(*([line] * self.inputs), indexing="ij")
        return np.stack([axis.ravel() for axis in axes], axis=1)

    def cell(self) -> float:
        """Return the spacing of the training grid."""
        return 2.0 * self.half_range / (self.train_points - 1)


def _case1(title: str, function: Callable[[Array], Array], c: float) -> Case:
    return Case(title, lambda x: function(x[:, 0]), c, 20, 1, 3.0, 121, 1000)


def _case2(title: str, function: Callable[[Array, Array], Array], nodes: int) -> Case:
    return Case(title, lambda x: function(x[:, 0], x[:, 1]), 0.0, nodes, 2, 1.0, 21, 80)


CASES = {
    "sin1d": _case1(
        "sin x for x < -1, else 1 + sin x", lambda x: np.sin(x) + np.where(x < -1, 0, 1), -1.0
    ),
    "lin1d": _case1("x for x < 0, else 0.5 x + 1", lambda x: np.where(x < 0, x, 0.5 * x + 1), 0.0),
    "lin2d": _case2(
        "x1 + x2 for x1 < 0, else 0.5 x1 + x2 + 1",
        lambda x, y: np.where(x < 0, x + y, 0.5 * x + y + 1), 25,
    ),
    "quad2d": _case2(
        "x1^2 + x2^2 for x1 < 0, else 0.5 x1^2 + x2^2 + 1",
        lambda x, y: np.where(x < 0, x * x + y * y, 0.5 * x * x + y * y + 1), 20,
    ),
    "varjump2d": _case2(
        "x1 + x2 for x1 < 0, else x1 - x2 + 1", lambda x, y: np.where(x < 0, x + y, x - y + 1), 25
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Net:
    """A net to train: jump nodes at `c` of basis `jump`, or none if `jump` is None."""

    case: str
    seed: int
    jump: int | None = None
    c: float = 0.0
    trainer: str = "batch"  # or "lm"

    def count(self) -> int:
        """Return the number of jump nodes: the step and the kink."""
        return 0 if self.jump is None else 2

    def jump_hidden(self, x: Array) -> Array:
        """Return the jump nodes (points, count) at x (points, n)."""
        phi = np.zeros((len(x), self.count()))
        for row, z in zip(phi, x[:, 0] - self.c, strict=True):
            if self.jump is not None:
                jumps.jump_nodes(self.jump, float(z), 2, row, 0)
        return phi


@dataclass(frozen=True)
class TrainedNet:
    """A trained net and its errors: rms on training and test grid, largest, away from the jump."""

    net: Net
    theta: Array
    train: float
    test: float
    largest: float
    far: float


def first_weights(case: Case, seed: int, extra: int) -> Array:
    """Return theta (1) as drawn."""
    draw, n, nodes = np.random.default_rng(seed), case.inputs, case.nodes
    size = 1.4 * nodes ** (1.0 / n)
    directions = draw.standard_normal((n, nodes))
    directions /= np.linalg.norm(directions, axis=0)
    thresholds = draw.uniform(-size, size, nodes)
    w = draw.uniform(-0.1, 0.1, nodes + 1)
    v = np.vstack((thresholds, directions * size / case.half_range))
    return np.concatenate((v.ravel(), w, np.zeros(extra)))


@inline
def layers(theta: Any, nodes: int, inputs: int) -> tuple[Any, Any]:
    """Return V_1 with its thresholds (n+1, L) and [W_1; W_2] (*, 1), views of theta (1)."""
    size = (inputs + 1) * nodes
    return theta[:size].reshape(inputs + 1, nodes), theta[size:].reshape(len(theta) - size, 1)


@compiled()
def evaluate(theta: Any, nodes: int, x: Any, phi: Any, y: Any, s: Any) -> None:
    """Write the net's output at `x` (points, n) to `y`, its hidden vectors to `s` (points, *)."""
    v, w = layers(theta, nodes, x.shape[1])
    z, slope, out = np.empty(nodes), np.empty(nodes), np.empty(1)
    for i in range(len(x)):
        backprop.hidden(LOGISTIC, x[i], v, z, s[i], slope)
        for k in range(phi.shape[1]):
            s[i, nodes + 1 + k] = phi[i, k]
        backprop.output(s[i], w, out)
        y[i] = out[0]


@compiled()
def downhill(theta: Any, nodes: int, x: Any, phi: Any, target: Any, down: Any) -> float:
    """Return J (2), write -grad J to `down`."""
    points = len(x)
    v, w = layers(theta, nodes, x.shape[1])
    down_v, down_w = layers(down, nodes, x.shape[1])
    gain, loss = 2.0 / points, 0.0
    z, slope, b, s = np.empty(nodes), np.empty(nodes), np.empty(nodes), np.empty(len(w))
    y, e = np.empty(1), np.empty(1)
    down[:] = 0.0
    for i in range(points):
        backprop.hidden(LOGISTIC, x[i], v, z, s, slope)
        for k in range(phi.shape[1]):
            s[nodes + 1 + k] = phi[i, k]
        backprop.output(s, w, y)
        e[0] = target[i] - y[0]
        loss += e[0] * e[0]
        backprop.back(slope, w, e, b)
        backprop.tune_output(gain, s, e, down_w)
        backprop.tune_first(gain, x[i], b, down_v)
    return loss / points


@compiled()
def batch(theta: Any, nodes: int, x: Any, phi: Any, target: Any, epochs: int) -> None:
    """Train `theta` in place by (3) (4)."""
    down, trial_down = np.zeros_like(theta), np.zeros_like(theta)
    move, rate = np.zeros_like(theta), RATE
    loss = downhill(theta, nodes, x, phi, target, down)
    for _ in range(epochs):
        move = MOMENTUM * move + (1.0 - MOMENTUM) * rate * down
        trial = theta + move
        trial_loss = downhill(trial, nodes, x, phi, target, trial_down)
        if trial_loss > WORSE * loss:
            rate *= SHRINK
            move[:] = 0.0
            continue
        if trial_loss < loss:
            rate *= GROW
        theta[:] = trial
        down[:] = trial_down
        loss = trial_loss


def levenberg_marquardt(theta: Array, nodes: int, x: Array, phi: Array, target: Array) -> None:
    """Train `theta` in place by LM_STEPS steps (J'J + mu I) d = J'E; mu: 1e-3, then x10, /10."""
    mu = 1e-3
    error, jacobian = residual(theta, nodes, x, phi, target)
    for _ in range(LM_STEPS):
        left, right = jacobian.T @ jacobian, jacobian.T @ error
        while mu < 1e10:
            trial = theta + np.linalg.solve(left + mu * np.eye(len(theta)), right)
            trial_error, trial_jacobian = residual(trial, nodes, x, phi, target)
            if trial_error @ trial_error < error @ error:
                break
            mu *= 10.0
        else:
            return
        mu *= 0.1
        theta[:], error, jacobian = trial, trial_error, trial_jacobian


def residual(theta: Array, nodes: int, x: Array, phi: Array, target: Array) -> tuple[Array, Array]:
    """Return E (points,) and dy/dtheta (points, theta)."""
    y, s = np.zeros(len(x)), np.zeros((len(x), nodes + 1 + phi.shape[1]))
    evaluate(theta, nodes, x, phi, y, s)
    w = theta[(x.shape[1] + 1) * nodes :]
    smooth = s[:, 1 : nodes + 1]
    back = smooth * (1.0 - smooth) * w[1 : nodes + 1]
    ones = np.column_stack((np.ones(len(x)), x))
    return target - y, np.hstack([*(ones[:, [i]] * back for i in range(ones.shape[1])), s])


def output(net: Net, theta: Array, x: Array) -> Array:
    """Return the net's output (points,) at x (points, n)."""
    case, phi = CASES[net.case], net.jump_hidden(x)
    y, s = np.zeros(len(x)), np.zeros((len(x), case.nodes + 1 + net.count()))
    evaluate(theta, case.nodes, x, phi, y, s)
    return y


def trained_net(net: Net, epochs: int = EPOCHS) -> TrainedNet:
    """Train a net from its seed and judge it; `epochs` of the batch trainer."""
    case = CASES[net.case]
    x = case.grid(case.train_points)
    theta, phi, target = (
        first_weights(case, net.seed, net.count()),
        net.jump_hidden(x),
        case.function(x),
    )
    if net.trainer == "lm":
        levenberg_marquardt(theta, case.nodes, x, phi, target)
    else:
        batch(theta, case.nodes, x, phi, target, epochs)
    test = case.grid(case.test_points)
    error = output(net, theta, test) - case.function(test)
    far = np.abs(test[:, 0] - case.c) > FAR_CELLS * case.cell()
    return TrainedNet(
        net,
        theta,
        _rms(output(net, theta, x) - target),
        _rms(error),
        float(np.abs(error).max()),
        _rms(error[far]),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values * values)))


@compiled()
def online(
    x: Any, nodes: int, theta: Any, rate: float, hebbian: bool, leak: float, limit: float
) -> None:
    """Fit sin(x) sample by sample, backprop.py (5) or, `hebbian`, (7); `x` (samples, 1)."""
    v, w = layers(theta, nodes, 1)
    z, slope, b, s = np.empty(nodes), np.empty(nodes), np.empty(nodes), np.empty(nodes + 1)
    y, e = np.empty(1), np.empty(1)
    for i in range(len(x)):
        backprop.hidden(LOGISTIC, x[i], v, z, s, slope)
        backprop.output(s, w, y)
        e[0] = np.sin(x[i, 0]) - y[0]
        if hebbian:
            backprop.tune_hebbian(rate, rate, leak, limit, e, x[i], s, w, v)
        else:
            backprop.tune(rate, rate, e, x[i], s, slope, b, w, v)


def online_fit(
    rate: float, hebbian: bool, leak: float = 0.0, limit: float = np.inf
) -> tuple[float, float, float]:
    """Return rms before, rms after 20,000 samples, |V| of 10 nodes, V ~ U(-2, 2), seed 1, W = 0."""
    draw = np.random.default_rng(1).uniform
    theta = np.concatenate((draw(-2.0, 2.0, 20), np.zeros(11)))
    x = draw(-np.pi, np.pi, (20_000, 1))
    test = np.linspace(-np.pi, np.pi, 41)[:, None]
    none, y, s = np.zeros((41, 0)), np.zeros(41), np.zeros((41, 11))
    target = np.sin(test[:, 0])
    online(x, 10, theta, rate, hebbian, leak, limit)
    evaluate(theta, 10, test, none, y, s)
    return _rms(target), _rms(y - target), float(np.linalg.norm(theta[:20]))

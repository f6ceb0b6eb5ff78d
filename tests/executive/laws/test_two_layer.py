"""The neural network: gradients, jump nodes, and the Lyapunov identity of its tuning laws."""

from typing import NamedTuple

import numpy as np
import pytest

from pcpc.drivers.compiled.jit import compiled
from pcpc.executive.laws.approximators import two_layer

N_IN, N, N_JUMP = 6, 10, 4
N_PHI = 1 + N + N_JUMP


class Network(NamedTuple):
    """A network in arrays."""

    x: np.ndarray
    a: np.ndarray
    phi: np.ndarray
    w: np.ndarray
    v: np.ndarray


@compiled()
def forward(x, v, a, phi, w, v1, v2):  # type: ignore[no-untyped-def]
    two_layer.hidden(x, v, a, phi)
    two_layer.jump_pair(v1, 0.004, phi, 1 + N)
    two_layer.jump_pair(v2, 3.0, phi, 3 + N)
    return two_layer.output(phi, w)


@compiled()
def tuned(r, kappa, f, fj, g, dt, x, a, phi, w, v):  # type: ignore[no-untyped-def]
    net = Network(x, a, phi, w, v)
    two_layer.tune(net, r, kappa * abs(r), dt * f, dt * fj, dt * g)


def network(rng: np.random.Generator) -> dict[str, np.ndarray]:
    x = rng.uniform(-2.0, 2.0, N_IN)
    x[0] = 1.0
    return {
        "x": x, "v": rng.uniform(-1, 1, N_IN * N).reshape(N_IN, N), "w": rng.normal(0, 2, N_PHI),
        "a": np.zeros(N), "phi": np.zeros(N_PHI),
    }  # fmt: skip


def evaluate(net: dict[str, np.ndarray], v1: float, v2: float) -> float:
    return forward(net["x"], net["v"], net["a"], net["phi"], net["w"], v1, v2)


def test_output_is_the_written_formula() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        net = network(rng)
        v1, v2 = rng.normal(0, 0.01), rng.normal(0, 3)
        y = evaluate(net, v1, v2)
        s = 1 / (1 + np.exp(-net["v"].T @ net["x"]))
        jumps = [
            (1 - np.exp(-abs(v) / scale)) * (v * side > 0)
            for v, scale in ((v1, 0.004), (v2, 3.0))
            for side in (1, -1)
        ]
        expected = net["w"] @ np.concatenate(([1.0], s, jumps))
        assert abs(y - expected) < 1e-12, f"{y} against {expected}"


def test_jump_nodes_are_one_sided_and_reach_one() -> None:
    phi = np.zeros(2)
    pair = compiled()(lambda v, scale, phi: two_layer.jump_pair(v, scale, phi, 0))
    for v, expected in ((1.0, (1.0, 0.0)), (-1.0, (0.0, 1.0)), (0.0, (0.0, 0.0))):
        pair(v, 0.004, phi)
        assert np.allclose(phi, expected, atol=1e-15), f"{phi} at v = {v}"


def test_first_layer_tuning_follows_the_gradient() -> None:
    """G x (s' W_s)' r is r times the gradient of y with respect to V (finite differences)."""
    net = network(np.random.default_rng(2))
    evaluate(net, 0.01, -1.0)
    before = net["v"].copy()
    tuned(1.0, 0.0, 0.0, 0.0, 1.0, 1.0, net["x"], net["a"], net["phi"], net["w"], net["v"])
    step, h = net["v"] - before, 1e-6
    for k in range(N_IN * N):
        sides = []
        for sign in (1, -1):
            net["v"][:] = before
            net["v"].ravel()[k] += sign * h
            sides.append(evaluate(net, 0.01, -1.0))
        gradient = (sides[0] - sides[1]) / (2 * h)
        assert abs(step.ravel()[k] - gradient) < 1e-8, (
            f"V[{k}]: {step.ravel()[k]} against {gradient}"
        )


def lyapunov_mismatch(sign_of_e_mod: float) -> float:
    """Return the largest relative mismatch of dL/dt and its closed form over random points.

    M r' = -K r + W*'phi* - W'phi + d,   L = M r^2/2 + W~'F^-1 W~/2 + tr(V~'G^-1 V~)/2
    dL/dt = -K r^2 + r (w + d) + kappa |r| (W~'W + tr V~'V)
    w = W*'phi* - W'phi - W~_0 - W~_s'(s - s' a) - W~_j'j - W_s's' V~'x
    """
    rng = np.random.default_rng(3)
    f, fj, g, kappa, mass, gain, worst = 80.0, 400.0, 2.0, 0.01, 3.6, 110.0, 0.0
    rates = np.concatenate((np.full(1 + N, f), np.full(N_JUMP, fj)))
    for _ in range(50):
        net, ideal = network(rng), network(rng)
        ideal["x"] = net["x"]
        v1, v2, r, d = rng.normal(0, 0.01), rng.normal(0, 3), rng.normal(0, 0.3), rng.normal()
        y_ideal, y = evaluate(ideal, v1, v2), evaluate(net, v1, v2)
        w_old, v_old = net["w"].copy(), net["v"].copy()
        s, a = net["phi"][1 : N + 1].copy(), net["a"].copy()
        slope = s * (1 - s)
        dt = 1.0
        leak = sign_of_e_mod * kappa
        tuned(r, leak, f, fj, g, dt, net["x"], net["a"], net["phi"], net["w"], net["v"])
        w_err, v_err = ideal["w"] - w_old, ideal["v"] - v_old
        numeric = r * (-gain * r + y_ideal - y + d)
        numeric -= np.sum(w_err * (net["w"] - w_old) / rates)
        numeric -= np.sum(v_err * (net["v"] - v_old) / g)
        through_v = v_err.T @ net["x"]
        residual = y_ideal - y - w_err[0] - w_err[1 : N + 1] @ (s - slope * a)
        residual -= w_err[N + 1 :] @ net["phi"][N + 1 :] + (w_old[1 : N + 1] * slope) @ through_v
        closed = -gain * r * r + r * (residual + d)
        closed += kappa * abs(r) * (w_err @ w_old + np.sum(v_err * v_old))
        worst = max(worst, abs(numeric - closed) / (1 + abs(closed)))
    assert mass > 0
    return worst


def test_tuning_laws_satisfy_the_lyapunov_identity() -> None:
    worst = lyapunov_mismatch(+1.0)
    assert worst < 1e-11, f"mismatch {worst:.1e}"


def test_a_flipped_e_modification_breaks_the_identity() -> None:
    worst = lyapunov_mismatch(-1.0)
    assert worst > 1e-3, f"mismatch only {worst:.1e}"


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_no_tuning_without_time(value: float) -> None:
    """With dt = 0 finite weights stay as they are, whatever drives them."""
    net = network(np.random.default_rng(4))
    evaluate(net, 0.0, 0.0)
    before = net["w"].copy()
    tuned(0.1, 0.01, 80.0, 400.0, 2.0, 0.0, net["x"], net["a"], net["phi"], net["w"], net["v"])
    assert np.array_equal(before, net["w"]), f"{value}: weights moved"

"""The deadzone laws: signs by finite differences, draws, guards; plain numpy beside them."""

import numpy as np
import pytest
from named_law import Law
from numpy.typing import NDArray

from pcpc.plants.deadzone_arm.laws import deadzone_nn as nn
from pcpc.plants.deadzone_map.laws import deadzone_fuzzy as fuzzy

Array = NDArray[np.float64]
SETTINGS = {
    "kv_Nms_rad": 15.0, "lam_per_s": 7.0, "u_max_Nm": 150.0, "a1_m": 1.0, "a2_m": 1.0,
    "m1_kg": 1.8, "m2_kg": 1.3, "r_max_rad_s": 50.0, "network_on": 1.0, "t_rate": 500.0,
    "s_rate": 24.0, "k1": 0.001, "k2": 0.0001, "jumps_on": 1.0, "nodes": 20.0,
    "norm_max": 5000.0, "network_seed": 11.0, "positive_slope": 1.0,
}  # fmt: skip
FUZZY = {"lam": 0.2, "kv": 0.3, "model_c": 0.15, "r_max": 20.0, "alpha": 0.1, "gam": 0.001}
N = nn.MOST_NODES
TUNED = ("w", "wi")
FIXED = ("v", "v0", "vi", "v0i")


def dual(**changed: float) -> Law:
    return Law(nn.BLOCK, SETTINGS | changed)


def random_input(seed: int) -> Array:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, 10)


def logistic(x: Array) -> Array:
    return 1.0 / (1.0 + np.exp(-x))


# The arm's law


@pytest.mark.parametrize("seed", range(5))
def test_with_the_exact_model_pd_leaves_the_linear_error_equation(seed: int) -> None:
    """M r' + Vm r + Kv r = 0 under tau = w: the law's model against an independent arm."""
    u = random_input(seed)
    rate, acc, q, v = u[[1, 6]], u[[2, 7]], u[[3, 8]], u[[4, 9]]
    found = Law(nn.PD, SETTINGS).step(u)
    far = 1.3 * np.cos(q[1])
    inertia = np.array([[3.1 + 1.3 + 2 * far, 1.3 + far], [1.3 + far, 1.3]])
    h = 1.3 * np.sin(q[1])
    vm = np.array([[-h * v[1], -h * (v[0] + v[1])], [h * v[0], 0.0]])
    v_rate = np.linalg.solve(inertia, found.tau_d_Nm - vm @ v)
    r_rate = (acc - v_rate) + 7.0 * (rate - v)
    left = inertia @ r_rate + vm @ found.r_rad_s + 15.0 * found.r_rad_s
    assert np.abs(left).max() < 1e-11, left


def test_the_networks_are_drawn_in_the_specified_order() -> None:
    law, draw = dual(positive_slope=0.0), np.random.default_rng(11)
    for joint in range(2):
        v = draw.uniform(0, 1, 20) * np.where(draw.random(20) < 0.5, -1, 1)
        rest = [draw.uniform(-35, 35, 20), draw.uniform(-50, 50, 20)]
        vi = draw.uniform(0, 1, 20) * np.where(draw.random(20) < 0.5, -1, 1)
        expected = (v, *rest, vi, draw.uniform(-35, 35, 20))
        for name, values in zip(("v", "v0", "w", "vi", "v0i"), expected, strict=True):
            drawn = getattr(law.x, name)[joint]
            wrong = np.abs(drawn[:20] - values).max()
            assert wrong == 0.0 and not drawn[20:].any(), (joint, name, wrong)
    assert not law.x.wi.any()


def test_the_positive_start_sees_a_deadzone_that_never_falls() -> None:
    fixed, free = dual(), dual(positive_slope=0.0)
    lowest = [1e9, 1e9]
    for wanted in np.linspace(-150.0, 150.0, 301):
        u = np.zeros(10)
        u[1] = u[6] = wanted / 15.0  # at rest w is all in r
        for i, law in enumerate((fixed, free)):
            lowest[i] = min(lowest[i], *law.step(u, 0.0).slope)
    assert lowest[0] >= 0.0 > lowest[1], f"lowest slopes {lowest}"


@pytest.mark.parametrize("seed", range(3))
def test_the_slope_is_the_derivative_of_the_deadzone_as_seen(seed: int) -> None:
    law = dual(network_seed=float(seed))
    found = law.step(random_input(seed), 0.0)
    for joint in (0, 1):
        w, v, v0 = law.x.w[joint], law.x.v[joint], law.x.v0[joint]
        u = found.tau_d_Nm[joint]  # Wi = 0
        h = 1e-4
        seen = [float(np.sum(w * logistic(v * (u + d) + v0))) for d in (-h, h)]
        slope = (seen[1] - seen[0]) / (2 * h)
        assert abs(found.slope[joint] - slope) < 1e-7, (found.slope, slope)


@pytest.mark.parametrize("seed", range(4))
def test_tuning_cancels_the_cross_terms_of_the_lyapunov_function(seed: int) -> None:
    """d/dt of tr(W~'W~)/2S + tr(Wi~'Wi~)/2T is -r'(W~'b y) + r'(J Wi~'s) without decay.

    These are the terms that the linearised throughput tau - w = -J Wi~'s + W~'b y adds to
    d/dt r'Mr/2 = -r'(tau - w) + ..., with the other sign.
    """
    law, rng, dt = dual(k1=0.0, k2=0.0, network_seed=float(seed)), np.random.default_rng(seed), 1e-9
    law.x.wi[:] = rng.uniform(-3.0, 3.0, (2, nn.COLUMN))
    law.x.wi[:, 20:N] = 0.0
    ideal_w, ideal_wi = rng.uniform(-50, 50, (2, N)), rng.uniform(-30, 30, (2, nn.COLUMN))

    def distance() -> tuple[Array, Array]:
        return ideal_w - law.x.w, ideal_wi - law.x.wi

    w_error, wi_error = distance()
    found = law.step(random_input(seed), dt)
    after_w, after_wi = distance()
    rate = float(
        np.sum((after_w - w_error) * (after_w + w_error)) / (2 * 24.0 * dt)
        + np.sum((after_wi - wi_error) * (after_wi + wi_error)) / (2 * 500.0 * dt)
    )
    cross = 0.0
    for i in (0, 1):
        r, y, w = found.r_rad_s[i], found.y_Nm[i], found.tau_d_Nm[i]
        z = logistic(law.x.v[i] * (w + y) + law.x.v0[i])
        b = z * (1 - z) * law.x.v[i]
        s = np.zeros(nn.COLUMN)
        s[:20] = logistic(law.x.vi[i, :20] * w + law.x.v0i[i, :20])
        s[N:] = (1.0, 1.0 - np.exp(-w)) if w >= 0.0 else (0.0, 0.0)
        slope = float((ideal_w[i] - w_error[i]) @ b)
        throughput = -slope * float(wi_error[i] @ s) + float(w_error[i] @ b) * y
        cross -= r * throughput
    assert abs(rate + cross) < 1e-5 * abs(cross), f"{rate} does not cancel {cross}"


def test_decay_never_carries_a_weight_through_zero() -> None:
    law = dual(k1=10.0, k2=10.0, t_rate=1e5, s_rate=1e5, r_max_rad_s=1e6, norm_max=1e9)
    law.x.v[:] = 0.0  # no slope and no gradient: decay alone
    law.x.wi[:] = 7.0
    u = random_input(1)
    u[0] = 1e3
    before = law.copies(*TUNED)
    law.step(u)
    for name, after in law.copies(*TUNED).items():
        ratio = after[before[name] != 0.0] / before[name][before[name] != 0.0]
        assert (ratio > 0.0).all() and (ratio < 1e-3).all(), (ratio.min(), ratio.max())


@pytest.mark.parametrize(("wanted", "nodes"), [(0.0, (1.0, 0.0)), (-1e-300, (0.0, 0.0))])
def test_the_jump_node_is_continuous_from_the_right(
    wanted: float, nodes: tuple[float, ...]
) -> None:
    law, u = dual(), np.zeros(10)
    u[1] = wanted / 15.0
    law.step(u)
    assert tuple(law.x.s[0, N:]) == nodes, law.x.s[0, N:]


@pytest.mark.parametrize("bad", [np.nan, np.inf, 8.0])
def test_the_guard_ends_both_commands_for_good(bad: float) -> None:
    law, u = dual(), random_input(1)
    law.step(u)
    weights = law.x.wi.copy()
    worse = u.copy()
    worse[3] = bad  # |r| beyond 50
    for inputs in (worse, u):
        found = law.step(inputs)
        assert not found.torque_Nm.any() and found.diverged == 1.0, found.torque_Nm
    if np.isfinite(bad):
        assert (law.x.wi == weights).all(), "it went on learning"


def test_the_network_off_is_pd_bit_for_bit_and_learns_nothing() -> None:
    off, pd = dual(network_on=0.0), Law(nn.PD, SETTINGS)
    weights = off.copies(*TUNED, *FIXED)
    for seed in range(50):
        u = 2.0 * random_input(seed)
        a, b = off.step(u).values(), pd.step(u).values()
        assert np.array_equal(a[: len(b)], b), (a, b)
    for name, values in off.copies(*TUNED, *FIXED).items():
        assert np.array_equal(values, weights[name]), name


# The map's law


def test_the_leak_is_the_spectral_norm_that_the_law_asks_for() -> None:
    for alpha in (0.05, 0.5, 1.0, 1.7, 2.0):
        for x in (np.array([1.0, 0.0]), np.array([0.0, -1.0])):
            norm = np.linalg.norm(np.eye(2) - alpha * np.outer(x, x), 2)
            assert max(1.0, abs(1.0 - alpha)) == pytest.approx(norm, abs=1e-15), (alpha, norm)


@pytest.mark.parametrize(("wanted", "side"), [(0.4, 0), (-0.4, 1)])
def test_a_wider_estimate_moves_the_next_error_as_tuning_assumes(wanted: float, side: int) -> None:
    """dr(k+1)/dd = X beyond the deadzone, so that -alpha X r is gradient descent."""
    following = []
    for width in (0.1, 0.1 + 1e-6):
        law = Law(fuzzy.BLOCK, FUZZY | {"gam": 0.0})
        setattr(law.x, ("width_plus", "width_minus")[side], width)
        u = law.step([0.0, 0.0, 0.0, 0.0, wanted]).command
        tau = np.sign(u) * max(abs(u) - 0.05, 0.0)
        following.append((0.0 + tau) - wanted)  # r(k+1) from x = 0, where F = 0
    slope = (following[1] - following[0]) / 1e-6
    assert slope == pytest.approx((1.0, -1.0)[side], abs=1e-6), slope


@pytest.mark.parametrize("bad", [np.nan, 30.0])
def test_the_guard_of_the_map_sends_zero_for_good(bad: float) -> None:
    for block in (fuzzy.BLOCK, fuzzy.PD):
        law = Law(block, FUZZY)
        law.step([0.1, 0.2, 0.1, 0.1, 0.1])
        for x2 in (bad, 0.2):
            found = law.step([0.1, x2, 0.1, 0.1, 0.1])
            assert (found.command, found.diverged) == (0.0, 1.0), found.command

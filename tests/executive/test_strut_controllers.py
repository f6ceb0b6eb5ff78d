"""The laws of the hydraulic strut by themselves: identities of proof, rules, filters, limits."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pcpc.executive.laws.block import Block, Port
from pcpc.executive.laws.controllers.strut import strut_backstepping as fl
from pcpc.executive.laws.controllers.strut import strut_outer as outer
from pcpc.executive.laws.controllers.strut import strut_pid as pid

Vector = NDArray[np.float64]
T = 1e-3
OUTER = {
    "bs_Ns_m": 1000.0, "ks_N_m": 16812.0, "bsky_Ns_m": 2000.0, "krh_N_m": 16812.0,
    "wb_rad_s": 56.748, "wk_rad_s": 56.748,
}  # fmt: skip
FL = OUTER | {
    "k1_per_s": 100.0, "lam_per_s": 200.0, "tf_s": 0.002, "kap_per_m": 100.0,
    "adaptation_rad_s": 120.0, "valve_lag_s": 1.0 / 30.0, "spool_max_m": 0.002,
}  # fmt: skip
PID = OUTER | {
    "gain_per_s": 600.0, "integral_per_s": 40.0, "derivative_s": 0.0005, "tf_s": 0.002,
    "spool_max_m": 0.002,
}  # fmt: skip
AC, AA = 5.0e-4, 3.5e-4
REST = (0.0, 0.0, 0.0, 18.966e6, 18.966e6, 0.0, 0.0)  # F is the weight


class Law:
    """A block with its views; `u` is what it measures."""

    def __init__(self, block: Block, settings: dict[str, float], **other: float) -> None:
        self.block = block
        own = {p.name: p.default for p in block.settings if p.default is not None}
        prepared = block.prepare({**own, **settings, **other}, 1.0 / T, 1)  # type: ignore[misc]
        self.p = self._packed(block.parameters, prepared.parameters)
        self.x = self._packed(block.states, prepared.states)
        self.y = np.zeros(block.size(block.outputs))

    @staticmethod
    def _packed(ports: tuple[Port, ...], values: Any) -> Vector:
        parts = [np.broadcast_to(values.get(port.name, 0.0), (port.size,)) for port in ports]
        return np.concatenate(parts).astype(np.float64)

    def step(self, u: Any, dt: float = T) -> Vector:
        self.block.step(0.0, dt, self.p, self.x, np.array(u, np.float64), self.y)
        return self.y

    @property
    def theta(self) -> Vector:
        return self.x[fl.THETA : fl.THETA + fl.RULES]


def _measured(rng: np.random.Generator) -> Vector:
    scale = np.array([0.2, 0.03, 0.2, 3e6, 3e6, 3e-4, 0.0])
    return rng.normal(size=7) * scale + (0, 0, 0, 19e6, 19e6, 0, 0)


def _drift_and_gain(u: Vector, xv: float) -> tuple[float, float]:
    """Return f and G of the force, straight from the equations."""
    x2, x3, x4, p1, p2 = u[:5]
    p0 = 290.0 * 9.81 / 1.5e-4
    v0 = (0.8e9 + 10.0 * p0) * 1.5e-4**2 / 16812.0 / 2.0
    flow = 0.6 * 9.6e-6 * np.sqrt(2.0 / 900.0) * (p1 - p2) / ((p1 - p2) ** 2 + 1e10) ** 0.25
    b1, b2 = ((0.8e9 + 10.0 * p) / v for p, v in ((p1, v0 + AC * x3), (p2, v0 - AA * x3)))
    v3 = x2 - x4
    f = AC * b1 * (-AC * v3 - flow) - AA * b2 * (AA * v3 + flow)
    psi = p0 + np.sign(xv) * (p0 - p1)
    return f, AC * b1 * 0.6 * 0.02 * np.sqrt(2.0 / 900.0 * psi)


def test_the_lyapunov_function_falls_as_the_proof_says() -> None:
    """L' from force dynamics, law and tuning against (9) with any ideal consequents."""
    rng = np.random.default_rng(5)
    c = 3.7e13
    for _ in range(50):
        law, u = Law(fl.BLOCK, FL, spool_max_m=1.0), _measured(rng)
        x7 = u[5] = rng.choice([-1.0, 1.0]) * rng.uniform(1e-4, 3e-4)
        law.theta[:] = rng.normal(size=fl.RULES) * 2e-4
        theta, ideal = law.theta.copy(), rng.normal(size=fl.RULES) * 2e-4
        law.x[outer.STARTED] = 1.0
        law.x[outer.XB], law.x[outer.XK] = rng.normal(), rng.normal() * 0.03
        law.x[fl.LAST_SPOOL] = x7  # the valve's sign as the force has it
        y = law.step(u, 1e-9).copy()  # so short that the filters move by their input only
        fd_rate, x7d_rate = law.x[fl.FD_RATE], law.x[fl.SPOOL_RATE]
        ef, e = y[3], y[4] - x7
        m = law.x[fl.FIRED : fl.FIRED + fl.RULES].copy()
        f, g = _drift_and_gain(u, x7)
        ef_rate = fd_rate - (f + g * x7)
        e_rate = x7d_rate - (y[0] - x7) * 30.0
        theta_rate = (law.theta - theta) / 1e-9
        gam = law.p[fl.GAM]
        fall = ef * ef_rate + c * e * e_rate - (ideal - theta) @ theta_rate / gam
        eps = -f / g - ideal @ m
        proof = -100.0 * ef**2 + g * ef * e - c * 200.0 * e**2 + g * ef * eps
        proof += 100.0 * abs(g * ef) * ((ideal - theta) @ theta)
        size = 100.0 * ef**2 + abs(g * ef * e) + c * 200.0 * e**2
        assert abs(fall - proof) < 1e-5 * size, f"L' {fall:.6e}, by the proof {proof:.6e}"


def test_the_rules_share_one_and_are_products_of_gaussians() -> None:
    rng = np.random.default_rng(6)
    law = Law(fl.BLOCK, FL)
    for _ in range(20):
        u = _measured(rng) * (4.0, 6.0, 4.0, 1.0, 1.0, 1.0, 0.0)
        law.step(u)
        m = law.x[fl.FIRED : fl.FIRED + fl.RULES]
        point = np.clip((u[1] / 0.1, (u[0] - u[2]) / 2.0, (u[3] - u[4]) / 10e6), -1.2, 1.2)
        mu = np.array([
            np.exp(-(((point[0] - a) / 0.5) ** 2 + ((point[1] - b) / 0.2) ** 2
                     + ((point[2] - c) / 0.2) ** 2) / 2.0)
            for a in np.linspace(-1, 1, 3)
            for b in np.linspace(-1, 1, 7)
            for c in np.linspace(-1, 1, 7)
        ])  # fmt: skip
        assert m.sum() == pytest.approx(1.0, abs=1e-14)
        assert np.abs(m - mu / mu.sum()).max() < 1e-13, f"{np.abs(m - mu / mu.sum()).max()}"


def test_the_tuning_rate_is_known() -> None:
    assert Law(fl.BLOCK, FL).p[fl.GAM] == pytest.approx(4.250e-15, rel=2e-4)


def test_exact_drift_is_minus_f_over_g() -> None:
    rng = np.random.default_rng(7)
    for _ in range(10):
        law, u = Law(fl.BLOCK, FL, exact_drift=1.0), _measured(rng)
        law.x[outer.STARTED], law.x[fl.LAST_SPOOL] = 1.0, 1e-4
        f, g = _drift_and_gain(u, 1e-4)
        assert law.step(u)[5] == pytest.approx(-f / g, rel=1e-12), f"{law.y[5]}"
        assert not law.theta.any(), "tunes beside the exact drift"


def test_without_the_fuzzy_system_nothing_is_learned_and_nothing_added() -> None:
    law, rng = Law(fl.BLOCK, FL, fl_on=0.0), np.random.default_rng(8)
    for _ in range(20):
        assert law.step(_measured(rng))[5] == 0.0
    assert not law.theta.any(), f"{law.theta}"


def test_nothing_is_learned_without_a_new_measurement() -> None:
    rng = np.random.default_rng(9)
    u = _measured(rng)
    learning, naive = Law(fl.BLOCK, FL), Law(pid.BLOCK, PID, gain_per_s=1.0)
    u[6] = 1.0
    learning.step(u)
    naive.step(u)
    assert not learning.theta.any() and naive.x[pid.INTEGRAL] == 0.0
    u[6] = 0.0
    learning.step(u)
    naive.step(u)
    assert learning.theta.any() and naive.x[pid.INTEGRAL] != 0.0


def test_commands_end_at_their_limits_and_pid_stops_integrating_there() -> None:
    far = (0.0, 0.0, 0.0, 60e6, 1e6, 0.0, 0.0)
    backstepping, naive = Law(fl.BLOCK, FL), Law(pid.BLOCK, PID)
    for _ in range(50):
        backstepping.step(far)
        naive.step(far)
    assert backstepping.y[4] == -0.002, f"wanted spool {backstepping.y[4]} m"
    assert abs(backstepping.y[0]) <= 0.006, f"u {backstepping.y[0]} m"
    assert naive.y[0] == -0.002 and naive.x[pid.INTEGRAL] == 0.0, f"I {naive.x[pid.INTEGRAL]}"


def test_the_differences_are_zero_at_the_first_tick_and_then_a_first_order_lag() -> None:
    x = np.zeros(2)
    assert outer.difference(5.0, T, 0.002, 0.0, x, 0) == 0.0
    found = [outer.difference(5.0 + 3.0 * k * T, T, 0.002, 1.0, x, 0) for k in range(1, 6)]
    expected = [3.0 * (1.0 - np.exp(-k * 0.5)) for k in range(1, 6)]
    assert found == pytest.approx(expected, rel=1e-10), f"{found}"


def test_the_desired_force_is_the_weight_at_rest_and_its_filters_are_exact() -> None:
    law = Law(outer.BLOCK, OUTER)
    assert law.step(REST)[1] == pytest.approx(290.0 * 9.81, rel=1e-12), f"Fd {law.y[1]} N"
    law = Law(outer.BLOCK, OUTER)
    law.step((0.0, 0.05, 0.0, 19e6, 19e6, 0.0, 0.0))
    assert law.x[outer.XK] == pytest.approx(0.05), "xk starts at x3"
    u = (0.3, 0.0, -0.1, 19e6, 19e6, 0.0, 0.0)
    for _ in range(10):
        law.step(u)
    decay = np.exp(-56.748 * 10 * T)
    assert law.x[outer.XB] == pytest.approx(0.4 * (1.0 - decay), rel=1e-9)
    assert law.x[outer.XK] == pytest.approx(0.05 * decay, rel=1e-9)
    assert law.y[0] == 0.0, "the valve stays closed"

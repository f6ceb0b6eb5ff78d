"""The laws of the hydraulic strut by themselves: identities of proof, rules, filters, limits."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pcpc.executive.laws.block import Block, Port
from pcpc.plants.quarter_car.laws import strut_backstepping as fl
from pcpc.plants.quarter_car.laws import strut_outer as outer
from pcpc.plants.quarter_car.laws import strut_pid as pid

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
    """A block with its ports by name; `u` is what it measures."""

    def __init__(self, block: Block, settings: dict[str, float], **other: float) -> None:
        self.block = block
        own = {p.name: p.default for p in block.settings if p.default is not None}
        prepared = block.prepare({**own, **settings, **other}, 1.0 / T, 1)  # type: ignore[misc]
        parameters, states, inputs, outputs = block.step.declared
        self.p = parameters(self._packed(block.parameters, prepared.parameters))
        self.x = states(self._packed(block.states, prepared.states))
        self.u, self.y = inputs(np.zeros(inputs.size)), outputs(np.zeros(outputs.size))

    @staticmethod
    def _packed(ports: tuple[Port, ...], values: Any) -> Vector:
        parts = [np.broadcast_to(values.get(port.name, 0.0), (port.size,)) for port in ports]
        return np.concatenate(parts).astype(np.float64)

    def step(self, u: Any, dt: float = T) -> Any:
        self.u.values()[:] = u
        self.block.step(0.0, dt, *(view.values() for view in (self.p, self.x, self.u, self.y)))
        return self.y


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
        x7 = outer.Inputs(u).spool_m = rng.choice([-1.0, 1.0]) * rng.uniform(1e-4, 3e-4)
        law.x.theta[:] = rng.normal(size=fl.RULES) * 2e-4
        theta, ideal = law.x.theta.copy(), rng.normal(size=fl.RULES) * 2e-4
        law.x.started = 1.0
        law.x.xb_m_s, law.x.xk_m = rng.normal(), rng.normal() * 0.03
        law.x.last_spool_m = x7  # the valve's sign as the force has it
        y = law.step(u, 1e-9)  # so short that the filters move by their input only
        fd_rate, x7d_rate = law.x.desired_rate_N_s, law.x.wanted_rate_m_s
        ef, e, m = y.ef_N, y.wanted_spool_m - x7, law.x.fired
        f, g = _drift_and_gain(u, x7)
        ef_rate = fd_rate - (f + g * x7)
        e_rate = x7d_rate - (y.command_m - x7) * 30.0
        theta_rate = (law.x.theta - theta) / 1e-9
        gam = law.p.gam_m2_N2
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
        m, v3, dp = (
            law.x.fired,
            law.u.body_rate_m_s - law.u.wheel_rate_m_s,
            law.u.p1_Pa - law.u.p2_Pa,
        )
        point = np.clip((law.u.extension_m / 0.1, v3 / 2.0, dp / 10e6), -1.2, 1.2)
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
    assert Law(fl.BLOCK, FL).p.gam_m2_N2 == pytest.approx(4.250e-15, rel=2e-4)


def test_exact_drift_is_minus_f_over_g() -> None:
    rng = np.random.default_rng(7)
    for _ in range(10):
        law, u = Law(fl.BLOCK, FL, exact_drift=1.0), _measured(rng)
        law.x.started, law.x.last_spool_m = 1.0, 1e-4
        f, g = _drift_and_gain(u, 1e-4)
        assert law.step(u).drift_m == pytest.approx(-f / g, rel=1e-12), f"{law.y.drift_m}"
        assert not law.x.theta.any(), "tunes beside the exact drift"


def test_without_the_fuzzy_system_nothing_is_learned_and_nothing_added() -> None:
    law, rng = Law(fl.BLOCK, FL, fl_on=0.0), np.random.default_rng(8)
    for _ in range(20):
        assert law.step(_measured(rng)).drift_m == 0.0
    assert not law.x.theta.any(), f"{law.x.theta}"


def test_nothing_is_learned_without_a_new_measurement() -> None:
    rng = np.random.default_rng(9)
    u = _measured(rng)
    learning, naive = Law(fl.BLOCK, FL), Law(pid.BLOCK, PID, gain_per_s=1.0)
    outer.Inputs(u).missing_cycles = 1.0
    learning.step(u)
    naive.step(u)
    assert not learning.x.theta.any() and naive.x.integral_Ns == 0.0
    outer.Inputs(u).missing_cycles = 0.0
    learning.step(u)
    naive.step(u)
    assert learning.x.theta.any() and naive.x.integral_Ns != 0.0


def test_commands_end_at_their_limits_and_pid_stops_integrating_there() -> None:
    far = (0.0, 0.0, 0.0, 60e6, 1e6, 0.0, 0.0)
    backstepping, naive = Law(fl.BLOCK, FL), Law(pid.BLOCK, PID)
    for _ in range(50):
        backstepping.step(far)
        naive.step(far)
    wanted, command = backstepping.y.wanted_spool_m, backstepping.y.command_m
    assert wanted == -0.002, f"wanted spool {wanted} m"
    assert abs(command) <= 0.006, f"u {command} m"
    integral = naive.x.integral_Ns
    assert naive.y.command_m == -0.002 and integral == 0.0, f"I {integral}"


def test_the_differences_are_zero_at_the_first_tick_and_then_a_first_order_lag() -> None:
    last, d = 5.0, outer.difference(5.0, 0.0, 0.0, 0.0, 0.002, T)
    assert d == 0.0
    found = []
    for k in range(1, 6):
        s = 5.0 + 3.0 * k * T
        d, last = outer.difference(s, last, d, 1.0, 0.002, T), s
        found.append(d)
    expected = [3.0 * (1.0 - np.exp(-k * 0.5)) for k in range(1, 6)]
    assert found == pytest.approx(expected, rel=1e-10), f"{found}"


def test_the_desired_force_is_the_weight_at_rest_and_its_filters_are_exact() -> None:
    law = Law(outer.BLOCK, OUTER)
    desired = law.step(REST).desired_N
    assert desired == pytest.approx(290.0 * 9.81, rel=1e-12), f"Fd {desired} N"
    law = Law(outer.BLOCK, OUTER)
    law.step((0.0, 0.05, 0.0, 19e6, 19e6, 0.0, 0.0))
    assert law.x.xk_m == pytest.approx(0.05), "xk starts at x3"
    u = (0.3, 0.0, -0.1, 19e6, 19e6, 0.0, 0.0)
    for _ in range(10):
        law.step(u)
    decay = np.exp(-56.748 * 10 * T)
    assert law.x.xb_m_s == pytest.approx(0.4 * (1.0 - decay), rel=1e-9)
    assert law.x.xk_m == pytest.approx(0.05 * decay, rel=1e-9)
    assert law.y.command_m == 0.0, "the valve stays closed"

"""The laws against backlash: Lyapunov identity, limits of the layer, switches, guards."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import compiled
from pcpc.executive.laws.block import Block
from pcpc.plants.backlash_map.laws import backlash_nn_discrete
from pcpc.plants.backlash_pendulum.laws import backlash_nn
from pcpc.plants.families.maps.laws import gap_inverse, map_pd

DETERMINISTIC = settings(max_examples=60, derandomize=True, deadline=None)
MODEL = {"model_time_constant_s": 1.0, "model_gravity_Nm": 24.525}
Vector = NDArray[np.float64]


class Law:
    """A law with settings changed from their defaults, and its state; `dt` in s."""

    def __init__(self, block: Block, dt: float = 1e-3, **changed: float) -> None:
        settings: dict[str, Any] = {port.name: port.default for port in block.settings} | changed
        states: Any = {}
        if block.prepare is not None:
            prepared = block.prepare(settings, 1.0 / dt, 1)
            settings, states = dict(prepared.parameters), prepared.states
        self.block, self.dt = block, dt
        self.p = np.array([settings[port.name] for port in block.parameters])
        self.x, self.y = np.zeros(block.size(block.states)), np.zeros(block.size(block.outputs))
        for name, value in states.items():
            self.x[self.at(name)] = value

    def at(self, name: str) -> slice:
        """Return where a state lies."""
        start = 0
        for port in self.block.states:
            if port.name == name:
                return slice(start, start + port.size)
            start += port.size
        raise KeyError(name)

    def step(self, *u: float) -> dict[str, float]:
        """Step once; return the outputs by name."""
        self.block.step(0.0, self.dt, self.p, self.x, np.array(u, float), self.y)
        return dict(zip((port.name for port in self.block.outputs), self.y.tolist(), strict=True))


def pendulum(dt: float = 1e-3, **changed: float) -> Law:
    given = {"robust_on": 1.0, "network_on": 1.0, **MODEL} | changed
    return Law(backlash_nn.BLOCK, dt, **given)


@pytest.mark.parametrize("seed", range(5))
def test_tuning_cancels_what_it_must_in_the_lyapunov_function(seed: int) -> None:
    """With B linearised about the weights, (|W~|^2/S + |V~|^2/T)'/2 + tt (y - B) = 0."""
    rng, dt = np.random.default_rng(seed), 1e-7
    law = pendulum(dt, kappa=0.0)
    law.x[law.at("w")] = rng.normal(0.0, 2.0, 11)
    w, v = law.x[law.at("w")].copy(), law.x[law.at("v")].copy().reshape(6, 10)
    inputs = rng.uniform(-1.0, 1.0, 6)
    out = law.step(*inputs)
    w_rate = (law.x[law.at("w")] - w) / dt
    v_rate = (law.x[law.at("v")].reshape(6, 10) - v) / dt
    xi = np.array([1.0, out["r_rad_s"], inputs[0], inputs[1], out["torque_error_Nm"], inputs[5]])
    a = v.T @ xi
    s = 1.0 / (1.0 + np.exp(-a))
    slope = s * (1.0 - s)
    ideal_w, ideal_v = rng.normal(0.0, 3.0, 11), rng.normal(0.0, 3.0, (6, 10))
    w_off, v_off = ideal_w - w, ideal_v - v
    through = w_off @ np.concatenate([[1.0], s - slope * a]) + (w[1:] * slope) @ (v_off.T @ xi)
    stored = -(w_off @ w_rate) / 30.0 - np.sum(v_off * v_rate) / 50.0
    left = stored - out["torque_error_Nm"] * through  # y - B = -through
    assert abs(left) < 1e-6 * abs(stored), f"{left:.1e} is left of {stored:.3f}"


@given(st.floats(-3.0, 3.0), st.floats(-300.0, 300.0), st.floats(0.0, 500.0))
@DETERMINISTIC
def test_the_layer_keeps_the_sampled_gain_below_rho(angle: float, tau: float, bound: float) -> None:
    law = pendulum(network_on=0.0, z_bound=bound)
    law.x[law.at("started")] = 1.0
    out = law.step(0.0, 0.0, 0.0, angle, 0.0, tau)
    zs = np.linalg.norm(law.x[law.at("v")]) + bound
    gain = (2.0 * zs + 2.0) * abs(out["r_rad_s"]) + 2.0 * zs * zs
    assert gain * 1e-3 / out["layer_now_Nm"] <= 0.15 * (1 + 1e-12)
    tt = out["torque_error_Nm"]
    expected = 2.0 * zs * tt + gain * tt / (abs(tt) + out["layer_now_Nm"])
    assert out["robust_Nm_s"] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_the_filtered_derivative_becomes_that_of_a_ramp() -> None:
    law = pendulum(robust_on=0.0, network_on=0.0, kb_per_s=0.0, lam_per_s=0.0, kv_Nms_rad=0.0)
    commands = [law.step(0.0, 0.0, 7.0 * 1e-3 * k, 0.0, 0.0, 0.0)["command_Nm"] for k in range(500)]
    rate = (commands[-1] - commands[-2]) / 1e-3  # tau_d rises by 7 N m/s
    lag = 100.0 * 1e-3 / (1.0 - np.exp(-0.1))  # a T/(1 - exp(-a T)): z lags a sample less than 1/a
    assert rate == pytest.approx(7.0 * lag, rel=1e-6), f"{rate:.4f} N m/s"


def test_the_first_sample_makes_no_jump_in_the_derivative() -> None:
    law = pendulum(robust_on=0.0, network_on=0.0)
    out = law.step(0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    assert out["command_Nm"] == pytest.approx(1e-3 * 15.0 * out["tau_d_Nm"], rel=1e-12)


def test_without_the_network_the_weights_stay_and_its_output_is_zero() -> None:
    law = pendulum(network_on=0.0)
    before = law.x[law.at("w")].copy(), law.x[law.at("v")].copy()
    for k in range(50):
        out = law.step(np.sin(0.1 * k), np.cos(0.1 * k), 0.0, 0.2, -0.4, 3.0)
    assert (law.x[law.at("w")] == before[0]).all() and (law.x[law.at("v")] == before[1]).all()
    assert out["network_Nm_s"] == 0.0
    assert out["norm_v"] == pytest.approx(4.4, abs=0.1), f"|V| {out['norm_v']:.2f} counts in (7)"


@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e300])
def test_a_bad_sample_latches_the_pendulums_law_off(poison: float) -> None:
    law = pendulum()
    assert law.step(0.0, 1.0, 0.0, 0.0, 0.0, 0.0)["diverged"] == 0.0
    for inputs in ((0.0, 1.0, 0.0, 0.0, poison, 0.0), (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)):
        out = law.step(*inputs)
        assert (out["diverged"], out["command_Nm"]) == (1.0, 0.0), f"{out}"


@pytest.mark.parametrize("block", [map_pd.BLOCK, backlash_nn_discrete.BLOCK])
@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e4])
def test_a_bad_sample_latches_the_maps_laws_off(block: Block, poison: float) -> None:
    law, n = Law(block), len(block.inputs)
    assert law.step(*[0.1] * n)["diverged"] == 0.0
    for x2 in (poison, 0.1):
        out = law.step(*[0.1] * 4, x2, *[0.1] * (n - 5))
        assert (out["diverged"], out["command"]) == (1.0, 0.0), f"{out}"


@compiled()
def tuned(drive: float, alpha: float, gamma: float, s: Vector, w: Vector) -> None:
    gap_inverse.tune(drive, alpha, gamma, s, w)


@pytest.mark.parametrize("alpha", [0.01, 0.15, 0.8])
def test_forgetting_goes_by_the_spectral_norm(alpha: float) -> None:
    rng = np.random.default_rng(3)
    s, w = rng.uniform(0.0, 1.0, 12), rng.normal(0.0, 1.0, 12)
    norm = np.linalg.norm(np.eye(12) - alpha * np.outer(s, s), 2)
    expected = w + alpha * s * 0.7 - 0.1 * norm * w
    tuned(0.7, alpha, 0.1, np.concatenate(([1.0], s)), w)
    assert np.abs(w - expected).max() < 1e-12, f"{np.abs(w - expected).max():.1e}"


def test_jump_nodes_see_the_sign_of_the_torque_error_and_nothing_else() -> None:
    for tau, expected in ((-0.3, [1.0, 0.0]), (0.3, [0.0, 1.0])):
        law = Law(backlash_nn_discrete.BLOCK)
        law.step(0.0, 0.0, 0.0, 0.0, 0.0, tau)
        assert law.x[law.at("s")][-2:].tolist() == expected
    off = Law(backlash_nn_discrete.BLOCK, jumps_on=0.0)
    off.step(0.0, 0.0, 0.0, 0.0, 0.0, -0.3)
    assert off.x[off.at("s")][-2:].tolist() == [0.0, 0.0]


def test_the_first_sample_tunes_nothing_and_foretells_no_step() -> None:
    law = Law(backlash_nn_discrete.BLOCK)
    out = law.step(1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    assert out["foretold"] == out["tau_d"] and out["norm_w"] == 0.0
    out = law.step(1.0, 1.0, 1.0, 0.0, 0.1, 0.0)
    assert out["norm_w"] > 0.0 and out["foretold"] != out["tau_d"]

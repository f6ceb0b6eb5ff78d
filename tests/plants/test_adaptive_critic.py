"""The adaptive critic: the Lyapunov identity of its proof, its bounds, its switches."""

import named_law
import numpy as np
import pytest

from pcpc.executive.laws.emath import cos
from pcpc.plants.families.two_link.laws import arm_pd_inertia
from pcpc.plants.payload_arm.laws import adaptive_critic as law

GAINS = {
    "kv_per_s": 30.0, "lam_per_s": 5.0, "a1_m": 1.0, "a2_m": 1.0, "m1_kg": 1.0, "m2_kg": 1.0,
    "action_on": 1.0, "critic_on": 1.0, "gam": 100.0, "kap1": 1.0, "kap2": 0.01, "alpha": 1.0,
    "beta": 5.0, "kz": 5.0, "delta_rad_s": 0.05, "network_seed": 7.0, "v2_size": 1.0,
}  # fmt: skip
TUNED = ("w1", "w2", "rho")


class Compiled(named_law.Law):
    """The law with gains changed; its step says what it tunes."""

    def __init__(self, **gains: float) -> None:
        super().__init__(law.BLOCK, GAINS | gains)

    def tuned(self, u: np.ndarray, dt: float) -> dict[str, np.ndarray]:
        """Step once; return by how much W1, W2 and rho have changed."""
        before = self.copies(*TUNED)
        self.step(u, dt)
        return {name: now - before[name] for name, now in self.copies(*TUNED).items()}


def sigma(x: np.ndarray) -> np.ndarray:
    """Return the logistic function; real or complex."""
    rest: np.ndarray = 1.0 / (1.0 + np.exp(-x))
    return rest


def random_law(rng: np.random.Generator, **gains: float) -> tuple[Compiled, np.ndarray]:
    """Return a law with random weights, and random inputs."""
    compiled = Compiled(**gains)
    for name, old in compiled.copies(*TUNED).items():
        getattr(compiled.x, name)[:] = rng.normal(size=old.shape)
    return compiled, np.append(rng.normal(size=10), 0.0)


def test_the_derivative_of_the_lyapunov_function_has_the_form_of_the_proof() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        # powers of two: a step of 1 s changes the weights by their rates, all but exactly
        compiled, u = random_law(rng, kap1=0.5, alpha=0.5, kap2=0.125)
        g = GAINS | {"kap1": 0.5, "kap2": 0.125}
        w1, w2, rho = compiled.copies(*TUNED).values()
        v1, v2 = compiled.x.v1, compiled.x.v2
        rates = compiled.tuned(u, 1.0)
        ideal1, ideal2, other = (rng.normal(size=s) for s in ((10, 2), (10, 2), 2))  # eps - d

        e, de = u[:2] - u[4:6], u[2:4] - u[6:8]
        r = de + g["lam_per_s"] * e
        s1 = sigma(v1.T @ r)
        s2 = sigma(v2.T @ np.concatenate(([1.0], e, de, u[:4], u[8:10])))
        learned, v = compiled.y.learned_rad_s2, -compiled.y.robust_rad_s2
        r_rate = ideal2.T @ s2 + other - (learned + g["kv_per_s"] * r - v)

        h = 1e-30  # a complex step: the derivative without cancellation
        r_c, w1_c, w2_c = r + 1j * h * r_rate, w1 + 1j * h * rates["w1"], w2 + 1j * h * rates["w2"]
        signal_c = w1_c.T @ sigma(v1.T @ r_c) + rho + 1j * h * rates["rho"]
        squares = (r_c**2).sum() + (signal_c**2).sum() + ((ideal1 - w1_c) ** 2).sum()
        direct = 0.5 * (squares + ((ideal2 - w2_c) ** 2).sum() / g["gam"]).imag / h

        signal = w1.T @ s1 + rho
        sc = r + v1 @ (s1 * (1.0 - s1) * (w1 @ signal))
        closed = (
            -g["kv_per_s"] * r @ r + g["beta"] * signal @ r - (s1 @ s1) * (signal @ signal)
            + signal @ (ideal1 - w1).T @ s1 + g["kap1"] * np.trace((ideal1 - w1).T @ w1)
            + g["kap2"] * np.trace((ideal2 - w2).T @ w2) + sc @ (other + v)
        )  # fmt: skip
        assert direct == pytest.approx(closed, rel=1e-10, abs=1e-9), f"{direct} and {closed}"


def test_the_robust_term_takes_what_a_bounded_disturbance_gives() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        compiled, u = random_law(rng, delta_rad_s=1e-6)
        compiled.step(u, 0.0)
        robust, sc = compiled.y.robust_rad_s2, compiled.x.sc
        size = np.hypot(*robust)
        assert 4.99 < size <= 5.0, f"|v| {size}"
        assert sc @ robust > 0.99 * 5.0 * np.hypot(*sc), f"{robust} on {sc}"


def test_the_first_layer_of_the_critic_allows_a_beta_of_13() -> None:
    v1 = Compiled().x.v1
    angles = np.linspace(0.0, 2.0 * np.pi, 181)
    ring = np.array([np.cos(angles), np.sin(angles)])
    least = min((sigma(v1.T @ (size * ring)) ** 2).sum(0).min() for size in np.linspace(0, 8, 81))
    assert least == pytest.approx(2.015, abs=0.002), f"|s1|^2 {least:.4f}"
    limit = np.sqrt(4.0 * 30.0 * least * (1.0 - 0.25))
    assert limit == pytest.approx(13.4, abs=0.1), f"beta {limit:.2f}"


def test_without_beta_the_critic_never_wakes() -> None:
    rng = np.random.default_rng(3)
    asleep, off = Compiled(beta=0.0), Compiled(critic_on=0.0)
    for _ in range(200):
        u = np.append(rng.normal(size=10), 0.0)
        asleep.step(u, 1e-3)
        off.step(u, 1e-3)
        assert not asleep.y.critic.any() and asleep.y.norm_w1 == 0.0, asleep.y.critic
        assert np.array_equal(asleep.y.values(), off.y.values())
    assert asleep.y.norm_w2 > 1.0, "the action network learns all the same"


def test_all_parts_off_leave_the_pd_law() -> None:
    rng = np.random.default_rng(4)
    bare, u = random_law(rng, critic_on=0.0, action_on=0.0, kz=0.0)
    changes = bare.tuned(u, 1e-3)
    y = named_law.Law(arm_pd_inertia.BLOCK, GAINS).step(u)
    for name in ("torque_Nm", "e_rad", "r_rad_s"):
        assert np.array_equal(getattr(bare.y, name), getattr(y, name)), name
    assert not any(change.any() for change in changes.values()), "networks that are off rest"
    r = u[2:4] - u[6:8] + 5.0 * (u[:2] - u[4:6])
    c = float(cos(u[5]))
    tau = np.array([[3.0 + 2.0 * c, 1.0 + c], [1.0 + c, 1.0]]) @ (30.0 * r)
    assert y.torque_Nm == pytest.approx(tau, rel=1e-13), y.torque_Nm - tau


def test_weights_rest_in_a_cycle_without_a_measurement() -> None:
    compiled, u = random_law(np.random.default_rng(5))
    u[10] = 1.0
    changes = compiled.tuned(u, 1e-3)
    assert not any(change.any() for change in changes.values()), changes


def test_the_first_layers_are_drawn_in_the_order_v1_v2() -> None:
    draw = np.random.default_rng(7)
    first, second = draw.uniform(-1, 1, (2, 10)), draw.uniform(-1, 1, (11, 10))
    compiled = Compiled()
    assert np.array_equal(compiled.x.v1, first)
    assert np.array_equal(compiled.x.v2, second)

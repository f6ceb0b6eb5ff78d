"""Laws of the two-link arm: Lyapunov identity, tuning gain, variants of the jump nodes."""

import named_law
import numpy as np
import pytest
from numpy.typing import NDArray

from pcpc.plants.families.two_link.laws import arm_pd
from pcpc.plants.friction_arm.laws import friction_nn

LINKS = (1.1, 1.0, 3.0, 2.3)
GAINS = {
    "kv_1_Nms_rad": 20.0, "kv_2_Nms_rad": 20.0, "lam_1_per_s": 5.0, "lam_2_per_s": 5.0, "kz": 0.02,
    "z_bound": 100.0, "s_rate": 10.0, "t_rate": 10.0, "e_rate": 35.0, "kappa": 0.01,
    "v_eps_rad_s": 0.01, "jump_nodes": 1.0, "nodes": 10.0, "network_seed": 1.0,
}  # fmt: skip
N = 10
Vector = NDArray[np.float64]


class Law(named_law.Law):
    """The law; its weights without room for more nodes."""

    def __init__(self, **settings: float) -> None:
        super().__init__(friction_nn.BLOCK, GAINS | settings)
        self.v, self.w1, self.w2 = self.x.v[:, :N], self.x.w1[: N + 1], self.x.w2

    def weights(self) -> list[Vector]:
        """Return copies of all weights."""
        return list(self.copies("w1", "w2", "v").values())


def _inputs(rng: np.random.Generator) -> Vector:
    return np.append(rng.uniform(-1.0, 1.0, 10), 0.0)


def _jumps(rate: Vector) -> Vector:
    return np.concatenate([(1.0, 1.0 - np.exp(-v)) if v >= 0 else (0.0, 0.0) for v in rate])


def _sigmoid(z: Vector) -> Vector:
    return np.concatenate(([1.0], 1.0 / (1.0 + np.exp(-z))))


def test_the_lyapunov_function_falls_as_the_proof_says() -> None:
    """L' from plant, law and tuning against the identity with any ideal weights W*, V*."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        law = Law()
        law.v[:], law.w1[:] = rng.normal(size=(11, N)), rng.normal(size=(N + 1, 2))
        law.w2[:] = rng.normal(size=(4, 2))
        v, w1, w2 = law.v.copy(), law.w1.copy(), law.w2.copy()
        v_i, w1_i, w2_i = (
            rng.normal(size=v.shape),
            rng.normal(size=w1.shape),
            rng.normal(size=(4, 2)),
        )
        u = _inputs(rng)
        e, e_rate, rate = u[0:2] - u[4:6], u[2:4] - u[6:8], u[6:8]
        r = e_rate + 5.0 * e
        x = np.concatenate(([1.0], e, e_rate, u[0:4], u[8:10]))
        s, s_i, phi = _sigmoid(v.T @ x), _sigmoid(v_i.T @ x), _jumps(rate)
        jac = np.vstack((np.zeros(N), np.diag(s[1:] * (1 - s[1:]))))
        eps, disturbance = rng.normal(size=2), rng.normal(size=2)
        f = w1_i.T @ s_i + w2_i.T @ phi + eps

        dt = 1e-3
        tau = law.step(u, dt).torque_Nm
        dw1, dv, dw2 = (law.w1 - w1) / dt, (law.v - v) / dt, (law.w2 - w2) / dt
        h = LINKS[3] * LINKS[0] * LINKS[1] * np.sin(u[5])
        vm = np.array([[-h * rate[1], -h * (rate[0] + rate[1])], [h * rate[0], 0.0]])
        r_rate_times_m = -vm @ r - tau + f + disturbance
        m_rate = np.array([[-2.0 * h, -h], [-h, 0.0]]) * rate[1]
        fall = r @ r_rate_times_m + 0.5 * r @ m_rate @ r
        fall -= np.sum((w1_i - w1) * dw1) / 10.0 + np.sum((v_i - v) * dv) / 10.0
        fall -= np.sum((w2_i - w2) * dw2) / 35.0

        remainder = s_i - s - jac @ ((v_i - v).T @ x)
        w = (w1_i - w1).T @ jac @ (v_i.T @ x) + w1_i.T @ remainder + eps
        norm = np.sqrt((w1**2).sum() + (v**2).sum() + (w2**2).sum())
        robust = -0.02 * (norm + 100.0) * r
        leak = sum(np.sum((a - b) * b) for a, b in ((w1_i, w1), (v_i, v), (w2_i, w2)))
        proof = -20.0 * r @ r + r @ (w + disturbance + robust) + 0.01 * np.linalg.norm(r) * leak
        assert fall == pytest.approx(proof, abs=1e-9), f"L' {fall}, by the proof {proof}"


def test_the_tuning_gain_is_what_a_tick_adds_to_the_network() -> None:
    """With r along the only direction of W1 and one jump on, (9) of augmented.py is no bound."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        law = Law(kappa=0.0, kz=0.0)
        direction = rng.normal(size=2)
        direction /= np.linalg.norm(direction)
        law.w1[:] = np.outer(rng.normal(size=N + 1), direction)
        u = _inputs(rng)
        u[2:4] = u[6:8] + 5.0 * (u[4:6] - u[0:2]) + direction  # r = direction
        first, second = law.step(u, 1e-7), law.step(u, 1e-7)
        added = (second.network_Nm - first.network_Nm) @ direction
        said = first.tuning_gain_Nms_rad
        assert added == pytest.approx(said, rel=1e-4), f"{added:.4e}, said {said:.4e}"


def test_weights_rest_without_a_new_measurement() -> None:
    law, u = Law(), _inputs(np.random.default_rng(7))
    u[10] = 1.0
    before = law.weights()
    first = law.step(u)
    assert all(map(np.array_equal, law.weights(), before))
    u[10] = 0.0
    assert np.array_equal(law.step(u).torque_Nm, first.torque_Nm), "that of the weights before"
    assert not any(map(np.array_equal, law.weights(), before))


@pytest.mark.parametrize(
    ("variant", "at_rest", "forward", "backward"),
    [
        (0.0, (0, 0), (0, 0), (0, 0)),
        (1.0, (1, 0), (1, 1 - np.exp(-0.005)), (0, 0)),
        (2.0, (0.5, 0), (0.75, 1 - np.exp(-0.005)), (0.25, 0)),
        (3.0, (1, 0), (1, 1 - np.exp(-0.005)), (0, 0)),
        (4.0, (1, 0), (1, 0), (1, 0)),
    ],
)
def test_the_jump_nodes_of_every_variant(
    variant: float, at_rest: tuple[float], forward: tuple[float], backward: tuple[float]
) -> None:
    cases = ((0.0, at_rest), (-0.0, at_rest), (0.005, forward), (-0.005, backward))
    for rate, wanted in cases:
        law = Law(jump_nodes=variant)
        law.step([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, rate, rate, 0.0, 0.0, 0.0])
        assert law.x.phi == pytest.approx([*wanted, *wanted], abs=1e-15), f"q' {rate}"


def test_without_jump_nodes_their_weights_stay_zero() -> None:
    law, rng = Law(jump_nodes=0.0), np.random.default_rng(8)
    for _ in range(100):
        law.step(_inputs(rng))
    assert not law.w2.any() and law.w1.any(), law.w2


def test_projection_keeps_the_own_steps_weight_from_going_negative() -> None:
    free, kept = Law(), Law(jump_nodes=3.0)
    for _ in range(200):
        for law in (free, kept):
            law.step([-1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # r = -5
    assert (free.y.step_weight_Nm < -10.0).all(), free.y.step_weight_Nm
    assert not kept.y.step_weight_Nm.any(), kept.y.step_weight_Nm
    assert np.array_equal(free.w2[0, 1], kept.w2[0, 1]), "the other joint's weights are free"


def test_a_network_with_no_weights_is_pd_with_the_damping_of_the_robust_term() -> None:
    law = Law()
    law.v[:] = 0.0
    u = _inputs(np.random.default_rng(9))
    pd = named_law.Law(arm_pd.BLOCK, GAINS).step(u)
    found = law.step(u)
    assert found.torque_Nm == pytest.approx(pd.torque_Nm * (20.0 + 0.02 * 100.0) / 20.0, rel=1e-14)
    assert np.array_equal(found.e_rad, pd.e_rad) and np.array_equal(found.r_rad_s, pd.r_rad_s)


@pytest.mark.parametrize("nodes", [1.0, 8.0, 16.0])
def test_nodes_beyond_those_in_use_are_never_touched(nodes: float) -> None:
    law, rng = Law(nodes=nodes), np.random.default_rng(10)
    drawn = np.random.default_rng(1).uniform(-1.0, 1.0, (11, int(nodes)))
    assert np.array_equal(law.x.v[:, : int(nodes)], drawn)
    for _ in range(20):
        law.step(_inputs(rng))
    assert not law.x.v[:, int(nodes) :].any()
    assert not law.x.w1[int(nodes) + 1 :].any()

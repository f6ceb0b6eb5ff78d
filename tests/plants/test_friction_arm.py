"""The two-link arm by itself: energy, a second implementation, sampling; and the golden trace."""

from itertools import pairwise

import numpy as np
import pytest
from friction_loop import ARM, LAW, Loop, Vector
from stepped import Stepped

from pcpc.plants.families.two_link.equations import gravity_torque, inertia, velocity_torque
from pcpc.plants.friction_arm import model

A1, A2, M1, M2, G = (ARM[n] for n in ("a1_m", "a2_m", "m1_kg", "m2_kg", "gravity_m_s2"))
GOLDEN = """
0.000 0 0 0 0 110.5988207 110.5988207 5.988207332
0.001 -5.458964061e-06 2.318995302e-05 -0.009928198006 0.04217154449 111.1981916 110.0425811 5.995837101
0.002 -2.059172573e-05 8.789243411e-05 -0.01939420869 0.0831448209 111.7890898 109.5049486 6.011803559
0.010 -0.0004366674976 0.001961910939 -0.07951702771 0.3705499404 116.3595315 105.9626221 6.5845219
0.050 -0.005439671025 0.03530290546 -0.1162280383 1.175377147 142.1121408 103.8436661 15.43104297
0.100 -0.007242098806 0.1097260298 0 1.903424269 182.773812 105.7898944 29.18086354
0.200 0.01813190271 0.3353695432 0.7812693421 2.054857539 251.71287 105.1745191 54.94109921
"""  # noqa: E501  t, q, q', tau, |Z| of an independent implementation, nn_step, seed 1


def stepped(**settings: float) -> Stepped:
    """Return the arm with these settings, called every millisecond."""
    return Stepped(model.BLOCK, ARM | settings, 1e-3)


def energy(q: Vector, v: Vector) -> float:
    """Return kinetic and potential energy, J."""
    height = (M1 + M2) * A1 * np.sin(q[0]) + M2 * A2 * np.sin(q[0] + q[1])
    return float(0.5 * v @ mass(q) @ v + G * height)


def swing(dt: float, seconds: float = 2.0) -> Vector:
    """Return the energy of the frictionless arm at every millisecond of a fall from the side."""
    arm = stepped(friction_model=0.0, step_s=dt)
    found = [arm.step(0.0, 0.0) for _ in range(round(1000.0 * seconds))]
    return np.array([energy(y.true.q_rad, y.true.rate_rad_s) for y in found])


def test_the_energy_of_the_free_arm_drifts_by_the_first_order_of_the_step() -> None:
    drift = [np.abs(np.ptp(swing(dt))) for dt in (1e-3, 1e-4, 1e-5)]
    assert 0.1 < drift[0] < 1.0, f"drifts {drift} J"
    for coarse, fine in pairwise(drift):
        assert 8.0 < coarse / fine < 12.0, f"drifts {drift} J"


def test_inertia_rate_less_twice_coriolis_is_skew() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        q2, v1, v2 = rng.uniform(-3.0, 3.0, 3)
        h = M2 * A1 * A2 * np.sin(q2)
        vm = np.array([[-h * v2, -h * (v1 + v2)], [h * v1, 0.0]])
        assert vm @ (v1, v2) == pytest.approx(velocity_torque(h, v1, v2), rel=1e-12, abs=1e-12)
        rate = np.array([[-2.0 * h, -h], [-h, 0.0]]) * v2
        skew = rate - 2.0 * vm
        assert np.abs(skew + skew.T).max() < 1e-14, skew
        eps = 1e-6
        high, low = (np.array(inertia(np.cos(q2 + s), A1, A2, M1, M2)) for s in (eps, -eps))
        slope = (high - low) / (2.0 * eps) * v2
        assert slope == pytest.approx((rate[0, 0], rate[0, 1], rate[1, 1]), abs=1e-8)


def levels(v: Vector) -> Vector:
    """Return the friction levels of both joints, N m."""
    found = []
    for j in (1, 2):
        a0, a1, a2 = (ARM[f"{n}_{j}_Nm"] for n in ("coulomb", "stiction", "viscous"))
        b1, b2 = ARM[f"beta1_{j}_s_rad"], ARM[f"beta2_{j}_s_rad"]
        s = abs(v[j - 1])
        found.append(a0 + a1 * np.exp(-b1 * s) + a2 * (1.0 - np.exp(-b2 * s)))
    return np.array(found)


def mass(q: Vector) -> Vector:
    """Return M(q)."""
    cross = M2 * A1 * A2 * np.cos(q[1])
    m22 = M2 * A2**2
    return np.array([[(M1 + M2) * A1**2 + m22 + 2 * cross, m22 + cross], [m22 + cross, m22]])


def load(q: Vector, v: Vector) -> Vector:
    """Return Vm v + G."""
    h = M2 * A1 * A2 * np.sin(q[1])
    outer = M2 * G * A2 * np.cos(q[0] + q[1])
    return np.array(
        [
            -h * (2 * v[0] * v[1] + v[1] ** 2) + (M1 + M2) * G * A1 * np.cos(q[0]) + outer,
            h * v[0] ** 2 + outer,
        ]
    )


def reference_step(q: Vector, v: Vector, tau: Vector, dt: float) -> tuple[Vector, Vector]:
    """One plant step with projected Gauss-Seidel."""
    m, c = mass(q), dt * levels(v)
    p = m @ v + dt * (tau - load(q, v))
    new = v.copy()
    for _ in range(2000):
        before = new.copy()
        for i in range(2):
            free = p[i] - m[i, 1 - i] * new[1 - i]
            new[i] = np.sign(free) * max(abs(free) - c[i], 0.0) / m[i, i]
        if np.abs(new - before).max() < 1e-15:
            break
    return q + dt * new, new


def reference_lugre(
    q: Vector, v: Vector, z: Vector, tau: Vector, dt: float
) -> tuple[Vector, Vector, Vector]:
    """One plant step with LuGre friction."""
    s0, s1, v0 = ARM["s0_Nm_rad"], ARM["s1_Nms_rad"], ARM["v0_rad_s"]
    a0, a1, a2 = (
        np.array([ARM[f"{n}_{j}_Nm"] for j in (1, 2)]) for n in ("coulomb", "stiction", "viscous")
    )
    a = s0 * np.abs(v) / (a0 + a1 * np.exp(-((v / v0) ** 2)))
    slope = (s0 * dt + s1) / (1 + dt * a) + a2
    offset = (s0 - s1 * a) * z / (1 + dt * a)
    m = mass(q)
    new = np.linalg.solve(m + dt * np.diag(slope), m @ v + dt * (tau - load(q, v) - offset))
    return q + dt * new, new, (z + dt * new) / (1 + dt * a)


class ReferenceLaw:
    """nn_step written with matrices."""

    def __init__(self) -> None:
        self.v = np.random.default_rng(1).uniform(-1, 1, (11, 10))
        self.w1, self.w2 = np.zeros((11, 2)), np.zeros((4, 2))

    def step(self, q: Vector, rate: Vector) -> Vector:
        """Return the torque, tune."""
        e, e_rate = 1.0 - q, -rate
        r = e_rate + 5.0 * e
        x = np.concatenate(([1.0], e, e_rate, (1.0, 1.0), np.zeros(4)))
        z = self.v.T @ x
        s = np.concatenate(([1.0], 1 / (1 + np.exp(-z))))
        jac = np.vstack((np.zeros(10), np.diag(s[1:] * (1 - s[1:]))))
        phi = np.concatenate([(1.0, 1 - np.exp(-w)) if w >= 0 else (0.0, 0.0) for w in rate])
        size = np.sqrt((self.v**2).sum() + (self.w1**2).sum() + (self.w2**2).sum())
        tau = 20.0 * r + self.w1.T @ s + self.w2.T @ phi + LAW["kz"] * (size + LAW["z_bound"]) * r
        leak, dt = 0.01 * np.linalg.norm(r), 1e-3
        w1 = self.w1 + dt * 10.0 * (np.outer(s, r) - np.outer(jac @ z, r) - leak * self.w1)
        v = self.v + dt * 10.0 * (np.outer(x, jac.T @ self.w1 @ r) - leak * self.v)
        self.w2 = self.w2 + dt * 35.0 * (np.outer(phi, r) - leak * self.w2)
        self.w1, self.v = w1, v
        return np.asarray(tau)


@pytest.mark.parametrize("friction_model", [1.0, 2.0])
def test_a_second_implementation_of_arm_and_law_agrees(friction_model: float) -> None:
    law = ReferenceLaw()
    q, v, z, tau = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    loop = Loop(step_s=2.5e-4, friction_model=friction_model)
    for k, (t, arm, _) in enumerate(loop.run(250)):
        for _ in range(4 if k else 0):
            if friction_model == 1.0:
                q, v = reference_step(q, v, tau, 2.5e-4)
            else:
                q, v, z = reference_lugre(q, v, z, tau, 2.5e-4)
        tau = law.step(q, v)
        error = max(np.abs(arm.sample.q_rad - q).max(), np.abs(arm.sample.rate_rad_s - v).max())
        assert error < 1e-10, f"{error:.1e} at {t} s"


def test_arm_and_law_reproduce_the_golden_trace() -> None:
    golden = [np.array(line.split(), float) for line in GOLDEN.strip().splitlines()]
    loop, found = Loop(), 0
    for t, arm, law in loop.run(201):
        for row in golden:
            if abs(t - row[0]) < 1e-9:
                motion = (*arm.sample.q_rad, *arm.sample.rate_rad_s)
                ours = np.array((*motion, *law.torque_Nm, law.norm_z))
                assert ours == pytest.approx(row[1:], rel=1e-6, abs=1e-14), f"{t} s: {ours}"
                found += 1
    assert found == len(golden)


def test_a_stuck_joint_has_exactly_no_velocity_and_friction_balances_its_load() -> None:
    loop = Loop(jump_nodes=2.0)
    stuck = np.zeros(2, int)
    for t, arm, _ in loop.run(5000):
        for j in range(2):
            if t > 1.0 and arm.true.rate_rad_s[j] == 0.0:
                stuck[j] += 1
                friction = abs(arm.friction_Nm[j])
                assert friction <= (36.1, 39.0)[j] * (1 + 1e-9), f"{friction} N m"
    assert (stuck > 500).all(), f"{stuck} of 4000 cycles stuck"


def test_lugre_bristles_stay_within_break_away_in_the_loop() -> None:
    loop, most = Loop(jump_nodes=2.0, friction_model=2.0), 0.0
    for _ in loop.run(5000):
        most = max(most, abs(loop.arm.x.motion.z_rad[0]))
    s0_z = ARM["s0_Nm_rad"] * most
    assert 34.5 < s0_z <= 36.1, f"s0 |z| {s0_z:.2f} N m"


def test_gravity_holds_the_arm_where_its_torque_says() -> None:
    g1, g2 = gravity_torque(0.0, 0.0, A1, A2, M1, M2, G)
    assert (g1, g2) == pytest.approx(load(np.zeros(2), np.zeros(2))), (g1, g2)
    arm = stepped()
    for _ in range(200):  # 0.1 N m short of break-away, without motion of joint 2
        y = arm.step(g1 + 36.0, g2)
    assert y.true.rate_rad_s[0] == 0.0 and y.true.q_rad[0] == 0.0, f"moved to {y.true.q_rad[0]} rad"
    for _ in range(200):
        y = arm.step(g1 + 36.2, g2)
    assert y.true.q_rad[0] > 0.0, f"held at {y.true.q_rad[0]} rad beyond break-away"


def test_the_delay_is_whole_samples_and_zero_acts_at_once() -> None:
    for delay in range(8):
        arm = stepped(delay_samples=float(delay))
        acting = [tuple(arm.step(k, -k).acting_Nm) for k in range(12)]
        wanted = [max(0.0, float(k - delay)) for k in range(12)]
        assert acting == [(w, -w) for w in wanted], f"delay {delay}: {acting}"


def test_quanta_round_samples_and_torques_and_nothing_else() -> None:
    quanta = {"torque_lsb_Nm": 0.5, "position_lsb_rad": 1e-3, "rate_lsb_rad_s": 1e-2}
    arm = stepped(**quanta)
    for k in range(300):
        y = arm.step(150.3, 90.3)
        if k:
            assert tuple(y.acting_Nm) == (150.5, 90.5), y.acting_Nm
        pairs = (
            (y.sample.q_rad, y.true.q_rad, 1e-3),
            (y.sample.rate_rad_s, y.true.rate_rad_s, 1e-2),
        )
        for sample, true, quantum in pairs:
            assert sample / quantum == pytest.approx(np.round(sample / quantum), abs=1e-9)
            assert (abs(sample - true) <= 0.5 * quantum * (1 + 1e-9)).all(), f"{sample} of {true}"
    assert any((sample != true).any() for sample, true, _ in pairs), "the truth is not rounded"


@pytest.mark.parametrize(("rate_hz", "substeps"), [(8.0, 1250), (1000.0, 10), (20000.0, 1)])
def test_whole_integration_steps_fit_the_period(rate_hz: float, substeps: int) -> None:
    found = Stepped(model.BLOCK, ARM, 1.0 / rate_hz).p.substeps
    assert found == substeps, found

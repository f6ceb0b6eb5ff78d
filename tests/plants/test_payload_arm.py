"""The arm with a payload by itself and in its loop: energy, order, a second implementation."""

import numpy as np
import pytest
from payload_arm_reference import ARM, LAW, Vector, acceleration, loop
from stepped import Stepped, vector

from pcpc.executive.laws.block import Nothing, Ports, group, port, stage
from pcpc.plants.families.two_link.laws import network_inputs
from pcpc.plants.payload_arm import model
from pcpc.plants.payload_arm.laws import adaptive_critic
from pcpc.plants.payload_arm.model import Motion

FREE = {"viscous_Nms_rad": 0.0, "coulomb_Nm": 0.0}
T_S = 1e-3


class Held(Ports):
    """What acts while the arm moves."""

    motion = group(Motion)
    acting_Nm = port("N m", "torques", shape=2)
    outer_mass_kg = port("kg", "m2")


@stage
def _slope(t: float, dt: float, p: model.Parameters, x: Nothing, u: Held, y: Motion) -> None:
    model.slope(t, p, u, u.motion, y)


def energy(x: Vector, m2: float) -> float:
    """Return kinetic and potential energy of point masses, from their velocities, J."""
    q1, q12 = x[0], x[0] + x[1]
    elbow = x[2] * np.array((-np.sin(q1), np.cos(q1)))
    hand = elbow + (x[2] + x[3]) * np.array((-np.sin(q12), np.cos(q12)))
    height = np.sin(q1) + m2 * (np.sin(q1) + np.sin(q12))
    return float(0.5 * (elbow @ elbow + m2 * hand @ hand) + ARM["gravity_m_s2"] * height)


def fall(h: float, seconds: float = 1.0, m2: float = 2.5, **other: float) -> tuple[Vector, Vector]:
    """Return states and energies of a fall from the horizontal under no torque."""
    arm = Stepped(model.BLOCK, ARM | {"m2_kg": m2, "substeps": 1.0} | other, h)
    arm.x.motion.q_rad[:] = 0.0, 0.5
    states = []
    for _ in range(round(seconds / h) + 1):
        arm.step(0.0, 0.0)
        states.append(arm.x.motion.values().copy())
    return np.array(states), np.array([energy(state, m2) for state in states])


def test_the_free_arm_keeps_its_energy_to_the_order_of_runge_kutta() -> None:
    drift = [np.ptp(fall(h, **FREE)[1]) for h in (4e-3, 2e-3, 1e-4)]
    assert drift[2] < 1e-10, f"drifts {drift} J"
    assert 12.0 < drift[0] / drift[1] < 40.0, f"drifts {drift} J"


def test_friction_takes_the_energy_that_it_works() -> None:
    h = 1e-4
    states, energies = fall(h)
    v = states[:, 2:]
    power = (v * (ARM["viscous_Nms_rad"] * v + ARM["coulomb_Nm"] * np.tanh(v / 0.05))).sum(axis=1)
    work = h * (power.sum() - 0.5 * (power[0] + power[-1]))
    lost = energies[0] - energies[-1]
    assert lost == pytest.approx(work, rel=1e-6), f"{lost} of {work} J"
    assert lost > 1.0, f"only {lost} J in 1 s"


def test_the_acceleration_is_that_of_the_matrices() -> None:
    rng = np.random.default_rng(1)
    p, y = vector(model.BLOCK.parameters, ARM), Motion(np.zeros(Motion.size))
    for _ in range(50):
        q, v, tau = rng.normal(size=2), 2.0 * rng.normal(size=2), 50.0 * rng.normal(size=2)
        for m2 in (1.0, 2.5):
            _slope(0.0, 0.0, p, np.zeros(0), np.array((*q, *v, *tau, m2)), y.values())
            assert y.rate_rad_s == pytest.approx(acceleration(q, v, tau, m2), rel=1e-11), (q, v)
            assert (y.q_rad == v).all(), y.q_rad


def compiled_loop(cycles: int, payload_kg: float) -> tuple[Vector, Vector]:
    """Return q, q', tau (cycles, 6) and m2 of the compiled arm and law without bus and rounding."""
    arm = Stepped(model.BLOCK, ARM | {"payload_kg": payload_kg}, T_S)
    law = Stepped(adaptive_critic.BLOCK, LAW, T_S)
    found, m2 = np.zeros((cycles, 6)), np.zeros(cycles)
    u = network_inputs.Inputs(np.zeros(network_inputs.Inputs.size))
    for k in range(cycles):
        y = arm.step(*law.y.torque_Nm)
        s, c = np.sin(k * T_S), np.cos(k * T_S)
        u.q_d_rad[:], u.q_d_rate_rad_s[:], u.q_d_acc_rad_s2[:] = (s, c), (c, -s), (-s, -c)
        u.q_rad[:], u.rate_rad_s[:] = y.sample.q_rad, y.sample.rate_rad_s
        tau = law.step(*u.values()).torque_Nm
        found[k], m2[k] = (*y.true.q_rad, *y.true.rate_rad_s, *tau), y.outer_mass_kg
    return found, m2


def test_arm_and_law_are_those_of_a_second_implementation() -> None:
    mine, _ = compiled_loop(600, 0.0)
    other = np.array([np.concatenate(each) for each in loop(600)])
    apart = np.abs(mine - other).max(axis=0)
    assert (apart[:4] < 1e-11).all() and (apart[4:] < 1e-9).all(), f"apart by {apart}"
    assert np.abs(mine[0, 4:]).max() > 400.0, "it starts 1 rad away"


def test_the_payload_is_there_from_5_to_7_s_to_the_period() -> None:
    _, m2 = compiled_loop(7100, 1.5)
    loaded = np.flatnonzero(m2 == 2.5)  # m2[k] acted up to sample k
    assert (loaded[0], loaded[-1], len(loaded)) == (5001, 7000, 2000), loaded
    assert (np.delete(m2, loaded) == 1.0).all(), m2


@pytest.mark.parametrize("samples", [0, 1, 3])
def test_the_torque_acts_as_many_samples_later_as_set(samples: int) -> None:
    arm = Stepped(model.BLOCK, ARM | {"delay_samples": samples, "torque_lsb_Nm": 0.5}, T_S)
    for k in range(8):
        acting = arm.step(k + 0.3, -k - 0.3).acting_Nm[0]
        sent = k - samples + 0.5 if k > samples else 0.0
        assert acting == sent, f"sample {k}: {acting} for {sent}"


def test_samples_are_multiples_of_their_quantum_and_the_truth_is_not() -> None:
    quanta = {"position_lsb_rad": 1e-3, "rate_lsb_rad_s": 1e-2}
    arm = Stepped(model.BLOCK, ARM | quanta, T_S)
    for _ in range(50):
        y = arm.step(0.0, 0.0)
        pairs = (
            (y.sample.q_rad, y.true.q_rad, 1e-3),
            (y.sample.rate_rad_s, y.true.rate_rad_s, 1e-2),
        )
        for sample, true, quantum in pairs:
            assert sample / quantum == pytest.approx(np.round(sample / quantum), abs=1e-9)
            assert (abs(sample - true) <= 0.5 * quantum * (1 + 1e-9)).all(), f"{sample} of {true}"
    assert all((sample != true).all() for sample, true, _ in pairs), "the truth is not rounded"

"""The arm with a payload by itself and in its loop: energy, order, a second implementation."""

import numpy as np
import pytest
from payload_arm_reference import ARM, LAW, Vector, acceleration, loop, values, views

from pcpc.executive.laws.block import Nothing, Ports, group, port, stage
from pcpc.executive.laws.controllers.arm import adaptive_critic
from pcpc.plants.payload_arm import model
from pcpc.plants.payload_arm.model import Motion

FREE = {"viscous_Nms_rad": 0.0, "coulomb_Nm": 0.0}
MOTION = Motion.size


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
    p, x = views(model.BLOCK, ARM | {"m2_kg": m2, "substeps": 1.0} | other)
    x[1] = 0.5
    states, y = [x[:MOTION].copy()], np.zeros(model.Outputs.size)
    for k in range(1, round(seconds / h) + 1):
        model.step(k * h, h, p, x, np.zeros(2), y)
        states.append(x[:MOTION].copy())
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
    p, y = values(model.BLOCK.settings, ARM), np.zeros(MOTION)
    for _ in range(50):
        q, v, tau = rng.normal(size=2), 2.0 * rng.normal(size=2), 50.0 * rng.normal(size=2)
        for m2 in (1.0, 2.5):
            _slope(0.0, 0.0, p, np.zeros(0), np.array((*q, *v, *tau, m2)), y)
            assert y[2:] == pytest.approx(acceleration(q, v, tau, m2), rel=1e-11), (q, v)
            assert (y[:2] == v).all(), y


def compiled_loop(cycles: int, payload_kg: float) -> tuple[Vector, Vector]:
    """Return q, q', tau (cycles, 6) and m2 of the compiled arm and law without bus and rounding."""
    p, x = views(model.BLOCK, ARM | {"payload_kg": payload_kg})
    law_p, law_x = views(adaptive_critic.BLOCK, LAW)
    y, law_y = (np.zeros(b.size(b.outputs)) for b in (model.BLOCK, adaptive_critic.BLOCK))
    u, found, m2 = np.zeros(11), np.zeros((cycles, 6)), np.zeros(cycles)
    for k in range(cycles):
        t = k * 1e-3
        model.step(t, 1e-3, p, x, law_y[:2].copy(), y)
        s, c = np.sin(t), np.cos(t)
        u[:4], u[4:8], u[8:10] = (s, c, c, -s), y[:4], (-s, -c)
        adaptive_critic.step(t, 1e-3, law_p, law_x, u, law_y)
        found[k, :4], found[k, 4:], m2[k] = y[4:8], law_y[:2], y[10]
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
    p, x = views(model.BLOCK, ARM | {"delay_samples": samples, "torque_lsb_Nm": 0.5})
    y = np.zeros(model.Outputs.size)
    for k in range(8):
        model.step(k * 1e-3, 1e-3, p, x, np.array((k + 0.3, -k - 0.3)), y)
        sent = k - samples + 0.5 if k > samples else 0.0
        assert y[8] == sent, f"sample {k}: {y[8]} for {sent}"


def test_samples_are_multiples_of_their_quantum_and_the_truth_is_not() -> None:
    p, x = views(model.BLOCK, ARM | {"position_lsb_rad": 1e-3, "rate_lsb_rad_s": 1e-2})
    y = np.zeros(model.Outputs.size)
    for k in range(50):
        model.step(k * 1e-3, 1e-3, p, x, np.zeros(2), y)
        for sample, true, quantum in ((y[0], y[4], 1e-3), (y[2], y[6], 1e-2)):
            assert sample / quantum == pytest.approx(round(sample / quantum), abs=1e-9)
            assert abs(sample - true) <= 0.5 * quantum * (1 + 1e-9), f"{sample} of {true}"
    assert (y[4:8] != y[:4]).all(), "the true motion is not rounded"

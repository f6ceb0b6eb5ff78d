"""Tests of the cart and its control: `pytest` in this folder runs them, nothing is to be imported.

`simulate` and `rig` come with pcpc (docs/python.md): a run in virtual time, and one of real
processes on a bus. A test that fails names its log, its figure and what was not met. (1) to (7):
model.py.
"""

from pathlib import Path

import numpy as np
import pytest

import pcpc

RIG = Path(__file__).with_name("rig.yaml")
FREE = {"cart.viscous_Ns_m": 0.0}
MOTION = ["position_m", "speed_m_s", "angle_rad", "rate_rad_s"]


def numbers(rig):
    """Return a, h, d, G, D of (1), and b."""
    p = rig.config.plant.blocks["cart"].parameters
    h = p["pole_kg"] * p["centre_m"]
    a, d = p["cart_kg"] + p["pole_kg"], p["inertia_kg_m2"] + h * p["centre_m"]
    return a, h, d, 9.81 * h, a * d - h * h, p["viscous_Ns_m"]


def pushed(force_N, **settings):
    """Return a run under a constant force, and x, x', q, q' of its cycles."""
    loop = pcpc.loop(RIG, set=settings)
    for sample in loop:
        sample.command["force_N"] = force_N
    return loop.run, [loop.run[f"plant:cart.{name}"] for name in MOTION]


@pytest.mark.parametrize("controller", ["state_feedback", "soft"])
def test_it_meets_its_limits(simulate, controller):
    simulate(RIG, controller).check()


def test_real_processes_in_lockstep_give_the_bits_of_virtual_time(simulate, rig):
    with rig(RIG, pacing="lockstep") as live:
        live.wait()
    virtual = simulate(RIG)
    for name in ("controller.force_N", "plant:cart.angle_rad"):
        np.testing.assert_array_equal(live.run[name], virtual[name])


@pytest.mark.parametrize(("force_N", "start_rad"), [(0.0, 1.0), (2.0, 0.0), (-3.0, 0.5)])
def test_without_friction_energy_and_momentum_are_those_of_the_force(force_N, start_rad):
    run, (x, v, q, w) = pushed(force_N, **FREE, duration_s=2.0, **{"cart.start_rad": start_rad})
    a, h, d, weight_Nm, _, _ = numbers(run.rig)
    energy_J = a * v * v / 2 + h * v * w * np.cos(q) + d * w * w / 2 + weight_Nm * np.cos(q)  # (6)
    momentum_Ns = a * v + h * w * np.cos(q)
    held_s = np.maximum(run.t_s - 0.001, 0.0)  # the first command acts from the first sample on
    gained_J = force_N * (x - x[1])
    np.testing.assert_allclose(energy_J[1:], energy_J[1] + gained_J[1:], atol=1e-8)
    np.testing.assert_allclose(momentum_Ns, force_N * held_s, atol=1e-8)
    assert np.abs(q).max() > 3.0, "it fell through"


@pytest.mark.parametrize("start_rad", [-1e-5, 1e-5])
def test_near_the_top_it_falls_as_the_linear_equations_say(start_rad):
    run, (x, _, q, _) = pushed(0.0, **FREE, duration_s=1.0, **{"cart.start_rad": start_rad})
    a, h, _, weight_Nm, determinant, _ = numbers(run.rig)
    expected_rad = start_rad * np.cosh(np.sqrt(a * weight_Nm / determinant) * run.t_s)  # (7)
    np.testing.assert_allclose(q, expected_rad, rtol=1e-5)
    np.testing.assert_allclose(x, -h / a * (q - start_rad), atol=1e-10)


@pytest.mark.parametrize(("controller", "pole_per_s"), [("state_feedback", -5.0), ("soft", -3.0)])
def test_the_gains_place_four_poles(simulate, controller, pole_per_s):
    run = simulate(RIG, controller, set={"duration_s": 0.1})
    a, h, d, weight_Nm, determinant, b = numbers(run.rig)
    _, c3, c2, c1, c0 = np.poly([pole_per_s] * 4)
    kx, kv = determinant * c0 / weight_Nm, b + determinant * c1 / weight_Nm
    kq = (determinant * c2 + a * weight_Nm + d * kx) / h
    kw = (determinant * c3 + d * (kv - b)) / h
    own = run.rig.config.controllers
    found = own["state_feedback"].parameters | own[controller].parameters
    names = ["kx_N_m", "kv_Ns_m", "kq_N_rad", "kw_Ns_rad"]
    assert [found[name] for name in names] == pytest.approx([kx, kv, kq, kw], rel=3e-3)


@pytest.mark.parametrize("move_m", [-0.5, -0.1, 0.05, 0.5])
def test_every_move_ends_at_rest_with_the_pole_up(simulate, move_m):
    run = simulate(RIG, set={"reference.amplitude": move_m})
    assert run.metrics["rest_error_max_mm"] < 2.0
    assert run.metrics["lean_max_mrad"] < 350.0
    assert run.metrics["force_max_N"] <= 10.0


@pytest.mark.parametrize("controller", ["state_feedback", "soft"])
@pytest.mark.parametrize("start_rad", [-0.5, 0.1, 0.3])
def test_a_pole_that_leans_is_caught(simulate, controller, start_rad):
    move = {"reference.amplitude": 0.0, "cart.start_rad": start_rad}
    run = simulate(RIG, controller, set=move)
    angle_rad, error_mm = run["plant:cart.angle_rad"], run.metrics["rest_error_max_mm"]
    assert np.abs(angle_rad).max() < 1.2 * abs(start_rad)
    assert np.abs(angle_rad[-500:]).max() < 0.002 and error_mm < 10.0


@pytest.mark.parametrize("at_s", [0.6, 0.9, 2.0])
def test_one_controller_takes_over_from_the_other_in_the_move(simulate, at_s):
    schedule = [{"at_s": at_s, "handover": "state_feedback"}]
    run = simulate(RIG, "soft", set={"standby": ["state_feedback"], "schedule": schedule})
    assert run.metrics["lean_max_mrad"] < 100.0
    assert run.metrics["rest_error_max_mm"] < 2.0

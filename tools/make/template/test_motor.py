"""Tests of the motor and its control: `pytest` in this folder runs them, nothing is to be imported.

`simulate` and `rig` come with pcpc (docs/python.md): a run in virtual time, and one of real
processes on a bus. A test that fails names its log, its figure and what was not met.
"""

from pathlib import Path

import numpy as np
import pytest

import pcpc

RIG = Path(__file__).with_name("rig.yaml")


@pytest.mark.parametrize("controller", ["pid", "pd"])
def test_it_meets_its_limits(simulate, controller):
    simulate(RIG, controller).check()


def test_real_processes_in_lockstep_give_the_bits_of_virtual_time(simulate, rig):
    with rig(RIG, pacing="lockstep") as live:
        live.wait()
    virtual = simulate(RIG)
    for name in ("controller.voltage_V", "plant:motor.angle_rad"):
        np.testing.assert_array_equal(live.run[name], virtual[name])


@pytest.mark.parametrize("voltage_V", [-12.0, 6.0, 24.0])
def test_a_constant_voltage_ends_at_the_speed_of_the_closed_form(voltage_V):
    loop = pcpc.loop(RIG, set={"duration_s": 2.0})
    for sample in loop:
        sample.command["voltage_V"] = voltage_V
    p = loop.run.rig.config.plant.blocks["motor"].parameters
    k, r = p["torque_constant_Nm_A"], p["resistance_ohm"]
    friction_Nm = np.copysign(p["coulomb_Nm"], voltage_V)
    expected = (k * voltage_V / r - friction_Nm) / (p["viscous_Nms_rad"] + k * k / r)
    assert loop.run["plant:motor.speed_rad_s"][-1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("move_rad", [-4.0, -0.5, 0.1, 1.0, 4.0])
def test_every_move_ends_within_two_counts_and_within_the_drivers_voltage(simulate, move_rad):
    run = simulate(RIG, set={"reference.amplitude_rad": move_rad})
    assert run.metrics["rest_error_max_mrad"] < 7.0
    assert run.metrics["voltage_max_V"] <= 24.0


@pytest.mark.parametrize("friction_Nm", [0.001, 0.004])
def test_without_an_integral_friction_holds_the_motor_off_its_target(simulate, friction_Nm):
    run = simulate(RIG, "pd", set={"motor.coulomb_Nm": friction_Nm})
    held_mrad = 1e3 * friction_Nm * 4.0 / (0.0274 * 30.0)  # Tc R/(K Kp)
    assert run.metrics["rest_error_max_mrad"] < held_mrad + 3.2, "and a count"
    assert run.metrics["rest_error_max_mrad"] > 0.5 * held_mrad


@pytest.mark.parametrize("at_s", [0.2, 0.5])
def test_pid_takes_over_where_pd_left(simulate, at_s):
    schedule = [{"at_s": at_s, "handover": "pid"}]
    run = simulate(RIG, "pd", set={"standby": ["pid"], "schedule": schedule})
    error_rad = np.abs(run["controller.e_rad"][round(1000 * at_s) :])
    assert error_rad.max() < 0.016, (
        "(6) of laws/pid.py: what friction leaves of pd's error, not 2 rad"
    )
    assert error_rad[-100:].max() < 0.0032, "the integral removes what friction left"

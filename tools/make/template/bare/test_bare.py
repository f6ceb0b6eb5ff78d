"""Tests of the plant and its control: `pytest` in this folder runs them.

`simulate` and `rig` come with pcpc (docs/python.md): a run in virtual time, and one of real
processes on a bus.
"""

from pathlib import Path

import numpy as np

import pcpc

RIG = Path(__file__).with_name("rig.yaml")


def test_it_meets_its_requirements(simulate):
    simulate(RIG).check()


def test_real_processes_in_lockstep_give_the_bits_of_virtual_time(simulate, rig):
    with rig(RIG, pacing="lockstep") as live:
        live.wait()
    np.testing.assert_array_equal(live.run["controller.error"], simulate(RIG)["controller.error"])


def test_a_constant_command_gives_the_closed_form():
    """Y = u (1 - exp(-t/T)) from the second sample on: (1) of model.py."""
    loop = pcpc.loop(RIG)
    for sample in loop:
        sample.command["command"] = 2.0
    after_s = loop.run.t_s - 1e-3
    wanted = 2.0 * -np.expm1(-np.maximum(after_s, 0.0) / 0.2)
    np.testing.assert_allclose(loop.run["plant:lag.output"], wanted, atol=1e-9)

"""Tests of the device: `pytest` in this folder runs them. `rig` and `simulate` come with pcpc."""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
COMMAND = [
    sys.executable,
    str(HERE / "device.py"),
    "{bus}",
]  # []: started elsewhere


def test_the_device_meets_the_limits_and_has_the_bits_of_the_law(rig, simulate):
    with rig(HERE / "device.yaml", pacing="lockstep", device=COMMAND) as live:
        run = live.wait(within_s=60)
    run.check()
    assert run.summary["device"]["late_cycles"] == 0
    virtual = simulate(HERE / "rig.yaml")
    for name in ("plant:motor.angle_rad", "plant:motor.held_V"):
        np.testing.assert_array_equal(run[name][: len(virtual.t_s)], virtual[name])

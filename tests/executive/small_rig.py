"""A small rig as text, with its laws; what a test changes in it, and what it is told then."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import load_rig

RIG = """\
rig: small
title: one joint
dbc: small.dbc
rate_hz: 1000
duration_s: 6.0
bus: {bitrate: 1000000}
controller: pd
controllers:
  pd:
    law: "laws.py:PD"
    parameters: {kv_Nms_rad: 110.0}
  nn:
    law: laws.py
    inputs: {extra: barrel.rate_rad_s}
executive:
  node: EXEC
  blocks:
    reference: {law: "laws.py:STEP", parameters: {size_rad: 1}}
    controller:
      inputs: {q_rad: rx.FB.angle, ref_rad: reference.ref_rad}
  transmit: {CMD.motor_torque: controller.tau_Nm}
  limits: {CMD.motor_torque: {low: -2.0, high: 2.0, rate_per_s: null}}
plant:
  node: PLANT
  parameters_file: parameters.yaml
  blocks:
    barrel:
      law: model.py:BARREL
      inputs: {tau_Nm: rx.CMD.motor_torque}
      parameters: {gap_rad: 0.003}
  transmit: {FB.angle: barrel.q_rad}
  safe: {CMD.motor_torque: 0.0}
evaluation: {file: evaluation.py, window_s: [3.25, 6.0], tolerance_rad: 0.01}
watch: controller.tau_Nm
expect: {pd: {error_rms_rad: [3.1, 3.8]}}
"""
PARAMETERS = """\
barrel:
  mass_kg: {value: 80, unit: kg, reason: drawing}
  gap_rad: {value: 0.002, unit: rad, reason: measured}
"""
LAWS = """\
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage

class Gains(Ports):
    kv_Nms_rad = port("N m s/rad", "velocity gain", low=0, high=500)
    lam_per_s = port("1/s", "slope", default=16.0)

class Weights(Ports):
    w = port("", "weights", default=0.5, shape=3)

class Size(Ports):
    size_rad = port("rad", "height of the step")

@stage
def pd(t, dt, p: Gains, x: Nothing, u: Nothing, y: Nothing): pass

@stage
def weighted(t, dt, p: Weights, x: Nothing, u: Nothing, y: Nothing): pass

@stage
def step(t, dt, p: Size, x: Nothing, u: Nothing, y: Nothing): pass

PD, BLOCK, STEP = Block(pd), Block(weighted), Block(step)
NUMBER = 3
"""
MODEL = """\
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage

class Parameters(Ports):
    mass_kg = port("kg", "mass", low=0.1)
    gap_rad = port("rad", "clearance", low=0.0, high=0.1)

@stage
def step(t, dt, p: Parameters, x: Nothing, u: Nothing, y: Nothing): pass

BARREL = Block(step)
"""

Write = Callable[..., Path]


@dataclass
class Case:
    """A rig with one thing replaced, and the message that it must give."""

    old: str
    new: str
    expected: str


def message(path: Path, controller: str | None = None, *options: str) -> str:
    with pytest.raises(RigError) as caught:
        load_rig(path, controller, options)
    assert "\n" not in str(caught.value), caught.value
    return str(caught.value)

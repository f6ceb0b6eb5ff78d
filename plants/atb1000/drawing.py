"""The barrel from the side, the hull seen from its trunnion; bending and play magnified.

    true axis   x along theta, y = BENDING sum_i f_i(x) q_i            beam.py (3), (4)        (1)
    wind-up     motor angle / N - (theta - pitch), in a slot of the gap's width                (2)
    errors      theta - q_d of the hub; of the muzzle evaluation.py (2) with the other sign    (3)

rad, m, N m.
"""

import math
from dataclasses import fields

import numpy as np

from pcpc.plants.atb1000.beam import Tube, modal_data, mode_shapes
from pcpc.plants.drawing import *

BENDING = 40.0
NEEDS = {
    "q_d": "executive:reference.q_d_rad",
    "theta": "plant:barrel.theta_rad",
    "q1": "plant:barrel.q1",
    "q2": "plant:barrel.q2",
    "q3": "plant:barrel.q3",
    "slope": "plant:barrel.elastic_slope_rad",
    "droop": "plant:barrel.droop_rad",
    "pitch": "plant:barrel.hull_rad",
    "motor": "plant:barrel.motor_angle_rad",
    "torque": "plant:barrel.gear_torque_Nm",
}
FIGURE = Figure("rigs/slew10.yaml", at_s=(0.5, 0.7, 0.85, 1.15), columns=2)
HUB = (0.0, 0.0)
FULL_NM, FULL_RAD = 30.0, 6e-3  # of torque arrow and error gauge


def turned_points(points: list[Point], angle: float) -> list[Point]:
    """Return points turned about the hub."""
    c, s = math.cos(angle), math.sin(angle)
    return [(c * x - s * y, s * x + c * y) for x, y in points]


def bent_axis(now: Now, p: Settings) -> list[Point]:
    """Return the true axis (1)."""
    beam = modal_data(Tube(*(float(p[field.name]) for field in fields(Tube))))
    x = np.linspace(0.0, long := float(p["length_m"]), 13)
    f, _, _ = mode_shapes(beam.roots, long, x)
    y = BENDING * (beam.tip / f[:, -1] * [now["q1"], now["q2"], now["q3"]]) @ f
    return turned_points(list(zip(x.tolist(), y.tolist(), strict=True)), now["theta"])


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    theta, pitch, long = now["theta"], now["pitch"], p["length_m"]
    hull = turned_points(
        [(-0.75, -0.05), (-0.6, -0.3), (0.35, -0.3), (0.5, -0.16), (0.12, -0.1)], pitch
    )
    (motor,) = turned_points([(-0.42, -0.1)], pitch)
    tube = [*turned_points([(0.0, -0.035), (long, -0.02), (long, 0.02), (0.0, 0.035)], theta)]
    muzzle = now["slope"] - now["droop"] * math.cos(now["q_d"]) / math.cos(theta)
    wind_up = now["motor"] / p["gear_ratio"] - (theta - pitch)
    off = theta - now["q_d"]
    return Scene(
        (-0.85, -0.62, 1.9, 0.75),
        ground((-0.8, -0.45), (0.55, -0.45), 0.06),
        disc((-0.45, -0.37), 0.08, "ground"),
        disc((0.2, -0.37), 0.08, "ground"),
        area(hull, "body", 0.1),
        line([HUB, motor], "body", 1.0),
        disc(motor, 0.08, "body", 0.1),
        line([motor, polar(motor, 0.08, now["motor"] + pitch)], "moving", 2.5),
        area(tube, "moving", 0.15),
        line([HUB, polar(HUB, 1.3 * long, now["q_d"])], "reference", 1.2, dash=True),
        disc(HUB, 0.1, "moving", 0.3),
        turn(HUB, 0.15, theta + 0.8, now["torque"] / FULL_NM * 1.5),
        line(bent_axis(now, p), "magnified", 2.0),
        slot((1.05, -0.42), 0.5, wind_up, -0.5 * p["gap_rad"], 0.5 * p["gap_rad"],
             4.0 * p["gap_rad"] or 1e-3),
        text((1.05, -0.57), f"play {1e3 * p['gap_rad']:g} mrad"),
        gauge((1.62, 0.1), 0.8, FULL_RAD, [(off, "moving"), (off + muzzle, "magnified")],
              f"error, ±{1e3 * FULL_RAD:g} mrad"),
        note=f"bending x {BENDING:g}; 270 deg of arrow: {math.pi * FULL_NM:.0f} N m",
    )  # fmt: skip

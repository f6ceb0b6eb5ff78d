"""The pendulum, and the play before it: the command is the tooth, the torque behind is the slot.

slot    tau + d- to tau + d+: the command moves tau only where it touches       model (3)
arrow   tau, three quarters of a turn at FULL_NM
"""

import math

from pcpc.plants.drawing import *

NEEDS = {
    "q": "plant:pendulum.q_rad",
    "wanted": "executive:reference.q_d_rad",
    "torque": "plant:pendulum.torque_Nm",
    "command": "plant:pendulum.acting_Nm",
}
FIGURE = Figure("rigs/backlash-pendulum.yaml", at_s=(1.0, 1.9, 3.2, 4.7))
FULL_NM = 40.0
PIVOT = (0.0, 0.0)


def bob(q: float, p: Settings) -> Point:
    """Return where the mass is."""
    return polar(PIVOT, p["length_m"], q - 0.5 * math.pi)


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    a, torque = p["length_m"], now["torque"]
    tip, wanted = bob(now["q"], p), bob(now["wanted"], p)
    middle, half = (0.0, -1.55 * a), 0.5 * a
    marks = [(middle[0] + half * x, middle[1] - 0.17 * a) for x in (-1.0, 1.0)]
    return Scene(
        (-1.15 * a, -1.9 * a, 1.15 * a, 0.3 * a),
        ground((0.2 * a, 0.05 * a), (-0.2 * a, 0.05 * a), 0.04 * a),
        link(PIVOT, tip, 0.04 * a, "moving"),
        disc(tip, 0.07 * a, "moving", 0.8),
        line([PIVOT, wanted], "reference", 1.2, dash=True),
        disc(wanted, 0.08 * a, "reference", 0.0, 1.2),
        disc(PIVOT, 0.03 * a, "body", 0.6),
        turn(PIVOT, 0.2 * a, now["q"] - 0.5 * math.pi, 1.5 * math.pi * torque / FULL_NM,
             head=0.06 * a),
        line(marks, "note", 0.8),
        line([(0.0, marks[0][1]), (0.0, marks[0][1] + 0.05 * a)], "note", 0.8),
        slot(middle, 2.0 * half, now["command"], torque + p["d_minus_Nm"], torque + p["d_plus_Nm"],
             2.0 * FULL_NM),
        text((-0.75 * a, -1.84 * a), f"play {p['d_plus_Nm'] - p['d_minus_Nm']:g} N m"),
        note=f"line: ±{FULL_NM:g} N m; 270 deg of arrow: {FULL_NM:g} N m",
    )  # fmt: skip

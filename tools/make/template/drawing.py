"""The motor from its shaft's end: the angle, where it should be, the current, the voltage.

A scene is made of shapes with roles, in metres or as here in radii of the shaft's dial; what else
may stand here: the header of plants/drawing.py of pcpc.
"""

import math

from pcpc.plants.drawing import Now, Scene, Settings, disc, gauge, line, polar, turn

NEEDS = {
    "angle": "plant:motor.angle_rad",
    "wanted": "executive:reference.q_d_rad",
    "current": "plant:motor.current_A",
    "voltage": "plant:motor.held_V",
}
CENTRE = (0.0, 0.0)
FULL_A = 3.0  # three quarters of a turn


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen at one instant."""
    angle = now["angle"]
    marks = [[polar(CENTRE, r, i * math.pi / 6) for r in (1.12, 1.18)] for i in range(12)]
    return Scene(
        (-1.5, -1.3, 2.2, 1.3),
        disc(CENTRE, 1.1, "body", 0.05),
        [line(mark, "note", 1.0) for mark in marks],
        line([CENTRE, polar(CENTRE, 1.1, now["wanted"])], "reference", 1.2, dash=True),
        disc(CENTRE, 0.75, "moving", 0.15),
        line([CENTRE, polar(CENTRE, 0.75, angle)], "moving", 4.0),
        disc(CENTRE, 0.12, "body", 0.6),
        turn(CENTRE, 0.9, angle, 1.5 * math.pi * now["current"] / FULL_A, head=0.15),
        gauge((1.75, 0.0), 1.8, p["v_max_V"], [(now["voltage"], "force")], "voltage"),
        note=f"voltage: ±{p['v_max_V']:g} V; 270 deg of arrow: {FULL_A:g} A",
    )

"""The cart and its pole from the side, to scale: where it should be, and the force on a gauge.

A scene is made of shapes with roles, here in metres; what else may stand here: the header of
plants/drawing.py of pcpc.
"""

import math

from pcpc.plants.drawing import Now, Scene, Settings, area, disc, gauge, ground, line, link, polar

NEEDS = {
    "x": "plant:cart.position_m",
    "angle": "plant:cart.angle_rad",
    "wanted": "executive:reference.value",
    "force": "plant:cart.held_N",
}
HALF_M, HEIGHT_M = 0.09, 0.08  # of the cart


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen at one instant."""
    x, wanted, length = now["x"], now["wanted"], 2.0 * p["centre_m"]
    pivot = (x, HEIGHT_M)
    corners = [(x - HALF_M, 0.0), (x + HALF_M, 0.0), (x + HALF_M, HEIGHT_M), (x - HALF_M, HEIGHT_M)]
    return Scene(
        (-0.6, -0.2, 1.0, 0.8),
        ground((-0.55, 0.0), (0.7, 0.0), 0.03),
        line([(wanted, -0.02), (wanted, HEIGHT_M + length)], "reference", 1.2, dash=True),
        area(corners, "body", 0.2),
        link(pivot, polar(pivot, length, 0.5 * math.pi - now["angle"]), 0.02, "moving"),
        disc(pivot, 0.015, "body", 0.6),
        gauge((0.85, 0.35), 0.7, p["f_max_N"], [(now["force"], "force")], "force"),
        note=f"force: ±{p['f_max_N']:g} N",
    )

"""The quarter car on its road, heights to scale; travel and force of the strut on gauges.

road     za sin(wr t + 2 pi x / WAVE_M): under the wheel it is zr               model (1)
strut    spring and damper, cylinder or force alone, as the rig has it          model (8)
force    F and Fd beside the body's weight, which is the gauge's middle
"""

import math

from pcpc.plants.drawing import *

NEEDS = {
    "body": "plant:car.body_m",
    "wheel": "plant:car.wheel_m",
    "ground": "plant:car.ground_m",
    "extension": "plant:car.extension_m",
    "force": "plant:car.strut_N",
    "wanted": "executive:controller.desired_N",
}
FIGURE = Figure("rigs/suspension-58.yaml", at_s=(4.0, 4.03, 4.06, 4.09))
WAVE_M, TYRE_M, STRUT_M, FULL_N = 1.4, 0.28, 0.48, 8000.0
PASSIVE, HYDRAULIC = 0.0, 1.0


def road(now: Now, p: Settings) -> list[Point]:
    """Return the road's profile, m."""
    phase = p["road_rad_s"] * now["t"]
    places = [i * 0.05 for i in range(-16, 17)]
    return [(x, p["road_m"] * math.sin(phase + 2.0 * math.pi * x / WAVE_M)) for x in places]


def strut(low: Point, high: Point, kind: float) -> list[Shapes]:
    """Return the strut between wheel and body."""
    (x, y0), (_, y1) = low, high
    if kind == PASSIVE:
        middle = 0.5 * (y0 + y1)
        return [
            spring((x - 0.1, y0), (x - 0.1, y1), 0.1, "moving"),
            line([(x + 0.1, y0), (x + 0.1, middle)], "moving"),
            line([(x + 0.04, middle), (x + 0.16, middle)], "moving", 3.0),
            line([(x + 0.04, y0 + 0.12), (x + 0.04, y1 - 0.12), (x + 0.16, y1 - 0.12),
                  (x + 0.16, y0 + 0.12)], "moving"),
            line([(x + 0.1, y1 - 0.12), (x + 0.1, y1)], "moving"),
        ]  # fmt: skip
    if kind == HYDRAULIC:
        piston = y0 + 0.26
        return [
            area([(x - 0.07, y1 - 0.34), (x + 0.07, y1 - 0.34), (x + 0.07, y1), (x - 0.07, y1)],
                 "moving", 0.15),
            line([low, (x, piston)], "moving", 4.0),
            line([(x - 0.07, piston), (x + 0.07, piston)], "moving", 4.0),
        ]  # fmt: skip
    return [line([low, high], "force", 1.0, dash=True)]


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    hub, floor = (0.0, TYRE_M + now["wheel"]), TYRE_M + STRUT_M + now["body"]
    profile, weight = road(now, p), p["ms_kg"] * p["gravity_m_s2"]
    return Scene(
        (-0.85, -0.3, 1.45, 1.2),
        disc(hub, TYRE_M, "body", 0.1),
        area([*profile, (0.8, -0.16), (-0.8, -0.16)], "ground", 0.3),
        disc(hub, 0.1, "moving", 0.3),
        strut(hub, (0.0, floor), p["strut"]),
        area([(-0.6, floor), (0.6, floor), (0.5, floor + 0.26), (-0.45, floor + 0.26)], "moving"),
        line([(-0.8, TYRE_M + STRUT_M), (-0.62, TYRE_M + STRUT_M)], "reference", 1.0, dash=True),
        gauge((0.95, 0.55), 0.8, 1.25 * p["stop_m"], [(now["extension"], "moving")], "travel"),
        [line([(0.91, y), (0.99, y)], "magnified", 2.0)
         for y in (0.55 - 0.32, 0.55 + 0.32) if p["limits_on"]],
        gauge((1.25, 0.55), 0.8, FULL_N, [(now["wanted"], "reference"),
                                           (now["force"] - weight, "moving")], "force"),
        note=f"travel: ±{125 * p['stop_m']:g} cm (red: stops); force: ±{1e-3 * FULL_N:g} kN",
    )  # fmt: skip

"""What the drawings of two-link arms share: links, joints, torques, the wanted arm.

q1 from the horizontal, q2 relative to link 1, rad; m, N m.
"""

import math

from pcpc.plants.drawing import (
    Now,
    Point,
    Settings,
    Shape,
    Shapes,
    disc,
    line,
    link,
    polar,
    turn,
)

THICK = 0.05  # of a link, of its length
ORIGIN = (0.0, 0.0)
ANGLES = {f"q_{j}": f"plant:arm.q_{j}_rad" for j in (1, 2)}
WANTED = {f"wanted_{j}": f"executive:reference_{j}.q_d_rad" for j in (1, 2)}
TORQUES = {f"torque_{j}": f"plant:arm.acting_{j}_Nm" for j in (1, 2)}


def reach(p: Settings) -> float:
    """Return how far the arm goes."""
    return p["a1_m"] + p["a2_m"]


def joints(q1: float, q2: float, p: Settings, base: Point = ORIGIN) -> list[Point]:
    """Return shoulder, elbow and tip."""
    elbow = polar(base, p["a1_m"], q1)
    return [base, elbow, polar(elbow, p["a2_m"], q1 + q2)]


def outline(points: list[Point], role: str, dash: bool = False) -> list[Shape]:
    """Return an arm as lines with a ring at its tip."""
    return [line(points, role, 1.5, dash), disc(points[-1], 0.05, role, 0.0)]


def links(points: list[Point], thick: float, role: str = "moving") -> list[Shape]:
    """Return an arm as rods with round ends, the outer one thinner."""
    shoulder, elbow, tip = points
    return [link(shoulder, elbow, thick, role), link(elbow, tip, 0.75 * thick, role)]


def mass(at: Point, kg: float, role: str = "moving", fill: float = 0.8) -> Shape:
    """Return a point mass, 1 kg with a radius of 70 mm."""
    return disc(at, 0.07 * math.copysign(abs(kg) ** (1 / 3), kg), role, fill)


def torques(points: list[Point], now: Now, full_Nm: float) -> list[Shapes]:
    """Return arrows around the joints, three quarters of a circle at `full_Nm`."""
    shoulder, elbow, _ = points
    q1, q2 = now["q_1"], now["q_2"]
    by = [1.5 * math.pi * now[f"torque_{j}"] / full_Nm for j in (1, 2)]
    return [
        turn(shoulder, 0.28, q1, by[0], head=0.1),
        turn(elbow, 0.24, q1 + q2, by[1], head=0.1),
    ]


def moving(now: Now, p: Settings, full_Nm: float, outer_kg: float) -> list[Shapes]:
    """Return the arm with masses and torques, the wanted one on it."""
    points = joints(now["q_1"], now["q_2"], p)
    thick = THICK * reach(p)
    return [
        links(points, thick),
        disc(points[0], 0.07, "body", 0.6),
        mass(points[1], p["m1_kg"]),
        mass(points[2], outer_kg),
        outline(joints(now["wanted_1"], now["wanted_2"], p), "reference", dash=True),
        torques(points, now, full_Nm),
    ]

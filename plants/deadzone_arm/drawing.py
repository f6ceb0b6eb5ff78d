"""The arm from above, and each joint's deadzone: the command along, the torque up."""

from pcpc.plants.drawing import *
from pcpc.plants.families.two_link.drawing import ANGLES, TORQUES, WANTED, moving, reach

NEEDS = {
    **ANGLES,
    **WANTED,
    **TORQUES,
    **{f"command_{j}": f"plant:rx.CMD.torque_{j}" for j in (1, 2)},
}
FIGURE = Figure("rigs/deadzone-sine.yaml", at_s=(0.05, 0.8, 2.0, 3.4))
FULL_NM = 80.0


def deadzone(p: Settings) -> list[Point]:
    """Return the curve of torque over command."""
    low, high = -p["d_minus_Nm"], p["d_plus_Nm"]
    return [(low - FULL_NM, -p["m_minus"] * FULL_NM), (low, 0.0), (high, 0.0),
            (high + FULL_NM, p["m_plus"] * FULL_NM)]  # fmt: skip


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    far = reach(p) + 0.2
    planes = [Plane((far + 0.75, y), 0.65, FULL_NM, FULL_NM) for y in (0.85, -0.85)]
    return Scene(
        (-0.7, -far, far + 1.6, far + 0.1),
        moving(now, p, FULL_NM, p["m2_kg"]),
        [plane.frame("command", f"torque {j}") for j, plane in enumerate(planes, 1)],
        [plane.curve(deadzone(p)) for plane in planes],
        [
            disc(plane.at(now[f"command_{j}"], now[f"torque_{j}"]), 0.06, "force", 1.0)
            for j, plane in enumerate(planes, 1)
        ],
        note=f"axes, 270 deg of arrow: {FULL_NM:g} N m",
    )

"""The arm from the side: links, wanted links, torques, and the friction that opposes them.

A joint without a rate sticks and is filled. The arrows of torque and friction have one scale.
"""

import math

from pcpc.plants.drawing import *
from pcpc.plants.families.two_link.drawing import ANGLES, TORQUES, WANTED, joints, moving, reach

NEEDS = {
    **ANGLES,
    **WANTED,
    **TORQUES,
    **{f"rate_{j}": f"plant:arm.rate_{j}_rad_s" for j in (1, 2)},
    **{f"friction_{j}": f"plant:arm.friction_{j}_Nm" for j in (1, 2)},
}
FIGURE = Figure("rigs/friction-c.yaml", at_s=(0.3, 1.62, 2.6, 4.8))
FULL_NM = 150.0


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    far = reach(p) + 0.3
    shoulder, elbow, _ = joints(now["q_1"], now["q_2"], p)
    start = (now["q_1"], now["q_1"] + now["q_2"])
    by = [-1.5 * math.pi * now[f"friction_{j}"] / FULL_NM for j in (1, 2)]
    sticks = [0.9 if now[f"rate_{j}"] == 0.0 else 0.0 for j in (1, 2)]
    return Scene(
        (-0.9, -far, far, far),
        ground((-0.25, -0.12), (0.25, -0.12)),
        moving(now, p, FULL_NM, p["m2_kg"]),
        turn(shoulder, 0.4, start[0], by[0], "ground", 0.1),
        turn(elbow, 0.36, start[1], by[1], "ground", 0.1),
        [
            disc(at, 0.05, "magnified", fill)
            for at, fill in zip((shoulder, elbow), sticks, strict=True)
        ],
        note=f"270 deg of arrow: {FULL_NM:g} N m; grey: friction; red: joint sticks",
    )

"""The telerobot: what the operator's node knows at the left, the robot itself at the right.

left    solid    z, the model of the robot without delay, which the law drives
pale     the robot as it is seen, T old
right   solid    the robot, with torques and the mass at its end
dashed   where it should be now: the reference of T ago
"""

from pcpc.plants.drawing import *
from pcpc.plants.families.two_link.drawing import (
    ANGLES,
    THICK,
    TORQUES,
    joints,
    links,
    mass,
    moving,
    outline,
    reach,
)

NEEDS = {
    **ANGLES,
    **TORQUES,
    **{f"wanted_{j}": f"executive:controller.aim_{j}_rad" for j in (1, 2)},
    **{f"z_{j}": f"executive:controller.z_{j}_rad" for j in (1, 2)},
    **{f"seen_{j}": f"executive:controller.seen_{j}_rad" for j in (1, 2)},
    "mass": "plant:arm.mass_kg",
    "delay": "executive:controller.delay",
}
FIGURE = Figure("rigs/telerobot-u2.yaml", at_s=(2.0, 7.0, 10.5, 14.0), columns=2)
FULL_NM = 40.0


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    far = reach(p)
    desk = (-1.9 * far, 0.0)
    model = joints(now["z_1"], now["z_2"], p, desk)
    seen = joints(now["seen_1"], now["seen_2"], p, desk)
    return Scene(
        (-3.0 * far, -far - 0.3, 1.1 * far, far * 0.55),
        [ground((x + 0.25, 0.12), (x - 0.25, 0.12)) for x in (0.0, desk[0])],
        links(seen, THICK * far, "ghost"),
        mass(seen[2], 1.0, "ghost", 0.4),
        outline(model, "body"),
        disc(desk, 0.07, "body", 0.6),
        text((desk[0], 0.45 * far), "operator: model, and the robot seen late"),
        moving(now, p, FULL_NM, now["mass"]),
        text((0.0, 0.45 * far), "robot"),
        arrow((desk[0] + 0.8 * far, 0.2), (-0.8 * far, 0.2), "note", 0.1),
        arrow((-0.8 * far, 0.0), (desk[0] + 0.8 * far, 0.0), "note", 0.1),
        text((-0.95 * far, 0.32), f"{now['delay']:g} cycles each way"),
        note=f"270 deg of arrow: {FULL_NM:g} N m",
    )

"""The arm from the side: links, wanted links, torques; the mass at its end grows by the payload."""

from pcpc.plants.drawing import *
from pcpc.plants.families.two_link.drawing import (
    ANGLES,
    TORQUES,
    WANTED,
    joints,
    mass,
    moving,
    reach,
)

NEEDS = {**ANGLES, **WANTED, **TORQUES, "outer": "plant:arm.outer_mass_kg"}
FIGURE = Figure("rigs/payload-on.yaml", at_s=(4.9, 5.2, 6.5, 7.5))
FULL_NM = 100.0


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    far = reach(p) + 0.3
    *_, tip = joints(now["q_1"], now["q_2"], p)
    loaded = now["outer"] > p["m2_kg"]
    return Scene(
        (-0.7, -far, far, far),
        ground((-0.25, -0.12), (0.25, -0.12)),
        moving(now, p, FULL_NM, p["m2_kg"]),
        [mass(tip, 2.0 * now["outer"], "magnified", 0.3)] if loaded else [],
        text((0.5 * far - 0.35, far - 0.1), f"mass at the end {now['outer']:g} kg"),
        note=f"270 deg of arrow: {FULL_NM:g} N m",
    )

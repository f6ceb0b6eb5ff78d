"""What the drawings of maps with two states share: the states, and where they should be.

The reference's two last samples are where (x1, x2) should be.
"""

from pcpc.plants.drawing import Now, Plane, Shapes, disc, line

BOUNDS = (-2.4, -1.35, 2.4, 1.25)
LEFT, RIGHT = (-1.2, 0.0), (1.2, 0.0)  # the planes' centres
STATES = {
    "x1": "plant:map.x1",
    "x2": "plant:map.x2",
    "tau": "plant:map.tau",
    "previous": "executive:reference.previous",
    "wanted": "executive:reference.now",
}


def states(now: Now, plane: Plane, axes: tuple[str, str] = ("x1", "x2")) -> list[Shapes]:
    """Return the states as a point, a ring where they should be, a line between the two."""
    seen, wanted = plane.at(now["x1"], now["x2"]), plane.at(now["previous"], now["wanted"])
    return [
        plane.frame(*axes),
        line([seen, wanted], "magnified", 1.0),
        disc(wanted, 0.07, "reference", 0.0, 1.5),
        disc(seen, 0.05, "moving", 0.9),
    ]

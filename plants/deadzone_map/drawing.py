"""The deadzone's curve with the point that moves on it, and the map's states.

left     the command along, tau up: 0 up to the half width d                       model (2)
right    (x1, x2), and where they should be: the two last samples of the reference
"""

from pcpc.plants.drawing import *
from pcpc.plants.families.maps.drawing import BOUNDS, LEFT, RIGHT, STATES, states

NEEDS = {**STATES, "command": "plant:rx.CMD.command"}
FIGURE = Figure("rigs/fuzzy-d03.yaml", at_s=(0.5, 11.0, 14.0, 17.0))
ZONE, STATE = Plane(LEFT, 1.0, 1.0, 1.0), Plane(RIGHT, 1.0, 1.4, 1.4)


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    d = p["d"]
    return Scene(
        BOUNDS,
        ZONE.frame("command u", "tau"),
        ZONE.curve([(-1.0, d - 1.0), (-d, 0.0), (d, 0.0), (1.0, 1.0 - d)]),
        disc(ZONE.at(now["command"], now["tau"]), 0.05, "force", 1.0),
        states(now, STATE),
        note="ring: reference; axes to 1 and 1.4",
    )

"""The gap's two lines with the point that moves between them, and the map's states.

left     the command along, tau up: rising on m (u - d+), falling on m (u - d-)   model (2)
right    (x1, x2), and where they should be: the two last samples of the reference
"""

from pcpc.plants.drawing import *
from pcpc.plants.families.maps.drawing import BOUNDS, LEFT, RIGHT, STATES, states

NEEDS = {**STATES, "command": "plant:map.acting"}
FIGURE = Figure("rigs/backlash-map.yaml", at_s=(0.01, 2.0, 5.0, 8.0))
GAP, STATE = Plane(LEFT, 1.0, 0.8, 0.4), Plane(RIGHT, 1.0, 1.6, 1.6)


def flank(at: float, p: Settings) -> list[Point]:
    """Return the line of one flank inside the plane."""
    return [(at + tau / p["slope"], tau) for tau in (-0.25, 0.25)]


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    tau, rising, falling = now["tau"], flank(p["d_plus"], p), flank(p["d_minus"], p)
    across = [(p[d] + tau / p["slope"], tau) for d in ("d_minus", "d_plus")]
    return Scene(
        BOUNDS,
        GAP.frame("command u", "tau"),
        GAP.curve(rising),
        GAP.curve(falling),
        arrow(GAP.at(*rising[0]), GAP.at(*rising[1]), "body", 0.08),
        arrow(GAP.at(*falling[1]), GAP.at(*falling[0]), "body", 0.08),
        GAP.curve(across, "ghost", 2.0),
        disc(GAP.at(now["command"], tau), 0.05, "force", 1.0),
        states(now, STATE),
        note="ring: reference; axes to 0.8, 0.4 and 1.6",
    )

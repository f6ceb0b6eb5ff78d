"""The deadzone's curve with the point that moves on it, and the map's states.

left     the command along, tau up: 0 up to the half width d                       model (2)
right    (x1, x2), and where they should be: the two last samples of the reference
"""

from pcpc.plants.drawing import *

NEEDS = {
    "x1": "plant:map.x1",
    "x2": "plant:map.x2",
    "tau": "plant:map.tau",
    "command": "plant:rx.CMD.command",
    "previous": "executive:reference.previous",
    "wanted": "executive:reference.now",
}
FIGURE = Figure("rigs/fuzzy-d03.yaml", at_s=(0.5, 11.0, 14.0, 17.0))
ZONE, STATE = Plane((-1.2, 0.0), 1.0, 1.0, 1.0), Plane((1.2, 0.0), 1.0, 1.4, 1.4)


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    d = p["d"]
    seen, wanted = STATE.at(now["x1"], now["x2"]), STATE.at(now["previous"], now["wanted"])
    return Scene(
        (-2.4, -1.35, 2.4, 1.25),
        ZONE.frame("command u", "tau"),
        ZONE.curve([(-1.0, d - 1.0), (-d, 0.0), (d, 0.0), (1.0, 1.0 - d)]),
        disc(ZONE.at(now["command"], now["tau"]), 0.05, "force", 1.0),
        STATE.frame("x1", "x2"),
        line([seen, wanted], "magnified", 1.0),
        disc(wanted, 0.07, "reference", 0.0, 1.5),
        disc(seen, 0.05, "moving", 0.9),
        note="ring: reference; axes to 1 and 1.4",
    )

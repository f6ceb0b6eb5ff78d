"""The two newest states of both chains, and where they should be.

left     chain a: (x2, x3), ring where they should be, the two last samples of the reference
right    chain b
"""

from pcpc.plants.drawing import *
from pcpc.plants.families.maps.drawing import BOUNDS, LEFT, RIGHT, states

NEEDS = {
    f"{name}_{chain}": source.format(chain)
    for chain in "ab"
    for name, source in (
        ("x1", "plant:chains.{}_x2"), ("x2", "plant:chains.{}_x3"),
        ("previous", "executive:reference_{}.previous"), ("wanted", "executive:reference_{}.now"),
    )
}  # fmt: skip
FIGURE = Figure("rigs/two-deadzones.yaml", at_s=(0.5, 5.0, 11.0, 14.0))
A, B = Plane(LEFT, 1.0, 1.4, 1.4), Plane(RIGHT, 1.0, 1.4, 1.4)


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    shapes = []
    for chain, plane in (("a", A), ("b", B)):
        shapes += states(
            {name: now[f"{name}_{chain}"] for name in ("x1", "x2", "previous", "wanted")},
            plane,
            ("x2", "x3"),
        )
    return Scene(BOUNDS, *shapes, note="left chain a, right chain b; ring: reference; axes to 1.4")

"""The lag on a rail: the command is where the spring pulls it."""

from pcpc.plants.drawing import *

NEEDS = {"x": "plant:lag.position", "command": "executive:controller.command"}
FULL = 5.0


def scene(now: Now, p: Settings) -> Scene:
    """Return what is seen."""
    x, end = now["x"], min(max(now["command"], -FULL), FULL)
    return Scene(
        (-FULL - 0.5, -1.0, FULL + 0.5, 1.2),
        ground((FULL, -0.35), (-FULL, -0.35), 0.3)[0],
        line([(0.0, -0.5), (0.0, -0.2)], "ground"),
        spring((x, 0.0), (end, 0.0), 0.3, "force"),
        disc((end, 0.0), 0.12, "force", 0.0),
        box((x, 0.0), 0.6, 0.6, "moving", 0.4),
        text((x, 0.65), f"{x:.3g}"),
        note=f"rail: ±{FULL:g}; orange: the command",
    )

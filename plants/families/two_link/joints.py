"""What the evaluations of arms with two joints share."""

from collections.abc import Callable

import numpy as np

from pcpc.plants.evaluation import BLACK, BLUE, VERMILION, Line, Panel, Run, Signal, Vector

JOINTS = (1, 2)
COLOURS = {1: BLUE, 2: VERMILION}


def each(of_joint: Callable[[Run, int], Vector], joint: int) -> Signal:
    """Return the signal of one joint. Its values: (n,)."""
    return lambda run: of_joint(run, joint)


def error(run: Run, joint: int) -> Vector:
    """Return q_d - q, the measured one if the log has no plant, rad. Shape (n,)."""
    if not run.plant_tells:
        return run[f"executive:controller.e_{joint}_rad"]
    return run[f"executive:reference_{joint}.q_d_rad"] - run[f"plant:arm.q_{joint}_rad"]


def torque_size(run: Run) -> Vector:
    """Return the larger |tau| of both joints that acts. Shape (n,)."""
    return np.fmax(*(np.abs(run[f"plant:arm.acting_{j}_Nm"]) for j in JOINTS))


def lines(source: str, label: str, width: float = 0.7) -> list[Line]:
    """Return a line for each joint; `{}` stands for its number."""
    return [Line(source.format(j), label.format(j), COLOURS[j], width) for j in JOINTS]


def angles(width: float = 1.1) -> Panel:
    """Return the axes of both angles and their references."""
    references = [
        Line(f"executive:reference_{j}.q_d_rad", f"reference {j}", BLACK, 0.9, style)
        for j, style in ((1, "--"), (2, ":"))
    ]
    return Panel("angle [rad]", [*references, *lines("plant:arm.q_{}_rad", "joint {}", width)])

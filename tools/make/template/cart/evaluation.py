"""What judges and draws a run of the cart.

    e = x_d - x          reference minus the cart's true position                             (1)
    overshoot            how far x went beyond x_d                                            (2)
    settled_s            time from the window's begin until |e| stays within 4 mm             (3)
    rest_error_max_mm    largest |e| from `rest_from_s` on                                    (4)
    back_mm              how far the cart first went the other way                            (5)

What else may stand here: docs/reference/rig-python.md of pcpc. mm, mrad, N, s.
"""

from pcpc.plants.evaluation import (
    BLACK,
    BLUE,
    ORANGE,
    PURPLE,
    RUN,
    VERMILION,
    WINDOW,
    Evaluation,
    Highest,
    Line,
    Panel,
    Peak,
    Rms,
    settling,
)

POSITION, POSITION_D = "plant:cart.position_m", "executive:reference.value"
SETTLED_MM = 4.0  # 2 % of the step in rig.yaml

EVALUATION = Evaluation(
    signals={
        "error_mm": lambda run: 1e3 * (run[POSITION_D] - run[POSITION]),  # (1)
        "beyond_mm": lambda run: -run["error_mm"],
        "behind_mm": lambda run: -1e3 * run[POSITION],
        "lean_mrad": lambda run: 1e3 * run["plant:cart.angle_rad"],
    },
    merits={
        "error_rms_mm": Rms("error_mm"),
        "overshoot_mm": Highest("beyond_mm"),  # (2)
        "settled_s": settling("error_mm", SETTLED_MM, WINDOW),  # (3)
        "rest_error_max_mm": Peak("error_mm", "rest"),  # (4)
        "back_mm": Highest("behind_mm"),  # (5)
        "lean_max_mrad": Peak("lean_mrad", RUN),
        "force_max_N": Peak("plant:cart.held_N", RUN),
    },
    panels=(
        Panel(
            "position [m]",
            (Line(POSITION_D, "desired", BLACK, 1.6, "--"), Line(POSITION, "true", BLUE)),
        ),
        Panel("error [mm]", (Line("error_mm", "x_d - x", VERMILION),)),
        Panel("angle [mrad]", (Line("lean_mrad", "of the pole", PURPLE),)),
        Panel("force [N]", (Line("plant:cart.held_N", "of the drive", ORANGE),)),
    ),
    notes=(
        ("overshoot {overshoot_mm:.1f} mm", "within 4 mm after {settled_s:.2f} s"),
        ("at rest within {rest_error_max_mm:.2f} mm", "leans up to {lean_max_mrad:.0f} mrad"),
    ),
)

"""What judges and draws a run of the barrel: pointing errors against the plant's true state.

    hub error     q_d - theta                                                               (1)
    muzzle error  q_d - (theta + slope'q - droop(q_d))                                      (2)
    droop(q_d)    static muzzle slope, droop(theta) cos q_d / cos theta; calibrated out     (3)
    u             motor torque command, saturated, times the gear ratio                     (4)

Further windows of the rig: `rest`, `settle` and `vibration` ask for `muzzle_rest_mrad`,
`settle_2mrad_s` (inf: never), `vibration_mrad` with `vibration1_mrad`; its number `gear_ratio`
overrides the controller's. Without the plant's record the hub error is the measured one, and what
needs the true state is absent. Contract: plants/evaluation.py.
Inside rad, s, N m; metrics in mrad, s, N m at the output. The definitions are this project's.
"""

import math

import numpy as np

from pcpc.plants.evaluation import *

SETTLED_RAD = 2e-3
MRAD = 1e3
Q_D, ELASTIC = "executive:reference.q_d_rad", "plant:barrel.elastic_slope_rad"


def theta(run: Run) -> Vector:
    """Return the hub's angle: measured, as its error, if no cycle has the plant's record.

    Shape (n,).
    """
    if run.plant_tells:
        return run.get("plant:barrel.theta_rad")
    return run.get(Q_D) - run.get("executive:controller.e_rad")


def muzzle_error(run: Run) -> Vector:
    """Return (2). Shape (n,)."""
    q_d, angle = run.get(Q_D), run["theta_rad"]
    with np.errstate(invalid="ignore"):  # of an infinite theta
        droop = run.get("plant:barrel.droop_rad") * np.cos(q_d) / np.cos(angle)  # (3)
    return q_d - (angle + run.get(ELASTIC) - droop)


def gear_ratio(run: Run) -> float:
    """Return the ratio to the motor."""
    return run.numbers.get("gear_ratio", run.setting("gear_ratio"))


def settling_text(after_s: float) -> str:
    """Return what the title says of the settling time."""
    if math.isnan(after_s):
        return ""
    return f"within 2 mrad after {after_s:.3g} s" if after_s < math.inf else "not settled to 2 mrad"


def mrad(source: str, label: str, colour: str, width: float = 1.1, style: str = "-") -> Line:
    """Return a line of an angle."""
    return Line(lambda run: MRAD * run.get(source), label, colour, width, style)


EVALUATION = Evaluation(
    signals={
        "theta_rad": theta,
        "hub_error_rad": lambda run: run.get(Q_D) - run["theta_rad"],  # (1)
        "muzzle_error_rad": muzzle_error,
        "command_Nm": lambda run: run.get("executive:controller.motor_torque_Nm") * gear_ratio(run),
        "command_step_Nm": lambda run: run.step(run["command_Nm"]),
    },
    merits={
        "muzzle_error_rms_mrad": Rms("muzzle_error_rad", scale=MRAD),
        "muzzle_error_max_mrad": Peak("muzzle_error_rad", scale=MRAD),
        "hub_error_rms_mrad": Rms("hub_error_rad", scale=MRAD),
        "hub_error_max_mrad": Peak("hub_error_rad", scale=MRAD),
        "command_rms_Nm": Rms("command_Nm"),
        "command_step_rms_Nm": Rms("command_step_Nm"),
        "muzzle_rest_mrad": Mean(lambda run: np.abs(run["muzzle_error_rad"]), "rest", MRAD),
        "settle_2mrad_s": settling("muzzle_error_rad", SETTLED_RAD, "settle"),
        "vibration_mrad": Deviation(ELASTIC, "vibration", MRAD),
        "vibration1_mrad": Deviation("plant:barrel.slope1_rad", "vibration", MRAD),
    },
    numbers=("gear_ratio",),
    panels=(
        Panel(
            "elevation [mrad]",
            (mrad("theta_rad", "hub angle", BLUE), mrad(Q_D, "reference", BLACK, 0.9, "--")),
        ),
        Panel(
            "error [mrad]",
            (
                mrad("muzzle_error_rad", "muzzle error", VERMILION, 1.5),
                mrad("hub_error_rad", "hub error", BLUE, 0.7),
            ),
            6.0,
            levels=(Level(lambda run: MRAD * SETTLED_RAD, "settled"),),
        ),
        Panel("slope [mrad]", (mrad(ELASTIC, "elastic slope at the muzzle", GREEN),), 4.0),
        Panel(
            "command [N m]",
            (Line("command_Nm", "torque command at the output", BLACK, 0.8),),
            levels=(Level(lambda run: run.setting("tau_max_Nm"), "limit", VERMILION),),
        ),
        Panel(
            "torque [N m]",
            (Line("plant:barrel.gear_torque_Nm", "shaft torque on the hub", BLUE, 0.8),),
            4.0,
        ),
    ),
    notes=(
        (
            "muzzle error {muzzle_error_rms_mrad:.3g} rms, {muzzle_error_max_mrad:.3g} max mrad",
            "hub error {hub_error_rms_mrad:.3g} rms, {hub_error_max_mrad:.3g} max mrad",
            "command {command_rms_Nm:.3g} rms, {command_step_rms_Nm:.3g} step N m",
        ),
        (
            "muzzle at rest {muzzle_rest_mrad:.3g} mrad",
            lambda metrics: settling_text(metrics.get("settle_2mrad_s", math.nan)),
            "vibration {vibration_mrad:.3g}, mode 1 {vibration1_mrad:.3g} mrad",
        ),
    ),
)

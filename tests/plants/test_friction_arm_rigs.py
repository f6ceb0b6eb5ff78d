"""The rigs of the two-link arm as they are shipped: what every controller must reach, or not."""

from functools import cache

import numpy as np
import pytest
from friction_loop import FOLDER
from judged import judged

from pcpc.executive.log.reader import Log
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.friction_arm import evaluation
from pcpc.plants.friction_arm.book import study

SEEDS = range(1, 11)
CONTROLLERS = ("pd", *study.NETWORKS)


def run(case: str, controller: str, *settings: str) -> tuple[Log, dict[str, float]]:
    """Return log and metrics of a rig in virtual time."""
    return judged(evaluation, f"friction-{case}", controller, *settings)


@cache
def metrics(case: str, controller: str, *settings: str) -> dict[str, float]:
    """Return the metrics of a rig in virtual time."""
    return run(case, controller, *settings)[1]


def errors(controller: str, seed: int) -> np.ndarray:
    """Return the early and the late mean errors of both joints in case A, (2, 2) rad."""
    other = () if seed == 1 else (f"controller.network_seed={seed}",)
    found = metrics("a", controller, *other)
    names = ("early_error_abs_mean_{}_rad", "error_abs_mean_{}_rad")
    return np.array([[found[name.format(j)] for j in (1, 2)] for name in names])


def test_pd_alone_has_the_known_error_which_gravity_and_friction_leave() -> None:
    for case, known in (("a", (0.9996, 0.5750)), ("b", (0.0253, 0.2770))):
        found = metrics(case, "pd")
        error = (found["error_abs_mean_1_rad"], found["error_abs_mean_2_rad"])
        assert error == pytest.approx(known, abs=6e-5), f"case {case}: {error}"


def test_pd_cannot_lift_the_arm_that_the_networks_lift() -> None:
    limits = load_rig(FOLDER / "rigs/friction-a.yaml", resolve=False).config.expect["nn_ramp"]
    found = metrics("a", "pd")
    low, high = limits["error_abs_mean_1_rad"]
    assert not low <= found["error_abs_mean_1_rad"] <= high, "a law without a network passes"


@pytest.mark.parametrize(("controller", "limit"), [("nn_ramp", 0.05), ("nn_step", 0.03)])
def test_ten_networks_come_close(controller: str, limit: float) -> None:
    worst = np.max([errors(controller, seed)[1] for seed in SEEDS], axis=0)
    assert (worst < limit).all(), f"worst of ten {worst} rad"


def test_the_augmented_network_is_four_times_better_than_the_standard_one_at_four_seconds() -> None:
    standard = np.median([errors("nn_standard", seed)[0] for seed in SEEDS], axis=0)
    step = np.median([errors("nn_step", seed)[0] for seed in SEEDS], axis=0)
    assert (standard / step >= 4.0).all(), f"{standard / step} times"
    assert (standard / step <= 30.0).all(), f"{standard / step} times: too good to be the same law"


def test_a_constant_in_place_of_the_jump_regulates_even_better() -> None:
    const = np.median([errors("nn_const", seed)[0] for seed in range(1, 4)], axis=0)
    step = np.median([errors("nn_step", seed)[0] for seed in range(1, 4)], axis=0)
    assert (const < 0.2 * step).all(), f"{const} and {step} rad"


def test_reversing_motion_is_where_the_jump_helps() -> None:
    rms = {}
    for controller in ("nn_standard", "nn_step"):
        seeds = ("controller.network_seed=2", "controller.network_seed=3")
        runs = [metrics("c", controller), *(metrics("c", controller, seed) for seed in seeds)]
        rms[controller] = np.median([found["error_rms_1_rad"] for found in runs])
    ratio = rms["nn_step"] / rms["nn_standard"]
    assert 0.4 < ratio < 0.8, f"joint 1 rms {rms}"


def test_a_resting_joint_of_the_rig_has_exactly_no_velocity() -> None:
    log, _ = run("a", "nn_ramp")
    rates = log.node["plant"].columns["arm.rate_1_rad_s"][-500:]
    assert (rates == 0.0).all(), f"largest {np.abs(rates).max():.1e} rad/s"


def test_the_step_node_chatters_and_its_variants_do_not() -> None:
    variation = {c: metrics("a", c)["torque_variation_Nm_s"] for c in CONTROLLERS}
    assert variation["nn_step"] > 20.0 * variation["nn_ramp"], variation
    assert variation["nn_project"] < 2.0 * variation["nn_standard"], variation


def test_sampling_at_100_hz_still_converges_and_at_8_hz_does_not() -> None:
    for rate, low, high in ((100.0, 0.0, 0.05), (8.0, 0.2, 4.0)):
        found = metrics("a", "nn_step", f"rate_hz={rate}")
        worst = max(found["error_abs_mean_1_rad"], found["error_abs_mean_2_rad"])
        assert low <= worst <= high, f"{worst:.3f} rad at {rate} Hz"

"""The rigs of the quarter car as they are shipped, and the table of every strut on every road."""

from functools import cache

import numpy as np
import pytest
from judged import judged
from quarter_car_reference import FOLDER

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.quarter_car import evaluation
from pcpc.plants.quarter_car.book import study

NAMES = (
    "speed_rms_m_s",
    "speed_max_m_s",
    "acceleration_rms_m_s2",
    None,
    "force_error_rms_N",
    "spool_max_m",
)
IRREGULAR = {("pid", 58): 0.005, ("passive", 150): 0.005}  # hammering: the digits depend on steps


@cache
def metrics(rig: str, controller: str, *settings: str) -> dict[str, float]:
    """Return the metrics of a rig in virtual time."""
    return judged(evaluation, f"suspension-{rig}", controller, *settings)[1]


@pytest.mark.parametrize("road", study.ROADS)
@pytest.mark.parametrize("strut", study.STRUTS)
def test_every_strut_has_the_figures_of_an_independent_implementation(
    strut: str, road: int
) -> None:
    controller, settings = study.STRUTS[strut]
    found = metrics(str(road), controller, *settings)
    for name, printed in zip(NAMES, study.known("table", strut, road), strict=True):
        if name is not None and printed:
            digit = 10.0 ** -len(printed.partition(".")[2])
            value = found[name] * (1e3 if name == "spool_max_m" else 1.0)
            margin = max(0.6 * digit, IRREGULAR.get((strut, road), 0.0) * value)
            assert abs(value - float(printed)) <= margin, f"{name} {value:.6g}, not {printed}"


def test_a_kick_tells_the_stable_force_loop_from_the_naive_one() -> None:
    naive, stable = metrics("kick", "pid"), metrics("kick", "fl")
    assert naive["speed_rms_m_s"] == pytest.approx(0.0224, abs=1e-4), f"{naive['speed_rms_m_s']}"
    assert naive["oscillation_rad_s"] == pytest.approx(55.3, abs=0.2), naive["oscillation_rad_s"]
    assert stable["speed_rms_m_s"] < 1e-4 * naive["speed_rms_m_s"], f"{stable['speed_rms_m_s']}"


def test_the_fuzzy_system_makes_the_ride_smoother_at_low_frequency() -> None:
    ride = {c: metrics("8", c)["acceleration_rms_m_s2"] for c in ("fl", "no_fl", "pid")}
    assert ride["fl"] < 0.9 * ride["no_fl"] and ride["fl"] < 0.75 * ride["pid"], f"{ride}"
    force = {c: metrics("8", c)["force_error_rms_N"] for c in ("fl", "no_fl", "pid")}
    assert 5.0 * force["fl"] < force["no_fl"] < 0.2 * force["pid"], f"{force}"


def test_three_samples_of_delay_leave_backstepping_as_it_is_and_hurt_pid() -> None:
    late = "car.delay_samples=3.0"
    for road, low, high in (("8", 0.1982, 0.1992), ("58", 0.324, 0.330), ("150", 0.0043, 0.0048)):
        found = metrics(road, "fl", late)["speed_rms_m_s"]
        assert low <= found <= high, f"fl at {road}: {found}"
    pid = metrics("8", "pid", late)["acceleration_rms_m_s2"]
    assert pid == pytest.approx(3.70, abs=0.05), f"pid {pid} m/s2"
    worse = metrics("150", "fl", "car.delay_samples=5.0")["speed_rms_m_s"]
    assert worse == pytest.approx(0.0162, abs=3e-4), f"fl 5 samples late at 150: {worse}"


def test_forgetting_matters_at_the_wheel_frequency() -> None:
    little = metrics("58", "fl", "controller.kap_per_m=1.0")["speed_rms_m_s"]
    much = metrics("58", "fl", "controller.kap_per_m=300.0")["speed_rms_m_s"]
    assert little == pytest.approx(0.4094, rel=0.01), f"kap 1: {little}"
    assert much == pytest.approx(0.3181, rel=0.01), f"kap 300: {much}"


@pytest.mark.parametrize("road", study.ROADS)
def test_coarse_sensors_do_not_change_the_fourth_digit(road: int) -> None:
    fine, coarse = (metrics(str(road), "fl", *more)["speed_rms_m_s"] for more in ((), study.QUANTA))
    assert coarse == pytest.approx(fine, abs=6e-5), f"{coarse}, with the bus' own {fine}"


def test_the_weights_stay_bounded() -> None:
    found = metrics("58", "fl", "duration_s=12.0")
    assert 1.8e-3 < found["theta_norm_max_m"] < 2.3e-3, f"{found['theta_norm_max_m']} m"
    assert 1.1e-3 < found["theta_max_m"] < 1.4e-3, f"{found['theta_max_m']} m"


def test_the_force_follows_at_150_once_the_law_is_faster_and_knows_the_drift() -> None:
    slow = metrics("150", "fl", *study.CAUSES["exact drift"])
    fast = metrics("150", "fl", *study.CAUSES["exact drift, faster"])
    assert slow["force_error_rms_N"] == pytest.approx(463.0, rel=0.01), (
        f"{slow['force_error_rms_N']} N"
    )
    assert fast["force_error_rms_N"] == pytest.approx(103.0, rel=0.01), (
        f"{fast['force_error_rms_N']} N"
    )
    assert fast["force_correlation"] == pytest.approx(0.97, abs=0.006)
    assert fast["speed_rms_m_s"] > 2.0 * metrics("150", "fl")["speed_rms_m_s"], (
        "no better for the body"
    )


def test_stops_hurt_the_passive_car_above_the_wheel_frequency() -> None:
    for road in (58, 150):
        free, stopped = (
            metrics(str(road), *_passive(label))["acceleration_rms_m_s2"]
            for label in ("passive, no stops", "passive")
        )
        assert 1.2 * free < stopped < 5.0 * free, f"{road}: {free} and {stopped} m/s2"


def _passive(label: str) -> tuple[str, ...]:
    controller, settings = study.STRUTS[label]
    return (controller, *settings)


@pytest.mark.parametrize(("controller", "least", "most"), [("pid", 0.5, 0.9), ("fl", 0.0, 0.02)])
def test_on_the_slow_road_the_valve_mode_appears_with_pid_alone(
    controller: str, least: float, most: float
) -> None:
    """The mode is a line between 40 and 70 rad/s of the body's acceleration, beside the road's."""
    log = in_memory(load_rig(FOLDER / "rigs/suspension-8.yaml", controller))
    rate_m_s = log.node["plant"].columns["car.body_rate_m_s"]
    settled = np.diff(rate_m_s[len(rate_m_s) // 2 :])
    lines = np.abs(np.fft.rfft(settled * np.hanning(len(settled))))
    turns_rad_s = 2.0 * np.pi * np.fft.rfftfreq(len(settled), 1e-3)
    road, mode = (
        lines[(turns_rad_s > low) & (turns_rad_s < high)].max() for low, high in ((5, 12), (40, 70))
    )
    assert least <= mode / road <= most, f"{mode / road:.3f} of the road's line"

"""Metrics of a barrel run on logs whose every figure is known, and the figure drawn of them."""

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pcpc.executive.log.reader import FRAME, Log, NodeLog
from pcpc.plants.atb1000 import ports
from pcpc.plants.atb1000.evaluation import EVALUATION
from pcpc.plants.judging import paired_rows
from pcpc.plants.pages import thinned_line

Array = NDArray[Any]
metrics, figure = EVALUATION.judge, EVALUATION.draw

PERIOD_S = 0.001
PERIOD_NS = 1_000_000
DROOP_RAD = -3.77e-3
RATIO = 60.0
ALL = (0.0, 100.0)
RIG = """\
controller: pd
controllers:
  other: {law: pd, parameters: {gear_ratio: 7.0}}
  pd: {law: pd, parameters: {gear_ratio: 60.0, tau_max_Nm: 115.0}}
plant: {blocks: {barrel: {law: model.py, parameters: {gear_ratio: 60.0}}}}
"""


def node(columns: dict[str, Array], phase_ns: int = 0) -> NodeLog:
    """Return a node of one cycle a period; `phase_ns` is added to the stamps."""
    cycle = np.arange(len(next(iter(columns.values()))), dtype=np.int64)
    stamps = cycle * PERIOD_NS + phase_ns
    return NodeLog(cycle, stamps, columns, {}, np.empty(0, FRAME), [], [], {})


def rows_of(old: NodeLog, rows: Array) -> NodeLog:
    """Return a node with these rows only."""
    columns = {name: values[rows] for name, values in old.columns.items()}
    return replace(old, cycle=old.cycle[rows], stamp_ns=old.stamp_ns[rows], columns=columns)


def with_nodes(log: Log, **nodes: NodeLog) -> Log:
    """Return a log with other nodes."""
    return replace(log, node={**log.node, **nodes})


def paced(log: Log, pacing: str) -> Log:
    """Return a log of another pacing."""
    return replace(log, metadata={"executive": {**log.metadata["executive"], "pacing": pacing}})


def run(
    cycles: int = 1000,
    error: Callable[[Array], Array] = np.zeros_like,
    bending: Callable[[Array], Array] = np.zeros_like,
    command: Callable[[Array], Array] = np.zeros_like,
    q_d: Callable[[Array], Array] = np.zeros_like,
    mode2: float = 0.0,
) -> Log:
    """Return a virtual run: hub error, bending about the static one, motor torque as given of t."""
    t = np.arange(cycles) * PERIOD_S
    theta = q_d(t) - error(t)
    executive = {
        "reference.q_d_rad": q_d(t),
        "controller.e_rad": error(t) + 1e-3,
        "controller.motor_torque_Nm": command(t),
    }
    plant = {
        "barrel.theta_rad": theta,
        "barrel.elastic_slope_rad": DROOP_RAD * np.cos(q_d(t)) + bending(t),
        "barrel.slope1_rad": (1.0 - mode2) * bending(t),
        "barrel.droop_rad": DROOP_RAD * np.cos(theta),
        "barrel.gear_torque_Nm": RATIO * command(t),
    }
    facts = {"pacing": "virtual", "period_ns": str(PERIOD_NS)}
    nodes = {"executive": node(executive), "plant": node(plant)}
    return Log(Path("run.mcap"), nodes, {"rig-resolved.yaml": RIG}, {"executive": facts}, [])


def sine(amplitude: float, frequency_hz: float) -> Callable[[Array], Array]:
    """Return a sine that has its peaks on the cycles."""
    return lambda t: amplitude * np.sin(2 * math.pi * frequency_hz * t)


def pulse(*cycles: int, size: float = 3e-3) -> Callable[[Array], Array]:
    """Return a signal that is `size` in some cycles, else 0."""
    return lambda t: size * np.isin(np.arange(len(t)), cycles)


def close(found: dict[str, float], **expected: float) -> None:
    """Check metrics to rounding."""
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-9, abs=1e-12), f"{name}: {found[name]!r}"


def test_errors_of_sines_have_their_rms_and_peak() -> None:
    log = run(error=sine(4e-3, 5.0), bending=sine(-3e-3, 5.0))
    close(
        metrics(log, (0.0, 1.0), {}, PERIOD_S),
        hub_error_rms_mrad=4.0 / math.sqrt(2.0),
        hub_error_max_mrad=4.0,
        muzzle_error_rms_mrad=7.0 / math.sqrt(2.0),
        muzzle_error_max_mrad=7.0,
    )


def test_droop_is_taken_at_the_desired_angle_not_at_the_present_one() -> None:
    log = run(error=lambda t: np.full_like(t, 0.5), q_d=lambda t: np.full_like(t, 0.6))
    close(metrics(log, ALL, {}, PERIOD_S), muzzle_error_max_mrad=500.0)
    sagging = DROOP_RAD * np.cos(log.node["plant"].columns["barrel.theta_rad"])
    log.node["plant"].columns["barrel.elastic_slope_rad"][:] = sagging
    expected = 500.0 + 1e3 * DROOP_RAD * (math.cos(0.6) - math.cos(0.1))
    close(metrics(log, ALL, {}, PERIOD_S), muzzle_error_max_mrad=expected)


def test_effort_and_step_of_the_command_are_at_the_output() -> None:
    square = run(command=lambda t: np.where(np.arange(len(t)) % 2 == 0, 0.5, -0.5))
    close(metrics(square, ALL, {}, PERIOD_S), command_rms_Nm=30.0, command_step_rms_Nm=60.0)
    ramp = run(command=lambda t: 2.0 * t)
    close(metrics(ramp, ALL, {}, PERIOD_S), command_step_rms_Nm=0.12)
    close(metrics(ramp, ALL, {"gear_ratio": 10.0}, PERIOD_S), command_step_rms_Nm=0.02)


def test_command_step_into_the_window_counts_and_one_over_a_skip_does_not() -> None:
    log = run(command=lambda t: np.where(t < 0.4995, 0.0, 1.0))
    close(metrics(log, (0.5, 0.6), {}, PERIOD_S), command_step_rms_Nm=6.0)
    skipped = rows_of(log.node["executive"], np.r_[0:498, 501:1000])
    found = metrics(with_nodes(log, executive=skipped), (0.4, 0.6), {}, PERIOD_S)
    close(found, command_step_rms_Nm=0.0)


def test_muzzle_at_rest_is_the_mean_size_of_its_error() -> None:
    log = run(error=lambda t: np.where(t < 0.6995, 2e-3, -1e-3))
    numbers = {"rest_from_s": 0.6, "rest_to_s": 0.8}
    close(metrics(log, (0.0, 0.1), numbers, PERIOD_S), muzzle_rest_mrad=1.5)


def test_settling_counts_from_its_start_to_one_period_after_the_last_sample_outside() -> None:
    numbers = {"settle_from_s": 0.2, "settle_to_s": 0.7}
    for outside, expected in (
        ((250, 320), 0.121),
        ((100, 199), 0.0),
        ((200,), 0.001),
        ((699,), math.inf),
        ((700,), 0.0),
    ):
        found = metrics(run(error=pulse(*outside)), ALL, numbers, PERIOD_S)
        assert found["settle_2mrad_s"] == pytest.approx(expected), f"{outside}: {found}"
    just = metrics(run(error=pulse(300, size=1.999e-3)), ALL, numbers, PERIOD_S)
    assert just["settle_2mrad_s"] == 0.0, just


def test_vibration_is_the_deviation_of_the_slope_about_its_mean() -> None:
    log = run(bending=sine(2e-3, 10.0), mode2=0.25)
    numbers = {"vibration_from_s": 0.1, "vibration_to_s": 0.6}
    close(
        metrics(log, ALL, numbers, PERIOD_S),
        vibration_mrad=2.0 / math.sqrt(2.0),
        vibration1_mrad=1.5 / math.sqrt(2.0),
    )


def test_metrics_that_were_not_asked_for_are_absent() -> None:
    asked = {"muzzle_rest_mrad", "settle_2mrad_s", "vibration_mrad", "vibration1_mrad"}
    assert not asked & set(metrics(run(), ALL, {}, PERIOD_S))
    numbers = {"rest_from_s": 0.0, "settle_from_s": 0.0, "vibration_from_s": 0.0}
    assert asked <= set(metrics(run(), ALL, numbers, PERIOD_S)), "no _to_s means the end"


@settings(max_examples=60, deadline=None)
@given(
    first=st.integers(0, 900), length=st.integers(1, 99), rate=st.sampled_from([300, 1000, 4000])
)
def test_window_holds_its_left_end_and_not_its_right(first: int, length: int, rate: int) -> None:
    period_s = 1.0 / rate
    window = (first * period_s, (first + length) * period_s)
    for cycle, expected in (
        (first - 1, 0.0),
        (first, 3.0),
        (first + length - 1, 3.0),
        (first + length, 0.0),
    ):
        found = metrics(run(error=pulse(cycle)), window, {}, period_s)
        assert found["hub_error_max_mrad"] == pytest.approx(expected), f"cycle {cycle} of {window}"


def test_run_as_long_as_its_window_is_judged_to_its_last_cycle() -> None:
    found = metrics(run(error=pulse(999)), (0.5, 1.0), {}, PERIOD_S)
    close(found, hub_error_max_mrad=3.0, hub_error_rms_mrad=3.0 / math.sqrt(500.0))


def lockstep_on_a_bus() -> Log:
    """Return a run whose plant stamps SYNC(k), whose executive stamps feedback(k) 70 us later."""
    log = run(error=sine(4e-3, 5.0), bending=sine(1e-3, 20.0))
    plant = replace(log.node["plant"], stamp_ns=log.node["plant"].stamp_ns + 9_000_000)
    executive = replace(log.node["executive"], stamp_ns=plant.stamp_ns + 70_000)
    return paced(with_nodes(log, plant=plant, executive=executive), "lockstep")


def test_pairing_by_stamp_gives_in_lockstep_the_same_as_by_cycle() -> None:
    for log in (lockstep_on_a_bus(), run(error=sine(4e-3, 5.0))):
        by_cycle, by_stamp = paired_rows(log, PERIOD_S), paired_rows(paced(log, "real"), PERIOD_S)
        assert np.array_equal(by_cycle, np.arange(1000)), by_cycle
        assert np.array_equal(by_stamp, by_cycle), by_stamp


def test_lockstep_pairs_by_cycle_when_the_machines_have_other_clocks() -> None:
    log = lockstep_on_a_bus()
    away = replace(log.node["plant"], stamp_ns=log.node["plant"].stamp_ns + 10**15)
    moved = with_nodes(log, plant=rows_of(away, np.r_[0:500, 520:1000]))
    rows = paired_rows(moved, PERIOD_S)
    assert np.array_equal(rows, np.r_[0:500, [-1] * 20, 500:980]), rows[495:525]


def test_without_a_clock_cycles_that_are_missing_do_not_move_the_plant_record() -> None:
    log = run(error=lambda t: t * 1e-3, bending=sine(1e-3, 20.0))
    kept = np.r_[0:100, 107:1000]
    short = with_nodes(log, executive=rows_of(log.node["executive"], kept))
    assert np.array_equal(paired_rows(short, PERIOD_S), kept)
    late = with_nodes(log, executive=rows_of(log.node["executive"], np.r_[7:1000]))
    assert np.array_equal(paired_rows(late, PERIOD_S), np.r_[7:1000])
    close(metrics(short, (0.1, 0.2), {}, PERIOD_S), hub_error_max_mrad=0.199)


def test_paced_cycle_gets_the_newest_plant_record_that_is_not_later() -> None:
    log = paced(run(), "real")
    half_later = replace(log.node["plant"], stamp_ns=log.node["plant"].stamp_ns + PERIOD_NS // 2)
    log = with_nodes(log, plant=half_later)
    assert np.array_equal(paired_rows(log, PERIOD_S), np.arange(-1, 999))
    late = log.node["executive"].stamp_ns.copy()
    late[10] += 600_000
    late[20] += 499_999
    executive = replace(log.node["executive"], stamp_ns=late)
    rows = paired_rows(with_nodes(log, executive=executive), PERIOD_S)
    assert (rows[10], rows[20]) == (10, 19), rows[8:22]


def test_paced_cycles_after_a_skip_keep_their_time_and_their_plant_record() -> None:
    log = paced(run(error=lambda t: t * 1e-3, bending=sine(1e-3, 20.0)), "real")
    kept = np.r_[0:100, 107:1000]
    skipped = with_nodes(log, executive=rows_of(log.node["executive"], kept))
    assert np.array_equal(paired_rows(skipped, PERIOD_S), kept)
    close(metrics(skipped, (0.1, 0.2), {}, PERIOD_S), hub_error_max_mrad=0.199)
    close(metrics(skipped, (0.05, 0.107), {}, PERIOD_S), hub_error_max_mrad=0.099)


def test_lost_plant_records_are_not_made_up_from_old_ones() -> None:
    log = paced(run(error=pulse(*range(300, 400))), "real")
    lost = rows_of(log.node["plant"], np.r_[0:250, 450:700])
    rows = paired_rows(with_nodes(log, plant=lost), PERIOD_S)
    assert np.flatnonzero(rows < 0).tolist() == [*range(252, 450), *range(702, 1000)]
    found = metrics(with_nodes(log, plant=lost), ALL, {"settle_from_s": 0.0}, PERIOD_S)
    close(found, hub_error_max_mrad=0.0, settle_2mrad_s=0.0)


def test_without_plant_only_what_the_executive_knows_is_told() -> None:
    log = run(error=pulse(5), command=lambda t: t)
    alone = replace(log, node={"executive": log.node["executive"]})
    numbers = {"rest_from_s": 0.0, "settle_from_s": 0.0, "vibration_from_s": 0.0}
    measured = {"hub_error_rms_mrad", "hub_error_max_mrad", "command_rms_Nm", "command_step_rms_Nm"}
    found = metrics(alone, ALL, numbers, PERIOD_S)
    assert set(found) == measured, found
    close(found, hub_error_max_mrad=4.0)
    empty = rows_of(log.node["plant"], np.arange(0))
    assert metrics(with_nodes(log, plant=empty), ALL, numbers, PERIOD_S) == found
    assert metrics(replace(log, node={"plant": log.node["plant"]}), ALL, numbers, PERIOD_S) == {}


def test_without_a_gear_ratio_nothing_is_said_about_the_output() -> None:
    found = metrics(replace(run(), attachments={}), ALL, {}, PERIOD_S)
    assert "command_rms_Nm" not in found and "hub_error_rms_mrad" in found, found


def test_values_that_are_not_finite_are_left_out_but_do_not_count_as_settled() -> None:
    log = run(error=lambda t: np.where(t < 0.4995, 1e-3, math.nan))
    found = metrics(log, (0.0, 1.0), {"settle_from_s": 0.1}, PERIOD_S)
    close(found, hub_error_rms_mrad=1.0, hub_error_max_mrad=1.0, settle_2mrad_s=math.inf)
    found = metrics(log, (0.6, 1.0), {}, PERIOD_S)
    assert "hub_error_rms_mrad" not in found and found["command_rms_Nm"] == 0.0, found
    diverged = run(error=lambda t: 10.0 ** (300.0 * t))
    assert metrics(diverged, ALL, {}, PERIOD_S)["hub_error_rms_mrad"] == math.inf


def test_short_log_is_judged_as_far_as_it_goes() -> None:
    log = run(600, error=lambda t: t * 1e-3)
    close(metrics(log, (0.5, 6.0), {}, PERIOD_S), hub_error_max_mrad=0.599)
    assert metrics(log, (0.6, 6.0), {}, PERIOD_S) == {}
    found = metrics(log, (0.5, 6.0), {"rest_from_s": 2.0, "rest_to_s": 2.5}, PERIOD_S)
    assert "muzzle_rest_mrad" not in found, found


def test_columns_read_here_are_outputs_of_the_barrel() -> None:
    outputs = {f"barrel.{port.name}" for port in ports.Outputs.ports}
    assert set(run().node["plant"].columns) <= outputs


@given(spike=st.integers(0, 15_999), size=st.sampled_from([-5.0, 5.0]))
@settings(max_examples=40, deadline=None)
def test_thinned_line_keeps_every_peak_and_its_time(spike: int, size: float) -> None:
    t = np.arange(16_000.0)
    y = np.sin(0.01 * t)
    y[spike] = size
    thin_t, thin_y = thinned_line(t, y, 1000)
    assert len(thin_t) <= 1016, len(thin_t)
    assert thin_y[thin_t == spike] == [size], f"{spike}: {thin_y.min()}..{thin_y.max()}"
    assert np.array_equal(thin_y, y[thin_t.astype(int)]) and np.all(np.diff(thin_t) > 0)


def test_thinned_line_keeps_gaps_and_peaks_beside_them() -> None:
    y = np.ones(10_000)
    y[4005], y[6005] = -7.0, 7.0
    y[4010:6000] = y[4000:4005] = y[6010:6015] = math.nan
    thin_t, thin_y = thinned_line(np.arange(10_000.0), y, 1000)
    assert np.isnan(thin_y[(thin_t >= 4020) & (thin_t < 5980)]).all()
    assert np.isfinite(thin_y[(thin_t < 3980) | (thin_t > 6020)]).all()
    assert (np.nanmin(thin_y), np.nanmax(thin_y)) == (-7.0, 7.0)


def test_figure_is_drawn_of_every_kind_of_log(tmp_path: Path) -> None:
    whole = run(
        error=sine(4e-3, 5.0), bending=sine(1e-3, 20.0), command=sine(0.1, 5.0), q_d=sine(0.1, 2.0)
    )
    executive, plant = whole.node["executive"], whole.node["plant"]
    late = np.where(np.arange(1000) % 100 == 50, 400.0, 20.0)
    timing = {"timing.wake_late_us": late, "health.late_cycles": np.cumsum(late > 100) * 1.0}
    none = rows_of(executive, np.arange(0))
    for name, log in {
        "virtual": whole,
        "paced": paced(with_nodes(whole, executive=replace(executive, timing=timing)), "real"),
        "alone": replace(whole, node={"executive": executive}, attachments={}),
        "empty": with_nodes(whole, executive=none, plant=none),
        "plant": replace(whole, node={"plant": plant}),
        "diverged": run(error=lambda t: np.where(t < 0.9, 10.0 ** (250.0 * t), math.nan)),
    }.items():
        found = metrics(log, (0.2, 1.0), {"settle_from_s": 0.0}, PERIOD_S)
        figure(log, tmp_path / f"{name}.png", f"barrel: {name}", found, (0.2, 1.0))
        head = (tmp_path / f"{name}.png").read_bytes()[:24]
        size = int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
        assert head[1:4] == b"PNG" and size == (1200, 1500), f"{name}: {size}"


def test_figure_without_matplotlib_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"needs matplotlib: .* -m pip install 'matplotlib~="):
        figure(run(), tmp_path / "figure.png", "", {}, ALL)

"""`pcpc.margin` where differences of a cycle's map say nothing or too little of the loop."""

from pathlib import Path

import numpy as np
import pytest

import pcpc
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.study.margin import loops, operating, slopes
from pcpc.tools.study.margin.book._linear_rig import PLANTS, RATE_HZ, T
from pcpc.tools.study.margin.cycle_map import CycleMap

LAG = PLANTS["lag"]


@pytest.mark.parametrize("quantum", [3e-8, 4e-7, 1e-6, 2.2e-6, 1e-3, 0.1])
@pytest.mark.parametrize("name", list(PLANTS))
def test_a_sample_rounded_in_the_plant_has_the_slope_from_step_to_step(
    tmp_path: Path, name: str, quantum: float
) -> None:
    path = PLANTS[name].write(tmp_path, quantum=quantum)
    one = pcpc.margin(path, method="linearised", settle_s=1.0, at_s=1.0)
    assert one.linearised is not None
    f, found = one.linearised.f_hz, one.linearised.response
    low = f < 0.45 * RATE_HZ  # L of one of them ends in 0
    error = np.abs(found[low] / PLANTS[name].loop(f[low]) - 1.0).max()
    assert error < 1e-3, f"{error:.1e}"
    assert "rx.FB.position is rounded" in one.text()
    assert f"in steps of {quantum:.3g}" in one.text().replace("\n", " ")


def test_a_ring_buffer_is_a_delay_of_the_loop(tmp_path: Path) -> None:
    path = LAG.write(tmp_path)
    late = {"controller.late": 5.0, "controller.kp": 2.0}
    one = pcpc.margin(path, "late", set=late, settle_s=1.0, amplitude=10.0, lowest_hz=0.5)
    assert one.linearised is not None
    f = one.linearised.f_hz
    exact = LAG.loop(f) * 2.0 / LAG.kp * np.exp(-2j * np.pi * f * 5.0 * T)
    assert np.abs(one.linearised.response / exact - 1.0).max() < 1e-3
    assert one.deviation.max() < 1e-3
    assert "another map in every cycle" in one.text()


def test_a_ring_buffer_that_is_too_long_for_the_loop_is_refused(tmp_path: Path) -> None:
    path = LAG.write(tmp_path)
    with pytest.raises(pcpc.Error, match=r"does not come to rest within .* cycles: unstable"):
        pcpc.margin(path, "late", set={"controller.late": 15.0}, method="linearised", settle_s=0.1)


def test_a_memory_behind_a_closed_gate_is_named(tmp_path: Path) -> None:
    one = pcpc.margin(LAG.write(tmp_path), "gated", method="linearised", settle_s=1.0, at_s=1.0)
    assert "not in the loop: controller.slow, controller.open; a gate" in one.text().replace(
        "\n", " "
    )


def test_a_limit_on_both_sides_is_no_rounding(tmp_path: Path) -> None:
    def limited(moved: dict[int, float]) -> slopes.Vector:
        x = 0.3 + moved.get(0, 0.0)
        return np.array([min(max(1e5 * (x - 0.3), -1.0), 1.0), 1.0 if x > 0.305 else 0.0])

    found = slopes.slopes(limited, np.array([0.3]), 0, np.empty(0, np.int64))
    for i in np.flatnonzero(found.rounded[:, 0]).tolist():
        assert slopes.steps(limited, np.array([0.3]), i, np.array([0])) is None
    assert found.slopes[0, 0] == pytest.approx(1e5) and found.slopes[1, 0] == 0.0


def test_a_loop_that_is_linear_but_cannot_be_measured_keeps_its_margins(tmp_path: Path) -> None:
    path = LAG.write(tmp_path, quantum=0.1)
    one = pcpc.margin(path, amplitude=1e-3, settle_s=1.0, lowest_hz=5.0)
    assert one.measured is None and one.linearised is not None
    assert "not measured: the measured loop does not answer" in one.text().replace("\n", " ")


def test_the_command_takes_a_time_and_frequencies_below_1_hz(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(LAG.write(tmp_path))
    words = ["margin", path, "--at", "2s", "--lowest", "0.5Hz", "--method", "linearised"]
    assert main(words) == 0
    assert "reference.target = 1," in capsys.readouterr().out
    assert main(["margin", "slew10", "--at", "1s", "--lowest", "nothing"]) == 2
    assert "expected a rate like 0.5, 20Hz" in capsys.readouterr().err


def test_what_left_its_bounds_is_a_state_of_a_block(tmp_path: Path) -> None:
    with pytest.raises(pcpc.Error, match=r"unstable: (controller|plant:system)\.\w+ leaves all"):
        pcpc.margin(LAG.write(tmp_path), set={"controller.kp": 500.0}, at_s=1.0, settle_s=8.0)


def test_the_plant_is_a_cycle_ahead_of_the_law_it_answers(tmp_path: Path) -> None:
    plans = operating.plans_of(operating.without_disturbances(load_rig(LAG.write(tmp_path))))
    cycle, (cut, _) = CycleMap(plans), loops.choose(load_rig(LAG.write(tmp_path)), plans, None)
    cycle.begin({})
    for k in range(3):
        if k < 2:
            cycle.advance()
        else:
            cycle.advance(cut, 0.0, added=True)
        told = [cycle.v[cycle.place(role, "time.t_s")] for role in cycle.roles]
        assert told == pytest.approx([k * T, (k + 1) * T])

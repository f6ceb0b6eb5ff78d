"""`pcpc.margin` on linear plants against closed forms, its definitions, and what it refuses."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from json_schemas import holds

import pcpc
from pcpc.tools.cli import main
from pcpc.tools.study.margin.book._linear_rig import PLANTS, RATE_HZ, Linear
from pcpc.tools.study.margin.margins import Margins, margins

Write = Callable[..., Path]
FAST = {"settle_s": 2.0, "lowest_hz": 0.5, "amplitude": 10.0}


@pytest.fixture(params=list(PLANTS))
def plant(request: pytest.FixtureRequest) -> Linear:
    return PLANTS[request.param]


def found(plant: Linear, folder: Path, **options: object) -> pcpc.Margin:
    return pcpc.margin(plant.write(folder), **(FAST | options))  # type: ignore[arg-type]


def brute(plant: Linear) -> dict[str, float]:
    """Return margins of the closed form by search over a million frequencies."""
    f = np.geomspace(0.1, 0.5 * RATE_HZ * (1.0 - 1e-9), 1_000_000)
    loop = plant.loop(f)
    size, imaginary = np.abs(loop), loop.imag
    across = np.flatnonzero((imaginary[1:] > 0) != (imaginary[:-1] > 0))
    across = across[(loop.real[across] < 0) & (size[across] < 1)]
    own = np.flatnonzero((size[1:] > 1) != (size[:-1] > 1))
    phase = np.mod(np.rad2deg(np.angle(loop[own])) + 180.0, 360.0)
    delay = np.deg2rad(phase) / (2 * np.pi * f[own])
    nearest = np.where(phase > 180.0, phase - 360.0, phase)
    return {
        "gain_margin": 1.0 / size[across].max(),
        "phase_margin_deg": nearest[np.argmin(np.abs(nearest))],
        "delay_margin_s": delay.min(),
        "sensitivity_peak": np.abs(1.0 / (1.0 + loop)).max(),
        "disk_margin": 2.0 / np.abs((1.0 - loop) / (1.0 + loop)).max(),
    }


def test_the_linearised_loop_is_the_closed_form(plant: Linear, tmp_path: Path) -> None:
    loop = found(plant, tmp_path, method="linearised").linearised
    assert loop is not None
    error = np.abs(loop.response / plant.loop(loop.f_hz) - 1.0).max()
    assert error < 1e-6, f"{error:.1e}"


def test_the_measured_loop_is_the_linearised_one(plant: Linear, tmp_path: Path) -> None:
    error = found(plant, tmp_path, settle_s=8.0).deviation.max()
    assert error < 1e-6, f"{error:.1e}"


@pytest.mark.parametrize("method", ["linearised", "measured"])
def test_margins_are_those_of_the_closed_form(plant: Linear, tmp_path: Path, method: str) -> None:
    ours, exact = found(plant, tmp_path, method=method), brute(plant)
    for name, value in exact.items():
        assert getattr(ours, name) == pytest.approx(value, rel=0.01), name


def test_the_gain_margin_is_where_a_pole_leaves_the_circle(plant: Linear, tmp_path: Path) -> None:
    margin = found(plant, tmp_path, method="linearised").gain_margin
    for factor, stable in ((0.999 * margin, True), (1.001 * margin, False)):
        folder = tmp_path / str(stable)
        folder.mkdir()
        path = plant.write(folder)
        gains = {"controller.kp": plant.kp * factor, "controller.kd": plant.kd * factor}
        if stable:
            pcpc.margin(path, set=gains, method="linearised", settle_s=0.1)
        else:
            with pytest.raises(pcpc.Error, match="unstable: a pole at"):
                pcpc.margin(path, set=gains, method="linearised", settle_s=0.1)


def test_no_factor_within_the_disk_reaches_minus_one_and_one_on_its_edge_does() -> None:
    f = np.geomspace(0.5, 249.0, 4000)
    for name, plant in PLANTS.items():
        loop = plant.loop(f)
        alpha = margins(f, loop, RATE_HZ).disk_margin
        delta = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 2001))[:, None]
        for share, reaches in ((0.98, False), (1.0, True)):
            own = share * alpha * delta
            nearest = np.abs(1.0 + loop[None, ::4] * (1.0 + own / 2) / (1.0 - own / 2)).min()
            assert (nearest < 5e-3) == reaches, (name, share, nearest)


def test_the_delay_margin_is_the_phase_margin_at_the_crossover() -> None:
    f = np.geomspace(1.0, 249.0, 2000)
    one = margins(f, PLANTS["lag"].loop(f), RATE_HZ)
    expected = np.deg2rad(one.phase_margin_deg) / (2.0 * np.pi * one.crossover_hz)
    assert one.delay_margin_s == pytest.approx(expected, rel=1e-9)
    assert one.delay_margin_samples == pytest.approx(expected * RATE_HZ, rel=1e-9)


def test_a_loop_below_one_has_every_margin_of_phase_and_delay() -> None:
    f = np.geomspace(1.0, 249.0, 100)
    one = margins(f, np.full(100, 0.5 + 0.0j), RATE_HZ)
    assert (one.gain_margin, one.phase_margin_deg, one.delay_margin_s) == (np.inf,) * 3
    assert one.disk_gain == pytest.approx((0.0, np.inf)) or one.disk_margin > 2.0


def test_the_disk_s_ranges_follow_from_its_size() -> None:
    nothing = [float("nan")] * 12
    one = Margins(*nothing[:10], 0.5, 1.0)
    assert one.disk_gain == pytest.approx((0.6, 1.0 / 0.6))
    assert one.disk_phase_deg == pytest.approx(2.0 * np.rad2deg(np.arctan(0.25)))


def test_the_other_loop_is_closed_while_one_is_looked_at(tmp_path: Path) -> None:
    plant = PLANTS["lag"]
    path = plant.write(tmp_path, side_gain=2.0)
    main_loop = pcpc.margin(path, loop="CMD.command", method="linearised").linearised
    side = pcpc.margin(path, loop="SIDE.command", method="linearised").linearised
    assert main_loop is not None and side is not None
    f = main_loop.f_hz
    whole = plant.loop(f)  # of kp; the side has 0.25 * 2 of the same error
    other = whole * 0.5 / plant.kp
    assert np.abs(main_loop.response / (whole / (1.0 + other)) - 1.0).max() < 1e-6
    f = side.f_hz
    whole = plant.loop(f)
    expected = whole * 0.5 / plant.kp / (1.0 + whole)
    assert np.abs(side.response / expected - 1.0).max() < 1e-6


def test_the_reference_is_held_and_its_rate_is_none(tmp_path: Path) -> None:
    path = PLANTS["lag"].write(tmp_path)
    one = pcpc.margin(path, at_s=3.0, method="linearised")
    assert one.reference == {"reference.target": 1.5, "reference.rate_s": 0.0}
    rest = 1.5 / (1.0 + 1.0 / PLANTS["lag"].kp)
    assert one.command == pytest.approx(rest, rel=1e-6)
    measured = pcpc.margin(path, at_s=3.0, method="measured", lowest_hz=10.0)
    assert measured.command == pytest.approx(rest, rel=1e-6)


def test_what_is_not_differentiable_is_named(tmp_path: Path) -> None:
    path = PLANTS["lag"].write(tmp_path, bend=0.1)
    one = pcpc.margin(path, at_s=0.0, method="linearised")
    assert one.kinks == ["plant:system.held"], "the command is 0, where the slopes meet"
    assert "not differentiable in plant:system.held" in one.text().replace("\n", " ")
    assert not pcpc.margin(path, at_s=1.0, method="linearised").kinks, "beside it"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"loop": "CMD.comand"}, "--loop CMD.comand: no such loop; did you mean CMD.command?"),
        ({"at_s": -1.0}, "--at -1 s: expected a time of the run"),
        ({"amplitude": 0.0}, "--amplitude 0: expected a number above 0"),
        ({"settle_s": 0.0}, "--settle 0 s"),
        ({"lowest_hz": 400.0}, "--lowest 400 Hz: expected 0.0005 to 62.5 Hz"),
        ({"method": "guessed"}, "method guessed: expected both, linearised or measured"),
        ({"set": {"controller.kp": 0.0}}, "CMD.command has no effect on itself: no gain"),
        ({"set": {"controller.kp": 1000.0}}, "the closed loop is unstable"),
    ],
)
def test_what_cannot_be_is_said_with_its_cure(
    tmp_path: Path, options: dict[str, object], said: str
) -> None:
    path = PLANTS["lag"].write(tmp_path)
    with pytest.raises(pcpc.Error) as caught:
        pcpc.margin(path, **({"method": "linearised"} | options))  # type: ignore[arg-type]
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_rig_without_a_loop_says_so(tmp_path: Path) -> None:
    path = PLANTS["lag"].write(tmp_path)
    text = path.read_text().replace("CMD.command: controller.command", "")
    path.write_text(text.replace("SIDE.command: controller.side", ""))
    with pytest.raises(pcpc.Error, match="no loop: no signal that a law sends"):
        pcpc.margin(path)


def test_an_unstable_loop_is_no_measured_one(tmp_path: Path) -> None:
    path = PLANTS["lag"].write(tmp_path)
    with pytest.raises(pcpc.Error, match=r"unstable|does not answer|ended after"):
        pcpc.margin(path, set={"controller.kp": 200.0}, at_s=1.0, lowest_hz=10.0)


def test_the_command_writes_a_table_json_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = str(PLANTS["lag"].write(tmp_path)), tmp_path / "out"
    more = ["--amplitude", "10", "--lowest", "5", "--settle", "500ms"]
    assert main(["margin", path, *more, "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 80
    assert "phase margin" in said and "measured" in said
    assert (out / "bode.png").read_bytes()[:4] == (out / "nyquist.png").read_bytes()[:4]
    assert main(["margin", path, *more, "--json"]) == 0
    printed = holds("margin", capsys.readouterr().out)
    assert printed == json.loads((out / "margin.json").read_text())
    assert printed["linearised"]["margins"]["phase_margin_deg"] == pytest.approx(
        brute(PLANTS["lag"])["phase_margin_deg"], rel=0.01
    )

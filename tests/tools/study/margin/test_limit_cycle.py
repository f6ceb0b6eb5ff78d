"""Harmonic balance: describing functions, a loop of closed form with play, a run beside it."""

from pathlib import Path

import numpy as np
import pytest
from json_schemas import holds

import pcpc
from pcpc.tools.cli import main
from pcpc.tools.study.margin import balance
from pcpc.tools.study.margin.book._linear_rig import PLANTS, Linear
from pcpc.tools.study.margin.limit_cycle import limit_cycle
from pcpc.tools.study.margin.limit_cycle_result import LimitCycle

GAIN = "controller.kp"


def play(ratio: float) -> complex:
    """Return the describing function of a play of slope 1, `ratio` = half the play by amplitude."""
    s = 1.0 - 2.0 * ratio
    real = 0.5 + (np.arcsin(s) + s * np.sqrt(1.0 - s * s)) / np.pi
    return complex(real, -4.0 * ratio * (1.0 - ratio) / np.pi)


def slack(ratio: float) -> complex:
    """Return that of a dead zone."""
    return complex(1.0 - 2.0 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1.0 - ratio**2)))


KNOWN = {"gap": play, "slack": slack}


def integral(name: str, ratio: float) -> complex:
    """Return the first harmonic of the wave itself, by quadrature."""
    from scipy.integrate import quad

    def wave(th: float) -> float:
        u = np.cos(th)
        if name == "slack":
            return float(u - np.clip(u, -ratio, ratio))
        turn = np.arccos(1.0 - 2.0 * ratio)  # it waits from each turn on
        th = float(np.mod(th, 2.0 * np.pi))
        if th < np.pi:
            return float(1.0 - ratio if th < turn else u + ratio)
        return float(ratio - 1.0 if th < np.pi + turn else u - ratio)

    parts = [
        quad(lambda th, f=f: wave(th) * f(th) / np.pi, 0.0, 2.0 * np.pi, limit=400)[0]
        for f in (np.cos, np.sin)
    ]
    return complex(parts[0], -parts[1])


@pytest.mark.parametrize("name", list(KNOWN))
@pytest.mark.parametrize("ratio", [0.1, 0.3, 0.7])
def test_describing_functions_are_their_integrals(name: str, ratio: float) -> None:
    assert KNOWN[name](ratio) == pytest.approx(integral(name, ratio), abs=1e-6)


@pytest.mark.parametrize("name", list(KNOWN))
@pytest.mark.parametrize("ratio", [0.1, 0.3, 0.7])
def test_phases_of_a_map_give_the_describing_function(name: str, ratio: float) -> None:
    def step(x: balance.Vector, gain: float) -> balance.Vector:
        u, held = x
        moved = u - np.clip(u, -ratio, ratio) if name == "slack" else u
        wide = ratio if name == "gap" else 0.0
        return np.array([u, np.clip(held, moved - wide, moved + wide)])

    at = balance.BalancedCycle(np.array([1.0, 0.5]), np.zeros(2), 0.3, 1.0, 1.0, 0.0)
    waiting = (1,) if name == "gap" else ()
    assert ratio > 0.5 or balance.waiting_states(step, at) == waiting
    swept = balance.after_cycle(
        step, balance.BalancedCycle(at.phi, at.mean, 0.3, 1.0, 1.0, 0.0, waiting)
    )
    assert balance.first_harmonic(swept[:, 1]) == pytest.approx(KNOWN[name](ratio), abs=5e-3)


def found(plant: Linear, folder: Path, **options: object) -> LimitCycle:
    path = plant.write(folder, **options)  # type: ignore[arg-type]
    taken = [f"system.{name}=0" for name in options]
    return limit_cycle(path, None, [], taken, GAIN, None, [1.0])


@pytest.mark.parametrize("name", list(KNOWN))
def test_the_branch_is_that_of_the_closed_form(name: str, tmp_path: Path) -> None:
    from scipy.optimize import brentq

    plant = PLANTS["lag"]
    ours = found(plant, tmp_path, **{name: 1000.0})
    assert len(ours.branch) > 6
    for point in ours.branch:
        ratio = 1000.0 / point.amplitude
        n = KNOWN[name](ratio)

        def angle(f: float, n: complex = n) -> float:
            return float(np.angle(-plant.loop(np.array([f]))[0] * n))

        f = brentq(angle, 0.3 * point.f_hz, 1.5 * point.f_hz)
        gain = 1.0 / abs(plant.loop(np.array([f]))[0] * n)
        assert point.f_hz == pytest.approx(f, rel=0.01)
        assert point.factor == pytest.approx(gain, rel=0.02), ratio


def test_a_run_cycles_as_a_relay_s_describing_function_says(tmp_path: Path) -> None:
    path = PLANTS["resonant"].write(tmp_path, relay=1000.0)
    one = limit_cycle(path, None, [], ["system.relay=0"], GAIN, None, [1.0, 1.5, 2.0])
    for row in one.rows:
        assert row.predicted is not None
        size = 4.0 / np.pi * 1000.0 / (one.linear_factor / row.factor - 1.0)
        assert row.predicted.amplitude == pytest.approx(size, rel=0.03), row.factor
        assert row.alone == pytest.approx(row.predicted.step_rms, rel=0.1), row.factor


def test_a_run_without_a_predicted_cycle_comes_to_rest(tmp_path: Path) -> None:
    path = PLANTS["lag"].write(tmp_path, gap=1000.0)
    row = limit_cycle(path, None, [], ["system.gap=0"], GAIN, None, [2.5]).rows[0]
    assert row.predicted is None and row.alone < 1.0


def test_the_command_tells_and_draws_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(PLANTS["lag"].write(tmp_path, slack=1000.0))
    words = ["margin", path, "--limit-cycle", GAIN, "--linear", "system.slack=0"]
    assert main([*words, "--factors", "1,2", "-o", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 80
    assert "with      system.slack = 1000" in said
    kept = holds("margin", (tmp_path / "out" / "limit_cycle.json").read_text())
    assert kept["onset"]["factor"] == pytest.approx(kept["linear_factor"], rel=0.2)
    assert (tmp_path / "out" / "limit_cycle.png").read_bytes()[:4] == b"\x89PNG"
    for wrong, said in (
        (words[:4], "no linear.yaml beside the rig or above; name what makes it linear"),
        ([*words[:3], "controller.none", *words[4:]], "controller.none: not a number that a step"),
        ([*words, "--factors", "0"], "expected numbers above 0 like 1,1.5,2, got '0'"),
    ):
        assert main(wrong) == 2
        assert said in capsys.readouterr().err


def test_a_gain_that_makes_nothing_unstable_is_refused(tmp_path: Path) -> None:
    path = PLANTS["lag"].write(tmp_path, slack=10.0)
    with pytest.raises(pcpc.Error, match="stable up to a thousand times its value"):
        limit_cycle(path, None, [], ["system.slack=0"], "system.bend")

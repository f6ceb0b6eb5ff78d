"""Reference generators: angle, rate and acceleration belong together, and each keeps its shape."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from places import ROOT

from pcpc.drivers.compiled.jit import VIEW, compiled, types
from pcpc.drivers.compiled.stage import ENTRY, call, part
from pcpc.executive.laws import references, sequences
from pcpc.executive.laws.block import Block
from pcpc.executive.rig.reading import load_rig

RIGS = ROOT / "plants" / "atb1000" / "rigs"
STEP_S = 1e-5  # of the finite differences
SEEN_S = np.unique(np.random.default_rng(5).uniform(0.0, 16.0, 2000))
DETERMINISTIC = settings(max_examples=100, derandomize=True, deadline=None)

LOWSPEED = {"rate_rad_s": 0.003, "leg_s": 4.0, "start_s": 0.2, "corner_s": 0.1}
TRIANGLE_EDGES = [0.2] + [4.0 * n + d for n in range(1, 5) for d in (-0.1, 0.1)]
Table = NDArray[np.float64]

# name: (settings, times at which the acceleration jumps, times at which the rate jumps)
CASES: dict[str, tuple[dict[str, float], list[float], list[float]]] = {
    "quintic": (
        {"amplitude_rad": 0.17, "move_s": 0.6, "up_s": 0.5, "back_s": 3.25},
        [0.5, 1.1, 3.25, 3.85],
        [],
    ),
    "bang_bang": ({"amplitude_rad": 0.17, "move_s": 0.5, "start_s": 0.5}, [0.5, 0.75, 1.0], []),
    "step": ({"amplitude_rad": 0.17, "start_s": 0.5}, [0.5], [0.5]),
    "sine": ({"amplitude_rad": 0.09, "frequency_hz": 0.5, "phase_rad": 0.0}, [], []),
    "triangle": (LOWSPEED, TRIANGLE_EDGES, [0.2]),
    "ramp": ({"rate_rad_s": 0.05, "rise_s": 0.4}, [0.0, 0.4], []),
}


def at(name: str, t_s: Table | list[float], given: Mapping[str, float] | None = None) -> Table:
    """Return value, rate and acceleration at these times, (n, 3)."""
    block: Block = getattr(references, name)
    values = CASES[name][0] if given is None else given
    p = np.array([values[port.name] for port in block.settings])
    out = np.empty((len(t_s), 3))
    t_s = np.ascontiguousarray(t_s, float)
    _step_at(block.step.entry, t_s, p, np.empty(0), out.ravel())
    return out


@compiled(types.void(ENTRY, *4 * [VIEW]))
def _step_at(entry: int, t_s: Table, p: Table, nothing: Table, out: Table) -> None:
    none = part(nothing, 0)
    for i in range(len(t_s)):
        call(entry, t_s[i], 1e-3, part(p, 0), none, none, part(out, 3 * i))


def away_from(edges: list[float]) -> Table:
    """Return times of which no finite difference crosses an edge."""
    far = [np.abs(SEEN_S - edge) > 2 * STEP_S for edge in edges]
    return SEEN_S[np.logical_and.reduce(far)] if far else SEEN_S


def test_every_generator_of_the_module_is_tested_here() -> None:
    found = {name for name, value in vars(references).items() if isinstance(value, Block)}
    assert found == set(CASES), found ^ set(CASES)


@pytest.mark.parametrize("name", CASES)
def test_rate_and_acceleration_are_the_derivatives(name: str) -> None:
    t = away_from(CASES[name][1] + CASES[name][2])
    before, now, after = at(name, t - STEP_S), at(name, t), at(name, t + STEP_S)
    for order, what in ((1, "rate"), (2, "acceleration")):
        slope = (after - before)[:, order - 1] / (2 * STEP_S)
        scale = max(1.0, np.abs(now[:, order]).max())
        worst = np.abs(slope - now[:, order]).max() / scale
        assert worst < 1e-7, f"{what}: off by {worst:.1e}"


@pytest.mark.parametrize("name", [name for name in CASES if name != "step"])
def test_the_angle_never_jumps_and_the_rate_only_where_it_says(name: str) -> None:
    edges = np.array(CASES[name][1])
    around = at(name, np.concatenate([edges - 1e-9, edges + 1e-9, SEEN_S, SEEN_S + 1e-9]))
    jumps = []
    for order in (0, 1):
        column = around[:, order]
        e = len(edges)
        jumps.append(np.abs(np.append(column[e : 2 * e] - column[:e], 0.0)))
    steepest, sharpest = np.abs(around[:, 1]).max(), np.abs(around[:, 2]).max()
    assert jumps[0].max() <= 3e-9 * steepest + 1e-15, f"angle jumps by {jumps[0].max():.1e} rad"
    smooth = [i for i, edge in enumerate(edges) if edge not in CASES[name][2]]
    worst = jumps[1][smooth].max(initial=0.0)
    assert worst <= 3e-9 * sharpest + 1e-15, f"rate jumps by {worst:.1e} rad/s"


@pytest.mark.parametrize("name", CASES)
def test_the_angle_is_the_integral_of_the_rate(name: str) -> None:
    t = np.linspace(0.0, 16.0, 160001)
    if name == "step":
        t = t[t > 0.5]
    values = at(name, t)
    integral = np.concatenate([[0.0], np.cumsum(0.5e-4 * (values[1:, 1] + values[:-1, 1]))])
    worst = np.abs(values[:, 0] - values[0, 0] - integral).max()
    assert worst < 1e-6, f"angle and integrated rate differ by {worst:.1e} rad"


@pytest.mark.parametrize("name", CASES)
def test_a_generator_is_a_function_of_time_only(name: str) -> None:
    forward, backward = at(name, SEEN_S), at(name, SEEN_S[::-1])
    assert (forward == backward[::-1]).all() and not getattr(references, name).states


@pytest.mark.parametrize("path", sorted(RIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_reference_starts_at_rest_angle_zero(path: Path) -> None:
    rig = load_rig(path)
    spec = next(s for s in rig.nodes()["executive"].blocks if s.name == "reference")
    y = np.full(3, np.nan)
    p = np.array(list(spec.settings.values()))
    spec.block.step(0.0, 1e-3, p, np.empty(0), np.empty(0), y)
    assert y[0] == 0.0 and np.isfinite(y).all(), y


def test_quintic_is_exactly_at_rest_before_between_and_after_the_moves() -> None:
    values = at("quintic", [0.0, 0.5, 1.1, 2.0, 3.25, 3.85, 1e5])
    assert (values[:, 1:] == 0.0).all(), values
    assert values[:, 0].tolist() == [0.0, 0.0, 0.17, 0.17, 0.17, 0.0, 0.0], values[:, 0]


@DETERMINISTIC
@given(s=st.floats(0.0, 1.0), amplitude=st.floats(-4.0, 4.0), move=st.floats(0.01, 100.0))
def test_quintic_moves_as_the_textbook_polynomial(s: float, amplitude: float, move: float) -> None:
    up, back = 2.0, 500.0
    given = {"amplitude_rad": amplitude, "move_s": move, "up_s": up, "back_s": back}
    t = up + s * move
    s = (t - up) / move
    expected = amplitude * (10 * s**3 - 15 * s**4 + 6 * s**5)
    value = at("quintic", [t], given)[0, 0]
    assert math.isclose(value, expected, rel_tol=1e-12, abs_tol=1e-14), (value, expected)
    half = at("quintic", [up + 0.5 * move], given)[0]
    assert math.isclose(half[0], 0.5 * amplitude, rel_tol=1e-9, abs_tol=1e-15), half
    assert math.isclose(half[1], 1.875 * amplitude / move, rel_tol=1e-9, abs_tol=1e-15), half


def test_bang_bang_has_one_acceleration_and_its_opposite() -> None:
    t = np.linspace(0.0, 2.0, 2001)
    values = at("bang_bang", t)
    peak = 4 * 0.17 / 0.25
    assert set(values[:, 2].tolist()) == {0.0, peak, -peak}, set(values[:, 2].tolist())
    assert at("bang_bang", [0.75])[0, 0] == pytest.approx(0.085, abs=1e-15)
    assert at("bang_bang", [0.75])[0, 1] == pytest.approx(2 * 0.17 / 0.5, abs=1e-15)
    assert (at("bang_bang", [1.0, 1.5, 1e6]) == [0.17, 0.0, 0.0]).all()
    assert (at("bang_bang", [0.0, 0.5]) == 0.0).all()


def test_step_is_there_from_its_time_on() -> None:
    values = at("step", [0.0, np.nextafter(0.5, 0.0), 0.5, 1e6])
    assert values[:, 0].tolist() == [0.0, 0.0, 0.17, 0.17] and (values[:, 1:] == 0.0).all()


def test_sine_has_its_amplitude_frequency_and_sign() -> None:
    values = at("sine", [0.0, 0.5, 1.0, 1.5, 2.0])
    omega = math.pi
    assert np.abs(values[:, 0] - 0.09 * np.array([0, 1, 0, -1, 0])).max() < 1e-16
    assert values[0, 1] == pytest.approx(0.09 * omega, rel=1e-15)
    t = SEEN_S
    v = at("sine", t)
    assert np.abs(v[:, 2] + omega * omega * v[:, 0]).max() < 1e-15
    assert np.abs(v[:, 0] ** 2 + (v[:, 1] / omega) ** 2 - 0.09**2).max() < 1e-16


@given(st.floats(-7.0, 7.0))
@DETERMINISTIC
def test_a_phase_of_the_sine_is_a_shift_in_time(phase: float) -> None:
    given = {"amplitude_rad": 0.09, "frequency_hz": 0.5, "phase_rad": phase}
    t = np.linspace(7.0, 9.0, 21)
    shifted = at("sine", t, given) - at("sine", t + phase / math.pi)
    assert np.abs(shifted).max() < 1e-14, np.abs(shifted).max()


def test_a_sequence_knows_its_neighbours_and_has_the_period_of_its_frequency() -> None:
    p, y = np.array([2.0, 0.5, math.pi / 2]), np.empty((40, 3))
    for k in range(40):
        sequences.sine.step(0.1 * k, 0.1, p, np.empty(0), np.empty(0), y[k])
    wanted = 2.0 * np.cos(0.05 * np.arange(-1, 41))
    for i in range(3):
        assert np.abs(y[:, i] - wanted[i : i + 40]).max() < 1e-14, f"output {i}"


def test_triangle_turns_at_the_end_of_every_leg() -> None:
    corners = at("triangle", [4.0, 8.0, 12.0, 16.0])
    assert (np.abs(corners[:, 1]) == 0.0).all(), corners[:, 1]
    acceleration = 0.003 / 0.1
    assert np.allclose(corners[:, 2], acceleration * np.array([-1, 1, -1, 1]), rtol=1e-12)
    for n in (1, 2, 3):
        rates = at("triangle", [4.0 * n + d for d in (-0.1, -0.05, 0.05, 0.1)])[:, 1]
        sign = 1.0 if n % 2 else -1.0
        expected = sign * 0.003 * np.array([1.0, 0.5, -0.5, -1.0])
        assert np.abs(rates - expected).max() < 1e-14, f"corner {n}: {rates} rad/s"


def test_triangle_climbs_first_at_its_rate_and_waits_before() -> None:
    waiting = at("triangle", np.linspace(0.0, 0.1999, 50))
    assert (waiting == 0.0).all(), np.abs(waiting).max()
    t = np.linspace(0.2, 3.9, 50)
    climbing = at("triangle", t)
    assert np.abs(climbing[:, 0] - 0.003 * (t - 0.2)).max() < 1e-16
    assert (climbing[:, 1] == 0.003).all() and (climbing[:, 2] == 0.0).all()


def test_triangle_swings_between_the_same_two_angles() -> None:
    t = np.linspace(3.0, 100.0, 97001)
    angle = at("triangle", t)[:, 0]
    high, low = 0.003 * (4.0 - 0.2 - 0.05), 0.003 * (0.05 - 0.2)
    assert math.isclose(angle.max(), high, rel_tol=1e-9), f"{angle.max()} rad instead of {high}"
    assert math.isclose(angle.min(), low, rel_tol=1e-9), f"{angle.min()} rad instead of {low}"


def test_ramp_rises_to_its_rate_and_keeps_it() -> None:
    values = at("ramp", [0.0, 0.2, 0.4, 1.0, 101.0])
    assert np.allclose(values[:, 1], [0.0, 0.025, 0.05, 0.05, 0.05], rtol=1e-12)
    assert np.allclose(values[:, 0], [0.0, 0.0025, 0.01, 0.04, 5.04], rtol=1e-12)

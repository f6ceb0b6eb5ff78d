"""The play operator and its inverse: two forms agree, no step size matters, the inverse inverts."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.drivers.compiled.jit import compiled
from pcpc.plants.actuators.backlash import backlash, backlash_inverse

DETERMINISTIC = settings(max_examples=60, derandomize=True, deadline=None)
gaps = st.tuples(st.floats(0.1, 20.0), st.floats(-20.0, -0.1), st.floats(0.2, 5.0))
moves = st.floats(-100.0, 100.0)


@compiled()
def play(tau: float, u: float, d_plus: float, d_minus: float, m: float) -> float:
    return backlash(tau, u, d_plus, d_minus, m)


@compiled()
def inverse(u: float, before: float, w: float, d_plus: float, d_minus: float, m: float) -> float:
    return backlash_inverse(u, before, w, d_plus, d_minus, m)


def by_rate(tau: float, path: np.ndarray, d_plus: float, d_minus: float, m: float) -> float:
    """Integrate tau' = m u' in contact, 0 in the gap, by Euler over the small moves of `path`."""
    for before, u in pairwise(path):
        up = u > before and tau <= m * (before - d_plus) + 1e-9
        down = u < before and tau >= m * (before - d_minus) - 1e-9
        tau += m * (u - before) if up or down else 0.0
    return tau


@given(gaps, st.lists(moves, min_size=2, max_size=6), st.floats(-1.0, 1.0))
@DETERMINISTIC
def test_the_clip_is_the_rate_equation(
    gap: tuple[float, float, float], turns: list[float], where: float
) -> None:
    d_plus, d_minus, m = gap
    middle, half = 0.5 * (d_plus + d_minus), 0.5 * (d_plus - d_minus)
    tau = fine = m * (turns[0] - middle + where * half)
    euler = 1e-6
    for begin, end in pairwise(turns):
        tau = play(tau, end, *gap)
        fine = by_rate(fine, np.linspace(begin, end, 301), *gap)
        euler = max(euler, 1.01 * m * abs(end - begin) / 300)  # contact begins within a step
        assert abs(tau - fine) < euler, f"{tau} by clip, {fine} by rate"


@given(gaps, moves, moves, st.floats(-60.0, 60.0))
@DETERMINISTIC
def test_a_monotone_move_in_one_step_is_that_in_a_thousand(
    gap: tuple[float, float, float], begin: float, end: float, tau: float
) -> None:
    at_once = play(play(tau, begin, *gap), end, *gap)
    bit_by_bit = play(tau, begin, *gap)
    for u in np.linspace(begin, end, 1000):
        bit_by_bit = play(bit_by_bit, u, *gap)
    assert at_once == bit_by_bit, f"{at_once} in one step, {bit_by_bit} in 1000"


@given(gaps, st.lists(moves, min_size=2, max_size=30))
@DETERMINISTIC
def test_the_inverse_gives_what_was_asked_for(
    gap: tuple[float, float, float], wanted: list[float]
) -> None:
    u, tau = wanted[0] / gap[2] + gap[0], wanted[0]
    for before, w in pairwise(wanted):
        u = inverse(u, before, w, *gap)
        tau = play(tau, u, *gap)
        assert tau == pytest.approx(w, abs=1e-9), f"{tau} for {w}"


def test_a_held_command_changes_nothing_more() -> None:
    tau = play(0.0, 30.0, 10.0, -10.5, 1.0)
    assert tau == play(tau, 30.0, 10.0, -10.5, 1.0) == 20.0, f"{tau} N m"


def test_the_gap_swallows_a_turn_of_less_than_its_width() -> None:
    tau = play(0.0, 30.0, 10.0, -10.5, 1.0)
    assert play(tau, 9.6, 10.0, -10.5, 1.0) == tau, "moved inside the gap"
    assert play(tau, 9.4, 10.0, -10.5, 1.0) < tau, "did not move beyond the gap"

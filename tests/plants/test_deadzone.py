"""The deadzone as an actuator: its two forms, its inverse, what stays bounded."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.plants.actuators.deadzone import deadzone, deadzone_inverse, output_estimate

DETERMINISTIC = settings(max_examples=300, derandomize=True, deadline=None)
width = st.floats(0.0, 100.0)
slope = st.floats(0.01, 100.0)
value = st.floats(-1e4, 1e4)
output = st.floats(-1e3, 1e3, allow_subnormal=False)  # their quotients are not exact to an ulp
width_10 = st.floats(0.0, 10.0)
BOOK = (25.0, 20.0, 1.5, 0.8)


def by_branches(u: float, d_plus: float, d_minus: float, m_plus: float, m_minus: float) -> float:
    if u >= d_plus:
        return m_plus * (u - d_plus)
    return m_minus * (u + d_minus) if u <= -d_minus else 0.0


@DETERMINISTIC
@given(value, width, width, slope, slope)
def test_the_form_with_a_saturation_is_the_form_with_branches(
    u: float, d_plus: float, d_minus: float, m_plus: float, m_minus: float
) -> None:
    found = deadzone(u, d_plus, d_minus, m_plus, m_minus)
    expected = by_branches(u, d_plus, d_minus, m_plus, m_minus)
    assert found == expected, f"{found} against {expected} at u = {u}"


@DETERMINISTIC
@given(output, width_10, width_10, slope, slope)
def test_the_deadzone_gives_back_what_went_into_its_inverse(
    w: float, d_plus: float, d_minus: float, m_plus: float, m_minus: float
) -> None:
    found = deadzone(
        deadzone_inverse(w, d_plus, d_minus, m_plus, m_minus), d_plus, d_minus, m_plus, m_minus
    )
    # u = w/m + d is rounded once and d is taken off again: half an ulp of u, times the slope
    m, d = (m_plus, d_plus) if w > 0.0 else (m_minus, d_minus)
    allowed = 1e-15 * (2.0 * abs(w) + m * d)
    assert abs(found - w) <= allowed, f"{found - w:.1e} at w = {w}, allowed {allowed:.1e}"


@pytest.mark.parametrize(("u", "tau"), [(-30.0, -8.0), (-20.0, 0.0), (25.0, 0.0), (35.0, 15.0)])
def test_the_books_deadzone_is_continuous_at_its_edges(u: float, tau: float) -> None:
    assert deadzone(u, *BOOK) == pytest.approx(tau, abs=1e-14), deadzone(u, *BOOK)
    jump = abs(deadzone(u + 1e-9, *BOOK) - deadzone(u - 1e-9, *BOOK))
    assert jump < 4e-9, f"a jump of {jump:.1e} at {u}"


def test_only_the_saturation_is_bounded_where_the_slope_is_not_one() -> None:
    u = np.linspace(-1e4, 1e4, 2001)
    tau = np.array([deadzone(float(v), *BOOK) for v in u])
    second_path = u - tau / np.where(u > 0.0, 1.5, 0.8)
    assert np.abs(second_path).max() <= 25.0 + 1e-9, np.abs(second_path).max()
    assert np.abs(u - tau).max() > 1000.0, np.abs(u - tau).max()


@DETERMINISTIC
@given(output, width_10, width_10, slope, slope)
def test_behind_an_output_deadzone_all_is_known_outside_the_band_and_inside_only_the_band(
    y: float, d_plus: float, d_minus: float, m_plus: float, m_minus: float
) -> None:
    shape = (d_plus, d_minus, m_plus, m_minus)
    z = deadzone(y, *shape)
    found = output_estimate(z, *shape)
    if z == 0.0:
        assert abs(found - y) <= 0.5 * (d_plus + d_minus) * (1.0 + 1e-15), (found, y)
        assert deadzone(found, *shape) == 0.0
    else:
        assert abs(found - y) <= 4e-16 * (abs(y) + abs(found)), f"{found - y:.1e} at y = {y}"


def test_no_estimate_from_an_output_deadzone_is_better_than_the_centre_of_its_band() -> None:
    band = np.linspace(-20.0, 25.0, 4501)
    assert not np.any([deadzone(float(y), *BOOK) for y in band]), "the band is told apart"
    worst = {guess: float(np.abs(band - guess).max()) for guess in np.linspace(-20.0, 25.0, 91)}
    best = output_estimate(0.0, *BOOK)
    assert best == 2.5 and worst[best] == min(worst.values()) == 22.5, worst[best]


def test_the_two_inverses_differ_in_the_band_alone() -> None:
    z = np.concatenate((-np.logspace(-9, 3, 50), np.logspace(-9, 3, 50)))
    for value in map(float, z):
        assert output_estimate(value, *BOOK) == deadzone_inverse(value, *BOOK), value
    assert deadzone_inverse(0.0, *BOOK) == 0.0

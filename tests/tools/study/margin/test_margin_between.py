"""What lies between the lines of a measured loop: exact loops with resonances, and their errors."""

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pcpc.tools.study.arrays import Complex, Vector
from pcpc.tools.study.margin import notes
from pcpc.tools.study.margin.between import between, lies_between, likeliest
from pcpc.tools.study.margin.margins import Margins, margins
from pcpc.tools.study.margin.measured import multisine
from pcpc.tools.study.margin.visible import (
    UNSURE,
    Unsure,
    _unsure,
    visible_margins,
    without_below,
)

RATE_HZ = 1000.0
LINES = multisine(RATE_HZ, RATE_HZ / 4000.0, 1.0, 1).lines * RATE_HZ / 4000.0
NAMES = ("gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin", "sensitivity_peak")


def loop(f_hz: Vector, mode_hz: float, damping: float, size: float) -> Complex:
    """Return a mass behind 3 ms under PD, with a flexible mode: L at f."""
    s = 2j * np.pi * f_hz
    w = 2.0 * np.pi * mode_hz
    plant = 1.0 / (s * (s + 0.5)) + size / (s**2 + 2.0 * damping * w * s + w**2)
    return np.asarray(40.0 * (s + 20.0) * plant * np.exp(-3e-3 * s))


def true_margins(mode_hz: float, damping: float, size: float) -> Margins:
    near = mode_hz * (1.0 + np.linspace(-0.2, 0.2, 2001))
    f = np.unique(np.concatenate((np.geomspace(LINES[0], LINES[-1], 3000), near)))
    return margins(f, loop(f, mode_hz, damping, size), RATE_HZ)


@pytest.mark.parametrize("mode_hz", [21.3, 45.7, 48.0, 90.1, 133.0])
@pytest.mark.parametrize("damping", [0.005, 0.02])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_no_margin_beside_a_resonance_is_wrong(
    mode_hz: float, damping: float, noise: float
) -> None:
    """The lines do not know of it; within 3 % or, with noise, not measured."""
    about = mode_hz, damping, 0.3
    true, rng = true_margins(*about), np.random.default_rng(1)
    g = 1.0 / (1.0 + loop(LINES, *about)) - 1.0
    g += noise * np.array([1.0, 1j]) @ rng.standard_normal((2, len(g))) / math.sqrt(2.0)
    own, unsure = visible_margins(LINES, -g / (1.0 + g), np.full(len(g), noise), RATE_HZ)
    assert noise or not unsure
    for name in NAMES:
        seen, exact = getattr(own, name), getattr(true, name)
        assert (
            math.isnan(seen)
            if noise and math.isnan(seen)
            else (seen == pytest.approx(exact, rel=0.03))
        ), (name, seen, exact)
    assert noise or not math.isnan(own.disk_margin)


@pytest.mark.parametrize("every", [6, 8, 9, 10, 12])
@pytest.mark.parametrize("about", [(45.7, 0.005, 1.0), (45.7, 0.02, 0.3), (21.3, 0.005, 0.3)])
def test_what_turns_where_no_line_is_has_no_number(
    every: int, about: tuple[float, float, float]
) -> None:
    """Of 7 to 14 lines none shows a mode; that others meet them no worse says so."""
    few = LINES[::every]
    own, unsure = visible_margins(few, loop(few, *about), np.zeros(len(few)), RATE_HZ)
    true = true_margins(*about)
    assert unsure and all("turns between two lines" in one.why for one in unsure)
    for one in unsure:
        assert math.isnan(getattr(own, one.name)), one
    for name in NAMES:
        seen = getattr(own, name)
        assert math.isnan(seen) or seen == pytest.approx(getattr(true, name), rel=0.05), name


@pytest.mark.parametrize("gain", [0.02, 0.2, 1.8])
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_a_loop_that_is_negative_at_half_the_rate_alone_has_that_margin(
    gain: float, noise: float
) -> None:
    """L = k/(z - 0.9): the margin 1.9/k lies behind the last line, and is no `any`."""
    found, rng = gain / (np.exp(2j * np.pi * LINES / RATE_HZ) - 0.9), np.random.default_rng(1)
    g = 1.0 / (1.0 + found) - 1.0
    g += noise * np.array([1.0, 1j]) @ rng.standard_normal((2, len(g))) / math.sqrt(2.0)
    own, _ = visible_margins(LINES, -g / (1.0 + g), np.full(len(g), noise), RATE_HZ)
    unknown = noise > 0.0 and math.isnan(own.gain_margin)
    assert unknown or own.gain_margin == pytest.approx(1.9 / gain, rel=0.02), own
    assert noise or own.gain_margin_hz == pytest.approx(0.5 * RATE_HZ)
    band = LINES < 0.3 * RATE_HZ
    some = between(LINES[band], found[band], np.zeros(band.sum()), RATE_HZ)
    assert some.f_hz[-1] == pytest.approx(LINES[band][-1]), "far from there nothing is known of it"


def test_noise_that_moves_a_margin_leaves_it_unknown() -> None:
    g, rng = 1.0 / (1.0 + loop(LINES, 45.7, 0.02, 0.3)) - 1.0, np.random.default_rng(1)
    g += 0.01 * np.array([1.0, 1j]) @ rng.standard_normal((2, len(g))) / math.sqrt(2.0)
    own, unsure = visible_margins(LINES, -g / (1.0 + g), np.full(len(g), 0.01), RATE_HZ)
    assert {one.name for one in unsure if "noise" in one.why} >= {"gain_margin", "delay_margin_s"}
    assert all(math.isnan(getattr(own, one.name)) for one in unsure)
    assert math.isnan(own.delay_margin_samples) and math.isnan(own.crossover_hz)


@pytest.mark.parametrize(
    ("one", "other", "is_unsure"),
    [
        (math.inf, math.inf, False),
        (math.inf, 2.0, True),
        (2.0, math.inf, True),
        (2.0, 2.0 * (1.0 + 0.9 * UNSURE), False),
        (2.0, 2.0 * (1.0 - 1.1 * UNSURE), True),
        (2.0, math.nan, True),
        (math.nan, 2.0, False),
    ],
)
def test_a_number_is_unsure_if_another_curve_has_another(
    one: float, other: float, is_unsure: bool
) -> None:
    own = true_margins(45.7, 0.02, 0.3)
    pair = [replace(own, gain_margin=value) for value in (one, other)]
    assert _unsure(*pair) == ["gain_margin"] * is_unsure


@pytest.mark.parametrize("apart", [2.2e-16, 1e-13, 1e-10])
def test_two_frequencies_that_differ_by_rounding_are_one(apart: float) -> None:
    """Resonances and lines may meet: no slope is known there, and no number is lost by it."""
    f = np.geomspace(LINES[0], LINES[-1], 800)
    twice = np.unique(np.append(f, f[::7] * (1.0 + apart)))
    assert len(twice) > len(f)
    own, other = (margins(one, loop(one, 45.7, 0.02, 0.3), RATE_HZ) for one in (f, twice))
    for name in NAMES:
        assert getattr(other, name) == pytest.approx(getattr(own, name), rel=1e-6), name


def test_a_rational_function_is_found_again() -> None:
    z = np.exp(2j * np.pi * LINES / RATE_HZ)
    g = (0.2 * z + 0.1) / (z**2 - 1.2 * z + 0.5)
    first, *more = likeliest(z, g, np.full(len(z), 1e-9))
    at = np.exp(2j * np.pi * np.geomspace(LINES[0], LINES[-1], 500) / RATE_HZ)
    exact = (0.2 * at + 0.1) / (at**2 - 1.2 * at + 0.5)
    assert len(first.at) == 3 and np.abs(first(at) - exact).max() < 1e-8
    assert first.off <= 1.0 and 0 < len(more) <= 2
    assert np.abs(first(z) - g).max() < 1e-9, "also on a line that it goes through"


def test_between_goes_through_the_lines_and_says_which_gaps_count() -> None:
    own = between(LINES, loop(LINES, 45.7, 0.02, 0.3), np.zeros(len(LINES)), RATE_HZ)
    assert not own.moved and len(own.f_hz) == 30 * (len(LINES) - 1) + 2
    assert own.f_hz[-1] == 0.5 * RATE_HZ, "as near to the last line as that to the one before"
    assert own.response[-1].imag == 0.0
    at = own.response[:-1:30] / loop(LINES, 45.7, 0.02, 0.3)
    assert np.abs(at - 1.0).max() < 3e-3
    flags = np.array([True, False, True, True])
    places = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0])
    found = lies_between(places, np.array([1.0, 2.0, 3.0, 4.0]), flags)
    assert found.tolist() == [True, False, False, False, True, True, True]


@pytest.mark.parametrize(("at_hz", "factor", "known"), [
    (0.1, 2.0, False), (0.3, 2.0, True), (0.3, 1.01, False), (499.9, 2.0, False),
])  # fmt: skip
@pytest.mark.parametrize(("name", "ours", "seen"), [
    ("gain_reduction", 0.14, 0.0), ("sensitivity_peak", 2.06, 1.06),
])  # fmt: skip
def test_what_is_worse_where_no_line_is_was_not_measured(
    name: str, ours: float, seen: float, at_hz: float, factor: float, known: bool
) -> None:
    """The linear loop knows of it below the lowest line, or between two lines that are its own."""
    true = replace(true_margins(45.7, 0.02, 0.3), disk_margin=math.nan)
    linear_one = replace(true, **{name: ours, f"{name}_hz": at_hz})
    lines = replace(true, **{name: seen, f"{name}_hz": math.nan})
    own: Any = SimpleNamespace(f_hz=LINES, response=LINES + 0j, error=0.0 * LINES, amplitude=1.0)
    told, _ = notes.comparison(linear_one, own, lines, factor * own.response)
    assert math.isnan(getattr(told, name)) != known
    late = replace(true, delay_margin_s=math.inf, delay_margin_samples=math.inf)
    early = replace(true, delay_margin_s=1.0, crossover_hz=at_hz)
    told, _ = notes.comparison(early, own, late, factor * own.response)
    assert math.isnan(told.delay_margin_s) == math.isnan(told.delay_margin_samples) != known
    same, _ = notes.comparison(linear_one, own, linear_one, factor * own.response)
    assert getattr(same, name) == ours, "seen as the linear loop has it"


def test_what_is_not_known_is_said_with_its_reason() -> None:
    some = [Unsure("gain_margin", 45.2, "a"), Unsure("delay_margin_s", 45.2, "a")]
    one, two = notes.unsure_notes([*some, Unsure("disk_margin", math.nan, "b")])
    assert (
        f"gain margin, delay margin: not known within {100 * UNSURE:g} %, as a, about 45.2" in one
    )
    assert "disk margin: not known within" in two and "about" not in two


PEAKS, CROSSES = "disk_margin sensitivity_peak", "phase_margin_deg delay_margin_s"


def flip(s: Complex, at_per_s: float) -> Complex:
    """Return 1 at low frequencies and -1 at high ones, of size 1 at all."""
    return np.asarray((1.0 - s / at_per_s) / (1.0 + s / at_per_s))


W = 2.0 * np.pi * 0.05  # rad/s, a fifth of the lowest line


@pytest.mark.parametrize(
    ("of", "hidden"),
    [
        (lambda s: 0.5 + 0.0 * s, ""),
        (lambda s: 3.0 / (1.0 + 0.01 * s), ""),
        (lambda s: 40.0 * (s + 20.0) / (s * (s + 0.5)), "gain_reduction"),
        (lambda s: 9.0 / (1.0 + 5.0 * s / W), f"{CROSSES} gain_margin gain_reduction {PEAKS}"),
        (lambda s: 9.0 * (1.0 + s / W) / (1.0 + 5.0 * s / W) ** 2 - 0.1 * s / (s + 400.0),
         f"{CROSSES} gain_reduction {PEAKS}"),
        (lambda s: -4.0 / (1.0 + 0.5 * s / W) - 0.2 * s / (s + 400.0), f"gain_reduction {PEAKS}"),
        (lambda s: 4.0 * (s + W) ** 2 / s**3 / (1.0 + 0.01 * s), "gain_reduction disk_margin"),
        (lambda s: 0.9 * (s / (s + W)) ** 3, f"gain_margin {PEAKS}"),
        (lambda s: -0.6 / (1.0 + s / W), f"{CROSSES} gain_margin gain_reduction {PEAKS}"),
        (lambda s: 0.4 * s / (s + 400.0), "gain_margin"),
        (lambda s: 40.0 * (s + 20.0) / s**2, "gain_reduction"),
        (lambda s: 4000.0 * (s + 60.0 * W) ** 2 / s**3, ""),
        (lambda s: 0.4 * s / (s + 4.0) * flip(s, 600.0), ""),
        (lambda s: -3.0 * flip(s, 0.4 * W) / (1.0 + 0.51 * s / W), f"gain_reduction {PEAKS}"),
        (lambda s: 3.0 * (s / (s + W)) ** 3, f"{CROSSES} gain_margin gain_reduction {PEAKS}"),
    ],
)  # fmt: skip
def test_a_number_that_a_crossing_below_the_lines_may_change_is_not_known(
    of: Callable[[Complex], Complex], hidden: str
) -> None:
    """By lines alone. What is printed is true from a thirtieth of them on, too."""

    def response(f_hz: Vector) -> Complex:
        return of(2j * RATE_HZ * np.tan(np.pi * f_hz / RATE_HZ))  # bilinear: real at half the rate

    seen, _ = visible_margins(LINES, response(LINES), np.zeros(len(LINES)), RATE_HZ)
    own, unsure = without_below(seen, LINES, response(LINES))
    wide = np.geomspace(0.03 * LINES[0], 0.5 * RATE_HZ, 20_000)
    true = margins(wide, response(wide), RATE_HZ)
    assert {one.name for one in unsure} == set(hidden.split())
    for name in (*NAMES, "gain_reduction"):
        value = getattr(own, name)
        assert math.isnan(value) == (name in hidden.split()), name
        assert math.isnan(value) or value == pytest.approx(getattr(true, name), rel=0.03), name
    assert all("at the lowest line" in line for line in notes.unsure_notes(unsure))

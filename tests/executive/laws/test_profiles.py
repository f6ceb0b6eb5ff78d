"""References of any unit: their closed forms, derivatives and joins."""

import math
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pcpc.executive.laws import profiles, references
from pcpc.executive.laws.block import Block

Table = NDArray[np.float64]
TIMES = np.unique(np.append(np.random.default_rng(3).uniform(0.0, 8.0, 400), np.arange(0, 8, 0.25)))
SEQUENCE = {
    "begin": 0.1, "start_s": 0.5,
    "over_1_s": 0.25,
    "to_2": 0.4, "over_2_s": 1.0, "shape_2": 3.0,
    "to_3": -0.2, "over_3_s": 0.5, "shape_3": 2.0,
    "to_4": 0.3, "over_4_s": 0.25, "shape_4": 1.0,
    "to_5": 0.0, "over_5_s": 1.0, "shape_5": 3.0,
}  # fmt: skip
# name: (settings, times at which the rate or the acceleration jumps)
CASES: dict[str, tuple[dict[str, float], list[float]]] = {
    "step": ({"amplitude": 0.2, "start_s": 0.5, "offset": 0.3}, [0.5]),
    "ramp": ({"slope": -0.4, "start_s": 0.5, "end_s": 3.0, "offset": 1.0}, [0.5, 3.0]),
    "sine": ({"amplitude": 0.2, "frequency_hz": 0.7, "start_s": 0.5, "phase_rad": 0.3}, [0.5]),
    "chirp": (
        {"amplitude": 0.2, "from_hz": 0.1, "to_hz": 2.0, "sweep_s": 5.0, "start_s": 0.5},
        [0.5, 5.5],
    ),
    "quintic": ({"amplitude": 0.2, "move_s": 0.6, "start_s": 0.5, "back_s": 3.0}, []),
    "sequence": (SEQUENCE, [0.5, 0.75, 1.75, 2.25, 2.5, 3.5]),
}


def at(
    name: str,
    times: Table | list[float],
    given: Mapping[str, float] | None = None,
) -> Table:
    """Return value, rate and acceleration at these times, (n, 3)."""
    block: Block = getattr(profiles, name)
    values = CASES[name][0] if given is None else given
    names = [(one, port.default) for port in block.settings for one in port.names()]
    p = np.array([values.get(one, default) for one, default in names], float)
    out, none = np.empty((len(times), 3)), np.zeros(1)
    for row, t in zip(out, times, strict=True):
        block.step(float(t), 1e-3, p, none, none, row)
    return out


def test_every_generator_of_the_module_is_tested_here() -> None:
    found = {name for name, value in vars(profiles).items() if isinstance(value, Block)}
    assert found == set(CASES)


@pytest.mark.parametrize("name", CASES)
def test_rate_and_acceleration_are_the_derivatives(name: str) -> None:
    h = 1e-5
    edges = CASES[name][1] + ([0.5, 1.1, 3.0, 3.6] if name == "quintic" else [])
    far = [t for t in TIMES if t > h and all(abs(t - edge) > 2 * h for edge in edges)]
    before, now, after = (at(name, [t + d for t in far]) for d in (-h, 0.0, h))
    for order in (1, 2):
        slope = (after - before)[:, order - 1] / (2 * h)
        scale = max(1.0, np.abs(now[:, order]).max())
        assert np.abs(slope - now[:, order]).max() / scale < 1e-6, order


@pytest.mark.parametrize("name", CASES)
def test_a_campaign_can_run_it_in_lanes(name: str) -> None:
    assert getattr(profiles, name).step.entry_of_lanes


def test_step_and_ramp_are_their_closed_forms() -> None:
    expected = np.where(TIMES >= 0.5, 0.5, 0.3)
    np.testing.assert_array_equal(at("step", TIMES)[:, 0], expected)
    ramp = at("ramp", TIMES)
    np.testing.assert_allclose(ramp[:, 0], 1.0 - 0.4 * (np.clip(TIMES, 0.5, 3.0) - 0.5), atol=1e-15)
    np.testing.assert_array_equal(ramp[:, 1], np.where((TIMES >= 0.5) & (TIMES < 3.0), -0.4, 0.0))
    assert not at("step", TIMES)[:, 1:].any() and not ramp[:, 2].any()
    early = at("ramp", [0.0, 2.0, 9.0], {"slope": 1.0, "start_s": 2.0, "end_s": 1.0})
    assert not early.any(), "an end before the start is no motion"


def test_a_step_begins_at_the_cycle_of_its_time() -> None:
    for k in range(1, 3000):
        values = at("step", [k * 0.001], {"amplitude": 1.0, "start_s": k / 1000})
        assert values[0, 0] == 1.0, k


def test_sine_and_chirp_have_the_phase_of_their_closed_forms() -> None:
    s = np.where(TIMES >= 0.5, TIMES - 0.5, np.nan)
    waits, (sine, chirp) = TIMES < 0.5, (at(name, TIMES) for name in ("sine", "chirp"))
    assert not sine[waits].any() and not chirp[waits].any()
    np.testing.assert_allclose(
        sine[~waits, 0], (0.2 * np.sin(2 * np.pi * 0.7 * s + 0.3))[~waits], atol=1e-15
    )
    phase = 2 * np.pi * (0.1 * s + 1.9 * s * s / (2 * 5.0))
    whole = 2 * np.pi * (0.1 * 5 + 1.9 * 5 / 2)
    phase = np.where(s > 5.0, whole + 2 * np.pi * 2.0 * (s - 5.0), phase)
    np.testing.assert_allclose(chirp[~waits, 0], 0.2 * np.sin(phase)[~waits], atol=1e-13)
    hz = np.clip(0.1 + 1.9 * s / 5.0, 0.1, 2.0)
    expected = 0.2 * 2 * np.pi * hz * np.cos(phase)
    np.testing.assert_allclose(chirp[~waits, 1], expected[~waits], atol=1e-12)


def test_a_fast_sine_is_a_number_after_days() -> None:
    fast = {"amplitude": 1.0, "frequency_hz": 1e4}
    values = at("sine", [999_999.00001, 999_999.000025], fast)
    assert values[0, 0] == pytest.approx(math.sin(0.2 * math.pi), abs=1e-5)
    assert values[1, 0] == pytest.approx(1.0, abs=1e-8)


@settings(max_examples=100, derandomize=True, deadline=None)
@given(s=st.floats(0.0, 1.0), amplitude=st.floats(-4.0, 4.0), move=st.floats(0.01, 100.0))
def test_quintic_has_the_bits_of_that_in_rad(s: float, amplitude: float, move: float) -> None:
    t = 2.0 + s * move
    mine = {"amplitude": amplitude, "move_s": move, "start_s": 2.0, "back_s": 500.0}
    theirs, none = np.empty(3), np.zeros(1)
    p = np.array([amplitude, move, 2.0, 500.0])
    references.quintic.step(t, 1e-3, p, none, none, theirs)
    np.testing.assert_array_equal(at("quintic", [t], mine)[0], theirs)


@pytest.mark.parametrize("name", ["quintic", "sequence"])
def test_a_quintic_begins_and_ends_without_rate_and_acceleration(name: str) -> None:
    begin, end, value = (0.5, 1.1, 0.2) if name == "quintic" else (0.75, 1.75, 0.4)
    times = [begin, end] if name == "quintic" else [begin, end - 1e-8]
    values = at(name, times)
    assert np.abs(values[:, 1:]).max() < 1e-6
    assert values[:, 0] == pytest.approx([0.0 if name == "quintic" else 0.1, value], abs=1e-12)


def test_segments_join_where_the_last_one_ended() -> None:
    joins = {0.5: 0.1, 0.75: 0.1, 1.75: 0.4, 2.25: -0.2, 2.5: 0.3, 3.5: 0.0}
    for t, value in joins.items():
        before, now = at("sequence", [t - 1e-7, t])[:, 0]
        assert now == pytest.approx(0.3 if t == 2.25 else value, abs=1e-15), t
        assert before == pytest.approx(0.1 if t == 0.5 else value, abs=1e-6), t
    assert at("sequence", [0.0])[0].tolist() == [0.1, 0.0, 0.0]
    assert at("sequence", [100.0])[0].tolist() == [0.0, 0.0, 0.0], "the last value stays"
    middle = at("sequence", [1.25, 2.0])
    assert middle[0, 0] == pytest.approx(0.25) and middle[0, 1] == pytest.approx(1.875 * 0.3)
    assert middle[1].tolist() == pytest.approx([0.1, -1.2, 0.0])


def test_a_sequence_that_repeats_has_the_period_of_its_segments() -> None:
    again = SEQUENCE | {"repeat": 1.0, "begin": 0.0}
    times = [0.5 + 0.013 * k for k in range(230)]
    first = at("sequence", times, again)
    for rounds in (1, 2, 7):
        later = at("sequence", [t + 3.0 * rounds for t in times], again)
        np.testing.assert_allclose(later, first, atol=1e-9)
    assert not at("sequence", [0.2], again).any()
    assert not at("sequence", [5.0], {"repeat": 1.0}).any(), "no segment"


def test_a_full_sequence_and_moves_without_time_are_finite() -> None:
    full = {
        f"{what}_{i}{end}": value
        for i in range(1, 17)
        for what, end, value in (("to", "", float(i)), ("over", "_s", 0.0), ("shape", "", 3.0))
    }
    assert at("sequence", [0.0, 5.0], full).tolist() == [[16.0, 0.0, 0.0]] * 2
    full |= {f"over_{i}_s": 0.5 for i in range(1, 17)}
    assert at("sequence", [7.75, 8.0], full)[:, 0] == pytest.approx([15.5, 16.0])

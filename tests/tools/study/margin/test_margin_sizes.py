"""`pcpc margin` of rigs that are not linear: what is measured is the answer to what is small."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pcpc
from pcpc.tools.study.margin import find, notes, sizes
from pcpc.tools.study.margin.book._linear_rig import PLANTS, RATE_HZ
from pcpc.tools.study.margin.margins import Margins, margins
from pcpc.tools.study.margin.sizes import MeasuredMargins

NAMES = ("gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin", "sensitivity_peak")
FAST = {"settle_s": 2.0, "lowest_hz": 0.5, "method": "measured"}


def exact(name: str) -> Margins:
    f = np.geomspace(0.1, 0.4999 * RATE_HZ, 20_000)
    return margins(f, PLANTS[name].loop(f), RATE_HZ)


@pytest.mark.parametrize("name", ["lag", "resonant"])
@pytest.mark.parametrize("soft", [1.0, 37.0, 1e3, 1e5])
def test_a_plant_that_saturates_softly_has_the_margins_of_its_small_answer(
    name: str, soft: float, tmp_path: Path
) -> None:
    """The command may be a million: of it 2 % are far beyond what such a plant takes."""
    path, true = PLANTS[name].write(tmp_path, soft=soft), exact(name)
    found = pcpc.margin(path, **FAST)  # type: ignore[arg-type]
    for what in NAMES:
        assert getattr(found, what) == pytest.approx(getattr(true, what), rel=0.03), what


@pytest.mark.parametrize(("soft", "known"), [(1e3, True), (20.0, False)])
def test_a_size_that_is_asked_for_stays_and_is_checked_by_its_half(
    soft: float, known: bool, tmp_path: Path
) -> None:
    path, true = PLANTS["lag"].write(tmp_path, soft=soft), exact("lag")
    found = pcpc.margin(path, amplitude=10.0, **FAST)  # type: ignore[arg-type]
    assert found.amplitude == pytest.approx(10.0)
    seen = [getattr(found, what) for what in NAMES]
    assert known != any(map(math.isnan, seen))
    assert known != any(sizes.HALF in note for note in found.notes)
    for what, value in zip(NAMES, seen, strict=True):
        assert math.isnan(value) or value == pytest.approx(getattr(true, what), rel=0.05), what


@pytest.mark.parametrize("parameter", ["slack", "gap"])
def test_a_dead_zone_or_play_of_the_size_of_the_injection_leaves_no_margin(
    parameter: str, tmp_path: Path
) -> None:
    path = PLANTS["lag"].write(tmp_path, **{parameter: 4.0})
    with pytest.raises(pcpc.Error, match=r"no margin is known: half|does not answer|hides"):
        pcpc.margin(path, amplitude=10.0, **FAST)  # type: ignore[arg-type]


NAN = math.nan
STUCK = "CMD.command has no effect on itself"
OTHER = (
    "measured: gain margin, phase margin, delay margin, sensitivity peak, disk margin: those of 10,"
)


@pytest.mark.parametrize(
    ("parameters", "amplitude", "at_s", "measured", "both"),
    [
        ({}, 200.0, 0.0, "", ""),
        ({"slack": 0.05}, 10.0, 1.0, "", ""),  # it rests beside the dead zone
        ({"gap": 0.05}, 200.0, 0.0, STUCK, "at an amplitude of 200; the smaller one counts"),
        ({"slack": 0.05}, 200.0, 0.0, STUCK, ""),
        ({"relay": -0.05}, 10.0, 0.0, "the closed loop is unstable", "is unstable"),
        ({"bend": 0.3}, 10.0, 1.0, OTHER, "at an amplitude of 10; the smaller one counts"),
    ],
)
def test_numbers_of_an_amplitude_at_which_a_rig_is_not_linear_are_said_to_be_its_own(
    parameters: dict[str, float],
    amplitude: float,
    at_s: float,
    measured: str,
    both: str,
    tmp_path: Path,
) -> None:
    """Half of a large injection agrees with it, and shows a loop without a gap."""
    path = PLANTS["lag"].write(tmp_path, **parameters)
    for method, said in (("measured", measured), ("both", both)):
        about = FAST | {"method": method, "amplitude": amplitude, "at_s": at_s}
        one = pcpc.margin(path, **about)  # type: ignore[arg-type]
        assert one.measured is not None and math.isfinite(one.measured.margins.gain_margin)
        assert said in "; ".join(one.notes)
        its_own = [note for note in one.notes if f"those of {amplitude:g}" in note]
        at_rest = measured in ("", OTHER)
        assert len(its_own) == (not at_rest or (method, said) == ("measured", OTHER)), one.notes
        assert all(("no stable linear loop at rest" in note) != at_rest for note in its_own)
        assert all(note.endswith("at rest") == (one.linearised is not None) for note in its_own)


@pytest.mark.parametrize(
    ("seen", "ours", "off", "is_told"),
    [
        ((2.0, 10.0), (3.0, 10.0), 0.2, True),
        ((2.0, 10.0), (2.07, 10.0), 0.2, False),  # as good as the same
        ((2.0, 10.0), (3.0, 10.0), 0.055, False),  # within the error of L there
        ((2.0, 10.0), (3.0, 10.0), 0.065, True),
        ((2.0, 10.0), (3.0, 0.5), 0.2, False),  # where no line lies
        ((2.0, 10.0), (3.0, 200.0), 0.2, False),
        ((math.inf, math.nan), (3.0, 10.0), 0.2, True),
        ((2.0, 10.0), (math.inf, math.nan), 0.2, True),
        ((math.nan, math.nan), (3.0, 10.0), 0.2, False),
    ],
)
def test_which_numbers_are_those_of_an_amplitude_alone(
    seen: tuple[float, float], ours: tuple[float, float], off: float, is_told: bool
) -> None:
    f = np.geomspace(1.0, 100.0, 21)
    own: Any = SimpleNamespace(f_hz=f, response=np.full(21, 1.0 + off), amplitude=5.0)
    own.error = np.full(21, 0.01)
    small: Any = SimpleNamespace(response=np.ones_like)
    cut: Any = SimpleNamespace(unit="N m")
    both = [
        replace(Margins(*[NAN] * 12), gain_margin=a, gain_margin_hz=at) for a, at in (seen, ours)
    ]
    found = notes.other_small_loop(own, cut, both[0], both[1], small)
    assert [note[:40] for note in found] == ["measured: gain margin: those of 5 N m, w"] * is_told


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (0.02, "3 lines from 1 Hz on are too few"),
        (
            0.021,
            r"nonlinearity moves L by up to 2.1 % at 5 N m, so that no margin is known; by its",
        ),
        (0.1, "nonlinearity moves L by up to 10 % at 5 N m"),
        (0.101, "nonlinearity hides 1 of 3 lines at 5 N m, and with them every margin"),
    ],
)
def test_why_no_margin_is_known_is_the_real_reason(error: float, why: str) -> None:
    still = SimpleNamespace(rms=0.0, at_limit=0.0, cycles=False)
    loop: Any = SimpleNamespace(f_hz=np.array([1.0, 2.0, 4.0]), amplitude=5.0, answers=True)
    loop.error, loop.alone = np.array([0.001, error, 0.001]), still
    loop.lasting_motion = lambda: None
    cut: Any = SimpleNamespace(unit="N m")
    with pytest.raises(pcpc.Error, match=why):
        notes.measured_notes(MeasuredMargins(loop, Margins(*[NAN] * 12), []), cut)


def test_a_rig_that_drifts_to_its_rest_is_linearised_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = PLANTS["lag"].write(tmp_path, soft=2.0)
    about = {"at_s": 1.0, "method": "linearised"}
    early, late = (pcpc.margin(path, settle_s=t, **about) for t in (0.03, 2.0))  # type: ignore[arg-type]
    assert not early.notes and not late.notes
    for what in NAMES:
        assert getattr(early, what) == pytest.approx(getattr(late, what), rel=1e-6), what
    for longer, rests in (((), False), ((1.0,), False), ((1.0, 2.0), True)):
        monkeypatch.setattr(find, "_LONGER", longer)
        one = pcpc.margin(path, settle_s=0.03, **about)  # type: ignore[arg-type]
        assert ("not at rest" in one.text()) != rests, longer


INF, NONE = math.inf, (math.nan, math.nan)


@pytest.mark.parametrize(
    ("numbers", "size", "told"),
    [
        ({8: (2.0, 50.0), 4: (2.04, 49.0)}, 8, (2.0, 50.0)),
        ({8: (3.0, 50.0), 4: (2.2, 50.0), 2: (2.0, 50.0), 1: (1.97, 50.0)}, 2, (2.0, 50.0)),
        ({8: (2.0, 50.0), 4: (2.02, 50.0), 2: (2.02, 50.0)}, 8, (2.0, 50.0)),
        ({8: (2.0, NAN), 4: (3.0, NAN), 2: (5.0, NAN), 1: NONE}, 8, NONE),
        ({8: (INF, 50.0), 4: (2.0, 50.0), 2: NONE}, 8, (NAN, 50.0)),
        ({8: (2.0, 50.0), 4: (2.06, 50.0), 2: NONE}, 8, (NAN, 50.0)),
        ({8: (2.0, 50.0), 4: (INF, 50.0), 2: NONE}, 8, (NAN, 50.0)),
        ({8: (2.0, 50.0), 4: (3.0, 60.0), 2: (4.0, 70.0), 1: NONE}, 4, NONE),
        ({8: (2.0, 50.0), 4: (3.0, 50.0), 2: (4.0, 70.0), 1: NONE}, 8, (NAN, 50.0)),
        ({8: (2.0, 50.0), 4: (NAN, 50.0)}, 8, (2.0, 50.0)),
        ({8: (NAN, 50.0), 4: (2.0, 50.0)}, 8, (NAN, 50.0)),
        ({8: (INF, 50.0), 4: (INF, 50.0)}, 8, (INF, 50.0)),
        ({8: (2.0, 50.0), 4: NONE}, 8, (2.0, 50.0)),
        ({8: NONE, 4: (2.0, 50.0), 2: (2.0, 50.0)}, 8, NONE),
        ({8: (2.0, 50.0)}, 8, (2.0, 50.0)),
    ],
)
def test_a_number_is_told_where_half_the_size_has_it_too(
    numbers: dict[int, tuple[float, float]],
    size: int,
    told: tuple[float, float],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def margins_of(loop: Any, rate_hz: float) -> MeasuredMargins:
        gain, phase = numbers[loop.amplitude]
        nothing = Margins(*[NAN] * 12)
        return MeasuredMargins(loop, replace(nothing, gain_margin=gain, phase_margin_deg=phase), [])

    def measured(amplitude: float) -> Any:
        return SimpleNamespace(amplitude=amplitude) if amplitude in numbers else None

    monkeypatch.setattr(sizes, "_margins_of", margins_of)
    found = sizes._nearest_to_linear(measured(8), measured, 1.0, 8)
    assert found.loop.amplitude == size
    seen = found.margins.gain_margin, found.margins.phase_margin_deg
    assert seen == pytest.approx(told, nan_ok=True)
    hidden = {"gain_margin": told[0], "phase_margin_deg": told[1]}
    names = [name for name in hidden if math.isnan(hidden[name])]
    first = dict(zip(hidden, numbers[size], strict=True))
    assert [one.name for one in found.unsure] == [n for n in names if not math.isnan(first[n])]


@pytest.mark.parametrize(
    ("errors", "alone", "size", "runs"),
    [
        ([0.01], 0.0, 0, 0),  # enough, as it is
        ([0.1, 0.3, 0.5, 2.0], 0.0, 0, 3),  # noise, until nothing answers
        ([0.1, 0.3, 0.05, 0.01, 0.001], 0.0, 3, 3),  # until it is enough
        ([0.1, 0.05, 0.3, 0.4, 0.6, 0.8, 0.03], 0.0, 1, 5),  # no further than that
        ([0.1, 0.05], 0.0, 1, 2),  # the next ends in a fault
        ([0.1, 0.05, 0.01], 5.0, 1, 1),  # 1/256 is lost in its own motion, 1/16 is not
    ],
)
def test_smaller_sizes_are_tried_until_one_is_clear(
    errors: list[float], alone: float, size: int, runs: int
) -> None:
    def measured(amplitude: float) -> Any:
        k = round(-math.log(amplitude, 16.0))
        tried.append(k)
        if k >= len(errors):
            return None
        error = np.array([errors[k]])
        about = {"error": error, "left": errors[k], "answers": errors[k] <= 1.0}
        return SimpleNamespace(amplitude=amplitude, alone=SimpleNamespace(rms=alone), **about)

    tried = list[int]()
    own = measured(1.0)
    assert sizes._clearest(own, measured).amplitude == pytest.approx(16.0**-size)
    assert tried == list(range(runs + 1))

"""`pcpc margin` of rigs that are not linear: what is measured is the answer to what is small."""

import math
from pathlib import Path

import numpy as np
import pytest

import pcpc
from pcpc.tools.study.margin import find, sizes
from pcpc.tools.study.margin.book._linear_rig import PLANTS, RATE_HZ
from pcpc.tools.study.margin.margins import Margins, margins

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

"""`pcpc experiment margins`: what its table is made of, on the plants that take least time."""

import dataclasses

import numpy as np
import pytest

from pcpc.tools.study.margin.book import margins
from pcpc.tools.study.margin.book._linear_rig import PLANTS


@pytest.mark.parametrize("name", ["probe", "backlash_map", "payload_arm"])
def test_measured_and_linearised_loops_agree_within_5_percent(name: str) -> None:
    found = margins.compared_loops(margins.CASES[name])
    assert len(found.f_hz) > 60
    assert found.deviation.max() < 0.05, f"{found.deviation.max():.3f}"


def test_bands_leave_no_gap_and_overlap_nowhere() -> None:
    whole = margins.compared_loops(margins.CASES["payload_arm"])
    bands = ((0.0, 10.0, 1.0), (10.0, np.inf, 1.0))
    parts = margins.compared_loops(dataclasses.replace(margins.CASES["payload_arm"], bands=bands))
    assert (np.diff(parts.f_hz) > 0.0).all()
    assert parts.f_hz[0] == whole.f_hz[0] and parts.f_hz[-1] == pytest.approx(whole.f_hz[-1], 0.01)


def test_every_plant_stands_in_it_or_is_told_why_not() -> None:
    assert set(margins.CASES) >= {
        "probe", "backlash_pendulum", "backlash_map", "deadzone_arm", "deadzone_map",
        "friction_arm", "payload_arm", "quarter_car", "telerobot", "atb1000",
    }  # fmt: skip
    rig, controller, said = margins._as_it_is("backlash-map", "pd")
    assert (rig, controller) == ("backlash-map", "pd") and "no gain around this loop" in said


@pytest.mark.parametrize("name", list(PLANTS))
def test_the_linear_plants_are_within_1_percent_of_their_closed_form(name: str) -> None:
    error = margins._exact(name)[-1]
    assert float(error.removesuffix(" %")) < 1.0, error

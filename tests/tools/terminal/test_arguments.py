"""What several commands take: times and durations."""

import argparse
import math

import pytest

from pcpc.tools.terminal import arguments as take


@pytest.mark.parametrize(("text", "time_s"), [
    ("0", 0.0), ("1.5", 1.5), ("1e3", 1e3), ("0s", 0.0), ("500ms", 0.5),
    ("250us", 2.5e-4), ("2min", 120.0), ("2m", 120.0), ("1h", 3600.0), (".5s", 0.5),
])  # fmt: skip
def test_a_time_of_a_run_has_a_unit_or_is_in_seconds(text: str, time_s: float) -> None:
    assert math.isclose(take.time(text), time_s)


@pytest.mark.parametrize("text", ["", "soon", "nan", "inf", "-1", "-1s", "1e10", "9e9s", "5 s"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=f"{text}: not a time; expected like 0"):
        take.time(text)

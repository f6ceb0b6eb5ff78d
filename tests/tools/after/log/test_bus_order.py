"""The order of a recording: a clock that is set back, frames out of place, distances."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from logcommand import run

from pcpc.tools.after.log import bus_order
from pcpc.tools.after.log.bus_order import BusOrder

_MS = 1_000_000


def ordered(stamps_ms: Sequence[int], sources: Sequence[int] | None = None) -> BusOrder:
    stamps = np.array(stamps_ms, np.int64) * _MS
    return bus_order.bus_order(stamps, np.array(sources or [0] * len(stamps), np.int64))


def result_ms(found: BusOrder) -> list[int]:
    return [int(stamp) // _MS for stamp in found.stamp_ns[found.order]]


def test_a_clock_that_was_set_back_keeps_the_order_and_is_told(tmp_path: Path) -> None:
    path = tmp_path / "step.log"
    times = [k * 0.01 - (5.0 if k >= 1000 else 0) for k in range(2000)]
    path.write_text(
        "".join(f"({1_700_000_000 + t:.6f}) can0 100#{k:04X}\n" for k, t in enumerate(times))
    )
    done = run("import", path, "-o", tmp_path / "o.mcap", "--json")
    counts = json.loads(done.out)
    step = {"frame": 1001, "back_s": 4.99, "shift_s": 5.0}
    assert (counts["clock_steps"], counts["unsorted"]) == ([step], 0), counts
    lines = run("export", "-o-", tmp_path / "o.mcap").out.splitlines()
    assert [int(line[-4:], 16) for line in lines] == list(range(2000))
    done = run("import", path, "-o", tmp_path / "o.mcap", "--force")
    said = (
        "its clock goes back by 4.99 s at frame 1001: the order stays, stamps from there on are 5 s"
    )
    assert said in done.out, done


@pytest.mark.parametrize(
    ("stamps", "sources", "moved", "steps", "result"),
    [
        ([0, 10, 20, 30], None, 0, [], [0, 10, 20, 30]),
        ([5, 5, 5], None, 0, [], [5, 5, 5]),
        ([0, 20, 10, 30, 40], None, 1, [], [0, 10, 20, 30, 40]),  # out of place
        ([0, 10, 900, 20, 30, 40, *range(50, 200, 10)], None, 18, [], None),  # ahead of its time
        ([0, 100, 200, 0, 100, 200], [0, 0, 0, 1, 1, 1], 2, [], [0, 0, 100, 100, 200, 200]),
        ([100, 110, 50, 60, 70], None, 0, [(3, 60, 70)], [100, 110, 120, 130, 140]),
        ([*range(0, 200, 10), *range(0, 200, 10)], None, 0, [(21, 190, 200)],
         list(range(0, 400, 10))),
        ([*range(0, 200, 10)] * 3, None, 0, [(21, 190, 200), (41, 190, 400)],
         list(range(0, 600, 10))),
        ([*range(0, 200, 10), *range(120, 300, 10)], None, 7, [], None),  # 8 frames are few
        ([*range(0, 200, 10), *range(100, 300, 10)], None, 0, [(21, 90, 100)],
         list(range(0, 400, 10))),
    ],
)  # fmt: skip
def test_stamps_never_fall_and_the_file_says_in_which_order(
    stamps: list[int],
    sources: list[int] | None,
    moved: int,
    steps: list[tuple[int, int, int]],
    result: list[int] | None,
) -> None:
    found = ordered(stamps, sources)
    told = [(step.frame, step.back_ns // _MS, step.shift_ns // _MS) for step in found.steps]
    assert (found.moved, told) == (moved, steps), found
    assert result_ms(found) == (result or sorted(stamps)), found


def test_stamps_without_sense_overflow_nothing() -> None:
    stamps = [0, 2**61, *range(20), 2**61, *range(20)]
    found = bus_order.bus_order(np.array(stamps, np.int64), np.zeros(len(stamps), np.int64))
    assert (np.diff(found.stamp_ns[found.order]) >= 0).all() and found.stamp_ns.min() >= 0


@pytest.mark.parametrize(
    ("stamps", "are"),
    [
        ([0.0, 0.2, 0.1, 0.3], True),
        ([0.0, 0.01, 0.01, 0.01], True),
        ([0.0, 0.1, 0.2, 0.3], False),
        ([0.1, 0.2, 0.1, 0.3], False),
        ([0.0, 0.0, 0.0], False),
        ([0.0, 0.1], False),
        ([*np.arange(0.0, 1.0, 0.01), 0.5], False),  # one of a hundred
    ],
)
def test_distances_are_added_up_where_the_stamps_show_that_they_are(
    stamps: list[float], are: bool, tmp_path: Path
) -> None:
    path = tmp_path / "d.log"
    path.write_text("".join(f"({s:010.6f}) can0 100#{k:02X}\n" for k, s in enumerate(stamps)))
    done = run("import", path, "-o", tmp_path / "o.mcap")
    assert ("distances, as of candump -td" in done.out) is are, done
    if are:
        assert f"in {sum(stamps):g} s" in done.out, done

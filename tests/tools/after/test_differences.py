"""Where two records differ: which numbers do, how it is told, in which order."""

import math
import random
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from pcpc.executive.log import reader as logs
from pcpc.tools.after.differences import (
    SENT,
    Change,
    Difference,
    Differences,
    Tolerance,
    loop_order,
    ulp_distance,
    unequal,
)

OTHER_NAN = np.array([0x7FF8000000000001]).view(np.float64)[0]


def column(*values: float) -> Any:
    return np.array(values, np.float64)


@pytest.mark.parametrize(
    ("a", "b", "ulp"),
    [
        (1.0, math.nextafter(1.0, 2.0), 1),
        (-5e-324, 5e-324, 2),
        (0.0, -0.0, 0),
        (1.0, math.nan, None),
        (math.inf, 1.7976931348623157e308, 1),
    ],
)
def test_ulp_distance_counts_the_floats_between(a: float, b: float, ulp: int | None) -> None:
    assert ulp_distance(a, b) == ulp == ulp_distance(b, a)


@pytest.mark.parametrize(
    ("a", "b", "exact", "near"),
    [
        (1.0, 1.0, False, False), (math.nan, OTHER_NAN, False, False),
        (math.inf, math.inf, False, False), (0.0, -0.0, True, False),
        (1.0, math.nextafter(1.0, 2.0), True, False), (0.0, 0.001, True, False),
        (0.0, math.nextafter(0.001, 1.0), True, True), (1000.0, 1001.001, True, False),
        (1001.002, 1000.0, True, False), (1000.0, 1001.0011, True, True),
        (1.0, math.nan, True, True), (math.nan, 1.0, True, True), (1e308, math.inf, True, True),
        (-math.inf, math.inf, True, True),
    ],
)  # fmt: skip
def test_which_numbers_differ(a: float, b: float, exact: bool, near: bool) -> None:
    assert unequal(column(5.0, a), column(5.0, b)).tolist() == [False, exact]
    assert unequal(column(a), column(b), Tolerance(1e-3, 1e-3)).tolist() == [near]


def test_pieces_add_up_to_where_it_begins_how_often_and_how_large() -> None:
    found = Differences("plant")
    for first, here, there in (
        (0, column(1, 2), column(1, 2)),
        (2, column(3, 4, math.nan), column(3, 4.5, 5)),
        (5, column(6, 0, 0), column(6, 1, 2)),
        (8, column(1), column(1.5)),
    ):
        cycle = first + np.arange(len(here))
        found.add("a.y", cycle, cycle / 10.0, here, there)
    (one,) = found.values()
    assert (one.node, one.cycle, one.time_s, one.count, one.ulp) == ("plant", 3, 0.3, 5, 2**49)
    assert (one.here, one.there, one.texts) == (4.0, 4.5, ("4.0", "4.5"))
    assert (one.largest, one.largest_time_s, one.is_endless) == (2.0, 0.7, False)
    found.add("a.y", np.array([9]), column(0.9), column(-1e308), column(1e308))
    found.add("a.y", np.array([10]), column(1.0), column(0.0), column(1.0))
    assert (one.largest, one.is_endless, one.count) == (2.0, True, 7)
    found.add("a.u", np.array([9]), column(0.9), column(1.0), column(math.nan))
    assert (found["a.u"].largest, found["a.u"].is_endless, found["a.u"].ulp) == (None, False, None)


@pytest.mark.parametrize(
    ("old", "new", "differs"),
    [
        (math.nan, math.nan, False), (0.0, -0.0, False), (None, 1.0, True), (None, math.nan, True),
        (1.0, math.nan, True), (math.inf, math.inf, False), ("a", "b", True), (True, True, False),
    ],
)  # fmt: skip
def test_a_value_of_a_whole_run_differs(old: Any, new: Any, differs: bool) -> None:
    assert Change("it", old, new).differs is differs and Change("it", new, old).differs is differs
    assert Change("it", -2.0, -1.0).relative == 0.5


ROWS = [["time.t_s", "", "supervisor", "loop"], ["rx.FB.q", "", "received", "FB"],
        ["supervisor.saturated", "", "supervisor", "loop"], ["tx.CMD.u", "", "sent", "CMD"],
        ["b.y", "", "output", "b"], ["b.x", "", "state", "b"], ["b.u", "", "input", "b"],
        ["a.y", "", "output", "a"], ["loop.k", "", "state", "loop"]]  # fmt: skip
STAGES = {"frame FB received": "frames in", "rx.FB.q": "frames in", "time.t_s": "time",
          "b.u": "block b", "b.x": "block b", "b.y": "block b", "a.y": "block a",
          "supervisor.saturated": "limits, sent", "frame CMD sent": "frames out"}  # fmt: skip


def test_the_order_is_that_of_a_cycle_and_of_the_nodes() -> None:
    wanted: list[Difference] = []
    for cycle in (5, 6):
        for node in ("plant", "local", "executive", "device"):
            found = Differences(node, ROWS)
            for name in reversed(STAGES):
                found.note(name, cycle, cycle * 1e-3, 1.0, 2.0)
            assert {one.name: one.stage for one in found.values()} == STAGES
            assert [one.name for one in found.ordered()] == list(STAGES), node
            wanted += [found[name] for name in STAGES] if node in logs.NODES else []
    mixed = random.Random(1).sample(wanted, len(wanted))
    assert sorted(mixed, key=loop_order) == wanted
    assert all(loop_order(one) < loop_order(other) for one, other in pairwise(wanted))
    sent = Differences("executive", ROWS)
    assert sent.note(SENT, 0, 0.0, "a", "b").place > sent.note("tx.CMD.u", 0, 0.0, 1.0, 2.0).place
    early = Differences("executive").note("a.y", 9, 0.001, 1.0, 2.0)
    assert loop_order(early) < loop_order(wanted[0]), "time goes before cycles"
    own = Differences("device", ROWS)
    device, later = (own.note(name, 9, 0.001, 1.0, 2.0) for name in ("loop.k", "a.y"))
    assert loop_order(early)[:3] == loop_order(device)[:3] < loop_order(wanted[0])[:3]
    assert (device.stage, device.place < later.place) == ("loop", True)
    assert loop_order(early) > loop_order(own.note("b.y", 8, 0.001, 1.0, 2.0)), "cycles go next"


@pytest.mark.parametrize(
    ("node", "name", "label"),
    [
        ("executive", "a.y", "a.y"), ("plant", "a.y", "plant.a.y"),
        ("executive", "frame FB sent", "frame FB sent"),
        ("plant2", "frame FB sent", "frame plant2.FB sent"),
    ],
)  # fmt: skip
def test_a_name_among_those_of_all_nodes(node: str, name: str, label: str) -> None:
    found = Differences(node).note(name, 0, 0.0, "x", "y")
    assert found.label == label and found.is_frame is ("frame" in name)
    assert found.texts == ("x", "y") and found.ulp is None

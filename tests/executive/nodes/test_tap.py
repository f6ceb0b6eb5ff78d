"""A tap of a node: every row that was there, whole, and the count of those that were not."""

import numpy as np
import pytest
from rings import STATES, TIMINGS, WIDE, block_of, put_cycle, put_event, values_of

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.events import Event
from pcpc.executive.nodes import rings
from pcpc.executive.nodes.live import Live, LiveError
from pcpc.executive.nodes.tap import Tap


@pytest.fixture
def block() -> sh.NodeMemory:
    return block_of("bench.tap.executive", states=["time.t_s", *STATES])


def forget(block: sh.NodeMemory) -> None:
    """Take all rows, as the recorder does."""
    for ring in sh.RINGS:
        block[f"{ring}_taken"][0] = block.ends(ring).head


def test_a_tap_gives_what_was_put_since_the_last_look(block: sh.NodeMemory) -> None:
    put_cycle(block, 1)
    tap = Tap(Live(block))
    assert len(tap.rows()) == 0 and len(tap.frames()) == 0
    for cycle in range(2, 7):
        put_cycle(block, cycle)
    put_event(block, 4, Event.TUNING, 2, 0.5)
    rows = tap.rows()
    assert rows.cycle.tolist() == [2, 3, 4, 5, 6]
    every = np.array([values_of(cycle, len(STATES) + 1 + len(TIMINGS)) for cycle in range(2, 7)])
    np.testing.assert_array_equal(rows.values, every)
    np.testing.assert_array_equal(rows["w.0"], every[:, 3])
    np.testing.assert_array_equal(rows["timing.work_us"], every[:, -1])
    assert tap.frames()[:, 2].tolist() == [2, 2, 3, 3, 4, 4, 5, 5, 6, 6]
    assert [*tap.events()] == [(4, "tunings", {"name": STATES[1], "value": 0.5})]
    assert len(tap.rows()) == 0 and tap.missed == dict.fromkeys(sh.RINGS, 0)
    with pytest.raises(LiveError, match="did you mean w_0"):
        rows["w_00"]


def test_what_the_ring_overwrote_is_counted_and_the_row_being_written_is_left_out() -> None:
    block = block_of("bench.wide.executive", states=["time.t_s", *WIDE])
    size = len(block["record"])
    tap = Tap(Live(block))
    for cycle in range(size + 10):
        put_cycle(block, cycle, frames=0)
        forget(block)
    rows = tap.rows()  # the ring's oldest row may be half of a new one
    assert rows.cycle.tolist() == [*range(11, size + 10)]
    assert tap.missed["record"] == 11
    np.testing.assert_array_equal(rows.values[0], values_of(11, len(WIDE) + 1 + len(TIMINGS)))


def test_rows_that_are_overwritten_while_they_are_copied_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    block = block_of("bench.torn.executive", states=["time.t_s", *WIDE])
    size = len(block["record"])
    tap = Tap(Live(block))
    for cycle in range(size - 5):
        put_cycle(block, cycle, frames=0)
        forget(block)
    put, looks = rings.put, []

    def later(block: sh.NodeMemory, ring: str) -> int:
        """Let the node go on between the first look at the end of the ring and the second."""
        looks.append(ring)
        if len(looks) == 2:
            for cycle in range(size - 5, size + 20):
                put_cycle(block, cycle, frames=0)
                forget(block)
        return put(block, ring)

    with monkeypatch.context() as changed:
        changed.setattr(rings, "put", later)
        rows = tap.rows()
    assert rows.cycle.tolist() == [*range(21, size - 5)]
    assert tap.missed["record"] == 21
    assert tap.rows().cycle.tolist() == [*range(size - 5, size + 20)]
    assert tap.missed["record"] == 21


def test_a_tap_of_some_variables_has_only_these(block: sh.NodeMemory) -> None:
    every, some = Tap(Live(block)), Tap(Live(block), names=["timing.work_us", STATES[1]])
    for cycle in range(5):
        put_cycle(block, cycle)
    whole, part = every.rows(), some.rows()
    assert some.names == (STATES[1], "timing.work_us")
    for name in some.names:
        np.testing.assert_array_equal(part[name], whole[name])
    with pytest.raises(LiveError):
        part[STATES[0]]


def test_a_node_that_nobody_records_is_stuck(block: sh.NodeMemory) -> None:
    tap = Tap(Live(block))
    assert not tap.stuck
    for cycle in range(len(block["record"]) + 1):
        put_cycle(block, cycle, frames=0)
    assert tap.stuck

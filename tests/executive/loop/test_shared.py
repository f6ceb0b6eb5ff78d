"""The shared block: rings that drop and count or wait, snapshots that are never torn."""

import hashlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from engine import ROOT, SLEW10, Bench, both
from places import PATIENCE_S

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.requests import SLOTS
from pcpc.executive.loop.ring_layout import EventRow, OfEvent
from pcpc.executive.nodes import planned_keyframes
from pcpc.executive.nodes.plan import Plan, describe
from pcpc.executive.rig.reading import load_rig

ROWS = 8

WRITER = """
import sys, threading
import standing
from engine import SLEW10, both, write_until_stopped
from pcpc.executive.loop import shared
from pcpc.executive.nodes.plan import describe
from pcpc.executive.rig.reading import load_rig
block = standing.stand(sys.argv[1], describe(both(load_rig(SLEW10))[0], {}))
block.loop.n_variables = shared.MAX_VARIABLES
def stop():
    sys.stdin.read()
    block.control.stop = 1
threading.Thread(target=stop, daemon=True).start()
print("ready", flush=True)
print(write_until_stopped(block.loop, int(sys.argv[2])))
"""


@pytest.fixture(scope="module")
def plans() -> tuple[Plan, Plan]:
    """Return the plans of a shipped rig."""
    return both(load_rig(SLEW10))


@pytest.fixture
def block(plans: tuple[Plan, Plan]) -> sh.NodeMemory:
    """Return an executive's memory."""
    return sh.private(describe(plans[0], {}))


def bench_with_small_ring(plans: tuple[Plan, Plan], waits: bool) -> Bench:
    """Return a closed loop whose executive has a record ring of a few rows that nobody empties."""
    bench = Bench(plans)
    bench.executive.loop.rings.record_rows = ROWS
    bench.executive.loop.rings.wait_recorder = waits
    return bench


# ------------------------------------------------------------------------------------------- rings


def test_a_full_ring_drops_new_rows_and_counts_them(plans: tuple[Plan, Plan]) -> None:
    bench = bench_with_small_ring(plans, waits=False)
    assert bench.run(20) == 20
    node, ends = bench.executive, bench.executive.loop.record_ends
    assert (int(ends.head), int(ends.dropped)) == (ROWS, 20 - ROWS), ends
    assert node.records()[:, 0].tolist() == list(range(ROWS)), node.records()[:, 0]


def test_a_ring_that_is_emptied_again_takes_new_rows(plans: tuple[Plan, Plan]) -> None:
    bench = bench_with_small_ring(plans, waits=False)
    bench.run(20)
    ends = bench.executive.loop.record_ends
    bench.executive.loop.record_taken[0] = ends.head - 3
    bench.run(4)
    cycles = bench.executive.records()[:, 0].tolist()
    assert cycles == [5, 6, 7, 20, 21, 22, 23], cycles
    assert int(ends.dropped) == 20 - ROWS, int(ends.dropped)


def test_the_event_ring_drops_and_counts_too(plans: tuple[Plan, Plan]) -> None:
    bench = Bench(plans)
    node, ends = bench.executive, bench.executive.loop.event_ends
    gain = dict.fromkeys(["controller.kv_Nms_rad"], 110.0)
    node.post(gain)
    node.loop.mail_index[:] = node.place("controller.kv_Nms_rad")
    node.loop.mail_value[:] = 110.0
    for _ in range(20):
        node.loop.mail.count = SLOTS
        bench.run(1)
        node.loop.mail.request += 1
    pushed = 2 + 20 * SLOTS  # READY, RUN
    assert int(ends.head) == sh.EVENT_RING_ROWS, int(ends.head)
    assert int(ends.dropped) == pushed - sh.EVENT_RING_ROWS, int(ends.dropped)


def test_a_full_mailbox_is_applied_and_more_than_that_refused(plans: tuple[Plan, Plan]) -> None:
    bench = Bench(plans)
    node = bench.executive
    node.post({"controller.kv_Nms_rad": 120.0})
    node.loop.mail_index[:] = node.place("controller.kv_Nms_rad")
    node.loop.mail_value[:] = 120.0
    for count, applied in ((10**6, 0), (SLOTS, SLOTS)):
        node.loop.mail.count = count
        bench.run(1)
        assert len(node.events(Event.TUNING)) == applied, count
        node.loop.mail.request += 1


def test_without_a_clock_the_loop_waits_for_the_recorder(plans: tuple[Plan, Plan]) -> None:
    bench = bench_with_small_ring(plans, waits=True)
    ends, seen = bench.executive.loop.record_ends, []
    driver = threading.Thread(target=bench.run, args=(300,), daemon=True)
    driver.start()
    give_up = time.monotonic() + PATIENCE_S
    while driver.is_alive() and time.monotonic() < give_up:
        rows = bench.executive.records()
        seen += rows[:1, 0].tolist()
        bench.executive.loop.record_taken[0] += len(rows[:1])
        os.sched_yield()
    seen += bench.executive.records()[:, 0].tolist()
    assert not driver.is_alive(), f"stuck after {len(seen)} cycles"
    assert seen == list(range(300)), f"{len(seen)} records"
    assert int(ends.dropped) == 0


def test_a_loop_that_waits_for_a_dead_recorder_still_stops(plans: tuple[Plan, Plan]) -> None:
    bench = bench_with_small_ring(plans, waits=True)
    driver = threading.Thread(target=bench.run, args=(300,), daemon=True)
    driver.start()
    ends, give_up = bench.executive.loop.record_ends, time.monotonic() + PATIENCE_S
    while int(ends.head) < ROWS and time.monotonic() < give_up:
        os.sched_yield()
    bench.executive.loop.control.stop = 1
    driver.join(PATIENCE_S)
    assert not driver.is_alive(), "it waits for ever"
    assert int(ends.head) == ROWS and int(ends.dropped) <= 1, ends


# --------------------------------------------------------------------------------------- snapshots


@contextmanager
def writer(burst: int) -> Iterator[sh.NodeMemory]:
    """Attach to a process that publishes 1, 2, 3, ... in all variables; end it afterwards.

    It writes the largest table, of which a reader takes the begin: most likely to be torn.
    """
    name, here = f"test-shared.{os.getpid()}", Path(__file__).parent
    path = os.pathsep.join(map(str, (ROOT, here.parent, here.parents[1])))
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, name, str(burst)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    try:
        yield sharing.attach(name)
    finally:
        published = int(process.communicate(timeout=PATIENCE_S)[0])
    assert published > 300, f"{published} published"


def test_a_snapshot_under_a_running_writer_in_another_process_is_never_torn() -> None:
    give_up, newest = time.monotonic() + PATIENCE_S, 0.0
    with writer(burst=3) as block:
        nothing = np.full(len(block["snapshot"]), -1.0)
        while newest < 900 and time.monotonic() < give_up:
            values = sh.snapshot(block, nothing)
            assert (values == values[0]).all(), f"torn: {np.unique(values)}"
            if values is not nothing:
                assert values[0] >= newest, f"{values[0]} after {newest}"
                newest = float(values[0])
                block.mail.request = int(newest)  # let it go on while we read again
    assert newest >= 900, f"{newest} of 900"


def test_a_writer_that_never_pauses_cannot_make_a_reader_take_a_torn_copy() -> None:
    give_up = time.monotonic() + PATIENCE_S
    with writer(burst=0) as block:
        old = np.full(len(block["snapshot"]), -1.0)
        while int(block["seq"][0]) < 2 * 100_000 and time.monotonic() < give_up:
            values = sh.snapshot(block, old, tries=3)
            assert (values == values[0]).all(), f"torn: {np.unique(values)}"
        published = int(block["seq"][0]) // 2
    assert published >= 100_000, f"{published} published in {PATIENCE_S} s"


def test_a_writer_killed_in_mid_write_is_noticed_and_the_next_one_repairs_it(
    block: sh.NodeMemory, plans: tuple[Plan, Plan]
) -> None:
    block["seq"][0] = 7
    block["snapshot"][:] = np.arange(len(block["snapshot"]))
    old = np.zeros(len(block["snapshot"]))
    assert sh.snapshot(block, old) is old, "a half-written table was taken"
    Bench(plans, block).run(1)
    assert int(block["seq"][0]) % 2 == 0, int(block["seq"][0])
    assert (sh.snapshot(block, old) == block.loop.v[: len(old)]).all()


def test_the_snapshot_holds_the_table_as_it_was_sent(
    block: sh.NodeMemory, plans: tuple[Plan, Plan]
) -> None:
    bench = Bench(plans, block)
    bench.run(5)
    names = [variable[0] for variable in block.description["variables"]]
    values = dict(zip(names, sh.snapshot(block).tolist(), strict=True))
    assert values["time.t_s"] == 0.004 and values["supervisor.state"] == 2.0
    assert values["tx.CMD.motor_torque"] == bench.executive["tx.CMD.motor_torque"]


# ------------------------------------------------------------------------------------------ layout


def test_the_words_that_two_processes_write_lie_on_lines_of_their_own() -> None:
    fields, line = sh.LOOP.fields or {}, 8 * sh.LINE_WORDS
    for name in ("control", "seq", "answer", *(f"{ring}_ends" for ring in sh.RINGS)):
        assert fields[name][1] + fields[name][0].itemsize <= sh.PUBLISHED_BYTES, name
    for name in ("mail", *(f"{ring}_taken" for ring in sh.RINGS)):
        begin, end = fields[name][1], fields[name][1] + fields[name][0].itemsize
        assert begin % line == end % line == 0, f"{name} shares a cache line"
        assert sh.PUBLISHED_BYTES <= begin < end <= sh.PUBLISHED_BYTES + sh.MAILBOX_BYTES, name


def test_what_only_the_loop_needs_lies_beyond_what_clients_map() -> None:
    shared_bytes, fields = sh.PUBLISHED_BYTES + sh.MAILBOX_BYTES, sh.LOOP.fields or {}
    assert sh.PUBLISHED_BYTES % sh.PAGE_BYTES == sh.MAILBOX_BYTES % sh.PAGE_BYTES == 0
    private = {name for name, field in fields.items() if field[1] >= shared_bytes}
    wanted = {"v", "k", "clock", "blocks", "limits", "tuning", "guard", "rx", "tx", "rings", "wire"}
    assert wanted <= private, wanted - private


def test_the_rows_of_events_have_the_columns_that_clients_take() -> None:
    assert EventRow.dtype.names == OfEvent.words()


def test_keyframes_hold_what_those_of_older_logs_hold() -> None:
    held = [
        [(record, name, size) for record, name, _, size in planned_keyframes.spans(9, faults, kind)]
        for kind in (None, "cia402", "odrive")
        for faults in (True, False)
    ]
    kinds = [str(kind.dtype) for kind in Loop.records().values()]
    # a keyframe is looked for under the name of its layout: after a change, older logs have none
    assert hashlib.sha256(repr((held, kinds)).encode()).hexdigest()[:16] == "202d26f67e8a721c"

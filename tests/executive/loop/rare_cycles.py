"""What hardly ever happens in a cycle: full rings, a bus that takes no frame, two odd outputs.

Run interpreted, see `test_interpreted_loop.py`: functions of the loop are called one by one.
"""

import signal
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import Bench, Node, both, puppet_rig, zeroed
from free_bus import GROUP, own_port
from places import ROOT

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import wire
from pcpc.drivers.can.wire_layout import QUEUE_FRAMES, Arrival, Flag
from pcpc.drivers.compiled.jit import i8, loop
from pcpc.executive.loop import (
    clock,
    draws,
    faults,
    losses,
    meeting,
    reception,
    rings,
    timing,
    tuning,
)
from pcpc.executive.loop.control import blank
from pcpc.executive.loop.cycle import N, finish
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.fault_kinds import WrongValue as Wrong
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.injected_values import wrong
from pcpc.executive.loop.injection import BURST, SHARE
from pcpc.executive.loop.layout import KEYFRAME_HEAD
from pcpc.executive.loop.limits import check_finite
from pcpc.executive.loop.ring_layout import OfFrame
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.shared import GREETING
from pcpc.executive.loop.stalls import pass_stalled_period
from pcpc.executive.loop.states import State
from pcpc.executive.loop.strangers import blame
from pcpc.executive.loop.supervisor import Overrun, judge_overrun
from pcpc.executive.loop.timing_layout import Stage
from pcpc.executive.nodes import planned_keyframes
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.nodes.virtual import VirtualRun, in_memory
from pcpc.executive.rig.reading import load_rig

MOTOR = ROOT / "tools/make/template/rig.yaml"
RELAY = ROOT / "tests/executive/relay/rig.yaml"


@loop(i8(N))
def _drain(n: Any) -> Any:
    reception.drain(n)
    return 0


@loop(i8(N))
def _finish(n: Any) -> Any:
    finish(n)
    return 0


@loop(i8(N, i8))
def _all_heard(n: Any, row: Any) -> Any:
    return np.int64(meeting.all_heard(n, row))


def test_a_full_ring_of_frames_drops_and_counts() -> None:
    n = zeroed()
    n.rings.frame_rows, n.rings.frame_words = 2, OfFrame.PAYLOAD + 8
    frame = np.arange(72, dtype=np.uint8)
    for flags in (Flag.FD, Flag.NONE, Flag.FD):
        frame[4], frame[5] = 64 if flags else 8, flags
        push_frame(n, frame, 1, 0)
    assert (int(n.frame_ends.head), int(n.frame_ends.dropped)) == (2, 1)
    rows = n.frame[: 2 * n.rings.frame_words].reshape(2, -1)[:, OfFrame.PAYLOAD :]
    assert rows[0].tobytes() == frame[8:].tobytes(), "FD: all of its data"
    assert rows[1].tobytes() == frame[8:16].tobytes() + bytes(56), "and of a classic one eight"


def test_a_loop_that_waits_for_the_recorder_waits_no_longer_than_once_when_it_is_to_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    n, frame = zeroed(), np.zeros(72, np.uint8)
    n.rings.frame_rows, n.rings.frame_words, n.rings.wait_recorder = 1, OfFrame.PAYLOAD + 8, 1
    push_frame(n, frame, 1, 0)

    def take() -> None:
        n.frame_taken[0] = 1

    recorder = threading.Timer(0.01, take)
    recorder.start()
    push_frame(n, frame, 1, 0)
    assert (int(n.frame_taken[0]), int(n.frame_ends.head), int(n.frame_ends.dropped)) == (1, 2, 0)
    recorder.join()
    n.control.stop = 1
    for wait_ns in (1_000_000, 10**18):  # the second would not end
        monkeypatch.setattr(rings, "LAST_WAIT_NS", wait_ns)
        push_frame(n, frame, 1, 0)
    assert (int(n.frame_ends.head), int(n.frame_ends.dropped)) == (2, 2)


@pytest.mark.parametrize("stops", [False, True])
def test_a_signal_wakes_who_sleeps_only_if_it_is_to_stop(stops: bool) -> None:
    n, came = zeroed(), []

    def note(number: int, _: object) -> None:
        came.append(number)
        n.control.stop = int(stops and len(came) > 1)

    n.clock.deadline = clock.now(n.clock) + (600_000_000_000 if stops else 50_000_000)
    before = signal.signal(signal.SIGALRM, note)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.002, 0.002)
        clock._sleep(n)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert came and (n.clock.wake < n.clock.deadline) == stops


def test_on_a_clock_a_node_that_stands_still_leaves_what_comes_on_its_bus(bench: Bench) -> None:
    n = bench.executive.loop
    n.wire.inbox_put += 1
    before, deadline = n.copy(), int(n.clock.deadline)
    pass_stalled_period(n)
    assert n.wire.inbox_taken == before.wire.inbox_taken == n.wire.inbox_put - 1
    assert (n.k, n.passes, n.control.skipped) == (before.k + 1, before.passes, 1)
    assert n.clock.deadline == deadline + n.clock.period_ns and n.faults.stalled == 1


def test_of_odd_outputs_that_of_the_first_block_is_named(bench: Bench) -> None:
    n = bench.executive.loop
    places = [int(n.blocks.views[i].y) for i in range(int(n.blocks.n))]
    n.v[places] = np.nan
    assert check_finite(n) and len(places) > 1
    assert n.control.odd_place == places[0] + 1


@pytest.mark.parametrize(("kind", "kept"), [(Wrong.DROPOUT, 2.0), (Wrong.STUCK, 1.0)])
def test_what_a_fault_leaves_alone_is_true_and_kept_but_by_what_is_stuck(
    kind: Wrong, kept: float
) -> None:
    n = zeroed()
    n.faults.kind[0], n.faults.kept[0], n.faults.seed[0] = kind, 1.0, 1
    n.v[SHARE], n.v[BURST] = 0.0, 1.0
    assert (wrong(n, 0, 2.0), n.faults.kept[0]) == (2.0, kept)


def test_a_bus_that_takes_no_frame_is_counted(bench: Bench) -> None:
    node = bench.executive
    sent, frames = node.count("sent"), int(node.loop.tx.n)
    node.loop.wire.outbox_put, node.loop.wire.errno = QUEUE_FRAMES, 105
    node.loop.clock.now_ns = node.loop.clock.deadline
    assert node.go() == 1 and node.count("sent") == sent
    assert 0 < node.count("send_errors") <= frames and node.count("bus_errno") == 105


def test_one_cycle_takes_so_many_frames_and_leaves_the_others() -> None:
    channel = f"{GROUP}:{own_port()}"
    made = both(load_rig(MOTOR))[0]
    node, sender = Node(made), zeroed()
    for loop_record in (node.loop, sender):
        buses.open_bus(buses.BusAddress("udp_multicast", channel), [], loop_record.wire)
    sender.wire.tx[:5] = 0x34, 0x05, 0, 0, 8  # an id of nobody
    for _ in range(reception.DRAIN_FRAMES + 3):
        assert wire.put_frame(sender.wire)
    _drain(node.loop)
    left = [wire.get_frame(node.loop.wire, False) for _ in range(4)]
    assert left == [Arrival.FRAME] * 3 + [Arrival.NOTHING]


def test_the_first_odd_output_is_named_and_a_fault_of_the_last_cycle_told(bench: Bench) -> None:
    node = bench.executive
    node["controller.other_Nm"] = node["controller.torque_Nm"] = np.nan
    bench.run(1)
    assert [place for _, place, _ in node.events(Event.NOT_FINITE)] == [
        node.place("controller.motor_torque_Nm")
    ]
    assert node.count("fault") == Fault.NONE, "known with the next cycle"
    _finish(node.loop)
    assert node.count("fault") == Fault.COMMAND_NOT_FINITE and node.state == "STOP"
    assert [what for _, what, _ in node.events(Event.FAULT)] == [Fault.COMMAND_NOT_FINITE]


def test_a_noted_variable_is_told_when_it_changes(bench: Bench) -> None:
    node, place = bench.executive, bench.executive.place("controller.tau_Nm")
    node.loop.blocks.noted_index[0], node.loop.blocks.n_noted = place, 1
    node.loop.blocks.noted[0] = 0.0
    for value in (0.5, 0.5, 0.75):
        node["controller.other_Nm"] = value
        bench.run(1)
    assert node.events(Event.CHANGE) == [(10, place, 0.5), (12, place, 0.75)]


def test_losses_come_in_bursts_and_are_those_of_the_seed(plans: tuple[Plan, Plan]) -> None:
    made = Bench(plans)
    loop_record, frames = made.executive.loop, plans[0].rx_frames
    losses.install(loop_record, [*frames], {"FB_A": (0.4, 2.0)}, 1)
    row = [frame.name for frame in frames].index("FB_A")
    assert made.run(30) > 10
    s, lost, count = draws.first(1, "FB_A"), 0, 0
    for _ in range(int(loop_record.passes)):
        s = s * draws.FACTOR % draws.PRIME
        if s / draws.PRIME < (0.5 if lost else 0.5 * 0.4 / 0.6):
            lost = 1 - lost
        count += lost
    assert made.executive.count("lost_on_purpose") == count > 0
    assert int(loop_record.rx.loss_state[row].draw) == s


def test_the_first_fault_stays_and_its_frame(bench: Bench) -> None:
    n = bench.executive.loop
    blame(n, Fault.INTRUSION, 0x120)
    blame(n, Fault.REPEATED_INPUT, 0x121)
    assert (n.guard.faulted, n.control.culprit) == (Fault.INTRUSION, 0x120)
    n.guard.overrun_policy, n.guard.overrun_after = Overrun.FAULT_AFTER, 1
    n.guard.grace_passes, n.clock.behind = 0, 1
    judge_overrun(n)
    assert n.guard.faulted == Fault.INTRUSION
    n.guard.overrun_policy = Overrun.FALL_BACK
    for _ in range(2):
        judge_overrun(n)
    assert len(bench.executive.events(Event.FALLBACK)) == 1


def test_a_request_that_changes_while_it_is_copied_waits_for_the_next_cycle(bench: Bench) -> None:
    node = bench.executive
    node.post({"controller.torque_Nm": 2.0})
    tuning.answer(node.loop, int(node.loop.mail.request) - 1)
    assert node["controller.torque_Nm"] == 1.0 and not node.events(Event.TUNING)
    bench.run(1)
    assert node["controller.torque_Nm"] == 2.0 and len(node.events(Event.TUNING)) == 1


def test_what_comes_from_nobody_is_no_node_below(bench: Bench) -> None:
    n = bench.executive.loop
    n.meeting.heard, row = 0, 0
    n.rx.role[row].peer = 0
    assert not _all_heard(n, row) and n.meeting.heard == 0
    n.rx.role[row].peer = 1
    assert _all_heard(n, row)


def test_counts_that_lack_times_have_the_largest_for_a_percentile() -> None:
    n = zeroed()
    n.stages[Stage.WORK].count, n.stages[Stage.WORK].most = 10, 77
    assert timing.percentile(n, Stage.WORK, 0.5) == 77


@pytest.mark.parametrize(
    ("fault", "word", "said"),
    [
        (Fault.ANOTHER_SENDER, GREETING, "the other node has another plant: rig, --set, seed or"),
        (Fault.ANOTHER_SENDER, 0x80, "another sender of 0x080 (SYNC) is on this bus"),
        (Fault.REPEATED_INPUT, 0x80, "0x080 (SYNC) was repeated again and again: another sender"),
        (Fault.INTRUSION, 0x81, "0x081 (?) comes from two senders"),
        (Fault.PEER_SILENT, 0x80, "the other node fell silent: no 0x080 (SYNC) came"),
        (Fault.PEER_SILENT, 0, "the other node fell silent"),
        (Fault.BUS_FAILED, 0x80, "the bus failed"),
    ],
)
def test_a_fault_is_told_with_its_frame(fault: Fault, word: int, said: str) -> None:
    control: Any = blank()
    control.fault, control.culprit = fault, word
    about = {"frames": {"128": "SYNC"}, "fault_names": faults.FAULT_NAMES}
    assert faults.reason(about, control).startswith(said)


def test_a_keyframe_is_all_that_a_node_carries_and_nothing_impossible(bench: Bench) -> None:
    node = bench.executive
    held = planned_keyframes.spans(int(node.loop.n_variables), False)
    planned_keyframes.let_keep(node.loop, held, 100)
    node.loop.keep.next = node.loop.passes
    bench.run(1)
    size = planned_keyframes.size_of(held)
    state = node.loop.keyframe.view(np.uint8)[8 * KEYFRAME_HEAD :][:size].tobytes()
    assert _held_bytes(held, node.loop) == state
    bench.run(3)
    assert _held_bytes(held, node.loop) != state
    planned_keyframes.put_back(node.loop, held, state)
    assert _held_bytes(held, node.loop) == state
    assert planned_keyframes.impossible(held, state) == ""
    wrong = np.frombuffer(state, np.uint8).copy()
    at = sum(size for *_, size in held[:1])
    wrong[at : at + 8] = 255, 255, 255, 255, 255, 255, 255, 0x7F
    assert planned_keyframes.impossible(held, wrong.tobytes()).startswith("control.")


def _held_bytes(held: Sequence[planned_keyframes.Span], loop_record: Any) -> bytes:
    """Return what of a node is in its keyframes, as it stands."""
    whole = loop_record.tobytes()
    return b"".join(whole[offset : offset + size] for _, _, offset, size in held)


def test_a_run_goes_on_in_pieces() -> None:
    rig = load_rig(MOTOR, settings=["duration_s=0.02"])
    run = VirtualRun(rig, None)
    run._at_once = 5
    assert [*run.advance()] == [5, 10, 15, 20]
    assert run.blocks[1].control.state == State.STOP


@pytest.mark.parametrize("line", ["", "bus: {emulate: 1M}"])
def test_a_local_node_hands_on_from_bus_to_bus(tmp_path: Path, line: str) -> None:
    path = tmp_path / "relayed.yaml"
    path.write_text(f"base: {RELAY}\nduration_s: 0.012\n{line}\n")
    log = in_memory(load_rig(path))
    moved = np.flatnonzero(log.node["plant"].columns["lag.position"] > 0)
    assert moved[0] == (1 if line else 2), "on a line its cycle begins within that of the executive"


def test_a_fault_while_the_bus_is_off_is_that_of_the_bus_also_without_a_clock(
    plans: tuple[Plan, Plan],
) -> None:
    made = Bench(plans)
    made.run(3)
    made.plant.loop.guard.off = 1
    made.run(1)
    assert int(made.plant.loop.guard.faulted) == Fault.BUS_OFF


def test_the_last_ramp_is_as_slow_as_the_slowest_command(tmp_path: Path) -> None:
    slow = "executive: {limits: {CMD.motor_torque: {rate_per_s: 2.0}}}"
    made = Bench(both(load_rig(puppet_rig(tmp_path, slow, "supervisor: {ramp_s: 0.01}"))))
    made.executive["controller.torque_Nm"] = 1.0
    made.run(20)
    made.executive.loop.control.stop = 1
    made.run(2)
    pace = float(made.executive.loop.guard.pace)
    assert pace == pytest.approx(0.002 / made.executive.loop.limits.table[0].last, rel=1e-9)

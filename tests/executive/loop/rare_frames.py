"""Frames that hardly ever come: to a drive, twice, for the other bus, put in place of others.

Run interpreted, see `test_interpreted_loop.py`: functions of the loop are called one by one.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import TWICE, Bench, Node, zeroed
from places import ROOT

from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.drivers.compiled.rows import FLAGS, LENGTH
from pcpc.executive.loop import exchange, injected_frames, meeting, plant_drive, reception
from pcpc.executive.loop.fault_kinds import WrongFrame
from pcpc.executive.loop.injected_frames import AND_ANOTHER, CHANGED, GONE
from pcpc.executive.loop.injection import VALUE
from pcpc.executive.loop.meeting import MeetingPart, Turn
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig

TEMPLATE = ROOT / "tools/make/template"
RELAY = ROOT / "tests/executive/relay/rig.yaml"
ROBOTS = ROOT / "tests/drivers/robots"


def heard(node: Node, word: int, data: bytes) -> None:
    """Let a node take a classic frame that it was sent."""
    frame = node.loop.wire.rx
    frame[:] = 0
    frame[:5] = np.frombuffer(struct.pack("<IB", word, len(data)), np.uint8)
    frame[8 : 8 + len(data)] = np.frombuffer(data, np.uint8)
    reception.take_one(node.loop)


def test_a_drive_has_the_gains_of_its_master_and_counts_twins_and_orders_of_other_makers() -> None:
    node = Node(plan(load_rig(ROBOTS / "odrive.yaml"), "plant", "real"))
    robot = node.loop.robot
    heard(node, 6 << 5 | 0x1B, struct.pack("<ff", 0.25, 0.5))
    found = [node[f"drive.{name}"] for name in ("velocity_gain", "integral_gain_per_s")]
    assert found == [0.25 * robot.rated, 2.0] and robot.state.regained == 0
    heard(node, 6 << 5 | 1, bytes(8))
    assert node.count("foreign") == 1, "the heartbeat that only it sends"
    for address in (6, 7):
        heard(node, address, bytes([255] * 7 + [252]))
    assert [*robot.foreign] == [0, 0, 1, 0, 0], "of MIT, to this node"


@pytest.mark.parametrize(("pacing", "sent"), [("real", [0x705, 0x585]), ("lockstep", [])])
def test_a_drive_answers_at_once_but_in_lockstep_behind_its_node(
    pacing: str, sent: list[int]
) -> None:
    node = Node(plan(load_rig(TEMPLATE / "drive_cia402.yaml"), "plant", pacing))
    heard(node, 0x600 + 5, bytes([0x40, 0x41, 0x60, 0, 0, 0, 0, 0]))
    end, drive = node.loop.wire, node.loop.canopen
    assert _ids(end.outbox, end.outbox_put) == sent
    assert sent + _ids(drive.outbox, drive.n_out) == [0x705, 0x585], "boot-up, then the answer"


def _ids(frames: Any, count: int) -> list[int]:
    return [int(frame[0]) | int(frame[1]) << 8 for frame in frames[:count]]


def test_a_velocity_that_nobody_measures_is_the_difference_of_positions() -> None:
    node = Node(plan(load_rig(ROBOTS / "odrive.yaml"), "plant", "real"))
    n, drive = node.loop, node.loop.robot
    drive.place_velocity, drive.before, drive.rate_hz = -1, 0.25, 1000.0
    found = []
    for n.passes, n.clock.behind, position in ((0, 0, 0.5), (1, 0, 0.75), (2, 1, 1.25)):
        found.append(plant_drive.velocity_at(n, drive, position))
    assert found == [0.0, 250.0, 250.0], "the last one over two periods"


def test_of_two_buses_each_plant_is_given_the_frames_of_its_own_and_heard() -> None:
    nodes = zeroed(), zeroed(), zeroed()
    end = nodes[0].wire
    nodes[2].meeting.on_second = 1
    end.second[0], end.n_second, end.outbox_put = 0x20, 1, 3
    for k, can_id in enumerate((0x10, 0x20, 0x30)):
        end.outbox[k, 0] = can_id
    nodes[0].meeting.peers, nodes[2].wire.outbox_put, nodes[2].wire.outbox[0, 0] = 2, 1, 0x40
    for i in range(3):
        exchange.pass_on(nodes, i)
    came = [[int(n.wire.inbox[k, 0]) for k in range(n.wire.inbox_put)] for n in nodes]
    assert came == [[0x40], [0x10, 0x30], [0x20]] and end.outbox_put == 0


def test_a_wrong_length_is_one_that_can_fd_has() -> None:
    n, frame = zeroed(), np.zeros(72, np.uint8)
    n.faults.kind[0], frame[FLAGS] = WrongFrame.LENGTH, Flag.FD
    for length in range(70):
        n.v[VALUE], n.wire.rx[:] = length, frame
        injected_frames.disturb(n, 0, 0)
        assert n.wire.rx[LENGTH] == min(one for one in LENGTHS if one >= min(length, 64))


def test_a_second_heartbeat_from_above_before_the_first_cycle_is_left() -> None:
    n = Node(plan(load_rig(TEMPLATE / "rig.yaml"), "plant", "lockstep")).loop
    parts = [int(n.rx.role[row].meeting) for row in range(n.rx.n)]
    row = parts.index(MeetingPart.FROM_ABOVE)
    assert [meeting.sorted_out(n, row) for _ in range(3)] == [Turn.TAKE, Turn.LEAVE, Turn.LEAVE]
    assert not np.any(n.meeting.holding)


@pytest.mark.parametrize(
    ("name", "acted", "counted"), [("FB_A", False, 2), ("FB_A", True, 2), ("MOTPOS", False, 0)]
)
def test_a_repeat_of_what_is_awaited_is_counted_also_where_a_fault_excuses_others(
    bench: Bench, name: str, acted: bool, counted: int
) -> None:
    n = bench.executive.loop
    row = [frame.name for frame in bench.executive.plan.rx_frames].index(name)
    n.rx.repeats.count = 0
    n.faults.acted[row] = int(n.passes) if acted else 0
    bench.run(2, {name: TWICE})
    assert n.rx.repeats.count == counted


@pytest.mark.parametrize(
    ("done", "state", "count"),
    [(CHANGED, 127, 1), (GONE | AND_ANOTHER, 5, 1), (CHANGED | AND_ANOTHER, 5, 2), (GONE, 4, 0)],
)
def test_a_frame_without_a_crc_that_faults_put_behind_another_is_used(
    bench: Bench, done: int, state: int, count: int
) -> None:
    node, n = bench.executive, bench.executive.loop
    row = [frame.name for frame in node.plan.rx_frames].index("HB_PLANT")
    n.wire.rx[:] = 0
    n.wire.rx[:5] = np.frombuffer(struct.pack("<IB", node.frames["HB_PLANT"], 1), np.uint8)
    n.faults.another[:] = n.wire.rx
    node["rx.HB_PLANT.nmt_state"], n.wire.rx[8], n.faults.another[8] = 4, 127, 5
    received = node.count("received")
    reception.put_in_place(n, row, done)
    assert node["rx.HB_PLANT.nmt_state"] == state
    assert node.count("received") - received == count


def test_a_local_node_goes_on_until_its_command_is_safe_and_the_plant_with_it(
    tmp_path: Path,
) -> None:
    path = tmp_path / "slow.yaml"
    limits = "{CMD.command: {low: -5.0, high: 5.0, rate_per_s: 40.0, safe: 0.4}}"
    path.write_text(f"base: {RELAY}\nduration_s: 0.03\nlocal: {{limits: {limits}}}\n")
    run = VirtualRun(load_rig(path), None)
    assert not [*run.advance()][:-1]
    loops = [block.loop for block in run.blocks]
    assert [int(block.control.done) for block in run.blocks] == [1, 1, 1]
    assert int(loops[0].k) == 30 < int(loops[1].k) == int(loops[2].k) - 1
    command = loops[1].limits.table[0]
    assert abs(command.sent - 0.4) <= command.rate


def test_a_local_node_that_is_not_told_the_end_is_ended_with_its_executive() -> None:
    run = VirtualRun(load_rig(RELAY, settings=["duration_s=0.02", "losses.ASK.share=0.9"]), None)
    assert not [*run.advance()][:-1]
    assert [int(block.control.done) for block in run.blocks] == [1, 1, 1]
    assert [int(block.control.state) for block in run.blocks] == [State.STOP] * 3
    assert run.blocks[1].loop.guard.pace == 0.0 and run.blocks[1].control.lost_on_purpose > 10

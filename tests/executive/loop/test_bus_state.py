"""What the CAN controller tells: counted by kind, bus-off a fault, on an emulated line too."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import ROOT, Bench, both, puppet_rig
from replays import replayed

from pcpc.drivers.can import wire
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.can.wire_layout import Arrival, Medium, Wire
from pcpc.drivers.line import error_frames, line
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.bus_state import note_bus_error
from pcpc.executive.loop.control import BUS_COUNTERS
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

PROBE = ROOT / "plants/probe/rig.yaml"
KINDS = ("warnings", "passives", "offs", "restarts", "no_acks", "tx_timeouts")
TOLD = {  # id, data[1]: counted as
    (0x004, 0x04): "warnings", (0x004, 0x08): "warnings",
    (0x004, 0x10): "passives", (0x004, 0x20): "passives", (0x004, 0x40): "",
    (0x040, 0x00): "offs", (0x100, 0x00): "restarts", (0x020, 0x00): "no_acks",
    (0x001, 0x00): "tx_timeouts", (0x008, 0x00): "", (0x0A8, 0x00): "no_acks",
}  # fmt: skip
WAITS = "supervisor: {on_fault: wait, ramp_s: 0.01}"


def tell(loop: Any, kind: int, detail: int = 0) -> None:
    """Let a node hear an error frame."""
    loop.wire.rx[:16] = [kind & 255, kind >> 8, 0, 0x20, 8, 0, 0, 0, 0, detail, *[0] * 6]
    note_bus_error(loop)


@pytest.mark.parametrize(("told", "kind"), TOLD.items())
def test_an_error_frame_is_counted_by_its_kind(
    told: tuple[int, int], kind: str, tmp_path: Path
) -> None:
    node = Bench(both(load_rig(puppet_rig(tmp_path)))).executive
    tell(node.loop, *told)
    counted = {name: node[f"health.bus_{name}"] for name in KINDS}
    assert counted == {name: float(name == kind) for name in KINDS}
    assert node.count("bus_errors") == (told not in ((0x004, 0x40), (0x100, 0x00)))


def test_bus_off_is_a_fault_that_no_reset_leaves_until_the_bus_is_back(tmp_path: Path) -> None:
    made = Bench(both(load_rig(puppet_rig(tmp_path, WAITS))))
    node = made.executive
    node["controller.torque_Nm"] = 1.0
    made.run(10)
    tell(node.loop, error_frames.OFF)
    made.run(1)
    assert (node.state, node["supervisor.fault"]) == ("FAULT", Fault.BUS_OFF)
    made.run(15)
    node.post({"supervisor.reset": 1.0})
    made.run(5)
    assert (node.state, node["supervisor.fault"]) == ("FAULT", Fault.BUS_OFF), "it is off"
    tell(node.loop, error_frames.RESTARTED)
    made.run(5)
    assert node.state == "FAULT", "latched"
    node.post({"supervisor.reset": 1.0})
    made.run(15)
    assert node.state == "RUN" and node["tx.CMD.motor_torque"] == 1.0


def emulated(*settings: str) -> Any:
    return load_rig(PROBE, None, ["bus.emulate=1M", *settings])


def test_a_node_that_goes_bus_off_on_the_line_faults_and_is_recomputed(tmp_path: Path) -> None:
    rig = emulated("bus.bit_error_rate=1.0", "duration_s=0.5")
    run = simulate(rig, tmp_path / "log.mcap")
    (off,) = np.flatnonzero(run.over[0].times_off[:2])[:1]
    log = logs.read(tmp_path / "log.mcap")
    name = ("executive", "plant")[off]
    block = run.blocks[off]
    assert block.control.fault == Fault.BUS_OFF, block.control
    assert block.control.bus_offs == run.over[0].times_off[off], "each time"
    assert block.control.bus_passives >= 1
    frames = log.node[name].frames
    told = frames[frames["e2e"] == FrameState.BUS_ERROR]
    assert 0x20000040 in told["id"], told
    for verdict in replayed(tmp_path / "log.mcap"):
        assert verdict.identical, verdict


def test_a_rough_line_takes_a_node_off_and_a_reset_lets_it_go_on(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(
        f"base: {PROBE}\nduration_s: 2.0\n"
        "bus: {emulate: 1M, bit_error_rate: 2.0e-5, error_burst: 60, queue: 8}\n"
        "supervisor: {on_fault: wait, hold_cycles: 100000, fault_after_cycles: 100000}\n"
        "schedule: ["
        + ", ".join(f"{{at_s: {t / 10}, set: {{supervisor.reset: 1}}}}" for t in range(1, 19))
        + "]\n"
    )
    run = simulate(load_rig(path), tmp_path / "log.mcap")
    control = run.blocks[0].control
    offs, restarts = int(control.bus_offs), int(control.bus_restarts)
    assert offs >= 1 and offs - 1 <= restarts <= offs, (offs, restarts)
    node = logs.read(tmp_path / "log.mcap").node["executive"].columns
    state, fault = node["supervisor.state"], node["supervisor.fault"]
    first = int(np.argmax(fault == Fault.BUS_OFF))
    assert fault[first] == Fault.BUS_OFF and state[first] == State.FAULT
    assert (state[first:] == State.RUN).any(), "behind a reset it runs"


def test_a_clean_line_tells_nothing(tmp_path: Path) -> None:
    run = simulate(emulated("duration_s=0.5"), tmp_path / "log.mcap")
    for block in run.blocks:
        words = [block.control[word] for word, *_ in BUS_COUNTERS]
        assert not any(words) and not block.control.bus_errors


def test_an_error_frame_in_memory_is_none_that_is_decoded() -> None:
    end: Any = np.zeros(1, Wire.dtype).view(np.recarray)[0]
    wire.prepare(end, Medium.MEMORY, -1, -1)
    wire.deliver(np.array([0x40, 0, 0, 0x20, 8, *[0] * 11], np.uint8), end)
    assert wire.get_frame(end, False) == Arrival.BUS_ERROR


def test_a_line_tells_each_change_of_a_sender_once() -> None:
    made: Any = np.zeros(1, line.Line.dtype).view(np.recarray)[0]
    line.prepare(made, 2)
    frame = np.zeros(16, np.uint8)
    assert not error_frames.news(made, 0, frame)
    seen = []
    for errors, off in ((95, 0), (96, 0), (128, 0), (256, 1), (0, 0), (100, 0), (0, 0)):
        made.transmit_errors[0], made.off[0] = errors, off
        if error_frames.news(made, 0, frame):
            seen.append((int(frame[0]) | int(frame[1]) << 8, int(frame[9])))
        assert not error_frames.news(made, 0, frame) and not error_frames.news(made, 1, frame)
    assert seen == [(4, 8), (4, 32), (64, 0), (256, 0), (4, 8), (4, 64)]

"""Virtual time over an emulated CAN line: delays that follow from bits, the same in every run."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import ROOT

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.faults import Fault
from pcpc.executive.nodes.virtual import VirtualRun, in_memory, simulate
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.replay import replay
from pcpc.tools.start.bus.traffic import Setup, buses, response_rows
from pcpc.tools.terminal.progress import Progress

PROBE = ROOT / "plants/probe/rig.yaml"
HULL = ROOT / "plants/atb1000/rigs/hull.yaml"
CMD, FB, SYNC = 0xA0, 0x120, 0x80


def probe(*settings: str, duration_s: float = 0.5) -> Rig:
    return load_rig(PROBE, None, [f"duration_s={duration_s}", *settings])


def logged(rig: Rig, path: Path) -> tuple[logs.Log, Any]:
    """Run a rig; return its log and the line."""
    run = simulate(rig, path)
    return logs.read(path), run.over[0] if run.over else None


def delays(log: logs.Log, can_id: int, sender: str, receiver: str) -> set[int]:
    """Return by how many cycles frames of an id are received behind the cycle that sent them."""
    sent, heard = (
        {
            frame["data"].tobytes(): int(frame["cycle"])
            for frame in log.node[name].frames
            if frame["id"] == can_id and frame["direction"] == way
        }
        for name, way in ((sender, 0), (receiver, 1))
    )
    assert len(set(heard) & set(sent)) > 100
    return {heard[data] - sent[data] for data in heard if data in sent and 5 < sent[data] < 190}


@pytest.mark.parametrize(
    ("bitrate", "phase", "late_cmd", "late_fb"),
    [
        ("1M", 0.5, 1, 0),  # as without a line: the plant is a cycle ahead
        ("350k", 0.4, 2, 0),  # SYNC and CMD take 0.5 ms
        ("350k", 0.8, 1, 1),  # and are there after 0.8 ms; then FB has 0.2 ms, and needs 0.33
        ("350k", 0.0, 1, 1),  # 0 stands for a whole cycle
    ],
)
def test_a_frame_that_is_not_through_is_taken_in_the_next_cycle(
    bitrate: str, phase: float, late_cmd: int, late_fb: int, tmp_path: Path
) -> None:
    # in a ramp of 0.5 s no value repeats, so that each frame is known by its data
    rig = probe(f"bus.emulate={bitrate}", f"realtime.plant.phase={phase}", duration_s=0.2)
    log, line = logged(rig, tmp_path / "log.mcap")
    assert delays(log, CMD, "executive", "plant") == {late_cmd}
    assert delays(log, FB, "plant", "executive") == {late_fb}
    assert (line.errors.sum(), line.refused.sum(), line.lost_off.sum()) == (0, 0, 0)


def test_a_line_that_is_fast_enough_changes_no_bit_of_what_the_laws_see() -> None:
    with_line, without = (
        in_memory(load_rig(HULL, None, ["duration_s=1.0", *settings]))
        for settings in (["bus.emulate=1 Mbit/s"], [])
    )
    for node in ("executive", "plant"):
        one, other = with_line.node[node], without.node[node]
        assert set(one.columns) == set(other.columns)
        for name in one.columns:
            if not name.startswith("rx.HB_"):  # slow ones come a cycle later
                a, b = one.columns[name], other.columns[name]
                assert np.array_equal(a, b, equal_nan=True), name


ROUGH = ("bus.emulate=400k", "bus.bit_error_rate=3e-4", "bus.error_burst=3", "bus.queue=8")


def test_equal_seeds_give_equal_runs_and_others_do_not(tmp_path: Path) -> None:
    def run(name: str, seed: int) -> tuple[list[bytes], bytes]:
        log, line = logged(probe(*ROUGH, f"seed={seed}"), tmp_path / name)
        assert line.errors.sum() > 5
        columns = [node.columns[n].tobytes() for node in log.node.values() for n in node.columns]
        return columns, line.tobytes()

    once, again, other = run("a", 1), run("b", 1), run("c", 2)
    assert once == again
    assert once != other


FAULTS = """
faults:
  stall: {kind: stall, node: executive, from: 100ms, for: 5ms}
  late: {kind: delay, frame: CMD, from: 200ms, for: 50ms, value: 3.0}
"""


WITHIN = """
faults:
  stall: {kind: stall, node: plant, from: 100ms, for: 40ms}
  blocked: {kind: loss, frame: CMD, from: 80ms, for: 30ms}
  odd: {kind: stall, node: executive, from: 300ms, for: 20ms}
  deaf: {kind: loss, frame: FB, from: 290ms, for: 15ms}
supervisor: {fault_after_cycles: 100, hold_cycles: 100}
"""  # a loss ends while its receiver stands still: what waits for it is heard


@pytest.mark.parametrize(
    "settings", [("bus.emulate=350k",), ROUGH, ()], ids=["late", "rough", "none"]
)
@pytest.mark.parametrize("faults", ["", FAULTS, WITHIN], ids=["", "faults", "within"])
def test_the_run_is_recomputed_from_its_log(
    settings: tuple[str, ...], faults: str, tmp_path: Path
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(f"base: {PROBE}\nduration_s: 0.5\n{faults}")
    simulate(load_rig(path, None, settings), tmp_path / "log.mcap")
    options = argparse.Namespace(controller=None, set=[], node="all")
    for verdict in replay(tmp_path / "log.mcap", options, Progress(quiet=True)):
        assert verdict.identical, verdict


def test_a_node_that_is_off_says_so_and_one_that_is_not_misses_the_other(tmp_path: Path) -> None:
    rig = probe(
        "bus.emulate=1M",
        "bus.bit_error_rate=1.0",
        "supervisor.hold_cycles=2",
        "supervisor.fault_after_cycles=5",
    )
    log, line = logged(rig, tmp_path / "log.mcap")
    assert line.times_off.sum() >= 1
    assert line.sent.sum() == 0
    faults = {name: set(node.columns["supervisor.fault"]) for name, node in log.node.items()}
    named = [Fault.BUS_OFF if off else Fault.INPUT_MISSING for off in line.times_off[:2]]
    assert [faults["executive"], faults["plant"]] == [{0, named[0]}, {0, named[1]}], faults


@pytest.mark.parametrize("bitrate", ["1M", "600k", "450k"])
def test_no_frame_of_a_rig_takes_longer_than_its_analysis_says(
    bitrate: str, tmp_path: Path
) -> None:
    rig = probe(f"bus.emulate={bitrate}")
    _, line = logged(rig, tmp_path / "log.mcap")
    setup = Setup(rig.config.rate_hz, rig.config.bus.bits_per_s or 0)
    (frames,) = buses(rig)
    longest = max(row.response_ns or 0 for row in response_rows(frames, setup))
    waited_ns = 1e9 * int(line.longest.max()) / setup.bitrate
    assert 0.4 * longest < waited_ns <= longest, f"{waited_ns} ns, bound {longest} ns"


@pytest.mark.parametrize("text", ["500 kbit/s", "500k", "0.5 Mbit/s", "0.5M", "500000"])
def test_a_bit_rate_is_given_as_people_write_it(text: str) -> None:
    rig = load_rig(PROBE, None, [f"bus.emulate={text}", "bus.bitrate=1000000"])
    assert rig.config.bus.bits_per_s == 500_000


def test_a_rate_that_cannot_be_emulated_is_refused_with_its_place() -> None:
    with pytest.raises(RigError, match="classic CAN"):
        VirtualRun(load_rig(HULL, None, ["bus.emulate=2M"]), None)


@pytest.mark.parametrize("phase", [0.3333, 0.7])  # before the plant's, behind it
def test_the_bus_above_a_local_node_is_a_line_that_below_takes_no_time(phase: float) -> None:
    settings = ["bus.emulate=1M", f"realtime.local.phase={phase}"]
    run = VirtualRun(load_rig(ROOT / "tests/executive/relay/rig.yaml", None, settings), None)
    for _ in run.advance():
        pass
    log, line = run.memory.log(), run.over[0]
    assert int(line.senders) == 2
    for s, passes, every in ((0, 1000, 2), (1, 1001, 1)):  # SYNC and ASK; TELL
        beats = passes // 100
        assert 0 <= every * passes + beats - int(line.sent[s]) <= 4, line.sent[:3]
    position = log.node["plant"].columns["lag.position"]
    assert abs(position[-1] - 0.8) < 1e-4, position[-1]
    assert np.flatnonzero(position > 0.0)[0] == 1 + (phase > 0.5), "a command acts at once below"

"""Virtual time over an emulated CAN line: delays that follow from bits, the same in every run.

The probe has classic frames, or with the same signals those of CAN FD.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import ROOT
from fd_rig import fd_rig
from replays import replayed

from pcpc.drivers.can.wire_layout import Flag
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.faults import Fault
from pcpc.executive.nodes.virtual import VirtualRun, in_memory, simulate
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.start.bus.traffic import Setup, buses, response_rows

PROBE = ROOT / "plants/probe/rig.yaml"
HULL = ROOT / "plants/atb1000/rigs/hull.yaml"
CMD, FB, SYNC = 0xA0, 0x120, 0x80
FAST = {
    "classic": ("bus.emulate=1M",),
    "fd": ("bus.emulate=1M", "bus.data_bitrate=5000000"),
}
NOISE = "bus.bit_error_rate=3e-4", "bus.error_burst=3", "bus.queue=8"
ROUGH = {
    "classic": ("bus.emulate=400k", *NOISE),
    "fd": ("bus.emulate=800k", FAST["fd"][1], *NOISE),
}
both = pytest.mark.parametrize("kind", ROUGH)


def rig_of(kind: str, folder: Path, *settings: str, lines: tuple[str, ...] = ()) -> Rig:
    """Return the probe's rig of a kind of frames, with further lines."""
    folder.mkdir(exist_ok=True)
    path = folder / "rig.yaml"
    if kind == "fd":
        path = fd_rig(folder, *lines)
    else:
        path.write_text("\n".join([f"base: {PROBE}", *lines]))
    return load_rig(path, None, ["duration_s=0.5", *settings])


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
    ("kind", "line", "phase", "late_cmd", "late_fb"),
    [
        ("classic", "emulate=1M", 0.5, 1, 0),  # as without a line: the plant is a cycle ahead
        ("classic", "emulate=350k", 0.4, 2, 0),  # SYNC and CMD take 0.5 ms
        ("classic", "emulate=350k", 0.8, 1, 1),  # and are there after 0.8 ms; FB needs 0.33 ms
        ("classic", "emulate=350k", 0.0, 1, 1),  # 0 stands for a whole cycle
        ("fd", "data_bitrate=5000000", 0.4, 1, 0),  # here the second bit rate decides
        ("fd", "data_bitrate=1500000", 0.4, 2, 0),  # SYNC and CMD take 0.44 ms
        ("fd", "data_bitrate=1500000", 0.7, 1, 1),  # FB takes 0.46 ms
        ("fd", "data_bitrate=5000000", 0.7, 1, 0),
    ],
)
def test_a_frame_that_is_not_through_is_taken_in_the_next_cycle(
    kind: str, line: str, phase: float, late_cmd: int, late_fb: int, tmp_path: Path
) -> None:
    # in a ramp of 0.5 s no value repeats, so that each frame is known by its data
    settings = f"bus.{line}", f"realtime.plant.phase={phase}", "duration_s=0.2"
    log, state = logged(rig_of(kind, tmp_path, "bus.emulate=1M", *settings), tmp_path / "log.mcap")
    assert delays(log, CMD, "executive", "plant") == {late_cmd}
    assert delays(log, FB, "plant", "executive") == {late_fb}
    assert (state.errors.sum(), state.refused.sum(), state.lost_off.sum()) == (0, 0, 0)


@both
def test_a_line_that_is_fast_enough_changes_no_bit_of_what_the_laws_see(
    kind: str, tmp_path: Path
) -> None:
    path = fd_rig(tmp_path) if kind == "fd" else HULL
    with_line, without = (
        in_memory(load_rig(path, None, ["duration_s=1.0", *settings]))
        for settings in (FAST[kind], ())
    )
    for node in ("executive", "plant"):
        one, other = with_line.node[node], without.node[node]
        assert set(one.columns) == set(other.columns)
        for name in one.columns:
            if not name.startswith("rx.HB_"):  # slow ones come a cycle later
                a, b = one.columns[name], other.columns[name]
                assert np.array_equal(a, b, equal_nan=True), name


def test_frames_that_do_not_switch_need_no_second_bit_rate(tmp_path: Path) -> None:
    nominal = (('"CANFD_BRS" "1"', '"CANFD_BRS" "0"'),)
    path = fd_rig(tmp_path, "bus: {emulate: 1M}", changes=nominal)
    rig = load_rig(path, None, ["rate_hz=500", "duration_s=0.3"])
    log, line = logged(rig, tmp_path / "log.mcap")
    assert (line.per_s, line.bit, line.fast) == (1_000_000, 1, 1)
    assert (line.errors.sum(), line.refused.sum(), line.lost_off.sum()) == (0, 0, 0)
    frames = log.node["executive"].frames
    assert {int(flags) for flags in frames["flags"][frames["id"] == FB]} == {Flag.FD}
    assert 600 < line.longest.max() < 800, "64 bytes at 1 Mbit/s"


@both
def test_equal_seeds_give_equal_runs_and_others_do_not(kind: str, tmp_path: Path) -> None:
    def run(name: str, seed: int) -> tuple[list[bytes], bytes]:
        rig = rig_of(kind, tmp_path / name, *ROUGH[kind], f"seed={seed}")
        log, line = logged(rig, tmp_path / name / "log.mcap")
        assert line.errors.sum() > 5
        columns = [node.columns[n].tobytes() for node in log.node.values() for n in node.columns]
        return columns, line.tobytes()

    once, again, other = run("a", 1), run("b", 1), run("c", 2)
    assert once == again
    assert once != other


FAULTS = """faults:
  stall: {kind: stall, node: executive, from: 100ms, for: 5ms}
  late: {kind: delay, frame: CMD, from: 200ms, for: 50ms, value: 3.0}"""
FD_FAULTS = """
  lost: {kind: loss, frame: FB, from: 0.05s, for: 0.05s, share: 0.3}
  bits: {kind: corruption, frame: CMD, from: 0.1s, for: 0.1s, share: 0.3, value: 3}
  back: {kind: delay, frame: FB, from: 0.15s, for: 0.03s, value: 3}
  size: {kind: length, frame: CMD, from: 0.1s, for: 0.1s, share: 0.2, value: 33}"""
WITHIN = """faults:
  stall: {kind: stall, node: plant, from: 100ms, for: 40ms}
  blocked: {kind: loss, frame: CMD, from: 80ms, for: 30ms}
  odd: {kind: stall, node: executive, from: 300ms, for: 20ms}
  deaf: {kind: loss, frame: FB, from: 290ms, for: 15ms}
supervisor: {fault_after_cycles: 100, hold_cycles: 100}"""  # a loss ends while its receiver stalls


@pytest.mark.parametrize("faults", ["", FAULTS, WITHIN], ids=["", "faults", "within"])
@pytest.mark.parametrize(
    ("kind", "settings"),
    [("classic", ("bus.emulate=350k",)), ("classic", ROUGH["classic"]), ("classic", ()),
     ("fd", FAST["fd"]), ("fd", ROUGH["fd"])],
    ids=["late", "rough", "none", "fd-clean", "fd-rough"],
)  # fmt: skip
def test_the_run_is_recomputed_from_its_log(
    kind: str, settings: tuple[str, ...], faults: str, tmp_path: Path
) -> None:
    lines = faults + FD_FAULTS * (kind == "fd" and faults == FAULTS)
    _, line = logged(rig_of(kind, tmp_path, *settings, lines=(lines,)), tmp_path / "log.mcap")
    assert line is None or bool(line.errors.sum()) == (settings == ROUGH[kind])
    for verdict in replayed(tmp_path / "log.mcap"):
        assert verdict.identical, verdict


@both
def test_a_node_that_is_off_says_so_and_one_that_is_not_misses_the_other(
    kind: str, tmp_path: Path
) -> None:
    settings = "supervisor.hold_cycles=2", "supervisor.fault_after_cycles=5"
    rig = rig_of(kind, tmp_path, *FAST[kind], "bus.bit_error_rate=1.0", *settings)
    log, line = logged(rig, tmp_path / "log.mcap")
    assert line.times_off.sum() >= 1
    assert line.sent.sum() == 0
    faults = {name: set(node.columns["supervisor.fault"]) for name, node in log.node.items()}
    named = [Fault.BUS_OFF if off else Fault.INPUT_MISSING for off in line.times_off[:2]]
    assert [faults["executive"], faults["plant"]] == [{0, named[0]}, {0, named[1]}], faults


@both
@pytest.mark.parametrize("of", ["executive", "plant"])
def test_a_node_of_another_bit_rate_hears_nothing_nor_is_heard_and_the_run_is_recomputed(
    kind: str, of: str, tmp_path: Path
) -> None:
    rig = rig_of(kind, tmp_path, *FAST[kind], f"bus.bitrates={{{of}: 500000}}", "duration_s=5.0")
    log, line = logged(rig, tmp_path / "log.mcap")
    assert line.sent.sum() == 0 and (line.worst[:2] >= 128).all(), line.worst[:2]
    for name, node in log.node.items():
        assert 0 < len(node.cycle) < 1000, f"{name}: {len(node.cycle)} cycles, at most a second"
    faults = {fault for node in log.node.values() for fault in node.columns["supervisor.fault"]}
    assert faults & {Fault.BUS_OFF, Fault.INPUT_MISSING}, faults
    for verdict in replayed(tmp_path / "log.mcap"):
        assert verdict.identical, verdict


def test_bit_errors_put_esi_into_the_frames_of_their_sender(tmp_path: Path) -> None:
    rough = "bus.bit_error_rate=1.5e-3", "bus.error_burst=4", "supervisor.hold_cycles=100"
    rig = rig_of("fd", tmp_path, *FAST["fd"], *rough, "supervisor.fault_after_cycles=200")
    log, _ = logged(rig, tmp_path / "log.mcap")
    flags = {
        int(frame["flags"])
        for node in log.node.values()
        for frame in node.frames
        if frame["direction"] == 1 and frame["id"] in (CMD, FB)
    }
    assert flags == {Flag.FD | Flag.BRS, Flag.FD | Flag.BRS | Flag.ESI}


@pytest.mark.parametrize(
    ("kind", "rate", "fast"),
    [("classic", "1M", None), ("classic", "600k", None), ("classic", "450k", None),
     ("fd", "1M", 5_000_000), ("fd", "600k", 3_000_000), ("fd", "1M", 2_100_000)],
)  # fmt: skip
def test_no_frame_of_a_rig_takes_longer_than_its_analysis_says(
    kind: str, rate: str, fast: int | None, tmp_path: Path
) -> None:
    """A node's frames are queued at once: the last one waits for all; their real bits are fewer."""
    rig = rig_of(kind, tmp_path, f"bus.emulate={rate}", f"bus.data_bitrate={fast or 'null'}")
    _, line = logged(rig, tmp_path / "log.mcap")
    (frames,) = buses(rig)
    rows = response_rows(frames, Setup(rig.config.rate_hz, rig.config.bus.bits_per_s or 0, fast))
    longest = max(row.response_ns or 0 for row in rows)
    waited_ns = 1e9 * int(line.longest.max()) / int(line.per_s)
    assert 0.4 * longest < waited_ns <= longest, f"{waited_ns} ns, bound {longest} ns"


@pytest.mark.parametrize("text", ["500 kbit/s", "500k", "0.5 Mbit/s", "0.5M", "500000"])
def test_a_bit_rate_is_given_as_people_write_it(text: str) -> None:
    rig = load_rig(PROBE, None, [f"bus.emulate={text}", "bus.bitrate=1000000"])
    assert rig.config.bus.bits_per_s == 500_000


@pytest.mark.parametrize(
    ("kind", "line", "said"),
    [("classic", "{emulate: 2M}", "classic CAN"),
     ("fd", "{emulate: 1M}", "CMD switches its bit rate; give bus.data_bitrate"),
     ("fd", "{emulate: 1M, data_bitrate: 500000}", "data at 500000 bit/s is slower than the nomi"),
     ("fd", "{emulate: 999983, data_bitrate: 4999999}", "no clock up to 9 GHz gives both 999983"),
     ("fd", "{emulate: 2M, data_bitrate: 5000000}", "CAN FD before its switch too")],
)  # fmt: skip
def test_a_line_that_cannot_be_is_refused_with_its_place(
    kind: str, line: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(RigError, match=said) as error:
        VirtualRun(rig_of(kind, tmp_path, lines=(f"bus: {line}",)), None)
    assert "bus.emulate" in str(error.value)


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

"""A rig with CAN FD frames over an emulated line, in virtual time."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fd_rig import fd_rig
from test_over_line import CMD, FB, delays, logged

from pcpc.drivers.can.wire_layout import Flag
from pcpc.executive.errors import RigError
from pcpc.executive.loop.faults import Fault
from pcpc.executive.nodes.virtual import VirtualRun, in_memory, simulate
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.replay import replay
from pcpc.tools.start.bus.traffic import Setup, buses, response_rows
from pcpc.tools.terminal.progress import Progress

FAST = "bus: {emulate: 1 Mbit/s, data_bitrate: 5000000}"


def rig_of(folder: Path, *settings: str, lines: tuple[str, ...] = (FAST,)) -> Rig:
    return load_rig(fd_rig(folder, *lines), None, ["duration_s=0.3", *settings])


def test_a_line_that_is_fast_enough_changes_no_bit_of_what_the_laws_see(tmp_path: Path) -> None:
    with_line = in_memory(rig_of(tmp_path))
    without = in_memory(rig_of(tmp_path, "bus.emulate=null"))
    for node in ("executive", "plant"):
        one, other = with_line.node[node], without.node[node]
        assert set(one.columns) == set(other.columns)
        for name in one.columns:
            if not name.startswith("rx.HB_"):  # slow ones come a cycle later
                a, b = one.columns[name], other.columns[name]
                assert np.array_equal(a, b, equal_nan=True), name


@pytest.mark.parametrize(
    ("fast", "phase", "late_cmd", "late_fb"),
    [(5_000_000, 0.4, 1, 0),
     (1_500_000, 0.4, 2, 0),  # SYNC and CMD take 0.44 ms
     (1_500_000, 0.7, 1, 1),  # FB takes 0.46 ms
     (5_000_000, 0.7, 1, 0)],
)  # fmt: skip
def test_what_decides_is_the_second_bit_rate(
    fast: int, phase: float, late_cmd: int, late_fb: int, tmp_path: Path
) -> None:
    rig = rig_of(tmp_path, f"bus.data_bitrate={fast}", f"realtime.plant.phase={phase}")
    log, line = logged(rig, tmp_path / "log.mcap")
    assert delays(log, CMD, "executive", "plant") == {late_cmd}
    assert delays(log, FB, "plant", "executive") == {late_fb}
    assert (line.errors.sum(), line.refused.sum(), line.lost_off.sum()) == (0, 0, 0)


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


ROUGH = ("bus.emulate=800k", "bus.bit_error_rate=3e-4", "bus.error_burst=3", "bus.queue=8")
FAULTS = """faults:
  lost: {kind: loss, frame: FB, from: 0.05s, for: 0.05s, share: 0.3}
  bits: {kind: corruption, frame: CMD, from: 0.1s, for: 0.1s, share: 0.3, value: 3}
  late: {kind: delay, frame: FB, from: 0.15s, for: 0.03s, value: 3}
  size: {kind: length, frame: CMD, from: 0.1s, for: 0.1s, share: 0.2, value: 33}
  stall: {kind: stall, node: executive, from: 0.2s, for: 5ms}"""


@pytest.mark.parametrize("settings", [(), ROUGH], ids=["clean", "rough"])
@pytest.mark.parametrize("faults", [(), (FAULTS,)], ids=["", "faults"])
def test_the_run_is_recomputed_from_its_log(
    settings: tuple[str, ...], faults: tuple[str, ...], tmp_path: Path
) -> None:
    run = simulate(rig_of(tmp_path, *settings, lines=(FAST, *faults)), tmp_path / "log.mcap")
    line: Any = run.over[0]
    assert bool(line.errors.sum()) == bool(settings)
    options = argparse.Namespace(controller=None, set=[], node="all")
    for verdict in replay(tmp_path / "log.mcap", options, Progress(quiet=True)):
        assert verdict.identical, verdict


def test_bit_errors_put_the_sender_off_and_esi_into_its_frames(tmp_path: Path) -> None:
    settings = ("supervisor.hold_cycles=2", "supervisor.fault_after_cycles=5")
    log, line = logged(rig_of(tmp_path, "bus.bit_error_rate=1.0", *settings), tmp_path / "a.mcap")
    assert line.times_off.sum() >= 1 and line.sent.sum() == 0
    faults = {name: set(node.columns["supervisor.fault"]) for name, node in log.node.items()}
    named = [Fault.BUS_OFF if off else Fault.INPUT_MISSING for off in line.times_off[:2]]
    assert [faults["executive"], faults["plant"]] == [{0, named[0]}, {0, named[1]}], faults

    rough = ("bus.bit_error_rate=1.5e-3", "bus.error_burst=4", "supervisor.hold_cycles=100")
    log, _ = logged(rig_of(tmp_path, *rough, "supervisor.fault_after_cycles=200"), tmp_path / "b")
    flags = {
        int(frame["flags"])
        for node in log.node.values()
        for frame in node.frames
        if frame["direction"] == 1 and frame["id"] in (CMD, FB)
    }
    assert flags == {Flag.FD | Flag.BRS, Flag.FD | Flag.BRS | Flag.ESI}


@pytest.mark.parametrize(
    ("rate", "fast"), [("1M", 5_000_000), ("600k", 3_000_000), ("1M", 2_100_000)]
)
def test_no_frame_of_a_rig_takes_longer_than_its_analysis_says(
    rate: str, fast: int, tmp_path: Path
) -> None:
    """A node's frames are queued at once: the last one waits for all; their real bits are fewer."""
    rig = rig_of(tmp_path, lines=(f"bus: {{emulate: {rate}, data_bitrate: {fast}}}",))
    _, line = logged(rig, tmp_path / "log.mcap")
    (frames,) = buses(rig)
    setup = Setup(rig.config.rate_hz, rig.config.bus.bits_per_s or 0, fast)
    rows = response_rows(frames, setup)
    longest = max(row.response_ns or 0 for row in rows)
    waited_ns = 1e9 * int(line.longest.max()) / int(line.per_s)
    assert 0.4 * longest < waited_ns <= longest, f"{waited_ns} ns, bound {longest} ns"


@pytest.mark.parametrize(
    ("line", "said"),
    [("{emulate: 1M}", "CMD switches its bit rate; give bus.data_bitrate"),
     ("{emulate: 1M, data_bitrate: 500000}", "data at 500000 bit/s is slower than the nominal"),
     ("{emulate: 999983, data_bitrate: 4999999}", "no clock up to 9 GHz gives both 999983 and"),
     ("{emulate: 2M, data_bitrate: 5000000}", "CAN FD before its switch too")],
)  # fmt: skip
def test_a_line_that_cannot_be_is_refused_with_its_place(
    line: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(RigError, match=said) as error:
        VirtualRun(rig_of(tmp_path, lines=(f"bus: {line}",)), None)
    assert "bus.emulate" in str(error.value)

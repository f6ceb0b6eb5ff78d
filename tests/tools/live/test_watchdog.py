"""The independent watch: what it makes of a run's frames, and of real processes that go wrong."""

import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fd_rig import fd_rig
from numpy.typing import NDArray
from places import PATIENCE_S
from processes import ATB1000, DEADLINE_S, own_bus, until

import pcpc
from pcpc.drivers.can import can_id, codec, e2e
from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.faults import Fault
from pcpc.executive.nodes.live import find
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.cli import main
from pcpc.tools.live.watchdog.frame_judge import FrameJudge

SILENT, WRONG = 20, 3
BYTES = {"classic": 1, "fd": 12}  # of the stop frame
PATIENT = "hold_cycles: 100000, fault_after_cycles: 100000, quick_stop_s: 0.02"
CMD, SYNC, FB_A, HB_PLANT = 160, 128, 288, 1794
FB = FB_A  # of the probe


def stop_frame(kind: str) -> tuple[tuple[str, str], ...]:
    """Return the changes of a DBC file that give it a stop frame."""
    sends = 'BA_ "GenMsgSendType" BO_ 1793 1;'
    fd = 'BA_ "VFrameFormat" BO_ 15 14;\n' if kind == "fd" else ""
    return (
        ('"EveryCycle","Cyclic"', '"EveryCycle","Cyclic","Event"'),
        ("BO_ 1793 HB", f"BO_ 15 ESTOP: {BYTES[kind]} Vector__XXX\n"
         ' SG_ pressed : 0|1@1+ (1,0) [0|1] "" EXEC,PLANT\n\nBO_ 1793 HB'),
        (sends, f'BA_ "GenMsgSendType" BO_ 15 2;\n{fd}{sends}'),
    )  # fmt: skip


def fd_file(folder: Path, *lines: str) -> Path:
    """Write the rig of the probe on CAN FD at 200 Hz with a stop frame of 12 bytes."""
    lines = (f"supervisor: {{{PATIENT}, stop_frame: ESTOP}}", "rate_hz: 200.0", "title: x", *lines)
    path = fd_rig(folder, *lines, changes=stop_frame("fd"))
    text = path.read_text().replace("rig: probe_fd", f"rig: watched-{os.getpid()}")
    path.write_text(text.replace("duration_s: 0.6\n", ""))
    return path


def rig_file(folder: Path, *lines: str, stop: str = "stop_frame: ESTOP") -> Path:
    """Write the hull rig at 200 Hz with a stop frame and a watchdog."""
    text = (ATB1000 / "atb1000.dbc").read_text()
    for line, other in stop_frame("classic"):
        assert text.count(line) == 1, line
        text = text.replace(line, other)
    (folder / "stop.dbc").write_text(text)
    path = folder / "rig.yaml"
    if not any("duration_s" in line for line in lines):
        lines = (*lines, "duration_s: 1.0")
    path.write_text("\n".join((
        f"base: {ATB1000}/rig.yaml", f"rig: watched-{os.getpid()}", "dbc: stop.dbc",
        "rate_hz: 200.0", f"supervisor: {{{PATIENT}, {stop}}}", *lines,
        "title: a step, watched", "executive:",
        "  limits: {CMD.motor_torque: {low: -2.0, high: 2.0, rate_per_s: 400.0}}",
        "  blocks:",
        "    reference: {law: references:step, parameters: {amplitude_rad: 0.1, start_s: 0.0}}", "",
    )))  # fmt: skip
    return path


# What the watch makes of frames


@dataclass
class Recorded:
    """A clean run: its rig, and the frames of each cycle as they were on the bus."""

    rig: Rig
    cycles: list[NDArray[np.uint8]]

    def watched(self, change: "Change | None" = None, clocked: bool = True) -> tuple[int, str]:
        """Return cycle and words of the first trouble, -1 without; `change` gets each cycle."""
        watch = FrameJudge(self.rig, clocked)
        for k, frames in enumerate(self.cycles):
            came = frames.copy() if change is None else change(k, frames.copy())
            watch.cycle = float(k)
            watch.judge(came)
            for _, what in watch.troubles():
                return k, what
        return -1, ""


Change = Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]]


def recorded(rig: Rig, log: Path, silent: int = 200) -> Recorded:
    """Run a rig; return what was on its bus, and a silence behind its end."""
    simulate(rig, log)
    cycles: dict[int, list[NDArray[np.uint8]]] = {}
    for node in logs.read(log).node.values():
        sent = node.frames[node.frames["direction"] == 0]
        for k, raw in zip(sent["cycle"].tolist(), logs.on_bus(sent), strict=True):
            cycles.setdefault(k, []).append(raw)
    nothing = np.zeros((1, len(cycles[0][0])), np.uint8)
    return Recorded(rig, [np.array(cycles.get(k, nothing)) for k in range(max(cycles) + silent)])


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("clean")
    rig = load_rig(rig_file(folder, "watchdog: {silent_cycles: 20}", "duration_s: 4.0"))
    return recorded(rig, folder / "log.mcap")


@pytest.fixture(scope="module")
def on_fd(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("fd")
    rig = load_rig(fd_file(folder, "watchdog: {silent_cycles: 40}", "duration_s: 0.6"))
    return recorded(rig, folder / "log.mcap", 0)


def of(can: int, frames: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which of some frames have an id."""
    return np.ascontiguousarray(frames[:, :4]).view("<u4")[:, 0] == can


def without(can: int, after: int) -> Change:
    return lambda k, frames: frames[~of(can, frames)] if k >= after else frames


def test_a_clean_run_is_no_trouble_nor_is_the_silence_behind_its_end(clean: Recorded) -> None:
    assert len(clean.cycles) > 600 and clean.watched() == (-1, "")
    assert clean.watched(clocked=False) == (-1, "")


@pytest.mark.parametrize(("can", "name"), [(CMD, "CMD"), (SYNC, "SYNC"), (FB_A, "FB_A")])
def test_a_frame_of_every_cycle_that_stays_away_is_told_in_time(
    clean: Recorded, can: int, name: str
) -> None:
    k, what = clean.watched(without(can, 100))
    assert k == 99 + SILENT + 1 and f"{name} did not come for 21 cycles" in what, (k, what)
    assert clean.watched(without(can, 100), clocked=False) == (-1, ""), "lockstep has no clock"


def test_of_a_slow_frame_three_of_its_cycles_have_to_pass(clean: Recorded) -> None:
    k, what = clean.watched(without(HB_PLANT, 100))
    assert 100 + 60 - 20 <= k <= 100 + 61 and "HB_PLANT did not come" in what, (k, what)


def test_a_node_that_falls_silent_is_one_trouble(clean: Recorded) -> None:
    k, what = clean.watched(lambda k, frames: frames[:0] if k >= 100 else frames)
    assert k == 99 + SILENT + 1 and what.startswith("executive: SYNC and "), (k, what)


def changed(rig: Rig, can: int, change: Callable[[int, Any], None], seal: bool = True) -> Change:
    """Return what changes the values of a frame from cycle 100 on, with a CRC that is right."""
    watch = FrameJudge(rig, True)
    row = watch.by_word[can_id.word_of(can, False)]
    frames, table = watch.table.frames, watch.table
    values = np.zeros(len(watch.places))

    def spoil(k: int, came: NDArray[np.uint8]) -> NDArray[np.uint8]:
        for frame in came[of(can, came)] if k >= 100 else ():
            codec.unpack(frame[8:], row, frames, table.signals, values)
            counter = int(frame[14] & 15)
            change(k, (frame, values, watch.places))
            if seal:
                codec.pack(frame[8:], row, frames, table.signals, values)
                e2e.protect(frame[8:], row, frames, counter)
            came[of(can, came)] = frame
        return came

    return spoil


def _torque(value: Callable[[int], float]) -> Callable[[int, Any], None]:
    def change(k: int, given: Any) -> None:
        _, values, places = given
        values[places["CMD.motor_torque"]] = value(k)

    return change


def test_a_command_beyond_its_limits_or_its_rate_is_told_after_three(clean: Recorded) -> None:
    rig = clean.rig
    k, what = clean.watched(changed(rig, CMD, _torque(lambda k: 2.001)))
    assert k == 100 + WRONG - 1 and "motor_torque = 2.001, outside its limits" in what, what
    assert clean.watched(changed(rig, CMD, _torque(lambda k: 2.0)))[0] == -1, "at its limit"
    assert clean.watched(changed(rig, CMD, _torque(lambda k: k % 2 * 2.0)))[0] == -1, "its rate"
    k, what = clean.watched(changed(rig, CMD, _torque(lambda k: k % 2 * 2.0 - 0.01 * (k % 2))))
    assert k == -1, what
    k, what = clean.watched(changed(rig, CMD, _torque(lambda k: k % 2 * 3.9 - 1.95)))
    assert k == 100 + WRONG and "motor_torque, which changes faster" in what, (k, what)
    assert clean.watched(changed(rig, CMD, _torque(lambda k: 2.001)), clocked=False)[0] == 102


def test_two_odd_frames_of_ten_are_none(clean: Recorded) -> None:
    odd = changed(clean.rig, CMD, _torque(lambda k: 2.001))
    assert clean.watched(lambda k, f: odd(k, f) if k % 10 < 2 else f)[0] == -1
    k, what = clean.watched(lambda k, f: odd(k, f) if k % 10 < 3 else f)
    assert k == 102 and "3 of the last 10 are wrong" in what, (k, what)


def test_a_wrong_crc_and_a_counter_that_stands_are_told(clean: Recorded) -> None:
    def flip(k: int, given: Any) -> None:
        given[0][8] ^= 4

    k, what = clean.watched(changed(clean.rig, CMD, flip, seal=False))
    assert k == 102 and "CMD is ERROR; 3 of the last 10 are wrong" in what, (k, what)
    first = clean.cycles[99][of(CMD, clean.cycles[99])]

    def stand(k: int, frames: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if k >= 100:
            frames[of(CMD, frames)] = first
        return frames

    k, what = clean.watched(stand)
    assert k == 102 and "CMD is REPEATED" in what, (k, what)


def spoilt(can: int, byte: int, bits: int) -> Change:
    """Return what changes a byte of the frames of an id from cycle 50 on; 5 says the kind."""

    def change(k: int, frames: NDArray[np.uint8]) -> NDArray[np.uint8]:
        frames[of(can, frames) & (k >= 50), byte] ^= bits
        return frames

    return change


LONG: dict[str, tuple[Change | None, str]] = {
    "clean": (None, ""),
    "classic": (spoilt(FB, 5, 5), "plant: FB is ERROR; 3 of the last"),
    "a bit behind the eighth byte": (spoilt(CMD, 48, 16), "executive: CMD is ERROR; 3 of the last"),
    "the last but one": (spoilt(FB, 70, 16), "plant: FB is ERROR; 3 of the last"),
    "away": (without(CMD, 50), "CMD did not"),
}


@pytest.mark.parametrize("name", LONG)
def test_long_frames_are_judged_by_all_their_bytes(name: str, on_fd: Recorded) -> None:
    change, says = LONG[name]
    said = on_fd.watched(change)[1]
    assert says in said and bool(said) is bool(says), said


WITHOUT = {
    "no frame": ("watchdog: {}", "ramp_s: 0.05", "a watchdog needs a frame that stops the rig"),
    "too eager": (
        "watchdog: {silent_cycles: 1}",
        "stop_frame: ESTOP",
        "expected a whole number >= 2",
    ),
}


@pytest.mark.parametrize(("line", "stop", "says"), WITHOUT.values(), ids=WITHOUT)
def test_a_rig_that_cannot_be_watched_is_refused_with_its_line(
    tmp_path: Path, line: str, stop: str, says: str
) -> None:
    with pytest.raises(RigError, match=says) as told:
        simulate(load_rig(rig_file(tmp_path, line, stop=stop)), tmp_path / "log.mcap")
    assert "rig.yaml:6" in str(told.value), told.value


# Real processes


@pytest.fixture
def fed(tmp_path: Path) -> Iterator[int]:
    """Return the end of a pipe in the place of /dev/watchdog."""
    os.mkfifo(tmp_path / "watchdog")
    reader = os.open(tmp_path / "watchdog", os.O_RDONLY | os.O_NONBLOCK)
    yield reader
    os.close(reader)


def all_of(reader: int) -> bytes:
    """Return what is in a pipe."""
    found = b""
    while True:
        try:
            part = os.read(reader, 65536)
        except BlockingIOError:
            return found
        if not part:
            return found
        found += part


def watched_rig(folder: Path, duration: str, kind: str = "classic") -> Path:
    lines = f"watchdog: {{silent_cycles: {SILENT}, feed: {folder}/watchdog}}"
    write = fd_file if kind == "fd" else rig_file
    return write(folder, lines, f"duration_s: {duration}")


def test_a_clean_run_feeds_the_device_to_its_orderly_end(tmp_path: Path, fed: int) -> None:
    rig = watched_rig(tmp_path, "1.0")
    with pcpc.running(rig, bus=own_bus(), folder=tmp_path / "run") as live:
        live.wait(120.0)
    assert live.run.verdict.startswith("ok"), live.run.summary["faults"]
    data = all_of(fed)
    assert len(data) > 10 and data.strip(b"\0") == b"V" and data.endswith(b"V"), data


@pytest.mark.parametrize("kind", BYTES)
def test_an_executive_that_stands_still_is_stopped_by_its_frame_alone(
    kind: str, tmp_path: Path, fed: int
) -> None:
    rig = watched_rig(tmp_path, "600.0", kind)
    with pcpc.running(rig, bus=own_bus(), folder=tmp_path / "run") as live:
        plant, executive = (find(role, f"watched-{os.getpid()}") for role in ("plant", "executive"))
        until(lambda: all_of(fed), "the first food")
        os.kill(executive.pid, signal.SIGSTOP)
        plant.wait_until(lambda now: now["supervisor.fault"] == Fault.STOP_FRAME, DEADLINE_S)
        plant.wait_until(lambda now: now["supervisor.gain"] == 0.0, DEADLINE_S)
        all_of(fed)
        os.kill(executive.pid, signal.SIGCONT)
        live.wait(PATIENCE_S)
    assert all_of(fed) == b"", "no food behind the stop, and no V"
    said = [line for line in live.run.summary["faults"] if "watchdog: executive" in line]
    assert said and "did not come for" in said[0] and said[0].endswith("ESTOP sent"), live.run
    assert live.run.verdict.startswith("safety stop")
    frames = live.run.log.node["plant"].frames
    stops = frames[frames["id"] == 15]
    assert len(stops) and set(stops["dlc"]) == {BYTES[kind]}
    if kind == "fd":
        assert set(stops["flags"]) == {5}


def test_a_watchdog_without_a_device_or_a_stop_frame_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = str(rig_file(tmp_path))
    assert main(["watchdog", rig, "--bus", own_bus(), "--feed", str(tmp_path / "none")]) == 4
    error = capsys.readouterr().err
    assert "none: cannot be fed: No such file or directory" in error, error
    assert main(["watchdog", "hull", "--bus", own_bus()]) == Exit.WRONG_INPUT
    error = capsys.readouterr().err
    assert "a watchdog needs a frame that stops the rig" in error and error.count("\n") == 1, error

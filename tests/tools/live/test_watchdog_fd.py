"""The independent watch of a rig on CAN FD: its frames, and a stop frame of CAN FD."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fd_rig import fd_rig
from processes import own_bus

import pcpc
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.faults import Fault
from pcpc.executive.nodes.live import find
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.live.watchdog.frame_judge import FrameJudge

CMD, FB = 0xA0, 0x120
STOP = (
    ('"EveryCycle","Cyclic"', '"EveryCycle","Cyclic","Event"'),
    (
        "BO_ 1793 HB",
        "BO_ 15 ESTOP: 12 Vector__XXX\n"
        ' SG_ pressed : 0|1@1+ (1,0) [0|1] "" EXEC,PLANT\n\nBO_ 1793 HB',
    ),
    (
        'BA_ "GenMsgSendType" BO_ 1793 1;',
        'BA_ "GenMsgSendType" BO_ 15 2;\nBA_ "VFrameFormat" BO_ 15 14;\n'
        'BA_ "GenMsgSendType" BO_ 1793 1;',
    ),
)
PATIENT = "hold_cycles: 1000000, fault_after_cycles: 1000000, quick_stop_s: 0.02"
LINES = (
    f"supervisor: {{{PATIENT}, stop_frame: ESTOP}}",
    "watchdog: {silent_cycles: 40}",
    "rate_hz: 200.0",
    "title: watched on CAN FD",
)


def watched(folder: Path, duration: str) -> Path:
    """Write the rig, whose name is this process's own."""
    path = fd_rig(folder, *LINES, changes=STOP)
    text = path.read_text().replace("rig: probe_fd", f"rig: watched-fd-{os.getpid()}")
    path.write_text(text.replace("duration_s: 0.6", f"duration_s: {duration}"))
    return path


Change = Callable[[int, Any], Any]


def classic(of: int) -> Change:
    """Make the frames of an id classic ones of the same length."""

    def change(k: int, frames: Any) -> Any:
        ids = np.ascontiguousarray(frames[:, :4]).view("<u4")[:, 0]
        frames[(ids == of) & (k >= 50), 5] = 0
        return frames

    return change


def flipped(of: int, byte: int) -> Change:
    """Flip a bit of the data of an id."""

    def change(k: int, frames: Any) -> Any:
        ids = np.ascontiguousarray(frames[:, :4]).view("<u4")[:, 0]
        frames[(ids == of) & (k >= 50), 8 + byte] ^= 16
        return frames

    return change


CASES: dict[str, tuple[Change, str]] = {
    "clean": (lambda k, frames: frames, ""),
    "classic": (classic(FB), "plant: FB is ERROR; 3 of the last"),
    "a bit behind the eighth byte": (flipped(CMD, 40), "executive: CMD is ERROR; 3 of the last"),
    "the last but one": (flipped(FB, 62), "plant: FB is ERROR; 3 of the last"),
    "away": (lambda k, frames: frames[frames[:, 4] != 48] if k >= 50 else frames, "CMD did not"),
}


@pytest.mark.parametrize("name", CASES)
def test_long_frames_are_judged_by_all_their_bytes(name: str, tmp_path: Path) -> None:
    change, says = CASES[name]
    rig = load_rig(watched(tmp_path, "0.6"))
    simulate(rig, tmp_path / "log.mcap")
    log, cycles = logs.read(tmp_path / "log.mcap"), dict[int, list[Any]]()
    for node in log.node.values():
        sent = node.frames[node.frames["direction"] == 0]
        for k, raw in zip(sent["cycle"].tolist(), logs.on_bus(sent), strict=True):
            cycles.setdefault(k, []).append(raw)
    judge, said = FrameJudge(rig, True), ""
    for k in range(110):
        judge.cycle = float(k)
        judge.judge(change(k, np.stack(cycles[k])))
        said = said or "".join(what for _, what in judge.troubles())
    assert said.startswith(says) or (name == "away" and says in said), said
    assert bool(said) is bool(says), said


def test_a_stop_frame_of_can_fd_stops_the_plant_of_a_silent_executive(tmp_path: Path) -> None:
    rig = watched(tmp_path, "600.0")
    with pcpc.running(rig, bus=own_bus(), folder=tmp_path / "run") as live:
        roles = "plant", "executive"
        plant, executive = (find(role, f"watched-fd-{os.getpid()}") for role in roles)
        plant.wait_until(lambda now: now["supervisor.state"] == 2.0, 60.0)
        os.kill(executive.pid, signal.SIGSTOP)
        plant.wait_until(lambda now: now["supervisor.fault"] == Fault.STOP_FRAME, 60.0)
        os.kill(executive.pid, signal.SIGCONT)
        live.wait(60.0)
    said = [line for line in live.run.summary["faults"] if "watchdog: executive" in line]
    assert said and said[0].endswith("ESTOP sent"), live.run
    frames = live.run.log.node["plant"].frames
    stops = frames[frames["id"] == 15]
    assert len(stops) and set(stops["flags"]) == {5} and set(stops["dlc"]) == {12}

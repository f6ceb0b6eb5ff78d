"""A generated device on CAN FD: the bits of the executive, and frames of the wrong kind."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from fd_rig import fd_rig
from processes import own_bus, pcpc

from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import diff

CYCLES = 600
SYNC, CMD, FB, HB_EXEC, HB_PLANT = 0x080, 0x0A0, 0x120, 0x701, 0x702
BITRATES = "bus: {bitrate: 1000000, data_bitrate: 5000000}"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the rig, and its device, compiled without a warning."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    folder = tmp_path_factory.mktemp("fd")
    rig = fd_rig(folder, BITRATES)
    done = pcpc("generate", "c", str(rig), "--device", "-o", str(folder / "c"))
    assert done.code == 0, done
    words = ["make", "-s", "-C", str(folder / "c"), "linux", "CFLAGS=-O2 -Werror"]
    compiled = subprocess.run(words, capture_output=True, text=True)
    assert (compiled.returncode, compiled.stdout + compiled.stderr) == (0, "")
    return rig, folder / "c" / "linux"


def test_it_gives_the_bits_of_the_executive(made: tuple[Path, Path], tmp_path: Path) -> None:
    rig, device = made
    simulated, run = tmp_path / "simulated", tmp_path / "run"
    assert pcpc("simulate", str(rig), "-o", str(simulated), "--no-figure").code == 0
    words = ("plant", str(rig), "--bus", own_bus(), "-o", str(run), "--json", "--no-figure")
    done = pcpc(*words, "--pacing", "lockstep", "--device", str(device), "{bus}")
    assert done.code == 0, done
    assert done.summary["device"]["problems"] == []
    assert done.summary["device"]["frames"]["CMD"] == {"received": CYCLES + 1, "ok": CYCLES + 1}
    log = logs.read(simulated / "log.mcap")
    alone = logs.Log(log.path, {"plant": log.node["plant"]}, {}, log.metadata, [])
    report = diff.compare(alone, logs.read(run / "log.mcap"))
    assert report.equal, report
    assert report.frames > 3 * CYCLES
    replayed = pcpc("replay", str(run), "--node", "device", "--json")
    assert replayed.code == 0 and json.loads(replayed.out)[0]["identical"], replayed


CHANGES = {
    "as it is": {},
    "error passive": {"error_state_indicator": True},
    "classic": {"is_fd": False, "bitrate_switch": False, "data": bytes(8)},
    "without a switch": {"bitrate_switch": False},
    "cut": {"data": bytes(48)},
}


@pytest.mark.parametrize("kind", CHANGES)
def test_it_takes_feedback_of_its_kind_only(
    kind: str, made: tuple[Path, Path], tmp_path: Path
) -> None:
    """The plant's recorded feedback answers each SYNC."""
    rig, device = made
    simulated = pcpc("simulate", str(rig), "-o", str(tmp_path / "run"), "--no-figure")
    assert simulated.code == 0, simulated
    frames = logs.read(tmp_path / "run" / "log.mcap").node["plant"].frames
    mine = frames[(frames["direction"] == 0) & (frames["id"] == FB)]["data"]
    bus = own_bus()
    _, group, port = bus.split(":")
    with can.Bus(interface="udp_multicast", channel=group, port=int(port)) as end:
        process = subprocess.Popen([str(device), bus, "100"])
        try:
            heard = list(answers(end, [row.tobytes() for row in mine[:60]], CHANGES[kind]))
        finally:
            process.kill()
            process.wait()
    commands = [one for one in heard if one.arbitration_id == CMD]
    assert all(one.is_fd and one.bitrate_switch and len(one.data) == 48 for one in commands)
    assert (len(commands) > 40) is (kind in ("as it is", "error passive")), len(commands)
    assert not any(one.is_fd for one in heard if one.arbitration_id == HB_EXEC)


def answers(
    end: can.BusABC, feedback: list[bytes], change: dict[str, Any]
) -> Iterator[can.Message]:
    """Yield what the device sends, until it is silent or all feedback was sent."""
    while (message := end.recv(20.0 if len(feedback) == 60 else 1.0)) is not None:
        yield message
        if message.arbitration_id == HB_EXEC:
            end.send(can.Message(arbitration_id=HB_PLANT, is_extended_id=False, data=b"\5"))
        if message.arbitration_id == SYNC:
            if not feedback:
                return
            told = {"is_fd": True, "bitrate_switch": True, "data": feedback.pop(0), **change}
            end.send(can.Message(arbitration_id=FB, is_extended_id=False, **told))

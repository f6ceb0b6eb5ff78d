"""A rig's executive as a device in C: on Linux, and in QEMU on a Cortex-M that speaks slcan.

On classic CAN and on CAN FD.
"""

import ctypes
import json
import random
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from fd_rig import PROBE, fd_rig
from processes import PCPC, ROOT, Done, own_bus, pcpc

from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log import diff
from pcpc.tools.make.generate.device import device
from pcpc.tools.start.rigs import find

pytestmark = pytest.mark.deep

CYCLES = 500
SHORT = ("--set", f"duration_s={CYCLES / 1000}", "--no-figure")
SYNC, CMD, FB, HB_EXEC, HB_PLANT = 0x080, 0x0A0, 0x120, 0x701, 0x702


def made(folder: Path, target: str) -> None:
    """Make one target of a device's folder, without a warning."""
    compiler = "cc" if target == "linux" else "arm-none-eabi-gcc"
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}; make firmware-tools")
    words = ["make", "-s", "-C", str(folder), target, "CFLAGS=-O2 -Werror"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stdout + done.stderr) == (0, ""), done


KILLED = """
import os, select, signal, subprocess, sys
from pcpc.tools.make.device import slcan
bus, commands = slcan.open_bus(sys.argv[2]), 0
device = subprocess.Popen([*sys.argv[1:3], "0", "100"])
while commands < 60:
    select.select((bus,), (), (), 60.0)
    commands += sum(frame.word == 0x0A0 for frame in bus.frames())
device.kill()
os.kill(os.getpid(), signal.SIGKILL)
"""


@dataclass(frozen=True)
class Held:
    """A rig whose executive is a device: its files, and the plant's record in virtual time."""

    rig: tuple[str, ...]
    folder: Path
    plant: logs.Log


def held(folder: Path, rig: str, controller: str | None = None) -> Held:
    """Write a rig's law as a device, and simulate it."""
    loaded = load_rig(find(rig), controller, [f"duration_s={CYCLES / 1000}"])
    for name, text in device(loaded).items():
        (folder / name).write_text(text)
    words = (rig, *(("--controller", controller) if controller else ()), *SHORT)
    done = pcpc("simulate", *words, "-o", str(folder / "run"))
    assert done.ran, done
    log = logs.read(folder / "run" / "log.mcap")
    plant = logs.Log(log.path, {"plant": log.node["plant"]}, {}, log.metadata, [])
    return Held(words, folder, plant)


@pytest.fixture(scope="module")
def barrel(tmp_path_factory: pytest.TempPathFactory) -> Held:
    """Return the barrel's networks as a device."""
    return held(tmp_path_factory.mktemp("firmware"), "hull", "pd_nn_fast")


@pytest.fixture(scope="module")
def classic(tmp_path_factory: pytest.TempPathFactory) -> Held:
    """Return the probe's law as a device."""
    return held(tmp_path_factory.mktemp("classic"), str(PROBE / "rig.yaml"))


@pytest.fixture(scope="module")
def fd(tmp_path_factory: pytest.TempPathFactory) -> Held:
    """Return the same on CAN FD."""
    folder = tmp_path_factory.mktemp("fd")
    return held(folder, str(fd_rig(folder, "bus: {bitrate: 1000000, data_bitrate: 5000000}")))


def with_device(held: Held, folder: Path, *device: str, pacing: str = "lockstep") -> Done:
    words = ("run", "--only=plant", *held.rig, "--bus", own_bus(), "-o", str(folder), "--json")
    return pcpc(*words, "--pacing", pacing, "--device", *device)


def in_qemu(held: Held, target: str) -> list[str]:
    """Return the command of an image in QEMU, whose serial line is on the bus."""
    if shutil.which("qemu-system-arm") is None:
        pytest.skip("no qemu-system-arm; make firmware-tools")
    return [PCPC, "slcan", "{bus}", "--", "sh", str(held.folder / "qemu.sh"), target]


@pytest.mark.parametrize(
    ("name", "target"), [("barrel", "linux"), ("barrel", "m7"), ("barrel", "m4"), ("fd", "linux")]
)
def test_a_generated_device_gives_the_bits_of_the_executive(
    name: str, target: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    held: Held = request.getfixturevalue(name)
    made(held.folder, target)
    linux = [str(held.folder / "linux"), "{bus}"]
    device = linux if target == "linux" else in_qemu(held, target)
    done = with_device(held, tmp_path / "run", *device)
    assert done.ran, done
    log = logs.read(tmp_path / "run" / "log.mcap")
    report = diff.compare(held.plant, log)
    assert report.equal, report
    assert report.frames > (5 if name == "barrel" else 3) * CYCLES
    assert done.summary["device"]["frames"]["CMD"] == {"received": CYCLES + 1, "ok": CYCLES + 1}
    assert done.summary["device"]["problems"] == []
    replayed = pcpc("replay", str(tmp_path / "run"), "--node", "device", "--json")
    assert replayed.code == 0, replayed
    (told,) = json.loads(replayed.out)
    assert (told["cycles"], told["identical"]) == (CYCLES, True)
    assert told["frames"] > 2 * CYCLES


LONG = {"is_fd": True, "bitrate_switch": True}
CHANGES: dict[str, dict[str, Any]] = {
    "classic": {}, "classic cut": {"data": bytes(7)}, "classic as fd": LONG,
    "fd": LONG, "fd error passive": LONG | {"error_state_indicator": True},
    "fd as classic": {"data": bytes(8)}, "fd without a switch": LONG | {"bitrate_switch": False},
    "fd cut": LONG | {"data": bytes(48)},
}  # fmt: skip
TAKEN = "classic", "fd", "fd error passive"


@pytest.mark.parametrize("feedback", CHANGES)
def test_it_takes_feedback_of_its_kind_only(feedback: str, request: pytest.FixtureRequest) -> None:
    """The plant's recorded feedback answers each SYNC."""
    kind = feedback.partition(" ")[0]
    held: Held = request.getfixturevalue(kind)
    made(held.folder, "linux")
    frames = held.plant.node["plant"].frames
    mine = frames[(frames["direction"] == 0) & (frames["id"] == FB)][:60]
    data = [row["data"][: row["dlc"]].tobytes() for row in mine]
    bus = own_bus()
    _, group, port = bus.split(":")
    with can.Bus(interface="udp_multicast", channel=group, port=int(port)) as end:
        process = subprocess.Popen([str(held.folder / "linux"), bus, "100"])
        try:
            heard = list(answers(end, data, CHANGES[feedback]))
        finally:
            process.kill()
            process.wait()
    commands = [one for one in heard if one.arbitration_id == CMD]
    assert {one.is_fd and one.bitrate_switch for one in commands} <= {kind == "fd"}
    assert {len(one.data) for one in commands} <= {48 if kind == "fd" else 8}
    assert (len(commands) > 40) is (feedback in TAKEN), len(commands)
    assert not any(one.is_fd for one in heard if one.arbitration_id == HB_EXEC)


def answers(end: can.BusABC, data: list[bytes], change: dict[str, Any]) -> Iterator[can.Message]:
    """Yield what the device sends, until it is silent or all data was sent."""
    while (message := end.recv(20.0 if len(data) == 60 else 1.0)) is not None:
        yield message
        if message.arbitration_id == HB_EXEC:
            end.send(can.Message(arbitration_id=HB_PLANT, is_extended_id=False, data=b"\5"))
        if message.arbitration_id == SYNC:
            if not data:
                return
            told = {"data": data.pop(0), **change}
            end.send(can.Message(arbitration_id=FB, is_extended_id=False, **told))


def test_a_replay_by_another_law_differs_from_the_device(barrel: Held, tmp_path: Path) -> None:
    made(barrel.folder, "linux")
    done = with_device(barrel, tmp_path / "run", str(barrel.folder / "linux"), "{bus}")
    assert done.ran, done
    one = pcpc("replay", "--brief", str(tmp_path / "run"))
    assert one.code == 0 and "identical" in one.out, one
    changed = "--set", "controller.kv_Nms_rad=111", "--node", "device"
    replayed = pcpc("replay", str(tmp_path / "run"), *changed)
    assert replayed.code == 1 and "first difference: cycle " in replayed.out, replayed


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Held:
    """Write the probe's law as a device that runs on a clock of its own, at 100 Hz."""
    folder, words = tmp_path_factory.mktemp("probe"), ("rate_hz=100", "duration_s=2")
    rig = ROOT / "plants" / "probe" / "device" / "rig.yaml"
    for name, text in device(load_rig(rig, None, list(words))).items():
        (folder / name).write_text(text)
    made(folder, "linux")
    settings = [part for word in words for part in ("--set", word)]
    return Held((str(rig), *settings, "--no-figure"), folder, logs.Log(rig, {}, {}, {}, []))


def test_of_a_generated_device_that_is_killed_the_plant_comes_to_rest(
    probe: Held, tmp_path: Path
) -> None:
    device = sys.executable, "-c", KILLED, str(probe.folder / "linux"), "{bus}"
    done = with_device(probe, tmp_path / "run", *device, pacing="real")
    assert done.code == 5 and "device: ended by SIGKILL after " in str(done.summary), done
    command = logs.read(tmp_path / "run" / "log.mcap").node["plant"].columns["rx.CMD.command"]
    assert np.abs(command).max() > 0.5 and command[-1] == 0.0


def test_the_wrong_rate_of_a_generated_device_is_named(probe: Held, tmp_path: Path) -> None:
    device = str(probe.folder / "linux"), "{bus}", "0", "125"
    done = with_device(probe, tmp_path / "run", *device, pacing="sync")
    assert "Hz, the rig's is 100 Hz" in str(done.summary), done


def test_a_device_that_would_give_other_bits_refuses_to_run(barrel: Held, tmp_path: Path) -> None:
    made(barrel.folder, "linux")
    flags = "CFLAGS=-O2 -march=native -ffp-contract=fast"
    if "fma" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this processor joins no product and sum")
    folder = shutil.copytree(barrel.folder, tmp_path / "joined")
    makefile = folder / "Makefile"
    makefile.write_text(makefile.read_text().replace("-ffp-contract=off", ""))
    subprocess.run(["make", "-s", "-C", str(folder), "linux", flags], check=True)
    done = subprocess.run([str(folder / "linux"), own_bus()], capture_output=True, text=True)
    assert done.returncode == 4 and "-ffp-contract=off" in done.stderr, done


def test_sums_in_software_are_rounded_as_those_in_hardware(tmp_path: Path) -> None:
    source = ROOT / "tools" / "make" / "generate" / "c" / "soft_double.c"
    words = ["cc", "-O2", "-shared", "-fPIC", "-o", str(tmp_path / "soft.so"), str(source)]
    subprocess.run(words, check=True)
    soft = ctypes.CDLL(str(tmp_path / "soft.so")).soft_sum
    soft.restype, soft.argtypes = ctypes.c_double, [ctypes.c_double] * 2
    assert soft(1.0, -float.fromhex("0x1.3e26c2c5006c4p-33")) == float.fromhex(
        "0x1.fffffffec1d94p-1"
    )
    draw = random.Random(3)
    for _ in range(50_000):
        a = draw.getrandbits(64)
        near = min(max((a >> 52 & 2047) + draw.randrange(-66, 67), 0), 2047)
        b = draw.choice((draw.getrandbits(64), a ^ 1 << 63, near << 52 | draw.getrandbits(52)))
        x, y = struct.unpack("2d", struct.pack("2Q", a, b))
        expected, told = x + y, soft(x, y)
        if expected == expected:
            assert struct.pack("d", told) == struct.pack("d", expected), (x.hex(), y.hex())
        else:
            assert told != told


def test_what_only_the_executive_does_is_refused(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    plausible = "executive: {plausible: {FB_A.encoder: {high: 9.0}}}"
    rig.write_text(f"base: {Path(find('hull')).resolve()}\n{plausible}\n")
    for words, what in (
        ([str(rig)], "leave it to the rig's executive"),
        (["hull", "--set", "supervisor.arm=manual"], "--set supervisor.arm=automatic"),
    ):
        done = pcpc("generate", "c", *words, "--device", "-o", "firmware", cwd=tmp_path)
        assert done.code == 2 and what in done.err, done
        assert not (tmp_path / "firmware").exists()

"""The supervisor of a generated device against the executive's own, on the same disturbed input."""

import ctypes
import random
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcpc.drivers.can import dbc, e2e
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.replay import Replay
from pcpc.executive.nodes.slices import HEAD, PASSES, STAMP, K, Slice
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.make.generate.device import device
from pcpc.tools.start.rigs import find

CYCLES = 400
RATE_HZ = 1000.0
NAMES = ["supervisor.fault", "supervisor.gain", "supervisor.state"]
SEND = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
Sent = tuple[int, int, int, bytes]  # cycle, id, length, data


class Frame(ctypes.Structure):
    """A frame as codec.h has it."""

    _fields_ = (("id", ctypes.c_uint32), ("n", ctypes.c_uint8), ("data", ctypes.c_uint8 * 8))


SETTINGS = {
    "as it is": [],
    "slow commands": [
        f"executive.limits.CMD.motor_torque.{key}={value}"
        for key, value in (("low", -1.0), ("high", 1.5), ("rate_per_s", 5.0), ("safe", 0.25))
    ],
    "patient": ["supervisor.fault_after_cycles=40", "supervisor.hold_cycles=5"],
    "waits in fault": ["supervisor.on_fault=wait", "supervisor.ramp_s=0.02"],
}


def rig_of(how: str) -> Rig:
    end = f"duration_s={CYCLES / RATE_HZ}"
    return load_rig(find("hull"), "pd_nn_fast", [end, *SETTINGS[how]])


def disturbed(rig: Rig, seed: int) -> np.ndarray[Any, Any]:
    """Return what a plant sends, as a log has it; now and then a frame is lost or wrong."""
    draw, rows = random.Random(seed), list[tuple[Any, ...]]()
    plant = dbc.frames(messages.database_of(rig), rig.config.plant.node, "tx")
    tables = {frame.name: dbc.table([frame], RATE_HZ) for frame in plant}
    away = 0
    for k in range(CYCLES + 1):
        away = draw.choice((1, 2, 3, 4)) if k > 0 and draw.random() < 0.01 else max(away - 1, 0)
        away = 1 if k == 1 and seed % 2 else away
        for frame in plant:
            if k % frame.every_n(RATE_HZ) or away:
                continue
            data = np.frombuffer(draw.randbytes(8), np.uint8).copy() & 0x8F  # small numbers
            if frame.name.startswith("HB"):
                data[0] = 5
            data[frame.dlc :] = 0
            counter, kind = k // frame.every_n(RATE_HZ), draw.random() if k > 0 else 1.0
            counter += draw.choice((-1, 3, 7)) if kind < 0.01 else 0
            e2e.protect(data, 0, tables[frame.name].frames, counter)
            if 0.01 <= kind < 0.02:
                data[draw.randrange(frame.dlc)] ^= 1 << draw.randrange(4)
            if 0.02 <= kind < 0.025:
                continue
            row = (0, k, frame.can_id, frame.dlc, 1, 0, 0, data)
            rows += [row] * (2 if 0.025 <= kind < 0.03 else 1)
    return np.array(rows, logs.FRAME)


def by_executive(rig: Rig, came: np.ndarray[Any, Any]) -> tuple[list[Sent], int]:
    """Return what the executive sends, and its cycles until it stops of itself."""
    rows = np.zeros((CYCLES, HEAD + len(NAMES)), np.int64)
    rows[:, K] = rows[:, PASSES] = np.arange(CYCLES)
    rows[:, STAMP] = rows[:, K] * 1_000_000
    rows[:, HEAD:] = np.array([0.0, 1.0, 2.0]).view(np.int64)
    replay = Replay(rig, "executive", "real", [])
    done = replay.advance(Slice(rows, came, []), NAMES)
    sent = [(int(f["cycle"]), int(f["id"]), int(f["dlc"]), f["data"].tobytes()) for f in done.sent]
    return sent, len(done.values)


def by_device(library: Any, came: np.ndarray[Any, Any]) -> tuple[list[Sent], int]:
    """Return what the device sends, and its cycles until it stops of itself."""
    sent, now = list[Sent](), 0

    def take(at: int) -> None:
        frame = Frame.from_address(at)
        sent.append((now, frame.id, frame.n, bytes(frame.data)))

    send = SEND(take)
    assert library.device_init(CYCLES, send)
    library.device_sync()
    for k in range(CYCLES):
        now = k
        for frame in came[came["cycle"] == k]:
            data = (ctypes.c_uint8 * 8)(*frame["data"].tolist())
            library.device_frame(ctypes.c_uint32(int(frame["id"])), data, int(frame["dlc"]))
        before = len(sent)
        library.device_cycle(1)
        if library.device_over():
            last = k + 1 if k == CYCLES - 1 else k
            return [s for i, s in enumerate(sent) if i < before or last > k], last
    return sent, CYCLES  # on the ramp at the end


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    found = {}
    for number, how in enumerate(SETTINGS):
        folder = tmp_path_factory.mktemp(f"device{number}")
        for name, text in device(rig_of(how)).items():
            (folder / name).write_text(text)
        found[how] = library_of(folder)
    yield found


def library_of(folder: Path) -> Any:
    machine = "main_linux.c", "main_mps2.c", "startup.c", "soft_double.c", "run.c"
    sources = [p.name for p in folder.glob("*.c") if p.name not in machine]
    words = ["cc", "-std=c99", "-O1", "-ffp-contract=off", "-shared", "-fPIC", "-o", "device.so"]
    subprocess.run([*words, *sources], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "device.so"))
    library.device_over.restype = library.device_init.restype = ctypes.c_bool
    return library


@pytest.mark.parametrize("how", SETTINGS)
def test_a_device_sends_what_the_executive_sends(how: str, built: dict[str, Any]) -> None:
    ended = set()
    for seed in range(4):
        rig = rig_of(how)
        came = disturbed(rig, seed)
        expected, cycles = by_executive(rig, came)
        sent, done = by_device(built[how], came)
        beats = [s for s in sent if s[0] == 0 and s[1] >> 7 == 0xE]
        told = [s for s in sent if s not in beats][: len(expected)]
        for ours, theirs in zip(told, expected, strict=True):
            assert ours == theirs, (seed, ours, theirs)
        assert done == cycles, seed
        ended.add(cycles == CYCLES)
    assert (False in ended) == (how in ("as it is", "slow commands")), ended

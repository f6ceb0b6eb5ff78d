"""XCP on a real vcan0: a master over SocketCAN measures and calibrates, the log replays."""

import re
import signal
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import SLOW
from live import CHANNEL, PATIENCE_S, PCPC, RIG, ROOT, until

from pcpc.drivers.can import plain_bus
from pcpc.drivers.can.bus import BusAddress
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes import live
from pcpc.tools.live.xcp.packets import LAYOUTS, Cmd

pytestmark = pytest.mark.vcan

MEASURED, GAIN, ROWS = ("time.t_s", "controller.e_rad"), "controller.kv_Nms_rad", 50


class Master:
    """A master of the slave with these ids: `dtos` are the packets of its list."""

    def __init__(self, down: int, up: int) -> None:
        self._bus = plain_bus.open_bus(BusAddress("socketcan", CHANNEL), [up])
        self._down = down
        self.dtos: list[bytes] = []
        self._others: list[bytes] = []

    def look(self) -> list[bytes]:
        """Take what came; return all but the packets of the list."""
        for frame in self._bus.frames():
            (self.dtos if frame.data[0] < 0xFD else self._others).append(frame.data)
        return self._others

    def send(self, packet: bytes) -> bytes:
        """Return the answer to a packet."""
        self._others.clear()
        self._bus.put(self._down, packet)
        until(self.look, "an answer")
        return self._others.pop(0)

    def ask(self, command: Cmd, *given: int) -> bytes:
        """Return the positive answer to a command."""
        answer = self.send(bytes([command]) + LAYOUTS[command].pack(*given))
        assert answer[0] == 0xFF, (command.name, answer)
        return answer

    def measure(self, *addresses: int) -> None:
        """Start a list of doubles, each in two halves, of every cycle."""
        halves = [at + part for at in addresses for part in (0, 4)]
        self.ask(Cmd.FREE_DAQ)
        self.ask(Cmd.ALLOC_DAQ, 1)
        self.ask(Cmd.ALLOC_ODT, 0, len(halves))
        for odt in range(len(halves)):
            self.ask(Cmd.ALLOC_ODT_ENTRY, 0, odt, 1)
        for odt, at in enumerate(halves):
            self.ask(Cmd.SET_DAQ_PTR, 0, odt, 0)
            self.ask(Cmd.WRITE_DAQ, 0xFF, 4, 0, at)
        self.ask(Cmd.START_STOP_DAQ_LIST, 1, 0)

    def write(self, address: int, value: float) -> int:
        """Set a parameter; return the first cycle with it."""
        data = struct.pack("<d", value)
        self.ask(Cmd.SET_MTA, 0, address)
        self._bus.put(self._down, bytes([Cmd.DOWNLOAD, 8]) + data[:6])
        assert self.send(bytes([Cmd.DOWNLOAD_NEXT, 2]) + data[6:]) == b"\xff"
        until(self.look, "its cycle")
        event = self._others.pop(0)
        assert event[:2] == b"\xfd\xfe", event
        return int.from_bytes(event[2:], "little")


def test_a_master_measures_and_calibrates_and_the_log_replays(tmp_path: Path) -> None:
    rig, folder = tmp_path / "rig.yaml", tmp_path / "run"
    rig.write_text(f"base: {ROOT / RIG}\nxcp: {{frames: 80}}\n")
    settings = [f"--set={one}" for one in SLOW if "duration_s" not in one]
    words = ["--set=duration_s=600", "--bus", CHANNEL, "--quiet", "--no-figure", "-o", str(folder)]
    run = subprocess.Popen(
        [PCPC, "run", str(rig), *settings, *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert run.stderr is not None
        said = run.stderr.readline()
        told = re.search(r"^executive: XCP over CAN, id 0x(\w+) to it, 0x(\w+) from it", said)
        assert told, (said, run.communicate())
        name = live.sh.block_name("slew10", f"socketcan:{CHANNEL}", "executive")
        until(lambda: name in (found := live.running()) and found[name].under_way, "a cycle")
        places = {name: 8 * i for i, name in enumerate(live.running()[name].variables)}
        master = Master(*(int(word, 16) for word in told.groups()))
        assert master.ask(Cmd.CONNECT, 0)[3] == 8
        master.measure(*(places[name] for name in MEASURED))
        cycles = {value: master.write(places[GAIN], value) for value in (19.0, 18.5, 18.25)}
        until(lambda: master.look() or len(master.dtos) >= 4 * ROWS, "rows")
        run.send_signal(signal.SIGINT)
        said = run.communicate(timeout=PATIENCE_S)[1]
    finally:
        run.kill()
    assert (folder / "log.mcap").exists(), (run.returncode, said)
    node = logs.read(folder / "log.mcap").node["executive"]
    assert {one["value"]: one["cycle"] for one in node.tunings if one["name"] == GAIN} == cycles
    rows = [b"".join(one[1:5] for one in master.dtos[i : i + 4]) for i in range(0, 4 * ROWS, 4)]
    values = np.frombuffer(b"".join(rows), "V8").reshape(ROWS, 2)
    cycle = np.round(values[:, 0].copy().view(np.float64) * 25).astype(int)
    at = np.searchsorted(node.cycle, cycle)
    assert np.array_equal(node.cycle[at], cycle) and np.array_equal(at, at[0] + np.arange(ROWS))
    for i, name in enumerate(MEASURED):
        assert values[:, i].tobytes() == node.columns[name][at].tobytes(), name
    replayed = subprocess.run([PCPC, "replay", str(folder), "--quiet"], capture_output=True)
    assert replayed.returncode == 0, replayed.stderr

"""XCP on CAN between real processes: pyXCP on a run's bus, an emulated line, what goes wrong."""

import json
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from fd_rig import PROBE, fd_rig
from live_run import KV
from live_run import pcpc as started
from processes import PATIENT, RIGS, own_bus, pcpc, until
from test_xcp_node import MASTER, ROWS, assert_in_log

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import plain_bus
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes import live
from pcpc.tools.live.xcp.packets import LAYOUTS, Cmd

SECONDS = 60.0


@dataclass
class Served:
    """A run that serves XCP on CAN: what it said, where a master joins, its ids by node."""

    host: "subprocess.Popen[str]"
    folder: Path
    bus: str
    master: str = ""
    ids: dict[str, tuple[int, int]] = field(default_factory=dict)

    def end(self) -> logs.Log:
        self.host.send_signal(signal.SIGINT)
        self.host.communicate(timeout=SECONDS)
        return logs.read(self.folder / "log.mcap")


@contextmanager
def serving(rig: Path, folder: Path, *words: str) -> Iterator[Served]:
    bus = own_bus()
    given = ["--bus", bus, "--set", "duration_s=600", "-o", str(folder / "run"), "--no-figure"]
    run = Served(started("run", str(rig), *given, "--quiet", *PATIENT, *words), folder / "run", bus)
    assert run.host.stderr is not None
    try:
        while len(run.ids) < 2:
            line = run.host.stderr.readline()
            assert line, f"the run ended: {run.host.communicate()}"
            if ": XCP over CAN" in line:
                role, _, rest = line.partition(": XCP over CAN")
                down, up = (int(word, 16) for word in rest.split() if word.startswith("0x"))
                run.ids[role], run.master = (down, up), rest.split()[-1]
        rig_name = "hull" if rig.stem == "served" else rig.stem
        name = live.sh.block_name(rig_name, bus, "executive")

        def is_up() -> bool:
            assert run.host.poll() is None, f"the run ended: {run.host.communicate()}"
            return name in (known := live.running()) and known[name].under_way

        until(is_up, "the first cycle")
        yield run
    finally:
        run.host.kill()


def served_hull(folder: Path, xcp: str) -> Path:
    rig = folder / "served.yaml"
    rig.write_text(f"base: {RIGS / 'hull.yaml'}\nrate_hz: 200\nxcp: {xcp}\n")
    return rig


class Raw:
    """A master that sends frames as they are."""

    def __init__(self, bus: str, ids: tuple[int, int]) -> None:
        self.bus = plain_bus.open_bus(buses.bus_named(*buses.parse(bus)))
        self.down, self.up, self.sent, self.got = *ids, 0, list[bytes]()

    def send(self, packet: bytes) -> None:
        self.bus.put(self.down, packet)
        self.sent += 1

    def look(self) -> list[bytes]:
        self.got += [frame.data for frame in self.bus.frames() if frame.word == self.up]
        return self.got

    def ask(self, command: Cmd, *given: int) -> bytes:
        self.got.clear()
        self.send(bytes([command]) + LAYOUTS[command].pack(*given))
        until(lambda: [one for one in self.look() if one[0] >= 0xFE], command.name, SECONDS)
        return next(one for one in self.got if one[0] >= 0xFE)

    def download(self, value: float) -> bytes:
        self.got.clear()
        data = struct.pack("<d", value)
        self.send(bytes([Cmd.DOWNLOAD, 8]) + data[:6])
        self.send(bytes([Cmd.DOWNLOAD_NEXT, 2]) + data[6:])
        until(lambda: [one for one in self.look() if one[0] >= 0xFE], "an answer", SECONDS)
        return self.got[0]


def measured(run: Served, layer: str, recorded: list[str], gain: str = KV) -> dict[str, Any]:
    group, port = buses.udp_address(run.master.partition(":")[2])
    down, up = run.ids["executive"]
    where = f"udp_multicast,{group},{port},{down:X},{up:X}"
    words = [sys.executable, str(MASTER), where, layer, str(ROWS), json.dumps(recorded), gain]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return dict(json.loads(done.stdout.splitlines()[-1]))


def test_a_session_of_pyxcp_on_classic_can_is_in_the_log_and_replays(tmp_path: Path) -> None:
    recorded = ["time.t_s", "controller.e_rad"]
    with serving(served_hull(tmp_path, "{frames: 80}"), tmp_path) as run:
        known = live.find(live.sh.block_name("hull", run.bus, "executive"))
        told = measured(run, "can", recorded)
        assert run.ids == {"executive": (0x7C0, 0x7C1), "plant": (0x7C2, 0x7C3)}
        assert set(told["places"]) == set(known.variables)
        assert "CAN_ID_MASTER 0x7C0 CAN_ID_SLAVE 0x7C1" in told["a2l"]
        master, cycles = Raw(run.bus, run.ids["executive"]), dict[float, int]()
        assert master.ask(Cmd.CONNECT, 0)[:4] == b"\xff\x05\xc0\x08"
        number = list(known.variables).index(KV)
        for value in range(200, 210):
            master.ask(Cmd.SET_MTA, 0, 8 * number)
            assert master.download(value) == b"\xff"
            until(lambda: [one for one in master.look() if one[:2] == b"\xfd\xfe"], "its cycle")
            event = next(one for one in master.got if one[:2] == b"\xfd\xfe")
            cycles[float(value)] = int.from_bytes(event[2:], "little")
        plant = Raw(run.bus, run.ids["plant"])
        assert plant.ask(Cmd.CONNECT, 0)[0] == 0xFF
        assert struct.unpack("<BxxI", plant.ask(Cmd.GET_ID, 4)[1:])[1] > 10_000
        log = run.end()
        until(lambda: b"\xfd\x07" in master.look() and b"\xfd\x07" in plant.look(), "its end")
    assert told["read"] == [91.0, 92.5, 93.25]
    assert_in_log(log.node["executive"], told["rows"], recorded)
    tuned = {one["value"]: one["cycle"] for one in log.node["executive"].tunings}
    assert {value: tuned[value] for value in cycles} == cycles
    done = pcpc("replay", str(tmp_path / "run" / "log.mcap"), "--json")
    assert done.code == 0 and all(one["identical"] for one in json.loads(done.out)), done


def test_what_goes_wrong_on_the_bus_ends_nothing(tmp_path: Path) -> None:
    with serving(served_hull(tmp_path, "can"), tmp_path) as run:
        node = live.find(live.sh.block_name("hull", run.bus, "executive"))
        cycle, number = node.read().cycle, list(node.variables).index(KV)
        master = Raw(run.bus, run.ids["executive"])
        for damaged in (b"", b"\xfd", b"\x00" * 8, bytes([Cmd.UPLOAD, 255])):
            master.send(damaged)  # before a connection
        master.bus.put(master.up, b"\xff\x00")  # another speaks with the slave's id
        master.bus.put(master.down, bytes(64), 4)  # CAN FD on a classic bus
        assert master.ask(Cmd.CONNECT, 0)[0] == 0xFF
        for _ in range(2000):
            master.send(b"\xfd")  # a flood: most of it is dropped
        until(lambda: len(master.look()) > 256, "answers to what was taken")
        again = Raw(run.bus, run.ids["executive"])  # another master has the same session
        again.send(b"\xfc")
        until(lambda: b"\xfe\x00" in again.look(), "the flood is over")
        again.ask(Cmd.SET_MTA, 0, 8 * number)
        assert pcpc("operate", "lock", "tune", "--node", node.name).code == 0
        assert again.download(201.0) == b"\xfe\x25", "locked"
        assert pcpc("operate", "lock", "none", "--node", node.name).code == 0
        again.ask(Cmd.SET_MTA, 0, 8 * number)
        assert again.download(1001.0) == b"\xfe\x22", "out of range"
        done = pcpc("xcp", node.name, "--can")
        assert done.code == 2 and "another slave has these ids" in done.err, done
        done = pcpc("xcp", node.name, "--can", "--udp", "0")
        assert done.code == 2 and "--udp: not with --can" in done.err, done
        assert node.read().cycle > cycle and run.host.poll() is None
        log = run.end()
    assert not log.node["executive"].tunings


def test_a_run_without_the_key_is_served_by_the_command(tmp_path: Path) -> None:
    bus = own_bus()
    words = ["--bus", bus, "--set", "duration_s=600", "-o", str(tmp_path / "run"), "--no-figure"]
    run = started("run", str(RIGS / "hull.yaml"), "--quiet", *PATIENT, *words)
    try:
        name = live.sh.block_name("hull", bus, "plant")
        until(lambda: (one := live.running().get(name)) and one.under_way, "the first cycle")
        slave = started("xcp", name, "--can")
        assert slave.stdout is not None
        assert f"id 0x7C2 to it, 0x7C3 from it, on {bus}" in slave.stdout.readline()
        assert Raw(bus, (0x7C2, 0x7C3)).ask(Cmd.CONNECT, 0)[0] == 0xFF
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=SECONDS)
        assert slave.wait(SECONDS) == 0
    finally:
        run.kill()


def test_the_ids_of_an_emulated_line_are_in_its_report(tmp_path: Path) -> None:
    rig = tmp_path / "probe.yaml"
    rig.write_text(
        f"base: {PROBE / 'rig.yaml'}\nrate_hz: 200\nbus: {{emulate: 1 Mbit/s}}\n"
        "xcp: {can: [0x7E0, 0x7E1], frames: 60}\n"
    )
    with serving(rig, tmp_path) as run:
        assert run.master != run.bus, "a side of its own"
        master = Raw(run.master, run.ids["executive"])
        assert master.ask(Cmd.CONNECT, 0)[0] == 0xFF
        master.ask(Cmd.FREE_DAQ)
        master.ask(Cmd.ALLOC_DAQ, 1)
        master.ask(Cmd.ALLOC_ODT, 0, 4)
        for odt in range(4):
            master.ask(Cmd.ALLOC_ODT_ENTRY, 0, odt, 1)
        for odt in range(4):
            master.ask(Cmd.SET_DAQ_PTR, 0, odt, 0)
            assert master.ask(Cmd.WRITE_DAQ, 0xFF, 7, 0, 0) == b"\xff"
        assert master.ask(Cmd.START_STOP_DAQ_LIST, 1, 0)[0] == 0xFF
        begin = time.monotonic()
        until(lambda: sum(one[0] < 4 for one in master.look()) >= 3000, "3,000 DTOs")
        seconds = time.monotonic() - begin
        run.end()
    line = json.loads((tmp_path / "run" / "line.json").read_text())
    executive, _, tester = line["sides"]
    assert tester["bus"] == f"{run.master}, XCP 0x7E0, 0x7E2" and tester["refused"] == 0
    assert tester["sent"] == master.sent, "each command went over the line once"
    assert executive["sent"] > 3000 + 2 * 200 * seconds, "its own frames and the DTOs"
    plain = pcpc("bus", str(rig), "--set", "xcp=null", "--json")
    alone = json.loads(plain.out)["buses"][0]["load"]
    assert line["load"] > 1.5 * alone, f"{line['load']:.3f}, without XCP {alone:.3f} at most"
    with_it = json.loads(pcpc("bus", str(rig), "--json").out)["buses"][0]["load"]
    assert line["load"] < with_it, "no more than the budget"


def test_a_rig_with_can_fd_is_measured_in_long_frames(tmp_path: Path) -> None:
    rig = fd_rig(tmp_path, "bus: {data_bitrate: 5000000}", "xcp: {frames: 80}", "rate_hz: 200")
    recorded = ["time.t_s", "rx.FB.position", "controller.command"]
    with serving(rig, tmp_path) as run:
        told = measured(run, "canfd", recorded, "controller.gain")
        node = live.find(live.sh.block_name("probe_fd", run.bus, "executive"))
        down, up = run.ids["executive"]
        bus = plain_bus.open_bus(buses.bus_named(*buses.parse(run.bus)))
        got = list[plain_bus.BusFrame]()

        def ask(packet: bytes) -> bytes:
            got.clear()
            bus.put(down, packet, 4)
            until(lambda: got.extend(f for f in bus.frames() if f.word == up) or got, "an answer")
            assert got[0].flags == 5, "switched CAN FD"
            return got[0].data

        assert ask(b"\xff\x00")[:6] == b"\xff\x05\xc0\x40\x40\x00"
        gain = list(node.variables).index("controller.gain")
        ask(bytes([0xF6, 0, 0, 0]) + struct.pack("<I", 8 * gain))
        assert ask(bytes([0xF0, 8]) + struct.pack("<d", 2.5) + bytes(6)) == b"\xff", "padded"
        short = bytes([0xF4, 8, 0, 0]) + struct.pack("<I", 8 * gain)
        answer = ask(short)
        assert answer == b"\xff" + struct.pack("<d", 2.5) + bytes(3), "twelve bytes"
        assert ask(bytes([0xF4, 63, 0, 0]) + struct.pack("<I", 0))[:1] == b"\xff"
        log = run.end()
    assert told["read"] == [91.0, 92.5, 93.25] and "MAX_DLC 64" in told["a2l"]
    assert_in_log(log.node["executive"], told["rows"], recorded)


@pytest.mark.parametrize("command", ["run", "check", "bus"])
def test_a_clash_of_ids_is_told_before_anything_starts(tmp_path: Path, command: str) -> None:
    rig = served_hull(tmp_path, "{can: [0x080, 0x081]}")
    done = pcpc(command, str(rig))
    assert done.code == 2 and done.err.count("\n") == 1, done
    assert "free is xcp: {can: [0x7C0, 0x7C1]}" in done.err and "served.yaml:3" in done.err, done


def test_an_a2l_file_tells_ids_and_rates(tmp_path: Path) -> None:
    from pya2l import import_a2l, model

    rig, file = served_hull(tmp_path, "{can: [0x7C0, 0x18DA00F1]}"), tmp_path / "hull.a2l"
    words = ("--set", "bus.bitrate=500000", "-o", str(file))
    assert pcpc("generate", "a2l", str(rig), "--node", "plant", *words).code == 0
    text = file.read_text()
    assert "/begin XCP_ON_CAN 0x0101 CAN_ID_MASTER 0x7C2 CAN_ID_SLAVE 0x98DA00F3" in text
    assert "BAUDRATE 500000" in text and "CAN_FD MAX_DLC" not in text
    assert "BLOCK SLAVE MASTER 43 " in text and "DAQ_BYTE 7 " in text
    session = import_a2l(str(file), in_memory=True, encoding="utf-8", progress_bar=False)
    assert len(session.query(model.Measurement).all()) > 50
    long = fd_rig(tmp_path, "bus: {data_bitrate: 5000000}", "xcp: can")
    assert pcpc("generate", "a2l", str(long), "-o", str(file)).code == 0
    assert "CAN_FD MAX_DLC 64 CAN_FD_DATA_TRANSFER_BAUDRATE 5000000" in file.read_text()

"""A running node is measured and calibrated by pyXCP; its log holds what was seen and set."""

import json
import re
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_run import KV, LAM, Run, going_on
from live_run import pcpc as started
from places import PATIENCE_S
from processes import RIGS, own_bus, pcpc, until
from test_xcp_slave import Node as SlaveTable

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes import live
from pcpc.tools.live.xcp.packets import EV_DAQ_OVERLOAD, EVENT, HEAD
from pcpc.tools.live.xcp.serve import _Master, _sent_bytes
from pcpc.tools.live.xcp.slave import XcpSession

MASTER = Path(__file__).with_name("xcp_master.py")
ROWS, SECONDS = 100, 60.0
BRIEF = ["--set", "duration_s=60", "--set", "rate_hz=200", "--no-figure", "--quiet"]


@dataclass
class Slave:
    """A run, the ports of its executive's slave and the process that serves them."""

    run: Run
    udp: int
    tcp: int
    process: "subprocess.Popen[str]"


@contextmanager
def served(folder: Path) -> Iterator[Slave]:
    """Serve the executive of a run until it ends."""
    with going_on(folder) as run:
        process = started("xcp", run.node, "--udp", "0", "--tcp", "0")
        assert process.stdout is not None
        ports = [int(process.stdout.readline().rsplit(":", 1)[1]) for _ in range(2)]
        yield Slave(run, *ports, process)
        process.kill()


@pytest.fixture(scope="module")
def slave(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slave]:
    with served(tmp_path_factory.mktemp("xcp") / "run") as found:
        yield found


class Raw:
    """A master that sends bytes as they are."""

    def __init__(self, port: int) -> None:
        self.end = socket.create_connection(("127.0.0.1", port), SECONDS)

    def ask(self, packet: bytes) -> bytes:
        self.end.sendall(HEAD.pack(len(packet), 0) + packet)
        return self.packet()

    def packet(self) -> bytes:
        length, _ = HEAD.unpack(self._read(HEAD.size))
        return self._read(length)

    def _read(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self.end.recv(count - len(data))
            if not more:
                raise EOFError
            data += more
        return data


POLLED = {
    "timing.reset", "supervisor.reset", "supervisor.stop", "supervisor.disarmed",
    "supervisor.status_word", "supervisor.error_code", "supervisor.error_register",
    "health.requests_refused", "health.bus_warnings", "health.bus_passives", "health.bus_offs",
    "health.bus_restarts", "health.bus_no_acks", "health.bus_tx_timeouts", "controller.q_d_rad",
    "controller.q_d_rate_rad_s", "controller.encoder_rad", "controller.hull_pitch_rad",
    "controller.hub_rate_rad_s", "controller.hull_rate_rad_s", "controller.motor_speed_rad_s",
}  # fmt: skip


def measured(slave: Slave, protocol: str, recorded: list[str]) -> dict[str, Any]:
    """Return what a session of pyXCP has seen."""
    port = slave.udp if protocol == "udp" else slave.tcp
    words = [sys.executable, str(MASTER), str(port), protocol, str(ROWS), json.dumps(recorded), KV]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return dict(json.loads(done.stdout.splitlines()[-1]))


def download(master: Raw, slave: Slave, value: float) -> bytes:
    number = list(live.find(slave.run.node).variables).index(KV)
    head = struct.pack("<BBxBI", 0xED, 8, 0, 8 * number)
    return master.ask(head + struct.pack("<d", value))


def test_a_session_of_pyxcp_is_in_the_log_and_replays(tmp_path: Path) -> None:
    with served(tmp_path / "run") as slave:
        node = live.find(slave.run.node)
        first, names = dict(node.read()), set(node.variables)
        wanted = [name for name in node.variables if name not in POLLED]
        told = {protocol: measured(slave, protocol, wanted) for protocol in ("udp", "tcp")}
        master, cycles = Raw(slave.tcp), dict[float, int]()
        assert master.ask(b"\xff\x00")[0] == 0xFF
        for value in range(200, 230):
            assert download(master, slave, value) == b"\xff"
            event = master.packet()
            assert event[:2] == b"\xfd\xfe"
            (cycles[float(value)],) = struct.unpack("<Q", event[2:])
        slave.run.host.send_signal(signal.SIGINT)
        slave.run.host.communicate(timeout=PATIENCE_S)
        assert master.packet() == b"\xfd\x07", "EV_SESSION_TERMINATED"
        until(lambda: slave.process.poll() is not None, "the slave ends with its node")
        assert slave.process.returncode == 0
    log = logs.read(tmp_path / "run" / "log.mcap")
    for one in told.values():
        assert one["read"] == [91.0, 92.5, 93.25] and set(one["places"]) == names
        assert [each["name"] for each in one["events"]] == ["cycle", "cycle_10", "cycle_100"]
        assert_in_log(log.node["executive"], one["rows"], wanted, first=first)
        assert set(re.findall(r"(\S+) \".* \(polled only\)\"\n", one["a2l"])) == POLLED
        assert one["a2l"].count("DAQ_EVENT FIXED_EVENT_LIST\n") == len(POLLED)
    tuned = {one["value"]: one["cycle"] for one in log.node["executive"].tunings}
    assert {value: tuned[value] for value in cycles} == cycles
    done = pcpc("replay", str(tmp_path / "run" / "log.mcap"), "--json")
    assert done.code == 0 and all(one["identical"] for one in json.loads(done.out)), done


@pytest.mark.deep
def test_a_thousand_downloads_of_a_session_are_tunings_at_the_cycles_told(tmp_path: Path) -> None:
    values = [50.0 + i / 8 for i in range(1000)]
    with served(tmp_path / "run") as slave:
        known = list(live.find(slave.run.node).variables)
        places = [8 * known.index(name) for name in (KV, LAM)]
        words = [sys.executable, MASTER.with_name("xcp_downloads.py"), slave.tcp, places, values]
        done = subprocess.run([*map(str, words)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        told = json.loads(done.stdout.splitlines()[-1])
    tunings = logs.read(tmp_path / "run" / "log.mcap").node["executive"].tunings
    found = [(one["name"], one["value"], one["cycle"]) for one in tunings]
    assert found == [*zip([KV, LAM] * 500, values, told, strict=True)], found[:5]
    assert told == sorted(told), "a later download is in an earlier cycle"
    done = pcpc("replay", str(tmp_path / "run" / "log.mcap"), "--json")
    assert done.code == 0 and all(one["identical"] for one in json.loads(done.out)), done


def assert_in_log(
    node: logs.NodeLog,
    rows: list[Any],
    recorded: list[str],
    rate_hz: float = 200.0,
    first: Mapping[str, float] | None = None,
) -> None:
    """Compare measured rows with the log's, bit by bit and stamp by stamp.

    `first`: what parameters were before all tunings.
    """
    values = np.array([[bytes.fromhex(one) for one in row[1]] for row in rows], "V8")
    time = values[:, recorded.index("time.t_s")].copy().view(np.float64)
    cycle = np.round(time * rate_hz).astype(int)
    at = np.searchsorted(node.cycle, cycle)
    assert len(cycle) >= ROWS and np.array_equal(node.cycle[at], cycle)
    assert np.array_equal(at, at[0] + np.arange(len(at))), "a row of the log is missing"
    for i, name in enumerate(recorded):
        if name in node.columns:
            theirs = node.columns[name][at]
        elif name in node.timing:
            theirs = node.timing[name][at]
        else:
            theirs = np.full(len(at), (first or {})[name])
            for one in node.tunings:
                if one["name"] == name:
                    theirs[cycle >= one["cycle"]] = one["value"]
        assert values[:, i].copy().tobytes() == theirs.astype(np.float64).tobytes(), name
    stamps = np.array([row[0] for row in rows])
    assert np.array_equal(stamps - stamps[0], (cycle - cycle[0]) * 1e9 / rate_hz)


def test_what_is_locked_or_out_of_range_is_refused(slave: Slave) -> None:
    master = Raw(slave.tcp)
    assert master.ask(b"\xff\x00")[0] == 0xFF
    assert download(master, slave, 1001.0) == b"\xfe\x22"
    assert pcpc("operate", "lock", "tune", "--node", slave.run.node).code == 0
    assert download(master, slave, 201.0) == b"\xfe\x25"
    assert pcpc("operate", "lock", "none", "--node", slave.run.node).code == 0
    assert download(master, slave, 199.0) == b"\xff"


def test_two_hundred_masters_and_one_that_does_not_read(slave: Slave) -> None:
    cycle = live.find(slave.run.node).read().cycle
    for _ in range(200):
        assert Raw(slave.tcp).ask(b"\xff\x00")[0] == 0xFF
    deaf = Raw(slave.tcp)
    deaf.end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.ask(b"\xff\x00")
    wrong = Raw(slave.tcp)
    wrong.end.sendall(HEAD.pack(0, 0) + b"x")
    with pytest.raises(EOFError):
        wrong.packet()
    with socket.socket(type=socket.SOCK_DGRAM) as udp:
        for damaged in (b"", b"\x01", HEAD.pack(9, 0) + b"\xff", HEAD.pack(300, 0) + b"\xff" * 300):
            udp.sendto(damaged, ("127.0.0.1", slave.udp))
    assert Raw(slave.tcp).ask(b"\xff\x00")[0] == 0xFF, "others are served"
    assert live.find(slave.run.node).read().cycle > cycle and slave.process.poll() is None


def test_a_master_that_does_not_read_gets_all_of_it_later_or_is_left() -> None:
    node = SlaveTable().table()
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    master = _Master(XcpSession(node), partial(_sent_bytes, ours.send, None), True)
    packets = [struct.pack("<I", i) * 250 for i in range(1000)]
    master.send(packets)
    theirs.settimeout(SECONDS)
    got = b""
    while len(got) < 1000 * (HEAD.size + 1000):
        got += theirs.recv(1 << 16)
        master.flush()
    whole = (HEAD.pack(1000, i) + packet for i, packet in enumerate(packets))
    assert got == b"".join(whole)
    with pytest.raises(ValueError, match="does not read"):
        for _ in range(10):
            master.send(packets)


def test_a_packet_that_udp_has_lost_is_told_with_the_next() -> None:
    went, full = list[bytes](), [True]

    def put(message: bytes) -> int:
        return 0 if full[0] else went.append(message[HEAD.size :]) or len(message)

    master = _Master(XcpSession(SlaveTable().table()), put, False)
    master.send([b"a"])
    full[0] = False
    master.send([b"b"])
    master.send([b"c"])
    assert went == [bytes([EVENT, EV_DAQ_OVERLOAD]), b"b", b"c"]


def test_a_port_that_is_taken_and_a_node_that_is_not_there_are_told(slave: Slave) -> None:
    done = pcpc("xcp", slave.run.node, "--tcp", str(slave.tcp))
    assert done.code == 4 and f"TCP 127.0.0.1:{slave.tcp}: Address already in use" in done.err
    done = pcpc("xcp", "nobody")
    assert done.code == 4 and "no such node" in done.err


def test_a_run_serves_its_executive_from_its_beginning_to_its_end() -> None:
    run = started("run", str(RIGS / "hull.yaml"), "--bus", own_bus(), "--xcp", "tcp:0", *BRIEF)
    assert run.stderr is not None
    for line in run.stderr:
        if line.startswith("executive: XCP over TCP on 127.0.0.1:"):
            break
    master = Raw(int(line.rsplit(":", 1)[1]))
    assert master.ask(b"\xff\x00")[0] == 0xFF
    run.send_signal(signal.SIGINT)
    assert master.packet() == b"\xfd\x07", "EV_SESSION_TERMINATED"
    assert run.wait(PATIENCE_S) == 130, run.communicate()


@pytest.mark.parametrize("where", ["5555", "udp:", "udp:99999", "cam", "tcp:-1"])
def test_a_wrong_place_is_told_before_the_run(where: str) -> None:
    done = pcpc("run", str(RIGS / "hull.yaml"), "--xcp", where)
    assert done.code == 2 and done.err.count("\n") == 1 and where[-5:] in done.err, done


def test_an_a2l_file_is_read_by_a_parser_of_another_hand(tmp_path: Path) -> None:
    from pya2l import import_a2l, model

    file = tmp_path / "hull.a2l"
    done = pcpc("generate", "a2l", "hull", "-o", str(file))
    assert done.code == 0, done
    session = import_a2l(str(file), in_memory=True, encoding="utf-8", progress_bar=False)
    found = {one.name: one.ecu_address.address for one in session.query(model.Measurement)}
    found |= {one.name: one.address for one in session.query(model.Characteristic)}
    gain = session.query(model.Characteristic).filter_by(name=KV).one()
    assert (gain.lowerLimit, gain.upperLimit) == (0.0, 1000.0)
    unit = session.query(model.CompuMethod).filter_by(name=gain.conversion).one()
    assert unit.unit == "N m s/rad"
    lines = file.read_text().count("ECU_ADDRESS"), len(re.findall("VALUE 0x", file.read_text()))
    assert len(found) == sum(lines) > 100
    assert sorted(found.values()) == [8 * i for i in range(len(found))]
    assert pcpc("generate", "a2l", "hull", "--node", "moon", "-o", str(file)).code == 2

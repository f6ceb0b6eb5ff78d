"""Frames of CAN FD on a real vcan0: with can-utils and python-can both ways, and a whole rig."""

import os
import subprocess
from pathlib import Path
from typing import Any

import can
import pytest
from fd_rig import fd_rig
from live import CHANNEL, PCPC, candump_into, until
from wires import new_wire, send

from pcpc.drivers.can import bus, wire
from pcpc.drivers.can.bus import BusAddress
from pcpc.drivers.can.wire_layout import LENGTHS, Arrival, Flag
from pcpc.executive.log import reader as logs

pytestmark = pytest.mark.vcan

LONG = LENGTHS[9:]


def opened(receive_ids: list[int], fd: int = 1) -> Any:
    """Return a wire on vcan0."""
    end = new_wire(fd)
    bus.open_bus(BusAddress("socketcan", CHANNEL), receive_ids, end)
    return end


def put(end: Any, can_id: int, data: bytes, flags: int) -> None:
    send(end, can_id, data, flags=flags)
    assert end.tx[5] == flags, "the frame that was sent goes into the log as it is"


def taken(end: Any) -> tuple[int, bytes] | int:
    """Return flags and data of the next frame, or what else came."""
    outcome = wire.get_frame(end, True)
    assert not end.rx[8 + end.rx[4] : 72 if end.rx[5] else 16].any()
    if outcome != Arrival.FRAME:
        return int(outcome)
    return int(end.rx[5]), end.rx[8 : 8 + end.rx[4]].tobytes()


def heard(dump: Path, number: str) -> list[str]:
    """Return the FD frames of an id that candump has written, without the kernel's own flag 4."""
    words = [line.split()[2].partition("##") for line in dump.read_text().splitlines()]
    return [f"{n}##{int(rest[0], 16) & 3}{rest[1:]}" for n, _, rest in words if n == number]


@pytest.mark.parametrize("flags", [Flag.FD, Flag.FD | Flag.BRS, Flag.FD | Flag.BRS | Flag.ESI])
def test_python_can_and_we_read_each_other(flags: int) -> None:
    ours = opened([0x55])
    with can.Bus(interface="socketcan", channel=CHANNEL, fd=True) as theirs:
        for n in LENGTHS:
            data = bytes(range(n))
            put(ours, 0x123, data, flags)
            message = theirs.recv(5.0)
            assert message is not None and message.is_fd, f"{message}"
            said = (message.bitrate_switch, message.error_state_indicator, bytes(message.data))
            assert said == (bool(flags & Flag.BRS), bool(flags & Flag.ESI), data)
            theirs.send(
                can.Message(
                    arbitration_id=0x55,
                    is_extended_id=False,
                    data=data,
                    is_fd=True,
                    bitrate_switch=bool(flags & Flag.BRS),
                    error_state_indicator=bool(flags & Flag.ESI),
                )
            )
            assert taken(ours) == (flags, data)
    os.close(ours.fd_rx)


def test_candump_and_cansend_have_our_frames_and_we_theirs(tmp_path: Path) -> None:
    ours, dump = opened([0x321]), tmp_path / "heard.log"
    with candump_into(dump):
        for n in LONG:
            put(ours, 0x123, bytes([n] * n), Flag.FD | Flag.BRS)
    assert heard(dump, "123") == [f"123##1{f'{n:02X}' * n}" for n in LONG]
    for n in LONG:
        subprocess.run(["cansend", CHANNEL, f"321##0{'A5' * n}"], check=True)
        assert taken(ours) == (Flag.FD, b"\xa5" * n)
    subprocess.run(["cansend", CHANNEL, "321#0102"], check=True)
    assert taken(ours) == (Flag.NONE, b"\1\2")
    os.close(ours.fd_rx)


def test_a_classic_end_hears_no_long_frame() -> None:
    ours, theirs = opened([0x10], fd=0), opened([])
    put(theirs, 0x10, bytes(12), Flag.FD)
    put(theirs, 0x10, b"short", Flag.NONE)
    assert taken(ours) == (Flag.NONE, b"short") and taken(ours) == Arrival.NOTHING
    for end in (ours, theirs):
        os.close(end.fd_rx)


def test_a_rig_runs_on_it_and_is_replayed(tmp_path: Path) -> None:
    rig, folder, dump = fd_rig(tmp_path), tmp_path / "run", tmp_path / "heard.log"
    usual = ["--pacing", "lockstep", "--quiet", "--no-figure", "-o", str(folder)]
    with candump_into(dump):
        done = subprocess.run(
            [PCPC, "run", str(rig), "--bus", f"socketcan:{CHANNEL}", *usual],
            capture_output=True,
            text=True,
        )
    assert done.returncode == 0, done.stderr
    replayed = subprocess.run([PCPC, "replay", str(folder), "--quiet"], capture_output=True)
    assert replayed.returncode == 0, replayed.stderr
    frames = logs.read(folder / "log.mcap").node["executive"].frames
    sent = frames[(frames["id"] == 0xA0) & (frames["direction"] == 0)]
    assert heard(dump, "0A0") == [
        f"0A0##1{row['data'][:48].tobytes().hex().upper()}" for row in sent
    ]
    assert len(sent) > 500


def test_an_interface_without_it_is_named() -> None:
    subprocess.run("ip link set vcan0 down; ip link set vcan0 mtu 16", shell=True, check=True)
    try:
        subprocess.run("ip link set vcan0 up", shell=True, check=True)
        with pytest.raises(bus.BusError, match="no CAN FD; run `sudo ip link set vcan0 mtu 72`"):
            opened([])
    finally:
        subprocess.run(
            "ip link set vcan0 down; ip link set vcan0 mtu 72; ip link set vcan0 up",
            shell=True,
            check=True,
        )
    until(lambda: bus.vcan_ready(CHANNEL), "vcan0 is up again")

"""The `canopen` package, unchanged, as the master of a drive that `pcpc run --only plant` runs."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from places import ROOT
from processes import Running, own_bus, pcpc, until

RIG = ROOT / "tools/make/template/drive_cia402.yaml"
FROM_NODES = [  # udp_multicast gives a sender its own frames, which the package takes for others'
    {"can_id": 0x080, "can_mask": 0x080},
    {"can_id": 0x700, "can_mask": 0x780},
]


@contextmanager
def master(bus: str, eds: Path) -> Iterator[BaseNode402]:
    """Connect to the drive."""
    group, port = bus.split(":")[1:]
    network = canopen.Network()
    network.connect(
        interface="udp_multicast", channel=group, port=int(port), can_filters=FROM_NODES
    )
    try:
        node = BaseNode402(5, str(eds))
        network.add_node(node)
        yield node
    finally:
        network.disconnect()


def test_a_master_switches_it_on_and_moves_it(tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    with Running(
        "run", "--only=plant", str(RIG), "--bus", bus, "-o", str(folder), "--quiet"
    ) as run:
        block = run.block("motor-drive", bus, "plant")
        until(lambda: block.control.passes > 10, "first cycles")
        with master(bus, folder / "drive.eds") as node:
            moves(node)
        run.process.send_signal(signal.SIGINT)
        assert run.done().code == 130, run
    done = pcpc("replay", str(folder))
    assert done.code == 0 and "bit-identical" in done.out, done


def segments_instead_of_blocks(node: BaseNode402) -> None:
    """Ask for blocks, both ways, and take segments after the refusal."""
    for crc in (True, False):
        given = {"block_transfer": True, "request_crc_support": crc}
        for mode, more in (("rb", {}), ("wb", {"size": 2})):
            with pytest.raises(canopen.SdoAbortedError) as refused:
                node.sdo.open(0x1017, 0, mode, **given, **more)
            assert refused.value.code == 0x0504_0001
        assert node.sdo.upload(0x1008, 0) == b"motor-drive"
        node.sdo.download(0x1017, 0, b"\x05\x01", force_segment=True)
        assert node.sdo.upload(0x1017, 0) == b"\x05\x01"


def moves(node: BaseNode402) -> None:
    """Do what a master does with a new drive."""
    assert node.sdo[0x1008].raw == "motor-drive"
    segments_instead_of_blocks(node)
    node.nmt.state = "OPERATIONAL"
    node.setup_402_state_machine()
    node.sdo[0x1017].raw = 50
    node.nmt.wait_for_heartbeat(2.0)
    assert node.nmt.state == "OPERATIONAL"
    node.op_mode = "PROFILED VELOCITY"
    node.sdo[0x60FF].raw = 2000
    node.state = "OPERATION ENABLED"
    until(lambda: abs(node.sdo[0x606C].raw - 2000) < 50, "its velocity")
    node.state = "SWITCH ON DISABLED"
    assert node.homing(timeout=10.0)
    tpdo = node.tpdo[2]
    tpdo.clear()
    tpdo.add_variable(0x6064)
    tpdo.cob_id, tpdo.trans_type, tpdo.enabled = 0x285, 1, True
    tpdo.save()
    node.op_mode = "PROFILED POSITION"
    node.sdo[0x6081].raw, node.sdo[0x607A].raw = 20_000, 3000
    node.state = "OPERATION ENABLED"
    node.controlword = 0x0F  # after that of homing: the setpoint is an edge
    for _ in range(2):
        node.check_statusword()  # a cycle has passed
    node.controlword = 0x1F
    until(lambda: node.statusword & 1 << 12, "the setpoint is taken")
    node.controlword = 0x0F
    until(lambda: node.statusword & 1 << 10, "the target is reached")
    node.network.sync.transmit()
    assert tpdo.wait_for_reception(2.0) is not None
    assert abs(tpdo[0x6064].raw - 3000) <= 10
    with pytest.raises(canopen.SdoAbortedError) as refused:
        node.sdo[0x6060].raw = 2
    assert refused.value.code == 0x06090030


def test_what_a_master_did_wrong_is_told_and_no_pass(tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    words = ["run", "--only=plant", str(RIG), "--bus", bus, "-o", str(folder), "--quiet"]
    with Running(*words) as run:
        block = run.block("motor-drive", bus, "plant")
        until(lambda: block.control.passes > 10, "first cycles")
        with master(bus, folder / "drive.eds") as node:
            node.nmt.state = "OPERATIONAL"
            for value in (2, 4):
                with pytest.raises(canopen.SdoAbortedError):
                    node.sdo[0x6060].raw = value
            node.sdo[0x6040].raw = 0x0F  # from SWITCH ON DISABLED
            assert node.sdo[0x6041].raw & 0x6F == 0x40
        run.process.send_signal(signal.SIGTERM)
        done = run.done()
    assert "master: SDO was aborted: 2 x (drive.master.sdo_aborted)" in done.err, done
    what = "controlword asked for a transition that its state does not have: 1 x"
    assert f"master: {what} (drive.master.command_ignored)" in done.err, done
    assert done.err.count("master: ") == 2, done


def test_a_second_drive_on_its_bus_leaves_nothing_behind(tmp_path: Path) -> None:
    bus = own_bus()
    words = ["run", "--only=plant", str(RIG), "--bus", bus, "--quiet", "-o"]
    with Running(*words, str(tmp_path / "first")) as run:
        block = run.block("motor-drive", bus, "plant")
        until(lambda: block.control.passes > 10, "first cycles")
        second = pcpc(*words, str(tmp_path / "second"))
        assert second.code == 4 and "already in use" in second.err, second
        assert not (tmp_path / "second").exists()
        run.process.send_signal(signal.SIGINT)
        assert run.done().code == 130, run
    assert (tmp_path / "first" / "drive.eds").is_file()

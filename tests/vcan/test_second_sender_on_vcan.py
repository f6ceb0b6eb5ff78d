"""A second process beside a running rig sends its frames, with the next counter and a right CRC."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest
from conftest import SLOW
from live import CMD, FB_A, PATIENCE_S, Command, Done, crc8_j1850, python_can

from pcpc.executive.loop.faults import Fault

pytestmark = pytest.mark.vcan

FORGED = 2  # a third within ten cycles, and the true sender, who hears them, would fault
SIGNS = {"two senders", "counter ahead"}  # which, depends on how late a forged frame comes
NAMES = {FB_A: "FB_A", CMD: "CMD"}
RECEIVER, SENDER = {FB_A: "executive", CMD: "plant"}, {FB_A: "plant", CMD: "executive"}
COUNTER_BIT = {FB_A: 52, CMD: 48}  # of 4 bits; read beforehand: a frame must be forged in time
CASES = [(FB_A, "count"), (FB_A, "hold"), (CMD, "fault")]


@dataclass(frozen=True)
class Attack:
    """A run into which frames were forged: whose id, what the rig does about it."""

    can_id: int
    reaction: str
    run: Done

    def node(self, role: str) -> Any:
        """Return what the log holds of a node."""
        return self.run.log.node[role]


def forged(can_id: int, good: bytes) -> bytes:
    """Return the frame that comes next, with other data."""
    word, start = int.from_bytes(good, "little") ^ 0b1100, COUNTER_BIT[can_id]
    after = (word >> start) + 1 & 15
    data = (word & ~(15 << start) | after << start).to_bytes(8, "little")[:7]
    return data + bytes([crc8_j1850(can_id.to_bytes(2, "little") + data)])


def latest(bus: can.BusABC) -> bytes:
    """Return the data of the frame that came last, and wait for it."""
    found = bus.recv(PATIENCE_S)
    while (message := bus.recv(0.0)) is not None:
        found = message
    assert found is not None, f"no frame within {PATIENCE_S:g} s"
    return bytes(found.data)


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{NAMES[case[0]]}-{case[1]}")
def attack(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Attack:
    """Return a run in whose middle FORGED frames follow true ones."""
    can_id, reaction = request.param
    folder: Path = tmp_path_factory.mktemp("attack") / "run"
    with python_can(can_id) as bus:
        settings = (*SLOW, f"supervisor.intrusion={reaction}")
        command = Command(folder, "run", settings, "--bus", "vcan0", "--pacing", "real")
        for _ in range(20):  # both nodes run
            latest(bus)
        for _ in range(FORGED):
            data = forged(can_id, latest(bus))
            bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        return Attack(can_id, reaction, command.done())


def test_the_frame_is_named_and_its_two_senders_are_counted(attack: Attack) -> None:
    receiver = attack.node(RECEIVER[attack.can_id])
    told = [event for event in receiver.events if event["event"] in SIGNS]
    assert told and {event["name"] for event in told} == {NAMES[attack.can_id]}, f"{attack.run}"
    here, of_both = receiver.timing["health.intrusions"][-1], attack.run.summary["frames"]
    assert 1 <= here <= of_both["intrusions"], f"{here} at the receiver\n{attack.run}"


def test_the_true_sender_hears_the_frames_too(attack: Attack) -> None:
    sender = attack.node(SENDER[attack.can_id])
    told = [event for event in sender.events if event["event"] == "foreign"]
    assert told and {event["name"] for event in told} == {NAMES[attack.can_id]}, f"{attack.run}"
    assert 1 <= attack.run.summary["frames"]["foreign"] <= FORGED, f"{attack.run}"


def test_the_reaction_is_the_one_that_the_rig_chose(attack: Attack) -> None:
    run, fault = attack.run, attack.node(RECEIVER[attack.can_id]).columns["supervisor.fault"]
    if attack.reaction == "fault":
        assert run.code == 5 and float(Fault.INTRUSION) in fault, f"{run}"
        return
    assert run.code == 3 and run.summary["verdict"] == "loss", f"{run}"
    assert not fault.any() and run.summary["cycles"] == 125, f"{run}"
    named = any("signs of a second sender" in line for line in run.summary["frames_too_many"])
    assert named == (attack.reaction == "hold"), f"{run}"

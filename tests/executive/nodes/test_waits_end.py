"""Every wait for another node has an end that names what does not come."""

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from free_bus import GROUP, own_port
from interpreting import interpreted
from places import ROOT

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can.wire import put_frame
from pcpc.executive.errors import RigError
from pcpc.executive.loop import faults
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.running import run
from pcpc.executive.nodes import planned_drive
from pcpc.executive.nodes.install import install
from pcpc.executive.nodes.plan import describe, plan
from pcpc.executive.nodes.process import open_buses
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.messages import parts_in_meeting, peers_of
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.cli import main

TEMPLATE = ROOT / "tools/make/template"
TELEROBOT = ROOT / "plants/telerobot"
THREE_NODES = sorted((TELEROBOT / "rigs").glob("*.yaml"))[0]
EXTRA = 'BO_ {id} EXTRA: 8 {by}\n SG_ x : 0|8@1+ (1,0) [0|1] "" {to}\n{more}\n'
SYNC_2 = ' SG_ sequence : 8|8@1+ (1,0) [0|255] "" {to}\n SG_ crc : 56|8@1+ (1,0) [0|255] "" {to}\n'
Edit = Callable[[str], str]


def another(of: str, by: str, to: str, sequence: bool = False) -> Edit:
    """Return what gives a DBC file one more frame of every cycle."""
    more = SYNC_2.format(to=to) if sequence else ""

    def edit(text: str) -> str:
        text = text.replace(f"BU_: {of}", f"BU_: {of} THIRD")
        text = text.replace("\nCM_ ", f"\n{EXTRA.format(id=300, by=by, to=to, more=more)}\nCM_ ", 1)
        return text.replace("\nVAL_ ", '\nBA_ "GenMsgSendType" BO_ 300 0;\nVAL_ ', 1)

    return edit


def receiver(frame: str, was: str, becomes: str) -> Edit:
    """Return what gives the signals of a frame of a DBC file another receiver."""

    def edit(text: str) -> str:
        found = re.search(rf"BO_ \d+ {frame}:.*?\n\n", text, re.S)
        assert found and f'" {was}\n' in found[0], frame
        return text.replace(found[0], found[0].replace(f'" {was}\n', f'" {becomes}\n'))

    return edit


def motor(folder: Path, edit: Edit, more: str = "") -> Rig:
    """Return the template's motor with another DBC file and more keys."""
    text = (TEMPLATE / "motor.dbc").read_text()
    assert edit(text) != text
    (folder / "other.dbc").write_text(edit(text))
    path = folder / "other.yaml"
    path.write_text(f"base: {TEMPLATE / 'rig.yaml'}\nrig: other\ndbc: other.dbc\n{more}")
    return load_rig(path, settings=["duration_s=0.1"])


def moved(text: str) -> str:
    """Return a DBC file whose heartbeat of the plant has an id of no heartbeat."""
    return text.replace("1794", "1538")


UNHEARD = receiver("HB_PLANT", "EXEC", "Vector__XXX")


@pytest.mark.parametrize("edit", [UNHEARD, moved])
@pytest.mark.parametrize("pacing", ["real", "sync", "lockstep", "line"])
@pytest.mark.parametrize("role", ["executive", "plant"])
def test_a_plant_without_a_heartbeat_is_refused_with_the_cure(
    tmp_path: Path, edit: Edit, pacing: str, role: str
) -> None:
    rig = motor(tmp_path, edit)
    words = r"plant\.node: PLANT sends no heartbeat that EXEC receives, .* other\.dbc a frame from"
    with pytest.raises(RigError, match=words):
        plan(rig, role, pacing)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("frame", "above", "below"), [("HB_LOCAL", "EXEC", "LOCAL"), ("HB_PLANT", "LOCAL", "PLANT")]
)
def test_of_three_nodes_each_needs_the_heartbeat_of_the_one_below(
    tmp_path: Path, frame: str, above: str, below: str
) -> None:
    text = (TELEROBOT / "telerobot.dbc").read_text()
    found = re.search(rf"BO_ \d+ {frame}: \d+ (\w+)\n SG_ .*?\" (\w+)\n", text)
    assert found is not None, frame
    (tmp_path / "other.dbc").write_text(
        text.replace(found[0], found[0].replace(f'" {found[2]}\n', '" Vector__XXX\n'))
    )
    path = tmp_path / "other.yaml"
    path.write_text(f"base: {THREE_NODES}\nrig: other\ndbc: other.dbc\n")
    with pytest.raises(RigError, match=f"{found[1]} sends no heartbeat that {found[2]} receives"):
        plan(load_rig(path), "executive", "real")


def test_only_the_node_above_waits(tmp_path: Path) -> None:
    """The executive's heartbeat may be missing: its SYNC begins."""
    simulation = VirtualRun(motor(tmp_path, receiver("HB_EXEC", "PLANT", "Vector__XXX")), None)
    assert list(simulation.advance())[-1] == 100


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (another("EXEC PLANT", "Vector__XXX", "EXEC"), "EXTRA, for which EXEC waits"),
        (another("EXEC PLANT", "THIRD", "EXEC"), "EXTRA, for which EXEC waits"),
        (another("EXEC PLANT", "THIRD", "EXEC", True), "EXTRA, for which EXEC waits"),
        (another("EXEC PLANT", "THIRD", "PLANT", True), "EXTRA, for which PLANT waits"),
    ],
)
def test_without_a_clock_a_frame_that_no_node_sends_is_refused(
    tmp_path: Path, edit: Edit, words: str
) -> None:
    rig = motor(tmp_path, edit)
    with pytest.raises(RigError, match=f"no node of the rig sends {words} in each cycle; give it"):
        VirtualRun(rig, None)
    plan(rig, "executive", "real")  # a node of no rig may send it on a bus


@pytest.mark.parametrize("command", ["check", "simulate"])
def test_what_a_plant_awaits_and_nobody_sends_is_told(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It begins without: its SYNC comes."""
    rig = motor(tmp_path, another("EXEC PLANT", "THIRD", "PLANT"))
    words = ["-o", str(tmp_path / "run"), "--no-figure"] if command == "simulate" else []
    code = 1 if command == "simulate" else 0  # too short for the rig's limits
    assert main([command, str(rig.path), "--set", "duration_s=0.05", *words]) == code
    shown = capsys.readouterr()
    lines = "".join(shown.err if command == "simulate" else shown.out).split()
    said = "no node of the rig sends EXTRA, for which PLANT waits in each cycle; give it a sender"
    assert " ".join(lines).count(said) == 1, shown


def test_a_heartbeat_cannot_be_lost_on_purpose(tmp_path: Path) -> None:
    def every_cycle(text: str) -> str:
        text = text.replace('"GenMsgSendType" BO_ 1794 1', '"GenMsgSendType" BO_ 1794 0')
        return text.replace('BA_ "GenMsgCycleTime" BO_ 1794 100;\n', "")

    rig = motor(tmp_path, every_cycle, "losses: {HB_PLANT: {share: 0.1}}\n")
    with pytest.raises(RigError, match="HB_PLANT is a heartbeat, for which the start waits"):
        plan(rig, "executive", "real")


@pytest.mark.parametrize("edit", [UNHEARD, moved])
def test_in_memory_a_meeting_that_cannot_be_ends_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, edit: Edit
) -> None:
    monkeypatch.setattr(planned_drive, "check_heartbeats", lambda rig, sent: None)
    simulation = VirtualRun(motor(tmp_path, edit), None)
    work = threading.Thread(target=lambda: list(simulation.advance()), daemon=True)
    work.start()
    work.join(120.0)
    block = simulation.blocks[0]
    assert not work.is_alive() and block.control.fault == Fault.PEER_SILENT


def test_frames_that_nobody_waits_for_break_no_silence() -> None:
    """The plant goes on with its heartbeats, and sends no feedback."""
    rig, bus = (
        load_rig(TEMPLATE / "rig.yaml"),
        buses.bus_named("udp_multicast", f"{GROUP}:{own_port()}"),
    )
    nodes = {}
    for role in rig.roles:
        made = plan(rig, role, "lockstep")
        block = sh.private(describe(made, {}))
        open_buses(rig, bus, made, block.loop.wire)
        install(made, block.loop)
        nodes[role] = made, block
    made, block = nodes["executive"]
    loop = block.loop
    loop.passes = loop.k = 1  # the meeting is over
    loop.meeting.seeks_below = loop.meeting.ordered = loop.rx.listen_ns = (
        loop.rings.wait_recorder
    ) = 0
    loop.rx.patience = 15  # 0.3 s
    work = threading.Thread(target=lambda: run(loop, made.steps), daemon=True)
    begin_s = time.monotonic()
    work.start()
    plant, end = nodes["plant"][1].loop.wire, begin_s + 120.0
    plant.tx[:2] = 0x02, 0x07  # HB_PLANT
    plant.tx[4] = 1
    while work.is_alive() and time.monotonic() < end:
        put_frame(plant)
        work.join(0.005)
    assert not work.is_alive()
    assert block.control.fault == Fault.PEER_SILENT
    told = faults.reason(block.description, block.control)
    assert told == "the other node fell silent: no 0x120 (FB) came"
    assert time.monotonic() - begin_s > 0.25


@pytest.mark.parametrize("rig", [TEMPLATE / "rig.yaml", THREE_NODES])
def test_a_part_in_the_meeting_from_below_has_a_node_that_sends_it(rig: Path) -> None:
    """What takes it, and what holds a heartbeat until then, counts the nodes from 1."""
    loaded = load_rig(rig)
    for role in loaded.roles:
        made = plan(loaded, role, "lockstep")
        peers = peers_of(role, made.rx_frames, made.below, made.senders)
        parts = parts_in_meeting(role, made.rx_frames, peers)
        assert all(peer > 0 for part, peer in zip(parts, peers, strict=True) if part > 1)


def test_nodes_that_share_a_process_do_not_compile_what_one_alone_runs() -> None:
    """Its machine code is a quarter of a first start of `pcpc simulate`."""
    known = "'pcpc.executive.loop.running' in __import__('sys').modules"
    assert interpreted("pcpc.executive.nodes.virtual", known) == "False"

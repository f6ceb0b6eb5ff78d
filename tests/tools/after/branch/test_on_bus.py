"""A branch on a bus: real sockets, nodes in lockstep, and the bits of virtual time."""

import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import can
import pytest
from logcommand import run_here
from processes import PATIENT, ROOT, own_bus, pcpc, until
from test_branch import branch, faulty, record, simulated

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import choice
from pcpc.drivers.machine import claim
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import Plan, plan
from pcpc.executive.nodes.process import claim_frames, open_buses
from pcpc.executive.rig.buses import wanted_bus
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.branch import on_bus as on_bus_module
from pcpc.tools.after.branch.on_bus import BranchOnBus


def on_bus(log: Path, out: Path, *words: str) -> Path:
    """Return the log of a branch on a bus of its own."""
    done = branch(log, out, "--bus", own_bus(), *words)
    assert done.code in (0, 1), done
    return out / "log.mcap"


def sockets_of_this_process() -> set[str]:
    found = set()
    for file in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            found.add(os.readlink(file))
    return {name for name in found if name.startswith("socket:")}


def has_bits_of(new: Path, parent: Path) -> None:
    mine, wanted = record(new), record(parent)
    for role, (rows, frames, tunings) in wanted.items():
        assert mine[role][0] == rows, role
        missing = frames - mine[role][1]
        more = mine[role][1] - frames
        assert not missing and all(cycle == 0 for cycle, *_ in more), (role, missing, more)
        assert mine[role][2] == tunings, role


def test_a_run_in_lockstep_goes_on_on_a_bus_again(tmp_path: Path) -> None:
    done = pcpc(
        "run",
        "engage",
        "--pacing",
        "lockstep",
        "--set",
        "duration_s=0.4",
        "--no-figure",
        "--quiet",
        "-o",
        str(tmp_path / "a"),
    )
    assert done.ran, done
    has_bits_of(on_bus(tmp_path / "a/log.mcap", tmp_path / "b", "--cycle", "201"),
                tmp_path / "a/log.mcap")  # fmt: skip


def test_with_changes_it_has_the_bits_of_the_branch_in_memory(tmp_path: Path) -> None:
    parent = faulty(tmp_path, "rig")
    words = ("--cycle", "250", "--set", "controller.kv_Nms_rad=90", "--fault", "stuck:50ms",
             "--controller", "pid")  # fmt: skip
    bus = own_bus()  # holds a socket of its own
    before = sockets_of_this_process()
    new = tmp_path / "b/log.mcap"
    done = branch(parent, new.parent, "--bus", bus, *words)
    assert done.code in (0, 1), done
    assert sockets_of_this_process() <= before, "its sockets are closed"
    done = branch(parent, tmp_path / "c", *words)
    assert done.code in (0, 1), done
    has_bits_of(new, tmp_path / "c/log.mcap")
    about = logs.head(new).metadata["executive"]
    assert about["pacing"] == "lockstep" and about["bus"].startswith("udp_multicast")
    assert about["branch_cycle"] == "250"
    whole = run_here("replay", new, "--quiet")
    assert whole.code == 0, whole
    again = branch(new, tmp_path / "d", "--cycle", "100")
    assert again.code in (0, 1), again
    has_bits_of(tmp_path / "d/log.mcap", new)


def test_its_frames_are_on_the_bus(tmp_path: Path) -> None:
    parent, bus = simulated(tmp_path / "log.mcap", "engage", "duration_s=0.1"), own_bus()
    _, group, port = bus.split(":")
    heard: list[can.Message] = []
    with can.Bus(interface="udp_multicast", channel=group, port=int(port)) as ear:
        notifier = can.Notifier(ear, [heard.append])
        done = branch(parent, tmp_path / "b", "--cycle", "50", "--bus", bus)
        assert done.code in (0, 1), done
        until(lambda: heard and heard[-1].timestamp < time.time() - 0.5, "silence on the bus")
        notifier.stop()
    node = logs.read(tmp_path / "b/log.mcap").node["executive"]
    sent = node.frames[(node.frames["direction"] == 0) & (node.frames["cycle"] > 40)]
    known = {(int(f["id"]), f["data"][: f["dlc"]].tobytes()) for f in sent}
    came = {
        (m.arbitration_id, bytes(m.data))
        for m in heard
        if m.arbitration_id in {i for i, _ in known}
    }
    assert len(known & came) > 20 and came <= known, "an ear may miss some, but none is made up"


def test_a_run_that_keeps_time_is_refused(tmp_path: Path) -> None:
    done = pcpc(
        "run",
        "engage",
        "--bus",
        own_bus(),
        *PATIENT,
        "--set",
        "duration_s=0.3",
        "--no-figure",
        "--quiet",
        "-o",
        str(tmp_path / "a"),
    )
    assert done.code in (0, 1), done
    refused = branch(tmp_path / "a/log.mcap", tmp_path / "b", "--cycle", "90", "--bus", "auto")
    assert refused.code == 2 and "leave out --bus" in refused.err, refused
    assert refused.err.count("\n") == 1 and not (tmp_path / "b").exists()


def apart(rig: Rig, _bus: object, made: Plan, end: Any) -> None:
    """Open the bus of a node as one that brings it no frame of another."""
    open_buses(rig, buses.bus_named(*buses.parse(own_bus())), made, end)


@pytest.mark.parametrize("rig", ["engage", "telerobot-u1"])
@pytest.mark.parametrize("cycle", [0, 1, 2])
def test_nodes_that_never_meet_are_given_up_with_what_they_wait_for(
    rig: str, cycle: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = "duration_s=0.1", "supervisor.peer_timeout_s=0.2"
    parent, bus = simulated(tmp_path / "log.mcap", rig, *settings), own_bus()
    monkeypatch.setattr(on_bus_module, "open_buses", apart)
    done = branch(parent, tmp_path / "b", "--cycle", str(cycle), "--bus", bus)
    silence = rf"executive: no frame of the other node on {bus} for 0 s, as HB_\w+.*--bus\n"
    assert done.code == 4 and re.fullmatch(silence, done.err), done
    assert not (tmp_path / "b").exists()


def test_nodes_that_part_end_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parent = simulated(tmp_path / "log.mcap", "engage", "duration_s=0.1")
    monkeypatch.setattr(on_bus_module, "open_buses", apart)
    done = branch(parent, tmp_path / "b", "--cycle", "50", "--bus", own_bus())
    assert done.code == 5 and "the other node fell silent" in done.out + done.err, done


def test_an_interruption_ends_nodes_that_have_not_met(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parent = simulated(tmp_path / "log.mcap", "engage", "duration_s=0.1")
    monkeypatch.setattr(on_bus_module, "open_buses", apart)
    asked = threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGTERM))
    monkeypatch.setattr(BranchOnBus, "advance", started(asked, BranchOnBus.advance))
    done = branch(parent, tmp_path / "b", "--cycle", "0", "--bus", own_bus())
    assert done.code == 130 and "interrupted" in done.err + done.out, done


def started(timer: threading.Timer, advance: Callable[..., Any]) -> Callable[..., Any]:
    def started_advance(run: BranchOnBus) -> Iterator[int]:
        timer.start()
        yield from advance(run)

    return started_advance


def test_a_bus_where_another_sends_its_frames_is_refused_and_let_go(tmp_path: Path) -> None:
    parent, bus = simulated(tmp_path / "log.mcap", "engage", "duration_s=0.1"), own_bus()
    rig = load_rig(ROOT / "plants/atb1000/rigs/engage.yaml")
    taken = choice.take_bus(wanted_bus(rig, (), bus))
    held = claim_frames(rig, plan(rig, "plant", "lockstep"), taken.bus)
    try:
        done = branch(parent, tmp_path / "b", "--cycle", "50", "--bus", bus)
        assert done.code == 4 and "another sender" in done.err, done
        assert not (tmp_path / "b").exists()
    finally:
        for one in held:
            one.close()
        taken.release()
    done = branch(parent, tmp_path / "b", "--cycle", "50", "--bus", bus)
    assert done.code in (0, 1), done
    again = claim.hold(f"frame/{taken.bus}/00000080")
    assert again is not None, "it has let go"
    again.close()

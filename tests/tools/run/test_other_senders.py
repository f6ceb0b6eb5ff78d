"""Somebody else sends a rig's frames on its bus: seen in real runs, from their end."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import RIGS, Done, Running, own_bus, pcpc, until

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import wire
from pcpc.drivers.can.wire_layout import Wire
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.frames import LIMITS, too_many

SLEW10 = str(RIGS / "slew10.yaml")
SYNC = 0x080


@contextmanager
def stranger(bus: str) -> Iterator[Any]:
    """Open an end on `bus` that claims nothing and knows nobody."""
    end = np.zeros(1, Wire.dtype).view(np.recarray)[0]
    buses.open_bus(buses.bus_named(*buses.parse(bus)), [], end)
    yield end
    os.close(end.fd_tx)
    os.close(end.fd_rx)


def send(end: Any, can_id: int, times: int) -> None:
    end.tx[:] = 0
    end.tx[:2] = can_id & 0xFF, can_id >> 8
    end.tx[4] = 2
    for _ in range(times):
        assert wire.put_frame(end), f"errno {end.errno}"


def beside(folder: Path, times: int, duration_s: int) -> Done:
    """Return a run in lockstep into which a stranger sends SYNC, while its recorder stands still.

    Its nodes wait for the recorder once their rings are full: the run cannot end before.
    """
    bus = own_bus()
    usual = ("--pacing", "lockstep", "--no-figure", "--json", "--bus", bus, "-o", str(folder))
    with (
        stranger(bus) as end,
        Running("run", SLEW10, *usual, "--set", f"duration_s={duration_s}") as running,
    ):
        recorder = running.pid("recorder")
        os.kill(recorder, signal.SIGSTOP)
        control = running.block("slew10", bus, "executive").control
        until(lambda: control.passes > 100 or running.over(), "it runs")
        send(end, SYNC, times)
        os.kill(recorder, signal.SIGCONT)
        return running.done()


def test_a_single_frame_keeps_the_run_from_being_ok_and_replays(tmp_path: Path) -> None:
    done = beside(tmp_path / "run", 1, 12)
    assert done.code == 3 and done.summary["verdict"] == "loss", str(done)
    assert done.summary["frames"]["foreign"] == 2, "the executive's own id, the plant's SYNC"
    assert done.summary["frames_too_many"] == ["2 frames of this rig from another sender"]
    log = logs.read(tmp_path / "run" / "log.mcap")
    told = [e for node in log.node.values() for e in node.events if e["event"] == "foreign"]
    assert [(e["argument"], e["name"]) for e in told] == [(SYNC, "SYNC")] * 2, f"{told}"
    replayed = pcpc("replay", str(tmp_path / "run" / "log.mcap"))
    assert replayed.code == 0, str(replayed)


def test_a_second_sender_is_a_fault_that_names_the_frame_in_a_few_cycles(tmp_path: Path) -> None:
    done = beside(tmp_path / "run", 1000, 600)
    assert done.code == 5, str(done)
    faults = "\n".join(done.summary["faults"])
    assert "another sender of 0x080 (SYNC) is on this bus" in faults, faults
    assert pcpc("replay", str(tmp_path / "run" / "log.mcap")).code == 0, str(done)


def test_a_node_does_not_begin_beside_a_sender_of_its_frames(tmp_path: Path) -> None:
    bus = own_bus()
    usual = ("--pacing", "lockstep", "--no-figure", "--json", "--bus", bus)
    with (
        stranger(bus) as end,
        Running("run", "--only=executive", SLEW10, *usual, cwd=tmp_path) as control,
    ):
        until(lambda: send(end, SYNC, 1) or control.process.poll() is not None, "it is refused")
        done = control.done()
    assert done.code == 4, str(done)
    wanted = f"{bus}: another sender of 0x080 (SYNC) is on this bus; end it or choose another"
    assert wanted in done.err and not list(tmp_path.glob("runs/*")), str(done)


@pytest.mark.parametrize(
    ("key", "setting"),
    [("crc_errors", "crc"), ("repeated", "repeated"), ("wrong_sequence", "wrong_sequence"),
     ("implausible", "implausible"), ("send_errors", "send"), ("bus_errors", "bus"),
     ("foreign", "")],
)  # fmt: skip
def test_wrong_frames_beyond_the_rigs_limit_are_told(key: str, setting: str) -> None:
    none = dict.fromkeys((*LIMITS, "foreign", "intrusions"), 0)
    strict = load_rig(SLEW10, resolve=False)
    watched = load_rig(SLEW10, settings=["supervisor.intrusion=hold"], resolve=False)
    assert len(too_many(watched, none | {"intrusions": 1})) == 1
    assert too_many(strict, none | {"intrusions": 1}) == []
    assert too_many(strict, none) == []
    assert len(too_many(strict, none | {key: 1})) == 1
    if setting:
        patient = load_rig(SLEW10, settings=[f"errors.{setting}=2"], resolve=False)
        assert too_many(patient, none | {key: 2}) == []
        (line,) = too_many(patient, none | {key: 3})
        assert line.startswith("3 ") and line.endswith(f"errors.{setting} allows 2"), line

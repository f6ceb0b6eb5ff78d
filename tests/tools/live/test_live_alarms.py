"""Alarms of a real run: told by its host and by a watcher while it goes on, and in its log."""

import os
import signal
from pathlib import Path

from live_run import pcpc
from places import PATIENCE_S
from processes import ROOT, own_bus, until

from pcpc.executive.log.reader import read
from pcpc.executive.nodes.live import running

NAME = f"alarmed-{os.getpid()}"
LOST = "alarm: executive: "


def rig_file(folder: Path, *lines: str) -> Path:
    """Write the probe's rig, 200 cycles a second."""
    path = folder / "rig.yaml"
    base = f"base: {ROOT}/plants/probe/rig.yaml"
    patient = "supervisor: {hold_cycles: 100000, fault_after_cycles: 100000}"
    path.write_text("\n".join((base, f"rig: {NAME}", "rate_hz: 200.0", patient, *lines, "")))
    return path


def test_losses_are_told_while_they_happen_and_stand_in_the_log(tmp_path: Path) -> None:
    rig = rig_file(
        tmp_path, "duration_s: 600.0", "losses: {FB: {share: 0.1}}", "alarms: {held_per_s: 0}"
    )
    words = ["--bus", own_bus(), "-o", str(tmp_path / "run"), "--no-figure"]
    host = pcpc("run", str(rig), *words)
    try:
        until(lambda: [one for one in running(NAME).values() if one.under_way], "first cycle")
        node = next(name for name in running(NAME) if name.endswith("executive"))
        watcher = pcpc("watch", "time.t_s", "--every", "100ms", "--node", node)
        assert watcher.stderr is not None
        assert LOST in watcher.stderr.readline()
    finally:
        host.send_signal(signal.SIGINT)
        _, said = host.communicate(timeout=PATIENCE_S)
        watcher.communicate(timeout=PATIENCE_S)
    told = [line for line in said.splitlines() if LOST in line and "frame lost" in line]
    assert told and " s cycle " in told[0], said
    events = read(tmp_path / "run" / "log.mcap").node["executive"].events
    kinds = {event["name"] for event in events if event.get("event") == "alarm"}
    assert {"lost", "held"} <= kinds, events


def test_a_rig_that_allows_them_hears_nothing(tmp_path: Path) -> None:
    allowed = "alarms: {late_us: 1.0e+9, lost_per_s: null, held_per_s: null}"
    rig = rig_file(tmp_path, "duration_s: 1.0", "losses: {FB: {share: 0.1}}", allowed)
    words = ["--bus", own_bus(), "-o", str(tmp_path / "run"), "--no-figure"]
    host = pcpc("run", str(rig), *words)
    summary, said = host.communicate(timeout=240)
    assert "lost_on_purpose" in summary, said
    assert "frame lost" not in said and "held input" not in said, said

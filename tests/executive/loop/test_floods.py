"""A node that floods the bus on purpose: it costs time on a bus with bits, and none on others."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from places import ROOT
from replays import replayed

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

FROM, TO = 50, 60


def motor(folder: Path, frames: float | str, emulate: str | None) -> Path:
    """Return a rig of 0.1 s whose plant floods for 10 cycles."""
    if not (folder / "motor").exists():
        shutil.copytree(ROOT / "tools/make/template", folder / "motor")
    text = (ROOT / "tools/make/template/rig.yaml").read_text().partition("watch:")[0]
    text = text.replace("duration_s: 1.0", "duration_s: 0.1")
    if emulate is not None:
        text = text.replace("bus: {", f"bus: {{emulate: {emulate}, ")
    path = folder / "motor/flooded.yaml"
    fault = f"{{kind: flood, node: plant, value: {frames}, from: {FROM}ms, for: {TO - FROM}ms}}"
    path.write_text(f"{text}faults:\n  it: {fault}\n")
    return path


def run(folder: Path, frames: float, emulate: str | None, *settings: str) -> reader.Log:
    """Return its log, of virtual time."""
    log = folder / "log.mcap"
    log.unlink(missing_ok=True)
    simulate(load_rig(motor(folder, frames, emulate), settings=list(settings)), log)
    return reader.read(log)


def held(log: reader.Log) -> set[int]:
    """Return the executive's cycles without a frame of its own cycle."""
    node = log.node["executive"]
    return set(node.cycle[node.columns["supervisor.missing_cycles"] > 0].tolist())


def test_on_a_bus_that_knows_its_bits_the_others_wait(tmp_path: Path) -> None:
    # a frame of 8 zeros has some 130 bits, those of the rig some 400 a cycle: 10 more of them each
    # are 700 too many, 7000 in 10 cycles, for which there is room 12 cycles after
    few = run(tmp_path, 2, "1M")
    assert not held(few)
    many = run(tmp_path, 10, "1M", "supervisor.fault_after_cycles=20")
    assert held(many) >= set(range(FROM + 2, TO)) and min(held(many)) >= FROM
    assert TO <= max(held(many)) <= TO + 12, "it is over, the queue empties"
    stopped = run(tmp_path, 10, "1M", "supervisor.hold_cycles=2", "supervisor.fault_after_cycles=3")
    assert stopped.node["executive"].columns["supervisor.state"].max() >= State.FAULT
    for verdict in replayed(tmp_path / "log.mcap"):
        assert verdict.identical, verdict


def test_without_bits_nobody_takes_notice(tmp_path: Path) -> None:
    clean = run(tmp_path, 200, None, "faults.it.for=0s").node
    log = run(tmp_path, 200, None).node
    for name, node in log.items():
        for key, values in node.columns.items():
            if not key.startswith("fault."):
                np.testing.assert_array_equal(values, clean[name].columns[key], key)
        assert not (node.frames["id"] == 1).any(), "the flood is not in the log"


@pytest.mark.parametrize(
    ("fault", "what"),
    [
        ("{kind: flood, node: plant}", "flood needs a value"),
        ("{kind: flood, value: 5}", "a flood has node: executive or plant, and neither"),
        (
            "{kind: flood, node: plant, frame: CMD, value: 5}",
            "a flood has node: executive or plant",
        ),
        ("{kind: flood, node: plant, value: 1e6}", "outside 1..200, which a flood may have"),
        ("{kind: loss, frame: FB, goes_on: true}", "only a fault of kind counter"),
    ],
)
def test_what_is_no_flood_is_told(fault: str, what: str, tmp_path: Path) -> None:
    path = motor(tmp_path, 1, None)
    path.write_text(path.read_text().partition("faults:")[0] + f"faults:\n  it: {fault}\n")
    with pytest.raises(RigError, match=what):
        simulate(load_rig(path), tmp_path / "log.mcap")

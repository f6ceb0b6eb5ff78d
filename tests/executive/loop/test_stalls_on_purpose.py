"""A node stands still on purpose; moments of faults; the same bits in virtual time and on a bus."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from pcpc.executive.log import reader
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import VirtualRun, in_memory
from pcpc.executive.rig.reading import Rig, load_rig


def motor(folder: Path, faults: str, *settings: str) -> Rig:
    """Return the motor with a timeline of faults."""
    if not (folder / "motor").exists():
        shutil.copytree(ROOT / "tools/make/template", folder / "motor")
    text = (ROOT / "tools/make/template/rig.yaml").read_text().partition("watch:")[0]
    path = folder / "motor/rig.yaml"
    path.write_text(f"{text}faults:\n{faults}")
    return load_rig(path, settings=["duration_s=0.3", *settings])


def jumps(node: reader.NodeLog) -> list[tuple[int, int]]:
    """Return after which cycles there is a gap, and how long it is."""
    gap = np.diff(node.cycle) - 1
    return [(int(node.cycle[i]), int(gap[i])) for i in np.flatnonzero(gap)]


def test_a_stall_of_the_executive_leaves_the_plant_alone_for_its_cycles(tmp_path: Path) -> None:
    faults = "  it: {kind: stall, node: executive, from: 120ms, for: 5ms}\n"
    log = in_memory(motor(tmp_path, faults, "supervisor.hold_cycles=2"))
    top, low = log.node["executive"], log.node["plant"]
    assert jumps(top) == [(119, 5)] and jumps(low) == []
    missing = low.columns["supervisor.missing_cycles"]
    held = dict(zip(low.cycle.tolist(), missing.tolist(), strict=True))
    assert [held[k] for k in range(120, 128)] == [0, 1, 2, 3, 4, 5, 0, 0]
    voltage = dict(zip(low.cycle.tolist(), low.columns["rx.CMD.voltage"], strict=True))
    assert len({voltage[k] for k in range(120, 126)}) == 1, "the last command is held"
    assert top.timing["health.skipped_cycles"][-1] == 5


def test_a_plant_that_stalled_does_the_physics_of_all_its_periods(tmp_path: Path) -> None:
    faults = "  it: {kind: stall, node: plant, from: 50ms, for: 4ms}\n"  # before the step at 0.1 s
    clean = in_memory(motor(tmp_path, faults, "faults.it.for=0s")).node
    log = in_memory(motor(tmp_path, faults)).node
    assert jumps(log["plant"]) == [(49, 4)] and jumps(log["executive"]) == []
    for name, values in log["plant"].columns.items():
        if name.startswith("motor."):  # it stood still: what it missed changed nothing
            own = clean["plant"].columns[name][log["plant"].cycle]
            np.testing.assert_array_equal(values, own, name)
    assert log["executive"].columns["supervisor.missing_cycles"].max() == 4


def test_more_cycles_than_the_watchdog_waits_are_a_fault(tmp_path: Path) -> None:
    faults = "  it: {kind: stall, node: executive, from: 120ms, for: 50ms}\n"
    limits = "supervisor.hold_cycles=2", "supervisor.fault_after_cycles=3"
    low = in_memory(motor(tmp_path, faults, *limits)).node["plant"]
    state = dict(zip(low.cycle.tolist(), low.columns["supervisor.state"].tolist(), strict=True))
    assert [state[k] for k in range(119, 125)] == [2, 2, 3, 3, 4, 4]


def test_an_executive_that_stalls_to_the_end_makes_its_command_safe_then(tmp_path: Path) -> None:
    """It did so for ever: a command with a rate limit was far from safe, and nothing moved it."""
    faults = "  it: {kind: stall, node: executive, from: 120ms}\n"
    rig = motor(tmp_path, faults)
    limited = rig.path.read_text().replace("high: 24.0}", "high: 24.0, rate_per_s: 100.0}")
    rig.path.write_text(limited)
    settings = ["duration_s=0.3", "supervisor.fault_after_cycles=500"]  # of a plant that waits
    top = in_memory(load_rig(rig.path, settings=settings)).node["executive"]
    assert jumps(top) == [(119, 180)]
    sent = np.abs(top.columns["tx.CMD.voltage"])
    assert sent[119] > 1.0 and sent[-1] <= 0.1 + 1e-9, "V; a step of a cycle from safe"
    assert ((np.diff(sent[120:]) < 0.0) & (np.diff(sent[120:]) >= -0.1 - 1e-9)).all()


def test_who_asks_for_the_end_waits_for_no_stall(tmp_path: Path) -> None:
    faults = "  it: {kind: stall, node: executive, from: 20ms}\n"
    run = VirtualRun(motor(tmp_path, faults, "duration_s=1000"), None)
    for _ in run.advance():
        run.stop()
    assert run.blocks[0].loop.k < 100_000


def test_moments_every_so_often_and_drawn(tmp_path: Path) -> None:
    at = "kind: bias, at: reference.q_d_rad, value: 0.0"
    faults = (
        f"  often: {{{at}, from: 20ms, every: 50ms, for: 3ms}}\n"
        f"  drawn: {{{at}, from: 20ms, times: 40, for: 1ms}}\n"
    )
    node = in_memory(motor(tmp_path, faults)).node["executive"]
    left = node.columns["fault.often.left"]
    assert np.flatnonzero(np.diff(left) > 0).tolist() == [19, 69, 119, 169, 219, 269]
    assert np.flatnonzero(left)[:4].tolist() == [20, 21, 22, 70]

    def drawn(seed: int) -> list[int]:
        made = plan(motor(tmp_path, faults, f"seed={seed}"), "executive", "lockstep")
        name = made.table.index["fault.drawn.left"]
        return [cycle for cycle, place, _ in made.schedule if place == name]

    assert drawn(1) == drawn(1) != drawn(2) and len(drawn(1)) == 40
    assert min(drawn(1)) >= 20 and max(drawn(1)) < 300


def test_a_stall_is_of_rigs_of_two_nodes(tmp_path: Path) -> None:
    relay = ROOT / "tests/executive/relay/rig.yaml"
    path = tmp_path / "rig.yaml"
    path.write_text(f"base: {relay}\nrig: r\nfaults: {{it: {{kind: stall, node: plant}}}}\n")
    with pytest.raises(Exception, match=r"faults.it: a stall needs a rig of two nodes"):
        plan(load_rig(path), "plant", "lockstep")

"""What a fault on purpose excuses: what it took, frame by frame, and nothing beside it."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from processes import ROOT

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.on_purpose import missing_input
from pcpc.tools.after.verdict.outcome import HEALTH, Outcome
from pcpc.tools.after.verdict.summary import summarise

NARROW = "bus: {emulate: 350k, queue: 1}\nerrors: {wrong_sequence: 1000, repeated: 1000}\n"
SPOILED = [
    "loss, frame: CMD, share: 0.0005",
    "loss, frame: CMD",
    "loss, frame: FB",
    "delay, frame: CMD, value: 3",
    "sequence, frame: CMD, share: 0.1",
    "repetition, frame: CMD",
    "repetition, frame: HB_PLANT",
    "corruption, frame: CMD, share: 0.1",
    "insertion, frame: CMD",
    "masquerade, frame: CMD",
    "forgery, frame: CMD, share: 0.1",
    "addressing, frame: CMD, data_of: SYNC",
    "length, frame: CMD, value: 3",
    "counter, how: freeze, frame: CMD",
    "counter, how: offset, value: 5, frame: CMD, goes_on: true",
    "counter, how: random, frame: CMD, share: 0.2",
    "checksum, how: random, frame: CMD",
    "payload, how: freeze, frame: CMD",
    "flood, node: plant, value: 1, share: 0.001",
    "stall, node: executive, times: 2",
    "stall, node: plant, times: 2",
]


def probe_with(folder: Path, more: str) -> tuple[str, dict[str, int], list[str]]:
    """Return verdict, counts and what is too much of a probe in virtual time."""
    rig = folder / "rig.yaml"
    base = f"base: {ROOT / 'plants/probe/rig.yaml'}\nrig: spoiled\nduration_s: 2.0\n"
    limits = "supervisor: {hold_cycles: 2, fault_after_cycles: 1000000}\n"
    rig.write_text(base + limits + more)
    made = load_rig(rig)
    log = folder / "log.mcap"
    simulate(made, log)
    summary = summarise(made, logs.read(log), Outcome("virtual", "memory"))
    log.unlink()
    return summary.verdict, summary.frames, summary.frames_too_many


@pytest.mark.parametrize("fault", SPOILED)
def test_a_fault_excuses_what_it_takes_and_nothing_else(fault: str, tmp_path: Path) -> None:
    spoilt = f"faults: {{it: {{kind: {fault}, from: 100ms, for: 130ms}}}}\n"
    verdict, counts, wrong = probe_with(tmp_path, spoilt)
    assert (verdict, wrong) == ("ok", []), f"of a good wire: {counts}"
    assert counts["missed"] == counts["starved"] == 0, counts
    real = probe_with(tmp_path, NARROW)[1]["missed"]
    ends = ", for: 20ms" if "stall" in fault else ""
    always = f"faults: {{it: {{kind: {fault}, from: 0s{ends}}}}}\n"
    verdict, counts, _ = probe_with(tmp_path, NARROW + always)
    against = counts["missed"] + counts["starved"]  # drawn data may say STOP
    assert verdict == "loss" and against >= 0.9 * real > 30, (real, counts)


@pytest.mark.parametrize(
    ("cycle", "ended", "counts"),
    [
        (97, 0, True), (98, 0, False), (123, 0, False), (124, 0, True),
        (113, 110, False), (114, 110, True), (123, 110, True), (124, 180, True),
    ],
)  # fmt: skip
def test_a_stall_of_another_node_excuses_its_cycles_and_two_beside_them(
    cycle: int, ended: int, counts: bool
) -> None:
    """It lasts for 20 cycles, or until somebody `ended` it."""
    names = [f"health.{HEALTH[key][1]}" for key in ("missed", "starved")]
    at = np.arange(300.0)
    columns = dict.fromkeys(names, np.where(at >= cycle, 1.0, 0.0))
    about = {"faults": {}, "period_ns": 1_000_000}
    own = SimpleNamespace(cycle=at, timing=columns, description=about, tunings=[])
    stall = [{"name": "fault.halt.left", "cycle": 100, "value": 20.0}]
    stall += [{"name": "fault.halt.left", "cycle": ended, "value": 0.0}] * (ended > 0)
    other = SimpleNamespace(description={"faults": {"halt": {"kind": "stall"}}}, tunings=stall)
    log: Any = SimpleNamespace(node={"executive": own, "plant": other})
    told = f"executive: 1 cycles with stale input, first at {1e-3 * cycle:g} s"
    assert missing_input(log, {"executive": {"starved": 1}}) == [told] * counts

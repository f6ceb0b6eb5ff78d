"""A plant whose first sample takes long: the same frames on a bus as in virtual time."""

from pathlib import Path

import pytest
from free_bus import own_bus
from places import ROOT
from two_processes import differing, lockstep, virtual

from pcpc.executive.own_laws import trial
from pcpc.executive.rig.reading import load_rig

SLOW = """
from pcpc.executive.laws.block import Block, stage
from pcpc.plants.probe.model import Inputs, Outputs, Parameters, States

@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    if t == 0.0:
        for _ in range(100_000_000):  # each waits for the one before it: a multiple of the time
            x.x = 0.5 * x.x + 1.0     # that a receive waits, 20 ms, on any machine
    y.position = x.x

BLOCK = Block(step)
"""


def test_a_plant_whose_first_sample_takes_long_has_the_same_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "law_problem", lambda case: None)  # it would interpret the loop
    (tmp_path / "slow.py").write_text(SLOW)
    text = (ROOT / "plants" / "probe" / "rig.yaml").read_text()
    for name in ("probe.dbc", "law.py"):
        text = text.replace(name, str(ROOT / "plants" / "probe" / name))
    rig_file = tmp_path / "rig.yaml"
    rig_file.write_text(text.replace("model.py", "slow.py"))
    rig = load_rig(rig_file, settings=["duration_s=0.02"])
    assert differing(lockstep(rig, own_bus()), virtual(rig)) == []

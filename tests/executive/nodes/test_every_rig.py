"""Every rig and every controller that the project ships: the same bits on a bus as without one."""

import itertools
from pathlib import Path

import pytest
from free_bus import own_bus
from places import ROOT
from two_processes import differing, lockstep, virtual

from pcpc.executive.rig import trial
from pcpc.executive.rig.reading import load_rig

RIGS = sorted((ROOT / "plants").glob("*/rigs/*.yaml"))
RELAY = Path(__file__).parents[1] / "relay" / "rig.yaml"  # three nodes
CYCLES = 400

Case = tuple[Path, str]


def one_of_each() -> list[Case]:
    """Return every rig once and every controller of every plant at least once.

    A rig whose expectations leave a controller out may have tunings that it does not know.
    """
    found: list[Case] = [(RELAY, "ask")]
    for folder in sorted({rig.parents[1] for rig in RIGS}):
        rigs = [rig for rig in RIGS if rig.parents[1] == folder]
        controllers = list(load_rig(rigs[0], resolve=False).config.controllers)
        number = max(len(rigs), len(controllers))
        turns = zip(range(number), itertools.cycle(rigs), itertools.cycle(controllers))
        for _, rig, turn in turns:
            config = load_rig(rig, resolve=False).config
            known = turn in config.expect or not config.expect
            found.append((rig, turn if known else config.controller))
    return found


@pytest.mark.parametrize(
    ("file", "controller"), [pytest.param(*c, id=f"{c[0].stem}-{c[1]}") for c in one_of_each()]
)
def test_lockstep_on_a_bus_has_the_bits_of_virtual_time(file: Path, controller: str) -> None:
    rate_hz = load_rig(file, resolve=False).config.rate_hz
    rig = load_rig(file, controller, [f"duration_s={CYCLES / rate_hz!r}"])
    ours, theirs = lockstep(rig, own_bus()), virtual(rig)
    done = {role: len(node.cycle) for role, node in ours.log.node.items()}
    assert done == {role: CYCLES + below for below, role in enumerate(rig.roles)}, done
    assert not differing(ours, theirs), differing(ours, theirs)[:5]


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

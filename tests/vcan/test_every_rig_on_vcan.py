"""A rig of every plant in lockstep on real vcan buses: the bits of virtual time.

A rig of three nodes takes vcan0 and vcan1. `tests/contract` does the same with all rigs on
udp_multicast: an emulated processor would need an hour for them.
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "contract"))

from rigs import ROOT, shipped
from two_processes import differing, lockstep, virtual

from pcpc.executive.rig.reading import load_rig

pytestmark = pytest.mark.vcan
CYCLES = 50
CASES = [(ROOT / "tests/executive/relay/rig.yaml", "ask"), *shipped()]
ONE_OF_EACH_PLANT = {file.parents[1].name: (file, law) for file, law in reversed(CASES)}


@pytest.mark.parametrize(
    ("file", "controller"), ONE_OF_EACH_PLANT.values(), ids=list(ONE_OF_EACH_PLANT)
)
def test_lockstep_on_vcan_has_the_bits_of_virtual_time(file: Path, controller: str) -> None:
    rate_hz = load_rig(file, resolve=False).config.rate_hz
    rig = load_rig(file, controller, [f"duration_s={CYCLES / rate_hz!r}"])
    ours, theirs = lockstep(rig, "vcan0"), virtual(rig)
    done = {role: len(node.cycle) for role, node in ours.log.node.items()}
    assert done == {role: CYCLES + below for below, role in enumerate(rig.roles)}, done
    assert not differing(ours, theirs), differing(ours, theirs)[:5]

"""What the page shows first of a plant is recorded in all of its rigs."""

import json
from pathlib import Path

import pytest

from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.host.drawn import LAYOUT
from pcpc.tools.host.sources import full
from pcpc.tools.rigs import Shipped, shipped

RIGS = {rig.name: rig for rig in shipped()}


@pytest.mark.parametrize("shown", RIGS.values(), ids=RIGS)
def test_a_layout_names_what_is_recorded(shown: Shipped) -> None:
    rig = load_rig(shown.path)
    beside = Path(rig.evaluation.file) if rig.evaluation else rig.path
    layout = json.loads(beside.with_name(LAYOUT).read_text())
    recorded = set()
    for role in rig.roles:
        made = plan(rig, role, "virtual")
        recorded |= {full(role, made.names[place]) for place in made.columns(timing=False)}
    for panel in layout["panels"]:
        assert panel["kind"] in ("time", "phase")
        assert set(panel["names"]) <= recorded, set(panel["names"]) - recorded

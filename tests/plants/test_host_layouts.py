"""What the page shows first of a plant is recorded in all rigs, and in those of `pcpc new`."""

import json
from pathlib import Path

import pytest

from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.live.host.plant_drawing import LAYOUT
from pcpc.tools.live.host.sources import full
from pcpc.tools.make.new import TEMPLATE
from pcpc.tools.start.rigs import shipped_rigs

RIGS = {rig.name: rig.path for rig in shipped_rigs()}
RIGS |= {"pcpc new": TEMPLATE / "rig.yaml", "pcpc new --cart": TEMPLATE / "cart/rig.yaml"}


@pytest.mark.parametrize("path", RIGS.values(), ids=RIGS)
def test_a_layout_names_what_is_recorded(path: Path) -> None:
    rig = load_rig(path)
    beside = Path(rig.evaluation.file) if rig.evaluation else rig.path
    layout = json.loads(beside.with_name(LAYOUT).read_text())
    recorded = set()
    for role in rig.roles:
        made = plan(rig, role, "virtual")
        recorded |= {full(role, made.names[place]) for place in made.columns(timing=False)}
    for panel in layout["panels"]:
        assert panel["kind"] in ("time", "phase")
        assert set(panel["names"]) <= recorded, set(panel["names"]) - recorded

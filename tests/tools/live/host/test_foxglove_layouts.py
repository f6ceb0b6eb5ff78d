"""The layouts that `pcpc host --foxglove-layout` prints name what the rig's channels have."""

import json
import re
from typing import Any

import pytest
from logcommand import run_here
from test_layouts import KEYS, message_paths, panels

from pcpc.executive.log.channels import Channels
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.start.rigs import ShippedRig, shipped_rigs

RIGS = {rig.name: rig for rig in shipped_rigs()}
ALSO = {"StateTransitions", "Parameters", "RosOut"}


class Fields:
    """Takes topics as a file or a server does, and keeps name and unit of each field."""

    def __init__(self) -> None:
        self.of: dict[str, dict[str, tuple[str, str]]] = {}

    def register(self, name: str, schema: str, text: str, encoding: str) -> int:
        """Keep what a schema in ROS 2's words says."""
        found = re.findall(r"^float64 (\w+)  # (\S+) \[(.*?)\]", text, re.MULTILINE)
        self.of[name] = {field: (variable, unit) for field, variable, unit in found}
        return len(self.of)

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Nothing of it is needed."""


def channels_of(shown: ShippedRig) -> Fields:
    """Return the fields of a rig's channels, as its nodes would register them."""
    rig, fields = load_rig(shown.path), Fields()
    for role in rig.roles:
        made = plan(rig, role, "virtual")
        rows = [(v.name, v.unit, "", "", v.help) for v in made.table.variables]
        facts = {"clock_wall_ns": "0", "clock_monotonic_ns": "0"}
        Channels(
            {
                "node": role, "metadata": facts, "period_ns": 1, "variables": rows,
                "state_columns": [made.names[i] for i in made.columns(timing=False)],
                "timing_columns": [made.names[i] for i in made.columns(timing=True)],
            },
            fields,
        )  # fmt: skip
    return fields


def paths(layout: dict[str, Any]) -> dict[str, str]:
    """Return each curve's message path by its label, those over another variable, too."""
    found = {}
    for name, panel in layout["configById"].items():
        for path in panel.get("paths", ()):
            found[f"{name} {path['label']}"] = path["value"]
        if "xAxisPath" in panel:
            found[f"{name} x"] = panel["xAxisPath"]["value"]
    return found


@pytest.mark.parametrize("shown", RIGS.values(), ids=RIGS)
def test_each_path_is_the_field_of_its_variable(shown: ShippedRig) -> None:
    done = run_here("host", "--foxglove-layout", shown.name)
    assert (done.code, done.err) == (0, "")
    layout, fields = json.loads(done.out), channels_of(shown).of
    assert set(layout) == KEYS
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    own = json.loads(done.out)["configById"]
    assert {name.partition("!")[0] for name in own} == {"Plot", *ALSO}
    named = paths(layout)
    assert len(named) >= 2 and set(message_paths(layout)) <= {*named.values()}
    for label, path in named.items():
        topic, _, field = path.partition(".")
        assert field in fields.get(topic, {}), f"{label}: {path} is in no channel"
        variable, node = fields[topic][field][0], topic.rpartition("/")[0].strip("/")
        if not label.endswith(" x"):
            assert label.split()[1] == (f"{node}:{variable}" if node else variable)


def test_what_a_rig_does_not_record_is_left_out_and_named(tmp_path: Any) -> None:
    assert run_here("new", tmp_path / "lab").code == 0
    layout = {
        "window_s": 2,
        "panels": [
            {"kind": "time", "names": ["controller.e_rad", "plant:motor.gone"]},
            {"kind": "phase", "names": ["controller.gone", "controller.e_rad"]},
        ],
    }
    (tmp_path / "lab" / "layout.json").write_text(json.dumps(layout))
    done = run_here("host", "--foxglove-layout", tmp_path / "lab")
    assert done.code == 0
    assert [line.split()[2].strip(",") for line in done.err.splitlines()] == [
        "plant:motor.gone",
        "controller.gone",
    ]
    plots = [one for key, one in json.loads(done.out)["configById"].items() if "Plot" in key]
    assert [path["value"] for plot in plots for path in plot["paths"]] == [
        "/state.controller_e_rad"
    ]
    assert plots[0]["followingViewWidth"] == 2.0
    (tmp_path / "lab" / "layout.json").write_text("{}")
    done = run_here("host", "--foxglove-layout", tmp_path / "lab")
    assert done.code == 2 and "layout.json: no layout" in done.err and done.err.count("\n") == 1

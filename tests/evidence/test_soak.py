"""Soak runs end well, and what is wrong with a log or with memory is told."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.evidence import soak

RIGS = Path(__file__).resolve().parents[2] / "plants" / "atb1000" / "rigs"
NAME = "tx.CMD.motor_torque"
RIG = f"""\
base: {RIGS / "hull.yaml"}
rig: soak
duration_s: 1.5
evaluation: {{window_s: [0.0, 1.5]}}
executive: {{limits: {{CMD.motor_torque: {{low: -2.0, high: 2.0, rate_per_s: 2000.0}}}}}}
supervisor: {{fault_after_cycles: 50}}
faults:
  loss: {{kind: loss, frame: FB_A}}
  bias: {{kind: bias, at: "plant:tx.FB_A.encoder", value: 0.002}}
expect: null
require: null
"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("soak") / "soak.yaml"
    path.write_text(RIG)
    return path


def test_runs_in_virtual_time_and_on_a_clock_keep_every_promise(rig: Path) -> None:
    virtual, paced = (soak.one(str(rig), 1, number) for number in range(2))
    assert virtual["wrong"] == paced["wrong"] == [], (virtual, paced)
    assert virtual["cycles"] == 3001 and virtual["tuned"] == 3, virtual
    assert paced["tuned"] == 5 and paced["faults"] == 2, paced
    assert min(paced["rss_kb"].values()) > 0 and len(paced["rss_kb"]) == 2, paced


@pytest.fixture(scope="module")
def run(rig: Path) -> tuple[Rig, logs.Node]:
    loaded = load_rig(str(rig), None, ["duration_s=0.3", "evaluation.window_s=[0.0, 0.3]"])
    return loaded, in_memory(loaded).node["executive"]


def beyond(sent: Any, state: Any) -> None:
    sent[100:] = 2.5


def fast(sent: Any, state: Any) -> None:
    sent[:] = np.where(np.arange(len(sent)) % 2, -1.5, 1.5)


def awake(sent: Any, state: Any) -> None:
    state[sent != 0.0] = 0.0


def rising(sent: Any, state: Any) -> None:
    sent[:], state[100:] = np.linspace(0.0, 1.0, len(sent)), 4.0


@pytest.mark.parametrize(("change", "says"), [
    (beyond, "CMD.motor_torque was beyond its bounds"), (fast, "CMD.motor_torque was faster"),
    (awake, "CMD.motor_torque was not safe in INIT"), (rising, "CMD.motor_torque rose in FAULT"),
])  # fmt: skip
def test_a_command_that_breaks_a_promise_is_told(
    run: tuple[Rig, logs.Node], change: Callable[[Any, Any], None], says: str
) -> None:
    loaded, node = run
    assert [*soak.commands(loaded, "executive", node)] == []
    columns = dict(node.columns) | {
        name: node.columns[name].copy() for name in (NAME, "supervisor.state")
    }
    change(columns[NAME], columns["supervisor.state"])
    changed = dataclasses.replace(node, columns=columns)
    told = [*soak.commands(loaded, "executive", changed)]
    assert any(line.startswith(says) for line in told), told


def test_memory_that_grows_is_told() -> None:
    rows = [{"rss_kb": {"executive": 1000 + 3 * i, "plant": 1000}} for i in range(20)]
    assert soak.growth(rows) == ["executive: 1002 kB in the first runs, 1056 kB in the last"]
    assert soak.growth(rows[:5]) == []

"""Soak runs end well, and what is wrong with a log or with memory is told."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds, strictly_holds

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.dev.command import main
from pcpc.tools.dev.evidence import soak
from pcpc.tools.dev.evidence.options import SOAK, SoakRequest
from pcpc.tools.start.children import Child
from pcpc.tools.study.swarm.promises import broken_limits

pytestmark = pytest.mark.deep

RIGS = Path(__file__).resolve().parents[4] / "plants" / "atb1000" / "rigs"
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


def test_a_run_on_a_clock_keeps_every_promise(rig: Path) -> None:
    row = soak.judged_run(str(rig), 1, 1, each_s=2.5)
    assert row["wrong"] == [] and strictly_holds("soak", json.dumps(row)), row
    assert row["tuned"] >= 5 and row["faults"] >= 1 and row["cycles"] > 1000, row
    told = soak.summary_lines([row])
    assert "no run lasted long enough" in told[-1] and max(map(len, told)) <= 80, told


def test_the_log_of_a_run_with_an_error_is_kept_and_named(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(soak, "broken_promises", lambda log, rig: (0, ["the moon is missing"]))
    request = SoakRequest(rig=str(rig), hours=0.0, each_s=1.0, json=True)
    assert soak.command(request) == 1
    out, err = capsys.readouterr()
    row = holds("soak", out)  # one row a line
    assert row["wrong"][0] == "the moon is missing" and "run 0: the moon is missing" in err
    kept = Path(row["wrong"][1].removeprefix("its log: "))
    assert kept.parent == Path("runs") and logs.read(kept / "log.mcap").node, row


def test_the_memory_of_every_process_of_a_run_is_looked_at(rig: Path, tmp_path: Path) -> None:
    words = ["run", str(rig), "-o", str(tmp_path / "run"), "--quiet", "--no-figure"]
    child = Child.started("run", "pcpc.tools.cli", words)
    try:
        nodes = soak._nodes(child, "soak")
        nodes[-1].wait_until(lambda now: now.cycle > 5, 60.0)
        held = soak._memory_kb(child.process.pid)
    finally:
        child.end(60.0)
    assert held.keys() == {"host", "executive", "plant", "recorder"} and min(held.values()) > 10_000


def test_a_run_that_cannot_begin_is_told_with_its_reason(rig: Path, tmp_path: Path) -> None:
    path = tmp_path / "soak.yaml"
    path.write_text(f"{rig.read_text()}bus: {{interface: socketcan, channel: nowhere}}\n")
    row = soak.judged_run(str(path), 1, 1, each_s=1.5)
    code, *why = holds("soak", json.dumps(row))["wrong"]
    assert code == "exit 4" and any("nowhere" in line for line in why), row


def test_a_run_that_ends_by_itself_is_told(tmp_path: Path) -> None:
    for cycles, told in ((1000, ["ended by itself after 1.000 of 9 s", "a fault"]), (8500, [])):
        summary = {"cycles": cycles, "rate_hz": 1000.0, "faults": ["a fault"]}
        (tmp_path / "summary.json").write_text(json.dumps(summary))
        assert soak.early_end(tmp_path, 9.0) == told


@pytest.fixture(scope="module")
def run(rig: Path) -> tuple[Rig, logs.NodeLog]:
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
    run: tuple[Rig, logs.NodeLog], change: Callable[[Any, Any], None], says: str
) -> None:
    loaded, node = run
    assert [*broken_limits(loaded, "executive", node)] == []
    columns = dict(node.columns) | {
        name: node.columns[name].copy() for name in (NAME, "supervisor.state")
    }
    change(columns[NAME], columns["supervisor.state"])
    changed = dataclasses.replace(node, columns=columns)
    told = [*broken_limits(loaded, "executive", changed)]
    assert any(line.startswith(says) for line in told), told


def test_memory_that_grows_is_told() -> None:
    first = [5000 + 900 * i for i in range(30)]  # what is written once for the first time
    flat, more = first + [32_000] * 60, first + [32_000 + 15 * i for i in range(60)]
    held = soak.settled_memory({"plant": flat, "recorder": more, "host": flat[:40]})
    assert held == {"plant": (32_000, 32_000), "recorder": (32_037, 32_847)}, held
    assert soak.growing_memory(held) == [
        "recorder: 32,037 kB once it had settled, 32,847 kB at the end"
    ]
    row = {"run": 3, "cycles": 9, "tuned": 1, "faults": 2, "resets": 0,
           "settled": held, "wrong": soak.growing_memory(held)}  # fmt: skip
    told = soak.summary_lines([row])
    assert told[-1].startswith("run 3: recorder: ") and "+2.53 %" in told[-2], told


def test_the_command_takes_hours_and_tells_rows_as_json(
    rig: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    row = {"run": 0, "cycles": 9, "tuned": 1, "faults": 2, "resets": 0,
           "settled": {}, "wrong": ["broken"]}  # fmt: skip
    monkeypatch.setattr(soak, "judged_run", lambda *_: row)
    assert main(SOAK, [str(rig), "--hours", "1e-15", "--json", "--quiet"]) == 1
    rows = capsys.readouterr().out.splitlines()  # one and more: the clock says how many
    assert rows and all(holds("soak", one) == row for one in rows)

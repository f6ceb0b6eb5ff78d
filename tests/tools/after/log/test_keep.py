"""The snapshot ring: what is around an event is in the log, and nothing else."""

import json
import os
import signal
from pathlib import Path

import pytest
from processes import RIGS, Running, own_bus, pcpc

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

ENGAGE_AT_S = 1.5


def recorded(path: Path, *settings: str) -> logs.Log:
    """Return the log of a virtual run in which the network is engaged at 1.5 s."""
    schedule = f"schedule=[{{at_s: {ENGAGE_AT_S}, set: {{controller.network_on: 1.0}}}}]"
    rig = load_rig(RIGS / "engage.yaml", settings=["duration_s=4.0", schedule, *settings])
    simulate(rig, path)
    return logs.read(path)


def test_what_lies_around_the_event_is_kept(tmp_path: Path) -> None:
    log = recorded(tmp_path / "log.mcap", "record.keep=400ms", "record.on=tuning")
    for name, node in log.node.items():
        assert node.cycle[0] == 1100, f"{name} begins with {node.cycle[0]}, 400 ms before the event"
        assert node.cycle[-1] == 1900, f"{name} ends with {node.cycle[-1]}, 400 ms after it"
        assert set(node.cycle[1:] - node.cycle[:-1]) == {1}
    assert [t["cycle"] for t in log.node["executive"].tunings] == [1500]
    assert not log.missing, log.missing


def test_two_events_make_one_stretch_where_they_are_close(tmp_path: Path) -> None:
    on, off = (f"set: {{controller.network_on: {value}}}" for value in (1.0, 0.0))
    twice = f"schedule=[{{at_s: 1.5, {on}}}, {{at_s: 1.8, {off}}}]"
    log = recorded(tmp_path / "log.mcap", "record.keep=400ms", "record.on=tuning", twice)
    node = log.node["executive"]
    assert set(node.cycle[1:] - node.cycle[:-1]) == {1}
    assert node.cycle[0] == 1100 and node.cycle[-1] == 2200, node.cycle[[0, -1]]


def test_a_run_in_which_nothing_happens_leaves_what_explains_it(tmp_path: Path) -> None:
    done = pcpc(
        "simulate",
        str(RIGS / "slew10.yaml"),
        "--set",
        "duration_s=2.0",
        "--set",
        "record.keep=1s",
        "-o",
        str(tmp_path / "run"),
        "--json",
        "--quiet",
    )
    assert done.ran, done
    assert done.summary["cycles"] == 2000, done.summary
    assert done.summary["records"]["written"] == 0
    assert done.summary["records"]["kept_back"] is True
    log = logs.read(tmp_path / "run" / "log.mcap")
    assert not len(log.node["executive"].cycle)
    assert "rig-resolved.yaml" in log.attachments
    assert int(log.metadata["run"]["discarded"]) > 2 * 2 * 2000, "state and timing of two nodes"


def test_the_death_of_the_emulator_is_in_the_log_with_what_led_to_it(tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    with Running(
        "run",
        str(RIGS / "slew10.yaml"),
        "--bus",
        bus,
        "--set",
        "record.keep=200ms",
        "--no-figure",
        "--set",
        "duration_s=60.0",
        "-o",
        str(folder),
        "--quiet",
    ) as run:
        run.in_the_middle("slew10", bus)
        os.kill(run.pid("plant"), signal.SIGKILL)
        done = run.done()
    assert done.code == 5, done
    node = logs.read(folder / "log.mcap").node["executive"]
    assert node.columns["supervisor.state"][-1] == 4.0, "FAULT"
    fault = next(e["stamp_ns"] for e in node.events if e["event"] == "fault")
    before_s = 1e-9 * (fault - int(node.stamp_ns[0]))
    rows = int((node.stamp_ns < fault).sum())  # not seconds: a stalled machine makes fewer of them
    assert before_s > 0.1 and rows < 450, f"{before_s:.3f} s, {rows} rows before; asked for 0.2 s"


@pytest.mark.parametrize(
    ("setting", "said"), [("record.keep=30", "record.keep"), ("record.on=boom", "record.on")]
)
def test_a_wrong_wish_is_refused_with_its_place(setting: str, said: str) -> None:
    with pytest.raises(RigError, match=said) as refusal:
        load_rig(RIGS / "slew10.yaml", settings=[setting])
    assert "\n" not in str(refusal.value), json.dumps(str(refusal.value))

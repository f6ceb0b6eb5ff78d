"""What the commands about running nodes print with --json, held against their schemas.

One run serves all: its loop waits to be closed, a second controller stands by, and a command that
is not finite brings a fault that waits for its reset.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from json_schemas import holds, strictly_holds
from live_run import pcpc as started
from logcommand import run_here
from processes import DEADLINE_S, ROOT, own_bus, until

import pcpc
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.live import Live

NAME = f"schemas-{os.getpid()}"
GAIN, COMMAND = "controller.gain", "controller.command"
PROBE = ROOT / "plants/probe"
RIG = f"""\
base: {PROBE / "rig.yaml"}
rig: {NAME}
rate_hz: 200.0
duration_s: 600.0
controllers:
  second: {{law: "{PROBE / "law.py"}:BLOCK", parameters: {{gain: 2.0, target: 1.0}}}}
standby: [second]
supervisor: {{hold_cycles: 100000, fault_after_cycles: 100000, on_fault: wait, arm: manual}}
faults:
  drift: {{kind: bias, at: "plant:tx.FB.position", value: 0.01}}
  endless: {{kind: gain, at: controller.command, value: 1e308}}
"""


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[pcpc.Live]:
    folder = tmp_path_factory.mktemp("schemas")
    (folder / "rig.yaml").write_text(RIG)
    with pcpc.running(folder / "rig.yaml", bus=own_bus(), folder=folder / "run") as run:
        yield run


def node(live: pcpc.Live, role: str = "executive") -> Live:
    return live._node(role)


def told(command: str, *words: str, at: str = "") -> Any:
    """Return what a command prints: of its schema, which sees whatever is wrong with it."""
    done = run_here(*command.split(), *words, "--json", *(("--node", at) if at else ()))
    assert done.code == 0, done.err
    return strictly_holds(command, done.out)


def refused(code: int, command: str, *words: str) -> None:
    """Hold that a command which fails prints no JSON, but a line elsewhere."""
    done = run_here(*command.split(), *words, "--json")
    assert (done.code, done.out, done.err.count("\n")) == (code, "", 1), done


def test_the_loop_is_closed_opened_and_handed_over(live: pcpc.Live) -> None:
    executive = node(live).name
    live.wait_until(lambda now: now["supervisor.state"] == State.READY, within_s=DEADLINE_S)
    assert told("operate arm", at=executive)["armed"] is True
    assert told("operate hold", at=executive)["armed"] is False
    assert told("operate resume", at=executive)["armed"] is True
    assert told("operate handover", "second", at=executive)["in_charge"] == "second"
    assert told("operate handover", "proportional", at=executive)["in_charge"] == "proportional"
    refused(2, "operate handover", "third", "--node", executive)
    refused(2, "operate arm", "--node", node(live, "plant").name)


def test_variables_are_shown_and_tuned(live: pcpc.Live, tmp_path: Path) -> None:
    executive, plant = node(live).name, node(live, "plant").name
    assert {one["name"]: one for one in told("get --long", at=executive)}[GAIN]["range"] == [0, 100]
    told("get --long", at=plant)
    several = told("get", f"{executive}:{GAIN}", f"{plant}:lag.position")
    assert [*several] == [f"executive:{GAIN}", "plant:lag.position"]
    assert told("set", f"{GAIN}=5", at=executive)["values"] == {GAIN: 5.0}
    assert told("undo", at=executive)["before"] == {GAIN: 5.0}
    until(lambda: live[GAIN] == 4.0, "undone")
    file = tmp_path / "tuned.yaml"
    for text, changes in (("6", 1), ("6", 0)):
        file.write_text(f"{GAIN}: {text}\n")
        assert len(told("load", str(file), at=executive)["values"]) == changes
        until(lambda: live[GAIN] == 6.0, "loaded")
    for level in ("all", "tune", "none"):
        assert told("operate lock", level, at=executive) == {"lock": level}
    refused(2, "set", f"{GAIN}=-1", "--node", executive)
    refused(2, "get", "controller.gian", "--node", executive)


def test_each_line_of_a_watch_is_json(live: pcpc.Live) -> None:
    with started("watch", GAIN, "time.t_s", "--json", "--node", node(live).name) as watcher:
        assert watcher.stdout is not None
        lines = [watcher.stdout.readline() for _ in range(3)]
        watcher.terminate()
        watcher.communicate(timeout=DEADLINE_S)
    cycles = [strictly_holds("watch", line)["cycle"] for line in lines]
    assert cycles == sorted({*cycles}), "each is another one"


def test_a_fault_on_purpose_is_listed_begun_and_ended(live: pcpc.Live) -> None:
    bus = node(live, "plant").name
    (drift,) = told("fault", at=bus)
    assert (drift["name"], drift["left"]) == ("drift", 0.0)
    assert told("fault", "drift", at=bus)["on"] is True
    until(lambda: told("fault", at=bus)[0]["left"] > 0.0, "begun")
    assert told("fault", "drift", "--end", at=bus)["on"] is False
    refused(2, "fault", "draft", "--node", bus)


def test_a_capture_says_what_it_holds_and_what_it_lacks(live: pcpc.Live, tmp_path: Path) -> None:
    def captured(code: int, trigger: str, *more: str) -> str:
        words = ["scope", COMMAND, "--trigger", trigger, "--quiet", "--json"]
        words += ["--post", "20ms", "--node", node(live).name, *more]
        done = run_here(*words, "-o", tmp_path / f"{len([*tmp_path.iterdir()])}.mcap")
        assert done.code == code, done
        return done.out

    auto = "--pre", "0ms", "--mode", "auto", "--count", "2"
    bursts = strictly_holds("scope", captured(0, "time.t_s < 0 s", *auto))["bursts"]
    assert [one["trigger"] for one in bursts] == [False, False]
    soon = f"time.t_s > {live['time.t_s'] + 0.7} s"
    late = captured(0, soon, "--pre", "590s", "--within", "30s")
    (burst,) = strictly_holds("scope", late)["bursts"]
    assert burst["missing_before"] > 0, burst
    assert captured(1, "time.t_s < 0 s", "--within", "10ms") == ""


def test_what_is_not_finite_is_null_and_a_fault_is_reset(live: pcpc.Live) -> None:
    executive = node(live).name
    refused(1, "operate reset", NAME)
    live.set({GAIN: 10.0, "controller.target": 10.0})
    told("fault", "endless", at=executive)
    live.wait_until(lambda now: now["supervisor.state"] == State.FAULT, within_s=DEADLINE_S)
    until(lambda: told("get", COMMAND, at=executive)[COMMAND] is None, "infinite")
    assert None in {one["value"] for one in told("get --long", at=executive)}
    with started("watch", COMMAND, "--json", "--node", executive) as watcher:
        assert watcher.stdout is not None
        assert holds("watch", watcher.stdout.readline())[COMMAND] is None
        watcher.terminate()
        watcher.communicate(timeout=DEADLINE_S)
    told("fault", "endless", "--end", at=executive)
    live.wait_until(lambda now: now["supervisor.gain"] == 0.0, within_s=DEADLINE_S)
    assert [*told("operate reset", NAME)] == [executive]
    assert [*told("stop", NAME, "--quick")] == [executive]
    live.wait(DEADLINE_S)

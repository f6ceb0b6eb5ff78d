"""A live rig through the door: it runs on a bus, is tuned, reset, held, stopped or cancelled."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import anyio
import pytest
from mcp_door import Door
from processes import DEADLINE_S, ROOT, own_bus, until
from test_mcp_protocol import left_of, wire

pytestmark = pytest.mark.deep  # each begins a server, and a run on a bus
NAME = f"door-{os.getpid()}"
COMMANDS = ["run", "set", "operate", "check"]
RIG = f"""\
base: {ROOT}/plants/probe/rig.yaml
rig: {NAME}
rate_hz: 200.0
duration_s: 600.0
supervisor: {{hold_cycles: 100000, fault_after_cycles: 100000, on_fault: wait}}
controllers: {{proportional: {{law: 'law.py:BLOCK'}}}}
"""


@pytest.fixture
def door(tmp_path: Path) -> Door:
    """Return a door to a rig that waits in FAULT, and whose gain may be anything."""
    bus = own_bus()
    door = Door(tmp_path, commands=COMMANDS, buses=[bus], processes=2, set=["controller.*"])
    law = (ROOT / "plants/probe/law.py").read_text()
    (door.work / "law.py").write_text(law.replace(", 0.0, 100.0)", ", 0.0, 1e308)"))
    (door.work / "rig.yaml").write_text(RIG)
    return door


async def answered(door: Door, tool: str, is_met: Callable[[Any], bool], **asked: Any) -> Any:
    """Return the first answer of a tool that is so."""
    with anyio.fail_after(DEADLINE_S):
        while not is_met(told := await door.call(tool, **asked)):
            pass
    return told


def is_ok(told: Any) -> bool:
    return told.get("exit") == 0


def test_a_run_is_tuned_reset_held_and_stopped(door: Door) -> None:
    async def story(door: Door) -> Any:
        found: dict[str, Any] = {}

        async def run() -> None:
            found["run"] = await door.call("run", rig=".", pacing="real")

        early = await door.call("set", names=["controller.gain=1"])
        assert early["refused"] == "commands", early
        async with anyio.create_task_group() as group:
            group.start_soon(run)
            await answered(door, "set", is_ok, names=["controller.gain=3"])
            wrong = await door.call("set", names=["plant:lag.time_constant_s=1"])
            assert wrong["refused"] == "set", wrong
            second = await door.call("run", rig=".", pacing="real")
            assert not is_ok(second) and second["said"], second
            told = await door.call("operate", verb="reset")
            assert not is_ok(told) and "no fault" in str(told), told
            told = await door.call("set", names=["controller.gain=1e308", "controller.target=10"])
            assert is_ok(told), told
            await answered(door, "operate", lambda told: "still there" in str(told), verb="reset")
            settings = ["controller.gain=4", "controller.target=1"]
            assert is_ok(await door.call("set", names=settings))
            told = await door.call("operate", verb="reset")
            assert is_ok(told) and all(NAME in node for node in told["answer"]), told
            held = await answered(door, "operate", is_ok, verb="hold")
            assert held["answer"]["armed"] is False, held
            assert is_ok(await door.call("operate", verb="resume"))
            stopped = await door.call("operate", verb="stop")
            assert is_ok(stopped), stopped
        return found["run"]

    told = door.session(story)
    assert told["answer"]["verdict"].startswith("safety stop"), told
    assert left_of(door) == []
    code, page = door.report()
    assert code == 1 and "controller.gain" in page


def test_a_run_that_is_cancelled_ends_with_all_its_nodes(door: Door) -> None:
    with wire(door) as server:
        server.call("run", rig=".", pacing="real")
        told: dict[str, Any] = {"method": "notifications/progress"}
        while told.get("method") == "notifications/progress":
            server.call("set", number=2, names=["controller.gain=3"])
            while (told := server.answer()).get("id") != 2:
                pass
            if told["result"]["structuredContent"].get("exit") != 0:
                told = {"method": "notifications/progress"}
        nodes = left_of(door)
        assert len(nodes) > 2, nodes
        gone = {"requestId": 1}
        server.send({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": gone})
        until(lambda: len(left_of(door)) == 1, "only the server is left")
    end = next(one for one in door.entries() if one["kind"] == "end" and one["tool"] == "run")
    assert "ancelled" in end["why"]

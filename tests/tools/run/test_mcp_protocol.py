"""Requests that are none, calls that are cancelled or take too long, and what is left running."""

import json
import os
import random
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from mcp_door import Door

from pcpc.tools import cli

pytestmark = pytest.mark.deep
HELLO = {
    "jsonrpc": "2.0", "id": "hello", "method": "initialize",
    "params": {"protocolVersion": "2025-06-18", "capabilities": {},
               "clientInfo": {"name": "test", "version": "1"}},
}  # fmt: skip
REQUESTS = 1000
PATIENCE_S = 240.0


class Wire:
    """The server's stdin and stdout, as lines."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self.process = process
        self.send(HELLO)
        assert "result" in self.answer()
        self.send({"jsonrpc": "2.0", "method": "notifications/initialized"})

    def send(self, message: Any) -> None:
        """Send a message, or bytes as they are."""
        line = message if isinstance(message, bytes) else json.dumps(message).encode()
        assert self.process.stdin is not None
        rest = line + b"\n"
        while rest:  # a pipe takes 64 KiB at once
            rest = rest[self.process.stdin.write(rest) :]

    def call(self, tool: str, number: int = 1, **arguments: Any) -> None:
        """Send a call of a tool."""
        params = {"name": tool, "arguments": arguments, "_meta": {"progressToken": "p"}}
        self.send({"jsonrpc": "2.0", "id": number, "method": "tools/call", "params": params})

    def answer(self) -> dict[str, Any]:
        """Return the next message of the server."""
        assert self.process.stdout is not None
        assert select.select([self.process.stdout], [], [], PATIENCE_S)[0], "no answer"
        found: dict[str, Any] = json.loads(self.process.stdout.readline())
        return found


@contextmanager
def wire(door: Door) -> Iterator[Wire]:
    """Give a server that has greeted; it ends with 0, in silence, and leaves nothing behind."""
    with subprocess.Popen(
        [sys.executable, *door.words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
        env=os.environ | {"DOOR": str(door.folder)},
    ) as process:
        try:
            yield Wire(process)
        except BaseException:
            process.kill()
            raise
        assert process.stdin is not None and process.stderr is not None
        process.stdin.close()
        said = process.stderr.read().decode()
        assert process.wait(PATIENCE_S) == 0, said
        assert said == ""
    assert left_of(door) == []


def left_of(door: Door) -> list[str]:
    """Return the processes that a server of this folder, or one of its calls, has begun."""
    mark, found = f"DOOR={door.folder}\0".encode(), []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if mark in (place / "environ").read_bytes():
                found.append((place / "cmdline").read_text())
        except OSError:
            continue
    return found


def malformed(draw: random.Random, number: int) -> bytes:
    """Return a request that is wrong in one of many ways."""
    good: dict[str, Any] = {
        "jsonrpc": "2.0", "id": number, "method": "tools/call",
        "params": {"name": "simulate", "arguments": {"rig": "."}},
    }  # fmt: skip
    text = json.dumps(good).encode()
    wrong: Any = draw.choice([None, 5, [1], {"a": 1}, True, "x" * draw.randrange(1, 5000)])
    name = "".join(draw.choices("abcdef/._-", k=draw.randrange(1, 30)))
    call, ask = {"name": "simulate"}, {"jsonrpc": "2.0", "id": number}
    ways: list[Any] = [
        text[: draw.randrange(1, len(text) - 1)],
        bytes(draw.choices([*range(1, 10), *range(11, 256)], k=draw.randrange(1, 200))),
        b"[" * draw.randrange(1, 4000),
        json.dumps(draw.choice([1, "x", [], [good], {}, None, True])).encode(),
        good | {"jsonrpc": draw.choice(["1.0", 2.0, None])},
        good | {"id": draw.choice([{}, [1], {"a": number}])},
        good | {"method": wrong if not isinstance(wrong, str) else name},
        good | {"params": draw.choice([[1], 5, "x"])},
        ask | {"method": name},
        good | {"params": {"name": name}},
        good | {"params": {"arguments": {}}},
        good | {"params": call | {"arguments": draw.choice([[1], 5, "x"])}},
        good | {"params": call | {"arguments": {}}},
        good | {"params": call | {"arguments": {"rig": draw.choice([5, None, [1], {"a": 1}])}}},
        good | {"params": call | {"arguments": {"rig": ".", name: 1}}},
        good | {"params": call | {"arguments": {"rig": ".", "set": draw.choice([5, "a=1", [1]])}}},
        good | {"params": call | {"arguments": {"rig": f"--{name}"}}},
        good | {"params": call | {"arguments": {"rig": draw.choice(["\0", "a\nb", "\ud800"])}}},
        good | {"params": call | {"arguments": {"rig": ".", "columns": ["\udfff"]}}},
        good | {"params": call | {"arguments": {"rig": "x" * 200_000}}},
        ask | {"method": "resources/read", "params": {"uri": f"pcpc://{name}"}},
        ask | {"method": "resources/read", "params": {"uri": "pcpc://docs/../pyproject.toml"}},
        ask | {"method": "resources/read", "params": {"uri": "pcpc://rig/../policy.yaml"}},
    ]
    chosen = draw.choice(ways)
    return chosen if isinstance(chosen, bytes) else json.dumps(chosen).encode()


def test_each_malformed_request_is_answered_with_an_error_of_the_protocol(tmp_path: Path) -> None:
    door, draw = Door(tmp_path), random.Random(59)
    with wire(door) as server:
        for number in range(REQUESTS):
            line = malformed(draw, number)
            server.send(line)
            try:
                answer = server.answer()
            except AssertionError:
                pytest.fail(f"no answer to {line!r}")
            assert isinstance(answer["error"]["code"], int) and answer["error"]["code"] < 0, line
            assert "Traceback" not in json.dumps(answer), line
        server.send({"jsonrpc": "2.0", "id": 1, "method": "tools/list"})
        assert server.answer()["result"]["tools"]
    assert [one["kind"] for one in door.entries()] == ["start", "stop"]


@pytest.fixture
def long_run(tmp_path: Path) -> Door:
    """Return a workspace in which a run takes minutes, and every setting is allowed."""
    door = Door(tmp_path, set=["*"], time_s=2.0, disk_MB=1000)
    door.work.rmdir()
    assert cli.main(["new", str(door.work)]) == 0
    return door


def test_a_call_that_takes_too_long_is_ended_with_all_it_began(long_run: Door) -> None:
    with wire(long_run) as server:
        server.call("simulate", rig=".", set=["duration_s=3000"])
        told = server.answer()
        assert told["method"] == "notifications/progress" and told["params"]["total"] == 2.0
        while "result" not in told:
            told = server.answer()
        assert told["result"]["structuredContent"]["refused"] == "time_s"
    assert [one["kind"] for one in long_run.entries()] == ["start", "call", "end", "stop"]


def test_a_call_that_is_cancelled_is_ended_with_all_it_began(long_run: Door) -> None:
    long_run.policy.write_text(long_run.policy.read_text().replace("time_s: 2.0", "time_s: 300"))
    with wire(long_run) as server:
        server.call("simulate", rig=".", set=["duration_s=3000"])
        assert server.answer()["method"] == "notifications/progress"
        gone = {"requestId": 1}
        server.send({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": gone})
        server.call("check", number=2, rig=".")
        while server.answer().get("id") != 2:
            pass
    end = next(one for one in long_run.entries() if one.get("call") == 2)
    assert end["kind"] == "end" and "ancelled" in end["why"]

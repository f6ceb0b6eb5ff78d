"""What cheats are made of, and that each is refused by a rule that is named, or is a finding."""

import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from mcp import MCPError
from mcp_door import Door

from pcpc.tools import cli

Cheat = Callable[[Door], Awaitable[Any]]
FIRST = "runs/0002-simulate"


def honest_folder(folder: Path) -> Path:
    """Return a folder with a motor that was there at the start, and a run that is ok."""
    assert cli.main(["new", str(folder / "motor")]) == 0
    door = Door(folder)
    told = door.session(lambda door: door.call("simulate", rig="."))
    assert told["answer"]["verdict"] == "ok", told
    assert door.report()[0] == 0
    return folder


def edit(name: str, old: str, new: str, rig: str = ".") -> Cheat:
    """Edit a file by hand, then run."""

    async def cheat(door: Door) -> Any:
        path = door.work / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))
        return await door.call("simulate", rig=rig)

    return cheat


def add(name: str, text: str, rig: str = ".") -> Cheat:
    """Write a file by hand, then run."""

    async def cheat(door: Door) -> Any:
        (door.work / name).parent.mkdir(exist_ok=True)
        (door.work / name).write_text(text.replace("OUTSIDE", str(door.folder)))
        return await door.call("simulate", rig=rig)

    return cheat


def call(tool: str, **arguments: Any) -> Cheat:
    """Ask for it."""
    return lambda door: door.call(tool, **arguments)


def shell(do: Callable[[Path], Any], then: Cheat | None = None) -> Cheat:
    """Do something in the workspace behind the server's back."""

    async def cheat(door: Door) -> Any:
        do(door.work)
        return await (then or call("check", rig="."))(door)

    return cheat


def hold_to_account(door: Door, cheat: Cheat, expected: str) -> None:
    """Let a client cheat; AssertionError where it ends as an unseen green."""

    async def story(door: Door) -> Any:
        try:
            return await cheat(door)
        except MCPError as error:
            return {"protocol": error.message, "error": True}

    told = door.session(story)
    code, page = door.report()
    kind, _, rule = expected.partition(" ")
    if kind == "refused":
        assert told["refused"] == rule and told["error"], told
        assert f"{rule}: " in page
    elif kind == "protocol":
        assert "protocol" in told, told
    elif kind == "exit":
        assert told["exit"] == int(rule) and told["error"], told
    elif kind == "nothing":  # it was in vain
        assert told["exit"] == 0 and code == 0, (told, page)
        assert not (door.folder / "mark").exists() and not (door.work / "mark").exists()
    else:
        assert code == 1, (told, re.findall("<li>.*?</li>", page))
        assert expected in page

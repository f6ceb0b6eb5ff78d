"""Each room of tools/ can be taken out: the rest works, and what is gone is refused in a line."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from processes import ROOT
from test_architecture import TREES, imports, within

import pcpc
from pcpc.tools.cli.commands import COMMANDS

LINKED = ("drivers", "executive", "plants", "pyproject.toml")
_IN_THE_COPY = """
import contextlib, importlib, io, json, sys
from pcpc.tools.cli import main
import pcpc

def done(words):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as end:
            code = end.code
    return [code, out.getvalue(), err.getvalue()]

given, refused = json.loads(sys.argv[1]), {}
came = [done(words) for words in given["commands"]]
for name in given["modules"]:
    try:
        importlib.import_module(name)
    except ImportError as error:
        refused[name] = str(error)
print(json.dumps({"came": came, "refused": refused, "all": pcpc.__all__,
                  "lost": [name for name in pcpc.__all__ if not hasattr(pcpc, name)]}))
"""


@dataclass(frozen=True)
class Room:
    """What is taken out, and a command line that asks for it then."""

    folder: str
    asked: tuple[str, ...]
    told: str  # in the answer
    code: int = 2
    goes_with: tuple[str, ...] = ()  # files and rooms that need this one
    names: tuple[str, ...] = ()  # of `import pcpc`


ROOMS = (
    Room("study/sweep", ("sweep", "probe"), "no such command", names=("Sweep", "sweep")),
    Room("study/margin", ("margin", "probe"), "no such command",
         goes_with=("study/book/rivals.py",), names=("Margin", "Margins", "Response", "margin")),
    Room("study/fit", ("fit", "probe", "latest"), "no such command", names=("Fit", "fit")),
    Room("study/swarm", ("swarm", "--seeds", "1"), "no such command", goes_with=("dev/evidence",)),
    Room("study/bounds", ("bounds", "probe"), "no such command", names=("Bounds", "bounds")),
    Room("make/generate", ("generate", "c", "probe"), "no such command",
         goes_with=("dev/bench", "make/fmu/cli.py", "make/web")),
    Room("make/fmu", ("generate", "fmu", "probe"), "'fmu' is not known"),
    Room("make/web", ("generate", "web", "probe"), "'web' is not known"),
    Room("live/host", ("run", "probe", "--host"), "no option --host",
         goes_with=("make/web",)),
    Room("live/host/foxglove", ("host", "--foxglove"), "no option --foxglove"),
    Room("after/report", ("report", "latest"), "no such command",
         goes_with=("run/mcp/report.py",)),
    Room("run/mcp", ("mcp", "--policy", "a", "--audit", "b"), "no such command"),
    Room("dev/evidence", ("evidence",), "no such command"),
    Room("live/watchdog", ("run", "watched.yaml"), "not in this installation", 4),
    Room("live/xcp", ("xcp",), "no such command"),
    Room("make/device", ("run", "probe", "--device", "true"), "no option --device"),
    Room("after/bisect", ("bisect", "hull", "a", "b"), "no such command"),
    Room("after/branch", ("branch", "latest"), "no such command"),
    Room("after/compare", ("compare", "a", "b"), "no such command",
         goes_with=("after/bisect", "after/branch"), names=("Comparison", "compare")),
    Room("after/step", ("replay", "latest", "--cycle", "1"), "no option --cycle"),
    Room("after/verify", ("replay", "latest", "--brief"), "no option --brief"),
    Room("live/top", ("top",), "no such command"),
    Room("machine/doctor", ("doctor",), "no such command"),
    Room("machine/vm", ("vm",), "no such command", goes_with=("machine/doctor",)),
    Room("study/experiment", ("experiment", "approximation"), "no such command",
         goes_with=("study/book/rivals.py", "study/book/rough.py", "study/margin/book/tuning.py")),
)  # fmt: skip
STAYS = "after/log", "machine/jitter", "start/bus"  # others stand on them


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the project's sources; drivers, executive and plants as links."""
    folder = tmp_path_factory.mktemp("project")
    for part in ("pcpc", "tools"):
        shutil.copytree(ROOT / part, folder / part, symlinks=True)
    for part in LINKED:
        (folder / part).symlink_to(ROOT / part)
    return folder


@contextmanager
def without(copy: Path, room: Room) -> Iterator[None]:
    """Take a room out of the copy for a while."""
    aside, folder = copy / "aside", copy / "tools" / room.folder
    aside.mkdir()
    places = [folder, *(copy / "tools" / name for name in room.goes_with)]
    for number, place in enumerate(places):
        place.rename(aside / f"{number}")
    (folder / "__pycache__").mkdir(parents=True)  # as where git has deleted it
    try:
        yield
    finally:
        shutil.rmtree(folder)
        for number, place in enumerate(places):
            (aside / f"{number}").rename(place)
        aside.rmdir()


def in_copy(copy: Path, commands: list[tuple[str, ...]], folder: Path) -> dict[str, Any]:
    """Return what commands and imports of all that is left came to, in a process of its own."""
    files = [
        f for f in (copy / "tools").rglob("*.py") if not {"template", "__pycache__"} & {*f.parts}
    ]
    modules = [".".join(("pcpc", *f.relative_to(copy).with_suffix("").parts)) for f in files]
    modules = [name.removesuffix(".__init__") for name in modules if "__main__" not in name]
    assert len(modules) > 150, len(modules)
    asked = json.dumps({"commands": commands, "modules": modules})
    done = subprocess.run(
        [sys.executable, "-P", "-c", _IN_THE_COPY, asked],
        cwd=folder,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(copy), "NUMBA_DISABLE_JIT": "1"},
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def listed(text: str) -> set[str]:
    """Return the commands that `pcpc help all` lists."""
    rows = (line[2:] for line in text.splitlines() if line[:2] == "  " != line[2:4])
    return {row.partition("  ")[0] for row in rows}


def commands_in(folder: str) -> set[str]:
    """Return the commands of a room and of those in it; none of a file."""
    files = sorted((ROOT / "tools" / folder).rglob("commands.py"))
    modules = (file.relative_to(ROOT).with_suffix("").as_posix() for file in files)
    found = [import_module(f"pcpc.{name.replace('/', '.')}").COMMANDS for name in modules]
    return {command.name for commands in found for command in commands}


def test_every_room_is_taken_out_here_or_stays() -> None:
    files = (ROOT / "tools").glob("*/**/commands.py")
    rooms = {file.parent.relative_to(ROOT / "tools").as_posix() for file in files}
    rooms = {name for name in rooms if "/" in name}
    known = {room.folder for room in ROOMS if not room.folder.startswith("dev/")}
    assert rooms == known | {*STAYS}


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.folder)
def test_a_room_can_be_taken_out(room: Room, copy: Path, tmp_path: Path) -> None:
    simulate = ("simulate", "probe", "--set", "duration_s=0.02", "--no-figure", "-o", "run")
    watched = f"base: {ROOT}/plants/probe/rig.yaml\nrig: watched\nwatchdog: {{}}\n"
    (tmp_path / "watched.yaml").write_text(watched)
    commands = [("help", "all"), ("--help",), ("check", "probe"), simulate, room.asked]
    with without(copy, room):
        found = in_copy(copy, commands, tmp_path)
    *works, (code, out, err) = found["came"]
    assert [one[0] for one in works] == [0] * 4, works
    gone = set().union(*map(commands_in, (room.folder, *room.goes_with)))
    assert listed(works[0][1]) == {*COMMANDS} - gone, works[0][1]
    assert found["refused"] == {}
    assert set(found["all"]) == {*pcpc.__all__} - {*room.names} and not found["lost"], found["lost"]
    assert code == room.code and not out, (code, out, err)
    assert room.told in err and "Traceback" not in err, err


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.folder)
def test_nothing_else_imports_a_room_not_in_a_function_either(room: Room) -> None:
    gone = tuple(
        f"tools.{name.removesuffix('.py').replace('/', '.')}"
        for name in (room.folder, *room.goes_with)
    )
    left = {
        name: tree
        for name, tree in TREES.items()
        if not within(name.removesuffix(".py").replace("/", "."), gone)
    }
    users = [
        f"{name}:{line}"
        for name, tree in left.items()
        for module, line in imports(tree)
        if within(module, gone)
    ]
    assert len(left) < len(TREES) and not users, users


def test_what_is_about_fmus_is_in_their_room_and_in_the_engine_which_steps_them() -> None:
    engine = {"executive/rig/fmu.py", "executive/rig/fmu_model.py", "executive/rig/fmu_block.py",
              "executive/nodes/fmus.py"}  # fmt: skip
    named = {name for name in TREES if re.search(r"fm[iu]", name)}
    rooms = "tools/make/fmu/", "drivers/fmi/"
    assert engine == {name for name in named if not name.startswith(rooms)}

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
from pcpc.tools import cli
from pcpc.tools.cli.commands import COMMANDS
from pcpc.tools.terminal.rooms import Room, declared_rooms

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
class Taken:
    """What is taken out, and what it says of itself."""

    folder: str
    room: Room

    @property
    def names(self) -> set[str]:
        """Return the names of `import pcpc` that are the room's."""
        return {one for one, place in pcpc._PLACES.items() if f"/{self.folder}/" in f"/{place}/"}


DECLARED = declared_rooms()
ROOMS = [Taken(name, one) for name, one in DECLARED.items() if one.asked]
ROOMS.append(Taken("dev/evidence", Room("", "", "evidence")))  # of the repository only
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
def without(copy: Path, room: Taken) -> Iterator[None]:
    """Take a room out of the copy for a while."""
    aside, folder = copy / "aside", copy / "tools" / room.folder
    aside.mkdir()
    places = [folder, *(copy / "tools" / name for name in room.room.needed_by)]
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


def test_every_room_says_what_it_is() -> None:
    files = (ROOT / "tools").glob("*/**/commands.py")
    rooms = {file.parent.relative_to(ROOT / "tools").as_posix() for file in files}
    assert {name for name in rooms if "/" in name} == {*DECLARED}
    assert {name for name, one in DECLARED.items() if not one.asked} == {*STAYS}
    nav = (ROOT / "mkdocs.yml").read_text("utf-8")
    for name, one in DECLARED.items():
        commands = commands_in(name) | {one.asked.split()[0]} if one.asked else commands_in(name)
        page = (ROOT / one.page).read_text("utf-8")
        assert f"- {one.page}\n" in nav, name
        assert any(f"pcpc {command}" in page for command in commands), (name, one.page)
        place = ROOT / one.attacked_by
        tests = [place] if place.is_file() else [*place.glob("**/test_*.py")]
        text = "".join(file.read_text("utf-8") for file in tests)
        assert re.search(r"pytest\.raises|\.code == [1-9]|refused|== 2", text), (name, place)
        assert all((ROOT / "tools" / other).exists() for other in one.needed_by), name


def test_help_says_what_a_room_says(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["help", "compare"]) == 0
    told = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert ["page", "docs/howto/ci.md"] in told and ["without", "it   no after/branch"] in told


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.folder)
def test_a_room_can_be_taken_out(room: Taken, copy: Path, tmp_path: Path) -> None:
    simulate = ("simulate", "probe", "--set", "duration_s=0.02", "--no-figure", "-o", "run")
    watched = f"base: {ROOT}/plants/probe/rig.yaml\nrig: watched\nwatchdog: {{}}\n"
    (tmp_path / "watched.yaml").write_text(watched)
    commands = [
        ("help", "all"),
        ("--help",),
        ("check", "probe"),
        simulate,
        tuple(room.room.asked.split()),
    ]
    with without(copy, room):
        found = in_copy(copy, commands, tmp_path)
    *works, (code, out, err) = found["came"]
    assert [one[0] for one in works] == [0] * 4, works
    gone = set().union(*map(commands_in, (room.folder, *room.room.needed_by)))
    assert listed(works[0][1]) == {*COMMANDS} - gone, works[0][1]
    assert found["refused"] == {}
    assert set(found["all"]) == {*pcpc.__all__} - room.names and not found["lost"], found["lost"]
    assert code == room.room.code and not out, (code, out, err)
    assert room.room.refused in err and "Traceback" not in err, err


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.folder)
def test_nothing_else_imports_a_room_not_in_a_function_either(room: Taken) -> None:
    gone = tuple(
        f"tools.{name.removesuffix('.py').replace('/', '.')}"
        for name in (room.folder, *room.room.needed_by)
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

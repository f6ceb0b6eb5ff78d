"""A rig by its name, from any folder, and `pcpc rigs`, which lists those that come with pcpc.

hull, atb1000/hull      plants/atb1000/rigs/hull.yaml beside the installed package
probe                   plants/probe/rig.yaml, which runs by itself
acme, acme/rig          the system of an installed package of others
any path                a rig file of your own, or a folder with a rig.yaml; a path wins
a run that goes on      the file of its rig, by the rig's name or as RIG.BUS
"""

import re
import shlex
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypedDict

from pcpc.drivers.errors import Exit
from pcpc.drivers.machine import outside
from pcpc.executive.errors import RigError, did_you_mean, near_file
from pcpc.executive.rig import yamlfile
from pcpc.tools.start.commands import RigsRequest
from pcpc.tools.terminal import screen

_PLANTS = Path(__file__).resolve().parents[2] / "plants"
_SUFFIXES = (".yaml", ".yml")
_RIG = re.compile(r"^rig:\s*([a-z0-9._-]+)", re.MULTILINE)


@dataclass(frozen=True)
class ShippedRig:
    """A rig that comes with pcpc, and the names by which it is found."""

    plant: str
    name: str
    path: Path

    @property
    def names(self) -> set[str]:
        """All names of this rig."""
        own = {self.name, self.plant if self.path.stem == "rig" else self.path.stem}
        return own | {f"{self.plant}/{name}" for name in own}


class RigFacts(TypedDict):
    """A rig that comes with pcpc."""

    plant: str
    name: str
    title: str
    "empty: none"
    file: str
    rate_hz: float
    "Hz"
    duration_s: float
    "s"
    controller: str
    "that is run if none is named"
    controllers: list[str]


Listed = list[RigFacts]


def shipped_rigs() -> Iterator[ShippedRig]:
    """Yield the rigs beside the package that run by themselves, by plant and name."""
    for folder in sorted(path.parent for path in _PLANTS.glob("*/rig.yaml")):
        yield from _rigs_in(folder, folder.name)


def added_rigs() -> Iterator[ShippedRig]:
    """Yield the rigs of systems that packages of others bring under a name of their own."""
    ours = {path.parent.name for path in _PLANTS.glob("*/rig.yaml")}
    for one in outside.additions("plants"):
        if not outside.why_taken(one, ours) and (one.folder / "rig.yaml").is_file():
            yield from _rigs_in(one.folder, one.name)


def _rigs_in(folder: Path, plant: str) -> Iterator[ShippedRig]:
    for path in (folder / "rig.yaml", *sorted(folder.glob("rigs/*.yaml"))):
        if found := _RIG.search(path.read_text(encoding="utf-8", errors="replace")):
            yield ShippedRig(plant, found[1], path)


def find(text: str, others: Iterable[str] = ()) -> str:
    """Return the path of the rig file that `text` names; RigError if there is none.

    `others` are names of what else would do, of which one may be meant.
    """
    if not text:
        raise RigError("'' is not a rig; `pcpc rigs` lists all, and `.` is this folder")
    path = Path(text)
    if (path / "rig.yaml").is_file():
        return str(path / "rig.yaml")
    if path.exists() and not path.is_dir():
        return text
    known = list(shipped_rigs())
    found = [rig for rig in known if text in rig.names]
    if not found:
        known += added_rigs()
        found = [rig for rig in known if text in rig.names]
    if len(found) == 1:
        return yamlfile.display_path(found[0].path)
    if found:
        choice = " or ".join(f"{rig.plant}/{rig.name}" for rig in found)
        raise RigError(f"{text}: {len(found)} rigs have this name; choose {choice}")
    if running := _running(text):
        return yamlfile.display_path(running)
    names = [name for rig in known for name in sorted(rig.names, key=len)]
    if path.suffix in _SUFFIXES:
        there = any(path.stem in rig.names for rig in known)
        cure = f"; the rig that comes with pcpc is called {path.stem}" if there else ""
        raise RigError(f"{text}: no such file{cure or near_file(path, _may_be_a_rig)}")
    what = "a folder without rig.yaml" if path.is_dir() else "no file and no rig of this name"
    cure = did_you_mean(text, [*names, *others]) or near_file(path, _may_be_a_rig)
    raise RigError(f"{text}: {what}{cure}; `pcpc rigs` lists all")


def _may_be_a_rig(path: Path) -> bool:
    return (path / "rig.yaml").is_file() or (path.suffix in _SUFFIXES and path.is_file())


def shell_name(file: str | Path) -> str:
    """Return what a shell takes for a rig file: the name of a shipped one, else the path."""
    own = (rig.name for rig in shipped_rigs() if rig.path == Path(file))
    return shlex.quote(next(own, yamlfile.display_path(Path(file))))


def _running(text: str) -> Path | None:
    """Return the rig file of the runs that are so called; None if they have none, or several."""
    from pcpc.executive.nodes import live  # only where no file has the name: it takes time

    files = {one.block.description.get("file") for one in live.running(text).values()}
    paths = [Path(str(file)) for file in files]
    return paths[0] if len(paths) == 1 and paths[0].is_file() else None


def command(request: RigsRequest) -> int:
    """List the rigs, or those whose name or plant matches. RigError: no such rig."""
    known, words = [*shipped_rigs(), *added_rigs()], request.names
    chosen = [
        rig
        for rig in known
        if not words
        or any(fnmatchcase(name, word) for word in words for name in (*rig.names, rig.plant))
    ]
    if not chosen:
        text = " ".join(words)
        names = [name for rig in known for name in (rig.plant, rig.name)]
        raise RigError(f"{text}: no such rig{did_you_mean(text, names)}")
    listed: Listed = [*_facts_of(chosen)]
    screen.answer(request.json, listed, _lines(listed), 2)
    return Exit.OK


def data_of(file: str | Path) -> dict[str, Any]:
    """Return what a rig file says, with that of its `base`; RigError."""
    return dict(yamlfile.load(Path(file)).data)


def _facts_of(chosen: Iterable[ShippedRig]) -> Iterator[RigFacts]:
    """Yield what is listed; a rig of another package that is wrong is named and left out."""
    for rig in chosen:
        try:
            yield _rig_facts(rig)
        except (RigError, KeyError, TypeError) as error:
            if rig.path.is_relative_to(_PLANTS):
                raise
            said = error if isinstance(error, RigError) else f"{rig.path}: {error} is missing"
            print(said, file=sys.stderr)


def _rig_facts(rig: ShippedRig) -> RigFacts:
    data = data_of(rig.path)
    return {
        "plant": rig.plant, "name": rig.name, "title": data.get("title", ""),
        "file": str(rig.path), "rate_hz": data["rate_hz"], "duration_s": data["duration_s"],
        "controller": data["controller"], "controllers": list(data["controllers"]),
    }  # fmt: skip


def _lines(listed: Listed) -> Iterator[str]:
    """Yield plant by plant what all its rigs share, then a line for each rig."""
    for plant in dict.fromkeys(rig["plant"] for rig in listed):
        own = [rig for rig in listed if rig["plant"] == plant]
        rates = " and ".join(dict.fromkeys(f"{rig['rate_hz']:g} Hz" for rig in own))
        laws = ", ".join(dict.fromkeys(law for rig in own for law in rig["controllers"]))
        yield f"{plant}: {rates}; controllers {laws}"
        rows = [(f"  {rig['name']}", f"{rig['duration_s']:g} s", rig["title"]) for rig in own]
        yield from screen.table(rows, right=(1,))

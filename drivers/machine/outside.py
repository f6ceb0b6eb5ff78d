"""What packages of others add to pcpc: the entry points of an installed package.

    pcpc.rooms   NAME = "module:COMMAND"   a command, a `tools.terminal.command.Command`
    pcpc.plants  NAME = "package.folder"   a system: a folder with rig.yaml, as those of plants/
    pcpc.drives  NAME = "module:KIND"      a drive's dialect, `nodes.planned_robot.RobotKind`
    pcpc.buses   NAME = "module:opened"    opened(channel, fd) of `drivers.can.bus`

Names are read from the files that an installer writes, in 2 ms where importlib.metadata takes 40.
Nothing is imported before it is asked for. What is broken is an error of whoever asks for it.
"""

import os
import re
import sys
from collections.abc import Collection, Iterator
from contextlib import redirect_stdout
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from pcpc.drivers.errors import Exit, UserError

KINDS = "rooms", "plants", "drives", "buses"
ENDLESS_S = 20.0  # of the processor, until an import is ended
_GROUP = re.compile(r"\[pcpc\.(\w+)\]")


class Addition(NamedTuple):
    """What a package adds: its kind, its name, what it points to; `info`: what pip notes of it."""

    kind: str
    name: str
    target: str
    package: str
    version: str
    info: Path

    def __str__(self) -> str:
        return f"{self.name} of {self.package} {self.version}"

    @property
    def folder(self) -> Path:
        """The folder of a package, which is not imported; of one in editable mode its parent is."""
        folder = self.info.parent.joinpath(*self.target.split("."))
        if not folder.is_dir():
            try:
                spec = find_spec(self.target)
            except (Exception, SystemExit):
                spec = None
            folder = Path(next(iter((spec and spec.submodule_search_locations) or ()), folder))
        return folder


def additions(kind: str) -> list[Addition]:
    """Return what the installed packages add of a kind, by name."""
    return [one for one in _all_additions(tuple(sys.path)) if one.kind == kind]


def named(kind: str, name: str) -> Addition | None:
    """Return the addition of a name that is not ours; UserError if it is of two packages."""
    both = [one for one in additions(kind) if one.name == name]
    if both and (why := why_taken(both[0])):
        raise broken(both[0], why)
    return both[0] if both else None


def why_taken(one: Addition, ours: Collection[str] = ()) -> str:
    """Return who else has an addition's name, `ours` or another package; "" for nobody."""
    if one.name in ours:
        return "pcpc has this name itself; its own is used"
    others = [other for other in additions(one.kind) if other.name == one.name and other != one]
    them = ", ".join(f"{other.package} {other.version}" for other in others)
    return f"{them} has this name, too; uninstall one of them" if others else ""


def loaded(one: Addition, target: str = "") -> Any:
    """Import what an addition points to, or another `module:name` of it; UserError says why not."""
    from pcpc.drivers.machine.patience import StalledError, patience  # here, because it takes time

    module, _, name = (target or one.target).partition(":")
    try:
        check_version(one)
        with redirect_stdout(sys.stderr), patience(ENDLESS_S):
            found = import_module(module)
        return getattr(found, name) if name else found
    except UserError:
        raise
    except StalledError:
        why = f"its import does not come to an end, it computed for {ENDLESS_S:g} s"
    except (Exception, SystemExit) as error:
        why = _cause(error)
    raise broken(one, why)


def broken(one: Addition, why: str) -> UserError:
    """Return what is said of an addition that cannot be used."""
    return UserError(f"{one}: {' '.join(why.split())}", Exit.ENVIRONMENT)


def check_version(one: Addition) -> None:
    """Raise UserError if the package is made for another version of pcpc."""
    from importlib import metadata  # here, because they take time; python-can brings the other

    from packaging.requirements import Requirement

    this_version = metadata.version("pcpc")
    try:
        lines = metadata.PathDistribution(one.info).requires or ()
        wanted_packages = [Requirement(line) for line in lines]
    except Exception as error:
        raise broken(one, _cause(error)) from None
    for wanted in wanted_packages:
        if wanted.name == "pcpc" and not wanted.specifier.contains(this_version, prereleases=True):
            raise broken(one, f"is made for pcpc{wanted.specifier}, this is {this_version}")


def _cause(error: BaseException) -> str:
    if isinstance(error, SystemExit):
        return "its import ends the process; it must not"
    import traceback  # here, because it takes time

    frame = traceback.extract_tb(error.__traceback__)[-1]
    is_theirs = "importlib" not in frame.filename and frame.filename != __file__
    where = f" ({Path(frame.filename).name}:{frame.lineno})" if is_theirs else ""
    return f"cannot be loaded: {type(error).__name__}: {error}{where}"


@cache
def _all_additions(paths: tuple[str, ...]) -> list[Addition]:
    """Return what all packages on the paths add; of one that is there twice, the first."""
    by_package: dict[str, list[Addition]] = {}
    for site in (Path(path) for path in paths):
        try:
            names = [name for name in os.listdir(site) if name.endswith(".dist-info")]
        except OSError:
            continue
        for name in sorted(names):
            package, _, version = name.removesuffix(".dist-info").rpartition("-")
            if package not in by_package:
                about = package.replace("_", "-"), version, site / name
                rows = _entries(site / name / "entry_points.txt")
                by_package[package] = [Addition(*row, *about) for row in rows]
    return sorted(one for some in by_package.values() for one in some)


def _entries(file: Path) -> Iterator[tuple[str, str, str]]:
    """Yield kind, name and target of the entry points for pcpc."""
    try:
        text = file.read_bytes() if file.is_file() else b""
    except OSError:
        text = b""
    if b"[pcpc." not in text:
        return
    kind = ""
    for line in text.decode("utf-8", "replace").splitlines():
        key, _, value = line.partition("=")
        if line.startswith("["):
            kind = found[1] if (found := _GROUP.fullmatch(line.strip())) else ""
        elif key.strip() and value.strip():
            yield from [(kind, key.strip(), value.strip())] if kind in KINDS else ()

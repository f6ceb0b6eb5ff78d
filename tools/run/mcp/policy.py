"""What a program may do: a YAML file that it cannot write. What is not in it is denied.

commands: [rigs, check, simulate, report, replay, compare, log]
folders: [.]                  of the workspace, in which its rigs lie
set: ["controller.*"]
"""

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import msgspec

from pcpc import plants
from pcpc.drivers.errors import UserError
from pcpc.tools.start.rigs import find

SHIPPED = Path(plants.__file__).resolve().parent


class Refused(Exception):
    """A call that the policy does not allow: `rule`, the key that would, and why."""

    def __init__(self, rule: str, why: str) -> None:
        super().__init__(why)
        self.rule = rule


class Policy(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The rules; lists are of names and patterns with *, of which none is allowed by default."""

    commands: tuple[str, ...] = ()
    rigs: tuple[str, ...] = ()
    "that come with pcpc"
    folders: tuple[str, ...] = ()
    "of the workspace, in which rigs may lie"
    set: tuple[str, ...] = ()
    "what may be set or varied"
    buses: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    "that a branch may begin"
    imports: tuple[str, ...] = ()
    "packages that Python of the workspace may import besides"
    time_s: float = 60.0
    "of a call"
    runs: int = 20
    "in the whole audit"
    draws: int = 100
    "of a sweep"
    disk_MB: float = 200.0
    "of the workspace"
    processes: int = 1
    "calls at once"

    def allow(self, rule: str, *names: str) -> None:
        """Raise Refused unless a list allows all names."""
        for name in names:
            if not any(fnmatchcase(name, one) for one in getattr(self, rule)):
                raise Refused(rule, f"{name!r} is not in {rule}")

    def limit(self, rule: str, count: float) -> None:
        """Raise Refused for more than a limit."""
        if count > getattr(self, rule):
            raise Refused(rule, f"{count:g} is more than {getattr(self, rule):g}")


def read(text: bytes, place: Path) -> Policy:
    """Return the policy of a file's content; UserError."""
    try:
        return msgspec.yaml.decode(text, type=Policy)
    except msgspec.MsgspecError as error:
        raise UserError(f"{place}: {error}") from None


def check(rules: Policy, tool: str, given: Mapping[str, Any], workspace: Path) -> dict[str, Any]:
    """Return the arguments of a call as they are carried out; Refused, UserError."""
    said = dict(given)
    rules.allow("commands", tool)
    if "rig" in said:
        said["rig"] = _rig(rules, said["rig"], workspace)
    for key in ("set", "vary", *["names"] * (tool == "set")):
        texts = (one.partition("=")[0].rpartition(":")[2].strip() for one in said.get(key, ()))
        rules.allow("set", *texts)
    rules.allow("faults", *(one.partition(":")[0] for one in said.get("fault", ())))
    if tool == "run":
        rules.allow("buses", said.setdefault("bus", next(iter(rules.buses), "auto")))
    if tool == "sweep":
        rules.limit("draws", said.setdefault("draws", rules.draws))
    return said


def _rig(rules: Policy, name: str, workspace: Path) -> str:
    """Return the file of a rig."""
    path = Path(workspace, name).resolve()
    if path.exists():
        path = path / "rig.yaml" if path.is_dir() else path
        if not any(path.is_relative_to((workspace / one).resolve()) for one in rules.folders):
            raise Refused("folders", f"rig {name!r} lies in none of them")
        return str(path)
    path = Path(find(name)).resolve()
    if not path.is_relative_to(SHIPPED):
        raise Refused("folders", f"rig {name!r} is a run of somebody else")
    rules.allow("rigs", path.stem if path.stem != "rig" else path.parent.name)
    return str(path)

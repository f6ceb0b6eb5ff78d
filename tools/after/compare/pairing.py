"""Which run of a new folder is compared with which of an old one, so that none is left out.

Partners have the same rig, controller and kind (a run, or a branch from the same cycle). Of several
such runs these belong together, the first rule first:

    1. those in the same place below their folders
    2. those of the same settings: all values of the rig, the seed too
    3. the others in the order in which they began

A run without a partner is alone. What cannot be read is told as not compared.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.tools.after.compare.pair import fact, settings
from pcpc.tools.after.log.recorded import log_of, logs_below
from pcpc.tools.after.opened import Opened
from pcpc.tools.start.folder import LOG

Key = tuple[str, str, str]  # rig, controller, kind
Partners = tuple["Recorded | None", "Recorded | None"]


@dataclass(frozen=True)
class Recorded:
    """A run of a folder; `place`: of its log, from there."""

    path: Path
    place: str
    head: logs.Log

    @property
    def key(self) -> Key:
        """What a partner has to share."""
        return fact(self.head, "rig"), fact(self.head, "controller"), kind(self.head)

    @cached_property
    def settings(self) -> str:
        """All values of its rig."""
        return json.dumps(sorted(settings(self.head)), default=str)

    @property
    def begin_ns(self) -> int:
        """When it began, 0 for unknown."""
        text = fact(self.head, "clock_wall_ns")
        return int(text) if text.isdecimal() else 0


def kind(log: logs.Log) -> str:
    """Return what a log is, if it is no run from its start."""
    cycle = fact(log, "branch_cycle")
    return f"branch at cycle {cycle}" if cycle else ""


def holds_runs(path: Path) -> bool:
    """Return whether this is a folder of runs, and no run itself."""
    return path.is_dir() and not (path / LOG).exists()


def recorded_runs(text: str, unreadable: Callable[[Path, str], None]) -> list[Recorded]:
    """Return all runs that a word names; RigError if it names none.

    `unreadable` is called for each log that cannot be read, with the reason.
    """
    is_folder = holds_runs(Path(text))
    paths = sorted(logs_below(Path(text))) if is_folder else [log_of(text)]
    runs = []
    for path in paths:
        try:
            place = path.relative_to(text).as_posix() if is_folder else path.name
            runs.append(Recorded(path, place, Opened(path).head))
        except (UserError, OSError) as error:
            words = error.strerror if isinstance(error, OSError) else str(error)
            unreadable(path, f"{words}".removeprefix(f"{path}: "))
    if not paths:
        raise RigError(f"{text}: no log in this folder; name a run, or a folder that holds some")
    return runs


def partners(old: Sequence[Recorded], new: Sequence[Recorded]) -> Iterator[Partners]:
    """Yield every run of both sides once, with its partner or None, by rig and controller."""
    for key in sorted({one.key for one in (*old, *new)}):
        old_runs, new_runs = ([one for one in side if one.key == key] for side in (old, new))
        for same in (_place, _settings, _nothing):
            yield from _taken_pairs(old_runs, new_runs, same)
        yield from ((one, None) for one in old_runs)
        yield from ((None, one) for one in new_runs)


def _taken_pairs(
    old: list[Recorded], new: list[Recorded], same: Callable[[Recorded], str]
) -> Iterator[Partners]:
    """Yield the runs that are the same in something, the first to begin first, and take them."""
    for side in (old, new):
        side.sort(key=lambda one: (one.begin_ns, one.place))
    for run in list(old):
        partner = next((two for two in new if same(two) == same(run)), None)
        if partner is not None:
            old.remove(run)
            new.remove(partner)
            yield run, partner


def _place(one: Recorded) -> str:
    return one.place


def _settings(one: Recorded) -> str:
    return one.settings


def _nothing(_: Recorded) -> str:
    return ""

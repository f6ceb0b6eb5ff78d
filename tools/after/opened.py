"""The one opener of a run: whole, cut, damaged, long, a branch, of an earlier version.

    with opened(path, Trust.of(request.code)) as run:
        run.head, run.log                 without and with the records of its cycles
        run.part(wanted)                  of a long log the columns that are wanted
        run.judged(), run.drawing()       its rig with its evaluation, no law loaded; its drawing
        with run.rig() as rig:            its rig as it ran: its laws open what they opened then

Whoever looks at a run goes by this, and compares by `differences`. `pcpc.Run` does so for Python.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from pcpc.executive.log import reader as logs
from pcpc.tools.after.trust import ASKED, FOLDER, Trust

if TYPE_CHECKING:
    from pcpc.executive.log.long_logs import Wanted
    from pcpc.executive.rig.reading import Rig


class Opened:
    """A log, and whose code of it may run. LogError, RigError where it is looked at."""

    def __init__(self, log: Path | logs.Log, trust: Trust = ASKED) -> None:
        """`log`: one that has been read is not read again."""
        self.path = log if isinstance(log, Path) else log.path
        self.trust = trust
        if not isinstance(log, Path):
            self.head = self.log = log

    @cached_property
    def head(self) -> logs.Log:
        """What the log says of the run, without its cycles."""
        return self.log if "log" in vars(self) else logs.head(self.path)

    @cached_property
    def log(self) -> logs.Log:
        """The whole log: nodes with their columns, events, tunings, attachments."""
        return logs.read(self.path)

    def part(
        self, wanted: Callable[[logs.Log], "Wanted"] = lambda log: {}, **cycles: int
    ) -> logs.Log:
        """Return the log; of a long one only the columns that are wanted.

        `cycles`: from how many on it is long (`short`), and of a `part`.
        """
        from pcpc.executive.log import long_logs  # time

        return long_logs.read(self.path, wanted, **cycles)

    @property
    def _rigs(self) -> ModuleType:
        from pcpc.tools.after.log import rig  # time

        return rig

    @cached_property
    def _files(self) -> "tempfile.TemporaryDirectory[str]":
        return tempfile.TemporaryDirectory(prefix=FOLDER)

    def judged(self, settings: Sequence[str] = ()) -> "tuple[Rig, str]":
        """Return its rig with its evaluation, and a word if that is another one."""
        return self._rigs.judged_rig(self.head, Path(self._files.name), self.trust, settings)

    def stated(self) -> "Rig":
        """Return its rig with limits and requirements, but no evaluation to judge them by."""
        return self._rigs.judged_rig(self.head, Path(self._files.name), None)[0]

    def drawing(self) -> tuple[Path | None, str]:
        """Return the file of its drawing, None without one, and a word if it is another one."""
        return self._rigs.drawing_of_log(self.head, Path(self._files.name), self.trust)

    def rig(
        self, controller: str | None = None, settings: Sequence[str] = (), whole: bool = False
    ) -> "AbstractContextManager[Rig]":
        """Return its rig to run it again, with another controller or `settings`, while it is used.

        `whole`: with its evaluation and its schedule.
        """
        return self._rigs.rig_of(self.head, self.trust, controller, settings, whole)

    def close(self) -> None:
        """Remove what was laid out of it."""
        if "_files" in vars(self):
            self._files.cleanup()


@contextmanager
def opened(log: Path | logs.Log, trust: Trust = ASKED) -> Iterator[Opened]:
    """Yield a run as long as it is looked at."""
    run = Opened(log, trust)
    try:
        yield run
    finally:
        run.close()

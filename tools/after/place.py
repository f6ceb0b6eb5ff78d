"""What a virtual run from Python needs besides its rig: a place for its log, a line of progress."""

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.record import Run
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.start.folder import LOG, run_folder
from pcpc.tools.terminal.progress import Compiling, Progress


def progress(quiet: bool | None) -> Progress:
    """Return where progress is shown: None is on a terminal only. Compiling is told unless True."""
    if quiet is not True:
        Compiling().told(False)
    return Progress(not sys.stderr.isatty() if quiet is None else quiet)


@contextmanager
def log_place(folder: str | Path | None, rig: Rig) -> Iterator[tuple[Path, Any]]:
    """Yield the log's place in `folder`; without one, in a temporary one, and what keeps that."""
    if folder is None:
        keep = tempfile.TemporaryDirectory(prefix="pcpc-")
        yield Path(keep.name) / LOG, keep
    else:
        with run_folder(folder, rig) as place:
            yield place / LOG, None


def finished_run(log: Path, rig: Rig, outcome: Outcome, keep: Any) -> Run:
    """Return the run; in a folder of the user's its summary is written too."""
    run = Run(log, rig, outcome, keep)
    if keep is None:
        summary_file.write_json(run.result, log.with_name(summary_file.NAME))
        run.asked = False  # by its user
    return run

"""The folder of a run: made before its first cycle, gone again when nothing came of it."""

import contextlib
import itertools
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from pcpc.executive.errors import FULL, RigError
from pcpc.executive.rig.reading import Rig

LOG = "log.mcap"


@contextlib.contextmanager
def run_folder(named: str | Path | None, rig: Rig) -> Iterator[Path]:
    """Make the run's folder with an empty log, which claims it; RigError if that cannot be.

    At the end what is still empty is removed.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    for number in itertools.count(1):  # of the runs that start in the same second
        name = f"{stamp}-{rig.config.rig}" + (f"-{number}" if number > 1 else "")
        folder = Path(named or Path("runs") / name)
        made = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / LOG).touch(exist_ok=False)
            break
        except FileExistsError:
            if named:
                what = "holds a log already" if folder.is_dir() else "is no folder"
                raise RigError(f"{folder}: {what}; choose another folder with -o") from None
        except OSError as error:
            if error.errno in FULL:
                raise OSError(error.errno, error.strerror, str(folder)) from None
            raise RigError(f"{folder}: {error.strerror}; choose another folder with -o") from None
    try:
        yield folder
    finally:
        if not (folder / LOG).stat().st_size:
            (folder / LOG).unlink()
        with contextlib.suppress(OSError):  # not empty: it stays
            for path in made:
                path.rmdir()

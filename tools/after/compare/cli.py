"""`pcpc compare`: two runs, two folders of runs, or two versions of the rigs in virtual time."""

import argparse
import math
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.tools.after.compare.comparison import Comparison
from pcpc.tools.after.compare.overlay import Criteria
from pcpc.tools.after.compare.pair import ALONE
from pcpc.tools.after.compare.recorded import recorded_comparison
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.option_notes import refuse
from pcpc.tools.terminal.outfile import write_text
from pcpc.tools.terminal.progress import Progress


def command(options: argparse.Namespace) -> int:
    """Compare, print, write; see `_code`. UserError: wrong input."""
    if not (math.isfinite(options.tolerance) and options.tolerance >= 0.0):
        raise UserError(f"--tolerance {options.tolerance:g}: expected 0 or more")
    is_new = options.output is not None and not Path(options.output).exists()
    how = Criteria(options.tolerance, _folder(options.output))
    try:
        found = _comparison(options, how, Progress(options.quiet))
        _allow(found, options.allow)
    except UserError:
        if is_new and how.figures is not None:
            with suppress(OSError):  # it holds figures already
                how.figures.rmdir()
        raise
    files = {options.markdown: found.markdown(), options.json: found.json()}
    for name in (name for name in files if name not in (None, "-")):
        write_text(Path(name), files[name] + "\n")
    if how.figures is not None:
        write_text(how.figures / "report.md", found.markdown(pictures=True) + "\n")
    sys.stdout.write(files.get("-", found.text()) + "\n")
    return _code(found, options.fail_on)


def _comparison(options: argparse.Namespace, how: Criteria, progress: Progress) -> Comparison:
    if options.against is not None:
        if options.jobs is not None and options.jobs < 1:
            raise UserError(f"--jobs {options.jobs}: expected 1 or more")
        from pcpc.tools.after.compare import versions  # time

        return versions.version_comparison(options, how, progress)
    why = "only with --against; two recordings are compared as they are"
    refuse(options, why, "controller", "jobs", "all_controllers")
    if len(options.words) != 2:
        cure = "name two, old and new, or a version with --against"
        raise UserError(f"expected two runs to compare, got {len(options.words)}; {cure}")
    old, new = options.words
    return recorded_comparison(old, new, how, progress)


def _code(found: Comparison, on: str) -> Exit:
    """Return the exit code: LOSS if all that fails is that logs are cut."""
    if not found.fails(on):
        return Exit.OK
    whole = [pair for pair in found.pairs if not pair.is_cut]
    rest = Comparison(found.old, found.new, whole)
    only_cut = len(whole) < len(found.pairs) and not (whole and rest.fails(on))
    return Exit.LOSS if only_cut else Exit.NOT_MET


def _allow(found: Comparison, names: Sequence[str]) -> None:
    """Let what is called so be on one side only, but no new run that is not ok; UserError."""
    for name in names:
        mine = [pair for pair in found.pairs if pair.is_called(name)]
        if not mine:
            known = dict.fromkeys(pair.rig for pair in found.pairs)
            raise UserError(f"--allow {name}: no such rig here{did_you_mean(name, known)}")
        for pair in mine:
            pair.allowed = pair.state == ALONE and not (pair.side == "new" and pair.faulty)


def _folder(name: str | None) -> Path | None:
    """Return an empty folder for figures; UserError if that cannot be."""
    if name is None:
        return None
    need(f"-o {name}: its figures need", FIGURE)
    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise FileExistsError(0, "is not empty")
    except OSError as error:
        raise UserError(f"{folder}: {error.strerror}; choose another folder with -o") from None
    return folder

"""`pcpc compare`: two runs, two folders of runs, or two versions of the rigs in virtual time."""

import math
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.tools.after.compare.commands import CompareRequest
from pcpc.tools.after.compare.comparison import Comparison
from pcpc.tools.after.compare.overlay import Criteria
from pcpc.tools.after.compare.pair import ALONE
from pcpc.tools.after.compare.recorded import recorded_comparison
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.outfile import write_text
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.rooms import part_of

_OF_RUNS = ("fail_on", "allow", "markdown", "output", "against", "controller", "all_controllers",
            "jobs")  # fmt: skip


def command(request: CompareRequest) -> int:
    """Compare, print, write; see `_code`. UserError: wrong input."""
    if request.beside.value("bits"):
        request.refuse("of runs, not of their bits", *_OF_RUNS)
        about = request.words, request.beside, request.tolerance, request.json, request.quiet
        return int(part_of("after/log", "diff").compare_bits(*about))
    if not (math.isfinite(request.tolerance) and request.tolerance >= 0.0):
        raise UserError(f"--tolerance {request.tolerance:g}: expected 0 or more")
    is_new = request.output is not None and not Path(request.output).exists()
    how = Criteria(request.tolerance, _folder(request.output))
    try:
        comparison = _comparison(request, how, Progress(request.quiet))
        _allow(comparison, request.allow)
    except UserError:
        if is_new and how.figures is not None:
            with suppress(OSError):  # it holds figures already
                how.figures.rmdir()
        raise
    files = {request.markdown: comparison.markdown(), request.json: comparison.json()}
    for name in (name for name in files if name not in (None, "-")):
        write_text(Path(name), files[name] + "\n")
    if how.figures is not None:
        write_text(how.figures / "report.md", comparison.markdown(pictures=True) + "\n")
    sys.stdout.write(files.get("-", comparison.text()) + "\n")
    return _code(comparison, request.fail_on)


def _comparison(request: CompareRequest, how: Criteria, progress: Progress) -> Comparison:
    if request.against is not None:
        if request.jobs is not None and request.jobs < 1:
            raise UserError(f"--jobs {request.jobs}: expected 1 or more")
        from pcpc.tools.after.compare import versions  # time

        return versions.version_comparison(request.against, request, how, progress)
    why = "only with --against; two recordings are compared as they are"
    request.refuse(why, "controller", "jobs", "all_controllers")
    request.refuse("only with --bits", "absolute")
    if len(request.words) != 2:
        cure = "name two, old and new, or a version with --against"
        raise UserError(f"expected two runs to compare, got {len(request.words)}; {cure}")
    old, new = request.words
    return recorded_comparison(old, new, how, progress)


def _code(comparison: Comparison, on: str) -> Exit:
    """Return the exit code: LOSS if all that fails is that logs are cut."""
    if not comparison.fails(on):
        return Exit.OK
    whole = [pair for pair in comparison.pairs if not pair.is_cut]
    rest = Comparison(comparison.old, comparison.new, whole)
    only_cut = len(whole) < len(comparison.pairs) and not (whole and rest.fails(on))
    return Exit.LOSS if only_cut else Exit.NOT_MET


def _allow(comparison: Comparison, names: Sequence[str]) -> None:
    """Let what is called so be on one side only, but no new run that is not ok; UserError."""
    for name in names:
        mine = [pair for pair in comparison.pairs if pair.is_called(name)]
        if not mine:
            known = dict.fromkeys(pair.rig for pair in comparison.pairs)
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

"""`pcpc log plot`: variables of one log or several over time, as a picture.

    one log        an axis for each unit, at most 8 lines on it
    several logs   an axis for each variable, a line for each log
    no variables   the figure of the log's evaluation, else what the controller works with

Every pixel column shows the first, last, lowest and highest value that falls into it, so a spike of
one cycle stays visible in a log of an hour. Time is s from the first record of each log.
"""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import animate, series
from pcpc.tools.after.log.commands import PlotRequest
from pcpc.tools.after.log.drawing import DPI, DrawnLog, page_of
from pcpc.tools.after.log.recorded import no_log
from pcpc.tools.after.log.series import Series
from pcpc.tools.after.opened import opened
from pcpc.tools.after.trust import Trust
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.outfile import LogCommandError, new_file
from pcpc.tools.terminal.progress import Progress

SUFFIXES = (".png", ".svg", ".pdf")
MOST_AXES, MOST_LINES = 12, 8
_DEFAULT_AXES = 6  # of several logs, where no variable is named
_DEFAULTS = ("reference.*", "controller.*", "rx.*", "*")


def command(request: PlotRequest) -> int:
    """Carry out `plot`; return the exit code. LogCommandError, RigError."""
    if request.moving:
        return animate.command(request)
    request.refuse("only with --moving", "speed")
    return draw(request)


def draw(request: PlotRequest) -> int:
    """Draw variables over time, or the figure of the evaluation; return the exit code."""
    progress = Progress(request.quiet)
    if request.output.suffix.lower() not in SUFFIXES:
        raise LogCommandError(f"{request.output}: not a picture; expected {', '.join(SUFFIXES)}")
    paths, patterns = logs_and_patterns(request.words)
    need("a picture needs", FIGURE)
    read = [series.read_log(path, progress) for path in paths]
    loss = Exit.LOSS if any(log.missing for log in read) else Exit.OK
    window = series.window_s(request.window)
    is_whole = window == series.EVER_S
    if len(read) == 1 and not patterns and is_whole and _has_own(read[0], request, progress):
        return loss
    names = names_of(paths)
    sources = [
        DrawnLog(name, log, series.all_series(log), series.start_ns(log))
        for name, log in zip(names, read, strict=True)
    ]
    groups = groups_of(sources, patterns)
    for source in sources:
        absent = [name for group in groups for name in group if name not in source.series]
        if absent:
            progress.say(f"{source.log.path}: no {', '.join(absent)}")
    drawn = (
        source.inside(name, window).any()
        for source in sources
        for group in groups
        for name in group
        if name in source.series
    )
    if not is_whole and not any(drawn):
        raise LogCommandError(f"{paths[0]}: nothing was recorded there; see --start, --end")
    progress.show(f"drawing {sum(map(len, groups))} variables")
    page = page_of(sources, groups, window)
    with new_file(request.output, force=True) as path:
        page.savefig(path, dpi=DPI, format=request.output.suffix[1:].lower())
    progress.close()
    print(f"{request.output}: {', '.join(name for group in groups for name in group)}")
    return loss


def logs_and_patterns(words: Sequence[str]) -> tuple[list[Path], list[str]]:
    """Return logs and patterns; a run folder stands for its log.

    LogCommandError: no log, or a wrong name.
    """
    paths, patterns = [], []
    for word in words:
        path = Path(word)
        path = path / "log.mcap" if path.is_dir() else path
        if path.is_file():
            paths.append(path)
        elif "/" in word or word.endswith(".mcap"):
            raise LogCommandError(f"{word}: {no_log(word)}")
        else:
            patterns.append(word)
    if not paths:
        raise LogCommandError(f"{words[0]}: {no_log(words[0])}")
    return paths, patterns


def names_of(paths: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths that tell them apart, without log.mcap."""
    parts = [path.absolute().parts for path in paths]
    parts = [p[:-1] if p[-1] == "log.mcap" else (*p[:-1], Path(p[-1]).stem) for p in parts]
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(p[-length:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{path} ({number})" for number, path in enumerate(paths, 1)]


# What to draw


def _has_own(log: logs.Log, request: PlotRequest, progress: Progress) -> bool:
    """Draw the figure of the log's evaluation; return False, and say why, if there is none."""
    from pcpc.tools.after.verdict.judge import Judge  # numba

    with opened(log, Trust.of(request.code)) as run:
        try:
            rig, note = run.judged()
        except (logs.LogError, RigError) as error:
            progress.say(f"{error}; variables instead")
            return False
        if note:
            progress.say(f"{log.path}: {note}")
        try:
            judge = Judge.of(rig)
            if not judge.evaluation.panels:
                return False
            with new_file(request.output, force=True) as path:
                about = judge.metrics(log), path, judge.requirements(log)
                if reason := judge.draw(log, *about):
                    raise LogCommandError(reason, Exit.ENVIRONMENT)
        except RigError as error:
            raise LogCommandError(str(error)) from None
    system = Path(judge.given.file).parent.name
    print(f"{request.output}: the figure of {system}, rig {rig.config.rig}")
    return True


def groups_of(sources: Sequence[DrawnLog], patterns: Sequence[str]) -> list[list[str]]:
    """Return the names on each axis; LogCommandError for an unknown one or too many."""
    known = {name: one for source in sources for name, one in source.series.items()}
    where = sources[0].log.path if len(sources) == 1 else f"{len(sources)} logs"
    if not known:
        raise LogCommandError(f"{where}: no variables recorded")
    read = [source.log for source in sources]
    names = (
        series.choose(known, patterns, str(where), read) if patterns else _default(sources, known)
    )
    groups: list[list[str]] = []
    if len(sources) > 1:
        groups = [[name] for name in names]
    else:
        for name in names:
            unit = known[name].unit
            mine = [g for g in groups if known[g[0]].unit == unit and len(g) < MOST_LINES]
            if mine:
                mine[-1].append(name)
            else:
                groups.append([name])
    if not patterns:
        return groups[: _DEFAULT_AXES if len(sources) > 1 else MOST_AXES]
    if len(groups) > MOST_AXES:
        raise LogCommandError(
            f"{where}: {len(names)} variables need {len(groups)} axes; a picture has at most "
            f"{MOST_AXES}: choose fewer variables"
        )
    return groups


def _default(sources: Sequence[DrawnLog], known: dict[str, Series]) -> list[str]:
    """Return the watched variable, then the first kind of variables of which some change."""
    watched = [s.log.node[n].description.get("watch") or "" for s in sources for n in s.log.node]
    chosen = dict.fromkeys(name for name in watched if name in known)
    for pattern in _DEFAULTS:
        names = [name for name in known if fnmatchcase(name, pattern)]
        moving = [n for n in names if len(v := known[n].values) and (v != v[0]).any()]
        chosen |= dict.fromkeys(moving)
        if pattern != "reference.*" and moving:
            break
    return list(chosen) or list(known)[:1]

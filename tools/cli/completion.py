"""What a shell completes by itself, and `pcpc completion`, which prints how it is told.

argcomplete asks this program for the words that may come next; commands and options it knows from
the parser, values from here. Nothing here imports numba: an answer takes a quarter of a second.
"""

import argparse
import os
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.machine.commands import CompletionRequest
from pcpc.tools.terminal import option_notes

if TYPE_CHECKING:
    from pcpc.executive.nodes.live import Live, LiveVariable

_CHAPTER = re.compile(r"^CHAPTER = (\d+)", re.MULTILINE)
Words = Iterable[str]


def command(request: CompletionRequest) -> int:
    """Print the code by which a shell learns to complete `pcpc`."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["pcpc"], shell=request.shell))
    return Exit.OK


def complete(parser: argparse.ArgumentParser, names_of_two: Sequence[str]) -> None:
    """Answer a shell and end, if it asks. `names_of_two`: those of two words, as `bus emulate`."""
    import argcomplete
    from argcomplete.finders import safe_actions

    safe_actions.update(option_notes.ACTIONS.values())  # these only note what is typed
    line = os.environ.get("COMP_LINE", "")
    names = "|".join(name.replace(" ", r"\s+") for name in names_of_two)
    if found := re.match(rf"\s*\S+\s+({names})(?=\s)", line):  # one word to the parser
        name = "\\ ".join(found[1].split())
        os.environ["COMP_LINE"] = f"{line[: found.start(1)]}{name}{line[found.end(1) :]}"
        point = int(os.environ.get("COMP_POINT", len(line)))
        os.environ["COMP_POINT"] = str(point + len(name) - len(found[1]))
    argcomplete.autocomplete(parser, exclude=[*names_of_two])


def attach(command: str, action: argparse.Action) -> None:
    """Give an argument of a command the words that it can have; else a shell offers files."""
    found = _OF.get(f"{command} {action.dest}") or _OF.get(action.dest)
    if found is not None and action.choices is None:
        vars(action)["completer"] = partial(_candidates, found)


def _candidates(
    found: Callable[[argparse.Namespace], Words],
    prefix: str,
    parsed_args: argparse.Namespace,
    **_: object,
) -> list[str]:
    try:
        return [word for word in found(parsed_args) if word.startswith(prefix)]
    except (UserError, OSError):  # a rig that is wrong, a node that has just ended
        return []


def _rigs(options: argparse.Namespace) -> Words:
    from pcpc.tools.start.rigs import shipped_rigs

    return [
        *(name for rig in shipped_rigs() for name in rig.names if "/" not in name),
        *_files(".yaml"),
    ]


def _rigs_and(*words: str) -> Callable[[argparse.Namespace], Words]:
    return lambda options: [*_rigs(options), *words]


def _running(options: argparse.Namespace) -> "dict[str, Live]":
    from pcpc.tools.live.local_nodes import Nodes

    there = Nodes()
    if (node := getattr(options, "node", None)) is not None:
        return {node: there.find(node)}
    return there.running()


def _names_of_rigs(options: argparse.Namespace) -> set[str]:
    return {str(one.block.description.get("rig")) for one in _running(options).values()}


def _runs(options: argparse.Namespace) -> Words:
    return [*_names_of_rigs(options), *_rigs(options)]


def _plants(options: argparse.Namespace) -> Words:
    from pcpc.tools.start.rigs import shipped_rigs

    return {name for rig in shipped_rigs() for name in (rig.plant, rig.name)}


def _controllers(options: argparse.Namespace) -> Words:
    from pcpc.tools.start import rigs

    return [] if options.rig is None else list(rigs.data_of(rigs.find(options.rig))["controllers"])


def _logs(options: argparse.Namespace) -> Words:
    from pcpc.tools.after.log.recorded import LATEST, RUNS

    return [LATEST, *(f"{run}" for run in RUNS.glob("*/")), *_files(".mcap")]


def _files(suffix: str) -> Words:
    """Return the files and folders here that may be meant."""
    return [
        f"{path}/" if path.is_dir() else str(path)
        for path in Path().iterdir()
        if path.suffix == suffix or (path.is_dir() and not path.name.startswith("."))
    ]


def _nodes(options: argparse.Namespace) -> Words:
    from pcpc.executive.rig.roles import ROLES

    return [*ROLES, *_running(options), *_names_of_rigs(options)]


def _variables(options: argparse.Namespace) -> Words:
    return {one.name for one in _live_variables(options)}


def _parameters(options: argparse.Namespace) -> Words:
    return {f"{one.name}=" for one in _live_variables(options) if one.range is not None}


def _live_variables(options: argparse.Namespace) -> "list[LiveVariable]":
    """Return the variables of the node that is named, else of all."""
    return [one for live in _running(options).values() for one in live.variables.values()]


def _faults(options: argparse.Namespace) -> Words:
    from pcpc.executive.nodes.injecting import faults_of

    return {one.name for one in faults_of([*_running(options).values()])}


def _laws(options: argparse.Namespace) -> Words:
    from pcpc.executive.nodes.operating import laws

    return {name for live in _running(options).values() for name in laws(live)}


def _levels(options: argparse.Namespace) -> Words:
    from pcpc.executive.nodes.mailbox import LEVELS

    return LEVELS


def _studies(options: argparse.Namespace) -> Words:
    project = Path(__file__).resolve().parents[2]
    texts = (path.read_text(encoding="utf-8") for path in project.glob("plants/*/book/study.py"))
    chapters = {f"chapter{found[1]}" for text in texts if (found := _CHAPTER.search(text))}
    return [*chapters, *(path.stem for path in project.glob("tools/study/**/book/[a-z]*.py"))]


_OF = {  # by the name of an argument, or of a command and its argument
    "rig": _rigs, "controller": _controllers, "node": _nodes, "log": _logs, "logs": _logs,
    "words": _logs, "rigs names": _plants, "get names": _variables,
    "watch names": _variables, "scope names": _variables, "set names": _parameters,
    "lock level": _levels, "handover controller": _laws, "standby": _controllers,
    "experiment name": _studies, "bus rig": _rigs_and("emulate"),
    "sweep rig": _rigs_and("merge", "rerun"), "run": _runs, "fault name": _faults,
}  # fmt: skip

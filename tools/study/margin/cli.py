"""`pcpc margin RIG`: the margins of a rig's loop, as a table, JSON and pictures."""

import argparse
import json
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.study.margin import limit_cycle
from pcpc.tools.study.margin.find import SETTLE_S, Question, margin_of
from pcpc.tools.study.margin.limit_cycle_result import LimitCycle
from pcpc.tools.study.result import Result
from pcpc.tools.terminal.ending import writing
from pcpc.tools.terminal.extras import FIGURE, need

_OF_MARGINS = (("at", "at_s"), ("settle",) * 2, ("amplitude",) * 2, ("lowest",) * 2)


def command(options: argparse.Namespace) -> int:
    """Find the margins and print them."""
    _check(options)
    if options.output is not None:
        need("-o: a figure needs", FIGURE)
    if options.limit_cycle is not None:
        return _print(options, _limit_cycle(options))
    rig = load_rig(options.rig, options.controller, options.set)
    question = Question(
        options.loop,
        options.at_s or 0.0,
        options.method,
        options.amplitude,
        options.seed,
        SETTLE_S if options.settle is None else options.settle,
        options.lowest,
    )
    return _print(options, margin_of(rig, question))


def _check(options: argparse.Namespace) -> None:
    """Raise UserError for an option that would have no effect, and for a folder that is a file."""
    cycle = options.limit_cycle is not None
    given = {f"--{name}": getattr(options, place) is not None for name, place in _OF_MARGINS}
    given |= {"--method": options.method != "both", "--seed": options.seed != 1}
    if not cycle:
        given = {"--linear": bool(options.linear)}
        given |= {"--with": options.grown is not None, "--factors": options.factors is not None}
    for option in (name for name, was in given.items() if was):
        cure = "leave one of them out" if cycle else "name the growing setting with --limit-cycle"
        raise UserError(f"{option} {'and' if cycle else 'is of'} --limit-cycle: {cure}")
    folder = options.output
    there = [] if folder is None else [one for one in (folder, *folder.parents) if one.exists()]
    if there and not there[0].is_dir():
        raise UserError(f"{there[0]}: is not a folder; choose another one with -o")


def _limit_cycle(options: argparse.Namespace) -> LimitCycle:
    settings = options.linear or [f"@{limit_cycle.linear_file(Path(options.rig))}"]
    return limit_cycle.limit_cycle(
        Path(options.rig),
        options.controller,
        options.set,
        settings,
        options.limit_cycle,
        options.grown,
        options.factors,
        options.loop,
    )


def _print(options: argparse.Namespace, found: Result) -> int:
    print(json.dumps(found.json()) if options.json else found.text(), end="\n" * options.json)
    if options.output is not None:
        with writing(Path(options.output)):
            found.save(options.output)
    return Exit.OK

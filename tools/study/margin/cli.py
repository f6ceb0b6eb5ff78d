"""`pcpc margin RIG`: the margins of a rig's loop, as a table, JSON and pictures."""

import argparse
import json
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.start.folder import folder_of
from pcpc.tools.study.margin import limit_cycle
from pcpc.tools.study.margin.find import Question, margin_of
from pcpc.tools.study.margin.limit_cycle_result import LimitCycle
from pcpc.tools.study.margin.result import Margin
from pcpc.tools.study.result import Result
from pcpc.tools.terminal.ending import writing
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.option_notes import refuse

_OF_MARGINS = ("at_s", "settle", "amplitude", "lowest", "method", "seed")
_OF_CYCLES = ("linear", "grown", "factors")


def command(options: argparse.Namespace) -> int:
    """Find the margins, or a limit cycle, and print what was found."""
    if options.limit_cycle is None:
        refuse(options, "is of --limit-cycle; name the growing setting with it", *_OF_CYCLES)
    else:
        refuse(options, "is not of --limit-cycle; leave one of them out", *_OF_MARGINS)
    find = _margins if options.limit_cycle is None else _limit_cycle
    if options.output is None:
        _print(options, find(options))
        return Exit.OK
    need("-o: a figure needs", FIGURE)
    with folder_of(options.output, "") as folder, writing(folder):
        found = find(options)
        _print(options, found)
        found.save(folder)
    return Exit.OK


def _margins(options: argparse.Namespace) -> Margin:
    rig = load_rig(options.rig, options.controller, options.set)
    question = Question(
        options.loop,
        options.at_s,
        options.method,
        options.amplitude,
        options.seed,
        options.settle,
        options.lowest,
    )
    return margin_of(rig, question)


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


def _print(options: argparse.Namespace, found: Result) -> None:
    print(json.dumps(found.json()) if options.json else found.text(), end="\n" * options.json)

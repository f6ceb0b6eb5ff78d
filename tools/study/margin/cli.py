"""`pcpc margin RIG`: the margins of a rig's loop, as a table, JSON and pictures."""

import json
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.start.folder import folder_of
from pcpc.tools.study.margin import limit_cycle
from pcpc.tools.study.margin.commands import MarginRequest
from pcpc.tools.study.margin.find import margin_of
from pcpc.tools.study.result import Result
from pcpc.tools.terminal.ending import writing
from pcpc.tools.terminal.extras import FIGURE, need

_OF_MARGINS = ("at_s", "settle_s", "amplitude", "lowest_hz", "method", "seed")
_OF_CYCLES = ("linear", "grown", "factors")


def command(request: MarginRequest) -> int:
    """Find the margins, or a limit cycle, and print what was found."""
    if request.limit_cycle is None:
        request.refuse("is of --limit-cycle; name the growing setting with it", *_OF_CYCLES)
    else:
        request.refuse("is not of --limit-cycle; leave one of them out", *_OF_MARGINS)
    if request.output is None:
        _print(request, _found(request))
        return Exit.OK
    need("-o: a figure needs", FIGURE)
    with folder_of(request.output, "") as folder, writing(folder):
        found = _found(request)
        _print(request, found)
        found.save(folder)
    return Exit.OK


def _found(request: MarginRequest) -> Result:
    if request.limit_cycle is None:
        return margin_of(load_rig(request.rig, request.controller, request.set), request.question)
    settings = request.linear or [f"@{limit_cycle.linear_file(Path(request.rig))}"]
    return limit_cycle.limit_cycle(
        Path(request.rig),
        request.controller,
        request.set,
        settings,
        request.limit_cycle,
        request.grown,
        request.factors,
        request.question.loop,
    )


def _print(request: MarginRequest, found: Result) -> None:
    print(json.dumps(found.json()) if request.json else found.text(), end="\n" * request.json)

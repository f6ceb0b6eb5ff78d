"""`pcpc margin RIG`: the margins of a rig's loop, as a table, JSON and pictures."""

import argparse
import json
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.console.ending import writing
from pcpc.tools.margin import limit_cycle
from pcpc.tools.margin.find import SETTLE_S, of
from pcpc.tools.margin.limit_cycle_result import LimitCycle
from pcpc.tools.margin.result import Margin


def command(options: argparse.Namespace) -> int:
    """Find the margins and print them."""
    if options.limit_cycle is not None:
        return _told(options, _limit_cycle(options))
    rig = load_rig(options.rig, options.controller, options.set)
    settle_s = SETTLE_S if options.settle is None else options.settle
    found = of(
        rig, options.loop, options.at_s or 0.0, options.method, options.amplitude, options.seed,
        settle_s, options.lowest,
    )  # fmt: skip
    return _told(options, found)


def _limit_cycle(options: argparse.Namespace) -> LimitCycle:
    settings = options.linear or [f"@{limit_cycle.of_plant(Path(options.rig))}"]
    return limit_cycle.limit_cycle(
        Path(options.rig), options.controller, options.set, settings, options.limit_cycle,
        options.grown, options.factors, options.loop,
    )  # fmt: skip


def _told(options: argparse.Namespace, found: Margin | LimitCycle) -> int:
    print(json.dumps(found.json()) if options.json else found.text(), end="\n" * options.json)
    if options.output is not None:
        try:
            with writing(Path(options.output)):
                found.save(options.output)
        except ImportError as error:
            raise UserError(str(error), Exit.ENVIRONMENT) from None
    return Exit.OK

"""`pcpc margin RIG`: the margins of a rig's loop, as a table, JSON and pictures."""

import argparse
import json

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.margin.find import SETTLE_S, of


def command(options: argparse.Namespace) -> int:
    """Find the margins and print them."""
    rig = load_rig(options.rig, options.controller, options.set)
    settle_s = SETTLE_S if options.settle is None else options.settle
    found = of(
        rig, options.loop, options.at_s or 0.0, options.method, options.amplitude, options.seed,
        settle_s, options.lowest,
    )  # fmt: skip
    if options.output is not None:
        try:
            found.save(options.output)
        except ImportError as error:
            raise UserError(str(error), Exit.ENVIRONMENT) from None
    print(json.dumps(found.json()) if options.json else found.text(), end="\n" * options.json)
    return Exit.OK

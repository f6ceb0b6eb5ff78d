"""`pcpc bench [NAME...]`: ratios against a yardstick, measured interleaved in one run.

A ratio is taken within a round, in which product and yardstick follow each other, and its spread is
the quartiles over rounds: on a machine that others use too, times mean little and ratios stay.
"""

import argparse
import json
import sys
from dataclasses import dataclass
from importlib import import_module

import numpy as np
from numpy.typing import ArrayLike

from pcpc.drivers.errors import BusError, Exit, UserError
from pcpc.tools.dev.bench.commands import SUITES
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.start.native import native
from pcpc.tools.terminal.outfile import check_file
from pcpc.tools.terminal.progress import Progress

ON_REQUEST = ("rate", "host", "startup", "batch")  # one to three minutes each


@dataclass(frozen=True)
class Ratio:
    """`own` and `base` are medians in `unit`; `ratio` = own/base: quartile, median, quartile."""

    suite: str
    what: str
    against: str
    own: float
    base: float
    unit: str
    ratio: tuple[float, float, float]

    @classmethod
    def of(
        cls, suite: str, what: str, against: str, own: ArrayLike, base: ArrayLike, unit: str
    ) -> "Ratio":
        """Return the ratio of `own` to `base`, both (rounds,) and measured in turn."""
        low, median, high = np.percentile(np.divide(own, base), (25.0, 50.0, 75.0)).tolist()
        ours, theirs = (float(np.median(np.asarray(a))) for a in (own, base))
        return cls(suite, what, against, ours, theirs, unit, (low, median, high))


def command(options: argparse.Namespace) -> int:
    """Run suites and print their ratios; ENVIRONMENT where a yardstick is missing."""
    if unknown := [name for name in options.names if name not in SUITES]:
        raise UserError(f"{' '.join(unknown)}: no such suite; known: {', '.join(SUITES)}")
    if options.rounds < 1:
        raise UserError(f"--rounds {options.rounds}: expected 1 or more")
    check_file("--json", options.json)
    with native(options.names == ["batch"]):  # as `pcpc sweep`
        return _measured(options)


def _measured(options: argparse.Namespace) -> int:
    progress, found, code = Progress(options.quiet), [], Exit.OK
    for name in options.names or [name for name in SUITES if name not in ON_REQUEST]:
        try:
            ratios = import_module(f"pcpc.tools.dev.bench.{name}").measure(progress, options.rounds)
        except (BenchError, BusError) as error:
            progress.close()
            print(f"{name}: {error}", file=sys.stderr)
            code = Exit.ENVIRONMENT
            continue
        progress.close()
        for ratio in ratios:
            show(ratio)
        found += ratios
    if options.json:
        try:
            options.json.write_text(json.dumps([vars(r) for r in found], indent=1) + "\n")
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(options.json)) from None
    return code


def show(r: Ratio) -> None:
    """Print a ratio in a line."""
    low, median, high = r.ratio
    print(
        f"{r.what:16} {r.own:10.4g} {r.unit:5} {r.against:32} {r.base:.4g} {r.unit}\n"
        f"{'':16} ratio {median:.3f} ({low:.3f} to {high:.3f})"
    )

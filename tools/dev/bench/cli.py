"""`pcpc bench [NAME...]`: ratios against a yardstick, measured interleaved in one run."""

import argparse
import json
import sys
from importlib import import_module

from pcpc.drivers.errors import BusError, Exit, UserError
from pcpc.tools.dev.bench.commands import SUITES
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.start.native import native
from pcpc.tools.terminal.outfile import check_file
from pcpc.tools.terminal.progress import Progress

ON_REQUEST = ("rate", "host", "startup", "batch")  # one to three minutes each


def command(options: argparse.Namespace) -> int:
    """Run suites and print their ratios; ENVIRONMENT where a yardstick is missing."""
    if unknown := [name for name in options.names if name not in SUITES]:
        raise UserError(f"{' '.join(unknown)}: no such suite; known: {', '.join(SUITES)}")
    if options.rounds < 1:
        raise UserError(f"--rounds {options.rounds}: expected 1 or more")
    check_file("--json", options.json)
    with native(options.names == ["batch"]):  # as `pcpc sweep`
        return _run_suites(options)


def _run_suites(options: argparse.Namespace) -> int:
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
            print(ratio)
        found += ratios
    if options.json:
        try:
            options.json.write_text(json.dumps([vars(r) for r in found], indent=1) + "\n")
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(options.json)) from None
    return code

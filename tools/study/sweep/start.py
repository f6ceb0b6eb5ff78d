"""`pcpc sweep` in a process of its own: compiled for this machine's processor, with equal bits.

But not `rerun`: one run is not worth the loop compiled anew, beside that of `simulate` and `run`.
"""

import argparse

from pcpc.tools.start.native import native
from pcpc.tools.start.rigs import find
from pcpc.tools.study.sweep.numbers import LIMITS, check_whole
from pcpc.tools.terminal.extras import need, need_for_sweep


def command(options: argparse.Namespace) -> int:
    """Carry out `pcpc sweep`; return the exit code."""
    need_for_sweep()
    if options.scheduler is not None:
        need("--scheduler needs", "distributed")
    if options.words[0] not in (
        "merge",
        "rerun",
    ):  # before a minute of compiling
        find(options.words[0])
        for name, most in LIMITS.items():
            if (value := getattr(options, name)) is not None:
                check_whole(name, value, 1, most)
    with native(options.words[0] != "rerun"):
        from pcpc.tools.study.sweep import cli  # which imports numba

        return cli.command(options)

"""`pcpc sweep` in a process of its own: compiled for this machine's processor, with equal bits.

But not `rerun`: one run is not worth the loop compiled anew, beside that of `simulate` and `run`.
"""

import argparse

from pcpc.tools.starting.native import native


def command(options: argparse.Namespace) -> int:
    """Carry out `pcpc sweep`; return the exit code."""
    with native(options.words[0] != "rerun"):
        from pcpc.tools.sweep import cli  # which imports numba

        return cli.command(options)

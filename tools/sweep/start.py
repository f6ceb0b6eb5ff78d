"""`pcpc sweep` in a process of its own: compiled for this machine's processor, with equal bits."""

import argparse
import os


def command(options: argparse.Namespace) -> int:
    """Carry out `pcpc sweep`; return the exit code."""
    os.environ.setdefault("PCPC_CPU", "native")  # numba has not been imported yet
    from pcpc.tools.sweep import cli

    return cli.command(options)

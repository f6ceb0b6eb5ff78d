"""`pcpc evidence` in a process of its own: compiled for this machine's processor, equal bits."""

import argparse

from pcpc.tools.starting.native import native


def command(options: argparse.Namespace) -> int:
    """Carry out `pcpc evidence`; return the exit code."""
    with native():
        from pcpc.tools.evidence import cli  # which imports numba

        return cli.command(options)

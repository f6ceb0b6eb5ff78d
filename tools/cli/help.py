"""`pcpc help [GROUP]`: the commands of a group, or of all."""

import argparse

from pcpc.drivers.errors import Exit
from pcpc.tools.cli.commands import of_group, overview


def command(options: argparse.Namespace) -> int:
    """Print the commands of `options.group`, without one what people begin with."""
    print(overview() if options.group is None else of_group(options.group))
    return Exit.OK

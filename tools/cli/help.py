"""`pcpc help [GROUP]`: the commands of a group, or of all."""

from pcpc.drivers.errors import Exit
from pcpc.tools.cli.commands import of_group, overview
from pcpc.tools.machine.commands import HelpRequest


def command(request: HelpRequest) -> int:
    """Print the commands of `request.group`, without one what people begin with."""
    print(overview() if request.group is None else of_group(request.group))
    return Exit.OK

"""Commands: rigs."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import BASIC_CODES, Add, Command


def rigs(add: Add) -> None:
    """Take names or patterns."""
    add("names", nargs="*", metavar="NAME", help="only these rigs or plants; patterns with * ? []")
    take.json(add)


COMMANDS = (
    Command(
        "rigs",
        "list the rigs that come with pcpc",
        "pcpc rigs atb1000 'friction-*'",
        rigs,
        codes=BASIC_CODES,
        module="start.rigs",
        first=True,
    ),
)

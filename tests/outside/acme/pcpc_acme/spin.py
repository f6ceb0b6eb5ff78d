"""`pcpc spin`."""

from pcpc.drivers.errors import Exit
from pcpc_acme.room import SpinRequest


def command(request: SpinRequest) -> int:
    """Say where one ends."""
    print(f"{'-' * request.backwards}{360 * request.turns} deg")
    return Exit.OK

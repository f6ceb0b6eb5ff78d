"""`python -m pcpc.tools.dev.evidence`."""

import sys

from pcpc.tools.dev import command
from pcpc.tools.dev.evidence.options import COMMAND

if __name__ == "__main__":
    sys.exit(command.main(COMMAND, sys.argv[1:], own=True))

"""`python -m pcpc.tools.cli`: the command line in a process of its own."""

import sys

from pcpc.tools.cli import main

if __name__ == "__main__":
    sys.exit(main())

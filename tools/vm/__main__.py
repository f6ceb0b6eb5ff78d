"""`python -m pcpc.tools.vm -- COMMAND`, the same as `pcpc vm -- COMMAND`."""

import sys

from pcpc.tools.vm.cli import run

sys.exit(run(sys.argv[1:]))

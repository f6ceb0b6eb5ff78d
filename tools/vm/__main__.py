"""`python -m tools.vm -- COMMAND`, the same as `pcpc vm -- COMMAND`."""

import sys

from tools.vm.cli import run

sys.exit(run(sys.argv[1:]))

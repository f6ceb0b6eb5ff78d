"""`python -m pcpc.tools.vm -- COMMAND`, the same as `pcpc vm -- COMMAND`."""

import sys

from pcpc.tools.ending import ended
from pcpc.tools.vm.cli import run

sys.exit(ended(lambda: run(sys.argv[1:]), goes_on=True))

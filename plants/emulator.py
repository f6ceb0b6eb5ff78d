"""The plant emulator: the same engine as the executive, started by SYNC or by its own clock."""

import sys

from executive.process import main

if __name__ == "__main__":
    sys.exit(main(["plant", *sys.argv[1:]]))

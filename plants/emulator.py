"""The plant emulator: the same engine as the executive, started by SYNC or by its own clock."""

import signal
import sys

if __name__ == "__main__":  # before numpy is imported, as in executive.process
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored ones never come
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})

from pcpc.executive.nodes.process import main

if __name__ == "__main__":
    sys.exit(main(["plant", *sys.argv[1:]]))

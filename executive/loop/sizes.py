"""Sizes of a node's memory (no numba here).

They are fixed, so that one compiled loop serves every rig; `executive.nodes.plan` checks the fit.
"""

MAX_VARIABLES = 8192
MAX_BLOCKS = 8
MAX_COPIES = 1024
MAX_LIMITS = 64
MAX_FRAMES = 32
MAX_PEERS = 16  # nodes below one
MAX_SIGNALS = 256
MAX_SCHEDULE = 2048
LINE_WORDS = 8  # what two processes write lies on lines of its own

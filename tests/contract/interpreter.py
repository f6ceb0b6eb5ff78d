"""Simulates rigs in a process that compiles nothing: one a line of its input, until that ends."""

import json
import sys
from pathlib import Path

from pcpc.drivers.compiled.jit import JIT_OFF
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

assert JIT_OFF
for line in sys.stdin:
    path, controller, settings, log = json.loads(line)
    try:
        simulate(load_rig(Path(path), controller, settings), Path(log))
        print(log, flush=True)
    except Exception as error:  # told by the test that asked
        print(repr(error), flush=True)

"""That freed blocks leave the process, where small ones that stay lie between them."""

import subprocess
import sys

import pytest

BLOCKS, BLOCK_BYTES = 200, 100_000
SCRIPT = f"""
import sys
import numpy as np
from pcpc.drivers.machine import heap

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096

if sys.argv[1] == "given back":
    heap.give_back()
del_me = np.ones(1 << 20, np.uint8)
del del_me  # from here on glibc would keep blocks up to 1 MiB in its heap
first = resident()
blocks, small = [], []
for _ in range({BLOCKS}):
    blocks.append(np.ones({BLOCK_BYTES}, np.uint8))
    small.append(np.ones(2000, np.uint8))
held = resident() - first
blocks.clear()
print(held, resident() - first)
"""


@pytest.mark.parametrize("kept", ["given back", "kept"])
def test_what_is_freed_goes_back_to_the_kernel(kept: str) -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT, kept], capture_output=True, check=True)
    held, left = map(int, done.stdout.split())
    assert held > 0.9 * BLOCKS * BLOCK_BYTES
    if kept == "given back":
        assert left < 0.1 * held
    else:
        assert left > 0.5 * held, "glibc gives it back by itself: drivers.machine.heap is needless"

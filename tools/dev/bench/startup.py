"""The time from the command `pcpc run slew10` to the first cycle of the executive.

    warm    with compiled code in the cache, against an interpreter that only imports what every
            node needs of others: numpy, numba, cantools
    cold    with an empty cache, in a folder of its own, against warm; one round, a minute or so

From before the process is made to the stamp of the first record in its log; both on the monotonic
clock. Python keeps what it compiled of modules, as after any installation, also where
PYTHONDONTWRITEBYTECODE says otherwise: without, 240 modules cost 0.3 s more.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pcpc.executive.log import reader as logs
from pcpc.tools.dev.bench.cycle import RIG
from pcpc.tools.dev.bench.ratio import Ratio
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.terminal.progress import Progress

SUITE = "startup"
BUS = "udp_multicast:239.74.163.65:43165"  # of its own
IMPORTS = "import numpy, numba, cantools"
RUN_S = 0.1
WARM_ROUNDS = 7
_NOT_OURS = "NUMBA_CACHE_DIR", "PYTHONDONTWRITEBYTECODE"


def measure(progress: Progress, rounds: int = 15, cold: bool = True) -> list[Ratio]:
    """Return "warm", and "cold" if asked; BenchError."""
    own, bare = [], []
    first_cycle_s()  # fills the cache
    count = min(rounds, WARM_ROUNDS)
    for i in range(count):
        progress.show(f"startup: warm, round {i + 1} of {count}")
        own.append(first_cycle_s())
        bare.append(bare_s())
    found = [Ratio.from_rounds(SUITE, "warm", f"python -c '{IMPORTS}'", own, bare, "s")]
    if cold:
        progress.say("startup: cold, compiling in an empty cache, about 20 s")
        with tempfile.TemporaryDirectory() as folder:
            first = first_cycle_s(Path(folder))
        base = found[0].own
        found.append(Ratio.from_rounds(SUITE, "cold", "warm", [first], [base], "s"))
    return found


def first_cycle_s(cache: Path | None = None) -> float:
    """Return the time to the first cycle of one run, with `cache` instead of the user's cache."""
    environment = {k: v for k, v in os.environ.items() if k not in _NOT_OURS}
    if cache is not None:
        environment["XDG_CACHE_HOME"] = str(cache)
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-P", "-m", "pcpc.tools.cli", "run", RIG, "--bus", BUS, "--quiet",
                 "--no-figure", "--json", "--set", f"duration_s={RUN_S}", "-o", folder]  # fmt: skip
        begin_ns = time.monotonic_ns()
        done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
        try:
            stamps = logs.read(Path(folder) / "log.mcap").node["executive"].stamp_ns
        except (logs.LogError, KeyError, OSError):
            last = (done.stderr.strip().splitlines() or ["no word"])[-1]
            raise BenchError(f"`{' '.join(words[3:6])}` failed: {last}") from None
    return 1e-9 * (int(stamps[0]) - begin_ns)


def bare_s() -> float:
    """Return the time in which an interpreter imports what is not ours, and ends."""
    begin_ns = time.monotonic_ns()
    subprocess.run([sys.executable, "-P", "-c", IMPORTS], check=True)
    return 1e-9 * (time.monotonic_ns() - begin_ns)

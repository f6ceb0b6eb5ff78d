"""A start that finds all its code compiled imports nothing that it does not use."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pcpc.drivers.compiled.jit import JIT_OFF

NOT_NEEDED = {  # a second or so, all together
    "asyncio", "can", "cantools.tester", "http", "matplotlib", "numba",
    "pandas", "rich", "scipy", "sqlite3", "ssl",
}  # fmt: skip
MAIN = """
import json, sys
from pcpc.tools.cli import main
assert main(sys.argv[1:]) == 1, "too short to be judged"
print("\\n" + json.dumps(sorted(sys.modules)))
"""


@pytest.mark.skipif(JIT_OFF, reason="numba is switched off")
@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "hull", "--controller", "pd", "--no-figure"],
        ["run", "hull", "--controller", "pd", "--no-figure", "--pacing", "lockstep"],
    ],
    ids=["simulate", "run"],
)
def test_a_warm_start_imports_no_numba_and_nothing_else_of_no_use(
    words: list[str], tmp_path: Path
) -> None:
    found: set[str] = set()
    for i in range(2):  # the first one may have to compile
        more = ["--set", "duration_s=0.02", "-o", str(tmp_path / str(i))]
        done = subprocess.run(
            [sys.executable, "-c", MAIN, *words, *more], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr
        found = NOT_NEEDED & set(json.loads(done.stdout.splitlines()[-1]))
    assert not found, f"{words[0]} imports {sorted(found)}"

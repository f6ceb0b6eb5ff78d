"""What hardly ever happens in a cycle happens as it should in the interpreted loop."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT


@pytest.mark.deep
@pytest.mark.parametrize("name", ["rare_cycles.py", "rare_frames.py"])
def test_rare_cycles_are_as_they_should_be(name: str) -> None:
    words = ["-m", "pytest", "-p", "no:cacheprovider", str(Path(__file__).with_name(name))]
    done = subprocess.run(
        [sys.executable, *words],
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-500:]

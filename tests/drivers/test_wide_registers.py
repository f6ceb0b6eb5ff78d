"""A native process asks for its processor's widest registers, in what is part of each key."""

import os
import platform
import subprocess
import sys

import pytest
from places import ROOT

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="of its processors")
MAIN = """
import os, pcpc.drivers.compiled.in_numba as made
from numba.core.registry import cpu_target
key = cpu_target.target_context.codegen().magic_tuple()[2]
assert key == os.environ["NUMBA_CPU_FEATURES"]
print(key)
"""


@pytest.mark.parametrize(
    ("given", "wide"),
    [
        ({"PCPC_CPU": "native"}, True),
        ({"PCPC_CPU": "generic"}, False),
        ({"PCPC_CPU": "native", "NUMBA_CPU_FEATURES": "+sse2"}, False),
    ],
)
def test_a_native_process_compiles_for_the_widest_registers(
    given: dict[str, str], wide: bool
) -> None:
    bare = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_CPU")}
    done = subprocess.run(
        [sys.executable, "-c", MAIN],
        capture_output=True,
        text=True,
        env=bare | given | {"PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0 and done.stderr == "", "LLVM names a feature that it does not know"
    assert done.stdout.strip().endswith(",-prefer-256-bit") == wide, done.stdout

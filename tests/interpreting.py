"""What an interpreter says that compiles nothing: its bits are those of compiled code."""

import os
import subprocess
import sys

from pcpc.drivers.compiled.jit import JIT_OFF


def interpreted(module: str, expression: str) -> str:
    """Return what a process that compiles nothing prints for an expression of a module, `t`."""
    assert not JIT_OFF, "this process must be the compiled one"
    code = f"import interpreting, {module} as t; print(interpreting.JIT_OFF, {expression})"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        capture_output=True,
        text=True,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    off, _, printed = done.stdout.strip().partition(" ")
    assert off == "True", f"{done.stdout} {done.stderr[-500:]}"
    return printed

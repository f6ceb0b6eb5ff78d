"""The module of a node's process, as others import it."""

import subprocess
import sys


def test_importing_a_node_leaves_the_signals_of_the_importer_alone() -> None:
    code = "import signal, pcpc.executive.nodes.process as _; "
    code += "print(signal.pthread_sigmask(signal.SIG_BLOCK, []))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()", done.stdout

"""The module of a node's process, as others import it."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize("name", ["executive.nodes.process", "tools.dev.bench.rate"])
def test_importing_a_node_leaves_the_signals_of_the_importer_alone(name: str) -> None:
    code = f"import signal, pcpc.{name}; print(signal.pthread_sigmask(signal.SIG_BLOCK, []))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()", done.stdout

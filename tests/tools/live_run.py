"""A run that goes on for the tests of a file: two nodes, a recorder, one bus of their own.

200 Hz and a patient supervisor: these tests are about the table, on a machine that may be busy.
"""

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from copies import program
from processes import DEADLINE_S, RIGS, ROOT, own_bus, until

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.nodes import live
from pcpc.tools.cli import main

KV, LAM, ERROR = "controller.kv_Nms_rad", "controller.lam_per_s", "controller.e_rad"
Screen = pytest.CaptureFixture[str]


def pcpc(*words: str) -> "subprocess.Popen[str]":
    """Start the command with its output in pipes."""
    return subprocess.Popen(
        [program(), *words], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@dataclass
class Run:
    """A run that goes on until it is told to stop."""

    host: "subprocess.Popen[str]"
    folder: Path
    node: str
    watcher: "subprocess.Popen[str]"


@contextmanager
def going_on(folder: Path) -> Iterator[Run]:
    """Start the run and a watcher of it; end it with Ctrl-C."""
    bus = own_bus()
    settings = ("duration_s=600", "rate_hz=200", "supervisor.fault_after_cycles=400")
    words = [word for setting in settings for word in ("--set", setting)]
    words += ["-o", str(folder), "--no-figure", "--quiet"]
    host = pcpc("run", str(RIGS / "hull.yaml"), "--bus", bus, *words)
    node = sh.block_name("hull", bus, "executive")

    def is_up() -> bool:
        assert host.poll() is None, f"the run ended: {host.communicate()}"
        try:
            return int(sharing.attach(node).control.passes) > 0
        except sh.SharedError:
            return False

    try:
        until(is_up, "first cycle")
        watcher = pcpc("watch", ERROR, "--json", "--every", "100ms", "--node", node)
        yield Run(host, folder, node, watcher)
    finally:
        host.send_signal(signal.SIGINT)
        host.communicate(timeout=DEADLINE_S)


def alone(run: Run, monkeypatch: pytest.MonkeyPatch, beside: str = "") -> None:
    """Leave nodes of other runs of this machine, but for `beside`, out of the search for one."""
    bus, every = run.node.removesuffix(".executive"), live.running

    def known(rig: str = "") -> dict[str, live.Live]:
        return {n: b for n, b in every(rig).items() if n.startswith(f"{bus}.") or n == beside}

    monkeypatch.setattr(live, "running", known)


def said(screen: Screen, run: Run, *words: str) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of a subcommand on the run's executive."""
    code = main([*words, "--node", run.node])
    return code, *screen.readouterr()


def value(screen: Screen, run: Run, name: str) -> float:
    code, out, err = said(screen, run, "get", name, "--json")
    assert code == 0, err
    return float(json.loads(out)[name])

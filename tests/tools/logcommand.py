"""A sub-command of `pcpc log` in this process, and a log of the barrel to use it on."""

import contextlib
import io
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from places import ROOT

from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main

PLANT = ROOT / "plants" / "atb1000"
DBC = PLANT / "atb1000.dbc"
_FOLDER = tempfile.TemporaryDirectory()


@dataclass(frozen=True)
class Done:
    """What came of a command."""

    code: int
    out: str
    err: str


def run(*words: str | Path) -> Done:
    """Run a sub-command; the first word is its name."""
    return run_here("log", *words)


def run_here(*words: str | Path) -> Done:
    """Run `pcpc` with these words in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(word) for word in words])
    return Done(code, out.getvalue(), err.getvalue())


@cache
def barrel_log(controller: str = "nn_backstepping") -> Path:
    """Return a log of 0.3 s of the barrel, made once; that of nn_backstepping has two networks."""
    path = Path(_FOLDER.name) / f"{controller}.mcap"
    simulate(load_rig(PLANT / "rigs" / "slew10.yaml", controller, ["duration_s=0.3"]), path)
    return path

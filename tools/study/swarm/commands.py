"""Commands: swarm."""

import argparse
import math
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


def _count(text: str) -> int:
    """Return a whole number above 0, also as 1e9."""
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not (1.0 <= found <= 1e15 and found.is_integer()):
        what = f"expected a whole number, 1 to 1e15, got {text!r}"
        raise argparse.ArgumentTypeError(what)
    return int(found)


class SwarmRequest(Request):
    """Which seeds, how many, and where what was found goes."""

    seed: Annotated[int, take.seed, "N", "first seed; default: 1"] = 1
    for_s: Annotated[float | None, take.duration, "--for", "TIME", "as 10m; default: 100 seeds"] = (
        None
    )
    cycles: Annotated[int | None, _count, "N", "until so many cycles are done, as 1e9"] = None
    seeds: Annotated[int | None, _count, "N", "so many seeds"] = None
    around: Annotated[
        str | None, "--rig", "RIG,...", "draw around these rigs in turn, not new ones"
    ] = None
    replay: Annotated[str | None, "FOLDER", "do again what lies in this folder"] = None
    output: Annotated[str, "-o", "DIR", "folder of what was found; default: %(default)s"] = "swarm"
    jobs: Annotated[int | None, take.positive, "-j", "N", "processes; default: one a processor"] = (
        None
    )
    dask: Annotated[str | None, "ADDRESS", "Dask: tcp://HOST:PORT, or local[:N]"] = None
    json: take.Json = False
    quiet: take.ShortQuiet = False


COMMANDS = (
    Command(
        "swarm",
        "draw rigs and what happens to them; check every promise in each",
        "pcpc swarm --for 10m\npcpc swarm --replay swarm/seed-41",
        SwarmRequest,
        compiles=True,
        module="study.swarm.cli",
        codes=codes(
            OK="every promise held",
            NOT_MET="a promise was broken, or none was checked",
            ENVIRONMENT="a process was killed",
            INTERRUPTED="",
        ),
        first=False,
    ),
)
ROOM = Room(
    "docs/howto/swarm.md",
    "tests/tools/study/test_swarm.py",
    "swarm --seeds 1",
    needed_by=("dev/evidence",),
)

"""Commands: sweep."""

from collections.abc import Sequence
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Request
from pcpc.tools.terminal.rooms import Room


class SweepRequest(Request):
    """Runs of a rig with values that vary, as texts of options; also what `pcpc.sweep` asks for."""

    rig: Annotated[str, "RIG", "name of a rig (pcpc rigs), or its file"]
    controllers: Annotated[
        str | None, "A,B", "controllers on the same draws; default: the rig's"
    ] = None
    vary: Annotated[
        Sequence[str],
        "NAME=SPEC",
        "lo:hi, lo:hi:n, normal(m,s), lognormal(median,factor), choice(a,b); x before one: "
        "a factor on the rig's value",
    ] = ()
    draws: Annotated[
        int | None, "N", "number of draws; default: 1000, grid: all, --until: as needed"
    ] = None
    sampling: Annotated[
        str | None,
        "default: sobol; --until: random",
        {"choices": ("random", "lhs", "sobol", "grid")},
    ] = None
    seed: Annotated[int, take.seed, "N", "seed of draws and noise"] = 1
    set: Annotated[Sequence[str], "NAME=VALUE", "change a value in all runs"] = ()
    until: Annotated[
        str | None,
        "STATEMENT",
        "stop when decided: 'p_fail < 1e-3 at 95%%', 'p_fail(NAME) < ...'",
    ] = None
    worst: Annotated[
        int | None,
        "RUNS",
        "search for the smallest requirement margin, or the largest --of",
    ] = None
    rare: Annotated[
        int | None,
        "RUNS",
        "estimate a rare failure: subset simulation, RUNS a level, as 1000",
    ] = None
    of: Annotated[
        str | None,
        "METRIC",
        "use this metric, not the requirements; --rare: with --limit",
    ] = None
    limit: Annotated[float | None, "X", "--rare: the metric fails above X"] = None
    shard: Annotated[str | None, "I/N", "run part I of N of the draws"] = None
    threads: Annotated[int | None, "N", "threads; default: processors + 2"] = None
    scheduler: Annotated[
        str | None,
        "ADDRESS",
        "Dask: tcp://HOST:PORT, or local[:N] for N workers here",
    ] = None
    output: Annotated[
        str | None,
        "-o",
        "DIR",
        "folder; resumes a sweep; default: runs/<UTC time>-sweep-<rig>",
    ] = None
    quiet: take.Quiet = False


class MergeRequest(Request):
    """The shards of a campaign."""

    folders: Annotated[Sequence[str], "DIR", "folders of shards"]
    output: Annotated[
        str | None, "-o", "DIR", "folder of the whole; default: the first of them"
    ] = None
    quiet: take.Quiet = False


class RerunRequest(Request):
    """A run of a campaign."""

    folder: Annotated[str, "DIR", "folder of a campaign"]
    draw: Annotated[str, "DRAW", "number of a draw"]
    controller: Annotated[str | None, WORD, "CONTROLLER", "default: the campaign's first"] = None
    on_bus: Annotated[bool, "also on a bus, in lockstep; compare the bits"] = False
    output: Annotated[str | None, "-o", "DIR", "run folder; default: DIR/draw-DRAW-CONTROLLER"] = (
        None
    )
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "sweep",
        "run a rig with many parameter values: table, statement, report",
        "pcpc sweep hull --controllers pd,pd_nn --vary barrel.gap_rad=x0.5:2 --draws 200\n"
        "pcpc sweep hull --vary barrel.gap_rad=x0.5:2 --until 'p_fail < 1e-2 at 95%'",
        SweepRequest,
        judges=True,
        compiles=True,
        module="study.sweep.start",
        codes=codes(
            OK="done, with any verdicts of the runs",
            NOT_MET="--until does not hold, or no run judged a requirement or limit",
            LOSS="the disk is full",
            ENVIRONMENT="a package is missing",
            INTERRUPTED="interrupted; the same command with -o resumes",
        ),
        first=True,
    ),
    Command(
        "sweep merge",
        "make one campaign of its shards: table, statement, report",
        "pcpc sweep merge SHARDS ...",
        MergeRequest,
        judges=True,
        compiles=True,
        module="study.sweep.start",
        codes=codes(
            NOT_MET="--until does not hold, or no run judged a requirement or limit",
            LOSS="the disk is full",
            ENVIRONMENT="a package is missing",
            INTERRUPTED="",
        ),
    ),
    Command(
        "sweep rerun",
        "run one draw of a campaign again, with its log and figure",
        "pcpc sweep rerun runs/SWEEP 39 pd --on-bus",
        RerunRequest,
        judges=True,
        compiles=True,
        module="study.sweep.start",
        codes=codes(
            NOT_MET="not ok, or not as in the table",
            LOSS="",
            ENVIRONMENT="a package is missing",
            SAFETY_STOP="",
            INTERRUPTED="",
        ),
    ),
)
ROOM = Room("docs/howto/campaign.md", "tests/tools/study/sweep/test_command.py", "sweep probe")

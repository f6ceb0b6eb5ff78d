"""Commands: sweep."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def sweep(add: Add) -> None:
    """Take a rig, what varies, how often; or the shards of a campaign."""
    add(
        "words",
        nargs="+",
        metavar="RIG | merge DIR | rerun DIR",
        help="name of a rig (pcpc rigs), or its file; merge: folders of shards; "
        "rerun: a folder, the number of a draw, a controller",
    )
    add("--on-bus", action="store_true", help="rerun: also on a bus, in lockstep; compare the bits")
    add("--controllers", metavar="A,B", help="controllers on the same draws; default: the rig's")
    take.several(
        add,
        "--vary",
        "NAME=SPEC",
        "lo:hi, lo:hi:n, normal(m,s), lognormal(median,factor), choice(a,b); x before one: "
        "a factor on the rig's value",
    )
    add(
        "--draws",
        type=int,
        metavar="N",
        help="number of draws; default: 1000, grid: all, --until: as needed",
    )
    add(
        "--sampling",
        choices=("random", "lhs", "sobol", "grid"),
        help="default: sobol; --until: random",
    )
    add(
        "--seed",
        type=take.seed,
        default=1,
        metavar="N",
        help="seed of draws and noise",
    )
    take.settings(add, "change a value in all runs")
    add(
        "--until",
        metavar="STATEMENT",
        help="stop when decided: 'p_fail < 1e-3 at 95%%', 'p_fail(NAME) < ...'",
    )
    add(
        "--worst",
        type=int,
        metavar="RUNS",
        help="search for the smallest requirement margin, or the largest --of",
    )
    add(
        "--rare",
        type=int,
        metavar="RUNS",
        help="estimate a rare failure: subset simulation, RUNS a level, as 1000",
    )
    add(
        "--of", metavar="METRIC", help="use this metric, not the requirements; --rare: with --limit"
    )
    add("--limit", type=float, metavar="X", help="--rare: the metric fails above X")
    add("--shard", metavar="I/N", help="run part I of N of the draws")
    add("--threads", type=int, metavar="N", help="threads; default: processors + 2")
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask: tcp://HOST:PORT, or local[:N] for N workers here",
    )
    add(
        "-o",
        "--output",
        metavar="DIR",
        help="folder; resumes a sweep; default: runs/<UTC time>-sweep-<rig>",
    )
    take.quiet(add)


COMMANDS = (
    Command(
        "sweep",
        "run a rig with many parameter values: table, statement, report",
        "pcpc sweep hull --controllers pd,pd_nn --vary barrel.gap_rad=x0.5:2 --draws 200\n"
        "pcpc sweep hull --vary barrel.gap_rad=x0.5:2 --until 'p_fail < 1e-2 at 95%'\n"
        "pcpc sweep merge SHARDS ...\n"
        "pcpc sweep rerun runs/SWEEP 39 pd --on-bus",
        sweep,
        judges=True,
        compiles=True,
        module="study.sweep.start",
        codes=codes(
            OK="done, with any verdicts of the runs",
            NOT_MET="--until does not hold, or no run judged a requirement; "
            "rerun: not ok, or not as in the table",
            LOSS="the disk is full",
            ENVIRONMENT="a package is missing",
            SAFETY_STOP="rerun: a node faulted",
            INTERRUPTED="interrupted; the same command with -o resumes",
        ),
        first=True,
    ),
)

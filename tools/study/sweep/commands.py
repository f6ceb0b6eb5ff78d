"""Commands: sweep."""

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def sweep(add: Add) -> None:
    """Take a rig, what varies, how often; or the shards of a campaign."""
    add(
        "words",
        nargs="+",
        metavar="RIG | merge DIR | rerun DIR",
        help="name of a rig (pcpc rigs), or its file; merge: folders of shards; "
        "rerun: a folder, the number of a draw, a controller",
    )
    add(
        "--on-bus", action="store_true", help="rerun: also on a bus, in lockstep; compares the bits"
    )
    add("--controllers", metavar="A,B", help="these on the same draws; the rig's own")
    add(
        "--vary",
        action="append",
        default=[],
        metavar="NAME=SPEC",
        help="lo:hi, lo:hi:n, normal(m,s), lognormal(median,factor), choice(a,b); x before one: "
        "a factor on the rig's value",
    )
    add(
        "--draws", type=int, metavar="N", help="1000; of a grid all, with --until as many as needed"
    )
    add("--sampling", choices=("random", "lhs", "sobol", "grid"), help="sobol; random with --until")
    add(
        "--seed",
        type=take.seed,
        default=1,
        metavar="N",
        help="of the draws and of the runs' noises",
    )
    take.settings(add, "any value of the rig or a block, of all runs")
    add(
        "--until",
        metavar="STATEMENT",
        help="end when it is decided: 'p_fail < 1e-3 at 95%%', 'p_fail(NAME) < ...'",
    )
    add(
        "--worst",
        type=int,
        metavar="RUNS",
        help="search for the smallest margin of the requirements, or the largest --of",
    )
    add(
        "--rare",
        type=int,
        metavar="RUNS",
        help="probability of a rare failure: subset simulation, RUNS a step, as 1000",
    )
    add("--of", metavar="METRIC", help="in place of the requirements; --rare: with --limit")
    add("--limit", type=float, metavar="X", help="--rare: the metric fails above it")
    add("--shard", metavar="I/N", help="part I of N: N processes or machines share the draws")
    add("--threads", type=int, metavar="N", help="two more than processors")
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask's: tcp://HOST:PORT, or local[:N] for N workers of this machine",
    )
    add(
        "-o",
        "--output",
        metavar="DIR",
        help="folder, not runs/<UTC time>-sweep-<rig>; what was begun goes on",
    )
    take.quiet(add)


COMMANDS = (
    Command(
        "sweep",
        "run it a thousand times with values that vary: table, statement, report",
        "pcpc sweep hull --controllers pd,pd_nn --vary barrel.gap_rad=x0.5:2 --draws 200\n"
        "pcpc sweep hull --vary barrel.gap_rad=x0.5:2 --until 'p_fail < 1e-2 at 95%'\n"
        "pcpc sweep merge SHARDS ...\n"
        "pcpc sweep rerun runs/SWEEP 39 pd --on-bus",
        sweep,
        judges=True,
        compiles=True,
        module="study.sweep.start",
        codes={
            Exit.OK: "done, whatever the runs came to",
            Exit.NOT_MET: "--until: it does not hold; rerun: not ok, or not as in the table",
            Exit.WRONG_INPUT: "",
            Exit.LOSS: "the disk is full",
            Exit.ENVIRONMENT: "a package is missing",
            Exit.SAFETY_STOP: "rerun: a node faulted",
            Exit.INTERRUPTED: "the same command with -o goes on",
        },
        first=True,
    ),
)

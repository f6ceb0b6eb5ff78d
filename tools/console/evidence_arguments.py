"""What `pcpc evidence` and `pcpc soak` take."""

from pcpc.tools.console.arguments import duration, json, positive, quiet
from pcpc.tools.console.command import Add


def evidence(add: Add) -> None:
    """Take the parts of the evidence, how much of each, and where it goes."""
    from pcpc.tools.evidence.parts import PARTS

    add("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all")
    add("--runs", type=positive, default=3000, metavar="N", help="of each fault; 3000")
    add("--hours", type=float, default=100.0, metavar="H", help="without a fault; 100")
    add("--frames", type=positive, default=1_000_000, metavar="N", help="damaged frames; 10^6")
    add("--laws", type=positive, default=100_000, metavar="N", help="random ones; 100,000")
    add("--kills", type=positive, default=100, metavar="N", help="disturbed processes; 100")
    add("--seed", type=positive, default=1, metavar="N", help="the first of the seeds; 1")
    add("-j", "--jobs", type=positive, metavar="N", help="processes; as many as processors")
    add("-o", "--output", default="evidence", metavar="FOLDER", help="for faults.md, faults.json")
    quiet(add, "-q")


def soak(add: Add) -> None:
    """Take a rig and for how long."""
    add("rig", metavar="RIG", help="rig file, or the name of one that comes with pcpc")
    add("--hours", type=float, default=1.0, metavar="H", help="default: %(default)s")
    add("--each", type=duration, default=600.0, metavar="DURATION",
        help="of a run on a clock; 10min")  # fmt: skip
    add("--seed", type=int, default=1, metavar="N", help="of what is drawn; %(default)s")
    json(add, "print a row a run as JSON")
    quiet(add, "-q")

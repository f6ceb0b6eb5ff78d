"""Commands: what looks at a running node, tunes and operates it."""

from pathlib import Path

from pcpc.tools.live import arguments as take_live
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import NODE_CODES, Add, Command, codes


def list_(add: Add) -> None:
    """Take variables, and how much about them."""
    take_live.table("NAME", "*")(add)
    add("-l", "--long", action="store_true", help="print also writer and meaning")


def save(add: Add) -> None:
    """Take where the parameters of a node go."""
    add("file", type=Path, metavar="FILE", help="the YAML file to write")
    add("--all", action="store_true", help="all parameters of the rig, not only changed ones")
    add("--force", action="store_true", help="overwrite FILE")
    take_live.node(add)


def load(add: Add) -> None:
    """Take where parameters of a node come from."""
    add("file", metavar="FILE", help="lines NAME: VALUE, as `pcpc save` writes them")
    take_live.node(add)
    take.json(add)


def undo(add: Add) -> None:
    """Take how many tunings."""
    add(
        "count",
        type=take.positive,
        nargs="?",
        default=1,
        metavar="N",
        help="undo the last N tunings; default: 1",
    )
    take_live.node(add)
    take.json(add)


def watch(add: Add) -> None:
    """Take variables, and how often."""
    take_live.table("NAME", "+")(add)
    add(
        "--every",
        type=take.seconds("--every"),
        default="200ms",
        metavar="TIME",
        help="interval: 500us, 5ms, 10s; default: %(default)s",
    )


def scope(add: Add) -> None:
    """Take variables, a trigger and where to write."""
    add("names", nargs="+", metavar="VAR", help="variables of one node, or patterns with * ? []")
    add(
        "--trigger",
        required=True,
        metavar="CONDITION",
        help="trigger when this condition becomes true",
    )
    pre, post = (take.seconds(option, zero=True) for option in ("--pre", "--post"))
    add(
        "--pre",
        type=pre,
        default="200ms",
        metavar="TIME",
        help="record before the trigger; default: %(default)s",
    )
    add(
        "--post",
        type=post,
        default="1s",
        metavar="TIME",
        help="record after the trigger; default: %(default)s",
    )
    add("-o", "--output", type=Path, required=True, metavar="FILE.mcap", help="the log to write")
    add("--plot", type=Path, metavar="FILE.png", help="draw the capture")
    add(
        "--mode",
        choices=("single", "normal", "auto"),
        default="single",
        help="one burst, each trigger, or without a trigger; default: %(default)s",
    )
    add("--count", type=take.positive, metavar="N", help="normal, auto: stop after N bursts")
    add("--within", type=take.duration, metavar="TIME", help="give up after this time")
    add("--past", action="store_true", help="search the node's ring buffer for past triggers too")
    add("--force", action="store_true", help="overwrite FILE.mcap")
    take_live.node(add)
    take.json(add)
    take.quiet(add)


def stop(add: Add) -> None:
    """Take which rig's run, and how."""
    reset(add)
    add("--quick", action="store_true", help="ramp down in supervisor.quick_stop_s, not ramp_s")


def reset(add: Add) -> None:
    """Take which rig's nodes, if there are several."""
    add(
        "run",
        metavar="RIG|RUN",
        nargs="?",
        help="if there are several runs: the rig's name or file, or RIG.BUS",
    )
    take_live.at(add)
    take.json(add)


def operate(add: Add) -> None:
    """Take which executive."""
    take_live.node(add)
    take.json(add)


def handover(add: Add) -> None:
    """Take who is to be in charge."""
    add(
        "controller",
        metavar="CONTROLLER",
        help="the controller that takes over: one on standby, or the rig's",
    )
    take_live.node(add)
    take.json(add)


def fault(add: Add) -> None:
    """Take a fault of the rig, how long and how large."""
    add("name", nargs="?", metavar="NAME", help="a name under faults: in the rig")
    add(
        "--for",
        dest="for_s",
        type=take.seconds("--for"),
        metavar="TIME",
        help="duration: 200ms, 5s; default: until --end",
    )
    add("--value", type=float, metavar="X", help="magnitude; default: the rig's value")
    add("--share", type=float, metavar="X", help="probability that it acts, 0 to 1")
    add("--end", action="store_true", help="end the fault")
    add("--node", metavar="NODE", help="only in this node: executive, plant or a full name")
    take_live.at(add)
    take.json(add)


COMMANDS = (
    Command(
        "list",
        "list the variables of a node with values, units and ranges",
        "pcpc list 'controller.*'",
        list_,
        module="live.variables",
        codes=NODE_CODES,
    ),
    Command(
        "get",
        "print values",
        "pcpc get controller.e_rad barrel.theta_rad\nssh -t rig-machine pcpc get controller.e_rad",
        take_live.table("NAME", "+"),
        module="live.variables",
        codes=NODE_CODES,
    ),
    Command(
        "set",
        "tune parameters, all at once",
        "pcpc set controller.kv_Nms_rad=120 controller.lam_per_s=15",
        take_live.table("NAME=VALUE", "+"),
        module="live.variables",
        codes=NODE_CODES,
        first=True,
    ),
    Command(
        "save",
        "write the tuned parameters to a file",
        "pcpc save tuned.yaml",
        save,
        notes="use them with --set @FILE, or in a running node with `pcpc load`",
        module="live.tunings",
        codes=NODE_CODES,
    ),
    Command(
        "load",
        "tune parameters to the values in a file, all at once or none",
        "pcpc load tuned.yaml",
        load,
        module="live.tunings",
        codes=NODE_CODES,
    ),
    Command(
        "undo",
        "undo the last tuning, of any client",
        "pcpc undo\npcpc undo 3",
        undo,
        module="live.tunings",
        codes=NODE_CODES,
    ),
    Command(
        "watch",
        "print values periodically",
        "pcpc watch 'controller.*' --every 500ms",
        watch,
        codes=NODE_CODES,
        module="live.variables",
    ),
    Command(
        "scope",
        "capture every cycle around a trigger into a log",
        "pcpc scope 'controller.*' --trigger 'abs(controller.e_rad) > 2 mrad' "
        "-o burst.mcap --plot burst.png",
        scope,
        codes=codes(
            NOT_MET="no trigger",
            LOSS="cycles were lost",
            ENVIRONMENT="no such node",
            INTERRUPTED="",
        ),
        module="live.scope",
    ),
    Command(
        "lock",
        "forbid tuning (tune) or everything (all), or allow it (none)",
        "pcpc lock tune",
        take_live.table("none|tune|all", 1),
        module="live.variables",
        codes=NODE_CODES,
    ),
    Command(
        "stop",
        "stop a run in order, even a locked one",
        "pcpc stop --quick",
        stop,
        module="live.operation",
        codes=NODE_CODES,
    ),
    Command(
        "reset",
        "clear a fault that waits for a reset (supervisor.on_fault)",
        "pcpc reset hull",
        reset,
        module="live.operation",
        codes=codes(NODE_CODES, NOT_MET="the cause is still there"),
    ),
    Command(
        "arm",
        "close the loop of a run that waits for it (supervisor.arm)",
        "pcpc arm",
        operate,
        module="live.operation",
        codes=codes(NODE_CODES, NOT_MET="not possible in this state"),
    ),
    Command(
        "hold",
        "ramp commands to their safe values, without a fault",
        "pcpc hold",
        operate,
        notes="time, references and laws continue; `pcpc resume` closes the loop again",
        module="live.operation",
        codes=NODE_CODES,
    ),
    Command(
        "resume",
        "close the loop after `pcpc hold`, on the same ramp",
        "pcpc resume",
        operate,
        module="live.operation",
        codes=codes(NODE_CODES, NOT_MET="not possible in this state"),
    ),
    Command(
        "handover",
        "let another controller take over, without a jump",
        "pcpc run hull --controller pd --standby pd_nn\npcpc handover pd_nn",
        handover,
        module="live.operation",
        codes=codes(NODE_CODES, NOT_MET="the controller is not usable; the present one stays"),
    ),
    Command(
        "fault",
        "list the injectable faults of a rig, begin or end one",
        "pcpc fault encoder_stuck --for 200ms",
        fault,
        codes=NODE_CODES,
        module="live.fault",
    ),
)

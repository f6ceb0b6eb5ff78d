"""What the commands about running nodes take; imports nothing that takes time."""

import argparse
from collections.abc import Callable
from pathlib import Path

from pcpc.tools.console import arguments as take
from pcpc.tools.console.command import Add


def table(names: str, count: str | int) -> Callable[[Add], None]:
    """Return what takes `count` variables of a node, called `names`."""

    def arguments(add: Add) -> None:
        add("names", nargs=count, metavar=names)
        add("--node", metavar="NODE",
            help="executive, plant, RIG, RIG.plant; without it, the one that has NAME")  # fmt: skip
        _at(add)
        take.json(add, "print JSON")

    return arguments


def _node(add: Add) -> None:
    add("--node", metavar="NODE", help="executive, plant, RIG, RIG.plant, or a full name")
    _at(add)


def _at(add: Add) -> None:
    """Take on which other machine the nodes run."""
    add("--at", metavar="HOST:PORT", help="nodes of another machine, by a `pcpc host` there")
    add("--token-file", metavar="FILE",
        help="--at: its token, in a file that only you read; else PCPC_TOKEN")  # fmt: skip
    add("--ca", metavar="FILE", help="--at: the certificate (PEM) of a host with one of its own")
    add("--plain", action="store_true",
        help="--at: without TLS; all on the way can read and tune")  # fmt: skip


def save(add: Add) -> None:
    """Take where the parameters of a node go."""
    add("file", type=Path, metavar="FILE", help="a YAML file to write")
    add("--all", action="store_true", help="all parameters that a rig gives, not only changed ones")
    add("--force", action="store_true", help="overwrite FILE")
    _node(add)


def load(add: Add) -> None:
    """Take where parameters of a node come from."""
    add("file", metavar="FILE", help="as `pcpc save` writes it: NAME: VALUE lines")
    _node(add)
    take.json(add, "print JSON")


def undo(add: Add) -> None:
    """Take how many tunings."""
    add("count", type=take.positive, nargs="?", default=1, metavar="N", help="the last N; 1")
    _node(add)
    take.json(add, "print JSON")


def list_(add: Add) -> None:
    """Take variables, and how much about them."""
    table("NAME", "*")(add)
    add("-l", "--long", action="store_true", help="also writer and meaning")


def fault(add: Add) -> None:
    """Take a fault of the rig, how long and how large."""
    add("name", nargs="?", metavar="NAME", help="a name under faults: in the rig file")
    add("--for", dest="for_", metavar="TIME", help="200ms, 5s; without it, until --end")
    add("--value", type=float, metavar="X", help="how large, instead of the rig's value")
    add("--share", type=float, metavar="X", help="in how many of all chances it acts, 0 to 1")
    add("--end", action="store_true", help="end it")
    add("--node", metavar="NODE", help="only there: executive, plant or a full name")
    _at(add)
    take.json(add, "print JSON")


def watch(add: Add) -> None:
    """Take variables, and how often."""
    table("NAME", "+")(add)
    add("--every", default="200ms", metavar="TIME", help="interval: 500us, 5ms, 10s")


def top(add: Add) -> None:
    """Take which run, and how often."""
    add("rig", metavar="RIG", nargs="?", help="only runs of this rig: its name, or its file")
    add("--node", metavar="NODE", help="of several runs: a node, or RIG.BUS")
    add("--every", default="1s", metavar="TIME", help="interval; %(default)s")
    add("--once", action="store_true", help="one screen, then end")
    _at(add)


def scope(add: Add) -> None:
    """Take variables, a trigger and where to write."""
    add("names", nargs="+", metavar="VAR", help="variables of one node, or patterns, * ? []")
    add("--trigger", required=True, metavar="CONDITION",
        help="as in requirements; the cycle in which it becomes true")  # fmt: skip
    add("--pre", default="200ms", metavar="TIME", help="before the trigger; %(default)s")
    add("--post", default="1s", metavar="TIME", help="behind it; %(default)s")
    add("-o", "--output", type=Path, required=True, metavar="FILE.mcap", help="the log to write")
    add("--plot", type=Path, metavar="FILE.png", help="draw it, too")
    add("--mode", choices=("single", "normal", "auto"), default="single",
        help="one burst; each time; also without a trigger; %(default)s")  # fmt: skip
    add("--count", type=take.positive, metavar="N", help="normal, auto: end after N bursts")
    add("--within", type=take.duration, metavar="TIME", help="give up after it")
    add("--past", action="store_true", help="also triggers that the node's ring still holds")
    add("--force", action="store_true", help="overwrite FILE.mcap")
    _node(add)
    take.json(add, "print JSON")
    take.quiet(add)


def watchdog(add: Add) -> None:
    """Take a rig, its bus, and what is fed while all is well."""
    take.rig(add)
    add("--bus", metavar="INTERFACE[:CHANNEL]", help=f"{take.BUSES}; the rig's run, if one goes on")
    add("--pacing", choices=("real", "sync", "lockstep"), help="of the run; the rig's")
    add("--feed", metavar="FILE",
        help="written as long as all is well: /dev/watchdog, a relay's heartbeat")  # fmt: skip


def reset(add: Add) -> None:
    """Take which rig's nodes, if there are several."""
    add("rig", metavar="RIG", nargs="?", help="if several run: name of the rig, or its file")
    _at(add)
    take.json(add, "print JSON")


def operate(add: Add) -> None:
    """Take which executive."""
    _node(add)
    take.json(add, "print JSON")


def handover(add: Add) -> None:
    """Take who is to be in charge."""
    add("controller", metavar="CONTROLLER", help="who takes over: on standby, or the rig's")
    _node(add)
    take.json(add, "print JSON")


def stop(add: Add) -> None:
    """Take which rig's run, and how."""
    reset(add)
    add("--quick", action="store_true", help="in supervisor.quick_stop_s instead of ramp_s")


def host(add: Add) -> None:
    """Take what is shown, to whom, and whether they may tune."""
    add("what", nargs="?", metavar="RIG|RUN|LOG",
        help="a rig whose run is shown, or a run folder, log or latest; what runs")  # fmt: skip
    add("--node", default="", metavar="NAME", help="where several run: a node, by its full name")
    add("--write", action="store_true", help="let the page tune, stop, reset, begin faults")
    take.recordings(add)
    add("--port", type=int, metavar="N", help="default: the first free from 8642 on")
    add("--address", default="127.0.0.1", metavar="IP",
        help="where it listens; %(default)s: for this machine only")  # fmt: skip
    add("--name", action="append", default=[], metavar="HOST",
        help="another name of this machine that browsers may use")  # fmt: skip
    add("--tls-cert", metavar="FILE", help="certificate (PEM), and with")
    add("--tls-key", metavar="FILE", help="its key, what is sent is encrypted")
    add("--plain", action="store_true",
        help="other addresses without TLS: all on the way can read and tune")  # fmt: skip
    add("--new-token", action="store_true", help="pages opened before lose their right")
    add("--foxglove", type=port, nargs="?", const=-1, metavar="PORT",
        help="for Foxglove and Lichtblick instead; the first free from 8765 on")  # fmt: skip
    add("--foxglove-layout", action="store_true", help="print a layout of RIG for both, and end")
    take.code_of_laws(add)


def port(text: str) -> int:
    """Return a port; 0: any that is free."""
    if not text.isdecimal() or int(text) > 65535:
        what = f"{text!r} is no port; a rig stands before it: `pcpc host {text} --foxglove`"
        raise argparse.ArgumentTypeError(what)
    return int(text)

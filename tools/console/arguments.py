"""What the commands of `pcpc` take; imports nothing that takes time."""

import argparse
from pathlib import Path
from typing import Any, NoReturn

from pcpc.executive.durations import duration_s
from pcpc.executive.rig.roles import ROLES
from pcpc.tools.console.command import Add
from pcpc.tools.console.rates import bits_per_s, hz

BUSES = "auto, vcan0, udp_multicast[:GROUP[:PORT]], any python-can one"


def json(add: Add, help: str = "print one JSON object") -> None:
    """Take whether to print JSON."""
    add("--json", action="store_true", help=help)


def quiet(add: Add, *short: str) -> None:
    """Take whether to show progress."""
    add(*short, "--quiet", action="store_true", help="no progress")


def _set(add: Add, help: str) -> None:
    add("--set", action="append", default=[], metavar="NAME=VALUE", help=help)


# Rigs


def rigs(add: Add) -> None:
    """Take names or patterns."""
    add("names", nargs="*", metavar="NAME", help="only these rigs or plants; * ? []")
    json(add, "print one JSON list")


def new(add: Add) -> None:
    """Take a folder, and what is to be in it."""
    add("dir", type=Path, metavar="DIR", help="a new or empty folder; its name is the rig's")
    add("--device", action="store_true",
        help="also the law as a program of its own in the executive's place")  # fmt: skip


def dbc(add: Add) -> None:
    """Take a rig, and where to write."""
    add("rig", metavar="RIG", help="its file or folder; its DBC file need not be there")
    add("-o", "--output", metavar="FILE", help="default: the file that the rig names")
    add(
        "--crc",
        type=int,
        choices=(8, 16),
        default=8,
        help="its bits, of every frame of every cycle; 16 as in AUTOSAR's E2E profile 5",
    )


def rig(add: Add) -> None:
    """Take a rig and what is changed in it."""
    add("rig", metavar="RIG", help="name of a rig (pcpc rigs), or its file")
    add("--controller", metavar="NAME", help="controller, instead of the rig's")
    add("--standby", action=_Standby, metavar="NAME[,NAME]",
        help="other controllers of the rig, which can take over")  # fmt: skip
    _set(add, "any value of the rig or a block, as controller.kv_Nms_rad=130; @FILE: of pcpc save")


def check(add: Add) -> None:
    """Take a rig."""
    rig(add)
    json(add)


def bus(add: Add) -> None:
    """Take a rig, and the bus that it is to fit; or two buses to make one of."""
    add("words", nargs="+", metavar="RIG | emulate A B",
        help="name of a rig (pcpc rigs), or its file; emulate: two buses, as vcan0 vcan1, "
        "udp_multicast:GROUP:PORT")  # fmt: skip
    _set(add, "any value of the rig, as realtime.plant.phase=0.4")
    add("--bitrate", type=bits_per_s, metavar="RATE",
        help="500k, 1M; default: the rig's bus.bitrate, else 1M")  # fmt: skip
    add("--data-bitrate", type=bits_per_s, metavar="RATE",
        help="as CAN FD frames that switch to this rate: 2M, 5M")  # fmt: skip
    add("--rate", type=hz, metavar="RATE", help="cycles a second, instead of the rig's: 2kHz")
    add("--jitter", metavar="TIME",
        help="from a node's cycle to its frames: waking, work; 100us; default 0")  # fmt: skip
    add("--any-phase", action="store_true",
        help="nodes on clocks of their own, as two machines: their phases drift")  # fmt: skip
    add("--in-order", action="store_true",
        help="a node sends in its loop's order, as SocketCAN; default: by priority")  # fmt: skip
    add("--queue", type=positive, default=64, metavar="N",
        help="emulate: frames that wait on a side, no more; default: %(default)s")  # fmt: skip
    add("--errors", metavar="p=P,...",
        help="emulate: bit error rate p; burst=N transmissions in a row; seed=N")  # fmt: skip
    add("--for", type=duration, dest="for_s", metavar="DURATION",
        help="emulate: end after it; default: at Ctrl-C")  # fmt: skip
    add("--error-every", metavar="TIME", help="a bus error at most this often: 10ms; default none")
    add("--plot", type=Path, metavar="FILE.png", help="draw the fullest cycle of the bus")
    quiet(add)
    json(add)


def doctor(add: Add) -> None:
    """Take only how to print."""
    json(add)


def run(add: Add) -> None:
    """Take a rig, and how it runs on a bus."""
    rig(add)
    add("--pacing", choices=("real", "sync", "lockstep"),
        help="real: own clocks; sync: the plant follows SYNC; lockstep: no clock")  # fmt: skip
    add("--bus", metavar="INTERFACE[:CHANNEL]", help=BUSES)
    _run_folder(add)
    add("--host", action="store_true",
        help="a page beside the run, as of `pcpc host`; ends with it")  # fmt: skip
    add("--write", action="store_true", help="--host: let the page tune, stop, reset, begin faults")
    add("--port", type=int, metavar="N", help="--host: default: the first free from 8642 on")
    recordings(add, "--host: ")


def recordings(add: Add, of: str = "") -> None:
    """Take where a page records to, and how much; `of`: what else has to be given."""
    add("--recordings", type=Path, metavar="DIR",
        help=f"{of}where the page records to, and saves what was; default runs/host")  # fmt: skip
    add("--recordings-mb", type=positive, metavar="N",
        help=f"{of}the most that all of them together have, MB; default 4000")  # fmt: skip


def plant(add: Add) -> None:
    """Take what `run` takes, and a device in the executive's place."""
    run(add)
    add("--device", nargs=argparse.REMAINDER, metavar="COMMAND",
        help="record and judge a device in the executive's place: the rest of the line starts it, "
        "{bus} is the bus; without one it is waited for")  # fmt: skip


def slcan(add: Add) -> None:
    """Take a bus, and the line: a port, or after -- a program."""
    add("bus", metavar="BUS", help="as --bus: vcan0, udp_multicast:GROUP[:PORT]")
    add("port", type=Path, nargs="?", metavar="PORT", help="a serial line: /dev/ttyACM0")
    add("--baud", type=positive, default=115200, metavar="N", help="default: %(default)s")
    add("--bitrate", type=bits_per_s, metavar="RATE",
        help="that the adapter has to set: 500k, 1M; default: as it is")  # fmt: skip


def simulate(add: Add) -> None:
    """Take a rig, without what has no effect in virtual time."""
    rig(add)
    add("--bus", "--pacing", action=_Refused, help=argparse.SUPPRESS)
    _run_folder(add)


def sweep(add: Add) -> None:
    """Take a rig, what varies, how often; or the shards of a campaign."""
    add("words", nargs="+", metavar="RIG | merge DIR | rerun DIR",
        help="name of a rig (pcpc rigs), or its file; merge: folders of shards; "
        "rerun: a folder, the number of a draw, a controller")  # fmt: skip
    add(
        "--on-bus", action="store_true", help="rerun: also on a bus, in lockstep; compares the bits"
    )
    add("--controllers", metavar="A,B", help="these on the same draws; the rig's own")
    add("--vary", action="append", default=[], metavar="NAME=SPEC",
        help="lo:hi, lo:hi:n, normal(m,s), lognormal(median,factor), choice(a,b); x before one: "
        "a factor on the rig's value")  # fmt: skip
    add(
        "--draws", type=int, metavar="N", help="1000; of a grid all, with --until as many as needed"
    )
    add("--sampling", choices=("random", "lhs", "sobol", "grid"),
        help="sobol; random with --until")  # fmt: skip
    add("--seed", type=int, default=1, metavar="N", help="of the draws and of the runs' noises")
    _set(add, "any value of the rig or a block, of all runs")
    add("--until", metavar="STATEMENT",
        help="end when it is decided: 'p_fail < 1e-3 at 95%%', 'p_fail(NAME) < ...'")  # fmt: skip
    add("--worst", type=int, metavar="RUNS",
        help="search for the smallest margin of the requirements, or the largest --of")  # fmt: skip
    add("--rare", type=int, metavar="RUNS",
        help="probability of a rare failure: subset simulation, RUNS a step, as 1000")  # fmt: skip
    add("--of", metavar="METRIC", help="in place of the requirements; --rare: with --limit")
    add("--limit", type=float, metavar="X", help="--rare: the metric fails above it")
    add("--shard", metavar="I/N", help="part I of N: N processes or machines share the draws")
    add("--threads", type=int, metavar="N", help="two more than processors")
    add("--scheduler", metavar="ADDRESS",
        help="Dask's: tcp://HOST:PORT, or local[:N] for N workers of this machine")  # fmt: skip
    add("-o", "--output", metavar="DIR",
        help="folder, not runs/<UTC time>-sweep-<rig>; what was begun goes on")  # fmt: skip
    quiet(add)


def _run_folder(add: Add) -> None:
    add("-o", "--output", metavar="DIR", help="run folder, instead of runs/<UTC time>-<rig>")
    json(add, "print the summary as one JSON object")
    quiet(add)
    add("--no-figure", action="store_true", help="do not draw figure.png")
    add("--judge", action="store_true",
        help="a limit that could not be judged, or nothing to judge, is exit code 1")  # fmt: skip


class _Standby(argparse.Action):
    """An option that is a setting of the rig in other words."""

    def __call__(
        self, parser: argparse.ArgumentParser, options: argparse.Namespace, text: Any, *_: Any
    ) -> None:
        """Append it to the settings."""
        options.set = [*options.set, f"standby=[{text}]"]


class _Refused(argparse.Action):
    """An option of the other commands that would have no effect here."""

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> NoReturn:
        parser.error(f"{given[-1]}: not in virtual time; `pcpc run` has it")


def experiment(add: Add) -> None:
    """Take a study."""
    add(
        "name",
        metavar="NAME",
        help="chapterN of the book, approximation, actuators, drawings, margins, rivals, rough, "
        "theorems, tuning, or a study.py",
    )
    add("-o", "--output", metavar="DIR", help="folder, instead of runs/<UTC time>-NAME")
    add("--jobs", type=int, metavar="N", help="processes; all processors")
    quiet(add)


# Logs


def code_of_laws(add: Add) -> None:
    """Take whose code of a log may run."""
    add("--trust", action="store_true",
        help="run the Python that stands in the log: its laws, its evaluation")  # fmt: skip
    add("--law", action="append", default=[], metavar="FILE",
        help="a law, an evaluation or a file one reads, of a run whose files moved")  # fmt: skip
    add("--rig", metavar="RIG", help="the rig file beside which they lie now")
    add("--fmu", action="append", default=[], metavar="FILE",
        help="run an FMU of the run, native code, which a log never holds")  # fmt: skip


def replay(add: Add) -> None:
    """Take a log, and what is changed."""
    add("log", metavar="LOG", help="log file, run folder or latest")
    add("--node", choices=(*ROLES, "device", "all"), default="all",
        help="device: what one sent, by the rig's own law; default: all")  # fmt: skip
    add("--controller", metavar="NAME", help="another controller of the log's rig")
    _set(add, "recompute with a change, in open loop: the recorded frames stay what they were")
    code_of_laws(add)
    json(add, "print one JSON list")
    quiet(add)


def bounds(add: Add) -> None:
    """Take a rig or a log, and by which law's theorem it is judged."""
    add("what", metavar="RIG|LOG", help="a rig, run in virtual time; a log file, folder or latest")
    add("--controller", metavar="NAME", help="controller, instead of the rig's")
    _set(add, "any value of the rig")
    add("--as", dest="law_as", metavar="LAW", help="by the theorem of this law of the plant")
    add("--plot", type=Path, metavar="FILE", help="draw V, its derivatives, |r|, weights, bounds")
    code_of_laws(add)
    json(add)
    quiet(add)


def compare(add: Add) -> None:
    """Take two runs, or a version and rigs, and where to tell what differs."""
    add("words", nargs="*", metavar="A B|RIG",
        help="two logs, runs or folders of runs, old and new; with --against: rigs")  # fmt: skip
    add("--against", metavar="GITREF",
        help="run the rigs of this version and of the working tree in virtual time")  # fmt: skip
    add("--controller", metavar="NAME", help="with --against: this controller of each rig")
    add("--all-controllers", action="store_true", help="with --against: all of each rig")
    add("--jobs", type=int, metavar="N", help="with --against: processes; all processors")
    add("--tolerance", type=float, default=0.0, metavar="REL",
        help="metrics that change by no more than this share are equal")  # fmt: skip
    add("--fail-on", choices=("any", "metrics", "verdict", "never"), default="any",
        help="what ends with exit code 1; any difference")  # fmt: skip
    add("--markdown", metavar="FILE", help="a table for a pull request; - is stdout")
    add("--json", metavar="FILE", help="everything as one JSON object; - is stdout")
    add("-o", "--output", metavar="DIR", help="report.md and figures of old over new")
    quiet(add)


def play(add: Add) -> None:
    """Take a log, and which of its frames go where and when."""
    add("log", metavar="LOG", help="log file, run folder or latest")
    add("--bus", default="auto", metavar="INTERFACE[:CHANNEL]", help=BUSES)
    add("-r", "--rate", type=float, default=1.0, metavar="FACTOR",
        help="speed: 2 is twice as fast, 0 as fast as the bus takes frames")  # fmt: skip
    add("--loop", type=int, nargs="?", const=0, metavar="N", help="N times; for ever without N")
    add("--start", type=float, default=0.0, metavar="S",
        help="begin S seconds behind the log's first frame")  # fmt: skip
    add("--duration", type=float, metavar="S", help="play S seconds of the recording")
    add("--step", nargs="?", const="frame", choices=("frame", "cycle"),
        help="one frame, or the frames of one cycle, at each Enter")  # fmt: skip
    add("--only", action="append", default=[], metavar="NAME|ID",
        help="only this frame: its name, or its id in hexadecimal; may be repeated")  # fmt: skip
    add("--as", dest="role", choices=("executive", "plant"),
        help="only what this node sent, once the other node is heard")  # fmt: skip
    add("--no-wait", action="store_true", help="with --as: begin without the other node")
    add("-p", "--priority", type=int, default=70, metavar="1..99",
        help="of SCHED_FIFO, where that is allowed; %(default)s, an emulator's")  # fmt: skip
    json(add, "print the result as one JSON object")
    quiet(add)


# This machine


def completion(add: Add) -> None:
    """Take a shell."""
    add("shell", choices=("bash", "zsh", "fish"), help="the shell that is to complete")


def jitter(add: Add) -> None:
    """Take what cyclictest takes, and yardsticks."""
    add("-i", "--interval", default="1000us", metavar="TIME", help="period; 1000us; 50us to 1s")
    add("-D", "--duration", default="10s", metavar="TIME", help="of all rounds of a loop; 10s")
    add("-p", "--priority", type=int, default=80, metavar="1..99",
        help="of SCHED_FIFO, where that is allowed; 80; the plant's is 10 less")  # fmt: skip
    add("-h", "--histogram", type=int, metavar="US", help="cyclictest's histogram, up to US")
    quiet(add, "-q")
    add("-a", "--affinity", metavar="CPU[,CPU]",
        help="processors of executive and plant; other loops: the first one")  # fmt: skip
    add("--bus", metavar="INTERFACE[:CHANNEL]",
        help="auto, vcan0, udp_multicast[:GROUP[:PORT]]; one that nobody else uses")  # fmt: skip
    add("--against", metavar="NAME,...", help="compare with cyclictest, c, python")
    add("--rounds", type=int, metavar="N", help="parts of the duration; 5 with --against")
    add("--json", type=Path, metavar="FILE", help="write all figures there")
    add("--plot", type=Path, metavar="FILE.png", help="draw the histograms of all loops")


def bench(add: Add) -> None:
    """Take suites."""
    add("names", nargs="*", metavar="NAME", help="suites; default: all but batch, rate, startup")
    add("--rounds", type=int, default=15, metavar="N", help="default 15")
    add("--json", metavar="FILE", help="write the ratios there too")
    quiet(add)


def vm(add: Add) -> None:
    """Take what the machine has; the command follows after --."""
    add("--accel", choices=("auto", "kvm", "tcg"), default="auto", help="default: %(default)s")
    add("--memory", type=positive, default=2048, metavar="MB", help="default: %(default)s")
    add("--cpus", type=positive, default=2, metavar="N", help="default: %(default)s")
    add("--timeout", type=duration, default=600.0, metavar="DURATION", help="default: 600s")
    add("--update", action="store_true", help="fetch the distribution's present kernel")
    add("--verbose", action="store_true", help="show the guest's console on stderr")
    add("--info", action="store_true", help="print kernel and accelerator, run nothing")


def duration(text: str) -> float:
    """Return a duration such as 500ms, 10s, 2min in s."""
    try:
        return duration_s(text, unit="")
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def positive(text: str) -> int:
    """Return a whole number above 0."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"expected a positive whole number, got {text!r}")
    return int(text)

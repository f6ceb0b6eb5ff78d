"""The `pcpc` command: arguments only; each subcommand lives in a module of its own."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from tools.ending import ended

_RIG = "plants/atb1000/rigs/slew10.yaml"
_CODES = (
    "exit code: 0 ok, 1 expectation not met, 2 wrong input, 3 loss, 4 environment, "
    "5 safety stop, 130 Ctrl-C"
)
_HELP = {  # of the commands that bring their own arguments
    "replay": "recompute a recorded run and compare it bit by bit",
    "play": "put recorded frames on a bus",
    "log": "look into logs, compare, draw, convert and repair them",
    "jitter": "measure the timing of the loop, beside cyclictest, C and plain Python",
    "bench": "measure ratios against C and others, interleaved in one run",
}
_MODULES = {name: f"tools.{name}" for name in _HELP}
_WITH_VERDICT = (  # which does not depend on whether somebody reads what is printed
    "run", "exec", "local", "plant", "simulate", "check", "replay", "play", "jitter", "experiment",
    "vm",
)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit code; see `tools.ending` for how it ends."""
    words = list(sys.argv[1:] if argv is None else argv)
    return ended(lambda: _carry_out(words), goes_on=words[:1] != [] and words[0] in _WITH_VERDICT)


def _carry_out(words: Sequence[str]) -> int:
    if words[:1] == ["vm"]:  # has its own arguments, up to --
        from tools.vm import run as run_vm

        return run_vm(list(words[1:]))
    options = _parser(words[:1]).parse_args(words)
    if options.command in _MODULES:
        return int(import_module(_MODULES[options.command]).command(options))
    if options.command in ("run", "exec", "local", "plant", "simulate"):
        from tools.run import command

        return command(options)
    if options.command == "doctor":
        from tools.doctor import command as doctor

        return doctor(options)
    if options.command == "experiment":
        from tools.experiment import command as experiment

        return experiment(options)
    if options.command == "check":
        from tools.check import command as check

        return check(options)
    from tools.watch import command as watch

    return watch(options)


def _parser(chosen: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser; of `_MODULES` only the `chosen` one is imported, for its arguments."""
    parser = argparse.ArgumentParser(
        "pcpc",
        description="hardware-in-the-loop: a real-time executive and a plant emulator on CAN",
        epilog=f"example: pcpc run {_RIG}\n{_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_runs(commands)
    _add_table(commands)
    one = _command(
        commands,
        "check",
        "check a rig file and print its wiring and bus load",
        f"pcpc check {_RIG}",
    )
    _add_rig(one)
    one.add_argument("--json", action="store_true", help="print one JSON object")
    one = _command(commands, "doctor", "what this machine offers, and how to get the rest",
                   "pcpc doctor")  # fmt: skip
    one.add_argument("--json", action="store_true", help="print one JSON object")
    one = _command(
        commands,
        "experiment",
        "run a whole study in virtual time: tables and figures",
        "pcpc experiment chapter9 -o results",
    )
    one.add_argument(
        "name", metavar="NAME", help="chapterN of the book, approximation, actuators, or a study.py"
    )
    one.add_argument(
        "-o", "--output", metavar="DIR", help="folder, instead of runs/<UTC time>-NAME"
    )
    one.add_argument("--jobs", type=int, metavar="N", help="processes; all processors")
    one.add_argument("--quiet", action="store_true", help="no progress")
    for name, module in _MODULES.items():
        if name in chosen:
            import_module(module).add_arguments(commands)
        else:
            commands.add_parser(name, help=_HELP[name], add_help=False)
    _command(
        commands, "vm", "run a command on a kernel with vcan, in QEMU", "pcpc vm -- candump vcan0"
    )
    return parser


def _command(
    commands: "argparse._SubParsersAction[argparse.ArgumentParser]",
    name: str,
    help: str,
    example: str,
) -> argparse.ArgumentParser:
    return commands.add_parser(
        name, help=help, description=help, epilog=f"example: {example}\n{_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip


def _add_rig(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("rig", metavar="RIG", help="rig file")
    parser.add_argument("--controller", metavar="NAME", help="controller, instead of the rig's")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any value of the rig or a block, as controller.kv_Nms_rad=130",
    )


def _add_runs(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    for name, help, example in (
        ("run", "start emulator, executive and recorder, end with a verdict", f"pcpc run {_RIG}"),
        ("exec", "start executive and recorder only", f"pcpc exec {_RIG} --bus vcan0"),
        ("plant", "start the emulator only", f"pcpc plant {_RIG} --bus vcan0"),
        ("local", "start the node between executive and plant only, of a rig with three",
         "pcpc local plants/telerobot/rigs/telerobot-rnn.yaml --bus vcan0"),
        ("simulate", "run the same in virtual time, in one process, without a bus",
         f"pcpc simulate {_RIG} --controller pid"),
    ):  # fmt: skip
        one = _command(commands, name, help, example)
        _add_rig(one)
        one.add_argument(
            "-o", "--output", metavar="DIR", help="run folder, instead of runs/<UTC time>-<rig>"
        )
        one.add_argument(
            "--pacing", choices=("real", "sync", "lockstep"),
            help="real: own clocks; sync: the plant follows SYNC; lockstep: no clock",
        )  # fmt: skip
        one.add_argument(
            "--bus", metavar="INTERFACE[:CHANNEL]",
            help="auto, vcan0, udp_multicast[:GROUP[:PORT]], any python-can one",
        )  # fmt: skip
        one.add_argument("--json", action="store_true", help="print the summary as one JSON object")
        one.add_argument("--quiet", action="store_true", help="no progress")
        one.add_argument("--no-figure", action="store_true", help="do not draw figure.png")


def _add_table(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    many: dict[str, str | int] = {"list": "*", "lock": 1}
    for name, help, example in (
        ("list", "list the variables of a running node", "pcpc list 'controller.*'"),
        ("get", "print values of a running node", "pcpc get controller.e_rad"),
        (
            "set",
            "tune parameters of a running node, all at once",
            "pcpc set controller.kv_Nms_rad=120",
        ),
        ("watch", "print values again and again", "pcpc watch 'controller.*' --every 500ms"),
        ("lock", "forbid tunings (tune, all), or allow them again (none)", "pcpc lock tune"),
    ):
        one = _command(commands, name, help, example)
        one.add_argument(
            "names", nargs=many.get(name, "+"), metavar="LEVEL" if name == "lock" else "NAME"
        )
        one.add_argument(
            "--node",
            default="executive",
            metavar="NODE",
            help="executive, plant, or a block's name",
        )
        one.add_argument("--json", action="store_true", help="print JSON")
        if name == "watch":
            one.add_argument(
                "--every", default="200ms", metavar="TIME", help="interval: 500us, 5ms, 10s"
            )


if __name__ == "__main__":
    sys.exit(main())

"""`pcpc log SUB`: what one does with a log. Each sub-command is a module of its own."""

import argparse
from importlib import import_module

from pcpc.tools import screen

_MODULES = {
    "info": "info",
    "cat": "cat",
    "diff": "diff",
    "recover": "recover",
    "export": "export",
    "import": "importer",
    "plot": "plot",
}


def add_arguments(
    commands: "argparse._SubParsersAction[argparse.ArgumentParser]", whole: bool = True
) -> None:
    """Register `log`; its sub-commands, which take half a second to import, only if `whole`."""
    text = "look into logs, compare, draw, convert and repair them"
    one = commands.add_parser(
        "log", help=text, description=text,
        epilog="example: pcpc log info latest\n"
        "`pcpc log SUB --help` tells the options and exit codes of each",
        formatter_class=screen.Help,
    )  # fmt: skip
    subs = one.add_subparsers(dest="log_command", required=True, metavar="SUB")
    for module in _MODULES.values() if whole else ():
        import_module(f"pcpc.tools.log.{module}").add_arguments(subs)


def command(options: argparse.Namespace) -> int:
    """Carry out a sub-command; return its exit code."""
    module = import_module(f"pcpc.tools.log.{_MODULES[options.log_command]}")
    code: int = module.command(options)
    return code

"""Which options a command line gives: none twice with two values, none without effect."""

import argparse
from typing import Any


class _Noted(argparse.Action):
    """An option that is noted; a second value that contradicts the first is refused."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        options: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        if self.nargs is None:
            need_value(parser, option_string, values)
        value = values if isinstance(self, argparse._StoreAction) else True  # others go together
        if option_string is not None and repr(_note(self, options, value)) != repr(value):
            parser.error(f"{option_string}: given twice, with two values")
        super().__call__(parser, options, values, option_string)


class _Store(_Noted, argparse._StoreAction):
    """An option with a value."""


class _StoreTrue(_Noted, argparse._StoreTrueAction):
    """An option without a value."""


class _Append(_Noted, argparse._AppendAction):
    """An option that may be repeated."""


ACTIONS = {None: _Store, "store": _Store, "store_true": _StoreTrue, "append": _Append}


def need_value(parser: argparse.ArgumentParser, option: str | None, value: Any) -> None:
    """Refuse `--option=--`, which argparse takes for a list of nothing."""
    if option is not None and value == []:
        parser.error(f"{option} '--': expected a value")


def note_options(parser: argparse.ArgumentParser) -> None:
    """Let a parser note which options are given; call it before they are added."""
    for name, action in ACTIONS.items():
        parser.register("action", name, action)


def _note(action: argparse.Action, options: argparse.Namespace, value: Any) -> Any:
    """Note an option; return the value that it was given first."""
    given = vars(options).setdefault("given", {})
    return given.setdefault(action.dest, (action.option_strings[-1], value))[1]

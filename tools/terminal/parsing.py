"""The parser of a command's words: a wrong one is answered in one line, with place and cure."""

import argparse
import math
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean, one_line
from pcpc.tools.terminal import screen

_NUMBER = re.compile(r"-\.?\d")  # what begins with a dash and is no option


class Parser(argparse.ArgumentParser):
    """argparse with the answers of this house: UserError in place of the usage and an exit.

    pcpc simulate: no option --controler; did you mean --controller?
    pcpc log export -o: expected one argument
    """

    def __init__(self, **more: Any) -> None:
        super().__init__(**{"formatter_class": screen.Help, "exit_on_error": False, **more})
        self.register("type", int, _whole_number)
        self.register("type", float, _number)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Return the options, and no words that are left over; UserError."""
        words = list(args)
        self._refuse_unknown_options(words)
        try:
            found, rest = super().parse_known_args(words, namespace)
        except UserError:
            if self._parts() and not words:
                self.error(f"expected one of {', '.join(self._parts())}")
            raise
        except argparse.ArgumentError as error:
            if error.argument_name is None:
                self.error(error.message)
            where = f"{self.prog} {error.argument_name}"
            raise UserError(one_line(f"{where}: {error.message}")) from None
        if rest:
            self.error(f"{rest[0]!r} is a word too many")
        return found, rest

    def error(self, message: str) -> NoReturn:
        """Raise UserError with the command before the message, and where its help stands behind."""
        cure = "" if ";" in message else f"; see `{self.prog} --help`"
        raise UserError(one_line(f"{self.prog}: {message}{cure}"))

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = [str(one) for one in action.choices]
            cure = did_you_mean(str(value), known) or f"; known: {', '.join(known)}"
            raise argparse.ArgumentError(action, f"{value!r} is not known{cure}")

    def _parts(self) -> list[str]:
        """Return the names of the commands of which this one consists."""
        actions = self._subparsers._group_actions if self._subparsers else ()
        return [name for action in actions for name in action.choices or ()]

    def _refuse_unknown_options(self, words: Sequence[str]) -> None:
        """Raise UserError for an option that is none, before something else is found missing."""
        known = self._option_string_actions
        for word in words:
            if word == "--" or (self._parts() and not word.startswith("-")):
                return
            if word in known or word == "-" or not word.startswith("-") or " " in word:
                continue
            name, _, value = word.partition("=")
            near = [option for option in known if name.startswith("--") and option.startswith(name)]
            if near or name in known or (word[:2] in known and not word.startswith("--")):
                continue
            if _NUMBER.match(word) is None:
                self.error(f"no option {name}{self._option_cure(name, value, words)}")

    def _option_cure(self, name: str, value: str, words: Sequence[str]) -> str:
        """Return the option that was meant, or a rig's value of this name with --set."""
        if "--set" in self._option_string_actions:
            from pcpc.executive.rig.conversion import file_keys_of  # takes time
            from pcpc.executive.rig.schema import Config

            word = name.lstrip("-").replace("-", "_")
            keys = [key for key in file_keys_of(Config) if word in (key, key.rpartition("_")[0])]
            if keys:
                behind = [value] if value else [*words[words.index(name) + 1 :], "VALUE"]
                return f"; did you mean --set {keys[0]}={behind[0]}?"
        shown = [one for one in self._actions if one.help != argparse.SUPPRESS]
        return did_you_mean(name, [option for one in shown for option in one.option_strings])


def _whole_number(text: str) -> int:
    """Return a whole number; none is below 0, what is counted here begins there."""
    try:
        if (found := int(text)) >= 0:
            return found
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"expected a whole number from 0 on, got {text!r}")


def _number(text: str) -> float:
    try:
        if math.isfinite(found := float(text)):
            return found
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"expected a number, got {text!r}")

"""The tools: commands of pcpc, each with the options that a program may give, and what it is told.

Names, types and words of the arguments are those of the command's `Request`.
"""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from typing import Any

from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.rooms import offers

MOST_ROWS = 200
_MOST_TEXT = 4000  # characters of an answer that is no JSON
_TYPES: Mapping[Any, str] = {int: "integer", float: "number"}


@dataclass(frozen=True)
class Tool:
    """A command, the options that can be given, words that always are, keys that are shown first.

    `keeps`: it makes a run folder; `reads`: the argument that names logs.
    """

    command: str
    options: str
    words: tuple[str, ...] = ("--json",)
    shown: str = "*"
    keeps: bool = False
    reads: str = ""

    def logs_in(self, given: Mapping[str, Any]) -> list[str]:
        """Return the logs that a call names."""
        found = given.get(self.reads, [])
        return [found] if isinstance(found, str) else [*found]


_RUN = "--json", "--quiet", "--judge"
_SUMMARY = (
    "verdict expectations_failed not_judged lost faults changed metrics requirements name held text"
)
_PAIRS = "changed counts pairs rig controller state said first metrics name old new"
TOOLS = {
    "rigs": Tool("rigs", "names", shown="name title plant controllers"),
    "check": Tool("check", "rig controller set schema",
                  shown="rig title controller rate_hz duration_s file $schema properties $defs"),
    "simulate": Tool("simulate", "rig controller standby set", _RUN, _SUMMARY, keeps=True),
    "run": Tool("run", "rig controller standby set pacing bus", _RUN, _SUMMARY, keeps=True),
    "set": Tool("set", "names"),
    "operate": Tool("operate", "verb controller level"),
    "report": Tool("report", "logs require", ("--requirements", *_RUN[:2]), reads="logs"),
    "replay": Tool("replay", "logs node since until controller set", _RUN[:2],
                   "node identical cycles planned first missing", reads="logs"),
    "compare": Tool("compare", "words tolerance", ("--json=-", "--quiet"), _PAIRS, reads="words"),
    "branch": Tool("branch", "log cycle time set controller fault duration_s", _RUN, _SUMMARY,
                   keeps=True, reads="log"),
    "sweep": Tool("sweep", "rig controllers vary draws sampling seed set", ("--quiet",),
                  keeps=True),
    "log": Tool("log export", "log start end", ("--output=-",), reads="log"),
}  # fmt: skip
_OWN: dict[str, dict[str, Any]] = {  # what the door itself takes
    "columns": {
        "type": "array",
        "items": {"type": "string"},
        "description": "more keys of the answer, or variables of a log; patterns with *",
    },
    "picture": {"type": "boolean", "description": "also the figure, as an image"},
}


@cache
def _commands() -> dict[str, Command]:
    found: dict[str, Command] = {}
    for one in (command for room in offers("COMMANDS") for command in room):
        found |= {one.name: one, **{f"{one.name} {part.name}": part for part in one.parts}}
    return found


@cache
def _options(tool: str) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return what a command's request declares, as far as the tool takes it: option, keywords."""
    command = _commands()[TOOLS[tool].command]
    verbs = [one.name for one in command.parts] * (tool == "operate")
    found: dict[str, tuple[str, dict[str, Any]]] = {
        "verb": ("", {"choices": verbs, "help": command.help})
    }

    def add(*names: str, **about: Any) -> Any:
        option = next((one for one in names if one.startswith("--")), "")
        key = about.get("dest") or (option or names[0]).lstrip("-").replace("-", "_")
        found.setdefault(key, (option, about))  # others set the same by other words

    for one in command.parts if verbs else (command,):
        one.asked.add_to(add)
    return {key: found[key] for key in TOOLS[tool].options.split()}


def _schema(about: Mapping[str, Any]) -> dict[str, Any]:
    kind: dict[str, Any] = {"type": _TYPES.get(about.get("type"), "string")}
    if "choices" in about:
        kind["enum"] = [*about["choices"]]
    if about.get("action") == "store_true":
        kind = {"type": "boolean"}
    if about.get("action") == "append" or about.get("nargs") in ("+", "*"):
        kind = {"type": "array", "items": kind}
    return kind | {"description": about.get("help") or about.get("metavar", "")}


@cache
def described(tool: str) -> tuple[str, dict[str, Any]]:
    """Return what a tool is for, and the JSON Schema of its arguments. ValueError: no tool."""
    if tool not in TOOLS or not is_here(tool):
        raise ValueError("no such tool")
    options = _options(tool)
    own = {key: _OWN[key] for key in _OWN if key == "columns" or TOOLS[tool].keeps}
    needed = (
        {"verb", "rig", "log", "names"} & options.keys() if tool not in ("rigs", "check") else {}
    )
    return _commands()[TOOLS[tool].command].help, {
        "type": "object",
        "properties": {key: _schema(about) for key, (_, about) in options.items()} | own,
        "required": [] if tool in ("rigs", "check") else [*needed],
        "additionalProperties": False,
    }


def is_here(tool: str) -> bool:
    """Return whether the room of a tool's command was not taken out."""
    return TOOLS[tool].command in _commands()


def words(tool: str, arguments: Mapping[str, Any]) -> list[str]:
    """Return the command line of a call; ValueError for a word that would be an option."""
    bare, options = list[str](), list[str]()
    for key, (option, _) in _options(tool).items():
        value = arguments.get(key, [])
        texts = [str(one) for one in (value if isinstance(value, list) else [value])]
        if isinstance(value, bool):
            options += [option] * value
        elif option:
            options += [f"{option}={text}" for text in texts]
        elif wrong := [text for text in texts if text.startswith("-")]:
            raise ValueError(f"{wrong[0]!r} is an option, not a word")
        else:
            bare += texts
    if wrong := [word for word in (*bare, *options) if not word.isprintable()]:
        raise ValueError(f"{wrong[0]!r} has a character that is not printable")
    return [*TOOLS[tool].command.split(), *bare, *options, *TOOLS[tool].words]


def answer(tool: str, text: str, columns: Sequence[str]) -> Any:
    """Return what is told of what a command has printed: some keys, and those of `columns`."""
    if tool == "log":
        return _rows([*csv.reader(text.splitlines())], columns or ("controller.*",))
    try:
        value = json.loads(text)
    except ValueError:
        return text[-_MOST_TEXT:]
    return _shown(value, [*columns, *TOOLS[tool].shown.split()])


def _shown(value: Any, wanted: Sequence[str]) -> Any:
    """Return an answer with the keys that are wanted, in their order; also in lists of it."""
    if isinstance(value, list):
        return [_shown(one, wanted) for one in value]
    if not isinstance(value, dict):
        return value
    keys = dict.fromkeys(key for one in wanted for key in value if fnmatchcase(key, one))
    return {k: _shown(value[k], wanted) if isinstance(value[k], list) else value[k] for k in keys}


def _rows(table: list[list[str]], wanted: Sequence[str]) -> dict[str, Any]:
    """Return columns of a table, thinned to MOST_ROWS rows."""
    head, *rows = table or [[]]
    names = [name.partition(" ")[0] for name in head]
    known = {own for own in names for one in ("time", *wanted) if fnmatchcase(own, one)}
    chosen = [i for i, own in enumerate(names) if own in known]
    thinned = rows[:: -(-len(rows) // MOST_ROWS) or 1]
    return {
        "columns": [head[i] for i in chosen],
        "rows": [[float(row[i] or "nan") for i in chosen] for row in thinned],
        "of_rows": len(rows),
        "others": [name for name in names if name not in known],
    }

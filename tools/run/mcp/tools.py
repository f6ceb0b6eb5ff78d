"""The tools: commands of pcpc, each with the options that a program may give, and what it is told.

Names, types and words of the arguments are those of the command's `Request`, what is answered is
described by the structs that it prints.
"""

import argparse
import csv
import json
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cache
from typing import Any, NamedTuple

import msgspec

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.answer import COMMON
from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.rooms import offers, part_of

MOST_ROWS = 200
_MOST_TEXT = 4000  # characters of an answer that is no JSON
_MOST_ASKED = 100_000  # bytes of arguments; the kernel takes 131,072 of a word
_TYPES: Mapping[Any, Any] = {
    int: "integer", float: "number", take.time: ["number", "string"],
}  # fmt: skip


class Tool(NamedTuple):
    """A command, the options that can be given, words that always are, keys that are shown first.

    `answer`: module of a room, and names in it of what is printed; `keeps`: it makes a run folder;
    `reads`: the argument that names logs; `needs`: one that has to be given.
    """

    command: str
    options: str
    words: tuple[str, ...] = ("--json",)
    shown: str = "*"
    answer: tuple[str, ...] = ()
    keeps: bool = False
    reads: str = ""
    needs: tuple[str, ...] = ()


_RUN = "--json", "--quiet", "--judge"
_SUMMARY = (
    "verdict expectations_failed not_judged lost faults changed metrics requirements name held text"
)
_PAIRS = "changed counts pairs rig controller state said first metrics name old new"
_SUMMED = "after/verdict", "summary", "Summary"
_LIVE = "live", "answers"
TOOLS = {
    "rigs": Tool("rigs", "names", shown="name title plant controllers",
                 answer=("start", "rigs", "Listed")),
    "check": Tool("check", "rig controller set schema",
                  shown="rig title controller rate_hz duration_s file $schema properties $defs",
                  answer=("run", "checked", "Report")),
    "simulate": Tool("simulate", "rig controller standby set", _RUN, _SUMMARY, _SUMMED, keeps=True,
                     needs=("rig",)),
    "run": Tool("run", "rig controller standby set pacing bus", _RUN, _SUMMARY, _SUMMED,
                keeps=True, needs=("rig",)),
    "set": Tool("set", "names node", answer=(*_LIVE, "Tuned"), needs=("names",)),
    "operate": Tool("operate", "verb controller level run", needs=("verb",),
                    answer=(*_LIVE, "LoopClosed", "LoopOpened", "HandedOver", "Locked",
                            "CyclesOfReset", "CycleOfStop")),
    "report": Tool("report", "logs require", ("--requirements", *_RUN[:2]), reads="logs",
                   answer=("after/verdict", "requirements", "JudgedRequirements")),
    "replay": Tool("replay", "logs node since until controller set", _RUN[:2],
                   "node identical cycles planned first missing", reads="logs",
                   answer=("after", "replayed", "ReplayedNodes")),
    "compare": Tool("compare", "words tolerance", ("--json=-", "--quiet"), _PAIRS, reads="words",
                    answer=("after/compare", "comparison", "ComparisonFacts")),
    "branch": Tool("branch", "log cycle time set controller fault duration_s", _RUN, _SUMMARY,
                   _SUMMED, keeps=True, reads="log", needs=("log",)),
    "sweep": Tool("sweep", "rig controllers vary draws sampling seed set", ("--quiet",),
                  keeps=True, needs=("rig",)),
    "log": Tool("log export", "log start end", ("--output=-",), reads="log", needs=("log",)),
}  # fmt: skip
_OWN: dict[str, dict[str, Any]] = {  # what the door itself takes
    "columns": {
        "type": "array",
        "items": {"type": "string"},
        "description": "more keys of the answer, or variables of a log; patterns with *",
    },
    "picture": {"type": "boolean", "description": "also the figure, as an image"},
}
_TOLD = {"exit": "integer", "said": "array", "run": "string", "refused": "string", "why": "string",
         "audit": "string"}  # fmt: skip


@cache
def _commands() -> dict[str, Command]:
    known = [command for room in offers("COMMANDS") for command in room]
    return {one.name: one for one in known} | {
        f"{one.name} {part.name}": part for one in known for part in one.parts
    }


@cache
def _options(tool: str) -> dict[str, argparse.Action]:
    """Return what a command's request declares, as far as the tool takes it."""
    command = _commands()[TOOLS[tool].command]
    verbs = [*(one.name for one in command.parts), "stop"]
    found = {"verb": argparse.Action((), "verb", choices=verbs, help=command.help)}

    def attach(_: str, one: argparse.Action) -> None:
        found.setdefault(one.dest, one)  # others set the same by other words

    command.add_to(argparse.ArgumentParser().add_subparsers(), attach)
    return {key: found[key] for key in TOOLS[tool].options.split() if key in found}


def _schema(one: argparse.Action) -> dict[str, Any]:
    kind: dict[str, Any] = {"type": "boolean" if one.nargs == 0 else _TYPES.get(one.type, "string")}
    kind |= {"enum": [*one.choices]} if one.choices else {}
    if isinstance(one.default, list) or one.nargs in ("+", "*"):
        kind = {"type": "array", "items": kind}
    return kind | {"description": one.help or one.metavar or ""}


@cache
def described(name: str) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Return what a tool is for, the schemas of arguments and answer. ValueError: no such tool."""
    if name not in TOOLS or TOOLS[name].command not in _commands():
        raise ValueError("no such tool")
    tool = TOOLS[name]
    own = {key: _OWN[key] for key in _OWN if key == "columns" or tool.keeps}
    asked = {
        "type": "object",
        "properties": {key: _schema(one) for key, one in _options(name).items()} | own,
        "required": [*tool.needs],
        "additionalProperties": False,
    }
    structs = [getattr(part_of(*tool.answer[:2]), one) for one in tool.answer[2:]]
    kinds, parts = msgspec.json.schema_components(structs, ref_template="#/$defs/{name}")
    answer = {"anyOf": [*kinds, {"type": "string"}]} if structs else {}
    told = {
        "type": "object",
        "properties": {**{k: {"type": v} for k, v in _TOLD.items()}, "answer": _of_part(answer)},
        "required": ["audit"],
        "$defs": _of_part(parts),
    }
    return _commands()[tool.command].help, asked, told


def _of_part(schema: Any) -> Any:
    """Return a schema that also holds of some of the keys."""
    if isinstance(schema, list | tuple):
        return [*map(_of_part, schema)]
    if not isinstance(schema, dict):
        return schema
    if schema.get("$ref", "").startswith(COMMON):
        return {}
    return {key: _of_part(own) for key, own in schema.items() if key != "required"}


def words(tool: str, arguments: Mapping[str, Any]) -> list[str]:
    """Return the command line of a call; ValueError for a word that would be an option."""
    if len(json.dumps(arguments, ensure_ascii=False).encode()) > _MOST_ASKED:
        raise ValueError("too long")
    bare, options = list[str](), list[str]()
    for key, action in _options(tool).items():
        value, option = arguments.get(key, []), [*action.option_strings[-1:]]
        texts = [str(one) for one in (value if isinstance(value, list) else [value])]
        if isinstance(value, bool):
            options += option * value
        elif option:
            options += [f"{option[0]}={text}" for text in texts]
        elif wrong := [text for text in texts if text.startswith("-")]:
            raise ValueError(f"{wrong[0]!r} is an option, not a word")
        else:
            bare += texts
    if wrong := [word for word in (*bare, *options) if not word.isprintable()]:
        raise ValueError(f"{wrong[0]!r} has a character that is not printable")
    family = [] if bare[:1] == ["stop"] and tool == "operate" else TOOLS[tool].command.split()
    return [*family, *bare, *options, *TOOLS[tool].words]


def answer(tool: str, text: str, columns: Sequence[str]) -> Any:
    """Return what is told of what a command has printed: some keys, and those of `columns`."""
    if tool == "log":
        return _rows([*csv.reader(text.splitlines())], columns or ("controller.*",))
    try:
        return _shown(json.loads(text), [*columns, *TOOLS[tool].shown.split()])
    except ValueError:
        return text[-_MOST_TEXT:]


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
    shown = [any(fnmatchcase(own, one) for one in ("time", *wanted)) for own in names]
    chosen = [i for i, is_shown in enumerate(shown) if is_shown]
    thinned = rows[:: -(-len(rows) // MOST_ROWS) or 1]
    return {
        "columns": [head[i] for i in chosen],
        "rows": [[float(row[i] or "nan") for i in chosen] for row in thinned],
        "of_rows": len(rows),
        "others": [own for i, own in enumerate(names) if i not in chosen],
    }

"""docs/reference/schemas from the structs that commands print, for `make reference`.

A struct's words are its docstring, a field's stand below it. What is printed has all its keys, but
for those that may be unset, and no others; JSON lacks some numbers, which are text or null.
"""

import ast
import inspect
import json
import textwrap
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any, get_origin

import msgspec
from msgspec.inspect import multi_type_info as inspected

from pcpc.executive.rig.roles import ROLES
from pcpc.tools.terminal.answer import COMMON
from pcpc.tools.terminal.rooms import is_installed, part_of

_STANDARD = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
_COMMON = {
    "Number": {
        "description": "a number, or the text of one that JSON lacks",
        "anyOf": [{"type": "number"}, {"enum": ["inf", "-inf", "nan"]}],
    },
    "OrNull": {"description": "null: not finite", "type": ["number", "null"]},
    "Node": {"enum": [*ROLES]},
    "AnyNode": {"anyOf": [{"$ref": "#/$defs/Node"}, {"const": "device"}]},
}
_DROPPED = {"default", "optional", "title"}  # told otherwise
_ALIKE = {  # commands that print what another one prints
    "branch": "run", "simulate": "run", "load": "set", "undo": "set",
    "operate-resume": "operate-arm",
}  # fmt: skip
_ANSWERS = {  # title, module of a room, names in it of what is printed, which is one of these
    "bench": ("Ratios to yardsticks", "dev/bench/ratio", "Ratios"),
    "bisect": ("The commit that changed the bits of a run first", "after/bisect/cli", "Bisected"),
    "bounds": ("A run compared with the theorem of its law", "study/bounds/text",
               "Figures", "Unknown"),
    "bus": ("Times of a rig's frames", "start/bus/report", "Times"),
    "bus-emulate": ("What an emulated line carried", "start/bus/emulate", "EmulatedLine"),
    "check": ("A rig as its nodes would run it", "run/checked", "Report"),
    "compare": ("What runs differ in", "after/compare/comparison", "ComparisonFacts"),
    "compare-bits": ("What two logs differ in", "after/log/diff", "BitReport"),
    "doctor": ("What this machine offers, or a bus", "machine/doctor/adapter/facts",
               "MachineFacts", "TuningFacts", "AdapterFacts"),
    "fault": ("The faults on purpose of a rig, or one that was begun or ended",
              "live/answers", "Faults", "FaultChange"),
    "fit": ("Parameters of a plant from a log", "study/fit/result", "FactsInFolder"),
    "get": ("Values of variables, by name", "live/answers", "Values"),
    "get-long": ("The variables of a node", "live/answers", "Variables"),
    "jitter": ("Lateness of the loop and of others in turn", "machine/jitter/figures", "Figures"),
    "log-export": ("What was exported of a log", "after/log/export",
                   "ExportedFrames", "ExportedRows", "ExportedLog"),
    "log-import": ("The log that was made of a recording", "after/log/imported", "Imported"),
    "log-info": ("What a log holds", "after/log/contents", "Contents", "Foreign"),
    "log-recover": ("What was recovered of a log", "after/log/recover", "RecoveredLog"),
    "margin": ("The margins of a rig's loop, or where its limit cycles begin",
               "study/margin/facts", "LoopFacts", "LimitCycleFacts"),
    "operate-arm": ("The loop was closed", "live/answers", "LoopClosed"),
    "operate-handover": ("Another controller took over", "live/answers", "HandedOver"),
    "operate-hold": ("The loop was opened without a fault", "live/answers", "LoopOpened"),
    "operate-lock": ("Which tunings a node refuses", "live/answers", "Locked"),
    "operate-reset": ("Nodes left FAULT", "live/answers", "CyclesOfReset"),
    "play": ("What was played", "run/played", "Played"),
    "replay": ("What was recomputed of each node", "after/replayed", "ReplayedNodes"),
    "replay-brief": ("What became of many logs, and how they stand to a table",
                     "after/verify/cli", "VerifiedLogs"),
    "replay-cycle": ("One cycle of each node of a log", "after/step/cli", "CyclesOfNodes"),
    "report": ("What became of each requirement", "after/verdict/requirements",
               "JudgedRequirements"),
    "rigs": ("The rigs that come with pcpc", "start/rigs", "Listed"),
    "run": ("What a run came to, as summary.json", "after/verdict/summary", "Summary"),
    "scope": ("What was captured around a trigger", "live/answers", "Capture"),
    "set": ("Parameters that were set", "live/answers", "Tuned"),
    "soak": ("A run of the soak", "dev/evidence/soak", "SoakRow"),
    "stop": ("The executive was asked to stop", "live/answers", "CycleOfStop"),
    "swarm": ("What a swarm of drawn rigs came to", "study/swarm/cli", "Told"),
    "watch": ("Values of variables in one cycle", "live/answers", "WatchedValues"),
}  # fmt: skip


def schema(title: str, *kinds: Any) -> dict[str, Any]:
    """Return the schema of a type, or of what is of one of several."""
    tops, parts = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    structs = {_class_of(one).__name__: one for one in _structs(inspected(kinds))}
    defs = {}
    for name, one in parts.items():
        defs[name] = _closed(one, structs[one["title"].partition("[")[0]])
    own = _plain({"anyOf": [*tops]} if kinds[1:] else tops[0])
    if "$ref" in own:
        own = defs.pop(own["$ref"].rpartition("/")[2])
    generic = {f"#/$defs/{name}": defs.pop(name) for name in parts if "_" in name}

    def inlined(one: dict[str, Any]) -> dict[str, Any]:
        return generic[one.pop("$ref")] | one if one.get("$ref") in generic else one

    about = {**own, **({"$defs": defs} if defs else {})}
    return {**_STANDARD, "title": title, **_changed(about, inlined)}


def _structs(one: Any) -> Iterator[Any]:
    """Yield what msgspec knows of the structs in a type."""
    if isinstance(one, tuple):
        for part in one:
            yield from _structs(part)
    elif isinstance(one, msgspec.inspect.Field):
        yield from _structs(one.type)
    elif isinstance(one, msgspec.inspect.Type):
        if hasattr(one, "fields"):
            yield one
        for key in one.__struct_fields__:
            yield from _structs(getattr(one, key))


def _class_of(struct: Any) -> type:
    """Return the class of a struct, of a generic one without what it is of."""
    return get_origin(struct.cls) or struct.cls


def _words(kind: type) -> dict[str, str]:
    """Return the words below the fields of a class and of those it is of."""
    sources = (one for one in kind.__mro__ if one.__module__.startswith("pcpc."))
    trees = (ast.parse(textwrap.dedent(inspect.getsource(one))).body[0] for one in sources)
    return {
        ast.unparse(field.target): " ".join(ast.literal_eval(below.value).split())
        for tree in trees
        if isinstance(tree, ast.ClassDef)
        for field, below in pairwise(tree.body)
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr)
    }


def _closed(one: Mapping[str, Any], struct: Any) -> dict[str, Any]:
    """Return the schema of a struct that has all its keys, and no others."""
    words, keys, required = _words(_class_of(struct)), {}, []
    config = getattr(struct.cls, "__struct_config__", None)
    omits = bool(config and config.omit_defaults)
    for field in struct.fields:
        name, own = field.encode_name, one["properties"][field.encode_name]
        keys[name] = _plain(own)
        if field.name in words:
            keys[name]["description"] = words[field.name]
        given = field.default, field.default_factory
        unset = given == (msgspec.NODEFAULT, msgspec.NODEFAULT) or omits or own.get("optional")
        if field.required or not unset:
            required.append(name)
    about = {"type": "object", "description": " ".join(one["description"].split())}
    return {**about, "properties": keys, "required": required, "additionalProperties": False}


def _changed(one: Any, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """Return a schema in which each object is changed, the inner ones first."""
    if isinstance(one, list):
        return [_changed(own, change) for own in one]
    if not isinstance(one, dict):
        return one
    return change({key: _changed(own, change) for key, own in one.items()})


def _plain(one: Any) -> Any:
    """Return a schema without what is told otherwise."""

    def plain(one: dict[str, Any]) -> dict[str, Any]:
        dropped = {*_DROPPED, *(["type"] if one.get("$ref", "").startswith(COMMON) else [])}
        return {key: own for key, own in one.items() if key not in dropped}

    return _changed(one, plain)


def _nullable(one: dict[str, Any]) -> dict[str, Any]:
    """Return a number as one that may be null, if it need not be finite."""
    if one.get("type") == "number" and not one.pop("finite", False):
        one["$ref"] = f"{COMMON}OrNull"
        del one["type"]
    return one


def _answer(title: str, place: str, *names: str) -> dict[str, Any]:
    """Return the schema of what a command prints; a study's numbers are null if not finite."""
    module = part_of(*place.rsplit("/", 1))
    found = schema(title, *(getattr(module, name) for name in names))
    return dict(_changed(found, _nullable)) if place.startswith("study/") else found


def files() -> dict[str, str]:
    """Return the files by name."""
    told = {
        "common": {**_STANDARD, "title": "What the schemas of several commands use",
                   "$defs": _COMMON},
        **{name: _answer(*about) for name, about in _ANSWERS.items() if is_installed(about[1])},
        **{name: {**_STANDARD, "$ref": f"{other}.json"} for name, other in _ALIKE.items()},
    }  # fmt: skip
    return {f"{name}.json": json.dumps(one, indent=2) + "\n" for name, one in told.items()}

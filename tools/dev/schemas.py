"""docs/reference/schemas from the structs that commands print, for `make reference`.

A struct's words are its docstring, a field's stand below it. What is printed has all its keys, but
for those that may be unset, and no others; JSON lacks some numbers, which are text or null.
"""

import ast
import inspect
import json
import textwrap
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import msgspec

from pcpc.tools.after.log import contents
from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.machine.jitter import figures as jitter
from pcpc.tools.run import checked, played
from pcpc.tools.start.bus import report as bus
from pcpc.tools.terminal.answer import COMMON
from pcpc.tools.terminal.rooms import is_installed, part_of

_ALIKE = ("branch", "simulate")  # commands that print what `run` prints
_STANDARD = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
_NUMBERS = {
    "Number": {
        "description": "a number, or the text of one that JSON lacks",
        "anyOf": [{"type": "number"}, {"enum": ["inf", "-inf", "nan"]}],
    },
    "OrNull": {"description": "null: not finite", "type": ["number", "null"]},
}
_DROPPED = {"default", "optional", "title"}  # told otherwise
_ANSWERS: dict[str, tuple[Any, ...]] = {  # title, and structs of which it is one
    "bus": ("Times of a rig's frames", bus.Times),
    "check": ("A rig as its nodes would run it", checked.Report),
    "jitter": ("Lateness of the loop and of others in turn", jitter.Figures),
    "log-info": ("What a log holds", contents.Contents, contents.Foreign),
    "play": ("What was played", played.Played),
    "run": ("What a run came to, as summary.json", Summary),
}
_STUDIES = {  # whose numbers are null where they are not finite: title, a room's part, its structs
    "bounds": ("A run compared with the theorem of its law", "text", "Figures", "Unknown"),
    "fit": ("Parameters of a plant from a log", "result", "FactsInFolder"),
    "swarm": ("What a swarm of drawn rigs came to", "cli", "Told"),
}


def schema(title: str, *kinds: Any) -> dict[str, Any]:
    """Return the schema of a type, or of what is of one of several."""
    tops, parts = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    structs = {one.cls.__name__: one for one in _structs(msgspec.inspect.multi_type_info(kinds))}
    defs = {name: _closed(one, structs[name]) for name, one in parts.items()}
    own = _plain({"anyOf": [*tops]} if kinds[1:] else tops[0])
    if "$ref" in own:
        own = defs.pop(own["$ref"].rpartition("/")[2])
    return {**_STANDARD, "title": title, **own, **({"$defs": defs} if defs else {})}


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
    words, keys, required = _words(struct.cls), {}, []
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


def _plain(one: Any) -> Any:
    """Return a schema without what is told otherwise."""
    if isinstance(one, list):
        return [_plain(own) for own in one]
    if not isinstance(one, dict):
        return one
    found = {key: _plain(own) for key, own in one.items() if key not in _DROPPED}
    if found.get("$ref", "").startswith(COMMON):
        del found["type"]
    return found


def _nullable(one: Any) -> Any:
    """Return a schema whose numbers may be null, but for those that are finite."""
    if isinstance(one, list):
        return [_nullable(own) for own in one]
    if not isinstance(one, dict):
        return one
    found = {key: _nullable(own) for key, own in one.items()}
    if found.get("type") == "number" and not found.pop("finite", False):
        found["$ref"] = f"{COMMON}OrNull"
        del found["type"]
    return found


def _study(room: str, title: str, part: str, *names: str) -> dict[str, Any]:
    """Return the schema of what a study that is here prints."""
    module = part_of(room, part)
    return _nullable(schema(title, *(getattr(module, name) for name in names)))


def files() -> dict[str, str]:
    """Return the files by name."""
    one = {"$ref": "run.json#/$defs/JudgedRequirement"}
    results = {"type": "array", "minItems": 1, "items": one}
    told = {
        "common": {**_STANDARD, "title": "What the schemas of several commands use",
                   "$defs": _NUMBERS},
        "report": {**_STANDARD, "title": "What became of each requirement", **results},
        **{name: schema(*about) for name, about in _ANSWERS.items()},
        **{name: _study(f"study/{name}", *about) for name, about in _STUDIES.items()
           if is_installed(f"study/{name}")},
        **{name: {**_STANDARD, "$ref": "run.json"} for name in _ALIKE},
    }  # fmt: skip
    return {f"{name}.json": json.dumps(one, indent=2) + "\n" for name, one in told.items()}

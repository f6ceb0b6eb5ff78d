"""JSON Schema of a rig file: what an editor completes, explains and marks while one types.

A file may lie over a `base:` and give a part only, so that no key has to be there, and null takes
one away; but a rig without a base has what it needs. Of a rig that is right its own names are known
too: its controllers, the settings of its laws with their ranges, ports, signals, frames, metrics.
The words of keys are those of docs/rig.md, by `make reference`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import msgspec
from msgspec import inspect

from pcpc.drivers.machine import outside
from pcpc.executive.loop.fault_kinds import KINDS
from pcpc.executive.rig import law_lookup
from pcpc.executive.rig.bus_keys import PROFILES
from pcpc.executive.rig.file_laws import FILE_LAWS
from pcpc.executive.rig.roles import MORE_PLANTS
from pcpc.executive.rig.schema import EARLIER, Config
from pcpc.executive.rig.segments import KEY, Segment

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block, Port
    from pcpc.executive.nodes.part import Plan
    from pcpc.executive.rig.reading import Rig

Schema = dict[str, Any]

_LISTED = ("Tuning", "Segment", "Requirement", "Expected")  # a list replaces that of a base
_TEXT: Schema = {"type": "string"}
_NUMBER: Schema = {"type": "number"}
_BELOW = "additionalProperties"
_NULL: Schema = {"type": "null"}
_DEFS = "#/$defs/"
_SEGMENT = {"over_s": "how long it takes, s", "to": "its last value; none: it holds", "by": "shape"}
_LIKE: Schema = {
    "description": "builds on this other entry, or on several; the last one rules",
    "anyOf": [_TEXT, {"type": "array", "items": _TEXT}],
}


def rig_schema(
    rig: Rig | None = None, plans: Sequence[Plan] = (), metrics: Iterable[str] = ()
) -> Schema:
    """Return the schema of any rig file, or of a rig's with what it knows; RigError.

    `plans`: of its nodes. `metrics`: of its evaluation.
    """
    whole = rig is not None and len(rig.document.sources) == 1  # no base
    kinds = (Config, Segment)
    structs = {one.cls.__name__: one.cls for one in _structs(inspect.multi_type_info(kinds))}
    _, parts = msgspec.json.schema_components(kinds, ref_template=f"{_DEFS}{{name}}")
    words = json.loads(Path(__file__).with_name("rig_words.json").read_text("utf-8"))
    defs = {
        name: _mapping(structs[name], own, words, whole or name in _LISTED)
        for name, own in parts.items()
    }
    _add_file_keys(defs, whole)
    if rig is not None:
        _add_names(defs, rig, plans, metrics)
    top = {**defs.pop("Config"), "title": "A rig of pcpc"}
    return {"$schema": "http://json-schema.org/draft-07/schema#", **top, "$defs": defs}


def _structs(kind: Any) -> Iterator[Any]:
    """Yield what msgspec knows of the structs in a type, or in several."""
    if isinstance(kind, tuple):
        for part in kind:
            yield from _structs(part)
    elif isinstance(kind, inspect.Field):
        yield from _structs(kind.type)
    elif isinstance(kind, inspect.Type):
        if isinstance(kind, inspect.StructType):
            yield kind
        for name in kind.__struct_fields__:
            yield from _structs(getattr(kind, name))


def _mapping(struct: type, own: Schema, words: Mapping[str, str], whole: bool) -> Schema:
    """Return the schema of a mapping of a file: its keys, none of which has to be there or all."""
    keys = {
        key: _described(words.get(f"{struct.__name__}.{key}", ""), _plain(value, whole), whole)
        for key, value in own["properties"].items()
    }
    about = own.get("description", "").partition("\n\n")[0].replace("\n", " ")
    needs = {"required": own["required"]} if whole and own["required"] else {}
    return {"description": about, "type": "object", "properties": keys, **needs,
            "additionalProperties": False}  # fmt: skip


def _described(words: str, own: Schema, whole: bool = False) -> Schema:
    """Return the schema of a key with its words; where a base may give it, null takes it away."""
    default = {key: own.pop(key) for key in ("default",) if key in own}
    kinds = own.pop("anyOf", None) or [own]
    if not whole and _NULL not in kinds:
        kinds = [*kinds, _NULL]
    told = {"description": words} if words else {}
    return {
        **told,
        **({"anyOf": kinds} if kinds[1:] or "$ref" in kinds[0] else kinds[0]),
        **default,
    }


def _plain(own: Any, whole: bool) -> Any:
    """Return a schema as editors read it: draft 7, patterns of JavaScript, defaults of JSON."""
    if isinstance(own, list):
        return [_plain(part, whole) for part in own]
    if not isinstance(own, dict):
        return own
    plain = {key: _plain(value, whole) for key, value in own.items() if key != "title"}
    if "prefixItems" in plain:
        plain["items"] = plain.pop("prefixItems")
    if "pattern" in plain:
        plain["pattern"] = plain["pattern"].replace(r"\A", "^").replace(r"\Z", "$")
    if isinstance(plain.get(_BELOW), dict):
        plain[_BELOW] = _described("", plain[_BELOW], whole)
    default = plain.get("default")
    if isinstance(default, dict) or (isinstance(default, float) and not isfinite(default)):
        del plain["default"]
    return plain


def _add_file_keys(defs: dict[str, Schema], whole: bool) -> None:
    """Add what a file may say and no struct has, since it is carried out before."""
    top, block = defs["Config"]["properties"], defs["BlockEntry"]["properties"]
    del top["more_plants"]
    top |= {role: {"anyOf": [{"$ref": f"{_DEFS}Plant"}, _NULL]} for role in MORE_PLANTS}
    top["base"] = {"description": "the file that this one builds on, key by key", **_TEXT}
    numbers = {"type": "object", "additionalProperties": {"type": ["number", "null"]}}
    top["evaluation"] = _described("what judges a run, and its numbers", {**numbers, "properties": {
        "file": {"description": "Python file with the metrics", **_TEXT},
        "window_s": {"description": "begin and end, s; none: the whole run", "type": "array",
                     "items": [_NUMBER, _NUMBER], "minItems": 2, "maxItems": 2},
    }}, whole)  # fmt: skip
    for (section, key), path in EARLIER.items():
        known = {"description": f"today {'.'.join(path)}", "deprecated": True}
        defs[section.capitalize()]["properties"][key] = known
    block[KEY] = _described(
        "of `law: profiles:sequence`: pieces of a reference",
        {"type": "array", "minItems": 1, "items": {"$ref": f"{_DEFS}Segment"}},
    )
    for key, words in _SEGMENT.items():
        defs["Segment"]["properties"][key]["description"] = words
    laws = [*sorted(law_lookup.shipped_laws()), *map(str, FILE_LAWS)]
    named = {"anyOf": [{"enum": laws}, {**_TEXT, "pattern": "[:.]"}]}
    defs["Law"]["properties"]["like"] = _LIKE
    defs["Plant"]["properties"] |= {
        "like": _LIKE,
        "fmu": _described("Functional Mock-up Unit that is the plant", {**_TEXT}, whole),
        **{key: block[key] for key in ("inputs", "parameters")},
    }
    for name in ("Law", "BlockEntry"):
        words = defs[name]["properties"]["law"].get("description", "")
        defs[name]["properties"]["law"] = _described(words, dict(named), whole and name == "Law")
    dialects = sorted({*PROFILES, *(one.name for one in outside.additions("drives"))})
    drive = defs["Drive"]["properties"]
    drive["profile"] = _described(drive["profile"]["description"], {"enum": dialects}, whole)
    defs["Fault"]["properties"]["kind"] |= {"enum": [*KINDS]}
    for name, others in (("Law", ("like",)), ("Plant", ("like", "fmu"))):
        if needs := defs[name].pop("required", None):
            spared = {"anyOf": [{"required": [key]} for key in others]}
            defs[name] |= {"if": {"not": spared}, "then": {"required": needs}}


def _add_names(
    defs: dict[str, Schema], rig: Rig, plans: Sequence[Plan], metrics: Iterable[str]
) -> None:
    """Add the names that a rig knows: controllers, blocks with their ports, signals, frames."""
    config, top, leader = rig.config, defs["Config"]["properties"], plans[0]
    names = {"enum": [*config.controllers]}
    for own, key in (
        (top, "controller"),
        (defs["Overrun"]["properties"], "fallback"),
        (defs["Tuning"]["properties"], "handover"),
    ):
        own[key] = _described(own[key]["description"], dict(names))
    for own, key in ((top, "standby"), (defs["Requirement"]["properties"], "controllers")):
        own[key] = _described(own[key]["description"], {"type": "array", "items": names})
    entries = {}
    for name, law in config.controllers.items():
        use = law_lookup.Use(law.parameters, config.rate_hz, config.seed)
        block = law_lookup.law_block(rig.document, ("controllers", name), law.law, use)
        entries[name] = _entry(defs["Law"], block, leader)
        own = [f"controller.{one}" for port in block.outputs for one in port.names()]
        entries[name]["properties"]["transmit"] = _sent(leader, "further signals and sources", own)
    top["controllers"] = _entries(top["controllers"], entries, closed=False)
    top["expect"] = _entries(
        top["expect"], dict.fromkeys(names["enum"], _entries(_below(top["expect"]), metrics))
    )
    top["losses"] = _entries(top["losses"], {one.name for plan in plans for one in plan.rx_frames})
    for plan in plans:
        defs |= _sources(plan)
        section = defs[type(config.sections[plan.role]).__name__]
        top[plan.role] = _described(section["description"], _node(defs, section, plan))


def _node(defs: Mapping[str, Schema], section: Schema, plan: Plan) -> Schema:
    """Return the schema of a node with what its plan knows."""
    keys = dict(section["properties"])
    written = plan.rig.config.sections[plan.role].blocks
    entries = {
        spec.name: _entry(defs["BlockEntry"], spec.block, plan)
        for spec in plan.spec.blocks
        if spec.name in written
    }
    keys["blocks"] = _entries(keys["blocks"], entries, closed=False)
    keys["transmit"] = _sent(plan, "signals and their sources; without one a signal is 0")
    for key, way in (("limits", "sent"), ("plausible", "received"), ("safe", "received")):
        if key in keys:
            keys[key] = _entries(keys[key], plan.of_kind(way))
    return {**section, "properties": keys}


def _entry(own: Schema, block: Block, plan: Plan) -> Schema:
    """Return the schema of a block or a controller, with what its law has."""
    settings = {
        name: _described(f"{port.help} [{port.unit}]", _setting(port))
        for port in block.settings
        for name in port.names()
    }
    inputs = {
        name: _described(f"{port.help} [{port.unit}]", _source(plan, port.unit))
        for port in block.inputs
        for name in port.names()
    }
    keys = own["properties"] | {
        key: _described(own["properties"][key].get("description", ""), _closed(entries))
        for key, entries in (("parameters", settings), ("inputs", inputs))
    }
    return {**own, "properties": keys}


def _setting(port: Port) -> Schema:
    bounds = {"minimum": port.low, "maximum": port.high, "default": port.default}
    known = {key: value for key, value in bounds.items() if value is not None and isfinite(value)}
    return {**_NUMBER, **known}


def _source(plan: Plan, unit: str, own: Sequence[str] = ()) -> Schema:
    """Return the schema of what may be wired to what has a unit; `own` of a controller, too."""
    name = f"{plan.role} [{unit}]".replace("~", "~0").replace("/", "~1")
    sources = {"$ref": f"{_DEFS}{quote(name, safe='~')}"}
    return {"anyOf": [sources, {"enum": [*own]}]} if own else {"anyOf": [sources]}


def _sources(plan: Plan) -> dict[str, Schema]:
    """Return the schemas of the variables of each unit that may be wired in a node."""
    known: dict[str, list[str]] = {}
    for one in plan.table.variables:
        known.setdefault(one.unit, [])
        if one.kind != "input":
            known[one.unit].append(one.name)
    return {f"{plan.role} [{unit}]": {"enum": names} for unit, names in known.items()}


def _sent(plan: Plan, words: str, own: Sequence[str] = ()) -> Schema:
    return _described(words, _closed({
        name: _described(f"[{signal.unit}]", _source(plan, signal.unit, own))
        for name, signal in plan.of_kind("sent").items()
    }))  # fmt: skip


def _closed(entries: Mapping[str, Schema]) -> Schema:
    """Return the schema of a mapping with these keys and no others; null takes one away."""
    return {"type": "object", "properties": dict(entries), _BELOW: _NULL}


def _below(own: Schema) -> Schema:
    """Return the schema of the entries of a mapping by name."""
    kinds = own.get("anyOf", [own])
    below: Schema = next(one["additionalProperties"] for one in kinds if _BELOW in one)
    return below


def _entries(
    own: Schema, names: Iterable[str] | Mapping[str, Schema], closed: bool = True
) -> Schema:
    """Return the schema of a mapping by name with these entries, and no others if `closed`."""
    below = _below(own)
    known = names if isinstance(names, Mapping) else dict.fromkeys(names)
    given = {key: value if isinstance(value, dict) else below for key, value in known.items()}
    mapping = _closed(given) if closed else _closed(given) | {_BELOW: below}
    return _described(own.get("description", ""), mapping)

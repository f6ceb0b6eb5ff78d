"""The schemas of docs/reference/schemas, which may refer to each other, and what they hold of."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from referencing import Registry, Resource

FOLDER = Path(__file__).resolve().parents[2] / "docs/reference/schemas"
COMMON = "common"  # what several use; it is of no command
SCHEMAS: dict[str, dict[str, Any]] = {
    path.stem: json.loads(path.read_text("utf-8")) for path in sorted(FOLDER.glob("*.json"))
}
_SUMMARY = {"ids", "id", "device", "bound", "rig_git"}
OPTIONAL = {  # keys that are not always there
    "run": _SUMMARY, "simulate": _SUMMARY, "branch": _SUMMARY, "check": {"fmus"},
    "doctor": {"can_run"}, "log info": {"name", "event", "argument"},
    "margin": {"spread", "coherence"}, "report": {"id"}, "scope": {"missing_before"},
}  # fmt: skip
PLAIN = {"compare": "settings"}  # below it any text, number, list
ANY = {"run": "device"}  # below it anything: others wrote it
_REGISTRY: Registry[Any] = Registry().with_resources(
    (f"{name}.json", Resource.from_contents(one)) for name, one in SCHEMAS.items()
)


def file_of(command: str) -> str:
    """Return the name of the schema of a command, or of one with an option: get-long."""
    return command.replace(" --", "-").replace(" ", "-")


def validator(command: str) -> Draft202012Validator:
    """Return what judges the output of a command."""
    return Draft202012Validator(SCHEMAS[file_of(command)], registry=_REGISTRY)


def strictly(text: str) -> Any:
    """Return what JSON says; a bare NaN or Infinity is none."""
    return json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))


def holds(command: str, text: str) -> Any:
    """Return what a command printed, which its schema has to hold of."""
    told = strictly(text)
    validator(command).validate(told)
    return told


def strictly_holds(command: str, text: str) -> Any:
    """Return what a command printed: of its schema, which sees whatever is wrong with it."""
    told = holds(command, text)
    unseen = [*unseen_lies(command, told)]
    assert not unseen, unseen
    return told


def unseen_lies(command: str, told: Any) -> Iterator[str]:
    """Yield where what was printed could be wrong, and its schema would hold of it nevertheless.

    Wrong is another type, a key too many or one too few, at any depth, in a list of the first one.
    """
    judge, optional = validator(command), OPTIONAL.get(command, ())
    told = _first_ones(told)
    judge.validate(told)
    for path, value, fixed in _parts(file_of(command), SCHEMAS[file_of(command)], told, ()):
        if command in ANY and ANY[command] in path[:-1]:
            continue
        plain = command in PLAIN and PLAIN[command] in path and not isinstance(value, dict | list)
        lies = {"another type": _put(told, path, {"odd": [{}]} if plain else _another(value))}
        if isinstance(value, dict) and (fixed or ANY.get(command) not in path):
            lies["a new key"] = _put(told, path, value | {"new.key": [{}]})
        for key in fixed:
            if key in value and key not in optional:
                lies[f"no {key}"] = _put(told, path, {k: v for k, v in value.items() if k != key})
        yield from (f"{path}: {what}" for what, lie in lies.items() if judge.is_valid(lie))


def _first_ones(told: Any) -> Any:
    """Return what was printed with at most three of each list: no answer needs more."""
    if isinstance(told, list):
        return [_first_ones(one) for one in told[:3]]
    return {k: _first_ones(v) for k, v in told.items()} if isinstance(told, dict) else told


def _parts(file: str, schema: Any, told: Any, path: tuple[Any, ...]) -> Iterator[Any]:
    """Yield path, value and the keys that it must have, of all that a schema says of."""
    if "$ref" in schema:
        place, _, name = schema["$ref"].partition("#/$defs/")
        file = place.removesuffix(".json") or file
        schema = SCHEMAS[file]["$defs"][name] if name else SCHEMAS[file]
        yield from _parts(file, schema, told, path)
        return
    for one in schema.get("anyOf", ()):
        if _judge(file, one).is_valid(told):
            yield from _parts(file, one, told, path)
            return
    fixed = [] if "patternProperties" in schema else [*schema.get("properties", {})]
    yield path, told, fixed
    if isinstance(told, dict):
        known, others = schema.get("properties", {}), schema.get("additionalProperties", {})
        for key, value in told.items():
            yield from _parts(file, known.get(key, others), value, (*path, key))
    elif isinstance(told, list) and told:
        first = schema["prefixItems"][0] if "prefixItems" in schema else schema.get("items", {})
        yield from _parts(file, first, told[0], (*path, 0))


def _judge(file: str, schema: Any) -> Draft202012Validator:
    """Return what judges by a part of a file."""
    defs = {"$defs": SCHEMAS[file].get("$defs", {})}
    return Draft202012Validator({**defs, **schema}, registry=_REGISTRY)


def _another(value: Any) -> Any:
    """Return a value of another type."""
    if isinstance(value, str) and value not in ("inf", "-inf", "nan"):
        return 1.5
    return "odd" if isinstance(value, dict | float | int) else {"odd": [{}]}


def _put(told: Any, path: Sequence[Any], value: Any) -> Any:
    """Return what was printed with another value at a path."""
    if not path:
        return value
    changed = told.copy()
    changed[path[0]] = _put(told[path[0]], path[1:], value)
    return changed

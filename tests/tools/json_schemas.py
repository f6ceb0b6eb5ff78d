"""The schemas of docs/reference/schemas, which may refer to each other, and what they hold of."""

import json
from collections.abc import Iterator
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


def without_a_key_or_with_another(told: Any) -> Iterator[tuple[str, Any]]:
    """Yield what was printed without each key of its outermost object, and with a new one."""
    one, more = (told[0], told[1:]) if isinstance(told, list) else (told, None)
    changed = {key: {k: v for k, v in one.items() if k != key} for key in one}
    for key, other in {**changed, "new": {**one, "new": 1}}.items():
        yield key, other if more is None else [other, *more]

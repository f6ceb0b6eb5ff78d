"""The words of docs/rig.md for each key of a rig, by the struct that has it: `make reference`."""

import json
import re
from pathlib import Path
from typing import Any

import msgspec
from msgspec import inspect

from pcpc.executive.rig.schema import Config

_PAGE = Path(__file__).resolve().parents[2] / "docs/rig.md"
_ROW = re.compile(r"^\| (`[^|]+`) \| [^|]* \| (\S.*) \|$", re.MULTILINE)
_LINK = re.compile(r"\[([^]]+)\]\([^)]*\)")


def struct_in(kind: inspect.Type) -> type | None:
    """Return the struct that a type is, holds as entries, or may be."""
    if isinstance(kind, inspect.StructType):
        return kind.cls
    if isinstance(kind, inspect.DictType):
        return struct_in(kind.value_type)
    if isinstance(kind, inspect.ListType):
        return struct_in(kind.item_type)
    if isinstance(kind, inspect.UnionType):
        return next(filter(None, map(struct_in, kind.types)), None)
    return None


def _struct_and_key(path: str) -> tuple[str, str]:
    """Return the struct of the key at a path such as executive.blocks.NAME.law, and its name."""
    kind: Any = Config
    around = kind
    parts = [part.removesuffix("[]") for part in path.split(".") if part != "NAME"]
    for part in parts:
        around = kind
        fields = msgspec.structs.fields(around)
        found = next((one.type for one in fields if one.encode_name == part), None)
        kind = None if found is None else struct_in(inspect.type_info(found))
    return around.__name__, parts[-1]


def written() -> str:
    """Return the file that `pcpc check --schema` takes the words of keys from."""
    words: dict[str, str] = {}
    for cell, meaning in _ROW.findall(_PAGE.read_text("utf-8")):
        paths, plain = re.findall(r"`([^`]+)`", cell), _LINK.sub(r"\1", meaning)
        parts = plain.split("; ")  # of as many keys each has its own
        each = parts if len(parts) == len(paths) else [plain] * len(paths)
        for path, text in zip(paths, each, strict=True):
            words.setdefault(".".join(_struct_and_key(path)), text)
    return json.dumps(words, indent=1) + "\n"

"""Data of a file that know where they were written, and how places and paths are told.

A path such as `a.b[2].c` names a value; its place is that of its key, in the file it comes from.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from pcpc.executive.errors import display_path

Keys = tuple[str | int, ...]


@dataclass(frozen=True)
class Place:
    """Where a value was given: a file with line and column (from 1), or a command line `option`."""

    file: Path
    line: int = 1
    column: int = 1
    option: str = ""

    def __str__(self) -> str:
        return self.option or f"{display_path(self.file)}:{self.line}:{self.column}"

    @property
    def folder(self) -> Path:
        """The folder that relative paths written at this place start from."""
        return (working_folder() or Path()) if self.option else self.file.parent


class PlacedMap(dict[str, Any]):
    """A mapping and the place of each key, `at`, which also keeps those of keys that it lost."""

    __slots__ = ("at",)

    def __init__(
        self, data: Mapping[str, Any] | None = None, at: Mapping[str, Place] | None = None
    ) -> None:
        super().__init__(data or {})
        self.at = dict(at or {})

    def take(self, key: str, other: "PlacedMap", other_key: str = "") -> None:
        """Take over a key of another mapping, or what has `other_key` there, with its places."""
        other_key = other_key or key
        self[key] = copied(other[other_key])
        if other_key in other.at:
            self.at[key] = other.at[other_key]


class Items(list[Any]):
    """A list and the place of each of its items, `at`."""

    __slots__ = ("at",)

    def __init__(self, data: Iterable[Any], at: Mapping[int, Place]) -> None:
        super().__init__(data)
        self.at = dict(at)


def places_in(data: Any) -> dict[Any, Place]:
    """Return the places of the keys of a mapping, or of the items of a list; {} of all else."""
    return data.at if isinstance(data, PlacedMap | Items) else {}


def child(data: Any, key: str | int) -> Any:
    """Return what a mapping has under a key, or a list at a place; None for nothing."""
    try:
        return data[key]
    except (LookupError, TypeError):
        return None


def copied(data: Any) -> Any:
    """Return data that can be changed, with the same places."""
    if isinstance(data, PlacedMap):
        return PlacedMap({key: copied(value) for key, value in data.items()}, data.at)
    return Items(map(copied, data), data.at) if isinstance(data, Items) else data


def keys_of(data: Any, path: str) -> Keys:
    """Return the keys along a written path, as far as there are such; they may have dots."""
    longest: Keys = ()
    for key in (*places_in(data), *(data if isinstance(data, PlacedMap) else ())):
        name = dotted_path((key,))
        if path == name or path.startswith((f"{name}.", f"{name}[")):
            rest = path.removeprefix(name).removeprefix(".")
            keys = (key, *keys_of(child(data, key), rest))
            longest = max(longest, keys, key=lambda one: len(dotted_path(one)))
    return longest


@lru_cache(10_000)
def dotted_path(keys: Keys) -> str:
    """Return the written form of a path: `a.b[2].c`."""
    parts = (f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
    return "".join(parts).removeprefix(".")


def working_folder() -> Path | None:
    """Return the working folder; None where it is gone."""
    try:
        return Path.cwd()
    except OSError:
        return None

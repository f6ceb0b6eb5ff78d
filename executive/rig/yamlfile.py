"""Strict YAML that remembers where every value stands, and files that build on a `base:` file.

Plain scalars are read as YAML 1.2 has them: `1e-3`, `1E5` and `.5` are numbers, `yes`, `no`, `on`
and `off` are text, keys are always text. Refused, because they hide mistakes: equal keys, `010` (8
or 10?), `0o10`, `.nan`, numbers beyond 64 bits, tags, anchors, merge keys (`base:` shares values).

    base: ../rig.yaml   the present file over its base: mappings merge, scalars and lists replace,
                        null deletes a key.  Keys keep the base's order and new ones follow, unless
                        the present mapping names all keys of the base's: then its order rules.

A path such as `a.b[2].c` names a value; its place is that of its key, in the file it comes from.
"""

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from pcpc.drivers.machine.regular_files import open_regular
from pcpc.executive.errors import RigError, near_file
from pcpc.executive.rig.yaml_parser import compose, reads_the_same

Keys = tuple[str | int, ...]

MOST_BYTES = 1 << 20  # of a rig file, which has a few thousand; PyYAML takes 10 s for it
_MOST_BASES = 100  # files over each other: a thousand are too deep for Python
_INTEGER = re.compile(r"[-+]?[0-9]+")
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"([-+]?)\.(inf|Inf|INF)")
_UNICODE_BREAKS = re.compile("[\x85\u2028\u2029\ufeff]")
_LEADING_ZERO = re.compile(r"[-+]?0[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?|0o[0-7]+")
_WIDTH = 100
_WORDS = {
    "": None, "~": None, "null": None, "Null": None, "NULL": None,
    "true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False,
}  # fmt: skip


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
        return (_working_folder() or Path()) if self.option else self.file.parent


@dataclass
class Document:
    """Plain data (dict, list, str, float, int, bool, None) and the place of every value.

    `text` is the file as given, without its bases; `sources` holds the text of every file read.
    """

    path: Path
    text: str
    data: dict[str, Any]
    places: dict[Keys, Place]
    sources: dict[Path, str] = field(default_factory=dict)
    _named: dict[str, Place] = field(default_factory=dict, repr=False, compare=False)

    def place(self, path: str | Keys) -> Place:
        """Return the place of the value at `path`, or of the nearest mapping or list around it."""
        if isinstance(path, tuple):
            while path not in self.places:
                path = path[:-1]
            return self.places[path]
        if len(self._named) != len(self.places):
            self._named = {dotted_path(keys): place for keys, place in self.places.items()}
        while path not in self._named:
            path = path[: max(path.rfind("."), path.rfind("["), 0)]
        return self._named[path]

    def where(self, path: str | Keys) -> str:
        """Return `file:line:column` (or the option) of `path`, or of what is nearest around it."""
        return str(self.place(path))

    def error(self, path: str | Keys, what: str) -> RigError:
        """Return the error `file:line:column: path: what`; an option needs no path beside it."""
        place, name = self.place(path), dotted_path(path) if isinstance(path, tuple) else path
        whole = what if place.option or not name else f"{name}: {what}"
        return RigError(f"{place}: {whole}")

    def file(self, keys: Keys, text: str, cure: str = "") -> Path:
        """Return the file that `text` at `keys` names, from where it was written; RigError."""
        try:
            file = _real_path(self.place(keys).folder / text)
            if file.is_file():
                return file
        except (OSError, ValueError) as error:  # a loop of links, a name too long
            raise self.error(keys, f"{text[:60]} is no file: {_reason(error)}") from None
        raise self.error(keys, f"no such file: {display_path(file)}{cure or near_file(file)}")

    def put(self, keys: Keys, value: Any, place: Place) -> None:
        """Set the value at `keys` (texts only), as given at `place`."""
        target: Any = self.data
        for key in keys[:-1]:
            if not isinstance(target.get(key), dict):
                target[key] = {}
            target = target[key]
        target[keys[-1]] = value
        for known in [one for one in self.places if one[: len(keys)] == keys]:
            del self.places[known]
        self.places[keys] = place
        self._named = {}


@dataclass(frozen=True)
class _Node:
    """`value` is a dict or list of nodes, or a scalar."""

    value: Any
    place: Place


def load(path: str | Path, text: str | None = None) -> Document:
    """Read a mapping from `path`, or from `text` as if it stood there, over its `base:` files.

    Raises RigError with the place of whatever is wrong.
    """
    try:
        file = _real_path(Path(path))
    except (OSError, ValueError) as error:
        raise RigError(f"{str(path)[:200]}: cannot be read: {_reason(error)}") from None
    sources: dict[Path, str] = {}
    root = _read_file(file, text, sources, (), None)
    document = Document(file, sources[file], _plain(root), dict(_places(root, ())), sources)
    document.places[()] = Place(file)
    return document


def parse_value(text: str, place: Place) -> Any:
    """Return the value of an option NAME=`text`: a scalar, flow list or mapping; RigError."""
    try:
        node = compose(text)
        return None if node is None else _plain(_tree(node, place.file, place))
    except yaml.YAMLError as error:
        raise RigError(f"{place}: {getattr(error, 'problem', error)}") from None
    except RecursionError:
        raise RigError(f"--set {text[:40]}...: nested too deeply") from None


def dump(data: Any) -> str:
    """Return YAML text that `load` reads back as equal data, in the same order."""
    with contextlib.suppress(UnicodeEncodeError):  # half a character, which libyaml refuses
        text = _yaml_text(data, _Fast, readable=True)
        if reads_the_same(text) and "\\" not in text and max(map(len, text.splitlines())) <= _WIDTH:
            return text  # PyYAML's own emitter, four times as slow, writes the same
    for readable in (True, False):
        text = _yaml_text(data, _Slow, readable)
        if not _UNICODE_BREAKS.search(text):  # PyYAML writes them raw and reads them as a space
            break
    return text


def _yaml_text(data: Any, dumper: Any, readable: bool) -> str:
    return str(
        yaml.dump(data, Dumper=dumper, sort_keys=False, allow_unicode=readable, width=_WIDTH)
    )


def parse_scalar(text: str) -> Any:
    """Return the value of a plain scalar. Raises ValueError (what; cure) if it is refused."""
    if text in _WORDS:
        return _WORDS[text]
    if _LEADING_ZERO.fullmatch(text):
        raise ValueError(f"{text} could be read as octal; write it in decimal, or quote it as text")
    if _INTEGER.fullmatch(text) or _HEXADECIMAL.fullmatch(text):
        if len(text) > 20 or not -(2**63) <= int(text, 0) < 2**63:
            raise ValueError(f"{text[:24]} is beyond 64 bits; write a float, or quote it as text")
        return int(text, 0)
    if _FLOAT.fullmatch(text):
        if abs(number := float(text)) == float("inf"):
            raise ValueError(f"{text[:24]} is beyond the range of a float; for infinity write .inf")
        return number
    if found := _INFINITY.fullmatch(text):
        return float(f"{found[1]}inf")
    if text in (".nan", ".NaN", ".NAN"):
        raise ValueError(f"{text} is not a value; give a number, or null for none")
    return text


@lru_cache(10_000)
def dotted_path(keys: Keys) -> str:
    """Return the written form of a path: `a.b[2].c`."""
    parts = (f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
    return "".join(parts).removeprefix(".")


def display_path(file: Path) -> str:
    """Return the path of `file` as messages show it: relative below the working directory."""
    try:
        return _path_below(file, os.getcwd())
    except OSError:  # it is gone
        return str(file)


@lru_cache(maxsize=64)  # every value of a rig has a place
def _path_below(file: Path, folder: str) -> str:
    return str(file.relative_to(folder) if file.is_relative_to(folder) else file)


def _working_folder() -> Path | None:
    """Return the working folder; None where it is gone."""
    try:
        return Path.cwd()
    except OSError:
        return None


def _real_path(path: Path) -> Path:
    """Return the absolute name behind all links; OSError, in every Python, for a loop of them."""
    try:
        os.path.realpath(path, strict=True)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise
    return path.resolve()


def _reason(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "the working folder is gone"  # nothing else asks for it
    if isinstance(error, OSError):
        return "a loop of links" if error.errno == errno.ELOOP else error.strerror or "refused"
    return "no name of a file"


class _Slow(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


class _Fast(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    ignore_aliases = _Slow.ignore_aliases


def _text_node(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    try:
        plain = parse_scalar(text) == text
    except ValueError:
        plain = False
    style = None if plain else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Slow.add_representer(str, _text_node)
_Fast.add_representer(str, _text_node)


def _read_file(
    file: Path,
    text: str | None,
    sources: dict[Path, str],
    above: tuple[Path, ...],
    named_at: Place | None,
) -> _Node:
    """Return the tree of `file` merged over its bases; `above` are the files that build on it."""
    at = f"{named_at}: base: " if named_at else ""
    if file in above:
        chain = " -> ".join(display_path(f) for f in (*above[above.index(file) :], file))
        raise RigError(f"{at}the files build on each other: {chain}")
    if text is None:
        try:
            if len(above) > _MOST_BASES:
                raise OSError(0, f"more than {_MOST_BASES} files build on each other")
            text = _text_of(file)
        except (OSError, ValueError) as error:
            why = f"cannot be read: {getattr(error, 'strerror', None) or 'not UTF-8 text'}"
            why = f"no such file{near_file(file)}" if isinstance(error, FileNotFoundError) else why
            raise RigError(f"{at}{display_path(file)}: {why}") from None
    sources[file] = text
    parsed = _parse(file, text)
    base = parsed.value.get("base")
    root = _Node({key: node for key, node in parsed.value.items() if key != "base"}, parsed.place)
    if base is None:
        return root
    if not isinstance(base.value, str):
        raise RigError(f"{base.place}: base: expected the path of a file")
    try:
        named = _real_path(file.parent / base.value)
    except (OSError, ValueError) as error:
        raise RigError(f"{base.place}: base: is no file: {_reason(error)}") from None
    return _merge(_read_file(named, None, sources, (*above, file), base.place), root)


def _text_of(file: Path) -> str:
    """Return the text of a regular file; OSError, UnicodeDecodeError."""
    with open_regular(file) as stream:
        whole = stream.read(MOST_BYTES + 1)
    if len(whole) > MOST_BYTES:
        raise OSError(0, f"more than {MOST_BYTES >> 20} MiB")
    return whole.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


@lru_cache(maxsize=64)  # an experiment loads the same few files a thousand times
def _parse(file: Path, text: str) -> _Node:
    """Return the tree of a file, which nobody changes."""
    try:
        node = compose(text)
        if not isinstance(node, yaml.MappingNode):
            raise RigError(f"{Place(file)}: expected a mapping, `key: value` lines")
        return _tree(node, file)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = Place(file, mark.line + 1, mark.column + 1) if mark else Place(file)
        what = str(error.problem or error.context).replace("'\\t'", "a tab")
        what = "found a tab; indent with spaces" if "a tab" in what else what
        raise RigError(f"{place}: {what}") from None
    except yaml.reader.ReaderError as error:
        before = text[: int(error.position)]
        place = Place(file, before.count("\n") + 1, len(before) - before.rfind("\n"))
        character = chr(error.character) if isinstance(error.character, int) else error.character
        raise RigError(f"{place}: character {character!r} is not allowed") from None
    except RecursionError:
        raise RigError(f"{Place(file)}: nested too deeply") from None


def _tree(node: yaml.Node, file: Path, place: Place | None = None) -> _Node:
    """Return our tree of PyYAML's; `place`, else the node's own position, is where it stands."""
    if isinstance(node, yaml.MappingNode):
        return _Node(_pairs(node, file, place), place or _place(node, file))
    if isinstance(node, yaml.SequenceNode):
        return _Node([_tree(item, file, place) for item in node.value], place or _place(node, file))
    assert isinstance(node, yaml.ScalarNode), "YAML has three kinds of nodes"
    if node.style:  # quoted, or a block
        return _Node(node.value, place or _place(node, file))
    try:
        return _Node(parse_scalar(node.value), place or _place(node, file))
    except ValueError as error:
        raise RigError(f"{place or _place(node, file)}: {error}") from None


def _pairs(node: yaml.MappingNode, file: Path, option: Place | None) -> dict[str, _Node]:
    pairs: dict[str, _Node] = {}
    for key_node, value_node in node.value:
        place, key = option or _place(key_node, file), key_node.value
        if not isinstance(key, str) or not key:
            raise RigError(f"{place}: expected text as the key")
        if key == "<<" and not key_node.style:
            raise RigError(f"{place}: merge keys are not supported; share values with `base:`")
        if key in pairs:
            first = pairs[key].place
            raise RigError(f"{place}: {key}: given twice, first at {first}; remove one of the two")
        pairs[key] = _Node(_tree(value_node, file, option).value, place)
    return pairs


def _place(node: yaml.Node, file: Path) -> Place:
    return Place(file, node.start_mark.line + 1, node.start_mark.column + 1)


def _merge(base: _Node, over: _Node) -> _Node:
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)):
        return over
    below, above = base.value, over.value
    names = above if below.keys() <= above.keys() else {**below, **above}
    merged: dict[str, _Node] = {}
    for name in names:
        if name in below and name in above:
            if above[name].value is not None:
                merged[name] = _merge(below[name], above[name])
        else:
            merged[name] = above[name] if name in above else below[name]
    return _Node(merged, over.place)


def _plain(node: _Node) -> Any:
    if isinstance(node.value, dict):
        return {key: _plain(child) for key, child in node.value.items()}
    if isinstance(node.value, list):
        return [_plain(child) for child in node.value]
    return node.value


def _places(node: _Node, keys: Keys) -> Iterator[tuple[Keys, Place]]:
    yield keys, node.place
    if isinstance(node.value, dict):
        for key, child in node.value.items():
            yield from _places(child, (*keys, key))
    elif isinstance(node.value, list):
        for index, child in enumerate(node.value):
            yield from _places(child, (*keys, index))

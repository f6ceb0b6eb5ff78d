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
from collections.abc import Collection
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from pcpc.drivers.machine.regular_files import open_regular
from pcpc.executive.errors import RigError, did_you_mean, near_file
from pcpc.executive.errors import display_path as display_path
from pcpc.executive.rig.placed import Items, PlacedMap, child, copied, keys_of, places_in
from pcpc.executive.rig.placed import Keys as Keys
from pcpc.executive.rig.placed import Place as Place
from pcpc.executive.rig.placed import dotted_path as dotted_path
from pcpc.executive.rig.yaml_parser import compose, reads_the_same

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


@dataclass
class Document:
    """Plain data (`PlacedMap`, `Items`, str, float, int, bool, None) that know their places.

    `text` is the file as given, without its bases; `sources` holds the text of every file read.
    """

    path: Path
    text: str
    data: PlacedMap
    sources: dict[Path, str] = field(default_factory=dict)

    def place(self, path: str | Keys) -> Place:
        """Return the place of the value at `path`, or of the nearest mapping or list around it."""
        place, data = Place(self.path), self.data
        for key in path if isinstance(path, tuple) else keys_of(data, path):
            place, data = places_in(data).get(key, place), child(data, key)
        return place

    def where(self, path: str | Keys) -> str:
        """Return `file:line:column` (or the option) of `path`, or of what is nearest around it."""
        return str(self.place(path))

    def error(self, path: str | Keys, problem: str) -> RigError:
        """Return the error `file:line:column: path: problem`; an option needs no path beside it."""
        place, name = self.place(path), dotted_path(path) if isinstance(path, tuple) else path
        whole = problem if place.option or not name else f"{name}: {problem}"
        return RigError(f"{place}: {whole}")

    def known(self, path: str | Keys, name: str, names: Collection[str], kind: str) -> None:
        """Raise RigError `no KIND NAME; did you mean X?` for a name that is not among `names`."""
        if name not in names:
            raise self.error(path, f"no {kind} {name}{did_you_mean(name, names)}")

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
            if not isinstance(target.get(key), PlacedMap):
                target[key] = PlacedMap()
            target = target[key]
        target[keys[-1]], target.at[keys[-1]] = value, place


def load(path: str | Path, text: str | None = None) -> Document:
    """Read a mapping from `path`, or from `text` as if it stood there, over its `base:` files.

    Raises RigError with the place of whatever is wrong.
    """
    try:
        file = _real_path(Path(path))
    except (OSError, ValueError) as error:
        raise RigError(f"{str(path)[:200]}: cannot be read: {_reason(error)}") from None
    sources: dict[Path, str] = {}
    data = copied(_read_file(file, text, sources, (), None))
    return Document(file, sources[file], data, sources)


def parse_value(text: str, place: Place) -> Any:
    """Return the value of an option NAME=`text`: a scalar, flow list or mapping; RigError."""
    try:
        node = compose(text)
        return None if node is None else _tree(node, place.file, place)
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


for _dumper in (_Slow, _Fast):
    _dumper.add_representer(str, _text_node)
    _dumper.add_representer(PlacedMap, yaml.SafeDumper.represent_dict)
    _dumper.add_representer(Items, yaml.SafeDumper.represent_list)


def _read_file(
    file: Path,
    text: str | None,
    sources: dict[Path, str],
    above: tuple[Path, ...],
    named_at: Place | None,
) -> PlacedMap:
    """Return the data of `file` merged over its bases; `above` are the files that build on it."""
    prefix = f"{named_at}: base: " if named_at else ""
    if file in above:
        chain = " -> ".join(display_path(f) for f in (*above[above.index(file) :], file))
        raise RigError(f"{prefix}the files build on each other: {chain}")
    if text is None:
        try:
            if len(above) > _MOST_BASES:
                raise OSError(0, f"more than {_MOST_BASES} files build on each other")
            text = _text_of(file)
        except (OSError, ValueError) as error:
            why = f"cannot be read: {getattr(error, 'strerror', None) or 'not UTF-8 text'}"
            why = f"no such file{near_file(file)}" if isinstance(error, FileNotFoundError) else why
            raise RigError(f"{prefix}{display_path(file)}: {why}") from None
    sources[file] = text
    parsed = _parse(file, text)
    if "base" not in parsed:
        return parsed
    own_data = PlacedMap({key: value for key, value in parsed.items() if key != "base"}, parsed.at)
    base, place = parsed["base"], parsed.at["base"]
    if not isinstance(base, str):
        raise RigError(f"{place}: base: expected the path of a file")
    try:
        named = _real_path(file.parent / base)
    except (OSError, ValueError) as error:
        raise RigError(f"{place}: base: is no file: {_reason(error)}") from None
    return _merge(_read_file(named, None, sources, (*above, file), place), own_data)


def _text_of(file: Path) -> str:
    """Return the text of a regular file; OSError, UnicodeDecodeError."""
    with open_regular(file) as stream:
        content = stream.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise OSError(0, f"more than {MOST_BYTES >> 20} MiB")
    return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


@lru_cache(maxsize=64)  # an experiment loads the same few files a thousand times
def _parse(file: Path, text: str) -> PlacedMap:
    """Return the data of a file, which nobody changes."""
    try:
        node = compose(text)
        if not isinstance(node, yaml.MappingNode):
            raise RigError(f"{Place(file)}: expected a mapping, `key: value` lines")
        return _pairs(node, file, None)
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


def _tree(node: yaml.Node, file: Path, option: Place | None) -> Any:
    """Return our data of PyYAML's nodes; `option`, else a node's position, is where it stands."""
    if isinstance(node, yaml.MappingNode):
        return _pairs(node, file, option)
    if isinstance(node, yaml.SequenceNode):
        at = {i: option or _place(item, file) for i, item in enumerate(node.value)}
        return Items((_tree(item, file, option) for item in node.value), at)
    assert isinstance(node, yaml.ScalarNode), "YAML has three kinds of nodes"
    if node.style:  # quoted, or a block
        return node.value
    try:
        return parse_scalar(node.value)
    except ValueError as error:
        raise RigError(f"{option or _place(node, file)}: {error}") from None


def _pairs(node: yaml.MappingNode, file: Path, option: Place | None) -> PlacedMap:
    pairs = PlacedMap()
    for key_node, value_node in node.value:
        place, key = option or _place(key_node, file), key_node.value
        if not isinstance(key, str) or not key:
            raise RigError(f"{place}: expected text as the key")
        if key == "<<" and not key_node.style:
            raise RigError(f"{place}: merge keys are not supported; share values with `base:`")
        if node.flow_style and ":" in key and not (key_node.style or value_node.value):
            raise RigError(f"{place}: {key}: write a blank behind the colon")
        if key in pairs:
            first = pairs.at[key]
            raise RigError(f"{place}: {key}: given twice, first at {first}; remove one of the two")
        pairs[key], pairs.at[key] = _tree(value_node, file, option), place
    return pairs


def _place(node: yaml.Node, file: Path) -> Place:
    return Place(file, node.start_mark.line + 1, node.start_mark.column + 1)


def _merge(below: PlacedMap, above: PlacedMap) -> PlacedMap:
    merged = PlacedMap()
    for key in above if below.keys() <= above.keys() else {**below, **above}:
        if key not in above:
            merged[key], merged.at[key] = below[key], below.at[key]
        elif key not in below or above[key] is not None:
            lower, value = below.get(key), above[key]
            if isinstance(lower, PlacedMap) and isinstance(value, PlacedMap):
                value = _merge(lower, value)
            merged[key], merged.at[key] = value, above.at[key]
    return merged

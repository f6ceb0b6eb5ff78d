"""Plain YAML data to typed values; what does not fit is an error at its line and column."""

import re
from types import UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from pcpc.executive.errors import did_you_mean
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.keyed import Keyed
from pcpc.executive.rig.yamlfile import Document, Keys

T = TypeVar("T")


def convert(document: Document, data: Any, kind: type[T], keys: Keys) -> T:
    """Return `data` as a `kind`; on failure descend, because msgspec does not name mapping keys.

    RigError: the data are wrong, with their place.
    """
    try:
        return msgspec.convert(_gathered(data, kind), kind)
    except msgspec.ValidationError as error:
        _raise_at_part(document, data, kind, keys)
        raise document.error(keys, _message(str(error), data)) from None


def file_keys_of(kind: type[Keyed]) -> dict[str, tuple[Any, bool]]:
    """Return the keys of a mapping in a file: the type of each, and whether it has to be there."""
    keys: dict[str, tuple[Any, bool]] = {}
    for info in msgspec.structs.fields(kind):
        if names := kind.spread.get(info.name):
            keys |= dict.fromkeys(names, (get_args(info.type)[1] | None, False))
        else:
            keys[info.encode_name] = info.type, info.required
    return keys


def as_data(keyed: Keyed) -> dict[str, Any]:
    """Return all values under the keys that they have in a file."""
    data: dict[str, Any] = {}
    for key, value in msgspec.to_builtins(keyed).items():
        data |= value if key in keyed.spread else {key: value}
    return data


def _gathered(data: Any, kind: Any) -> Any:
    """Return data whose `spread` keys are in the fields of the kind; ValidationError."""
    spread = getattr(kind, "spread", {}) if isinstance(data, dict) else {}
    for field, names in spread.items():
        if field in data:
            raise msgspec.ValidationError(field)
        entries = {name: data[name] for name in names if data.get(name) is not None}
        data = {key: value for key, value in data.items() if key not in names} | {field: entries}
    return data


def _raise_at_part(document: Document, data: Any, kind: Any, keys: Keys) -> None:
    """Raise the error of the first part of `data` that is not what `kind` says, if it is a part."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is UnionType and isinstance(data, dict | list):
        for one in arguments:
            if isinstance(data, dict) == (isinstance(one, type) and issubclass(one, Keyed)):
                _raise_at_part(document, data, one, keys)
    if isinstance(kind, type) and issubclass(kind, Keyed) and isinstance(data, dict):
        fields = file_keys_of(kind)
        for key in data:
            if key not in fields:
                known = (*getattr(kind, "carried_out", ()), *fields)
                raise document.error((*keys, key), f"unknown key{did_you_mean(key, known)}")
        for name, (below, required) in fields.items():
            if name in data:
                convert(document, data[name], below, (*keys, name))
            elif required:
                raise document.error(keys, f"key {name} is missing")
    elif origin is dict and isinstance(data, dict):
        for key, child in data.items():
            convert(document, key, arguments[0], (*keys, key))
            convert(document, child, arguments[1], (*keys, key))
    elif origin is list and isinstance(data, list):
        for index, child in enumerate(data):
            convert(document, child, arguments[0], (*keys, index))
    elif origin is tuple and isinstance(data, list) and len(data) == len(arguments):
        for index, child in enumerate(data):
            convert(document, child, arguments[index], (*keys, index))
    elif origin is Literal and isinstance(data, str):
        raise document.error(keys, f"unknown value {data}{did_you_mean(data, arguments)}")


_WORDS = {
    "float": "a number", "int": "a whole number", "str": "text", "bool": "true or false",
    "object": "a mapping", "array": "a list", "null": "null",
}  # fmt: skip


def _message(message: str, data: Any) -> str:
    """Return msgspec's message in YAML's words, with the value that came."""
    expected = re.sub(r"(, got .*)?( - at .*)?\Z", "", message)
    expected = re.sub(r"matching regex '(.*)'\Z", r"of the form \1", expected)
    expected = expected.replace("\\\\A", "").replace("\\\\Z", "")
    kinds = re.sub(r"`([a-z |]+)`", lambda found: _in_words(found[1]), expected)
    got = f"text {_shortened_line(repr(data))}" if isinstance(data, str) else _short(data)
    return f"{kinds[:1].lower()}{kinds[1:]}, got {got}"


def _in_words(kinds: str) -> str:
    return " or ".join(_WORDS.get(kind, kind) for kind in kinds.split(" | "))


def _short(data: Any) -> str:
    text = yamlfile.dump([data]).strip().removeprefix("- ") if data != {} else "{}"
    line = " ".join(text.strip("[]").split()) if not isinstance(data, list) else str(data)
    return _shortened_line(line)


def _shortened_line(line: str) -> str:
    return line if len(line) <= 40 else f"{line[:37]}..."

"""Values from Python as the command line's NAME=VALUE takes them."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_SIMPLE_LETTERS = 1000


def settings(
    values: Mapping[str, Any] | None, seed: int | None = None, standby: Sequence[str] = ()
) -> list[str]:
    """Return NAME=VALUE for each; TypeError, ValueError for what no rig file can hold."""
    given = dict(values or {}) | ({} if seed is None else {"seed": seed})
    given |= {"standby": list(standby)} if standby else {}
    return [f"{name}={_text(name, value)}" for name, value in given.items()]


def _text(name: str, value: Any) -> str:
    """Return a value as YAML in one line, floats to the last bit."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, str):
        return _quoted_text(value)
    if value is None or isinstance(value, bool | int):
        return json.dumps(value)
    if isinstance(value, float):
        if math.isnan(value):
            raise ValueError(f"{name}: nan is no value")
        return repr(value) if math.isfinite(value) else f"{'-' * (value < 0)}.inf"
    if isinstance(value, Mapping):
        inside = (f"{_key(str(key))}: {_text(name, one)}" for key, one in value.items())
        return f"{{{', '.join(inside)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_text(name, one) for one in value)}]"
    raise TypeError(f"{name}: a rig holds no {type(value).__name__}")


def _key(text: str) -> str:
    """Return a key; YAML wants a mark before one of more than 1024 letters."""
    quoted = _quoted_text(text)
    return f"? {quoted} " if len(quoted) > _SIMPLE_LETTERS else quoted


def _quoted_text(text: str) -> str:
    """Return a text in YAML's double quotes, in printable ASCII."""
    plain = (c if " " <= c <= "~" and c not in '"\\' else f"\\U{ord(c):08x}" for c in text)
    return f'"{"".join(plain)}"'

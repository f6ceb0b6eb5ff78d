"""`segments`, a list, for `law: profiles:sequence`: each becomes three numbered parameters.

segments:
  - {over_s: 0.5}                            hold what was before
  - {to: 0.2, by: quintic, over_s: 1.5}      step, line, quintic
"""

from typing import Any, Literal

from pcpc.executive.rig.conversion import convert
from pcpc.executive.rig.keyed import Keyed
from pcpc.executive.rig.roles import ROLES
from pcpc.executive.rig.yamlfile import Document, Keys

LAW = "profiles:sequence"
KEY = "segments"
_SHAPES = {"hold": 0, "step": 1, "line": 2, "quintic": 3}  # as `laws.profiles` numbers them
_MOST = 16


class Segment(Keyed):
    """From where the one before ended to `to`; without that, it holds."""

    over_s: float
    to: float | None = None
    by: Literal["hold", "step", "line", "quintic"] = "hold"


def expand_segments(document: Document) -> None:
    """Turn the segments of every block into parameters; RigError."""
    for role in ROLES:
        node = document.data.get(role)
        blocks = node.get("blocks") if isinstance(node, dict) else None
        for name, entry in blocks.items() if isinstance(blocks, dict) else ():
            if isinstance(entry, dict) and KEY in entry:
                _expand(document, (role, "blocks", name), entry)


def _expand(document: Document, keys: Keys, entry: dict[str, Any]) -> None:
    at, law, given = (*keys, KEY), entry.get("law"), entry.pop(KEY)
    if given is None:  # by a rig over its base
        return
    if law != LAW:
        raise document.error(at, f"only `law: {LAW}` takes segments, got {law}")
    found = convert(document, given, list[Segment], at)
    if not 1 <= len(found) <= _MOST:
        what = f"{len(found)} segments, expected 1 to {_MOST}; more: law: table (docs/rig.md)"
        raise document.error(at, what)
    parameters = entry.setdefault("parameters", {})
    if not isinstance(parameters, dict):
        return  # refused with all other keys
    for number, one in enumerate(found, 1):
        here = (*at, number - 1)
        if (one.to is None) != (one.by == "hold"):
            what = "`to: VALUE` goes with `by: step`, `line` or `quintic`; neither of them: hold"
            raise document.error(here, what)
        if not 0.0 <= one.over_s <= 1e6:
            raise document.error((*here, "over_s"), f"{one.over_s:g} is outside 0..1e+06 s")
        if one.over_s == 0.0 and one.by in ("line", "quintic"):
            raise document.error((*here, "over_s"), f"a {one.by} takes time; 0 s is `by: step`")
        values = {"to": one.to or 0.0, "over": one.over_s, "shape": float(_SHAPES[one.by])}
        for what, value in values.items():
            name = f"{what}_{number}_s" if what == "over" else f"{what}_{number}"
            if name in parameters:
                place = (*keys, "parameters", name)
                raise document.error(place, f"segment {number} gives it; change that one")
            key = "over_s" if what == "over" else what
            place = (*here, key) if (*here, key) in document.places else here
            document.put((*keys, "parameters", name), value, document.place(place))

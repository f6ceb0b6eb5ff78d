"""`segments`, a list, for `law: profiles:sequence`: each becomes three numbered parameters.

segments:
  - {over_s: 0.5}                            hold what was before
  - {to: 0.2, by: quintic, over_s: 1.5}      step, line, quintic
"""

from typing import Literal

from pcpc.executive.rig.conversion import convert
from pcpc.executive.rig.keyed import Keyed
from pcpc.executive.rig.placed import PlacedMap
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
            if isinstance(entry, PlacedMap) and KEY in entry:
                _expand(document, (role, "blocks", name), entry)


def _expand(document: Document, keys: Keys, entry: PlacedMap) -> None:
    its_keys, law, listed = (*keys, KEY), entry.get("law"), entry[KEY]
    if listed is not None:  # null: by a rig over its base
        if law != LAW:
            raise document.error(its_keys, f"only `law: {LAW}` takes segments, got {law}")
        segments = convert(document, listed, list[Segment], its_keys)
        if not 1 <= len(segments) <= _MOST:
            problem = (
                f"{len(segments)} segments, expected 1 to {_MOST}; more: law: table (docs/rig.md)"
            )
            raise document.error(its_keys, problem)
        parameters = entry.setdefault("parameters", PlacedMap())
        for number, segment in enumerate(segments, 1):
            if isinstance(parameters, PlacedMap):  # else refused with all other keys
                _put_parameters(document, keys, parameters, number, segment)
    del entry[KEY]


def _put_parameters(
    document: Document, keys: Keys, parameters: PlacedMap, number: int, segment: Segment
) -> None:
    """Put what a segment says into the parameters of its block; RigError."""
    its_keys = (*keys, KEY, number - 1)
    if (segment.to is None) != (segment.by == "hold"):
        what = "`to: VALUE` goes with `by: step`, `line` or `quintic`; neither of them: hold"
        raise document.error(its_keys, what)
    if not 0.0 <= segment.over_s <= 1e6:
        raise document.error((*its_keys, "over_s"), f"{segment.over_s:g} is outside 0..1e+06 s")
    if segment.over_s == 0.0 and segment.by in ("line", "quintic"):
        raise document.error((*its_keys, "over_s"), f"a {segment.by} takes time; 0 s is `by: step`")
    for name, key, value in (
        (f"to_{number}", "to", segment.to or 0.0),
        (f"over_{number}_s", "over_s", segment.over_s),
        (f"shape_{number}", "shape", float(_SHAPES[segment.by])),
    ):
        if name in parameters:
            at = (*keys, "parameters", name)
            raise document.error(at, f"segment {number} gives it; change that one")
        parameters[name], parameters.at[name] = value, document.place((*its_keys, key))

"""Controllers and plants that are like others: each number stands in one place of a rig file.

    controllers:
      pd:      {law: pd, parameters: {kv_Nms_rad: 110.0, lam_per_s: 16.0}}
      pd_star: {like: pd, parameters: {lam_per_s: 20.0}}
      pd_nn:   {like: pd, law: pd_nn, parameters: {kappa: 0.01}}
      both:    {like: [pd_nn, pd_fast], law: pd_nn_fast}
    plant_2: {like: plant, node: AXIS_2, drive: {node: 6}}

What the entry itself gives rules, then the last name of a list, then the one before it; null takes
a key away. The names mean the entries as they are after all `base:` files. What is taken over keeps
the place where it was written, for messages.
"""

from typing import Any

from pcpc.executive.rig.placed import PlacedMap
from pcpc.executive.rig.roles import PLANTS
from pcpc.executive.rig.yamlfile import Document, Keys

_SECTION = "controllers"


def inherit_entries(document: Document) -> None:
    """Carry out every `like` in the document's controllers and plants; RigError with its place."""
    controllers = document.data.get(_SECTION)
    if isinstance(controllers, dict):
        for name in controllers:
            _inherit(document, controllers, (_SECTION,), name, ())
    plants: dict[str, Any] = {role: document.data[role] for role in PLANTS if role in document.data}
    for role in plants:
        _inherit(document, plants, (), role, ())


def _inherit(
    document: Document, entries: dict[str, Any], section: Keys, name: str, above: tuple[str, ...]
) -> None:
    entry, keys = entries[name], (*section, name, "like")
    if not isinstance(entry, PlacedMap) or "like" not in entry:
        return
    kind = "controller" if section else "plant"
    likes = entry["like"] if isinstance(entry["like"], list) else [entry["like"]]
    for other in likes:
        if not isinstance(other, str):
            expected = f"expected the name of a {kind}, or a list of names, got {other!r}"
            raise document.error(keys, expected)
        if other in (*above, name):
            chain = " -> ".join((*above, name, other))
            raise document.error(keys, f"the {kind}s build on each other: {chain}")
        document.known(keys, other, entries, kind)
        _inherit(document, entries, section, other, (*above, name))
    del entry["like"]
    for other in reversed(likes):
        if isinstance(entries[other], PlacedMap):
            _copy_absent(entry, entries[other])
    _drop_nulls(entry)


def _copy_absent(mine: PlacedMap, theirs: PlacedMap) -> None:
    """Copy what `mine` lacks from `theirs`, with its places."""
    for key, value in theirs.items():
        if key not in mine:
            mine.take(key, theirs)
        elif isinstance(mine[key], PlacedMap) and isinstance(value, PlacedMap):
            _copy_absent(mine[key], value)


def _drop_nulls(entry: dict[str, Any]) -> None:
    for key in [key for key, value in entry.items() if value is None]:
        del entry[key]
    for value in entry.values():
        if isinstance(value, dict):
            _drop_nulls(value)

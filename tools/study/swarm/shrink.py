"""A world made as small as it can be: fewer features, nodes, cycles, the same promise broken."""

import copy
import json
import re
from collections.abc import Callable, Iterator
from typing import Any

from pcpc.tools.study.swarm.files import World

_LEAST_CYCLES, _MOST_TRIES = 20, 120


def smallest(world: World, still_broken: Callable[[World], bool]) -> World:
    """Return the world without all that is not needed; what breaks it no more is put back."""
    tries, changed = 0, True
    while changed:
        changed = False
        for smaller in _smaller(world):
            tries += 1
            if tries > _MOST_TRIES:
                return world
            if still_broken(smaller):
                world, changed = smaller, True
                break
    return world


def _smaller(world: World) -> Iterator[World]:
    """Yield worlds that lack one thing, the largest first."""
    for i in range(1, len(world["plants"]) + 1 if world["plants"][1:] else 0):
        yield _without_plant(world, i)
    for key in ("faults", "losses", "schedule", "bus", "plausible", "limits", "require", "errors",
                "overrun", "standby", "handover", "supervisor"):  # fmt: skip
        place = world["keys"]
        place = place if key in place else place.get("executive", {})
        if key in place:
            yield _changed(world, place is not world["keys"], key, None)
            if len(place[key]) > 1:
                for part in place[key] if isinstance(place[key], dict) else range(len(place[key])):
                    yield _changed(world, place is not world["keys"], key, part)
    for act in world.get("acts", ()):
        yield world | {"acts": [one for one in world["acts"] if one is not act]}
    if world["cycles"] > _LEAST_CYCLES:
        for share in (2, 4):
            smaller = copy.deepcopy(world)
            smaller["cycles"] -= max(world["cycles"] // share, 1)
            if smaller["cycles"] >= _LEAST_CYCLES:
                yield smaller


def _without_plant(world: World, i: int) -> World:
    """Return the world without plant `i`, and what names it; later ones count one less."""
    smaller = copy.deepcopy(world)
    del smaller["plants"][i - 1]
    own = re.compile(rf"\b(CMD|FB)_{i}\b|\bplant{f'_{i}' if i > 1 else ''}\b")
    keys = smaller["keys"]
    for of in (keys, keys.get("executive", {})):
        for name in ("faults", "losses", "limits", "plausible"):
            named = of.get(name, {})
            kept = {k: v for k, v in named.items() if not own.search(json.dumps({k: v}))}
            of |= {name: kept} if kept else {}
            if not kept:
                of.pop(name, None)
    text = json.dumps(keys)
    for j in range(i + 1, len(world["plants"]) + 1):
        text = re.sub(rf"\b(CMD|FB)_{j}\b", rf"\g<1>_{j - 1}", text)
        text = re.sub(rf"\bplant_{j}\b", "plant" if j == 2 else f"plant_{j - 1}", text)
    smaller["keys"] = json.loads(text)
    return smaller


def _changed(world: World, of_executive: bool, key: str, part: Any) -> World:
    """Return the world without a key, or without a part of it."""
    smaller = copy.deepcopy(world)
    place = smaller["keys"]["executive"] if of_executive else smaller["keys"]
    if part is None:
        del place[key]
    else:
        del place[key][part]
    return smaller

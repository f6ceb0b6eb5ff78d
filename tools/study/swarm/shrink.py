"""A world made as small as it can be: fewer features, nodes, cycles, the same promise broken."""

import copy
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
    for count in range(1, len(world["plants"])):
        yield _without_plants(world, count)
    for key in ("faults", "losses", "schedule", "bus", "plausible", "limits", "require", "errors",
                "overrun", "standby", "handover", "supervisor"):  # fmt: skip
        place = world["keys"]
        place = place if key in place else place.get("executive", {})
        if key in place:
            yield _changed(world, place is not world["keys"], key, None)
            if len(place[key]) > 1:
                for part in place[key] if isinstance(place[key], dict) else range(len(place[key])):
                    yield _changed(world, place is not world["keys"], key, part)
    if world["cycles"] > _LEAST_CYCLES:
        for share in (2, 4):
            smaller = copy.deepcopy(world)
            smaller["cycles"] -= max(world["cycles"] // share, 1)
            if smaller["cycles"] >= _LEAST_CYCLES:
                yield smaller


def _without_plants(world: World, count: int) -> World:
    smaller = copy.deepcopy(world)
    smaller["plants"] = smaller["plants"][:count]
    limits = smaller["keys"].get("executive", {})
    for of in limits.values():
        for name in [one for one in of if int(one.partition(".")[0].split("_")[1]) > count]:
            del of[name]
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

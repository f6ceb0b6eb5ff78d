"""What happens to a drawn rig: faults, what its user does, frames of another sender."""

import math
from collections.abc import Sequence
from typing import Any

from pcpc.executive.loop.fault_kinds import WrongFrame, WrongNode, WrongValue
from pcpc.tools.study.swarm.features import KINDS, ODD, Drawing
from pcpc.tools.study.swarm.files import TUNABLE, World

_FAULT_KEYS = ("kind", "at", "frame", "node", "data_of", "how", "goes_on", "value", "share",
               "burst", "from", "for", "every", "times", "x")  # fmt: skip
_ODD_VALUES: tuple[Any, ...] = (
               None, True, [], {}, "", "x", "loss", "FB_1", "plant", "freeze", "0s", "-1ms",
               "999999999min", 0, -1, 1, 3.5, 2**64, -(2**63), 5e-324, 1e300, float("nan"),
               float("inf"))  # fmt: skip
_AGAIN = {"supervisor.disarmed": 0.0}, {"supervisor.reset": 1.0}


def acts(d: Drawing, world: World) -> None:
    """Draw what is done from outside: an end, requests, of which some are refused, frames."""
    drawn: list[World] = [{"stop": 1}] * d.has(0.1, "end asked")
    for _ in range(d.one(1, 1, 3) * d.has(0.15, "request")):
        values = d.near(0.1, 5.0), d.one(1.0, -3.0, 1e9)
        asked = dict(zip(d.one(TUNABLE, TUNABLE, ("time.t_s", *TUNABLE)), values, strict=False))
        drawn.append({"set": asked})
    if d.has(0.06, "second sender"):
        drawn.append({"send": d.one(1, 2, 3, 5), "node": d.one("executive", "plant")})
    if drawn:  # which wait for the end of a piece: as long as a keyframe's
        world["every"] = math.ceil(max(0.1 * world["rate_hz"], world["cycles"] / 60))
        world["keys"]["record"] = {"keyframe": ms(world, world["every"])}
    last = max(world["cycles"] - world["every"], 1)
    cycles = sorted(d.random.randint(1, last) for _ in drawn)
    drawn = d.random.sample(drawn, len(drawn))
    world["acts"] = [{"cycle": at} | act for at, act in zip(cycles, drawn, strict=True)]


def faults(
    d: Drawing, world: World, keys: World, protected: dict[str, bool], places: list[str],
    roles: Sequence[str],
) -> None:  # fmt: skip
    """Draw faults: of `protected` frames or others, of values at `places`, of nodes."""
    if not d.has(0.65, "faults"):
        return
    frames = [one for one in KINDS if one.startswith("frame")]
    features = [one for one in KINDS if one in d.sure]
    features += d.random.choices((*KINDS, *frames), k=d.random.randint(1, 4))
    found: World = {}
    for i, feature in enumerate(features):
        kind: Any = KINDS[feature]
        names = [one for one in protected if protected[one] or not kind.row.protected]
        if not names:
            continue
        name = d.one(*names)
        if kind is WrongNode.STALL and len(roles) > 2:
            continue
        entry: World = {"kind": kind.word}
        if isinstance(kind, WrongValue):
            entry |= {"at": d.one(*places), "value": d.near(0.01, 5.0)}
        elif isinstance(kind, WrongFrame):
            entry["frame"] = name
            entry["value"] = d.random.randint(1, 8)
        else:
            entry["node"] = d.one(*roles)
            entry["value"] = d.random.randint(1, 40)
        if not kind.row.sized:
            entry.pop("value", None)
        if kind.row.hows:
            entry["how"] = d.one(*kind.row.hows)
            if entry["how"] in ("freeze", "random"):
                entry.pop("value", None)
        if kind.row.copies:
            entry["data_of"] = name
        if d.has(0.4, "share of a fault") and not isinstance(kind, WrongNode):
            entry["share"] = d.near(0.05, 0.9)
            entry["burst"] = d.one(1, 2, 5)
        entry |= _moments(d, world)
        if world["plants"] and d.has(0.08, ODD):
            for key in d.random.sample(_FAULT_KEYS, d.one(1, 1, 2)):
                if d.random.random() < 0.5:
                    entry.pop(key, None)
                else:
                    words = (one.word for one in KINDS.values())
                    entry[key] = d.one(*_ODD_VALUES, *places, *protected, *words, "5ms", "20ms")
        d.features.append(feature)
        found[f"f{i}"] = entry
    keys["faults"] = found


def _moments(d: Drawing, world: World) -> World:
    """Return when a fault acts, in whole cycles."""
    cycles = world["cycles"]
    begin, most = _moment(d, world, max(cycles - 20, 2)), d.one(1, 3, 12, 60)
    found = {"from": ms(world, begin), "for": ms(world, d.random.randint(1, most))}
    if d.has(0.15, "fault again"):
        seldom = cycles // 200  # of some faults: a node's schedule holds 1,024 beginnings and ends
        found["every"] = ms(world, seldom + d.random.randint(most + 2, 200 + most))
    return found


def _moment(d: Drawing, world: World, last: int) -> int:
    """Return a cycle from 1 to the last; often one at a keyframe, where a replay has a seam."""
    cycle = d.random.randint(1, last)
    if d.random.random() < 0.4:
        cycle += world["every"] - 1 - cycle % world["every"] + d.one(-1, 0, 0, 1)
    return min(cycle, last)


def ms(world: World, cycles: int) -> str:
    """Return so many cycles as a rig says a time."""
    return f"{1e3 * cycles / world['rate_hz']:.9g}ms"


def schedule(d: Drawing, world: World, keys: World, known: dict[str, tuple[float, float]]) -> None:
    """Draw what an operator does; `known`: what may be tuned, and between which values."""
    period_s = 1.0 / world["rate_hz"]
    rows: list[World] = []
    free = world["plants"] and "fallback" not in keys.get("overrun", {})
    if free and d.has(0.25, "standby"):
        keys["standby"] = ["second"]
        keys["handover"] = {"over_s": d.near(0.0, 0.1)}
        for name in ("second", "first")[: d.random.randint(1, 2)]:
            rows.append({"handover": name})
    for _ in range(max(d.random.randint(0, 3), "tuning" in d.sure)):
        if known and d.has(0.6, "tuning"):
            name = d.one(*known)
            rows.append({"set": {name: d.random.uniform(*sorted(known[name]))}})
    for name, value, share, *causes in (
        ("disarmed", 1.0, 0.15), ("disarmed", 0.0, 0.1, "disarmed 1", "armed by hand"),
        ("reset", 1.0, 0.1, "waits in FAULT"), ("stop", 1.0, 0.12), ("stop", 2.0, 0.06),
    ):  # fmt: skip
        share = 0.7 if not {*causes}.isdisjoint(d.features) else share
        if d.has(share, f"{name} {value:g}"):
            rows += [{"set": {f"supervisor.{name}": value}}] * d.one(1, *[3] * bool(causes))
    last = world["cycles"] // d.one(1, 2, 3) - 1  # which leaves time for a ramp
    times = sorted(_moment(d, world, last) for _ in rows)
    rows = d.random.sample(rows, len(rows))
    if d.random.random() < 0.7:  # commands rise again at the end
        rows.sort(key=lambda row: row.get("set", {}) in _AGAIN)
    found = [{"at_s": at * period_s, **row} for at, row in zip(times, rows, strict=True)]
    if found:
        keys["schedule"] = found

"""A world is drawn from a seed: rig, history, and at which places of it promises are checked.

`world["features"]` names what was drawn, for the table of pairs. What is drawn is allowed by the
rig file; a share of worlds is made wrong in one place, see WRONG.
"""

import math
from typing import Any

from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.study.swarm.expressions import SHAPES
from pcpc.tools.study.swarm.features import RATES_HZ, REFERENCES, SLOW_MS, Drawing
from pcpc.tools.study.swarm.files import (
    DRIVES,
    SPAN,
    WORDS,
    World,
    bits_of,
    frames_of,
    nodes,
)
from pcpc.tools.study.swarm.histories import acts, faults, ms, schedule

MOST_CYCLES, WRONG_SHARE, MANY_SHARE, PLAIN_SHARE = 600, 0.05, 0.01, 0.25
TIMES = *[1] * 11, 4, 4, 12, 60, 60  # as many: most histories are short, some long
PLACES = "branch", "keyframe", "cut", "flip", "sample"  # of promises, each a share of the run
_LENGTHS = 8, 8, 8, 12, 16, 24, 32, 48, 64
WRONG: dict[str, tuple[tuple[Any, ...], Any]] = {  # what is wrong: where, and by what
    "rate": (("rate_hz",), -5),
    "word": (("supervizor",), {}),
    "controller": (("controller",), "third"),
    "variable": (("executive", "transmit", "CMD_1.command"), "controller.comand"),
    "signal": (("executive", "transmit", "CMD_1.kommand"), "controller.command"),
    "file": (("dbc",), "none.dbc"),
    "gain": (("controllers", "first", "parameters", "first"), 1e9),
    "law": (("controllers", "first", "law"), "law_none.py:BLOCK"),
    "hold": (("supervisor",), {"hold_cycles": 0}),
    "fault": (("faults",), {"x": {"kind": "los", "frame": "FB_1"}}),
    "safe": (("plant", "safe"), {"CMD_1.none": 0.0}),
    "limit": (("executive", "limits"), {"CMD_1.command": {"low": 1.0, "high": -1.0}}),
}


def world_of(seed: int, base: str | None = None) -> World:
    """Return the world of a seed; around a rig, if one is its `base`. RigError."""
    d = Drawing(seed)
    world: World = {"seed": seed, "around": base, "wrong": []}
    keys: World = {"seed": d.random.randint(1, 10**6)}
    world["keys"] = keys
    if base is None:
        _drawn(d, world, keys)
    else:
        _around(d, world, keys, load_rig(base))
    world["at"] = {name: d.random.random() for name in PLACES}
    if keys.get("schedule") and d.random.random() < 0.5:  # a branch beside what is tuned
        cycle = round(d.one(*keys["schedule"])["at_s"] * world["rate_hz"]) + d.one(-1, 0, 1, 2, 2)
        world["at"]["branch"] = min(max((cycle - 0.5) / (world["cycles"] - 3), 0.0), 0.999)
    world["features"] = [*dict.fromkeys([*d.features, f"{world['rate_hz']:g} Hz"])]
    return world


def _drawn(d: Drawing, world: World, keys: World) -> None:
    """Draw a rig of lags, each behind its own frames."""
    world["rate_hz"] = d.named("{:g} Hz", *RATES_HZ)
    world["cycles"] = d.random.randint(100, MOST_CYCLES) * d.one(*TIMES)
    d.span_s = min(1.0, world["cycles"] / world["rate_hz"])
    world["slow_ms"] = d.named("slow frames each {} ms", *SLOW_MS)  # between two heartbeats
    d.features.append(f"slow frames each {world['slow_ms']} ms")
    _keyframes(d, world, keys)
    if d.has(MANY_SHARE, "many plants"):
        count = d.one(5, 5, 5, 16)
    else:
        count = 1 if d.has(0.6, "one plant") else d.random.randint(2, 3)
    world["cycles"] //= 4 if count > 3 else 1
    if d.has(PLAIN_SHARE, "plain"):  # most of what follows keeps a rig from lanes
        d.often = 0.15
    world["plants"] = [_plant(d, count < 9) for _ in range(count)]  # a node has 32 frames
    _supervision(d, world, keys)
    _values(d, world, keys)
    _bus(d, world, keys)
    protected = {name: frame["crc"] > 0 for name, _, frame, *_ in frames_of(world)}
    places = ["controller.position"]
    for role, i in nodes(world).items():
        places += [f"tx.CMD_{i}.command", f"{role}:tx.FB_{i}.position", f"{role}:lag.command"]
    acts(d, world)
    faults(d, world, keys, protected, places, ("executive", *nodes(world)))
    schedule(d, world, keys, {"controller.first": (0.1, 5.0), "controller.second": (-5.0, 5.0)})
    if d.has(WRONG_SHARE, "wrong rig"):
        world["wrong"] = [[list(path), value] for path, value in [d.one(*WRONG.values())]]


def _keyframes(d: Drawing, world: World, keys: World) -> None:
    """Draw how often there is one: not below 0.1 s."""
    rate_hz, many = world["rate_hz"], d.one(1, 1, 1, min(world["cycles"] // 300 + 1, 10))
    cycles = d.random.randint(10, 300) * (world["cycles"] // 300 + 1) // many
    world["every"] = max(cycles, math.ceil(0.1 * rate_hz))
    keys["record"] = {"keyframe": ms(world, world["every"])}


def _around(d: Drawing, world: World, keys: World, rig: Rig) -> None:
    """Draw what happens to a rig that is there: faults, losses, tunings, an early end."""
    cycles = round(rig.config.duration_s * rig.config.rate_hz)
    world |= {"rate_hz": rig.config.rate_hz, "plants": []}
    world["cycles"] = min(cycles, d.random.randint(150, MOST_CYCLES))
    _keyframes(d, world, keys)
    plans = [plan(rig, role, "virtual") for role in rig.roles]
    awaited = [one for made in plans for one in made.rx_frames if messages.is_awaited(one)]
    top = plans[0]
    places = [one.name for one in top.table.variables if one.kind == "input"]
    known = {
        one.name: (top.values[place] * 0.8, top.values[place] * 1.25)
        for one in top.table.variables
        if one.kind == "parameter" and one.name.startswith("controller.")
        for place in [top.table.index[one.name]]
        if one.low <= 0.8 * top.values.get(place, 0.0)
        and 1.25 * top.values.get(place, 0.0) <= one.high
    }
    protected = {one.name: one.protected for one in awaited}
    faults(d, world, keys, protected, places, rig.roles)
    if not rig.config.schedule:
        schedule(d, world, keys, known)


# Plants and their frames


def _plant(d: Drawing, few: bool) -> World:
    reference = d.named("{}", *REFERENCES)
    d.features.append(reference)
    layouts = d.random.randint(2, 4) if d.has(0.15, "multiplexer") else 0
    presses = d.has(0.08, "emergency stop")
    large = d.near(-20.0, 20.0)
    gains = [{"first": d.near(0.1, 5.0), "second": d.near(-5.0, 5.0)} for _ in range(2)]
    return {
        "shape": d.random.randrange(SHAPES), "gains": gains[0], "others": gains[1],
        "tau_s": max(d.time_s(0.01, 0.5), 1e-3), "safe": d.one(0.0, 0.0, d.near(-2.0, 2.0)),
        "large": large,
        "reference": _reference(d, reference.removeprefix("reference "), large),
        "command": _frame(d, ["command"], True, 0),
        "back": _frame(d, ["position", "other"][: d.random.randint(1, 2)], False, layouts, presses),
        "press_s": d.time_s(0.01, 2.0) if presses else 1e6,
        "slow": few and d.has(0.3, "slow frame")
        and _frame(d, ["slow"], False, 0) | {"ms": d.one(*SLOW_MS)},
    }  # fmt: skip


def _reference(d: Drawing, name: str, large: float) -> World:
    given: dict[str, dict[str, float]] = {
        "step": {"amplitude": large, "start_s": d.time_s(0.0, 0.2)},
        "ramp": {"slope": large / d.span_s, "end_s": d.time_s(0.1, 2.0)},
        "sine": {"amplitude": large, "frequency_hz": d.near(0.5, 20.0)},
        "chirp": {"amplitude": large, "from_hz": 0.5, "to_hz": d.near(1.0, 30.0), "sweep_s": 1.0},
        "quintic": {"amplitude": large, "move_s": d.time_s(0.05, 0.5)},
    }
    if name != "sequence":
        return {"law": f"profiles:{name}", "parameters": given[name]}
    over_s = 0.05 * d.span_s
    ways = [{"to": d.near(-9, 9), "by": d.one("step", "line", "quintic"), "over_s": over_s}]
    segments = [
        *ways,
        {"over_s": d.time_s(0.01, 0.1)},
        {"to": large, "by": "line", "over_s": over_s},
    ]
    return {"law": "profiles:sequence", "parameters": {"repeat": 1}, "segments": segments}


def _frame(
    d: Drawing, names: list[str], downwards: bool, layouts: int, presses: bool = False
) -> World:
    """Return a frame whose signals lie where they may, drawn until all have found a place."""
    protection = d.named("{}", "no E2E", "CRC 8", "CRC 8", "CRC 8", "CRC 16")
    d.features.append(protection)
    crc = 0 if protection == "no E2E" else int(protection.removeprefix("CRC "))
    fd, most = d.has(0.25, "FD"), 32  # bits of a value: fewer where there was no room
    while True:
        length = d.one(*_LENGTHS) if fd else 8
        signals: World = {}
        used: set[int] = set()
        if crc == 8:
            signals["counter"] = _signal(8 * length - 16 + d.one(0, 4), 4, whole=True)
            signals["crc"] = _signal(8 * length - 8, 8, whole=True)
        elif crc:
            first = 8 * d.random.randint(0, length - 3)
            signals["crc"] = _signal(first, 16, whole=True)
            signals["counter"] = _signal(first + 16, 8, whole=True)
        for one in signals.values():
            used |= {*bits_of(one)}
        if crc:  # the whole byte of a counter is its own
            used |= {8 * (signals["counter"]["start"] // 8) + bit for bit in range(8)}
        if downwards:
            signals["mode"] = _placed(d, used, length, 4, "unsigned", whole=True)
        if presses:
            signals["estop"] = _placed(d, used, length, 1, "unsigned", whole=True)
        if layouts:
            signals["which"] = _placed(d, used, length, 4, "unsigned", whole=True, layout=-1)
        kinds = "signed", "signed", "unsigned", *["float"] * (most == 32)
        signals |= {
            name: _placed(d, used, length, d.random.randint(10, most), d.one(*kinds))
            for name in names
        }
        for i in range(layouts):
            own = set(used)
            bits = d.random.randint(8, min(most, 16))
            signals[f"part_{i}"] = _placed(d, own, length, bits, d.one(*kinds), layout=i)
        if all(signals.values()):
            break
        most = max(most - 4, 10)
    d.features += ["big endian"] * any(one["big"] for one in signals.values())
    d.features += ["float"] * any(one["kind"] == "float" for one in signals.values())
    return {"length": length, "fd": fd, "signals": signals, "crc": crc}


def _signal(start: int, bits: int, kind: str = "unsigned", **more: Any) -> World:
    about = {"start": start, "bits": bits, "kind": kind, "big": False, "whole": False}
    return about | {"layout": None} | more


def _placed(d: Drawing, used: set[int], length: int, bits: int, kind: str, **more: Any) -> World:
    """Return a signal of free bits, which are then used; {} if there are none."""
    bits, big = 32 if kind == "float" else bits, d.has(0.3)
    for start in d.random.sample(range(8 * length), 8 * length):
        one = _signal(start, bits, kind, big=big, **more)
        its = {*bits_of(one)}
        whole = max(its) < 8 * length and max(its) // 8 - min(its) // 8 < 8
        if whole and not its & used:
            used |= its
            return one
    return {}


# What the rig makes of frames and values


def _supervision(d: Drawing, world: World, keys: World) -> None:
    hold = d.random.randint(2, 8)
    found: World = {"hold_cycles": hold, "fault_after_cycles": hold + d.random.randint(0, 12)}
    found["ramp_s"] = d.near(0.002, 0.08)
    if d.has(0.3, "waits in FAULT"):
        found["on_fault"] = "wait"
    if d.has(0.3, "intrusion limits"):
        found["intrusion"] = d.one("hold", "fault")
    if d.has(0.2, "quick stop"):
        found["quick_stop_s"] = d.near(0.002, 0.02)
    if d.has(0.08, "armed by hand"):
        found["arm"] = "manual"
    if "estop" in world["plants"][0]["back"]["signals"]:
        found["estop"] = "FB_1.estop"
    keys["supervisor"] = found
    if d.has(0.2, "overrun policy"):
        keys["overrun"] = d.one({"fault_after": 2}, {"fallback": "second"})


def _values(d: Drawing, world: World, keys: World) -> None:
    limits, plausible = {}, {}
    for i in range(1, len(world["plants"]) + 1):
        if d.has(0.6, "limits"):
            full = d.near(*d.one((0.3, 3.0), (2.5, 30.0)))
            limits[f"CMD_{i}.command"] = {"low": -full, "high": full}
            if d.has(0.5, "rate limit"):
                share = d.near(*d.one((0.003, 0.03), (0.03, 0.5)))  # of the way, in a cycle
                limits[f"CMD_{i}.command"]["rate_per_s"] = share * full * world["rate_hz"]
        if d.has(0.25, "plausibility"):
            full = d.near(5.0, SPAN)
            if d.random.random() < 0.7:  # near what it comes to, without limits
                one, gain = world["plants"][i - 1], world["plants"][i - 1]["gains"]["first"]
                full = max(abs(one["large"]) * gain / (1.0 + gain) / d.near(0.95, 1.15), 0.1)
            plausible[f"FB_{i}.position"] = {"low": -full, "high": full}
            if d.has(0.4):
                plausible[f"FB_{i}.position"]["rate_per_s"] = d.near(100.0, 1e5)
            if d.has(0.4):
                plausible[f"FB_{i}.position"]["fault_after"] = d.random.randint(2, 30)
    keys["executive"] = {"limits": limits, "plausible": plausible}
    if d.has(0.4, "requirement"):
        at_most = d.near(0.5, 60.0)
        keys["require"] = [{"always": f"abs(rx.FB_1.position) < {at_most!r}"}]
    if d.has(0.2, "errors allowed"):
        keys["errors"] = {"crc": 10**6, "repeated": 10**6, "wrong_sequence": 10**6}


def _bus(d: Drawing, world: World, keys: World) -> None:
    with_fd = any(frame["fd"] for _, _, frame, *_ in frames_of(world))
    if len(world["plants"]) == 1 and world["rate_hz"] <= 1000 and d.has(0.2, "line"):
        keys["bus"] = {"bitrate": 1000000, "emulate": "1M", "queue": d.random.randint(4, 64)}
        if d.has(0.6, "bit errors"):
            keys["bus"]["bit_error_rate"] = d.one(1e-5, 1e-4, 1e-3)
            keys["bus"]["error_burst"] = d.one(1, 3)
    elif len(world["plants"]) == 1 and d.has(0.06, "drive"):
        _drive(d, world, keys)
    if with_fd and "bus" in keys:
        keys["bus"]["data_bitrate"] = 5000000
    if d.has(0.2, "losses"):
        frame = d.one("CMD_1", "FB_1")
        keys["losses"] = {frame: {"share": d.near(0.01, 0.3), "burst": d.one(1, 2, 4)}}


def _drive(d: Drawing, world: World, keys: World) -> None:
    """Draw a drive between the first plant and its command, and what its master says."""
    profile = d.one(*DRIVES)
    words = [d.random.getrandbits(16) for _ in WORDS]
    keys["bus"] = {"bitrate": 1000000} | keys.get("bus", {})
    world["drive"] = {
        "profile": profile, "on": d.one(DRIVES[profile][1], DRIVES[profile][1], words),
        "on_s": d.near(0.0, 1.0), "hold_s": d.near(0.0, 0.1), "seed": d.near(0.0, 9.0),
    }  # fmt: skip

"""What contradicts itself between the keys of a rig, and what no key may hold.

Each part yields paths and what is wrong there; the first one is the error.
"""

import math
import re
from collections.abc import Iterator
from itertools import chain
from typing import Any

import msgspec

from pcpc.drivers.machine import outside
from pcpc.executive.errors import did_you_mean
from pcpc.executive.own_laws.modules import project_file
from pcpc.executive.rig import standby, tables
from pcpc.executive.rig.bus_keys import PROFILES
from pcpc.executive.rig.conversion import as_data, convert, file_keys_of
from pcpc.executive.rig.effective import file_keys, value_at
from pcpc.executive.rig.file_laws import FILE_LAWS
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.executive.rig.schema import FALLBACK, Config, Evaluation, Expected
from pcpc.executive.rig.yamlfile import Document, Keys

Problems = Iterator[tuple[Keys, str]]

_STEERS = re.compile(  # a terminal, or the direction of writing
    "[\0-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
_CURES: dict[Keys, str] = {("dbc",): "; `pcpc dbc` writes one from the wiring"}
_PORTS = 1 << 16
_TAKEN = {*file_keys_of(Config), FALLBACK, "rx", "tx", "timing"} - {"controller"}


def check_characters(document: Document) -> None:
    """Raise RigError for a character that no file's name, no log and no terminal takes."""
    for keys, text in _texts(document.data, ()):
        if found := _STEERS.search(text):
            raise document.error(keys, f"character {found[0]!a} is not allowed")


def _texts(data: Any, keys: Keys) -> Iterator[tuple[Keys, str]]:
    """Yield all keys and values that are texts."""
    if isinstance(data, dict | list):
        for key, child in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _texts(key, (*keys, key))
            yield from _texts(child, (*keys, key))
    elif isinstance(data, str):
        yield keys, data


def check(document: Document, config: Config) -> None:
    """Raise the first contradiction between the keys of a rig; RigError."""
    problems = chain(
        _drives(config),
        _plants(config),
        _blocks(document, config),
        _overrun(document, config),
        standby.problems(document, config),
        ((("record", key), what) for key, what in config.record.problems()),
        _xcp(config),
        _limits(config),
        _patience(config),
        _expectations(config),
        _requirements(document, config),
        _ids(config),
    )
    for keys, what in problems:
        raise document.error(keys, what)
    evaluation(document, config)
    for keys in file_keys(as_data(config)):
        if keys[-1] != "law" and keys[0] != "evaluation":  # which was looked for just now
            document.file(keys, value_at(document.data, keys), _CURES.get(keys, ""))


def _drives(config: Config) -> Problems:
    for role, drive in config.drives.items():
        name = drive.profile
        if name not in PROFILES and outside.named("drives", name) is None:
            known = (*PROFILES, *(one.name for one in outside.additions("drives")))
            yield (role, "drive", "profile"), f"unknown value {name}{did_you_mean(name, known)}"


def _plants(config: Config) -> Problems:
    """Refuse plants beside a local node, without the first one, and on a third bus."""
    nodes: dict[str, Role] = {}
    buses = {role: one.bus for role, one in config.plants.items() if one.bus is not None}
    for role, plant in config.plants.items():
        if config.local is not None and (role != "plant" or role in buses):
            yield (role,), "a rig with a local node has one plant, on the local node's bus"
        if plant.node in nodes:
            yield (role, "node"), f"{plant.node} is {nodes[plant.node]}; give each its own DBC node"
        nodes[plant.node] = role
    first = next(iter(buses), None)
    for role, bus in buses.items():
        if first is not None and bus != buses[first]:
            yield (role, "bus"), f"differs from {first}.bus; a rig has two buses at the most"


def _blocks(document: Document, config: Config) -> Problems:
    document.known(("controller",), config.controller, config.controllers, "controller")
    first: dict[str, Role] = {}
    for role, node in config.sections.items():
        for name, entry in node.blocks.items():
            keys: Keys = (role, "blocks", name)
            if name in _TAKEN:
                yield keys, "this name is taken; rename the block"
            if name in first and not {first[name], role} <= set(PLANTS):
                where = document.where((first[name], "blocks", name))
                yield keys, f"the {first[name]} has this block, {where}; rename one"
            first.setdefault(name, role)
            has_file = entry.file is not None and entry.law not in FILE_LAWS
            if entry.law != tables.LAW and (has_file or entry.signal or entry.interpolation):
                yield keys, "only `law: table` takes file, signal, interpolation"
            if (role, name) == ("executive", "controller"):
                for key in ("law", "parameters"):
                    if getattr(entry, key):
                        yield (*keys, key), f"belongs at controllers.{config.controller}.{key}"
            elif entry.law is None:
                yield keys, "key law is missing"
    if "controller" not in config.executive.blocks:
        yield ("executive", "blocks"), "block controller is missing"


def _overrun(document: Document, config: Config) -> Problems:
    fallback, its_keys = config.overrun.fallback, ("overrun", "fallback")
    if fallback is None:
        return
    if config.overrun.fault_after is not None:
        yield its_keys, "fault_after is given too; choose one of the two"
    document.known(its_keys, fallback, config.controllers, "controller")
    if fallback == config.controller:
        yield its_keys, f"{fallback} is the controller itself; name another one"


def _xcp(config: Config) -> Problems:
    port = config.xcp.partition(":")[2] if isinstance(config.xcp, str) else ""
    if port and int(port) > (most := _PORTS - len(config.sections)):
        yield ("xcp",), f"expected a port of at most {most}, as each node has one from there on"


def _limits(config: Config) -> Problems:
    """Refuse bounds without a value between them, and safe values that cannot be sent."""
    for role, node in config.sections.items():
        for name, limit in node.limits.items():
            keys: Keys = (role, "limits", name)
            if not limit.low < limit.high:
                yield keys, f"low {limit.low:g} is not below high {limit.high:g}"
            if limit.rate_per_s is not None and not math.isfinite(limit.rate_per_s):
                what = f"{_not_finite(limit.rate_per_s)}; null is no rate limit"
                yield (*keys, "rate_per_s"), what
            if limit.safe is not None and not limit.low <= limit.safe <= limit.high:
                yield (*keys, "safe"), f"{limit.safe:g} is outside {limit.low:g}..{limit.high:g}"
            if limit.safe is not None and not math.isfinite(limit.safe):
                yield (*keys, "safe"), _not_finite(limit.safe)
        for name, value in getattr(node, "safe", {}).items():
            if not math.isfinite(value):
                yield (role, "safe", name), _not_finite(value)


def _not_finite(value: float) -> str:
    return f"expected a finite number, got {value:g}"


def _patience(config: Config) -> Problems:
    patience_s = config.supervisor.peer_timeout_s
    if patience_s * config.rate_hz < 2.0:
        what = f"{patience_s:g} s is less than 2 periods, {2.0 / config.rate_hz:g} s"
        yield ("supervisor", "peer_timeout_s"), what


def _expectations(config: Config) -> Problems:
    for name, figures in config.expect.items():
        if name not in config.controllers:
            yield ("expect", name), f"no such controller{did_you_mean(name, config.controllers)}"
        for figure, (low, high) in figures.items():
            if not low <= high or -low == high == math.inf:
                what = f"{low:g} is above {high:g}" if high < low else "limits nothing"
                yield ("expect", name, figure), what


def _requirements(document: Document, config: Config) -> Problems:
    """Refuse requirements that say nothing, whatever the names in them stand for."""
    from pcpc.executive.rig.requirements import (  # here: few rigs have some
        RequirementError,
        timed_requirement,
    )

    for i, entry in enumerate(config.require):
        for name in entry.controllers or ():
            document.known(("require", i, "controllers"), name, config.controllers, "controller")
        try:
            timed_requirement(entry, lambda name: None)
        except RequirementError as error:
            yield ("require", i, *error.keys), error.what


def _ids(config: Config) -> Problems:
    """Refuse an id that two requirements of one controller have."""
    for controller in config.controllers:
        entries: list[tuple[Keys, str | None]] = [
            (("require", i, "id"), one.id)
            for i, one in enumerate(config.require)
            if one.controllers is None or controller in one.controllers
        ]
        limits = config.expect.get(controller, {}).items()
        entries += [
            (("expect", controller, name, "id"), one.id)
            for name, one in limits
            if isinstance(one, Expected)
        ]
        known: dict[str, str] = {}
        for keys, word in entries:
            if word is None:
                continue
            if word in known:
                yield keys, f"{word} is the id of {known[word]} too; give each requirement its own"
            known[word] = ".".join(map(str, keys[:-1])).replace("require.", "require ")


def evaluation(document: Document, config: Config) -> Evaluation | None:
    """Return how a run is judged, its file found; RigError."""
    if config.evaluation is None:
        return None
    numbers = dict(config.evaluation)
    named = {key: numbers.pop(key) for key in ("file", "window_s") if key in numbers}
    named.setdefault("window_s", [0.0, config.duration_s])
    declared = convert(document, named, Evaluation, ("evaluation",))
    if not 0 <= declared.window_s[0] < declared.window_s[1]:
        raise document.error(("evaluation", "window_s"), "expected 0 <= begin < end")
    shipped = project_file(declared.file)
    file = document.file(("evaluation", "file"), declared.file) if shipped is None else shipped
    own_numbers = convert(document, numbers, dict[str, float], ("evaluation",))
    return msgspec.structs.replace(declared, file=str(file), numbers=own_numbers)

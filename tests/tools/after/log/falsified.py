"""Ways to falsify a run: a function each, which changes a copy of it in its folder."""

import json
import math
import shutil
from collections.abc import Callable, Sequence
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from test_logs_rewritten import CHANGES, Content, content, written

from pcpc.executive.log import reader as logs
from pcpc.executive.log.mcap_records import CRC_KEY, metadata_crc

Lie = Callable[[Path], object]  # of the run folder
LOG, SUMMARY, RIG = "log.mcap", "summary.json", "rig-resolved.yaml"
BOTH = "executive", "plant"


def rewritten(change: Callable[[Content], object]) -> Lie:
    """Change what is in the log, and write it anew with checksums that are right."""

    def lie(folder: Path) -> None:
        given = content(folder / LOG)
        change(given)
        written(given, folder / LOG)

    return lie


def part(name: str) -> Lie:
    """As another tool cut, doubled or turned it."""
    return rewritten(CHANGES[name][0])


# What is recorded


def value(node: str, name: str, cycle: int, how: Callable[[float], float]) -> Lie:
    """Change a value of a variable in a cycle."""

    def lie(folder: Path) -> None:
        about = logs.head(folder / LOG).node[node].description
        kind = "state" if name in about["state_columns"] else "timing"
        topic = logs.topic(node, kind)
        place = about["state_columns" if kind == "state" else "timing_columns"].index(name)

        def change(given: Content) -> None:
            one = next(m for t, m in given.messages if t == topic and m.sequence == cycle)
            body = np.frombuffer(one.data[logs.CDR_BYTES :], "<f8").copy()
            body[place] = how(float(body[place]))
            one.data = one.data[: logs.CDR_BYTES] + body.tobytes()

        rewritten(change)(folder)

    return lie


def ulp(old: float) -> float:
    return math.nextafter(old, math.inf)


def minus(old: float) -> float:
    return -old


def always(new: float) -> Callable[[float], float]:
    return lambda _: new


def frame(node: str, cycle: int, byte: int) -> Lie:
    """Change a byte of the first message of a frame in a cycle; -1: its last one."""

    def change(given: Content) -> None:
        topic = logs.topic(node, "can/frames")
        one = next(m for t, m in given.messages if t == topic and m.sequence == cycle)
        data = bytearray(one.data)
        data[byte] ^= 1
        one.data = bytes(data)

    return rewritten(change)


def event(topic: str, **more: Any) -> Lie:
    """Let something happen in cycle 100: a fault, if nothing else is said."""
    told = {"cycle": 100, "stamp_ns": 100_000_000, "event": "fault", "argument": 1, "value": 0.0}

    def change(given: Content) -> None:
        at = next(i for i, (_, m) in enumerate(given.messages) if m.log_time > 100_000_000)
        one = copy(next(m for t, m in given.messages if t == topic.replace("tunings", "events")))
        one.sequence, one.log_time, one.publish_time = 100, 100_000_000, 100_000_000
        one.data = json.dumps({**told, **more}).encode()
        if topic not in given.schemas:
            given.schemas[topic] = given.schemas[topic.replace("tunings", "events")]
            given.encodings[topic] = "json"
        given.messages.insert(at, (topic, one))

    return rewritten(change)


def stopped(given: Content) -> None:
    """Let the executive not have told that it stopped."""
    given.messages.remove(next(pair for pair in given.messages[::-1] if pair[0] == "/events"))


def swapped(given: Content) -> None:
    """Let each node have said what the other one did."""

    def other(topic: str) -> str:
        return topic.removeprefix("/plant") if topic.startswith("/plant") else f"/plant{topic}"

    given.messages = [(other(topic), one) for topic, one in given.messages]


def later(given: Content) -> None:
    """Let every cycle of the executive have been a second later."""
    for topic, one in given.messages:
        if topic in ("/state", "/timing"):
            one.log_time = one.publish_time = one.log_time + 1_000_000_000


# What is told of it


def facts(names: Sequence[str], right: bool = True, **new: str | None) -> Lie:
    """Change metadata; None: leave out. `right`: with their checksum."""

    def change(given: Content) -> None:
        for one in given.metadata:
            if one.name in names:
                told = {key.replace("__", "."): text for key, text in new.items()}
                told = {k: v for k, v in {**one.metadata, **told}.items() if v is not None}
                told |= {CRC_KEY: metadata_crc(one.name, told)} if right else {}
                one.metadata = told

    return rewritten(change)


def attached(end: str, how: Callable[[bytes], bytes | None]) -> Lie:
    """Change attachments whose name ends so; None: leave out."""

    def change(given: Content) -> None:
        for one in [one for one in given.attachments if one.name.endswith(end)]:
            if (new := how(one.data)) is None:
                given.attachments.remove(one)
            else:
                one.data = new

    return rewritten(change)


def described(**new: Any) -> Lie:
    """Change what the executive's description says."""
    return attached("executive.json", lambda data: json.dumps({**json.loads(data), **new}).encode())


def columns_swapped(data: bytes) -> bytes:
    names = b'"controller.e_rad"', b'"controller.r_rad_s"'
    head, mid, tail = data.partition(b'"state_columns"')
    for old, new in ((names[0], b"?"), (names[1], names[0]), (b"?", names[1])):
        tail = tail.replace(old, new, 1)
    return head + mid + tail


def rig(**new: Any) -> Lie:
    """Change values of the log's own rig; A__B: the key B of A."""

    def how(data: bytes) -> bytes:
        told = yaml.safe_load(data)
        for name, one in new.items():
            *above, last = name.split("__")
            place = told
            for key in above:
                place = place[int(key) if key.isdecimal() else key]
            place[last] = one
        return yaml.safe_dump(told, sort_keys=False).encode()

    return attached(RIG, how)


# Files


def of_file(name: str, how: Callable[[bytes], bytes]) -> Lie:
    """Change the bytes of a file; where there is none, of nothing."""

    def lie(folder: Path) -> None:
        path = folder / name
        path.write_bytes(how(path.read_bytes() if path.exists() else b""))

    return lie


def flipped(share: float) -> Lie:
    def how(data: bytes) -> bytes:
        at = int(share * len(data))
        return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]

    return of_file(LOG, how)


def cut(share: float) -> Lie:
    return of_file(LOG, lambda data: data[: int(share * len(data))])


def copied(run: str, *names: str) -> Lie:
    """Put files of another run in its place."""

    def lie(folder: Path) -> None:
        for name in names:
            shutil.copy(folder.parent / run / name, folder / name)

    return lie


def gone(name: str, instead: Callable[[Path], object] = lambda path: None) -> Lie:
    """Take a file away, and put something else there."""

    def lie(folder: Path) -> None:
        (folder / name).unlink()
        instead(folder / name)

    return lie


def summary(**new: Any) -> Lie:
    """Change keys of summary.json; None: leave out."""

    def how(data: bytes) -> bytes:
        told = {k: v for k, v in {**json.loads(data), **new}.items() if v is not None}
        return json.dumps(told, indent=2).encode() + b"\n"

    return of_file(SUMMARY, how)


def both(*lies: Lie) -> Lie:
    """Tell one lie after the other."""

    def lie(folder: Path) -> None:
        for one in lies:
            one(folder)

    return lie

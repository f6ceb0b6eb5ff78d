"""Logs that are valid MCAP files with odd contents, and damaged ones, made from a true log.

A log is taken apart into its records (`Parts`), one to three of the changes below are made, and it
is written again with all checksums right; sometimes bytes are then flipped, cut or doubled.
"""

import json
import random
import re
import struct
import zlib
from typing import Any

from log_parts import Parts, put_together, take_apart
from mcap.records import (
    Attachment,
    Channel,
    Metadata,
    Schema,
)

TEXTS = [
    "", "-1", "0", "1", "7", "nan", "inf", "-inf", "1e400", "-1e308", "9" * 30, "9" * 5000, "abc",
    "\x1b[2J\x1b[31m", "a\nb", "a\0b", "\u202egnp", "\udc80", "../../../../x", "/etc/passwd", "*",
    "**", "..", ".", "a/b", "[", "x" * 300, "x" * 70000, "true", "null", "{}", "[]", "\u00b0", "%s",
    "executive", "plant", "real", "sync", "lockstep", "virtual", "socketcan:\x1b[1m",
]  # fmt: skip
VALUES: list[Any] = [
    None, True, False, 0, 1, -1, 7, 255, 2**31, 2**32, 2**63, -(2**63), 2**64, 2**70, 10**400, 0.0,
    -0.0, 1e308, -1e308, 5e-324, float("nan"), float("inf"), float("-inf"), [], {}, [[]], [{}],
    {"a": {}}, [0] * 5, ["a", 1, None], *TEXTS,
]  # fmt: skip
SCHEMAS = [
    "", "float64", "float64 a\nfloat64 a\n", "float64 x  # a [ [ [\n" * 20, "uint8[] a\n",
    "float64 a  # b [c]\n" * 300, "float64 x  # " + " [" * 20000,
    "\x1b[2J\nfloat64 \u00b5  # \x1b [\0]",
    "float64 a  #  []\nfloat64 b  # c []\n",
]  # fmt: skip


# Changes


def _some(random: random.Random, parts: Parts, kinds: str = "") -> list[int]:
    """Return the places of the messages of one channel."""
    ids = [i for i, c in parts.channels.items() if kinds in c.topic]
    wanted = random.choice(ids) if ids else -1
    return [n for n, row in enumerate(parts.content) if row[0] == wanted]


def drop(random: random.Random, parts: Parts) -> None:
    """Leave out a record, or all of a kind."""
    which = random.randrange(6)
    if which == 0 and parts.attachments:
        parts.attachments.remove(random.choice(parts.attachments))
    elif which == 1 and parts.metadata:
        parts.metadata.remove(random.choice(parts.metadata))
    elif which == 2 and parts.schemas:
        del parts.schemas[random.choice(list(parts.schemas))]
    elif which == 3 and parts.channels:
        del parts.channels[random.choice(list(parts.channels))]
    elif which == 4:
        gone = set(_some(random, parts))
        parts.content = [row for n, row in enumerate(parts.content) if n not in gone]
    else:
        parts.content = random.sample(parts.content, len(parts.content) // 2)


def repeat(random: random.Random, parts: Parts) -> None:
    """Have a record twice, under the same or another name."""
    which = random.randrange(3)
    if which == 0 and parts.attachments:
        parts.attachments.append(random.choice(parts.attachments))
    elif which == 1 and parts.metadata:
        parts.metadata.append(random.choice(parts.metadata))
    elif parts.channels:
        one = random.choice(list(parts.channels.values()))
        new = random.choice([900, 65535, 0])
        schema = random.choice([one.schema_id, *parts.schemas, 0, 4000])
        parts.channels[new] = Channel(new, one.topic, one.message_encoding, {}, schema)
        for n in _some(random, parts)[::3]:
            parts.content[n] = (new, *parts.content[n][1:])


def _changed(random: random.Random, value: Any, depth: int = 0) -> Any:
    """Return a JSON value with one odd place."""
    if depth < 5 and random.random() < 0.85:
        if isinstance(value, dict) and value:
            key = random.choice(list(value))
            if random.random() < 0.15:
                return {k: v for k, v in value.items() if k != key}
            if random.random() < 0.1:
                return {(random.choice(TEXTS) if k == key else k): v for k, v in value.items()}
            return value | {key: _changed(random, value[key], depth + 1)}
        if isinstance(value, list) and value:
            at = random.randrange(len(value))
            if random.random() < 0.15:
                return value[:at]
            return [*value[:at], _changed(random, value[at], depth + 1), *value[at + 1 :]]
    return random.choice(VALUES)


def _json(value: Any) -> bytes:
    return json.dumps(value).encode()


def describe(random: random.Random, parts: Parts) -> None:
    """Change a place in the description of a node."""
    about = [a for a in parts.attachments if a.name.endswith(".json")]
    if about:
        one = random.choice(about)
        try:
            value = json.loads(one.data)
        except (ValueError, RecursionError):
            value = {}
        odd = [b"[" * 100000, b"", b"5", b"\xff", _json(_changed(random, value))]
        data = random.choice([*odd, *(_json(_changed(random, value)) for _ in range(8))])
        _replace(parts, one, data=data)


def _replace(parts: Parts, one: Attachment, **what: Any) -> None:
    new = Attachment(**(vars(one) | what))
    parts.attachments = [new if a is one else a for a in parts.attachments]


def note(random: random.Random, parts: Parts) -> None:
    """Change metadata."""
    if parts.metadata:
        one = random.choice(parts.metadata)
        key = random.choice([*one.metadata, "clock_wall_ns", "period_ns", random.choice(TEXTS)])
        pairs = dict(one.metadata)
        if random.random() < 0.2:
            pairs.pop(key, None)
        else:
            pairs[key] = random.choice([*TEXTS, *map(str, VALUES)])
        name = random.choice(TEXTS) if random.random() < 0.1 else one.name
        parts.metadata = [
            Metadata(name=name, metadata=pairs) if m is one else m for m in parts.metadata
        ]


def attach(random: random.Random, parts: Parts) -> None:
    """Change the name or the text of an attachment."""
    if not parts.attachments:
        return
    one = random.choice(parts.attachments)
    if random.random() < 0.3:
        new = random.choice([*TEXTS, *(a.name for a in parts.attachments), "a.py", "../x.py"])
        _replace(parts, one, name=new.encode("utf-8", "replace").decode())
        return
    text = one.data.decode("utf-8", "replace")
    words = list(re.finditer(r"[-\w.]+", text))
    for _ in range(random.choice((1, 1, 3))):
        if words:
            found = random.choice(words)
            new = random.choice([*TEXTS, random.choice(words)[0]])
            text = text[: found.start()] + new + text[found.end() :]
            words = list(re.finditer(r"[-\w.]+", text))
    _replace(parts, one, data=text.encode("utf-8", "surrogatepass"))


def time(random: random.Random, parts: Parts) -> None:
    """Change sequence and log time of messages."""
    odd = [0, 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1, 10**18]
    rows = _some(random, parts)
    if random.random() < 0.3:
        shuffled = random.sample(rows, len(rows))
        old = [parts.content[n] for n in shuffled]
        for n, row in zip(rows, old, strict=True):
            parts.content[n] = row
        return
    for n in random.sample(rows, min(len(rows), random.choice((1, 5, 10**6)))):
        channel, sequence, at, data = parts.content[n]
        if random.random() < 0.5:
            sequence = random.choice(odd)
        else:
            at = random.choice(odd)
        parts.content[n] = (channel, sequence, at, data)


def payload(random: random.Random, parts: Parts) -> None:
    """Change payloads: numbers, lengths, bytes."""
    rows = _some(random, parts, random.choice(("", "state", "timing", "frames")))
    numbers = [float("nan"), float("inf"), float("-inf"), 1e308, -1e308, -0.0, 5e-324, 1e19, -1.0]
    for n in random.sample(rows, min(len(rows), random.choice((1, 3, 10**6)))):
        channel, sequence, at, data = parts.content[n]
        which = random.randrange(6)
        place = 4 + 8 * random.randrange(max(1, (len(data) - 4) // 8))
        if which == 0:
            data = data[: random.randrange(len(data) + 1)]
        elif which == 1:
            data += bytes(random.choice((1, 4, 8, 800)))
        elif which == 2:
            data = data[:place] + struct.pack("<d", random.choice(numbers)) + data[place + 8 :]
        elif which == 3:
            odd = random.choice([0, -1, 2**63 - 1, -(2**63), 2**62, 10**18])
            data = data[:place] + struct.pack("<q", odd) + data[place + 8 :]
        elif which == 4 and data:
            place = random.randrange(len(data))
            data = data[:place] + bytes([random.randrange(256)]) + data[place + 1 :]
        else:
            data = random.randbytes(len(data))
        parts.content[n] = (channel, sequence, at, data)


def entries(random: random.Random, parts: Parts) -> None:
    """Put odd events and tunings among the messages."""
    ids = [i for i, c in parts.channels.items() if c.topic.endswith(("events", "tunings"))]
    about = {"cycle": 3, "stamp_ns": 5, "name": "controller.gain", "value": 1.0, "event": "fault"}
    for _ in range(random.choice((1, 5))):
        if ids:
            odd = [b"5", b"null", b"[]", b'"x"', b"{", b"\xff", b"", b"[" * 50000, b'{"a":' * 5000]
            value = _json(_changed(random, about))
            data = random.choice([*odd, value, value, value, value, value, _json(about)])
            row = (random.choice(ids), random.randrange(5), parts.content[0][2], data)
            parts.content.insert(random.randrange(len(parts.content) + 1), row)
            about = about | {"name": random.choice(["supervisor.state", "rx.FB.position", *TEXTS])}


def explain(random: random.Random, parts: Parts) -> None:
    """Change a schema or a channel."""
    if random.random() < 0.4 and parts.schemas:
        one = random.choice(list(parts.schemas.values()))
        text = one.data.decode()
        lines = text.split("\n")
        swapped = "\n".join(random.sample(lines, len(lines)))
        data = random.choice([*SCHEMAS, text[: len(text) // 2], text + text, swapped]).encode()
        encoding = random.choice([one.encoding, *TEXTS])
        parts.schemas[one.id] = Schema(one.id, data, encoding, one.name)
    elif parts.channels:
        channel = random.choice(list(parts.channels.values()))
        what: dict[str, Any] = random.choice(
            [
                {"topic": random.choice([*TEXTS, *(c.topic for c in parts.channels.values())])},
                {"message_encoding": random.choice(["json", "cdr", *TEXTS])},
                {"schema_id": random.choice([0, 1, 2, 3, 4000])},
            ]
        )
        parts.channels[channel.id] = Channel(**(vars(channel) | what))


def frame_it(random: random.Random, parts: Parts) -> None:
    """Change how the file is put together."""
    parts.compression = random.choice(("", "lz4", "zstd"))
    parts.per_chunk = random.choice((1, 7, 10**6))
    parts.summary = random.random() < 0.5
    odd = random.choice([{}, {1: 2**63}, {65535: 5, 0: 2**64 - 1}])
    parts.statistics = random.choice([None, odd])
    if random.random() < 0.3:
        random.shuffle(parts.content)


CHANGES = (
    drop, repeat, describe, describe, describe, note, note, attach, attach, time, payload, payload,
    entries, entries, explain, explain, frame_it,
)  # fmt: skip


def damaged(random: random.Random, data: bytes) -> bytes:
    """Return a file with flipped, cut, doubled or zeroed bytes."""
    out = bytearray(data)
    for _ in range(random.choice((1, 1, 4, 30))):
        at = random.randrange(len(out))
        size = random.choice((1, 8, 100, 3000))
        which = random.randrange(5)
        if which == 0:
            out[at] ^= 1 << random.randrange(8)
        elif which == 1:
            out[at : at + size] = b""
        elif which == 2:
            out[at:at] = out[at : at + size]
        elif which == 3:
            out[at : at + size] = bytes(len(out[at : at + size]))
        else:
            del out[at:]
        if not out:
            break
    return bytes(out)


def odd_log(base: bytes, random: random.Random) -> tuple[bytes, str]:
    """Return a changed log and what was changed."""
    parts, names = take_apart(base), []
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        change = random.choice(CHANGES)
        change(random, parts)
        names.append(change.__name__)
    data = put_together(parts)
    if random.random() < 0.25:
        data = damaged(random, data)
        names.append("damaged")
    return data, "+".join(names)


# DBC files and recordings

NUMBERS = [
    "0", "-1", "1", "8", "64", "65", "1e9", "1e400", "-1e400", "4294967295", "2147483648",
    "1" + "0" * 30, "1" + "0" * 400, "0.0", "1e-320", "1e308", "255", "-0", "9999", "1.5", "+3",
]  # fmt: skip


def odd_text(text: str, random: random.Random) -> str:
    """Return a DBC file, or a recording that is text, with other numbers, words, lines or signs."""
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        which, at = random.randrange(7), random.randrange(len(text))
        numbers = list(re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", text))
        words = list(re.finditer(r"\w+", text))
        if which < 3 and numbers:
            found = random.choice(numbers)
            text = text[: found.start()] + random.choice(NUMBERS) + text[found.end() :]
        elif which == 3:
            lines = text.split("\n")
            lines.insert(random.randrange(len(lines)), lines.pop(random.randrange(len(lines))))
            text = "\n".join(lines)
        elif which == 4:
            text = text[:at] + random.choice('"|@+-()[]:;,# \nmM0\x1b\xb0\0') + text[at:]
        elif which == 5:
            text = text[:at] or "x"
        elif words:
            found, other = random.choice(words), random.choice(words)
            text = text[: found.start()] + other[0] + text[found.end() :]
    return text


def odd_recording(data: bytes, suffix: str, random: random.Random) -> bytes:
    """Return a changed recording; of a BLF file also the inside of its containers."""
    if suffix != ".blf":
        if random.random() < 0.8:
            return odd_text(data.decode("latin-1"), random).encode("latin-1", "replace")
        return damaged(random, data)
    if random.random() < 0.4:
        return damaged(random, data)
    out, place = bytearray(data[:144]), 144
    while place + 32 <= len(data):
        size = int.from_bytes(data[place + 8 : place + 12], "little")
        inside = bytearray(zlib.decompress(data[place + 32 : place + size]))
        for _ in range(random.choice((1, 1, 3, 20))):
            at = 4 * random.randrange(len(inside) // 4)
            inside[at : at + 4] = struct.pack(
                "<I", random.choice([0, 1, 16, 48, 86, 2**31, 2**32 - 1])
            )
        body = data[place + 16 : place + 32] + zlib.compress(bytes(inside))
        out += data[place : place + 8] + struct.pack("<II", 16 + len(body), 10) + body
        out += bytes((16 + len(body)) % 4)
        place += size + size % 4
    return bytes(out)

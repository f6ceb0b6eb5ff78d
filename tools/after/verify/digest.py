"""The digest of a log: SHA-256 over what it says, however its file is cut into chunks or packed.

It is the hash of these lines, each ended by a newline; NODE is executive, local, plant, in this
order, and what a log lacks counts 0 or has no line:

    pcpc log digest 1
    NODE state N SHA       names and units of the columns; of each message its length, the low half
                           of its cycle, the bits of all columns
    NODE can/frames N SHA  of each message its length, cycle, id, dlc, direction, check, data
    NODE tunings N SHA     of each its JSON with sorted keys, without `stamp_ns`
    NODE KEY TEXT          metadata: those of FACTS and all `version_*`, sorted, as JSON
    file NAME SHA          attachments, sorted: rig, DBC, laws, evaluation; no description of a node

N counts messages, SHA is the SHA-256 of them in the order of the file. Not hashed: clocks and
stamps, measured times (/timing), events, counts of the recorder, the machine, the bus. So two runs
of one seed in virtual time have one digest.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import checks
from pcpc.executive.log import reader as logs
from pcpc.executive.log.inventory import TOPICS, topic
from pcpc.executive.log.mcap_records import MESSAGE_HEAD

FACTS = ("branch_cycle", "controller", "git", "pacing", "period_ns", "python", "rate_hz", "rig",
         "rig_git", "seed")  # fmt: skip
_KINDS = "state", "can/frames", "tunings"
_LENGTH, _CYCLE = slice(1, 9), slice(11, 15)  # of a message record
_OF_FRAME = MESSAGE_HEAD + logs.CDR_BYTES + 8  # behind its stamp


def digest(path: Path) -> str:
    """Return the digest of a log, read in one pass; LogError."""
    scanned = logs.Scan()
    hashes = {(node, kind): hashlib.sha256() for node in logs.NODES for kind in _KINDS}
    counts = dict.fromkeys(hashes, 0)
    for channel, rows in logs.walk(path, scanned):
        key = TOPICS.get(scanned.topic(channel), ("", ""))
        if key in hashes:
            hashes[key].update(_hashed_bytes(key[1], rows))
            counts[key] += len(rows)
    lines = ["pcpc log digest 1"]
    for (node, kind), hashed in hashes.items():
        if kind == "state":
            columns = logs.variables(scanned, topic(node, kind))
            hashed.update(json.dumps([(each.name, each.unit) for each in columns]).encode())
        lines.append(f"{node} {kind} {counts[node, kind]} {hashed.hexdigest()}")
    for node in logs.NODES:
        known = {
            key: record.metadata[key]
            for record in scanned.metadata
            if record.name == node
            for key in record.metadata
            if key in FACTS or key.startswith("version_")
        }
        lines += [f"{node} {key} {json.dumps(known[key])}" for key in sorted(known)]
    described = {f"{node}.json" for node in logs.NODES}
    lines += sorted(
        f"file {json.dumps(one.name)} {hashlib.sha256(one.data).hexdigest()}"
        for one in scanned.attachments
        if one.name not in described
    )
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()


def _hashed_bytes(kind: str, rows: NDArray[np.uint8]) -> bytes:
    """Return what is hashed of messages."""
    if kind == "state":
        parts = rows[:, _LENGTH], rows[:, _CYCLE], rows[:, MESSAGE_HEAD:]
        return np.hstack(parts).tobytes()
    if kind == "can/frames":
        return np.hstack((rows[:, _LENGTH], rows[:, _OF_FRAME:])).tobytes()
    return b"".join(_tuning(row[MESSAGE_HEAD:].tobytes()) for row in rows)


def _tuning(text: bytes) -> bytes:
    """Return a tuning without its stamp; as it is, if it is none."""
    try:
        entry: Any = checks.parse_json(text)
    except ValueError:
        return text + b"\n"
    if isinstance(entry, dict):
        entry.pop("stamp_ns", None)
    return json.dumps(entry, sort_keys=True).encode() + b"\n"

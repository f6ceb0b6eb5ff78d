"""What a node that is started alone says of the plant of its rig, before the first cycle.

    id      29 bits, GREETING + 0 executive, 1 local, 2 plant, 3 plant_2, ...
    data    the first 8 bytes of the SHA-256 of what the plant runs: rate, seed, its blocks and
            parameters, frames, its laws' files; not what the executive does with it

The other end compares it with its own (`executive.loop.meeting`). Devices say nothing of the kind
and need not hear it; nor do nodes of one command, which have one rig.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import yaml

from pcpc.drivers.can import can_id, dbc
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.shared import GREETING
from pcpc.executive.own_laws.carried_files import with_local_imports
from pcpc.executive.rig.law_lookup import law_source
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import PLANTS, ROLES, Role

PLANT_BYTES = 8


def install(loop: Loop, rig: Rig, role: Role) -> None:
    """Let a node greet; not one whose DBC file has an id of the greeting."""
    ids = {message.frame_id for message in dbc.load(rig.dbc).messages}
    if ids & {GREETING + i for i in range(len(ROLES))}:
        return
    word = can_id.word_of(GREETING + ROLES.index(role), True)
    loop.meeting.greets, frame = 1, loop.meeting.greeting
    frame[:4] = list(word.to_bytes(4, "little"))
    frame[LENGTH] = PLANT_BYTES
    frame[8:16] = list(plant_of(rig))


def plant_of(rig: Rig) -> bytes:
    """Return in 8 bytes what the plant of a rig is, wherever its files lie."""
    whole = yaml.safe_load(rig.resolved())
    own = whole["plant"] if len(rig.config.plants) == 1 else [whole[r] for r in rig.config.plants]
    told = json.dumps(_bare(own), sort_keys=True)
    digest = hashlib.sha256(f"{rig.config.rate_hz!r} {rig.config.seed} {told}".encode())
    digest.update(dbc.text(rig.dbc).encode())
    for name, text in sorted(rig.tables().items()):
        digest.update(f"{name} {text}".encode())
    for keys, law in rig.laws():
        file, _ = law_source(rig.document, keys, law) if keys[0] in PLANTS else (None, None)
        for path in with_local_imports(file) if file is not None else ():
            digest.update(path.name.encode() + path.read_bytes())
    return digest.digest()[:PLANT_BYTES]


def _bare(value: Any) -> Any:
    """Return a part of a rig with names of files instead of paths."""
    if isinstance(value, dict):
        return {key: _bare(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [_bare(child) for child in value]
    return Path(value).name if isinstance(value, str) and "/" in value else value

"""What the audit keeps of a run: its verdict, its laws, and its yardstick, from the log itself."""

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from pcpc.drivers.errors import UserError
from pcpc.executive.own_laws.carried_files import sha256
from pcpc.tools.after.opened import opened
from pcpc.tools.run.mcp.audit import Ran
from pcpc.tools.run.mcp.workspace import LOG

_JUDGED = {"controller", "controllers", "standby", "title", "note", "watch", "rig"}


def ran(folder: Path, printed: str, name: str) -> Ran:
    """Return what became of a run, by its log and by what its command has printed."""
    found = Ran(folder=name)
    log = folder / LOG
    try:
        summary = json.loads(printed)
        found.verdict, found.metrics = summary["verdict"], summary["metrics"]
        found.changed = summary["changed"]
    except (ValueError, KeyError, TypeError):
        found.verdict = "unknown"
    if not log.is_file():
        return found
    found.log = sha256(log)
    try:
        with opened(log) as run:
            texts = dict(run.head.attachments)
    except (UserError, OSError):
        return found
    resolved = "".join(text for name, text in texts.items() if name.endswith("resolved.yaml"))
    if not (rig := yaml.safe_load(resolved)):
        return found
    found.rig, found.controller = rig["rig"], rig["controller"]
    for name, value in flat(rig):
        (found.laws if is_law(name) else found.yardstick)[name] = value
    used = {os.path.normpath(one) for one in map(_file_of, found.yardstick.values())}
    laws = {os.path.normpath(_file_of(one["law"])) for one in rig["controllers"].values()} - used
    for name in ("dbc", "evaluation.file"):  # where it lies; its content is told below
        found.yardstick.pop(name, None)
    for name, text in texts.items():
        if name.endswith(".dbc"):
            found.yardstick["file .dbc"] = hashlib.sha256(text.encode()).hexdigest()
        for file in json.loads(text).get("files", ()) if name.endswith(".json") else ():
            own = {os.path.normpath(one) for one in (file["name"], *file["laws"])}
            into = found.laws if own & laws and not file["judges"] else found.yardstick
            into |= {} if file["draws"] else {f"file {Path(file['name']).name}": file["sha256"]}
    return found


def _file_of(value: Any) -> str:
    """Return the file of a law, as FILE:BLOCK names it, or a text as it is."""
    return str(value).rpartition(":")[0] or str(value)


def is_law(key: str) -> bool:
    """Return whether a rig's key is of its laws; all others say what they are judged by."""
    return key.partition(".")[0] in _JUDGED


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a rig by their dotted names; entries of a list by their own names."""
    if isinstance(value, list) and any(isinstance(one, dict) for one in value):
        value = {str(one.get("id") or one.get("name") or i): one for i, one in enumerate(value)}
    if not isinstance(value, dict) or not value:
        yield name, value
        return
    for key, own in value.items():
        yield from flat(own, f"{name}.{key}" if name else str(key))

"""What a log needs that it does not carry: the packages of others that its drives came with."""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers.machine import outside
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.bus_keys import PROFILES
from pcpc.executive.rig.roles import ROLES


def check_dialects(head: logs.Log, data: Mapping[str, Any]) -> None:
    """Raise LogError for a drive of a package that is not here. `data`: the rig of the log."""
    drives = (node.get("drive") for role in ROLES if isinstance(node := data.get(role), dict))
    for name in {str(drive.get("profile")) for drive in drives if isinstance(drive, dict)}:
        if name not in PROFILES and outside.named("drives", name) is None:
            what = f"its drive speaks {name}{packages_of(head)}"
            raise logs.LogError(f"{head.path}: {what}; install that package to recompute it")


def packages_of(head: logs.Log) -> str:
    """Return ", which came with PACKAGES" for a rig of packages of others; "" of none."""
    names = {facts.get("packages", "") for facts in head.metadata.values()} - {""}
    return f", which came with {', '.join(sorted(names))}" if names else ""

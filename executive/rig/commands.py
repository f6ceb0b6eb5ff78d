"""Which sent signals are commands, and the limits and safe values of each."""

from collections.abc import Iterable

import msgspec

from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import Limit


def commands(rig: Rig, role: Role, sent: Iterable[str]) -> dict[str, Limit]:
    """Return the limits of what a node sends; without bounds, of what the receiver makes safe.

    What the other node's watchdog substitutes is a command: it is safe in FAULT and at the end.
    """
    nodes = rig.nodes()
    safe_values = {
        name: value
        for other in rig.roles
        if other != role
        for name, value in nodes[other].safe.items()
    }
    declared = dict(nodes[role].limits)
    declared |= {name: Limit() for name in sent if name in safe_values and name not in declared}
    limits = {}
    for name, limit in declared.items():
        safe = safe_values.get(name, 0.0) if limit.safe is None else limit.safe
        limits[name] = msgspec.structs.replace(limit, safe=min(max(safe, limit.low), limit.high))
    return limits

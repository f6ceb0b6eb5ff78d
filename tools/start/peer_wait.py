"""How long nodes that are ready have waited for another one, and what to say when nobody comes."""

import time
from collections.abc import Iterator, Mapping, Sequence

from pcpc.drivers.can import dbc
from pcpc.executive.loop import shared as sh
from pcpc.executive.rig.messages import database_of, is_heartbeat
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

_MEET_S = 20.0  # nodes of one host that are ready hear each other within this
_ODD_S = 0.5  # on an emulated line with two bit rates: nothing comes


class PeerWait:
    """The wait of a host's nodes from the moment when all are ready to their first cycle."""

    def __init__(self, rig: Rig, roles: Sequence[Role]) -> None:
        self.rig, self.roles = rig, roles
        self.limit_s = rig.config.supervisor.peer_timeout_s
        if len(roles) > 1:  # the other one is ours
            others = set(rig.config.bus.bitrates.values()) - {rig.config.bus.bits_per_s}
            self.limit_s = min(self.limit_s, _ODD_S if others else _MEET_S)
        self.given_up_s = 0.0  # how long it was when it was too long
        self._ready_ns = 0

    def too_long(self, blocks: Mapping[str, sh.NodeMemory], under_way: bool) -> bool:
        """Return whether the nodes, all ready, have waited for longer than they should."""
        ready = [block for block in blocks.values() if block.control.ready]
        if len(ready) < len(self.roles) or under_way:
            self._ready_ns = 0
            return False
        self._ready_ns = self._ready_ns or time.monotonic_ns()
        waited_s = 1e-9 * (time.monotonic_ns() - self._ready_ns)
        self.given_up_s = waited_s if waited_s > self.limit_s else 0.0
        return self.given_up_s > 0.0

    def message(self, leader: str, bus: str, rig_file: str) -> str:
        """Return what to say once it was too long."""
        missing = [role for role in self.rig.roles if role not in self.roles]
        cure = "another run may use the bus, or it hands on nothing here; choose one with --bus"
        if missing:
            kind = missing[-1].partition("_")[0]
            start = f"`pcpc run {rig_file} --only {kind}`"
            cure = f"start {start} on this bus, or raise supervisor.peer_timeout_s"
        others = " or ".join(missing) or "the other node"
        silent = missing or [role for role in self.rig.roles if role != leader]
        names = ", ".join(self._awaited_names(silent))
        silence = f"no frame of {others} on {bus} for {self.given_up_s:.0f} s"
        return f"{leader}: {silence}, as {names}; {cure}"

    def _awaited_names(self, roles: Sequence[Role]) -> Iterator[str]:
        """Yield the frames of nodes by which another one knows them: SYNC, else the heartbeat."""
        database = database_of(self.rig)
        for role in roles:
            sent = dbc.frames(database, self.rig.config.sections[role].node, "tx")
            leads = role == "executive"
            yield from (f.name for f in sent if (f.has_sequence if leads else is_heartbeat(f)))

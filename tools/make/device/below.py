"""What the nodes right below a device heard of it and told it: a local node, or all plants."""

from dataclasses import replace

import numpy as np

from pcpc.drivers.can import dbc
from pcpc.executive.log import reader as logs
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role


class NodesBelow:
    """The nodes right below a rig's executive, `roles`; BusError if the DBC file is not there.

    `heard`: the frames that come from above, each with the first node that hears it; `told`: those
    that go up, with their senders.
    """

    def __init__(self, rig: Rig) -> None:
        self.roles = rig.config.below
        self.heard = self._frames(rig, "rx", "tx")
        self.told = self._frames(rig, "tx", "rx")

    def _frames(self, rig: Rig, way: dbc.Way, other: dbc.Way) -> list[tuple[Role, dbc.Frame]]:
        database, sections = messages.database_of(rig), rig.config.sections
        names = [one.node for role, one in sections.items() if role != "executive"]
        own = {frame.name for name in names for frame in dbc.frames(database, name, other)}
        found: dict[str, tuple[Role, dbc.Frame]] = {}
        for role in self.roles:
            for frame in dbc.frames(database, sections[role].node, way):
                if frame.name not in own:
                    found.setdefault(frame.name, (role, frame))
        return list(found.values())

    def _in_order(self) -> list[dbc.Frame]:
        """Return all of these frames, those of one node in the order in which it sends them."""
        both = ([frame for _, frame in of] for of in (self.told, self.heard))
        return [frame for of in both for frame in sorted(of, key=messages.sending_order)]

    def record(self, log: logs.Log) -> logs.NodeLog:
        """Return the record of the first of these nodes with the frames that all had with above.

        In the order of the cycles and in one that in which they are sent; each frame once.
        """
        parts, order = [], {frame.word: i for i, frame in enumerate(self._in_order())}
        for role in [role for role in self.roles if role in log.node]:
            frames, chosen = log.node[role].frames, False
            for way, of in enumerate((self.told, self.heard)):
                words = [frame.word for one, frame in of if one == role]
                chosen |= np.isin(frames["id"], words) & (frames["direction"] == way)
            parts.append(frames[chosen])
        together = np.concatenate(parts)
        if len(parts) > 1:
            rank = np.array([order[word] for word in together["id"].tolist()], np.int64)
            together = together[np.lexsort((rank, together["cycle"]))]
        return replace(log.node[self.roles[0]], frames=together)

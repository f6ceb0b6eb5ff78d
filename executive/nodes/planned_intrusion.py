"""What follows a second sender of a frame, and how often heartbeats come."""

from pcpc.executive.loop.intrusion import REACTIONS, Reaction
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.rig.messages import is_heartbeat


class Intrusion(Part):
    """The watch for second senders of what a node receives."""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the rig's reaction, and the turns of heartbeats."""
        watch, config = loop.intrusion, made.rig.config
        watch.reaction = REACTIONS.index(config.supervisor.intrusion)
        watch.early_at[:] = -(2**62)
        for row, frame in enumerate(made.rx_frames):
            if is_heartbeat(frame) and frame.cycle_ms:
                watch.beat_every[row] = frame.every_n(config.rate_hz)
            watch.care[row] = watch.reaction != Reaction.COUNT or watch.beat_every[row] > 0

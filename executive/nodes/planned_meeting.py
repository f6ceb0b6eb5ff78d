"""The part of a node among the others: for whom it waits, which frames start its cycle."""

from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.sending import LastWord
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.rig import messages as protocol


class Meeting(Part):
    """How nodes find each other; the lowest waits for nobody, and owes periods after a stall."""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write what each received frame is to this node, and what the node does first and last."""
        rx, meeting = loop.rx, loop.meeting
        meeting.ordered = made.pacing == "lockstep"
        meeting.between = made.role == "local"
        loop.wire.in_turn = meeting.ordered and meeting.between
        meeting.on_second = made.is_plant and made.rig.config.plants[made.role].bus is not None
        meeting.seeks_below = not made.is_plant
        loop.blocks.owe_periods = made.is_plant
        loop.tx.last_word = LastWord.HEARTBEAT if made.is_plant else LastWord.ALL_FRAMES
        peers = protocol.peers_of(made.role, made.rx_frames, made.below, made.senders)
        part = protocol.parts_in_meeting(made.role, made.rx_frames, peers)
        meeting.peers = max(made.senders.values(), default=1)
        for i, frame in enumerate(made.rx_frames):
            starts = protocol.starts_cycle(made.role, frame, made.below)
            rx.role[i] = (starts, protocol.is_awaited(frame), peers[i], part[i])
        rx.starters, rx.awaited = rx.role["starts"].sum(), rx.role["awaited"].sum()

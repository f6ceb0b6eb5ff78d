"""The frames of a node: which it receives and sends, their signals, the rows that hold them."""

from pcpc.drivers.can import dbc, e2e
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.ring_layout import frame_words
from pcpc.executive.loop.table import Variable
from pcpc.executive.nodes import planned_drive
from pcpc.executive.nodes.part import Part, Plan, Size
from pcpc.executive.rig import messages as protocol


class Frames(Part):
    """What a node receives and sends; each signal is a variable."""

    def variables(self, made: Plan) -> None:
        """Take the frames of the DBC file, and their signals; RigError for one that is lacking."""
        rig, role, database = made.rig, made.role, protocol.database_of(made.rig)
        with protocol.errors_named(rig):
            made.rx_frames = planned_drive.frames(rig, role, database, "rx")
            sent = planned_drive.frames(rig, role, database, "tx")
            made.tx_frames = sorted(sent, key=protocol.sending_order)
            if not made.is_plant:
                own = {frame.name for frame in (*made.rx_frames, *made.tx_frames)}
                made.below = protocol.frames_on_second(rig, database) & own
            made.senders = protocol.senders_below(rig, role, database)
            planned_drive.check_senders(rig, database, made.pacing)
            protocol.check(rig, role, made.rx_frames, made.tx_frames)
        for kind, way in (("received", "rx"), ("sent", "tx")):
            for frame in made.rx_frames if way == "rx" else made.tx_frames:
                for s in frame.signals:
                    name = f"{way}.{frame.name}.{s.name}"
                    made.add(Variable(name, s.unit, kind, frame.name, s.help, s.low, s.high))

    def sizes(self, made: Plan) -> list[Size]:
        """Return how many frames and signals there are, of the direction that has more."""
        ways = made.rx_frames, made.tx_frames
        signals = [len(dbc.table(frames, 1.0).variables) for frames in ways]
        return [
            ("frames", max(map(len, ways)), sh.MAX_FRAMES),
            ("signals", max(signals), sh.MAX_SIGNALS),
        ]

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the tables of the codec, and which variables are sent."""
        rx, tx, rate_hz = loop.rx, loop.tx, made.rig.config.rate_hz
        for way, frames in (("rx", made.rx_frames), ("tx", made.tx_frames)):
            own = {name[3:]: i for i, name in enumerate(made.names) if name.startswith(f"{way}.")}
            table, into = dbc.table(frames, rate_hz, own), loop[way]
            into.frames[: len(frames)] = table.frames
            into.signals[: len(table.signals)] = table.signals
        rx.n, tx.n = len(made.rx_frames), len(made.tx_frames)
        rx.state[: rx.n] = loop.faults.on_wire[: rx.n] = e2e.new_state(rx.n)
        for i, frame in enumerate(made.tx_frames):
            kinds = frame.has_sequence, protocol.is_heartbeat(frame), protocol.is_emergency(frame)
            tx.kind[i] = (*kinds, 0)
        sent = [i for i, variable in enumerate(made.table.variables) if variable.kind == "sent"]
        tx.first, tx.past = (sent[0], sent[-1] + 1) if sent else (0, 0)


class FrameRows(Part):
    """How large a frame is, on the wire and in a row of the ring and of the log."""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the size of a row, and which frames go out on the second bus."""
        loop.rings.frame_words = frame_words({"data_bytes": made.data_bytes})
        loop.rings.frame_rows = sh.FRAME_RING_WORDS // loop.rings.frame_words
        second = [frame.word for frame in made.tx_frames if frame.name in made.below]
        loop.wire.n_second, loop.wire.fd = len(second), made.fd
        loop.wire.second[: len(second)] = second

    def described(self, made: Plan) -> NodeDescription:
        """Return the size of a row that is longer than that of classic CAN."""
        return {"data_bytes": made.data_bytes} if made.fd else {}

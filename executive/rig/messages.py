"""What the frames of a DBC file mean to a node: what starts a cycle, what is awaited, who hears it.

SYNC         has the signals sequence and crc; the node above sends it as the last of its cycle
awaited      of every cycle and no SYNC: a cycle without one counts as missing input
heartbeat    ids 0x700 to 0x77F, as in CANopen
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager

from pcpc.drivers.can import dbc
from pcpc.executive.loop.meeting import MeetingPart
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import PLANTS, Role

FD_PROFILES = ("moteus",)  # drives whose frames are of CAN FD
SYNC_WAYS = {"executive": ("tx",), "local": ("rx", "tx")}  # a plant: ("rx",)


@contextmanager
def errors_named(rig: Rig) -> Iterator[None]:
    """Put the DBC file's name before what is wrong in it. Raises DbcError again."""
    try:
        yield
    except dbc.DbcError as error:
        raise dbc.DbcError(f"{rig.dbc}: {error}") from None


def database_of(rig: Rig) -> dbc.Database:
    """Return the frames of a rig's DBC file."""
    return dbc.load(rig.dbc)


def is_awaited(frame: dbc.Frame) -> bool:
    """Return True if a cycle without this frame counts as missing input."""
    return frame.cycle_ms == 0.0 and not frame.has_sequence


def starts_cycle(role: Role, frame: dbc.Frame, below: Collection[str]) -> bool:
    """Return True if this frame starts a cycle where no clock does.

    The executive waits for all feedback, the plant for SYNC, a local node for both; `below` are the
    frames on its bus to the plant.
    """
    feedback = role == "executive" or frame.name in below
    return frame.has_sequence or (feedback and is_awaited(frame))


def is_heartbeat(frame: dbc.Frame) -> bool:
    """Return True for CANopen's heartbeat, which nodes also send while they look for each other."""
    return 0x700 <= frame.can_id < 0x780


def is_emergency(frame: dbc.Frame) -> bool:
    """Return True for CANopen's emergency frame, which is sent when a fault comes or goes."""
    return frame.on_event and 0x080 < frame.can_id < 0x100 and not frame.protected


def sending_order(frame: dbc.Frame) -> tuple[bool, bool, int]:
    """Slow frames first, then the frames of every cycle, SYNC last; each by id."""
    return frame.has_sequence, frame.cycle_ms == 0.0, frame.can_id


def check(rig: Rig, role: Role, rx: Sequence[dbc.Frame], tx: Sequence[dbc.Frame]) -> None:
    """Raise RigError if a node lacks the SYNC that starts it, or those below, or any input."""
    is_drive = role in rig.config.drives  # which waits for nobody
    for way in () if is_drive else SYNC_WAYS.get(role, ("rx",)):
        if not any(frame.has_sequence for frame in (tx if way == "tx" else rx)):
            raise rig.error(
                "dbc",
                "no SYNC frame from executive to plant; in one frame from each node to the one "
                "below it, declare the signals sequence and crc",
            )
    for frame in tx:
        if frame.on_event and not is_emergency(frame):
            raise rig.error(
                "dbc",
                f"no node sends {frame.name}, of send type Event; only an emergency frame, 0x081 "
                "to 0x0FF and without counter and crc, may have it; give it a GenMsgCycleTime",
            )
    if not is_drive and not any(is_awaited(frame) for frame in rx):
        node = rig.config.sections[role].node
        slow = next((str(frame.can_id) for frame in rx if not is_heartbeat(frame)), "ID")
        raise rig.error(
            "dbc",
            f'{node} receives no frame with send type "EveryCycle"; write '
            f'BA_ "GenMsgSendType" BO_ {slow} 0; where 0 is EveryCycle in its BA_DEF_',
        )


def check_stops(rig: Rig, database: dbc.Database) -> None:
    """Raise RigError for an emergency stop or a stop frame that no node hears or that one sends."""
    nodes = [node.node for node in rig.config.sections.values()]
    heard = [frame for node in nodes for frame in dbc.frames(database, node, "rx")]
    signals = [f"{frame.name}.{signal.name}" for frame in heard for signal in frame.signals]
    single = [frame.name for frame in heard if frame.on_event]
    stops = rig.config.supervisor
    for key, name, known in (
        ("estop", stops.estop, signals),
        ("stop_frame", stops.stop_frame, single),
    ):
        if name is not None:
            phrase = "signal" if key == "estop" else "frame of GenMsgSendType Event"
            rig.known(f"supervisor.{key}", name, known, f"node receives a {phrase}")
    sent = [frame.name for node in nodes for frame in dbc.frames(database, node, "tx")]
    if stops.stop_frame in sent:
        phrase = f"{stops.stop_frame} is sent by a node of the rig; leave its sender open"
        raise rig.error("supervisor.stop_frame", phrase)
    if rig.config.watchdog is not None:
        stop_frame_of(rig)


def stop_frame_of(rig: Rig) -> str:
    """Return the name of the frame by which a watchdog stops a rig; RigError if it could not."""
    stop = rig.config.supervisor.stop_frame
    if stop is None:
        problem = "a watchdog needs a frame that stops the rig; name one as supervisor.stop_frame"
        raise rig.error("watchdog", f"{problem} (docs/bus-safety.md)")
    if "supervisor.state" not in rig.nodes()["executive"].transmit.values():
        problem = "a watchdog does not see the end of a run; transmit supervisor.state, as CMD.mode"
        raise rig.error("executive.transmit", problem)
    return stop


def frames_on_second(rig: Rig, database: dbc.Database) -> frozenset[str]:
    """Return the frames of the rig's second bus, to a local node's plant or to plants on their own.

    RigError if one is on both buses.
    """
    known = {role: _frame_names(database, node.node) for role, node in rig.config.sections.items()}
    if rig.config.local is not None:
        second, both = known["local"] & known["plant"], known["executive"]
    else:
        plants = rig.config.plants.items()
        second, both = (
            set[str]().union(*(known[role] for role, one in plants if (one.bus is None) == first))
            for first in (False, True)
        )
    for name in sorted(second & both):
        raise rig.error("dbc", f"frame {name} is on both buses; give each bus a frame of its own")
    return frozenset(second)


def senders_below(rig: Rig, role: Role, database: dbc.Database) -> dict[str, int]:
    """Return the node below `role` that sends a frame, 1 and up, by the frame's name.

    Empty where one is below.
    """
    plants = rig.config.plants
    if role != "executive" or len(plants) < 2:
        return {}
    return {
        frame.name: i + 1
        for i, plant in enumerate(plants.values())
        for frame in dbc.frames(database, plant.node, "tx")
    }


def check_heartbeats(rig: Rig, sent: Mapping[Role, Sequence[dbc.Frame]]) -> None:
    """Raise RigError for a node below another without a heartbeat, for which that one waits.

    `sent`: what each node sends before its first cycle.
    """
    nodes, database = rig.config.sections, database_of(rig)
    pairs: list[tuple[Role, Role]] = [("executive", role) for role in rig.config.plants]
    if rig.config.local is not None:
        pairs = [("executive", "local"), ("local", "plant")]
    for above, below in pairs:
        heard = {frame.name for frame in dbc.frames(database, nodes[above].node, "rx")}
        if nodes[above].node != nodes[below].node and not any(
            is_heartbeat(frame) and frame.name in heard for frame in sent[below]
        ):
            sender, receiver = nodes[below].node, nodes[above].node
            what = f"{sender} sends no heartbeat that {receiver} receives, and the start waits"
            cure = f"give {rig.dbc.name} a frame from {sender} to {receiver}, id 0x701 to 0x77F"
            raise rig.error(f"{below}.node", f"{what} for one; {cure}")


def unsent_frames(rig: Rig, database: dbc.Database) -> Iterator[tuple[Role, dbc.Frame]]:
    """Yield what a node awaits in each cycle and no node of the rig sends.

    Which frames a drive sends its objects say while it runs.
    """
    if rig.config.drives:
        return
    nodes = rig.config.sections
    sent = {frame.name for one in nodes.values() for frame in dbc.frames(database, one.node, "tx")}
    for role, one in nodes.items():
        for frame in dbc.frames(database, one.node, "rx"):
            if (frame.has_sequence or is_awaited(frame)) and frame.name not in sent:
                yield role, frame


def check_starters(rig: Rig, database: dbc.Database) -> None:
    """Raise RigError for a frame that starts cycles, where no clock does, and has no sender."""
    for role, frame in unsent_frames(rig, database):
        if frame.has_sequence or role in ("executive", "local"):
            raise rig.error("dbc", unsent_text(rig, role, frame))


def unsent_text(rig: Rig, role: Role, frame: dbc.Frame) -> str:
    """Return what is wrong with a frame of `unsent_frames`, and the cures."""
    node, name = rig.config.sections[role].node, frame.name
    cure = f"give it a sender or a GenMsgCycleTime, or take {node} from its receivers"
    return f"no node of the rig sends {name}, for which {node} waits in each cycle; {cure}"


def unsent_lines(rig: Rig) -> list[str]:
    """Return a line for each frame that a node awaits and no node of the rig sends."""
    database = database_of(rig)
    frames = unsent_frames(rig, database)
    return [f"{rig.where('dbc')}: {unsent_text(rig, role, frame)}" for role, frame in frames]


def received_frames(rig: Rig, database: dbc.Database) -> dict[Role, list[str]]:
    """Return the names of the frames that each node receives."""
    return {
        role: [frame.name for frame in dbc.frames(database, node.node, "rx")]
        for role, node in rig.config.sections.items()
    }


def _frame_names(database: dbc.Database, node: str) -> set[str]:
    """Return the names of the frames that a node sends or receives."""
    both = (*dbc.frames(database, node, "rx"), *dbc.frames(database, node, "tx"))
    return {frame.name for frame in both}


def _frames_of_rig(rig: Rig, database: dbc.Database) -> set[str]:
    nodes = rig.config.sections.values()
    return set[str]().union(*(_frame_names(database, node.node) for node in nodes))


def frames_of_rig(rig: Rig, database: dbc.Database) -> list[dbc.Frame]:
    """Return the frames that the rig's nodes send or receive; a DBC file may know more."""
    known = _frames_of_rig(rig, database)
    return [dbc.frame(message) for message in database.messages if message.name in known]


def frames_by_bus(rig: Rig, database: dbc.Database) -> tuple[frozenset[str], ...]:
    """Return the names of the frames on each of a rig's buses, the executive's first.

    Only frames of the rig's nodes count: a DBC file may know more nodes than a rig has.
    """
    known = _frames_of_rig(rig, database)
    second = frames_on_second(rig, database)
    return (frozenset(known - second), *([second] if second else []))


def check_no_drive(rig: Rig, problem: str) -> None:
    """Raise RigError, `problem` it is, if one of the rig's plants is a drive."""
    for role in rig.config.drives:
        raise rig.error(f"{role}.drive", problem)


def fd_frames(rig: Rig) -> list[dbc.Frame]:
    """Return the rig's frames that are of CAN FD."""
    with errors_named(rig):
        return [one for one in frames_of_rig(rig, database_of(rig)) if one.fd]


def has_fd_drive(rig: Rig) -> bool:
    """Return whether one of the rig's plants is a drive whose frames are of CAN FD."""
    return any(drive.profile in FD_PROFILES for drive in rig.config.drives.values())


def peers_of(
    made_for: Role, rx: Sequence[dbc.Frame], below: Collection[str], senders: Mapping[str, int]
) -> list[int]:
    """Return which of the nodes that a node waits for sends each received frame, 1 and up; else 0.

    `below`: frames of a local node's bus to the plant; `senders`: of `senders_below`.
    """
    if senders:
        return [senders.get(frame.name, 0) for frame in rx]
    return [int(made_for != "local" or frame.name in below) for frame in rx]


def parts_in_meeting(
    made_for: Role, rx: Sequence[dbc.Frame], peers: Sequence[int]
) -> list[MeetingPart]:
    """Return what each received frame is to the meeting; `peers`: of `peers_of`.

    All frames of the executive come from below, none of a plant's.
    """
    below = [0 if made_for in PLANTS else peer for peer in peers]
    first: dict[int, dbc.Frame] = {}
    for frame in sorted(filter(is_heartbeat, rx), key=sending_order):
        first.setdefault(below[rx.index(frame)], frame)
    parts = []
    for frame, peer in zip(rx, below, strict=True):
        beat = first.get(peer)
        if is_heartbeat(frame) and peer == 0 and made_for != "executive":
            parts.append(MeetingPart.FROM_ABOVE)
        elif beat is None or peer == 0:
            parts.append(MeetingPart.NO_PART)
        elif frame is beat:
            parts.append(MeetingPart.FROM_BELOW)
        else:
            later = sending_order(frame) > sending_order(beat)
            parts.append(MeetingPart.AFTER if later else MeetingPart.BEFORE)
    return parts

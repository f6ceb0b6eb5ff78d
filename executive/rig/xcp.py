"""XCP on CAN: the ids of a rig's nodes, and the frames that these add to its bus."""

from collections.abc import Iterator
from itertools import chain

from pcpc.drivers.can.frames import Frame
from pcpc.drivers.can.wire_layout import Flag
from pcpc.executive.rig.bus_keys import Drive, Xcp
from pcpc.executive.rig.messages import database_of, fd_frames, has_fd_drive
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

FREE_FROM = range(Xcp().can[0], 0x100, -1), range(0x10000000, 0x10010000)  # for a suggestion
MASTER = "XCP master"  # as a sender


def xcp_flags(rig: Rig) -> int:
    """Return the flags of XCP's frames: of CAN FD where the rig has such, switched if it can."""
    if not fd_frames(rig) and not has_fd_drive(rig):
        return Flag.NONE
    return Flag.FD | Flag.BRS * (rig.config.bus.data_bitrate is not None)


def xcp_ids(rig: Rig) -> dict[Role, tuple[int, int]]:
    """Return the ids from master to slave and back by node; none without XCP on CAN.

    RigError: one of them is another frame's.
    """
    keys = rig.config.xcp_on_can
    if keys is None:
        return {}
    owners = {message.frame_id: message.name for message in database_of(rig).messages}
    owners |= {
        number: f"the drive {role}'s"
        for role, drive in rig.config.drives.items()
        for number in range(0x800)
        if _belongs(number, drive)
    }

    def ids(first: int, second: int) -> list[tuple[int, int]]:
        return [(first + 2 * i, second + 2 * i) for i in range(len(rig.roles))]

    own = list(chain(*ids(*keys.can)))
    if clash := next((one for one in own if one in owners or own.count(one) > 1), None):
        free = next(n for n in chain(*FREE_FROM) if not owners.keys() & {*chain(*ids(n, n + 1))})
        what = f"the id 0x{clash:X} is {owners.get(clash, 'of two nodes')}, too"
        raise rig.error("xcp", f"{what}; free is xcp: {{can: [0x{free:X}, 0x{free + 1:X}]}}")
    return dict(zip(rig.roles, ids(*keys.can), strict=True))


def _belongs(number: int, drive: Drive) -> bool:
    """Return whether an id of 11 bits may be that of a drive's frame."""
    if drive.profile == "odrive":
        return number >> 5 == drive.node
    if drive.profile == "cia402":
        return number < 0x780 and number & 0x7F in (0, drive.node)
    return drive.node in (number & 0xFF, number >> 8)


def xcp_frames(rig: Rig) -> Iterator[tuple[str, Frame, int]]:
    """Yield sender and form of what is sent in `Xcp.CYCLES`, and how many of them at most."""
    keys, flags = rig.config.xcp_on_can, xcp_flags(rig)
    for role, (down, up) in xcp_ids(rig).items():
        assert keys is not None, "as there are ids"
        node = rig.config.sections[role].node
        for sender, number, count in ((MASTER, down, keys.commands), (node, up, keys.frames)):
            yield sender, _form(rig, number, f"XCP x{count}", flags), count


def _form(rig: Rig, number: int, name: str, flags: int) -> Frame:
    cycle_ms = 1e3 * Xcp.CYCLES / rig.config.rate_hz
    none = (0, 0, 0)
    long = number > 0x7FF
    size = 64 if flags else 8
    return Frame(name, number, long, size, cycle_ms, False, none, none, (), "", flags=flags)
